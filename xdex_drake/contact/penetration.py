"""Penetration of a hand and points of an object's surface."""

import numpy as np
from numpy.typing import ArrayLike

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Hand


def hand_depths(hand: Hand, R_WLs: ArrayLike, p_WLs: ArrayLike, points_W: ArrayLike, *, reach: float = 0.0) -> Array:
    """How deep each point is inside the hand's collision geometry.

    Where geometries overlap, the depth is the greatest of theirs (a lower bound of the depth in their union).

    Args:
        hand: The hand.
        R_WLs: Rotations of the links in W, in the order of `hand.links`, shape (n_links, 3, 3).
        p_WLs: Origins of the links in W [m], shape (n_links, 3).
        points_W: Points in W [m], shape (m, 3).
        reach: Distance by which the geometry is enlarged first [m].

    Returns:
        Depths [m], zero outside, shape (m,).

    Raises:
        ConfigError: The shapes do not match the hand.
        HandFileError: The vertices of a convex geometry do not span a volume.
    """
    R, p = np.asarray(R_WLs, dtype=float), np.asarray(p_WLs, dtype=float)
    points = np.asarray(points_W, dtype=float)
    n = len(hand.links)
    if R.shape != (n, 3, 3) or p.shape != (n, 3) or points.ndim != 2 or points.shape[1] != 3:
        raise ConfigError(
            f"R_WLs, p_WLs, points_W: shapes {R.shape}, {p.shape}, {points.shape} are not ({n}, 3, 3), ({n}, 3), (m, 3)"
        )
    depths = np.zeros(len(points))
    shapes = [
        (k, geometry, *geometry.bounding_sphere()) for k, link in enumerate(hand.links) for geometry in link.geometry
    ]
    if not shapes or not len(points):
        return depths
    # Most points are far from most geometries: look only at those within a bounding sphere.
    links = np.array([k for k, *_ in shapes])
    centers = p[links] + (R[links] @ np.array([center for _, _, center, _ in shapes])[:, :, None])[..., 0]
    radii = np.array([radius for *_, radius in shapes])
    middle = points.mean(axis=0)
    x, c = points - middle, centers - middle
    squared = (x * x).sum(axis=1) - 2.0 * c @ x.T + (c * c).sum(axis=1)[:, None]  # (n_shapes, m)
    near = squared < ((radii + reach) ** 2)[:, None]
    for row in np.flatnonzero(near.any(axis=1)):
        k, geometry = shapes[row][:2]
        index = np.flatnonzero(near[row])
        depth = reach - geometry.signed_distance((points[index] - p[k]) @ R[k])
        depths[index] = np.maximum(depths[index], depth)
    return depths


def penetration_depth(hand: Hand, R_WLs: ArrayLike, p_WLs: ArrayLike, points_W: ArrayLike) -> float:
    """The greatest depth of some points inside the hand's collision geometry (`hand_depths`).

    Args:
        hand: The hand.
        R_WLs: Rotations of the links in W, in the order of `hand.links`, shape (n_links, 3, 3).
        p_WLs: Origins of the links in W [m], shape (n_links, 3).
        points_W: Points of the object's surface in W [m], shape (m, 3).

    Returns:
        Depth [m], 0 where no point is inside.

    Raises:
        ConfigError: The shapes do not match the hand.
        HandFileError: The vertices of a convex geometry do not span a volume.
    """
    return float(hand_depths(hand, R_WLs, p_WLs, points_W).max(initial=0.0))
