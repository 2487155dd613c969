"""Wrenches of contact forces, and forces within friction cones, for NumPy arrays and torch tensors alike."""

from __future__ import annotations

from typing import Any

from xdex_drake.programs.arrays import cross, namespace

FORCE_FRICTION = 0.4
"""Fraction of the friction that the forces of an energy may use, so that a margin is left."""

NORMAL_FORCES = (0.3, 1.5)
"""Least and greatest normal component of such forces; their scale is arbitrary."""


def wrench(p_WCs: Any, f_Ws: Any, p_WOcm: Any, length: float) -> Any:
    """Wrench of contact forces on the object about its center of mass, torque divided by a length.

    Args:
        p_WCs: Contact points [m], shape (..., nc, 3).
        f_Ws: Forces on the object, in W [N], shape (..., nc, 3).
        p_WOcm: Center of mass [m], shape (3,).
        length: Length that divides the torque [m].

    Returns:
        (torque / length, force) [N], shape (..., 6).
    """
    torque = cross(p_WCs - p_WOcm, f_Ws).sum(-2) / length
    return namespace(p_WCs).concatenate([torque, f_Ws.sum(-2)], -1)


def grasp_map(p_WCs: Any, p_WOcm: Any, length: float) -> Any:
    """The matrix G of `wrench`, which is linear in the forces: wrench = G f.

    Args:
        p_WCs: Contact points [m], shape (..., nc, 3).
        p_WOcm: Center of mass [m], shape (3,).
        length: Length that divides the torque [m].

    Returns:
        G, shape (..., 6, 3 nc).
    """
    xp = namespace(p_WCs)
    x, y, z = (((p_WCs - p_WOcm) / length)[..., k] for k in range(3))
    o, one = 0.0 * x, 0.0 * x + 1.0
    rows = [[o, -z, y], [z, o, -x], [-y, x, o], [one, o, o], [o, one, o], [o, o, one]]
    G = xp.stack([xp.stack(row, -1) for row in rows], -3)  # (..., 6, nc, 3)
    return G.reshape(*G.shape[:-2], -1)


def project_forces(f_Ws: Any, n_WCs: Any, mu: float, low: float, high: float) -> Any:
    """Forces in the friction cone with a bounded normal component, near the given ones.

    The nearest point of the second-order cone in closed form, then the normal component into its bounds.

    Args:
        f_Ws: Forces on the object, in W, shape (..., nc, 3).
        n_WCs: Unit normals into the object, shape (..., nc, 3).
        mu: Coefficient of friction.
        low: Least normal component.
        high: Greatest normal component.

    Returns:
        Forces, shape (..., nc, 3).
    """
    normal = (f_Ws * n_WCs).sum(-1)[..., None]
    tangent = f_Ws - normal * n_WCs
    size = ((tangent * tangent).sum(-1)[..., None] + 1e-18) ** 0.5
    onto = (normal + mu * size) / (1.0 + mu * mu)
    outside = 1.0 * (size > mu * normal)
    normal = outside * onto + (1.0 - outside) * normal
    normal = normal.clip(min=low, max=high)
    scale = (mu * normal / size).clip(max=1.0)
    return normal * n_WCs + scale * tangent


def relaxed_forces(
    f_Ws: Any, p_WCs: Any, n_WCs: Any, touching: Any, *, p_WOcm: Any, length: float, mu: float, steps: int
) -> Any:
    """Forces within friction cones that leave less unbalanced wrench: projected-gradient steps on 1/2 |G f|^2.

    Args:
        f_Ws: Forces on the object to start from, in W [-], shape (..., nc, 3).
        p_WCs: Contact points [m], shape (..., nc, 3).
        n_WCs: Unit normals into the object, shape (..., nc, 3).
        touching: 1 for contacts that carry a force and 0 for others, shape (..., nc).
        p_WOcm: Center of mass [m], shape (3,).
        length: Length that divides torques [m].
        mu: Coefficient of friction.
        steps: Number of steps.

    Returns:
        Forces, shape (..., nc, 3).
    """
    mask = touching[..., None]
    step = 1.0 / (2.0 * touching.sum(-1).clip(min=1.0))[..., None, None]
    G = grasp_map(p_WCs, p_WOcm, length)
    Gt = G.swapaxes(-1, -2)
    force = f_Ws * mask
    for _ in range(steps):
        descent = (Gt @ (G @ force.reshape(*force.shape[:-2], -1, 1))).reshape(force.shape)
        force = project_forces(force - step * descent, n_WCs, mu, *NORMAL_FORCES) * mask
    return force
