"""The link pose vector: nine numbers that say where a link is, in terms that do not depend on a vendor's link axes.

They are the origin p_WL and the first two columns of R_WL R_HL(0)^T: how far the link has turned, with the wrist, since
the zero configuration. How a vendor turned the axes of L drops out, as R_WL and R_HL(0) both end with it. NumPy alone.
"""

import numpy as np

from xdex_drake.arrays import Array


def rotations_since_zero(R_WLs: Array, R_HLs_zero: Array) -> Array:
    """How links have turned since the zero configuration: R_WL R_HL(0)^T.

    Args:
        R_WLs: Rotations of the links in W, shape (..., L, 3, 3).
        R_HLs_zero: Rotations of the links in H at the zero configuration, shape (L, 3, 3).

    Returns:
        Rotations, shape (..., L, 3, 3).
    """
    return R_WLs @ np.swapaxes(R_HLs_zero, -1, -2)


def link_pose_vectors(R_WLs: Array, p_WLs: Array, R_HLs_zero: Array) -> Array:
    """Link pose vectors: origin of L, then the first two columns of R_WL R_HL(0)^T.

    Args:
        R_WLs: Rotations of the links in W, shape (..., L, 3, 3).
        p_WLs: Origins of the links in W [m], shape (..., L, 3).
        R_HLs_zero: Rotations of the links in H at the zero configuration, shape (L, 3, 3).

    Returns:
        Vectors, shape (..., L, 9).
    """
    R = rotations_since_zero(R_WLs, R_HLs_zero)
    return np.concatenate([p_WLs, R[..., 0], R[..., 1]], axis=-1)


def link_poses_from_vectors(vectors: Array, R_HLs_zero: Array) -> tuple[Array, Array]:
    """Inverse of `link_pose_vectors`; the two columns are made orthonormal by Gram-Schmidt first.

    Args:
        vectors: Link pose vectors, shape (..., L, 9).
        R_HLs_zero: Rotations of the links in H at the zero configuration, shape (L, 3, 3).

    Returns:
        Rotations R_WL, shape (..., L, 3, 3), and origins p_WL [m], shape (..., L, 3).
    """
    x = vectors[..., 3:6] / np.linalg.norm(vectors[..., 3:6], axis=-1, keepdims=True)
    y = vectors[..., 6:9] - np.sum(vectors[..., 6:9] * x, axis=-1, keepdims=True) * x
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    R = np.stack([x, y, np.cross(x, y)], axis=-1)
    return R @ R_HLs_zero, vectors[..., :3].copy()
