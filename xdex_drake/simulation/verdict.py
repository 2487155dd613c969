"""The rule of a lift, whichever simulator plays it: what is looked at, when, and what a failure is called."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.description import Hand
from xdex_drake.scene.belonging import check_belonging, check_liftable
from xdex_drake.simulation.hold import NOT_LIFTED, Grip, Pusher, play_hold

_log = logging.getLogger(__name__)

FAILURE_REASONS = (
    "simulation_failed",
    "timeout",
    "pregrasp_in_contact",
    "table_collision",
    "obstacle_collision",
    "not_grasped",
    "slipped",
    "turned",
    "too_few_fingertips",
)

CHECK_STEPS = 20
"""Steps of the protocol's plant between two looks at it."""


@dataclass(frozen=True)
class Touch:
    """Which links touch the object, the table, and obstacles, at one moment, as indices into `hand.links`."""

    object_links: frozenset[int]
    table_links: frozenset[int]
    obstacle_links: frozenset[int] = frozenset()


class Player(Pusher, Protocol):
    """A simulator that holds hand, object and table, ready to play any number of lifts."""

    @property
    def hand(self) -> Hand:
        """The hand."""
        ...

    def start(self, grasp: Grasp) -> None:
        """Puts hand and object at the begin of a lift, time zero, and takes up the lift's targets."""
        ...

    def release(self) -> None:
        """Lets the object go that the protocol kept in place."""
        ...

    def touching_at_rest(self, depth: float = 0.0) -> Touch:
        """Contacts of the configuration as it stands and at least as deep as given [m], from geometry alone."""
        ...

    def touching(self) -> Touch:
        """Contacts of the last step."""
        ...


def play_lift(player: Player, grasp: Grasp) -> Lift:
    """Plays one lift and judges it.

    Args:
        player: The simulator, with the grasp's hand and scene.
        grasp: A grasp with pre-grasp and squeeze targets.

    Returns:
        Verdict, with the first failure reason of `FAILURE_REASONS` that matches where it failed, and what came after
        the lift where the protocol goes on.

    Raises:
        ConfigError: Grasp, hand and scene do not belong together, the grasp has no pre-grasp or squeeze, or the
            protocol lifts from a table that is not there.
    """
    check_belonging(grasp, player.hand, player.scene)
    check_liftable(grasp)
    protocol = player.protocol
    if player.scene.table is None and not protocol.release:
        raise ConfigError(
            f"protocol {protocol.name} lifts from a table, and scene {player.scene.scene_id} has none; use protocol "
            "release"
        )
    # The limit is on time of the processor, so that a busy machine does not change a verdict.
    begin, cpu_begin = time.perf_counter(), time.process_time()
    player.start(grasp)
    z0 = _center_height(player)

    def result(reason: str, rise: float, tips: tuple[str, ...] = ()) -> Lift:
        hold = None if protocol.hold is None else NOT_LIFTED
        if not reason and grip is not None and protocol.hold is not None:
            hold = play_hold(grip, protocol.hold, cpu_begin + protocol.cpu_limit_s)
        return Lift(protocol.name, reason == "", reason, rise, tips, time.perf_counter() - begin, hold)

    at_rest = player.touching_at_rest()
    if at_rest.object_links and player.touching_at_rest(protocol.start_depth_m).object_links:
        return result("pregrasp_in_contact", 0.0)
    if at_rest.table_links:
        return result("table_collision", 0.0)
    if at_rest.obstacle_links:
        return result("obstacle_collision", 0.0)
    step = protocol.plant.time_step
    squeezed = round((protocol.close_s + protocol.squeeze_s) / step)
    # Nothing that is left behind by half the rise comes up again.
    decided = squeezed + round(0.6 * protocol.rise_s / step)
    total = round(protocol.duration_s / step)
    after_squeeze = Touch(frozenset(), frozenset())
    hit_table, hit_obstacle, grip = False, False, None
    try:
        for k in sorted({*range(CHECK_STEPS, total, CHECK_STEPS), squeezed, decided, total}):
            player.advance_to(k * step)
            if protocol.hold is not None and k >= squeezed:
                grip = grip or Grip(player)
                grip.look()
            rise = _center_height(player) - z0
            if time.process_time() - cpu_begin > protocol.cpu_limit_s:
                return result("timeout", rise)
            if k <= squeezed:
                after_squeeze = player.touching()
                hit_table = hit_table or bool(after_squeeze.table_links)
                hit_obstacle = hit_obstacle or bool(after_squeeze.obstacle_links)
            if k == squeezed and protocol.release:
                player.release()
            if k >= decided and rise < min(0.1 * protocol.rise_m, protocol.success_m):
                break
    except RuntimeError as error:
        _log.info("lift of %s %s: %s", grasp.hand, grasp.grasp_id, error)
        return result("simulation_failed", float("nan"))
    rise = _center_height(player) - z0
    if not np.isfinite(rise):
        return result("simulation_failed", float("nan"))
    touched = player.touching().object_links
    hand = player.hand
    tips = tuple(f.name for f in hand.fingers if hand.link_index[f.tip_link] in touched)
    missed = _missed(player, grasp, rise, tips)
    if missed and hit_table:
        missed = "table_collision"
    elif missed and hit_obstacle:
        missed = "obstacle_collision"
    elif missed and not after_squeeze.object_links:
        missed = "not_grasped"
    return result(missed, rise, tips)


def _center_height(player: Player) -> float:
    """Height of the object's center of mass above the table [m]."""
    return float((player.X_WO() @ player.scene.object.p_OOcm)[2])


def _missed(player: Player, grasp: Grasp, rise: float, tips: tuple[str, ...]) -> str:
    """The first bound of a protocol that the end of a lift does not meet; empty where all are met."""
    protocol, X_WO = player.protocol, player.X_WO()
    slipped = rise < protocol.success_m
    if protocol.max_height_error_m is not None:
        slipped = slipped or abs(rise - protocol.rise_m) >= protocol.max_height_error_m
    if protocol.max_shift_m is not None:
        shift = X_WO.translation() - grasp.X_WO.translation() - np.array([0.0, 0.0, protocol.rise_m])
        slipped = slipped or float(np.linalg.norm(shift)) >= protocol.max_shift_m
    if protocol.off_table_m is not None:
        lowest = float((X_WO @ player.scene.object.vertices.T)[2].min()) - player.scene.floor
        slipped = slipped or lowest < protocol.off_table_m
    if slipped:
        return "slipped"
    if protocol.max_turn_rad is not None:
        turn = (grasp.X_WO.rotation().inverse() @ X_WO.rotation()).ToAngleAxis().angle()
        if abs(turn) >= protocol.max_turn_rad:
            return "turned"
    return "too_few_fingertips" if len(tips) < protocol.fingertips else ""
