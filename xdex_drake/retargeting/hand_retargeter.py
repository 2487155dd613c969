"""A person's key points to joint values of a hand: frame by frame, as a stream, or all frames at once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import zero_configuration
from xdex_drake.retargeting.chains import Chains, Placed
from xdex_drake.retargeting.descent import Problem, descend
from xdex_drake.retargeting.keypoints import FINGERS, check_points, finger_length, in_wrist_frame, wrist_frames
from xdex_drake.retargeting.objectives import OBJECTIVES, make_objective, make_targets, start_pinches

CHUNK = 64
"""Frames that are solved together: more no longer fit the processor's cache."""


@dataclass(frozen=True)
class Following:
    """Joint values that follow a person's hand, of one frame or of several in the first axis.

    Attributes:
        q: Actuated joint values in the order of `Hand.joint_names` [rad or m], shape (..., n).
        R_WH: Rotation of the person's wrist frame, where the hand's wrist frame belongs, shape (..., 3, 3).
        p_WH: Its origin [m], shape (..., 3).
        cost: Value of the objective, smoothing included, shape (...).
        error: Mean distance between the objective's vectors and their targets [m], shape (...).
    """

    q: Array
    R_WH: Array
    p_WH: Array
    cost: Array
    error: Array


class HandRetargeter:
    """Follows a person's hand with any hand, by one of the objectives of dex-retargeting.

    A hand's fingers are found by their names; those that it lacks are left out and told (`missing`). Couplings hold
    exactly, q_full = C q + c, and limits are never passed. Wrists are laid upon each other: the hand's wrist frame H is
    the person's, so that joints alone are sought.

    The objective has no regulariser but `smoothing`; joints that no point constrains stay where they were, for steps
    are damped.

    Attributes:
        hand: The hand.
        objective: Name of the objective.
        side: The person's hand: "right" or "left".
        scale: Size of the hand over that of the person's.
        missing: The person's fingers that the hand lacks.
        unused: The hand's fingers that no finger of a person moves.
    """

    def __init__(
        self,
        hand: Hand,
        objective: str = "vector",
        *,
        side: str | None = None,
        scale: float = 1.0,
        middles: bool = False,
        smoothing: float = 0.0,
        iterations: int = 40,
        tolerance: float = 1e-3,
    ) -> None:
        """Prepares a hand.

        Args:
            hand: The hand: of the library, generated, or imported.
            objective: "position": fingertips in the wrist frame, by coordinate; "vector": vectors from the wrist to the
                fingertips, by length; "dexpilot": also vectors between fingertips, with pinches. See
                `xdex_drake.retargeting.objectives`.
            side: The person's hand; the hand's own side where None. Points of the other side are mirrored.
            scale: Size of the hand over that of the person's, by which the person's points are scaled. `calibrated`
                measures it.
            middles: Whether the middle joints of the fingers follow, too; for position and vector.
            smoothing: Weight of squared joint increments from the frame before [1/rad^2]; dex-retargeting uses 4e-3.
            iterations: Greatest number of Newton steps a frame.
            tolerance: A frame is done where a step lowers its cost by less than this fraction.

        Raises:
            ConfigError: An argument is out of its range, or the hand has no finger of a person.
        """
        if objective not in OBJECTIVES:
            raise ConfigError(f"objective {objective!r}: choose one of {', '.join(OBJECTIVES)}")
        if side not in (None, "right", "left"):
            raise ConfigError(f"side {side!r}: a person's hand is right or left")
        if not (np.isfinite(scale) and 0.05 <= scale <= 20.0):
            raise ConfigError(f"scale {scale}: give the hand's size over the person's, a number near 1")
        if not (np.isfinite(smoothing) and smoothing >= 0.0):
            raise ConfigError(f"smoothing {smoothing}: give a weight that is not negative")
        names = [finger.name for finger in hand.fingers]
        if not set(names) & set(FINGERS):
            raise ConfigError(
                f"hand {hand.name}: none of its fingers ({', '.join(names)}) is named as a person's; name them "
                f"{', '.join(FINGERS)} in its file"
            )
        if objective == "dexpilot" and (middles or len(set(names) & set(FINGERS)) < 2):
            raise ConfigError(f"hand {hand.name}: dexpilot takes fingertips alone, of two fingers at least")
        self.hand, self.objective, self.scale = hand, objective, float(scale)
        self.side = side or hand.side
        self.missing = tuple(name for name in FINGERS if name not in names)
        self.unused = tuple(name for name in names if name not in FINGERS)
        self._options = {"middles": middles, "smoothing": smoothing, "iterations": iterations, "tolerance": tolerance}
        aim = make_objective(hand, objective, middles=middles)
        self._problem = Problem(Chains.of(hand, aim.links, aim.p_LPs), aim, float(smoothing), iterations, tolerance)

    def calibrated(self, points: Array) -> HandRetargeter:
        """The same with the scale measured: lengths of the hand's fingers over those of the person's.

        Lengths go from the wrist along the joints to the tip, so that any posture will do.

        Args:
            points: Key points of a few frames [m], shape (..., 21, 3); medians are taken.

        Returns:
            A retargeter with that scale.

        Raises:
            ConfigError: These are no key points.
        """
        points = check_points(points)
        lengths = hand_lengths(self.hand).items()
        ratios = [length / float(np.median(finger_length(points, name))) for name, length in lengths]
        return HandRetargeter(self.hand, self.objective, side=self.side, scale=float(np.mean(ratios)), **self._options)

    def frame(
        self, points: Array, *, q_start: Array | None = None, X_WH: tuple[Array, Array] | None = None
    ) -> Following:
        """Follows one frame.

        Args:
            points: Key points [m], shape (21, 3), in any frame W.
            q_start: Joint values to start from, shape (n,), which smoothing holds on to; the hand's rest posture
                where None.
            X_WH: The person's wrist frame, as rotation (3, 3) and origin (3,); seen from the points where None.

        Returns:
            Joint values and wrist.

        Raises:
            ConfigError: These are no key points.
        """
        stream = self.stream(q_start=q_start)
        return stream.follow(points, X_WH=X_WH)

    def batch(self, points: Array, *, X_WH: tuple[Array, Array] | None = None) -> Following:
        """Follows many frames at once, each by itself from the rest posture, as `frame` does.

        Args:
            points: Key points [m], shape (T, 21, 3).
            X_WH: The person's wrist frames, (T, 3, 3) and (T, 3); seen from the points where None.

        Returns:
            Joint values and wrists, T rows.

        Raises:
            ConfigError: These are no key points, or smoothing is asked for, which needs an order: see `stream`.
        """
        if self._problem.smoothing:
            raise ConfigError("smoothing: frames of a batch do not follow each other; use stream()")
        points = _frames(points, 3)
        R_WH, p_WH, p_HPs = self._at_wrist(points, X_WH)
        targets, _ = make_targets(
            self._problem.objective, p_HPs, self.scale, start_pinches(self._problem.objective, len(p_HPs))
        )
        starts = np.tile(self._start(None), (len(points), 1))
        found = []
        for k in range(0, len(points), CHUNK):
            rows = np.zeros(len(points), dtype=bool)
            rows[k : k + CHUNK] = True
            found.append(descend(self._problem, starts[k : k + CHUNK], targets.rows(rows), near=False))
        q, r, cost = (np.concatenate([getattr(part, name) for part in found]) for name in ("q", "r", "cost"))
        return Following(q, R_WH, p_WH, cost, _distance(r))

    def stream(self, *, q_start: Array | None = None) -> Stream:
        """A stream of frames, each starting from the joint values of the one before.

        Args:
            q_start: Joint values before the first frame, shape (n,); the hand's rest posture where None.

        Returns:
            The stream.
        """
        return Stream(self, self._start(q_start), far=q_start is None)

    def follow(self, points: Iterable[Array]) -> Iterator[Following]:
        """Follows frames as they come, as a stream.

        Args:
            points: Key points of each frame [m], shape (21, 3).

        Yields:
            Joint values and wrist of each.
        """
        stream = self.stream()
        for frame in points:
            yield stream.follow(frame)

    def scaled_points(self, points: Array) -> Array:
        """What the hand follows, to be shown with it: key points scaled about the wrist, mirrored where it is.

        Args:
            points: Key points [m] in W, shape (T, 21, 3).

        Returns:
            Points in W [m], shape (T, 21, 3).
        """
        R_WH, p_WH, p_HPs = self._at_wrist(_frames(points, 3), None)
        return self.scale * p_HPs @ np.swapaxes(R_WH, -1, -2) + p_WH[:, None]

    def _start(self, q: Array | None) -> Array:
        low, high = self.hand.limits
        start = self.hand.q_rest if q is None else np.asarray(q, dtype=float)
        if start.shape != low.shape or not np.isfinite(start).all():
            raise ConfigError(f"q_start: give {len(low)} finite joint values, in the order of the hand's joint_names")
        return np.clip(start, low, high)

    def _at_wrist(self, points: Array, X_WH: tuple[Array, Array] | None) -> tuple[Array, Array, Array]:
        R_WH, p_WH = wrist_frames(points, self.side) if X_WH is None else (np.asarray(v, dtype=float) for v in X_WH)
        if R_WH.shape != (*points.shape[:-2], 3, 3) or p_WH.shape != (*points.shape[:-2], 3):
            raise ConfigError(f"X_WH: has shapes {R_WH.shape} and {p_WH.shape}; give a rotation and an origin a frame")
        return R_WH, p_WH, in_wrist_frame(points, R_WH, p_WH, mirrored=self.side != self.hand.side)


class Stream:
    """A stream of frames with a warm start; its state is the last joint values and who pinches.

    Attributes:
        q: Joint values of the last frame, shape (n,), to be read only.
    """

    def __init__(self, retargeter: HandRetargeter, q: Array, *, far: bool) -> None:
        """Starts a stream; use `HandRetargeter.stream`."""
        self.q = q
        self._retargeter, self._far = retargeter, far
        self._placed: Placed | None = None
        self._pinches = start_pinches(retargeter._problem.objective, 1)

    def follow(self, points: Array, *, X_WH: tuple[Array, Array] | None = None) -> Following:
        """Follows the next frame.

        Args:
            points: Key points [m], shape (21, 3).
            X_WH: The person's wrist frame, as in `HandRetargeter.frame`.

        Returns:
            Joint values and wrist.

        Raises:
            ConfigError: These are no key points; the stream stays as it was.
        """
        it = self._retargeter
        R_WH, p_WH, p_HPs = it._at_wrist(_frames(points, 2), X_WH)
        problem = it._problem
        targets, self._pinches = make_targets(problem.objective, p_HPs[None], it.scale, self._pinches)
        # The points at the last joint values are known still.
        found = descend(problem, self.q[None], targets, near=not self._far, placed=self._placed)
        self.q, self._placed, self._far = found.q[0].copy(), found.placed, False
        return Following(found.q[0], R_WH, p_WH, found.cost[0], _distance(found.r)[0])


def hand_lengths(hand: Hand) -> dict[str, float]:
    """Length of each finger of a hand along its joints, the wrist included.

    Args:
        hand: The hand.

    Returns:
        For each finger named as a person's the length from the wrist over its joints to the tip [m].
    """
    R_HLs, p_HLs = zero_configuration(hand)
    lengths = {}
    for finger in hand.fingers:
        if finger.name in FINGERS:
            links = [hand.link_index[name] for name in finger.links]
            tip = p_HLs[links[-1]] + R_HLs[links[-1]] @ finger.p_LTip
            chain = np.array([np.zeros(3), *p_HLs[links], tip])
            lengths[finger.name] = float(np.linalg.norm(np.diff(chain, axis=0), axis=1).sum())
    return lengths


def _frames(points: Array, dimensions: int) -> Array:
    points = check_points(points)
    if points.ndim != dimensions:
        wanted = "(21, 3)" if dimensions == 2 else "(T, 21, 3)"
        raise ConfigError(f"points: have shape {points.shape}; give {wanted}")
    return points


def _distance(r: Array) -> Array:
    return np.sqrt((r * r).sum(axis=-1)).mean(axis=-1)
