"""The 21 key points of a person's hand: their order, the wrist frame that they show, and how large the hand is.

The order is that of MediaPipe, which also serves reordered MANO joints: 0 is the wrist, then four points a finger from
the palm out, thumb, index, middle, ring, little; the last of each is its tip. Points are in metres, in any frame.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array, cross
from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.shapes import FLIP

FINGERS = ("thumb", "index", "middle", "ring", "little")
COUNT = 21
WRIST = 0
TIPS = {name: 4 * k + 4 for k, name in enumerate(FINGERS)}
MIDDLES = {name: 4 * k + 2 for k, name in enumerate(FINGERS)}
"""Second point of each finger: the middle joint, of the thumb its knuckle."""

LEAST_LENGTH, GREATEST_LENGTH = 0.08, 0.35
"""Lengths that a person's hand may have [m]; others are millimetres, pixels or another order of the points."""


def check_points(points: object, source: str = "points") -> Array:
    """Key points as an array, or an error.

    Args:
        points: Key points [m], shape (..., 21, 3).
        source: What an error calls them: a file, say.

    Returns:
        The same in double precision.

    Raises:
        ConfigError: The shape is another, a number is not finite, or the lengths are no hand's.
    """
    array = np.asarray(points)
    if array.dtype.kind not in "fiu" or array.shape[-2:] != (COUNT, 3) or array.size == 0:
        shape = array.shape if array.dtype.kind in "fiu" else array.dtype
        raise ConfigError(f"{source}: holds {shape}; give numbers of shape (21, 3), or (T, 21, 3) for T frames")
    array = array.astype(float)
    if not np.isfinite(array).all():
        frame = int(np.argwhere(~np.isfinite(array.reshape(-1, COUNT * 3)).all(axis=1))[0, 0])
        raise ConfigError(f"{source}: frame {frame} holds a number that is not finite; leave such frames out")
    length = float(np.median(finger_length(array, "middle")))
    if not LEAST_LENGTH <= length <= GREATEST_LENGTH:
        raise ConfigError(
            f"{source}: wrist to tip of the middle finger is {length:.4g} m along its joints; give metres, in the "
            "order of MediaPipe"
        )
    return array


def read_points(path: Path) -> Array:
    """Reads key points from a `.npy` file of plain numbers; a pickle is refused, and nothing of it is run.

    Args:
        path: The file.

    Returns:
        Key points [m], shape (T, 21, 3).

    Raises:
        ConfigError: The file cannot be read, or does not hold key points.
    """
    try:
        with path.open("rb") as file:
            content = np.lib.format.read_array(file, allow_pickle=False)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, EOFError, MemoryError, SyntaxError) as error:
        said = " ".join(str(error).split())[:120]
        raise ConfigError(f"{path}: is no .npy file of plain numbers ({said}); save one with numpy.save") from None
    points = check_points(content, str(path))
    if points.ndim > 3:
        raise ConfigError(f"{path}: holds {points.shape}; give (21, 3), or (T, 21, 3) for T frames")
    return points.reshape(-1, COUNT, 3)


def wrist_frames(points: Array, side: str) -> tuple[Array, Array]:
    """Frames H of the wrist: origin there, z to the knuckle of the middle finger, x out of the palm.

    The frame of dex-retargeting, whose plane of the palm goes through the wrist and the knuckles of index and middle
    finger. The y axis then points to the thumb's side of a right hand, and away from it on a left one.

    Args:
        points: Key points [m] in any frame W, shape (..., 21, 3).
        side: "right" or "left".

    Returns:
        R_WH, shape (..., 3, 3), and p_WH [m], shape (..., 3).

    Raises:
        ConfigError: Wrist and knuckles lie on a line, in some frame.
    """
    p_WH, index, middle = points[..., WRIST, :], points[..., 5, :], points[..., 9, :]
    z, aside = middle - p_WH, index - middle if side == "right" else middle - index
    length = np.sqrt((z * z).sum(axis=-1, keepdims=True))
    z = z / np.maximum(length, 1e-9)
    y = aside - (aside * z).sum(axis=-1, keepdims=True) * z
    breadth = np.sqrt((y * y).sum(axis=-1, keepdims=True))
    if min(length.min(), breadth.min()) < 1e-3:
        raise ConfigError("points: the wrist and the knuckles of index and middle finger lie on a line, with no palm")
    y = y / breadth
    return np.stack([cross(y, z), y, z], axis=-1), p_WH.copy()


def in_wrist_frame(points: Array, R_WH: Array, p_WH: Array, *, mirrored: bool = False) -> Array:
    """Key points in the wrist frame.

    Args:
        points: Key points in W [m], shape (..., 21, 3).
        R_WH: Rotations of the wrist frames, shape (..., 3, 3).
        p_WH: Their origins [m], shape (..., 3).
        mirrored: Reflect them in the plane y = 0 of H, as `xdex_drake.mirror` does with hands.

    Returns:
        p_HPs [m], shape (..., 21, 3).
    """
    p_HPs = (points - p_WH[..., None, :]) @ R_WH
    return p_HPs * FLIP if mirrored else p_HPs


def finger_length(points: Array, finger: str) -> Array:
    """Length of a finger along its joints, the wrist included: no posture changes it.

    Args:
        points: Key points [m], shape (..., 21, 3).
        finger: One of `FINGERS`.

    Returns:
        Length from the wrist over its joints to the tip [m], shape (...).
    """
    tip = TIPS[finger]
    to_knuckle = points[..., tip - 3, :] - points[..., WRIST, :]
    beyond = points[..., tip - 2 : tip + 1, :] - points[..., tip - 3 : tip, :]
    return np.sqrt((to_knuckle**2).sum(axis=-1)) + np.sqrt((beyond**2).sum(axis=-1)).sum(axis=-1)


def human_keypoints(hand: Hand, qs: Array, R_WH: Array, p_WH: Array) -> Array:
    """The 21 key points of a hand that has a person's five fingers of at least three segments, as `human_hand` has.

    Args:
        hand: The hand.
        qs: Actuated joint values [rad], shape (T, n).
        R_WH: Rotations of the wrist, shape (T, 3, 3).
        p_WH: Its origins [m], shape (T, 3).

    Returns:
        Key points in W [m], shape (T, 21, 3).

    Raises:
        ConfigError: A finger is missing or too short.
    """
    fingers = {finger.name: finger for finger in hand.fingers}
    short = [name for name in FINGERS if name not in fingers or len(fingers[name].links) < 3]
    if short:
        raise ConfigError(f"hand {hand.name}: {', '.join(short)} lack the joints that a person has; take a human hand")
    R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), qs)
    p_HPs = np.zeros((len(qs), COUNT, 3))
    for name, tip in TIPS.items():
        links = [hand.link_index[link] for link in fingers[name].links[-3:]]
        p_HPs[:, tip - 3 : tip] = p_HLs[:, links]
        p_HPs[:, tip] = p_HLs[:, links[-1]] + R_HLs[:, links[-1]] @ fingers[name].p_LTip
    return p_HPs @ np.swapaxes(R_WH, -1, -2) + p_WH[:, None]
