"""Stored grasps, one by one: carried to other hands, or lifted again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

from xdex_drake.dataset.files import SceneFacts
from xdex_drake.grasp import Grasp, Lift

if TYPE_CHECKING:
    from xdex_drake.grasping.finish import Outcome
    from xdex_drake.hand.description import Hand
    from xdex_drake.scene.tabletop import Scene
    from xdex_drake.simulation.lift import LiftRig


@dataclass(frozen=True)
class RetargetUnit:
    """A stored grasp that shall be carried to another hand.

    Attributes:
        index: Its place in the file.
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
    """A stored grasp that shall be lifted again.

    Attributes:
        index: Its place in the file.
        grasp: The grasp.
        scene: Its scene.
        hand: Name or path of its hand.
        protocol: Name of the protocol.
        robust: Number of errors of pose under which it is repeated; 0 for one lift as it is.
    """

    index: int
    grasp: Grasp
    scene: SceneFacts
    hand: str
    protocol: str = "lift-0.2/2tips"
    robust: int = 0


def run_retarget(unit: RetargetUnit) -> Outcome:
    """Retargets a stored grasp and lifts the result.

    Args:
        unit: The grasp and the target.

    Returns:
        The lifted grasp, or the reason why there is none.
    """
    import torch

    from xdex_drake.grasping.finish import Outcome
    from xdex_drake.grasping.retarget import retarget
    from xdex_drake.hand.library import load_hand
    from xdex_drake.simulation.lift import simulate_lift

    torch.set_num_threads(1)
    scene = _scene(unit.scene)
    source, target = load_hand(unit.source), load_hand(unit.target)
    outcome = retarget(unit.grasp, source, target, scene)
    if outcome.grasp is None:
        return outcome
    lift = simulate_lift(_rig(unit.target, unit.scene), outcome.grasp)
    name = outcome.grasp.grasp_id or f"{unit.grasp.grasp_id}-{target.name}"
    source_id = outcome.grasp.source_grasp_id or unit.grasp.grasp_id
    return Outcome(replace(outcome.grasp, lift=lift, grasp_id=name, source_grasp_id=source_id), "")


def run_lift(unit: LiftUnit) -> Lift:
    """Lifts a stored grasp.

    Args:
        unit: The grasp.

    Returns:
        The verdict.
    """
    from xdex_drake.simulation.lift import lift
    from xdex_drake.simulation.protocol import find_protocol
    from xdex_drake.simulation.robust import RobustSettings, robust_lift

    hand, scene, protocol = _hand(unit.hand), _scene(unit.scene), find_protocol(unit.protocol)
    if unit.robust:
        return robust_lift(
            unit.grasp, hand, scene, protocol=protocol, settings=RobustSettings(repeats=unit.robust)
        ).lift
    return lift(unit.grasp, hand, scene, protocol=protocol)


def lost_lift(unit: LiftUnit, failure: str) -> Lift:
    """The verdict of a lift whose process crashed or took too long: it failed.

    Args:
        unit: The lift.
        failure: What happened to it.

    Returns:
        The verdict.
    """
    from xdex_drake.simulation.hold import NOT_LIFTED
    from xdex_drake.simulation.protocol import find_protocol

    reason = "timeout" if failure.startswith("timeout") else "simulation_failed"
    name = f"robust:{unit.protocol}" if unit.robust else unit.protocol
    hold = None if find_protocol(unit.protocol).hold is None else NOT_LIFTED
    return Lift(name, False, reason, float("nan"), (), 0.0, hold)


@lru_cache(maxsize=4)
def _hand(hand: str) -> Hand:
    from xdex_drake.hand.library import load_hand

    return load_hand(hand)


@lru_cache(maxsize=4)
def _scene(scene: SceneFacts) -> Scene:
    return scene.build()


@lru_cache(maxsize=4)
def _rig(hand: str, scene: SceneFacts) -> LiftRig:
    from xdex_drake.hand.library import load_hand
    from xdex_drake.simulation.lift import lift_rig

    return lift_rig(load_hand(hand), _scene(scene))
