"""What units of work share in a process: hands, scenes and rigs by plain facts, made once, a bounded number kept."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from xdex_drake.scene.facts import SceneFacts

if TYPE_CHECKING:
    from xdex_drake.hand.description import Hand
    from xdex_drake.scene.tabletop import Scene
    from xdex_drake.simulation.drake import LiftRig
    from xdex_drake.simulation.protocol import LiftProtocol


@lru_cache(maxsize=16)
def hand_of(name: str) -> Hand:
    """The hand of a name or path; see `load_hand`."""
    from xdex_drake.hand.library import load_hand

    return load_hand(name)


@lru_cache(maxsize=4)
def scene_of(facts: SceneFacts) -> Scene:
    """The scene of some facts; see `SceneFacts.build`."""
    return facts.build()


def rig_of(hand: str, facts: SceneFacts, protocol: LiftProtocol | None = None) -> LiftRig:
    """The lift rig of a hand and a scene; see `simulation.drake.shared_rig`."""
    from xdex_drake.simulation.drake import shared_rig

    return shared_rig(hand_of(hand), scene_of(facts), protocol=protocol)


def use_one_thread() -> None:
    """Has torch use one thread in this process, so that sums have one order and a seed gives the same grasps."""
    import torch

    torch.set_num_threads(1)
