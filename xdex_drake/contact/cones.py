"""Contact frames, grasp matrix and friction cones.

A contact frame C has its z axis along the contact normal, which points into the object; a contact force
f_C = (t1, t2, n) lies in the friction cone where |(t1, t2)| <= mu n. Forces of several contacts are stacked contact
after contact: f = (f_C1, f_C2, ...), shape (3 n,). Wrenches are torque first, about the object's center of mass.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xdex_drake.arrays import Array, skew
from xdex_drake.errors import ConfigError

# A fixed rotation with exact entries. Any smooth choice of tangents fails for at least one normal; the one it fails for
# here is -_R_WA[:, 2] = (-0.36, -0.48, -0.8), which no face of a box on a table has.
_R_WA = np.array([[0.8, 0.48, 0.36], [-0.6, 0.64, 0.48], [0.0, -0.6, 0.8]])


def contact_frames(n_WCs: ArrayLike) -> Array:
    """Orthonormal frames whose z axes are the given normals.

    The frame is that of the least rotation from a fixed axis to the normal, written so that it keeps full precision
    (Frisvad 2012, with 1 + z replaced by (x^2 + y^2) / (1 - z) where z < 0). It is smooth in the normal but at the one
    normal (-0.36, -0.48, -0.8), where it is still orthonormal.

    Args:
        n_WCs: Normals in W, of any nonzero length, shape (..., 3).

    Returns:
        R_WCs, shape (..., 3, 3).

    Raises:
        ConfigError: A normal has zero length or is not finite.
    """
    n = np.asarray(n_WCs, dtype=float)
    if n.shape[-1:] != (3,):
        raise ConfigError(f"n_WCs: shape {n.shape} does not end in 3; give normals of shape (n, 3)")
    norm = np.sqrt((n * n).sum(axis=-1, keepdims=True))
    if not np.all((norm > 0.0) & np.isfinite(norm)):
        raise ConfigError("n_WCs: a normal has zero length or is not finite; drop contacts without a normal")
    x, y, z = np.moveaxis((n / norm) @ _R_WA, -1, 0)
    radius = x * x + y * y
    # 1 / (1 + z), free of cancellation for z near -1; at z = -1 exactly the tangents of z = -1 + 0 along y are taken.
    pole = radius < 1e-300
    inverse = np.where(z > 0.0, 1.0 / (1.0 + np.abs(z)), (1.0 - z) / np.where(pole, 1.0, radius))
    xx = np.where(pole & (z < 0.0), 0.0, x * x * inverse)
    yy = np.where(pole & (z < 0.0), 2.0, y * y * inverse)
    xy = np.where(pole, 0.0, x * y * inverse)
    R_AC = np.empty((*n.shape[:-1], 3, 3))
    R_AC[..., 0, 0], R_AC[..., 0, 1], R_AC[..., 0, 2] = 1.0 - xx, -xy, x
    R_AC[..., 1, 0], R_AC[..., 1, 1], R_AC[..., 1, 2] = -xy, 1.0 - yy, y
    R_AC[..., 2, 0], R_AC[..., 2, 1], R_AC[..., 2, 2] = -x, -y, z
    return _R_WA @ R_AC


def grasp_matrix(p_WCs: ArrayLike, R_WCs: ArrayLike, p_WOcm: ArrayLike) -> Array:
    """Grasp matrix: the wrench on the object about its center of mass is F_Ocm_W = G f.

    G = [ [p_OcmC1]x R_WC1, ... ; R_WC1, ... ], torque first.

    Args:
        p_WCs: Contact points [m], shape (..., n, 3).
        R_WCs: Contact frames, shape (..., n, 3, 3).
        p_WOcm: Center of mass [m], shape (3,) or (..., 3).

    Returns:
        G, shape (..., 6, 3 n): rows 0..2 torque [m], rows 3..5 force [-].

    Raises:
        ConfigError: The shapes do not match.
    """
    p, R, c = (np.asarray(a, dtype=float) for a in (p_WCs, R_WCs, p_WOcm))
    if p.ndim < 2 or p.shape[-1] != 3 or R.shape != (*p.shape, 3) or c.shape[-1:] != (3,):
        raise ConfigError(
            f"grasp_matrix: shapes {p.shape}, {R.shape}, {c.shape} do not match; give (..., n, 3), (..., n, 3, 3), (3,)"
        )
    blocks = np.concatenate([skew(p - c[..., None, :]) @ R, R], axis=-2)  # (..., n, 6, 3)
    G = np.moveaxis(blocks, -3, -2)  # (..., 6, n, 3)
    return np.ascontiguousarray(G).reshape(*p.shape[:-2], 6, 3 * p.shape[-2])


def cone_violation(f: ArrayLike, mu: ArrayLike) -> Array:
    """How far forces lie outside their friction cones: max(0, |f_t| - mu f_n, -f_n).

    Args:
        f: Forces in contact frames [N], shape (..., 3).
        mu: Coefficients of friction, broadcast against f's leading shape.

    Returns:
        Violation [N], shape (...).
    """
    f = np.asarray(f, dtype=float)
    tangent = np.hypot(f[..., 0], f[..., 1])
    normal = f[..., 2]
    return np.maximum(0.0, np.maximum(tangent - np.asarray(mu, dtype=float) * normal, -normal))


def in_cone(f: ArrayLike, mu: ArrayLike, tolerance: float = 1e-9) -> NDArray[np.bool_]:
    """Whether forces lie in their friction cones, |f_t| <= mu f_n.

    Args:
        f: Forces in contact frames [N], shape (..., 3).
        mu: Coefficients of friction, broadcast against f's leading shape.
        tolerance: Violation that still counts as inside [N].

    Returns:
        Booleans, shape (...).
    """
    return cone_violation(f, mu) <= tolerance


def cone_edges(mu: ArrayLike, k: int) -> Array:
    """Edges of the pyramids with k sides that are inscribed in the friction cones; unit normal component.

    Args:
        mu: Coefficients of friction, shape (...).
        k: Number of edges, at least 3.

    Returns:
        Edges in contact frames (mu cos, mu sin, 1), as columns, shape (..., 3, k).

    Raises:
        ConfigError: k is below 3.
    """
    if k < 3:
        raise ConfigError(f"k: a pyramid of {k} edges has no interior; give at least 3")
    mu = np.asarray(mu, dtype=float)
    angle = 2.0 * np.pi * np.arange(k) / k
    edges = np.empty((*mu.shape, 3, k))
    edges[..., 0, :] = mu[..., None] * np.cos(angle)
    edges[..., 1, :] = mu[..., None] * np.sin(angle)
    edges[..., 2, :] = 1.0
    return edges


def effort_map(J_WCs: ArrayLike, R_WCs: ArrayLike) -> Array:
    """A = J^T: torques that the actuated joints must apply for given contact forces on the object, tau = A f.

    Args:
        J_WCs: Jacobians of the contact points, fixed in their links, with respect to the actuated joints, couplings
            followed, expressed in W, shape (n, 3, n_act).
        R_WCs: Contact frames, shape (n, 3, 3).

    Returns:
        A, shape (n_act, 3 n) [m]; f is stacked in contact frames.
    """
    J, R = np.asarray(J_WCs, dtype=float), np.asarray(R_WCs, dtype=float)
    return (np.swapaxes(R, -1, -2) @ J).reshape(-1, J.shape[-1]).T
