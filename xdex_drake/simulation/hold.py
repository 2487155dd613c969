"""Holds a lifted object for a while, then pushes it from all sides, whichever simulator plays it."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.contact.wrench import GRAVITY
from xdex_drake.grasp import Hold
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import HoldTest, LiftProtocol

_log = logging.getLogger(__name__)

PUSHES = {
    f"{sign}{axis}": (1.0 if sign == "+" else -1.0) * np.eye(3)[k] for k, axis in enumerate("xyz") for sign in "+-"
}
"""Directions of the pushes in W, in their order, by name."""

NOT_LIFTED = Hold(False, "not_lifted", float("nan"), float("nan"))
"""The verdict on an object that did not get as far."""

LOOK_STEPS = 5
"""Steps between two looks at slip and turn."""


class Pusher(Protocol):
    """A simulator at the end of a lift, whose object can be pushed, and which can go back to a state."""

    @property
    def protocol(self) -> LiftProtocol:
        """The protocol."""
        ...

    @property
    def scene(self) -> Scene:
        """The object, with the protocol's mass and friction."""
        ...

    def advance_to(self, t: float) -> None:
        """Simulates until a time [s]; a RuntimeError where the simulation breaks down."""
        ...

    def X_WO(self) -> RigidTransform:
        """Pose of the object."""
        ...

    def X_WH(self) -> RigidTransform:
        """Pose of the wrist frame."""
        ...

    def push(self, f_W: Array) -> None:
        """Applies a force at the object's center of mass from now on, in W [N], shape (3,); zero ends it."""
        ...

    def state(self) -> Any:
        """All that the further simulation depends on, to go on from here again by `restore`."""
        ...

    def restore(self, state: Any) -> None:
        """Goes back to a state of the same lift."""
        ...


def slip_and_turn(X_HO: RigidTransform, other: RigidTransform, p_OOcm: Array) -> tuple[float, float]:
    """How far an object has moved in the hand.

    Args:
        X_HO: Pose in the wrist frame.
        other: Pose later.
        p_OOcm: Center of mass in O [m], shape (3,).

    Returns:
        Distance of the center of mass [m], and angle of the turn [rad], both zero or more.
    """
    turn = (X_HO.rotation().inverse() @ other.rotation()).ToAngleAxis().angle()
    return float(np.linalg.norm(other @ p_OOcm - X_HO @ p_OOcm)), abs(float(turn))


@dataclass
class Grip:
    """Slip and turn of the object in the hand since the first look.

    Attributes:
        player: The simulator.
        X_HO: Pose of the object in the wrist frame at the first look.
        slip: Greatest distance of the center of mass from there so far [m].
        turn: Greatest turn so far [rad].
    """

    player: Pusher
    X_HO: RigidTransform = field(init=False)
    slip: float = 0.0
    turn: float = 0.0

    def __post_init__(self) -> None:
        """Takes the first look."""
        self.X_HO = self._now()

    def _now(self) -> RigidTransform:
        return self.player.X_WH().inverse() @ self.player.X_WO()

    def look(self) -> None:
        """Takes a look; a RuntimeError where the object's pose is no number any more."""
        slip, turn = slip_and_turn(self.X_HO, self._now(), self.player.scene.object.p_OOcm)
        if not np.isfinite(slip + turn):
            raise RuntimeError("the object's pose is not finite")
        self.slip, self.turn = max(self.slip, slip), max(self.turn, turn)

    def problem(self, test: HoldTest) -> str:
        """The bound that is not met; empty where both are."""
        if self.slip >= test.max_slip_m:
            return "slipped"
        return "turned" if self.turn >= test.max_turn_rad else ""


def play_hold(grip: Grip, test: HoldTest, cpu_end: float) -> Hold:
    """Goes on after a lift that succeeded, until a bound is not met.

    Args:
        grip: Slip and turn since the end of the squeeze; its simulator is at the end of the lift.
        test: What comes.
        cpu_end: Processor time at which it is given up [s].

    Returns:
        The verdict. Its reason is `slipped`, `turned`, `simulation_failed` or `timeout`, a colon, and when: `lift`,
        `still`, or the name of a push.
    """
    player, phase, problem = grip.player, "lift", grip.problem(test)
    step = player.protocol.plant.time_step
    begin = round(player.protocol.duration_s / step)
    end = begin + round(test.still_s / step)
    try:
        if not problem:
            phase, problem = "still", _advance(grip, test, range(begin + 1, end + 1), cpu_end)
        state = None if problem else player.state()
        for name, direction in {} if problem else PUSHES.items():
            phase = name
            player.restore(state)
            problem = _push(grip, test, direction, end, cpu_end)
            if problem:
                break
    except RuntimeError as error:
        _log.info("hold, %s: %s", phase, error)
        problem = "simulation_failed"
    return Hold(not problem, f"{problem}:{phase}" if problem else "", grip.slip, grip.turn)


def _push(grip: Grip, test: HoldTest, direction: Array, begin: int, cpu_end: float) -> str:
    """Pushes along a direction from a step on, with a ramp; returns the bound that was not met."""
    player, step = grip.player, grip.player.protocol.plant.time_step
    force = test.weights * player.scene.object.mass * GRAVITY * direction
    ramp, rest = round(test.ramp_s / step), round(test.push_s / step)
    try:
        for k in range(1, ramp + 1):
            player.push(k / ramp * force)
            player.advance_to((begin + k) * step)
        return _advance(grip, test, range(begin + ramp, begin + ramp + rest + 1), cpu_end)
    finally:
        player.push(np.zeros(3))


def _advance(grip: Grip, test: HoldTest, steps: range, cpu_end: float) -> str:
    """Simulates some steps, the last of them included; returns the bound that was not met."""
    step = grip.player.protocol.plant.time_step
    for k in sorted({*steps[::LOOK_STEPS], steps[-1]}):
        grip.player.advance_to(k * step)
        grip.look()
        if problem := grip.problem(test):
            return problem
        if time.process_time() > cpu_end:
            return "timeout"
    return ""
