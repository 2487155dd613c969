"""Which point of the object a grasp heads for: one rule for any hand, after DexGraspNet 2.0 (Zhang et al. 2024).

The heading runs from the center of the palm to the midpoint between the thumb's tip and the mean of the other tips; a
hand without a thumb, or with nothing else, uses the mean of its tips.
"""

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.shapes import Geometry

CONE = np.deg2rad(30.0)
"""Points farther from the heading than this angle are no candidates."""
DEPTH = 0.02
"""Candidates lie at most this far behind the nearest one along the heading [m]."""


def heading(hand: Hand, R_WLs: Array, p_WLs: Array) -> tuple[Array, Array]:
    """Center of the palm and direction of the heading.

    Args:
        hand: The hand.
        R_WLs: Rotations of the links in W, shape (L, 3, 3).
        p_WLs: Origins of the links in W [m], shape (L, 3).

    Returns:
        Center of the base link's geometry in W [m], shape (3,), and unit direction in W, shape (3,).
    """
    p_WPalm = R_WLs[0] @ _center(hand.links[0].geometry) + p_WLs[0]
    tips = {}
    for finger in hand.fingers:
        k = hand.link_index[finger.tip_link]
        tips[finger.name] = R_WLs[k] @ finger.p_LTip + p_WLs[k]
    others = [tip for name, tip in tips.items() if name != "thumb"]
    if "thumb" in tips and others:
        target = 0.5 * (tips["thumb"] + np.mean(others, axis=0))
    else:
        target = np.mean(list(tips.values()), axis=0)
    direction = target - p_WPalm
    return p_WPalm, direction / max(float(np.linalg.norm(direction)), 1e-9)


def object_point(hand: Hand, R_WLs: Array, p_WLs: Array, p_WPoints: Array) -> int:
    """The point of the object that a grasp heads for.

    Among the points ahead of the palm and within 30 degrees of the heading, those at most 2 cm behind the nearest one,
    x_min, are weighed by 2^(-angle / 10 deg) 2^(-(x - x_min) / 1.5 cm), x along the heading; the heaviest is taken.
    Where no point is that well ahead, the one at the least angle is taken.

    Args:
        hand: The hand.
        R_WLs: Rotations of the links in W, shape (L, 3, 3).
        p_WLs: Origins of the links in W [m], shape (L, 3).
        p_WPoints: Points of the object's surface in W [m], shape (N, 3).

    Returns:
        Index of the point in `p_WPoints`.
    """
    p_WPalm, direction = heading(hand, R_WLs, p_WLs)
    p_PalmPoints = p_WPoints - p_WPalm
    x = p_PalmPoints @ direction
    angle = np.arccos(np.clip(x / np.maximum(np.linalg.norm(p_PalmPoints, axis=1), 1e-9), -1.0, 1.0))
    ahead = (x > 0.0) & (angle < CONE)
    if not ahead.any():
        return int(np.argmin(angle))
    x_min = x[ahead].min()
    weight = np.exp2(-angle / np.deg2rad(10.0) - (x - x_min) / 0.015)
    return int(np.argmax(np.where(ahead & (x <= x_min + DEPTH), weight, -1.0)))


def _center(geometry: tuple[Geometry, ...]) -> Array:
    """Centroid of a link's geometry by volume, overlaps counted twice; the origin without any, shape (3,)."""
    if not geometry:
        return np.zeros(3)
    parts = [shape.volume() for shape in geometry]
    weights = np.maximum([part.volume for part in parts], 1e-12)
    return np.average(np.array([part.p_LCenter for part in parts]), axis=0, weights=weights)
