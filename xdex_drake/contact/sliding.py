"""What pushes do to an object held by constant targets, contacts sliding where they must.

The law of `contact.stiffness` ends where the first contact slides, and most grasps hold beyond: forces move to other
contacts, or the object turns a little and stops. Here the grasp is stepped through each push, with its stiffness H(f0)
and its contact points and normals as they are at rest. A step of length h minimises

    1/2 |v - v_0|^2_M + h/2 |v|^2_D + 1/2 z' H z - w' z + sum_i phi_n(e_n) + h mu f_n |e_t'|,      z = z_0 + h v,

M being the object's inertia and D the joints' damping; contacts are springs C_s along their normals that do not pull
(phi_n), and along their tangents they have Coulomb's friction with the normal force of the step before, as in Drake's
`lagged` approximation (Castro et al., 2023). That is a small convex program a step. It is solved by weighted least
squares: |e_t'| is replaced by its majoriser at the last iterate, a damper mu f_n / sqrt(|e_t'|^2 + creep^2), so that
every iterate lowers the cost. Iterates are solved for u = E z, E = [J, -G'], 3 nc numbers: with A = M / h^2 + D / h + H
and weights W of springs and dampers, z = A^-1 (loads - E' W u) gives (1 + E A^-1 E' W) u = E A^-1 loads. All pushes are
stepped at once.

Reference:
    A. Castro, X. Han, J. Masterjohn, Irrotational contact fields, 2023, arXiv:2312.03908.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from xdex_drake.arrays import Array
from xdex_drake.contact.stiffness import GraspStiffness

JOINT_INERTIA = 2e-5
"""Inertia of a joint with what it carries [kg m^2]: far below what the damping of a step amounts to."""

LOST = 1.0
"""Motion beyond which an object counts as lost, and is not followed further [m and rad]."""


@dataclass(frozen=True)
class PushSettings:
    """How pushes are stepped.

    Attributes:
        ramp_s: Time over which a push grows linearly [s].
        duration_s: Time of a push, with its ramp [s].
        step_s: Length of a step [s].
        damping: Damping of every joint, of its control and its own [N m s/rad].
        creep: Speed at which friction is half-way regularised [m/s].
        iterations: Least-squares solves of each step.
    """

    ramp_s: float = 0.1
    duration_s: float = 0.5
    step_s: float = 0.025
    damping: float = 0.11
    creep: float = 1e-3
    iterations: int = 3


PUSH = PushSettings()


@dataclass(frozen=True)
class PushedMotion:
    """How far pushes move an object in the hand, the greatest over time.

    Attributes:
        shift: Motion of the center of mass [m], shape (k,); at most `LOST`.
        turn: Turn of the object [rad], shape (k,); at most `LOST`.
        f: Contact forces at the end of each push in their frames [N], shape (k, nc, 3).
    """

    shift: Array
    turn: Array
    f: Array


def pushed_motion(
    stiffness: GraspStiffness,
    f: ArrayLike,
    mu: ArrayLike,
    wrenches: ArrayLike,
    *,
    mass: float,
    inertia: ArrayLike,
    settings: PushSettings = PUSH,
) -> PushedMotion:
    """Steps a grasp through pushes.

    Args:
        stiffness: The grasp's stiffness.
        f: Forces while nothing pushes, in balance and within friction [N], shape (3 nc,).
        mu: Coefficient of friction, one or nc.
        wrenches: Pushes on the object about its center of mass, torque first, shape (k, 6).
        mass: Mass of the object [kg].
        inertia: Its inertia about the center of mass in W [kg m^2], shape (3, 3).
        settings: How pushes are stepped.

    Returns:
        The motions.
    """
    f0, W = np.asarray(f, dtype=float).reshape(-1, 3), np.atleast_2d(np.asarray(wrenches, dtype=float))
    (k, nc), m, h = (len(W), len(f0)), len(stiffness.kp), settings.step_s
    # Components of all contacts: tangents in pairs, then normals.
    order, t = np.concatenate([(3 * np.arange(nc)[:, None] + [0, 1]).ravel(), np.arange(2, 3 * nc, 3)]), 2 * nc
    E = np.concatenate([stiffness.J, -stiffness.G.T], axis=1)[order]
    H = stiffness.hessian(f0.ravel()) - stiffness.elastic
    H[np.arange(m), np.arange(m)] += stiffness.kp
    M, D = _inertias(m, mass, np.asarray(inertia, dtype=float), settings.damping)
    inert, still = M / h**2 + D / h, M / h
    free = np.linalg.inv(inert + 0.5 * (H + H.T))
    by_contacts = E @ free
    S, Et, unit = by_contacts @ E.T, np.ascontiguousarray(E.T), np.eye(3 * nc)
    mus, spring, at_rest = np.full(nc, 1.0) * np.asarray(mu, dtype=float), 1.0 / stiffness.compliance[2::3], f0[:, 2]
    # Loads at rest are in balance with f0, so that what remains is the pushes and what changes of the forces.
    rest = f0.ravel()[order] @ E
    z, v, u = np.zeros((k, m + 6)), np.zeros((k, m + 6)), np.zeros((k, 3 * nc))
    normal, pressing, touching = np.tile(at_rest, (k, 1)), np.tile(at_rest, (k, 1)), np.ones((k, nc))
    weights, pulls, slid = np.empty((k, 3 * nc)), np.empty((k, 3 * nc)), np.zeros((k, t))
    c, shift, turn = mus * normal / settings.creep, np.zeros(k), np.zeros(k)
    for step in range(1, round(settings.duration_s / h) + 1):
        load = z @ inert + v @ still + rest
        load[:, m:] += min(1.0, step * h / settings.ramp_s) * W
        z_0, was, limit = z, u[:, :t], mus * normal
        z_free = load @ free
        u_free = z_free @ Et
        for _ in range(settings.iterations):
            # Contacts add -E' (weights u - pulls) to the loads.
            weights[:, 0:t:2] = weights[:, 1:t:2] = c / h
            weights[:, t:] = touching * spring
            pulls[:, :t], pulls[:, t:] = weights[:, :t] * was, -touching * at_rest
            u = np.linalg.solve(unit + S * weights[:, None, :], (u_free + pulls @ S)[:, :, None])[:, :, 0]
            slid = (u[:, :t] - was) / h
            pressing = at_rest + spring * u[:, t:]
            touching = (pressing > 0.0).astype(float)
            c = limit / np.sqrt(slid[:, 0::2] ** 2 + slid[:, 1::2] ** 2 + settings.creep**2)
        z = z_free - (weights * u - pulls) @ by_contacts
        v, normal = (z - z_0) / h, np.maximum(pressing, 0.0)
        lost = ~(np.abs(z).max(axis=1) < LOST)  # true of what is not a number, too
        shift = np.maximum(shift, np.where(lost, LOST, np.linalg.norm(z[:, m + 3 :], axis=1)))
        turn = np.maximum(turn, np.where(lost, LOST, np.linalg.norm(z[:, m : m + 3], axis=1)))
        z[lost], v[lost], u[lost], normal[lost], slid[lost] = 0.0, 0.0, 0.0, 0.0, 0.0
    forces = np.concatenate([c[:, :, None] * slid.reshape(k, nc, 2), normal[:, :, None]], axis=2)
    return PushedMotion(np.minimum(shift, LOST), np.minimum(turn, LOST), forces)


def _inertias(m: int, mass: float, inertia: Array, damping: float) -> tuple[Array, Array]:
    """Inertia and damping of (joints, object), each of shape (m + 6, m + 6)."""
    M, D = np.zeros((m + 6, m + 6)), np.zeros((m + 6, m + 6))
    joints = np.arange(m)
    M[joints, joints], D[joints, joints] = JOINT_INERTIA, damping
    M[m : m + 3, m : m + 3], M[m + 3 :, m + 3 :] = inertia, mass * np.eye(3)
    return M, D
