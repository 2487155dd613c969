"""A straight way of the open hand to its pre-grasp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.grasping.pregrasp import NO_CONTACTS
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.point import Point
from xdex_drake.scene.tabletop import Scene


@dataclass(frozen=True)
class Approach:
    """A straight way of the open hand to its pre-grasp.

    Attributes:
        direction_W: Unit vector from the pre-grasp to where the hand comes from, in W, shape (3,).
        clearance: Least gap between a sphere of the hand and the object on the way [m].
        height: Least height of a sphere of the hand above the table on the way [m].
    """

    direction_W: Array
    clearance: float
    height: float


def straight_approach(
    hand: Hand, scene: Scene, X_WH: RigidTransform, q: Array, *, length: float = 0.1, clearance: float = 2e-3
) -> Approach | None:
    """Finds a straight way to a pre-grasp, clear of object, table and obstacles.

    Tried are the directions against the palm's normal, against the fingers, up, and those half way between them. Gaps
    are taken from the object's grid of distances, in steps of 5 mm: two milliseconds where the first direction is
    clear.

    Args:
        hand: The hand.
        scene: The scene.
        X_WH: Wrist pose of the pre-grasp.
        q: Its joint values, shape (n,).
        length: Length of the way [m].
        clearance: Gap to keep from the object [m]; the table may be touched no deeper than at the pre-grasp itself.

    Returns:
        The first clear way, None where there is none among those tried.
    """
    R_WH = X_WH.rotation().matrix()
    away, back, up = -R_WH[:, 0], -R_WH[:, 2], np.array([0.0, 0.0, 1.0])
    start = Point(Configuration.at(hand, X_WH, q), scene, NO_CONTACTS, np.zeros((0, 3)))
    radii = hand.spheres[:, 3]
    p_OSs = (scene.X_WO.inverse() @ start.centers_W.T).T
    R_OW = scene.X_WO.rotation().matrix().T
    lowest = float(start.heights.min())
    floor = min(lowest, 0.0)
    grid, steps = scene.object.grid, np.linspace(0.0, length, max(2, round(length / 5e-3) + 1))
    for direction in (away, away + up, up, away + back, back + up, back, away + back + up):
        if (norm := float(np.linalg.norm(direction))) < 1e-3:
            continue
        unit = direction / norm
        height = lowest + min(0.0, length * float(unit[2]))
        if height < floor - 1e-9:
            continue
        centers = p_OSs[None] + steps[:, None, None] * (R_OW @ unit)
        gaps = grid.lower_bounds(centers.reshape(-1, 3)).reshape(len(steps), -1) - radii
        if (least := float(gaps.min())) >= clearance and _is_clear(scene, start.centers_W, radii, steps, unit):
            return Approach(unit, least, height)
    return None


def _is_clear(scene: Scene, centers_W: Array, radii: Array, steps: Array, unit: Array) -> bool:
    """Whether spheres that move along a direction stay out of all obstacles."""
    way = (centers_W[None] + steps[:, None, None] * unit).reshape(-1, 3)
    gaps = (fixture.lower_bounds(way).reshape(len(steps), -1) - radii for fixture in scene.obstacles)
    return all(float(gap.min()) >= 0.0 for gap in gaps)
