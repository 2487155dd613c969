"""Certificates: forces and numbers that prove a grasp, and their check in NumPy without a solver."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import cone_violation, contact_frames, grasp_matrix
from xdex_drake.contact.margins import ball_margin, task_margin
from xdex_drake.contact.wrench import GRAVITY, balance, gravity_wrench, push_wrenches
from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Certificate, Contact


@dataclass(frozen=True)
class CertificateResult:
    """A certificate, or the reason why there is none.

    Attributes:
        certificate: The certificate; None where gravity cannot be balanced.
        reason: Why there is none; empty where there is one.
        seconds: Wall time.
    """

    certificate: Certificate | None
    reason: str
    seconds: float


@dataclass(frozen=True)
class Residuals:
    """What remains unproved of a certificate; all zero, to rounding, where it is sound.

    Attributes:
        wrench: Norm of the unbalanced wrench of gravity and forces, torque divided by length, divided by m g.
        cone: Greatest violation of a friction cone by the forces, divided by m g.
        witness: Greatest distance of a witness force's wrench from +-margin_lower along its axis.
        witness_cone: Greatest violation of the cones or of sum f_n <= 1 by the witness forces.
        support: How far the support of the wrench set in `witness_direction` differs from margin_upper.
        bracket: max(0, margin_lower - margin_upper).
    """

    wrench: float
    cone: float
    witness: float
    witness_cone: float
    support: float
    bracket: float

    def passes(self, tolerance: float = 1e-6) -> bool:
        """Whether every residual is at most `tolerance`; a residual that is not a number fails."""
        values = (self.wrench, self.cone, self.witness, self.witness_cone, self.support, self.bracket)
        return all(value <= tolerance for value in values)


def contact_geometry(p_OCs: ArrayLike, n_OCs: ArrayLike, R_WO: ArrayLike, p_OOcm: ArrayLike) -> tuple[Array, Array]:
    """Contact frames and grasp matrix in W of contacts given in O.

    The contact frame is fixed to the object, R_OC = contact_frames(n_OC), so that stored forces keep their meaning when
    the object turns.

    Args:
        p_OCs: Contact points in O [m], shape (n, 3).
        n_OCs: Unit normals in O, into the object, shape (n, 3).
        R_WO: Rotation of the object in W, shape (3, 3).
        p_OOcm: Center of mass in O [m], shape (3,).

    Returns:
        R_WCs, shape (n, 3, 3), and G of F_Ocm_W = G f, shape (6, 3 n).

    Raises:
        ConfigError: Shapes do not match or a normal has zero length.
    """
    R = np.asarray(R_WO, dtype=float)
    p_OCs = np.asarray(p_OCs, dtype=float).reshape(-1, 3)
    R_WCs = R @ contact_frames(np.asarray(n_OCs, dtype=float).reshape(-1, 3))
    return R_WCs, grasp_matrix((p_OCs - np.asarray(p_OOcm, dtype=float)) @ R.T, R_WCs, np.zeros(3))


def certify(
    p_OCs: ArrayLike,
    n_OCs: ArrayLike,
    links: Sequence[str],
    *,
    mu: ArrayLike,
    mass: float,
    p_OOcm: ArrayLike,
    length: float,
    R_WO: ArrayLike,
    A: ArrayLike | None = None,
    effort: ArrayLike | None = None,
    safety: float = 0.95,
    min_normal: float = 0.0,
    disturbances: ArrayLike | None = None,
    tol: float = 1e-3,
    gravity: float = GRAVITY,
) -> CertificateResult:
    """Prove that a grasp holds its object: forces for gravity, task margin, bracket of the ball margin.

    The forces are computed with friction mu * safety, so that the proof with mu has room for rounding. The margins take
    mu itself.

    Args:
        p_OCs: Contact points in O [m], shape (n, 3).
        n_OCs: Unit normals in O, into the object, shape (n, 3).
        links: Name of the hand's link at each contact, n of them.
        mu: Coefficient of friction, one or n.
        mass: Mass of the object [kg], positive.
        p_OOcm: Center of mass in O [m], shape (3,).
        length: Length that divides torques [m].
        R_WO: Rotation of the object in W, shape (3, 3).
        A: Map of contact forces to actuated joint torques, in the contact frames of `contact_geometry`, shape
            (n_act, 3 n).
        effort: Limits of |A f|, shape (n_act,).
        safety: Factor on friction for the stored forces, below 1.
        min_normal: Least normal force at each contact [N].
        disturbances: Wrenches of the task margin, in W, torque first, shape (k, 6); six pushes of m g by default.
        tol: Width of the bracket of the ball margin.
        gravity: Acceleration of gravity [m/s^2].

    Returns:
        The certificate, or the reason why gravity cannot be balanced.

    Raises:
        ConfigError: Shapes do not match or a number is out of range.
    """
    start = time.perf_counter()
    p, normals = np.asarray(p_OCs, dtype=float).reshape(-1, 3), np.asarray(n_OCs, dtype=float).reshape(-1, 3)
    n = len(p)
    if len(normals) != n or len(links) != n:
        raise ConfigError(
            f"contacts: {n} points, {len(normals)} normals, {len(links)} links; give one of each per contact"
        )
    if not mass > 0.0:
        raise ConfigError(f"mass: {mass} must be positive")
    if n == 0:
        return CertificateResult(None, "there is no contact", time.perf_counter() - start)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    mus = np.full(n, 1.0) * np.asarray(mu, dtype=float)
    _, G = contact_geometry(p, normals, R_WO, p_OOcm)
    F = gravity_wrench(mass, gravity)
    forces = balance(G, mus, F, A=A, effort=effort, length=length, min_normal=min_normal, safety=safety)
    if not forces.solved:
        return CertificateResult(None, f"gravity is not held: {forces.reason}", time.perf_counter() - start)
    pushes = push_wrenches(mass, gravity) if disturbances is None else disturbances
    task = task_margin(G, mus, F, pushes, A, effort, length=length)
    ball = ball_margin(G, mus, length=length, tol=tol)
    certificate = Certificate(
        contacts=tuple(
            Contact(link, p[i].copy(), normals[i].copy(), float(mus[i]), forces.f[3 * i : 3 * i + 3].copy())
            for i, link in enumerate(links)
        ),
        R_WO=np.array(R_WO, dtype=float),
        p_OOcm=np.array(p_OOcm, dtype=float),
        mass=float(mass),
        length=float(length),
        wrench_residual=forces.residual,
        task_margin=task.margin,
        margin_lower=ball.lower,
        margin_upper=ball.upper,
        witness_forces=ball.witness_forces,
        witness_direction=ball.direction,
    )
    return CertificateResult(certificate, "", time.perf_counter() - start)


def check_certificate(certificate: Certificate, gravity: float = GRAVITY) -> Residuals:
    """Check a certificate again, in plain NumPy, without a solver.

    Args:
        certificate: The certificate.
        gravity: Acceleration of gravity [m/s^2].

    Returns:
        Residuals; `residuals.passes()` is the verdict.
    """
    contacts, nan = certificate.contacts, float("nan")
    if not contacts:
        return Residuals(nan, nan, nan, nan, nan, nan)
    n, weight = len(contacts), certificate.mass * gravity
    mu = np.array([contact.mu for contact in contacts])
    f = np.array([contact.f_C for contact in contacts])  # (n, 3)
    p_OCs, n_OCs = np.array([c.p_OC for c in contacts]), np.array([c.n_OC for c in contacts])
    _, G = contact_geometry(p_OCs, n_OCs, certificate.R_WO, certificate.p_OOcm)
    G[:3] /= certificate.length  # torques divided by length
    w = np.asarray(certificate.witness_forces).reshape(12, n, 3)
    axes = np.kron(np.eye(6), [[1.0], [-1.0]]) * certificate.margin_lower
    u = certificate.witness_direction / np.linalg.norm(certificate.witness_direction)
    g = (G.T @ u).reshape(n, 3)
    h = max(0.0, float((mu * np.hypot(g[:, 0], g[:, 1]) + g[:, 2]).max()))
    return Residuals(
        wrench=float(np.linalg.norm(G @ f.ravel() - [0, 0, 0, 0, 0, weight])) / weight,
        cone=float(cone_violation(f, mu).max()) / weight,
        witness=float(np.linalg.norm(w.reshape(12, -1) @ G.T - axes, axis=1).max()),
        witness_cone=max(float(cone_violation(w, mu).max()), float(w[..., 2].sum(axis=1).max()) - 1.0, 0.0),
        support=abs(h - certificate.margin_upper),
        bracket=max(0.0, certificate.margin_lower - certificate.margin_upper),
    )
