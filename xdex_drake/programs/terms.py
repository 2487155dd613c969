"""Energy terms of the grasp programs, each written once, with its gradient, for NumPy arrays and torch tensors alike.

A term is a pure function of what kinematics supplies (distances of spheres, contact points and normals, keypoints,
joint values) and returns its value and its gradient with respect to those inputs. Leading dimensions are batches. The
same functions serve the batched search (torch) and the `MathematicalProgram` (NumPy).
"""

from __future__ import annotations

import sys
from typing import Any, TypeVar

import numpy as np

# A NumPy array or a torch tensor: whatever comes in, its like goes out.
A = TypeVar("A")


def _namespace(array: Any) -> Any:
    """The module, numpy or torch, that an array belongs to; never imports torch by itself."""
    return np if isinstance(array, np.ndarray) else sys.modules["torch"]


def cross(a: A, b: A) -> A:
    """Cross product along the last axis.

    Args:
        a: Vectors, shape (..., 3).
        b: Vectors, shape (..., 3).

    Returns:
        a x b, shape (..., 3).
    """
    return _namespace(a).linalg.cross(a, b)


def penetration(distances: Any, radii: Any) -> tuple[Any, Any]:
    """Sum of sphere penetrations: E_sdf of Eq. (1), with the hinge that the paper's print leaves out.

    E_sdf = sum_i max(0, r_i - SDF(c_i))

    Args:
        distances: Signed distance of each sphere's center, negative inside [m], shape (..., n).
        radii: Sphere radii [m], shape (n,).

    Returns:
        Value [m], shape (...), and gradient with respect to `distances`, shape (..., n); 0 where a sphere just touches.
    """
    depth = (radii - distances).clip(min=0.0)
    return depth.sum(-1), -1.0 * (depth > 0.0)


def contact_distance(distances: Any, radii: Any, weights: Any) -> tuple[Any, Any]:
    """Sum of gaps between contact spheres and the surface: E_dis of Eq. (1).

    E_dis = sum_i w_i |SDF(c_i) - r_i|

    Args:
        distances: Signed distance of each contact sphere's center [m], shape (..., nc).
        radii: Their radii [m], shape (..., nc).
        weights: 1 for a contact that is asked for and 0 for one that is not, shape (..., nc).

    Returns:
        Value [m], shape (...), and gradient with respect to `distances`, shape (..., nc); 0 where a contact is exact.
    """
    gap = distances - radii
    return (weights * abs(gap)).sum(-1), weights * (1.0 * (gap > 0.0) - 1.0 * (gap < 0.0))


def joint_limits(q: Any, limits: Any) -> tuple[Any, Any]:
    """Sum of limit violations: E_j of Eq. (1).

    E_j = sum_i max(0, q_i - upper_i) + max(0, lower_i - q_i)

    Args:
        q: Joint values [rad or m], shape (..., n).
        limits: Rows (lower, upper), shape (2, n).

    Returns:
        Value [rad or m], shape (...), and gradient with respect to `q`, shape (..., n).
    """
    above, below = (q - limits[1]).clip(min=0.0), (limits[0] - q).clip(min=0.0)
    return (above + below).sum(-1), 1.0 * (above > 0.0) - 1.0 * (below > 0.0)


def self_collision(between: Any, reach: Any) -> tuple[Any, Any]:
    """Sum of overlaps between pairs of spheres of different links: E_s of Eq. (1).

    E_s = sum over pairs of max(0, reach - |between|)

    Args:
        between: Differences between the centers of the two spheres [m], shape (..., m, 3).
        reach: Sum of the two radii of each pair [m], shape (m,).

    Returns:
        Value [m], shape (...), and its gradient with respect to `between`, shape (..., m, 3).
    """
    distance = ((between * between).sum(-1) + 1e-18) ** 0.5
    overlap = (reach - distance).clip(min=0.0)
    return overlap.sum(-1), -((overlap > 0.0) / distance)[..., None] * between


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
    return _namespace(p_WCs).concatenate([torque, f_Ws.sum(-2)], -1)


def grasp_map(p_WCs: Any, p_WOcm: Any, length: float) -> Any:
    """The matrix G of `wrench`, which is linear in the forces: wrench = G f.

    Args:
        p_WCs: Contact points [m], shape (..., nc, 3).
        p_WOcm: Center of mass [m], shape (3,).
        length: Length that divides the torque [m].

    Returns:
        G, shape (..., 6, 3 nc).
    """
    xp = _namespace(p_WCs)
    x, y, z = (((p_WCs - p_WOcm) / length)[..., k] for k in range(3))
    o, one = 0.0 * x, 0.0 * x + 1.0
    rows = [[o, -z, y], [z, o, -x], [-y, x, o], [one, o, o], [o, one, o], [o, o, one]]
    G = xp.stack([xp.stack(row, -1) for row in rows], -3)  # (..., 6, nc, 3)
    return G.reshape(*G.shape[:-2], -1)


def wrench_energy(p_WCs: Any, n_WCs: Any, f_Ws: Any, p_WOcm: Any, length: float) -> tuple[Any, Any, Any]:
    """Half the squared unbalanced wrench of given contact forces, with its gradient by the envelope theorem.

    E_fc = 1/2 |G f|^2

    With f = n this is half the paper's estimator |G n|^2 (Liu et al. 2021). With f the minimiser of the same energy
    over friction cones it is the value of a convex wrench program, and the gradient is exact although f is held
    (Danskin): forces keep their coordinates in the contact frame, so they turn with the normal, df = (n x dn) x f.

    Args:
        p_WCs: Contact points [m], shape (..., nc, 3).
        n_WCs: Unit contact normals into the object, shape (..., nc, 3).
        f_Ws: Forces on the object, in W [-], shape (..., nc, 3).
        p_WOcm: Center of mass [m], shape (3,).
        length: Length that divides torques [m].

    Returns:
        Value, shape (...), gradients with respect to `p_WCs` and `n_WCs`, shape (..., nc, 3).
    """
    residual = wrench(p_WCs, f_Ws, p_WOcm, length)
    torque, force = residual[..., None, :3] / length, residual[..., None, 3:]
    torque = torque + 0.0 * p_WCs  # (..., nc, 3)
    on_force = force + cross(torque, p_WCs - p_WOcm)
    value = 0.5 * (residual * residual).sum(-1)
    return value, cross(f_Ws, torque), cross(cross(f_Ws, on_force), n_WCs)


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


def alignment(a_Ws: Any, b_Ws: Any, least: float, weights: Any) -> tuple[Any, Any, Any]:
    """How far pairs of unit vectors fall short of a least cosine: keeps contacts on the pads of the fingers.

    E = sum_i w_i max(0, least - a_i . b_i)

    Args:
        a_Ws: Unit vectors, shape (..., m, 3).
        b_Ws: Unit vectors, shape (..., m, 3).
        least: Cosine that is enough.
        weights: Weight of each pair, shape (..., m).

    Returns:
        Value, shape (...), gradients with respect to `a_Ws` and `b_Ws`, shape (..., m, 3).
    """
    short = (least - (a_Ws * b_Ws).sum(-1)).clip(min=0.0)
    active = (weights * (short > 0.0))[..., None]
    return (weights * short).sum(-1), -active * b_Ws, -active * a_Ws


def approach(a_Ws: Any, direction_W: Any, least: float) -> tuple[Any, Any]:
    """How far the palm's direction falls short of a wanted one.

    E = max(0, least - a . d)

    Args:
        a_Ws: Unit vector along which the palm approaches, shape (..., 3).
        direction_W: Unit vector along which it shall, shape (3,).
        least: Cosine that is enough.

    Returns:
        Value, shape (...), and gradient with respect to `a_Ws`, shape (..., 3).
    """
    short = (least - (a_Ws * direction_W).sum(-1)).clip(min=0.0)
    return short, -(1.0 * (short > 0.0))[..., None] * direction_W


def finger_spread(p_WPs: Any, least: float, weights: Any) -> tuple[Any, Any]:
    """How far points, such as contacts or fingertips, are nearer to each other than wanted.

    E = sum over pairs of w_i w_j max(0, least - |p_i - p_j|)

    Args:
        p_WPs: Points [m], shape (..., m, 3).
        least: Distance that is enough [m].
        weights: 1 for points that count and 0 for others, shape (..., m).

    Returns:
        Value [m], shape (...), and gradient with respect to `p_WPs`, shape (..., m, 3).
    """
    between = p_WPs[..., :, None, :] - p_WPs[..., None, :, :]
    distance = ((between * between).sum(-1) + 1e-18) ** 0.5
    apart = (between * between).sum(-1) > 0.0  # no point counts against itself
    pairs = weights[..., :, None] * weights[..., None, :] * apart
    short = (least - distance).clip(min=0.0)
    pull = (pairs * (short > 0.0) / distance)[..., None] * between
    return 0.5 * (pairs * short).sum((-1, -2)), -pull.sum(-2)


def keypoints(p_WPs: Any, targets_W: Any, weights: Any) -> tuple[Any, Any]:
    """Squared distances of keypoints from their targets: the first sum of Eq. (2), and of Eq. (6).

    E = sum_i w_i |p_i - target_i|^2

    Args:
        p_WPs: Keypoints [m], shape (..., m, 3).
        targets_W: Their targets [m], shape (..., m, 3).
        weights: Weight of each, shape (m,).

    Returns:
        Value [m^2], shape (...), and gradient with respect to `p_WPs`, shape (..., m, 3).
    """
    error = p_WPs - targets_W
    weighted = weights[..., None] * error
    return (weighted * error).sum((-1, -2)), 2.0 * weighted
