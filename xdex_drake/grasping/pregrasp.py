"""Pre-grasp: the open hand before a grasp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs import constraints
from xdex_drake.programs.force_closure import near_self_pairs, posture_cost
from xdex_drake.programs.point import ContactSet, Point
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.sequential import solve_sequential
from xdex_drake.scene.tabletop import Scene

CLEARANCE = 5e-3
"""Gap that a pre-grasp keeps from the object, everywhere [m]."""


NO_CONTACTS = ContactSet(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64))


@dataclass(frozen=True)
class Pregrasp:
    """A configuration before the grasp.

    Attributes:
        X_WH: Wrist pose; its rotation is the grasp's.
        q: Joint values, shape (n,).
        clearance: Least gap between a sphere of the hand and the object [m].
    """

    X_WH: RigidTransform
    q: Array
    clearance: float


def pregrasp_program(hand: Hand, scene: Scene, X_WH: RigidTransform, q: Array, clearance: float) -> GraspProgram:
    """The nearest configuration that clears the object everywhere: joints open first, the wrist moves back if it must.

    Args:
        hand: The hand.
        scene: The scene.
        X_WH: Wrist pose of the grasp.
        q: Joint values of the grasp, shape (n,).
        clearance: Gap to keep from the object [m].

    Returns:
        The program.
    """
    start = Point(Configuration.at(hand, X_WH, q), scene, NO_CONTACTS, np.zeros((0, 3)))
    near, gaps, _ = start.object_distances
    blocks = (
        constraints.object_block(near[gaps < 0.04], np.full(int((gaps < 0.04).sum()), clearance)),
        constraints.table_block(np.flatnonzero(start.heights < 0.05), 2e-3),
        *constraints.obstacle_blocks(start, 2e-3),
        constraints.self_block(near_self_pairs(hand, start.k), 1e-3),
        constraints.limit_block(hand.limits),
    )
    # The carriage of a lift does not turn, so the wrist's rotation is all but fixed.
    cost = posture_cost(start, 1.0, rotation=1e-3, translation=0.005, joint=0.3)
    return GraspProgram("pre-grasp", start, (cost,), blocks)


def pregrasp(hand: Hand, scene: Scene, X_WH: RigidTransform, q: Array, *, clearance: float = CLEARANCE) -> Pregrasp:
    """Opens the hand until it clears the object.

    Args:
        hand: The hand.
        scene: The scene.
        X_WH: Wrist pose of the grasp.
        q: Joint values of the grasp, shape (n,).
        clearance: Gap to reach [m].

    Returns:
        The pre-grasp with the clearance that was reached, which may be less than asked for.
    """
    # A little more than asked for: the solver stops at its own tolerance.
    program = pregrasp_program(hand, scene, X_WH, q, clearance + 5e-4)
    point, _ = solve_sequential(program, iterations=12, trust=0.3, improvement=np.inf)
    q_open = np.clip(point.k.q, hand.limits[0], hand.limits[1])
    X_open = RigidTransform(X_WH.rotation(), point.k.X_WH.translation())
    end = Point(Configuration.at(hand, X_open, q_open), scene, NO_CONTACTS, np.zeros((0, 3)))
    return Pregrasp(X_open, q_open, float(np.min(end.object_distances[1], initial=np.inf)))
