"""How alike grasps are across hands, and how different those of one object: over many grasps, by arrays.

Grasps compare through keypoints, the fingertips by name and the wrist, and two hands by the names that they share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.evaluation.metrics import fingertips
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.scene.tabletop import Scene

APART_CM = 2.0
"""Least position difference, in the object's frame, of grasps that count as distinct [cm]."""

REACH_M = 0.01
"""Distance from a contact within which the surface counts as covered [m]."""


@dataclass(frozen=True)
class Keypoints:
    """Fingertips and wrists of grasps; NaN where a hand lacks the finger.

    Attributes:
        fingers: Names of the fingers of all hands.
        tips: Fingertips in W [m], shape (n, number of fingers, 3).
        tips_H: The same in the wrist frame of each grasp.
        wrists: Origins of the wrist frames in W [m], shape (n, 3).
    """

    fingers: tuple[str, ...]
    tips: Array
    tips_H: Array
    wrists: Array


@dataclass(frozen=True)
class Consistency:
    """Mean differences over pairs of grasps by different hands.

    Attributes:
        pairs: Number of pairs.
        position_cm: Mean distance of corresponding fingertips and of the wrists in W [cm].
        vector_cm: Mean distance of corresponding fingertips, each in its wrist frame, over pairs that share a finger
            [cm].
    """

    pairs: int
    position_cm: float
    vector_cm: float


@dataclass(frozen=True)
class Diversity:
    """How many different ways an object is lifted.

    Attributes:
        lifted: Lifted grasps.
        distinct: Those of them that are distinct; see `distinct_grasps`.
        coverage: Share of the object's surface within `REACH_M` of a contact of a lifted grasp.
    """

    lifted: int
    distinct: int
    coverage: float


def keypoints(grasps: Sequence[tuple[Hand, Grasp]]) -> Keypoints:
    """Fingertips and wrists of grasps.

    Args:
        grasps: Each grasp with its hand.

    Returns:
        The keypoints.
    """
    names = tuple(sorted({finger.name for hand, _ in grasps for finger in hand.fingers}))
    tips = np.full((len(grasps), len(names), 3), np.nan)
    tips_H, wrists = tips.copy(), np.empty((len(grasps), 3))
    for k, (hand, grasp) in enumerate(grasps):
        X_HW = grasp.X_WH.inverse()
        wrists[k] = grasp.X_WH.translation()
        for name, p_WTip in fingertips(hand, grasp).items():
            tips[k, names.index(name)], tips_H[k, names.index(name)] = p_WTip, X_HW @ p_WTip
    return Keypoints(names, tips, tips_H, wrists)


def differences(points: Keypoints, pairs: Array) -> tuple[Array, Array]:
    """Position and vector difference of pairs of grasps.

    Args:
        points: Keypoints of the grasps.
        pairs: Numbers of the two grasps of each pair, shape (m, 2).

    Returns:
        Position differences and vector differences [cm], shape (m,) each; a vector difference is NaN where the hands
        share no finger.
    """
    a, b = np.asarray(pairs, dtype=int).reshape(-1, 2).T
    tips = np.linalg.norm(points.tips[a] - points.tips[b], axis=2)
    wrists = np.linalg.norm(points.wrists[a] - points.wrists[b], axis=1)
    turned = np.linalg.norm(points.tips_H[a] - points.tips_H[b], axis=2)
    shared = np.isfinite(tips).sum(axis=1)
    position = (np.nansum(tips, axis=1) + wrists) / (shared + 1)
    vector = np.where(shared > 0, np.nansum(turned, axis=1) / np.maximum(shared, 1), np.nan)
    return 100.0 * position, 100.0 * vector


def matched_pairs(grasps: Sequence[Grasp]) -> Array:
    """Pairs of versions of one grasp by different hands: a source and what came from it, or two that came from it.

    Args:
        grasps: Grasps.

    Returns:
        Numbers of the two grasps of each pair, shape (m, 2).
    """
    return _pairs(grasps, [grasp.source_grasp_id or grasp.grasp_id for grasp in grasps])


def all_pairs(grasps: Sequence[Grasp], scenes: Sequence[str]) -> Array:
    """All pairs of grasps of one scene by different hands, as the paper's tables count them.

    Args:
        grasps: Grasps.
        scenes: Name of the scene of each.

    Returns:
        Numbers of the two grasps of each pair, shape (m, 2).
    """
    return _pairs(grasps, scenes)


def _pairs(grasps: Sequence[Grasp], groups: Sequence[str]) -> Array:
    """Pairs of grasps of one group by different hands."""
    members: dict[str, list[int]] = {}
    for k, group in enumerate(groups):
        members.setdefault(group, []).append(k)
    pairs = [
        pair
        for some in members.values()
        for pair in combinations(some, 2)
        if grasps[pair[0]].hand != grasps[pair[1]].hand
    ]
    return np.array(pairs, dtype=int).reshape(-1, 2)


def consistency(points: Keypoints, pairs: Array) -> Consistency:
    """Mean differences over pairs of grasps.

    Args:
        points: Keypoints of the grasps.
        pairs: Numbers of the two grasps of each pair, shape (m, 2), by `matched_pairs` or `all_pairs`.

    Returns:
        The means; NaN where there is no pair.
    """
    if not len(pairs):
        return Consistency(0, float("nan"), float("nan"))
    position, vector = differences(points, pairs)
    known = vector[np.isfinite(vector)]
    return Consistency(len(pairs), float(position.mean()), float(known.mean()) if len(known) else float("nan"))


def distinct_grasps(points: Keypoints, *, apart_cm: float = APART_CM) -> list[int]:
    """Grasps of one scene that differ: each is at least some position difference away from those before it.

    A grasp counts where fingertips that correspond and the wrist are on average `apart_cm` or more from those of every
    grasp that counted before. So no two that count are near each other, and each that does not count is near one that
    does; another order may give another number, between one and two packings.

    Args:
        points: Keypoints of the grasps, in the order in which they are taken.
        apart_cm: Least position difference [cm].

    Returns:
        Numbers of the grasps that count, ascending.
    """
    kept: list[int] = []
    for k in range(len(points.wrists)):
        pairs = np.array([(k, other) for other in kept], dtype=int).reshape(-1, 2)
        if not kept or differences(points, pairs)[0].min() >= apart_cm:
            kept.append(k)
    return kept


def coverage(grasps: Sequence[Grasp], scene: Scene, *, reach_m: float = REACH_M, samples: int = 2048) -> float:
    """Share of an object's surface that some contact reaches.

    Args:
        grasps: Certified grasps of the object.
        scene: A scene of the object.
        reach_m: Distance from a contact within which the surface counts as covered [m].
        samples: Points of the surface.

    Returns:
        The share, 0 without a contact.
    """
    contacts = [c.p_OC for grasp in grasps if grasp.certificate is not None for c in grasp.certificate.contacts]
    if not contacts:
        return 0.0
    points, _ = scene.object.surface_samples(samples)
    near = np.linalg.norm(points[:, None] - np.array(contacts)[None], axis=2).min(axis=1) <= reach_m
    return float(near.mean())


def diversity(grasps: Sequence[tuple[Hand, Grasp]], scene: Scene) -> Diversity:
    """How many different ways an object is lifted in one scene.

    Args:
        grasps: Grasps of the scene, each with its hand; those that did not lift are passed over.
        scene: The scene.

    Returns:
        Counts and coverage of the lifted ones.
    """
    lifted = [(hand, grasp) for hand, grasp in grasps if grasp.lift is not None and grasp.lift.success]
    if not lifted:
        return Diversity(0, 0, 0.0)
    kept = distinct_grasps(keypoints(lifted))
    return Diversity(len(lifted), len(kept), coverage([grasp for _, grasp in lifted], scene))
