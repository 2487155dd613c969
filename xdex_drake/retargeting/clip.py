"""A clip of a person's hand without a camera: our human hand reaches for a thing, grasps it and lifts it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.human import MEAN_SHAPE, HumanShape, human_hand
from xdex_drake.hand.kinematics import rotation_about
from xdex_drake.hand.mirror import mirror
from xdex_drake.retargeting.keypoints import human_keypoints

OPEN = {"thumb": (-15.0, 20.0, 0.0, 5.0), "finger": (0.0, 12.0, 14.0, 8.0)}
CLOSED = {"thumb": (14.0, 38.0, 22.0, 34.0), "finger": (0.0, 52.0, 44.0, 28.0)}
"""Joint values of the open and of the closed hand [deg], in the order of the human hand's joints."""

SPREAD = {"index": 6.0, "middle": 1.0, "ring": -5.0, "little": -11.0}
"""Abduction of the open fingers [deg]; closed, they lie side by side."""

REACH, RISE = np.array([0.22, 0.10, -0.18]), 0.15
"""Way of the wrist to the thing, and how far it is lifted [m]."""

PHASES = (0.40, 0.70)
"""Shares of the clip at which the reach ends and the lift begins; between them the hand closes."""


@dataclass(frozen=True)
class Clip:
    """A person's hand over time.

    Attributes:
        times: Time of each frame [s], shape (T,).
        points: Key points in W [m], shape (T, 21, 3).
        hand: The person's hand.
        qs: Its joint values [rad], shape (T, 20).
        R_WH: Rotations of its wrist frame, shape (T, 3, 3).
        p_WH: Origins of its wrist frame [m], shape (T, 3).
    """

    times: Array
    points: Array
    hand: Hand
    qs: Array
    R_WH: Array
    p_WH: Array


def reach_grasp_lift(
    *,
    seconds: float = 3.0,
    frames_per_second: float = 30.0,
    side: str = "right",
    shape: HumanShape = MEAN_SHAPE,
    noise_m: float = 0.0,
    seed: int = 0,
) -> Clip:
    """A clip in which a hand reaches, grasps and lifts, each with the smooth speed of people (Flash and Hogan 1985).

    Args:
        seconds: Length of the clip [s].
        frames_per_second: Frames a second.
        side: "right" or "left"; the left clip is the mirror image of the right one.
        shape: The person's shape.
        noise_m: Standard deviation of noise on each coordinate of the points [m], as a camera adds it.
        seed: Seed of the noise.

    Returns:
        The clip.

    Raises:
        ConfigError: There would be fewer than two frames, or the side is neither.
    """
    count = round(seconds * frames_per_second)
    if count < 2 or side not in ("right", "left"):
        raise ConfigError(f"a clip needs two frames of a right or left hand, not {count} of a {side} one")
    hand = human_hand(shape)
    t = np.linspace(0.0, 1.0, count)
    reach, close, rise = (_minimum_jerk(t, *span) for span in ((0.0, PHASES[0]), PHASES, (PHASES[1], 1.0)))
    postures = [_posture(hand, OPEN, SPREAD), _posture(hand, CLOSED, {})]
    # The hand opens a little more on its way, as people's do.
    aperture = np.sin(np.pi * reach)[:, None] * 0.12
    qs = postures[0] + (close[:, None] - aperture) * (postures[1] - postures[0])
    qs = np.clip(qs, *hand.limits)
    # The palm looks sideways and down: the wrist turns about the forearm as it arrives.
    forward = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    turns = np.array([rotation_about(np.array([0.0, 0.0, 1.0]), 0.5 * (1.0 - float(s))) for s in reach])
    R_WH = forward @ turns
    p_WH = reach[:, None] * REACH + rise[:, None] * np.array([0.0, 0.0, RISE])
    if side == "left":
        hand = mirror(hand)
        flip = np.array([1.0, -1.0, 1.0])
        # The mirror stands in W's plane y = 0, and the frames of a left hand are mirrored in their own.
        R_WH, p_WH = R_WH * np.outer(flip, flip), p_WH * flip
    points = human_keypoints(hand, qs, R_WH, p_WH)
    if noise_m:
        points = points + np.random.default_rng(seed).normal(scale=noise_m, size=points.shape)
    return Clip(t * seconds, points, hand, qs, R_WH, p_WH)


def _minimum_jerk(t: Array, start: float, end: float) -> Array:
    s = np.clip((t - start) / (end - start), 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def _posture(hand: Hand, posture: dict[str, tuple[float, ...]], spread: dict[str, float]) -> Array:
    angles = [
        value + (spread.get(finger.name, 0.0) if k == 0 else 0.0)
        for finger in hand.fingers
        for k, value in enumerate(posture["thumb" if finger.name == "thumb" else "finger"])
    ]
    return np.radians(angles)
