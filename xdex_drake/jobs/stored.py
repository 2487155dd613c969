"""Stored grasps, one by one: carried to other hands, or lifted again."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from xdex_drake.grasp import Grasp, Lift
from xdex_drake.jobs.ordered import in_order
from xdex_drake.jobs.processes import Failure, FailureKind
from xdex_drake.jobs.workbench import hand_of, rig_of, scene_of, use_one_thread
from xdex_drake.scene.facts import SceneFacts

if TYPE_CHECKING:
    from xdex_drake.dataset.files import StoredGrasp
    from xdex_drake.grasping.finish import Outcome

_log = logging.getLogger(__name__)

SIMULATORS = {"drake": "xdex_drake.simulation.drake", "mujoco": "xdex_drake.simulation.mujoco"}
"""The module of each simulator's `lift`."""


@dataclass(frozen=True)
class RetargetUnit:
    """A grasp that shall be carried to another hand.

    Attributes:
        index: Its place among the grasps.
        grasp: The grasp.
        scene: Its scene.
        source: Name or path of its hand.
        target: Name or path of the other hand.
    """

    index: int
    grasp: Grasp
    scene: SceneFacts
    source: str
    target: str


@dataclass(frozen=True)
class LiftUnit:
    """A grasp that shall be lifted again.

    Attributes:
        index: Its place among the grasps.
        grasp: The grasp.
        scene: Its scene.
        hand: Name or path of its hand.
        protocol: Name of the protocol; empty for that of `usual_protocol`.
        robust: Number of errors of pose under which it is repeated; 0 for one lift as it is.
        simulator: One of `SIMULATORS`.
    """

    index: int
    grasp: Grasp
    scene: SceneFacts
    hand: str
    protocol: str = ""
    robust: int = 0
    simulator: str = "drake"


def retarget_units(stored: Sequence[StoredGrasp], targets: Sequence[str]) -> list[RetargetUnit]:
    """Every grasp to every target, target by target.

    Args:
        stored: Grasps of a file.
        targets: Names or paths of the other hands.

    Returns:
        The units; their index is the grasp's place in `stored`.
    """
    return [
        RetargetUnit(k, item.grasp, item.facts, item.hand_path, target)
        for target in targets
        for k, item in enumerate(stored)
    ]


def retarget_all(units: Sequence[RetargetUnit], *, workers: int = 2) -> Iterator[tuple[RetargetUnit, Outcome]]:
    """Retargets grasps and lifts the results.

    Args:
        units: Grasps and targets.
        workers: Number of processes; 0 works in this one.

    Yields:
        Each unit with what became of it, in order; one whose process crashed or took too long is told and left out.
    """
    for done in in_order(units, run_retarget, workers=min(workers, len(units))):
        if done.value is None:
            _log.warning("grasp %d to %s: %s", done.unit.index, done.unit.target, done.failure)
        else:
            yield done.unit, done.value


def lift_units(
    stored: Sequence[StoredGrasp],
    *,
    protocol: str = "",
    robust: int = 0,
    simulators: Sequence[str] = ("drake",),
) -> list[LiftUnit]:
    """Every grasp once for each simulator, those of one hand and scene in a row, so that they share a rig.

    Args:
        stored: Grasps of a file.
        protocol: Name of the protocol; empty for that of `usual_protocol`.
        robust: Number of errors of pose under which each lift is repeated; 0 for one lift as it is.
        simulators: Names of `SIMULATORS`.

    Returns:
        The units; their index is the grasp's place in `stored`.
    """
    units = [
        LiftUnit(k, item.grasp, item.facts, item.hand_path, protocol, robust, simulator)
        for simulator in simulators
        for k, item in enumerate(stored)
    ]
    return sorted(units, key=lambda unit: (unit.hand, unit.scene.scene_id, simulators.index(unit.simulator)))


def lift_all(units: Sequence[LiftUnit], *, workers: int = 2) -> Iterator[tuple[LiftUnit, Lift]]:
    """Lifts grasps.

    Args:
        units: The grasps.
        workers: Number of processes; 0 works in this one.

    Yields:
        Each unit with its verdict, in order; one whose process crashed or took too long has failed.
    """
    for done in in_order(units, run_lift, workers=min(workers, len(units))):
        if done.value is None:
            assert done.failure is not None
            _log.warning("grasp %d: %s", done.unit.index, done.failure)
            yield done.unit, lost_lift(done.unit, done.failure)
        else:
            yield done.unit, done.value


def run_retarget(unit: RetargetUnit) -> Outcome:
    """Retargets a grasp and lifts the result.

    Args:
        unit: The grasp and the target.

    Returns:
        The lifted grasp, or the reason why there is none.
    """
    from xdex_drake.grasping.finish import Outcome
    from xdex_drake.grasping.retarget import retarget
    from xdex_drake.simulation.drake import simulate_lift

    use_one_thread()
    outcome = retarget(unit.grasp, hand_of(unit.source), hand_of(unit.target), scene_of(unit.scene))
    if outcome.grasp is None:
        return outcome
    return Outcome(replace(outcome.grasp, lift=simulate_lift(rig_of(unit.target, unit.scene), outcome.grasp)))


def run_lift(unit: LiftUnit) -> Lift:
    """Lifts a grasp.

    Args:
        unit: The grasp.

    Returns:
        The verdict.
    """
    from xdex_drake.simulation.protocol import LiftProtocol, find_protocol, usual_protocol
    from xdex_drake.simulation.robust import RobustSettings, robust_lift

    hand, scene = hand_of(unit.hand), scene_of(unit.scene)
    protocol = find_protocol(unit.protocol) if unit.protocol else usual_protocol(scene)
    lift = importlib.import_module(SIMULATORS[unit.simulator]).lift
    if unit.robust and isinstance(protocol, LiftProtocol):
        settings = RobustSettings(repeats=unit.robust)
        return robust_lift(unit.grasp, hand, scene, protocol=protocol, settings=settings, lift=lift).lift
    return lift(unit.grasp, hand, scene, protocol=protocol)


def lost_lift(unit: LiftUnit, failure: Failure) -> Lift:
    """The verdict of a lift whose process crashed or took too long: it failed.

    Args:
        unit: The lift.
        failure: What happened to it.

    Returns:
        The verdict.
    """
    from xdex_drake.simulation.hold import NOT_LIFTED
    from xdex_drake.simulation.protocol import LIFT, RELEASE, find_protocol

    usual = LIFT if unit.scene.table is not None else RELEASE
    protocol = find_protocol(unit.protocol) if unit.protocol else usual
    reason = "timeout" if failure.kind is FailureKind.TIMEOUT else "simulation_failed"
    name = protocol.name if unit.simulator == "drake" else f"{unit.simulator}:{protocol.name}"
    name = f"robust:{name}" if unit.robust else name
    hold = None if protocol.hold is None else NOT_LIFTED
    return Lift(name, False, reason, float("nan"), (), 0.0, hold)
