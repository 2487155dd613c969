"""Accelerates an object in a closed hand, far from any table, whichever simulator plays it.

An object without weight under an acceleration a is one whose center of mass feels m (a + g) against gravity.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.contact.penetration import hand_depths
from xdex_drake.contact.wrench import GRAVITY
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.scene.belonging import check_belonging, check_liftable
from xdex_drake.scene.distance import sample_surface
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.hold import slip_and_turn
from xdex_drake.simulation.protocol import AnyProtocol, PushProtocol
from xdex_drake.simulation.verdict import Player, play_lift

_log = logging.getLogger(__name__)

ALOFT = RigidTransform(np.array([0.0, 0.0, 50.0]))
"""Where hand and object are taken, so that the table is never reached."""

LOOK_S = 0.02
"""Time between two looks at shift and turn [s]."""

DEPTH_POINTS = 2048
"""Points of the object's surface at which penetration is measured."""

OPENED, CLOSED = 0.25, 0.15
"""Fractions of each joint's way to its limit by which `fractions` opens and closes."""

SIDEWAYS = 0.3
"""A joint that moves its fingertip less than this cosine along the direction to the object spreads, and stays."""

DIP, DIP_REACH = 1e-3, 1e-3
"""How far `dip` sends links in, and the gap up to which they are sent [m]."""


def play(player: Player, grasp: Grasp, protocol: AnyProtocol) -> Lift:
    """Plays a lift, or pushes without weight, and judges it; the player is the rig of `protocol.grip`."""
    if isinstance(protocol, PushProtocol):
        return play_pushes(player, grasp, protocol)
    if protocol.start_offset_H is not None:
        check_belonging(grasp, player.hand, player.scene)
        check_liftable(grasp)
        grasp = from_afar(grasp, player.hand, np.array(protocol.start_offset_H))
    return play_lift(player, grasp)


def play_pushes(player: Player, grasp: Grasp, protocol: PushProtocol) -> Lift:
    """Closes the hand, accelerates the object, and judges what becomes of it.

    Args:
        player: The simulator, with the grasp's hand and scene, and the protocol's `grip`.
        grasp: A grasp with pre-grasp and squeeze targets.
        protocol: The protocol.

    Returns:
        Verdict. Where it fails, its reason is `penetrating`, `pregrasp_in_contact`, `simulation_failed`, `timeout`, or
        `slipped`, `turned` or `lost` with a colon and the direction under which that happened first.

    Raises:
        ConfigError: Grasp, hand and scene do not belong together, or the grasp has no pre-grasp or squeeze.
    """
    check_belonging(grasp, player.hand, player.scene)
    check_liftable(grasp)
    begin, cpu_end = time.perf_counter(), time.process_time() + protocol.grip.cpu_limit_s

    def result(reason: str) -> Lift:
        seconds = time.perf_counter() - begin
        tips = tuple(f.name for f in player.hand.fingers if player.hand.link_index[f.tip_link] in touched)
        return Lift(protocol.name, reason == "", reason, float("nan"), tips, seconds)

    touched: frozenset[int] = frozenset()
    if _too_deep(player.hand, player.scene, grasp, protocol):
        return result("penetrating")
    player.start(aloft(CLOSINGS[protocol.closing](grasp, player.hand, player.scene)))
    start = player.X_WO()
    if protocol.closing == "squeeze" and player.touching_at_rest(protocol.grip.start_depth_m).object_links:
        return result("pregrasp_in_contact")
    try:
        _accelerate(player, np.zeros(3))
        closed = _round(player, protocol.grip.close_s + protocol.grip.squeeze_s)
        player.advance_to(closed)
        reasons, touched = _push_all(player, protocol, start if protocol.from_start else player.X_WO(), closed, cpu_end)
    except RuntimeError as error:
        _log.info("%s of %s %s: %s", protocol.name, grasp.hand, grasp.grasp_id, error)
        return result("simulation_failed")
    finally:
        player.push(np.zeros(3))
    passed = sum(not reason for reason in reasons)
    first = next((reason for reason in reasons if reason), "")
    return result("" if passed >= min(protocol.needed, len(reasons)) else first)


def _push_all(
    player: Player, protocol: PushProtocol, before: RigidTransform, t: float, cpu_end: float
) -> tuple[list[str], frozenset[int]]:
    """What went wrong under each acceleration, and the links that touch at the end; one that decides is the last."""
    state, reasons = player.state(), []
    for k, acceleration in enumerate(protocol.accelerations):
        last = k == len(protocol.accelerations) - 1
        if protocol.reset and k:
            player.restore(state)
        begin = t if protocol.reset else t + k * protocol.push_s
        judged = last or not protocol.only_end
        problem = _push(player, protocol, before, np.array(acceleration), begin, judged, cpu_end)
        if judged:
            reasons.append(f"{problem}:{_name(acceleration)}" if problem not in ("", "timeout") else problem)
        if problem == "timeout" or (problem and protocol.needed == len(protocol.accelerations)):
            break
        if not problem and protocol.needed == 1:
            break
    return reasons, player.touching().object_links


def _push(
    player: Player,
    protocol: PushProtocol,
    before: RigidTransform,
    acceleration: Array,
    begin: float,
    judged: bool,
    cpu_end: float,
) -> str:
    """Accelerates the object for a while; the first bound that is not met, empty where all are."""
    _accelerate(player, acceleration)
    end = _round(player, begin + protocol.push_s)
    looks = [] if protocol.only_end else np.arange(begin + LOOK_S, end, LOOK_S).tolist()
    for t in (*looks, end):
        player.advance_to(_round(player, t))
        if time.process_time() > cpu_end:
            return "timeout"
        shift, turn = slip_and_turn(before, player.X_WO(), player.scene.object.p_OOcm)
        if not np.isfinite(shift + turn):
            raise RuntimeError("the object's pose is not finite")
        if judged and protocol.max_shift_m is not None and shift > protocol.max_shift_m:
            return "slipped"
        if judged and protocol.max_turn_rad is not None and turn > protocol.max_turn_rad:
            return "turned"
    return "lost" if judged and protocol.contact and not player.touching().object_links else ""


def _accelerate(player: Player, acceleration: Array) -> None:
    player.push(player.scene.object.mass * (acceleration + np.array([0.0, 0.0, GRAVITY])))


def _round(player: Player, t: float) -> float:
    """The time of a whole number of steps."""
    step = player.protocol.plant.time_step
    return round(t / step) * step


def _name(acceleration: tuple[float, float, float]) -> str:
    axis = int(np.argmax(np.abs(acceleration)))
    return f"{'+' if acceleration[axis] > 0.0 else '-'}{'xyz'[axis]}"


def _too_deep(hand: Hand, scene: Scene, grasp: Grasp, protocol: PushProtocol) -> bool:
    """Whether the grasp penetrates the object more than a protocol allows."""
    if protocol.max_depth_m is None and protocol.max_depth_sum_m is None:
        return False
    k = Configuration.at(hand, grasp.X_WH, grasp.q)
    points, _ = sample_surface(scene.object.vertices, scene.object.faces, DEPTH_POINTS, 0)
    depths = hand_depths(hand, k.R_WLs, k.p_WLs, (scene.X_WO @ points.T).T)
    sum_bound = np.inf if protocol.max_depth_sum_m is None else protocol.max_depth_sum_m
    bound = np.inf if protocol.max_depth_m is None else protocol.max_depth_m
    return bool(depths.sum() >= sum_bound or depths.max(initial=0.0) >= bound)


def aloft(grasp: Grasp) -> Grasp:
    """The grasp where no table is."""
    assert grasp.X_WH_pregrasp is not None
    return replace(grasp, X_WO=ALOFT @ grasp.X_WO, X_WH=ALOFT @ grasp.X_WH, X_WH_pregrasp=ALOFT @ grasp.X_WH_pregrasp)


def from_afar(grasp: Grasp, hand: Hand, offset_H: Array) -> Grasp:
    """The grasp with another pre-grasp: the wrist at an offset, the fingers stretched, the thumb as it was.

    Args:
        grasp: A grasp with a pre-grasp.
        hand: Its hand.
        offset_H: Offset from the grasp's wrist position, in H [m], shape (3,).

    Returns:
        The grasp.
    """
    assert grasp.q_pregrasp is not None
    of_thumb = {link for finger in hand.fingers if finger.name == "thumb" for link in finger.links}
    thumb = np.array([joint.child in of_thumb for joint in hand.joints if joint.coupling is None])
    q = np.where(thumb, grasp.q_pregrasp, np.clip(0.0, *hand.limits))
    start = RigidTransform(grasp.X_WH.rotation() @ offset_H) @ grasp.X_WH
    return replace(grasp, X_WH_pregrasp=start, q_pregrasp=q)


def as_given(grasp: Grasp, hand: Hand, scene: Scene) -> Grasp:
    """The grasp with its own pre-grasp and squeeze."""
    return grasp


def between_fractions(grasp: Grasp, hand: Hand, scene: Scene) -> Grasp:
    """From the grasp opened by a fraction of each joint's way to its limit to the grasp closed by another.

    A joint closes in the sense in which it moves its own finger's tip towards the object's center of mass.

    Args:
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.

    Returns:
        The grasp with open joints as pre-grasp, closed ones as grasp, and no squeeze; its wrist stays.
    """
    sense = closing_senses(hand, grasp, scene)
    low, high = hand.limits
    opened = grasp.q + OPENED * np.where(sense >= 0.0, low - grasp.q, high - grasp.q)
    closed = grasp.q + CLOSED * np.where(sense >= 0.0, high - grasp.q, low - grasp.q)
    opened, closed = (np.where(sense == 0.0, grasp.q, q) for q in (opened, closed))
    return replace(grasp, X_WH_pregrasp=grasp.X_WH, q_pregrasp=opened, q=closed, tau_squeeze=np.zeros_like(grasp.q))


def closing_senses(hand: Hand, grasp: Grasp, scene: Scene) -> Array:
    """1 or -1 where a joint's growth closes or opens its finger on the object, 0 where it spreads it, shape (n,)."""
    k = Configuration.at(hand, grasp.X_WH, grasp.q)
    center = grasp.X_WO @ scene.object.p_OOcm
    links = np.array([hand.link_index[finger.tip_link] for finger in hand.fingers], dtype=np.int64)
    tips = k.points(links, np.array([finger.p_LTip for finger in hand.fingers]))
    J = k.jacobian(links, tips)[:, :, 6:]  # (fingers, 3, n)
    to_center = center - tips
    along = np.einsum("fan,fa->fn", J, to_center / np.linalg.norm(to_center, axis=1, keepdims=True))
    size = np.linalg.norm(J, axis=1)
    cosine = np.where(size > 1e-9, along / np.maximum(size, 1e-9), 0.0)
    finger = np.argmax(size, axis=0)
    chosen = cosine[finger, np.arange(cosine.shape[1])]
    return np.where(np.abs(chosen) < SIDEWAYS, 0.0, np.sign(chosen))


def dipped(grasp: Grasp, hand: Hand, scene: Scene) -> Grasp:
    """At a posture whose contacts are a little deep, from the begin on.

    Args:
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.

    Returns:
        The grasp with that posture as pre-grasp and grasp, and no squeeze; its wrist stays.
    """
    k = Configuration.at(hand, grasp.X_WH, grasp.q)
    centers = k.points(hand.sphere_links, hand.spheres[:, :3])
    X_OW = grasp.X_WO.inverse()
    found = scene.object.exact.query((X_OW @ centers.T).T)
    gaps = found.distance - hand.spheres[:, 3]
    rows = [
        int(on_link[np.argmin(gaps[on_link])])
        for link in range(1, len(hand.links))
        if len(on_link := np.flatnonzero(hand.sphere_links == link)) and gaps[on_link].min() < DIP_REACH
    ]
    q = grasp.q
    if rows:
        inward = -found.gradient[rows] @ grasp.X_WO.rotation().matrix().T
        J = np.einsum("ka,kan->kn", inward, k.jacobian(hand.sphere_links[rows], centers[rows])[:, :, 6:])
        q = np.clip(q + np.linalg.lstsq(J, np.full(len(rows), DIP), rcond=1e-3)[0], *hand.limits)
    return replace(grasp, X_WH_pregrasp=grasp.X_WH, q_pregrasp=q, q=q, tau_squeeze=np.zeros_like(q))


CLOSINGS: dict[str, Callable[[Grasp, Hand, Scene], Grasp]] = {
    "squeeze": as_given,
    "fractions": between_fractions,
    "dip": dipped,
}
"""Where joints start and are sent, by `PushProtocol.closing`."""
