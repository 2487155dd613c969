"""Certificates: forces and numbers that prove a grasp, and their check in NumPy without a solver."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from xdex_drake.contact.cones import cone_violation
from xdex_drake.contact.grasp_map import Effort, GraspMap
from xdex_drake.contact.held_object import HeldObject
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


def certify(
    p_OCs: ArrayLike,
    n_OCs: ArrayLike,
    links: Sequence[str],
    held: HeldObject,
    *,
    effort: Effort | None = None,
    safety: float = 0.95,
    min_normal: float = 0.0,
) -> CertificateResult:
    """Prove that a grasp holds its object: forces for gravity, task margin against six pushes, bracket of the ball.

    The forces are computed with friction mu * safety, so that the proof with mu has room for rounding. The margins take
    mu itself.

    Args:
        p_OCs: Contact points in O [m], shape (n, 3).
        n_OCs: Normals in O, into the object, of any length, shape (n, 3).
        links: Name of the hand's link at each contact, n of them.
        held: The object; that of a scene is `HeldObject.of(scene)`.
        effort: What the hand can apply, in the contact frames of `held.grasp_map`; anything where None.
        safety: Factor on friction for the stored forces, below 1.
        min_normal: Least normal force at each contact [N].

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
    if n == 0:
        return CertificateResult(None, "there is no contact", time.perf_counter() - start)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    grasp_map, F = held.grasp_map(p, normals), gravity_wrench(held.mass)
    forces = balance(grasp_map, F, effort=effort, safety=safety, min_normal=min_normal)
    if not forces.solved:
        return CertificateResult(None, f"gravity is not held: {forces.reason}", time.perf_counter() - start)
    task = task_margin(grasp_map, F, push_wrenches(held.mass), effort=effort)
    ball = ball_margin(grasp_map)
    certificate = Certificate(
        contacts=tuple(
            Contact(link, p[i].copy(), normals[i].copy(), float(grasp_map.mus[i]), forces.f[3 * i : 3 * i + 3].copy())
            for i, link in enumerate(links)
        ),
        R_WO=np.array(held.R_WO, dtype=float),
        p_OOcm=np.array(held.p_OOcm, dtype=float),
        mass=float(held.mass),
        length=float(held.length),
        wrench_residual=forces.residual,
        task_margin=task.margin,
        margin_lower=ball.lower,
        margin_upper=ball.upper,
        witness_forces=ball.witness_forces,
        witness_direction=ball.direction,
    )
    return CertificateResult(certificate, "", time.perf_counter() - start)


def certified_map(certificate: Certificate) -> GraspMap:
    """The grasp map in W that a certificate is about."""
    contacts = certificate.contacts
    mu = np.array([contact.mu for contact in contacts])
    held = HeldObject(certificate.mass, certificate.length, certificate.p_OOcm, mu, certificate.R_WO)
    return held.grasp_map([contact.p_OC for contact in contacts], [contact.n_OC for contact in contacts])


def with_forces(certificate: Certificate, f: ArrayLike) -> Certificate:
    """The certificate with other forces that balance gravity within the cones, such as those of a firmer squeeze.

    Args:
        certificate: The certificate.
        f: The forces in contact frames [N], shape (3 n,).

    Returns:
        The certificate; its margins do not depend on the forces.
    """
    forces = np.asarray(f, dtype=float).reshape(-1, 3)
    contacts = tuple(replace(c, f_C=force.copy()) for c, force in zip(certificate.contacts, forces, strict=True))
    changed = replace(certificate, contacts=contacts)
    return replace(changed, wrench_residual=check_certificate(changed).wrench)


def check_certificate(certificate: Certificate) -> Residuals:
    """Check a certificate again, in plain NumPy, without a solver.

    Args:
        certificate: The certificate.

    Returns:
        Residuals; `residuals.passes()` is the verdict.
    """
    contacts, nan = certificate.contacts, float("nan")
    if not contacts:
        return Residuals(nan, nan, nan, nan, nan, nan)
    try:
        grasp_map = certified_map(certificate)
    except ConfigError:  # numbers that are no grasp prove nothing
        return Residuals(nan, nan, nan, nan, nan, nan)
    n, mu, G, weight = len(contacts), grasp_map.mus, grasp_map.scaled, certificate.mass * GRAVITY
    f = np.array([contact.f_C for contact in contacts])  # (n, 3)
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
