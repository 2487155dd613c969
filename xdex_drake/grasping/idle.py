"""Brings fingers without contact near the object, where a hand that takes hold has them.

A search moves only the fingers that shall touch; the others stay as they happened to be, often stretched out. After the
certificate they are closed toward the object by a small program of their own. Only joints that move no touching finger
take part, so that contacts, forces and certificate stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.grasping.pregrasp import NO_CONTACTS
from xdex_drake.hand.description import Finger, Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs import constraints
from xdex_drake.programs.point import Point
from xdex_drake.programs.program import GraspProgram, LeastSquares
from xdex_drake.programs.sequential import solve_sequential
from xdex_drake.programs.spheres import sphere_pairs
from xdex_drake.scene.tabletop import Scene

REST_GAP = 6e-3
"""Gap between an idle fingertip and the object at which it rests [m]."""

CLEARANCE = 4e-3
"""Least gap of idle links from the object [m]: more than what a squeeze moves it by."""

COMFORT = 0.5
"""Turn of a joint that costs as much as `COMFORT_GAP` of a fingertip's gap [rad]."""

COMFORT_GAP = 0.015
"""See `COMFORT` [m]."""


def idle_fingers(hand: Hand, links: Iterable[str]) -> list[Finger]:
    """Fingers that do not touch.

    Args:
        hand: The hand.
        links: Names of the links in contact.

    Returns:
        The fingers none of whose links is in contact.
    """
    touching = set(links)
    return [finger for finger in hand.fingers if not touching & set(finger.links)]


def idle_joints(hand: Hand, links: Iterable[str]) -> NDArray[np.bool_]:
    """Actuated joints that move idle fingers and nothing else that counts.

    Args:
        hand: The hand.
        links: Names of the links in contact.

    Returns:
        True for each actuated joint that moves an idle finger, but no link of a touching one and no link in contact,
        shape (n,).
    """
    touching, idle = set(links), idle_fingers(hand, links)
    moves = (hand.coupling_matrix.T != 0.0).astype(int) @ hand.ancestors > 0  # (n, n_links)
    busy = touching.union(*(finger.links for finger in hand.fingers if finger not in idle))
    at = hand.link_index
    return moves[:, [at[finger.tip_link] for finger in idle]].any(1) & ~moves[:, [at[name] for name in busy]].any(1)


def rest_idle_fingers(hand: Hand, scene: Scene, k: Configuration, links: Iterable[str]) -> Configuration:
    """Closes idle fingers until their tips rest near the object, or as far as limits and neighbours let them.

    Args:
        hand: The hand.
        scene: The scene.
        k: A grasp's configuration.
        links: Names of the links in contact.

    Returns:
        The configuration with other values of the idle joints alone: clear of object, table and hand where they move;
        `k` itself where there is nothing to gain.
    """
    names = list(links)
    joints = idle_joints(hand, names)
    if not joints.any():
        return k
    program = _program(hand, scene, k, joints, idle_fingers(hand, names))
    point, _ = solve_sequential(program, iterations=12, trust=0.4, improvement=0.05)
    for share in (1.0, 0.5, 0.25):
        q = np.where(joints, np.clip(k.q + share * (point.k.q - k.q), *hand.limits), k.q)
        rested = Configuration.at(hand, k.X_WH, q)
        trial = Point(rested, scene, NO_CONTACTS, np.zeros((0, 3)))
        if all(block.violation(trial) <= constraints.TOLERANCES[block.unit] for block in program.constraints):
            return rested
    return k


def _program(hand: Hand, scene: Scene, k: Configuration, joints: NDArray[np.bool_], idle: list[Finger]) -> GraspProgram:
    """Fingertips to their gaps, joints near where they are; nothing else moves."""
    start = Point(k, scene, NO_CONTACTS, np.zeros((0, 3)))
    columns = np.concatenate([np.zeros(6, dtype=bool), joints])
    moves = (hand.coupling_matrix.T[joints] != 0.0).astype(int) @ hand.ancestors > 0
    moved = np.flatnonzero(moves.any(0)[hand.sphere_links])
    # Spheres that are nearer already need not go away.
    near, gaps, _ = start.object_distances
    known = np.full(len(hand.spheres), np.inf)
    known[near] = gaps
    heights = start.heights[moved]
    low = moved if scene.table is not None else moved[:0]
    pairs = sphere_pairs(hand)
    blocks = (
        constraints.object_block(moved, np.minimum(CLEARANCE, known[moved])),
        constraints.table_block(low, min(2e-3, float(heights.min(initial=np.inf)))),
        *constraints.obstacle_blocks(start, 0.0, spheres=moved),
        constraints.self_block(pairs[np.isin(pairs, moved).any(1)], 1e-3),
    )
    costs = (
        LeastSquares("idle fingertips", 1.0, _tip_gaps(hand, scene, idle, columns), "gap of each idle fingertip"),
        LeastSquares("idle joints", 1.0, _turns(k.q, joints, columns), "turn of each idle joint"),
    )
    only = tuple(replace(block, evaluate=_only(columns, block.evaluate)) for block in blocks)
    return GraspProgram("idle fingers", start, costs, (*only, constraints.limit_block(hand.limits)))


Rows = Callable[[Point], tuple[Array, Array]]


def _only(columns: NDArray[np.bool_], rows: Rows) -> Rows:
    """Rows whose derivatives with respect to all else are left out, so that a solver leaves it where it is."""

    def evaluate(point: Point) -> tuple[Array, Array]:
        g, J = rows(point)
        return g, J * columns

    return evaluate


def _tip_gaps(hand: Hand, scene: Scene, idle: list[Finger], columns: NDArray[np.bool_]) -> Rows:
    """Gaps of fingertips from the object less `REST_GAP`, in units of `COMFORT_GAP`; by the grid, which sees far."""
    links = np.array([hand.link_index[finger.tip_link] for finger in idle])
    p_LTips = np.array([finger.p_LTip for finger in idle])
    R_WO, p_WO = scene.X_WO.rotation().matrix(), scene.X_WO.translation()

    def evaluate(point: Point) -> tuple[Array, Array]:
        tips = point.k.points(links, p_LTips)
        distance, gradient = scene.object.grid.interpolate((tips - p_WO) @ R_WO)
        J = point.k.pull_back_each(links, tips, gradient @ R_WO.T)
        return (distance - REST_GAP) / COMFORT_GAP, J * columns / COMFORT_GAP

    return evaluate


def _turns(q: Array, joints: NDArray[np.bool_], columns: NDArray[np.bool_]) -> Rows:
    """Turns of the idle joints in units of `COMFORT`."""
    J = np.diag(columns / COMFORT)[6:][joints]
    return lambda point: ((point.k.q - q)[joints] / COMFORT, J)
