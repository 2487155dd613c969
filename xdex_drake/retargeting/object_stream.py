"""Follows a person's hand beside an object: what the fingers want, as far as the object lets them.

Each frame takes the joint values that the person's points ask for, and looks for the nearest ones at which the hand
stays out of the object, within joint limits and within a greatest step from the frame before. The wrist may give way a
little, at a cost. Links that touch go on touching while the person still presses.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import daqp
import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.grasping.true_shapes import nearest_points
from xdex_drake.hand.description import Finger
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.point import ContactSet, Point
from xdex_drake.retargeting.hand_retargeter import Following, HandRetargeter
from xdex_drake.scene.object import ObjectModel
from xdex_drake.scene.tabletop import Scene

ROUNDS = 3
"""Linearisations a frame."""

STEP = 0.19
"""Greatest step of a joint from one frame to the next [rad or m]."""

NEAR = 0.02
"""Links whose spheres are nearer than this are asked for their exact distance [m]."""

TURN = 0.08
"""Greatest step of a joint in one linearisation near the object [rad or m]."""

GIVE = 0.004
"""Greatest displacement of the wrist in one linearisation [m]."""

STILL = 2e-3
"""A step shorter than this is the last one [rad or m]."""

SPARE = 3e-4
"""Clearance that is aimed at, so that what linearisation misses stays small [m]."""

DEEP = -2e-4
"""Exact distance below which another linearisation is worth its while [m]."""

TOUCHING, PRESSING = 1.5e-3, -1e-3
"""A link that is nearer than the first touches; it goes on while the person wants it deeper than the second [m]."""

WRIST = 60.0
"""Weight of a wrist's displacement squared over that of a joint's [rad^2 / (0.1 m)^2 each]."""

BLOCKED = 1e4
"""Weight of what cannot be kept out [1/m]."""

_NONE = ContactSet(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64))


@dataclass(frozen=True, eq=False)
class Guarded:
    """A frame beside an object.

    Attributes:
        q: Joint values [rad or m], shape (n,).
        X_WH: Wrist pose: the person's, given way where it had to.
        wanted: What the person's points alone ask for.
        clearance: Exact distance of the nearest link from the object, negative inside [m]; infinity where none is near.
        touching: Links that touch.
        X_WO: Pose of the object.
    """

    q: Array
    X_WH: RigidTransform
    wanted: Following
    clearance: float
    touching: tuple[str, ...]
    X_WO: RigidTransform


class ObjectStream:
    """A stream of frames beside an object, with the same numbers for every hand.

    Attributes:
        retargeter: Whose objective is followed.
        object: The object.
        X_WO: Its pose; where `carried`, it goes with the wrist once thumb and another finger touch.
    """

    def __init__(
        self,
        retargeter: HandRetargeter,
        object: ObjectModel,
        X_WO: RigidTransform,
        *,
        carried: bool = True,
        q_start: Array | None = None,
    ) -> None:
        """Starts a stream.

        Args:
            retargeter: Whose objective is followed.
            object: The object.
            X_WO: Its pose at the begin.
            carried: Whether it moves with the wrist while thumb and another finger touch it; else it stays.
            q_start: Joint values before the first frame, shape (n,); the hand's rest posture where None.
        """
        self.retargeter, self.object, self.X_WO = retargeter, object, X_WO
        self._carried, self._far = carried, q_start is None
        self._stream = retargeter.stream(q_start=q_start)
        self._q = self._stream.q.copy()
        self._touching: tuple[int, ...] = ()
        self._X_HO: RigidTransform | None = None
        self._shift = np.zeros(3)

    def follow(
        self, points: Array, *, X_WH: tuple[Array, Array] | None = None, X_WO: RigidTransform | None = None
    ) -> Guarded:
        """Follows the next frame.

        Args:
            points: Key points [m], shape (21, 3).
            X_WH: The person's wrist frame, as in `HandRetargeter.frame`.
            X_WO: Pose of the object in this frame, where something tells it; it is not carried then.

        Returns:
            Joint values and wrist.

        Raises:
            ConfigError: These are no key points; the stream stays as it was.
        """
        wanted = self._stream.follow(points, X_WH=X_WH)
        R_WH = RotationMatrix.ProjectToRotationMatrix(wanted.R_WH)
        wrist = RigidTransform(R_WH, wanted.p_WH)
        if X_WO is not None:
            self.X_WO, self._X_HO = X_WO, None
        elif self._X_HO is not None:
            self.X_WO = wrist @ self._X_HO
        scene = Scene(self.object, self.X_WO, "")
        q, X, clearance, touching = self._guarded(scene, wanted, wrist)
        hand = self.retargeter.hand
        self._q, self._touching, self._shift = q, touching, X.translation() - wrist.translation()
        names = tuple(hand.links[link].name for link in touching)
        held = self._carried and X_WO is None and _is_held(hand.fingers, names)
        self._X_HO = None if not held else (wrist.inverse() @ self.X_WO if self._X_HO is None else self._X_HO)
        self._far = False
        return Guarded(q, X, wanted, clearance, names, self.X_WO)

    def _guarded(
        self, scene: Scene, wanted: Following, wrist: RigidTransform
    ) -> tuple[Array, RigidTransform, float, tuple[int, ...]]:
        """The nearest posture outside of the object: joints, wrist, clearance, links that touch."""
        hand = self.retargeter.hand
        low, high = hand.limits
        reach = np.inf if self._far else STEP
        least, most = np.maximum(low, self._q - reach), np.minimum(high, self._q + reach)
        aim = np.clip(wanted.q, least, most)
        # From the frame before, which is outside of the object: a linearisation inside may point through it.
        q, X = self._q, RigidTransform(wrist.rotation(), wrist.translation() + self._shift)
        kept = self._pressed(scene, wanted, wrist)
        for _ in range(ROUNDS):
            k = Configuration.at(hand, X, q)
            links, p_WCs, gaps, away = near_links(scene, k)
            J = -np.einsum("ka,kab->kb", away, k.jacobian(links, p_WCs))[:, 3:]
            held = np.array([link in kept for link in links], dtype=bool)
            turn = np.full_like(q, TURN if len(gaps) else np.inf)
            bounds = np.maximum(least - q, -turn), np.minimum(most - q, turn)
            step = _step(J, gaps, held, aim - q, wrist.translation() - X.translation(), *bounds)
            q = np.clip(q + step[3:], least, most)
            X = RigidTransform(X.rotation(), X.translation() + step[:3])
            if not len(gaps) or (np.abs(step).max() < STILL and gaps.min() > DEEP):
                break
        k = Configuration.at(hand, X, q)
        links, _, gaps, _ = near_links(scene, k)
        touching = tuple(dict.fromkeys(links[gaps < TOUCHING].tolist()))
        return q, X, float(gaps.min(initial=np.inf)), touching

    def _pressed(self, scene: Scene, wanted: Following, wrist: RigidTransform) -> set[int]:
        """Links that touched in the frame before and that the person's points want inside of the object still."""
        if not self._touching:
            return set()
        hand = self.retargeter.hand
        k = Configuration.at(hand, wrist, wanted.q)
        rows = np.flatnonzero(np.isin(hand.sphere_links, self._touching))
        centers = k.points(hand.sphere_links[rows], hand.spheres[rows, :3])
        gaps = scene.object.grid.lower_bounds((scene.X_WO.inverse() @ centers.T).T) - hand.spheres[rows, 3]
        return {link for link in self._touching if gaps[hand.sphere_links[rows] == link].min() < PRESSING}


def near_links(scene: Scene, k: Configuration) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Exact distances of links that are near the object, each at its two nearest spheres.

    Args:
        scene: The object.
        k: The hand's configuration.

    Returns:
        Index of each link, shape (m,), the nearest point of the mesh to it [m], shape (m, 3), its distance, negative
        inside [m], shape (m,), and the unit direction in W from the link to that point, shape (m, 3).
    """
    hand = k.hand
    near, gaps, outward = Point(k, scene, _NONE, np.zeros((0, 3))).object_distances
    links = hand.sphere_links[near]
    order = np.lexsort((gaps, links))
    first = np.flatnonzero(np.diff(links[order], prepend=-1))
    rows = np.unique(np.concatenate([order[first], order[np.minimum(first + 1, max(len(order) - 1, 0))]]))
    rows = rows[gaps[rows] < NEAR]
    if not len(rows):
        return np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))
    centers = k.points(hand.sphere_links[near[rows]], hand.spheres[near[rows], :3])
    starts = centers - (gaps[rows] + hand.spheres[near[rows], 3])[:, None] * outward[rows]
    p_WCs, clearances, away = nearest_points(hand, k, scene, links[rows], starts)
    return links[rows], p_WCs, clearances, away


def _step(
    J: Array, gaps: Array, held: NDArray[np.bool_], to_aim: Array, to_wrist: Array, least: Array, most: Array
) -> Array:
    """Displacement of the wrist and step of the joints: towards the aim, outside of the object to first order.

    One slack for all rows says how far the object cannot be kept clear of.
    """
    n, m = len(to_aim), len(gaps)
    H = np.diag(np.concatenate([np.full(3, WRIST / 0.01), np.ones(n), [BLOCKED]]))
    f = np.concatenate([-WRIST / 0.01 * to_wrist, -to_aim, [BLOCKED]])
    A = np.hstack([J, np.ones((m, 1))])
    # Contacts that are kept may leave the surface by no more than a hair, unless that is out of reach.
    A = np.vstack([A, np.hstack([J[held], -np.ones((int(held.sum()), 1))])])
    lower = np.concatenate([np.full(3, -GIVE), least, [0.0], SPARE - gaps, np.full(int(held.sum()), -1e30)])
    upper = np.concatenate([np.full(3, GIVE), most, [1e3], np.full(m, 1e30), 2.0 * SPARE - gaps[held]])
    x, _, flag, _ = daqp.solve(H, f, np.ascontiguousarray(A), upper, lower, np.zeros(len(upper), dtype=np.int32))
    return np.asarray(x[:-1], dtype=np.float64) if flag > 0 else np.zeros(3 + n)


def _is_held(fingers: Iterable[Finger], touching: Iterable[str]) -> bool:
    """Whether the thumb and another finger, or the palm, touch."""
    of_finger = {link: finger.name for finger in fingers for link in finger.links}
    names = {of_finger.get(link, "palm") for link in touching}
    return "thumb" in names and len(names) > 1


def follow_beside(
    retargeter: HandRetargeter, points: Array, object: ObjectModel, X_WO: RigidTransform, *, carried: bool = True
) -> Iterator[Guarded]:
    """Follows frames as they come; see `ObjectStream`.

    Args:
        retargeter: Whose objective is followed.
        points: Key points of each frame [m], shape (T, 21, 3).
        object: The object.
        X_WO: Its pose at the begin.
        carried: See `ObjectStream`.

    Yields:
        Joint values and wrist of each frame.

    Raises:
        ConfigError: These are no key points.
    """
    stream = ObjectStream(retargeter, object, X_WO, carried=carried)
    for frame in points:
        yield stream.follow(frame)
