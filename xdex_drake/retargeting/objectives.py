"""The objectives of dex-retargeting 0.5 (Qin et al. 2023), by which key points of two hands are compared.

Each is a weighted sum of smooth absolute values of vectors between key points, in the wrist frame H:

    position: fingertips (and middles) of both hands, coordinate by coordinate;
    vector: the same points as vectors from the wrist, by their length;
    dexpilot: vectors between fingertips and from the wrist to them; where a person's thumb and finger come close, the
        target becomes a pinch (Handa et al. 2020, with the switching of dex-retargeting).

Smooth L1 of x: x^2 / (2 beta) below beta, |x| - beta / 2 above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Finger, Hand
from xdex_drake.hand.kinematics import zero_configuration
from xdex_drake.retargeting.keypoints import MIDDLES, TIPS

OBJECTIVES = ("position", "vector", "dexpilot")

BETA = {"position": 0.02, "vector": 0.02, "dexpilot": 0.03}
"""Where smooth L1 becomes linear [m]."""

PINCH_BELOW, PINCH_UNTIL = 0.03, 0.05
"""A pair of thumb and finger pinches once the person's tips are closer than the first, until they are farther apart
than the second [m]."""

NEIGHBOURS_BELOW = 0.03
"""Two fingers that both pinch are drawn together where the person's are not farther apart than this [m]."""

PINCH_GAP, NEIGHBOURS_GAP = 1e-4, 0.03
"""Lengths of the target vectors of thumb and finger, and of two fingers, that pinch [m]."""

PINCH_WEIGHT, NEIGHBOURS_WEIGHT = 200.0, 400.0


@dataclass(frozen=True)
class Objective:
    """Which vectors of a hand follow which vectors of a person, and how their differences count.

    Attributes:
        name: One of `OBJECTIVES`.
        links: Link of each point of the hand, shape (m,).
        p_LPs: The points in their links' frames [m], shape (m, 3).
        combine: Vectors from points: +1 for the end, -1 for the origin, which is the wrist where none stands, shape
            (K, m); None where vectors are points.
        human: Key points of a person: origin and end of each vector, shape (K, 2).
        pairs: How many of the vectors, the first ones, lie between fingertips; and how many of those have the thumb's.
        beta: Where smooth L1 becomes linear [m].
    """

    name: str
    links: NDArray[np.int64]
    p_LPs: Array
    combine: Array | None
    human: NDArray[np.int64]
    pairs: tuple[int, int]
    beta: float

    @property
    def by_coordinate(self) -> bool:
        """Whether coordinates count one by one instead of lengths."""
        return self.name == "position"


@dataclass(frozen=True)
class Targets:
    """What the hand's vectors should be.

    Attributes:
        vectors: Target vectors in H [m], shape (B, K, 3).
        weights: Weight of each, shape (B, K).
    """

    vectors: Array
    weights: Array

    def rows(self, chosen: NDArray[np.bool_]) -> Targets:
        """Those of some frames."""
        return Targets(self.vectors[chosen], self.weights[chosen])


def make_objective(hand: Hand, name: str, *, middles: bool) -> Objective:
    """The objective of a hand.

    Args:
        hand: The hand; its fingers are found by their names.
        name: One of `OBJECTIVES`.
        middles: Whether the middle joints of the fingers follow, too; not for dexpilot.

    Returns:
        The objective.
    """
    fingers = [finger for finger in hand.fingers if finger.name in TIPS]
    fingers.sort(key=lambda finger: TIPS[finger.name])
    marks = [(hand.link_index[finger.tip_link], finger.p_LTip, TIPS[finger.name]) for finger in fingers]
    if middles:
        marks += [(_middle_link(hand, finger), np.zeros(3), MIDDLES[finger.name]) for finger in fingers]
    links, p_LPs = np.array([mark[0] for mark in marks]), np.array([mark[1] for mark in marks], dtype=float)
    human = np.array([(0, mark[2]) for mark in marks])
    if name != "dexpilot":
        return Objective(name, links, p_LPs, None, human, (0, 0), BETA[name])
    count = len(fingers)
    pairs = [(j, i) for i in range(count) for j in range(i + 1, count)]
    combine = np.concatenate([np.zeros((len(pairs), count)), np.eye(count)])
    for row, (origin, end) in enumerate(pairs):
        combine[row, origin], combine[row, end] = -1.0, 1.0
    between = np.array([(human[origin, 1], human[end, 1]) for origin, end in pairs]).reshape(-1, 2)
    thumbs = count - 1 if fingers[0].name == "thumb" else 0
    return Objective(name, links, p_LPs, combine, np.concatenate([between, human]), (len(pairs), thumbs), BETA[name])


def _middle_link(hand: Hand, finger: Finger) -> int:
    """Link at whose origin a finger's middle joint is: its last but one, or its last where only that one travels."""
    if len(finger.links) < 2:
        return hand.link_index[finger.tip_link]
    link = hand.link_index[finger.links[-2]]
    # An origin travels where a joint above its own does not have it on its axis.
    R_HLs, p_HLs = zero_configuration(hand)
    for joint in np.flatnonzero(hand.ancestors[:, link])[:-1]:
        axis = R_HLs[joint + 1] @ hand.joints[joint].axis
        arm = p_HLs[link] - p_HLs[joint + 1]
        if hand.prismatic[joint] or np.linalg.norm(np.cross(axis, arm)) > 5e-3:
            return link
    return hand.link_index[finger.links[-1]]


def start_pinches(objective: Objective, count: int) -> NDArray[np.bool_]:
    """No pair pinches, shape (count, number of pairs)."""
    return np.zeros((count, objective.pairs[0]), dtype=bool)


def make_targets(
    objective: Objective, p_HPs: Array, scale: float, pinches: NDArray[np.bool_]
) -> tuple[Targets, NDArray[np.bool_]]:
    """Targets from a person's key points.

    Args:
        objective: The objective.
        p_HPs: Key points in the wrist frame [m], shape (B, 21, 3).
        scale: Size of the hand over that of the person's; published for vector and dexpilot, 1 for position.
        pinches: Which pairs pinched in the frame before, shape (B, number of pairs); unused but by dexpilot.

    Returns:
        The targets, and which pairs pinch now.
    """
    vectors = p_HPs[:, objective.human[:, 1]] - p_HPs[:, objective.human[:, 0]]
    K = vectors.shape[1]
    if objective.name != "dexpilot":
        return Targets(scale * vectors, np.full((len(vectors), K), 1.0 / K)), pinches
    pairs, thumbs = objective.pairs
    fingers = K - pairs
    lengths = np.linalg.norm(vectors[:, :pairs], axis=-1)
    now = _switch(pinches, lengths, thumbs)
    gap = np.where(np.arange(pairs) < thumbs, PINCH_GAP, NEIGHBOURS_GAP)
    pinched = vectors[:, :pairs] / (lengths[..., None] + 1e-6) * gap[:, None]
    targets = scale * vectors
    targets[:, :pairs] = np.where(now[..., None], pinched, targets[:, :pairs])
    heavy = np.where(np.arange(pairs) < thumbs, PINCH_WEIGHT, NEIGHBOURS_WEIGHT)
    weights = np.full((len(vectors), K), float(pairs + fingers))
    weights[:, :pairs] = np.where(now, heavy, 1.0)
    return Targets(targets, weights / K), now


def _switch(before: NDArray[np.bool_], lengths: Array, thumbs: int) -> NDArray[np.bool_]:
    """Which pairs pinch: thumb and finger with hysteresis, two fingers where both of them pinch and are close."""
    near = (before[:, :thumbs] | (lengths[:, :thumbs] < PINCH_BELOW)) & (lengths[:, :thumbs] <= PINCH_UNTIL)
    now = np.zeros_like(before)
    now[:, :thumbs] = near
    first, second = np.triu_indices(thumbs, 1)
    if thumbs:
        now[:, thumbs:] = near[:, first] & near[:, second] & (lengths[:, thumbs:] <= NEIGHBOURS_BELOW)
    return now
