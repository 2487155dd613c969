"""Rigs that are built once for a hand, a scene and a protocol, and kept."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

from xdex_drake.hand.description import Hand
from xdex_drake.hand.yaml_file import hand_digest
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LiftProtocol

Rig = TypeVar("Rig")

RIGS = 4
"""How many rigs are kept, of all simulators together; one takes a few megabytes."""

_rigs: OrderedDict[tuple, Any] = OrderedDict()


def shared(build: Callable[[], Rig], kind: str, hand: Hand, scene: Scene, protocol: LiftProtocol) -> Rig:
    """The rig of a hand and a scene, built once and kept.

    Args:
        build: Builds it.
        kind: Name of what is built, such as the simulator's.
        hand: The hand.
        scene: The object on its table.
        protocol: The protocol.

    Returns:
        A rig of this process; at most `RIGS` are kept, those that were used last. Not for use by several threads.
    """
    model = scene.object
    pose = scene.X_WO.GetAsMatrix34().tobytes()
    around = (scene.table, *((f.object.digest, f.X_WF.GetAsMatrix34().tobytes()) for f in scene.obstacles))
    physics = (model.digest, model.mass, model.friction, pose)
    key = (kind, _digest_by_identity(_Identity(hand)), *physics, around, protocol)
    rig = _rigs.pop(key, None) or build()
    _rigs[key] = rig
    while len(_rigs) > RIGS:
        _rigs.popitem(last=False)
    return rig


@dataclass(frozen=True, eq=False)
class _Identity:
    """A hand that is compared by identity: its digest takes as long as a tenth of a lift."""

    hand: Hand

    def __hash__(self) -> int:
        return id(self.hand)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Identity) and other.hand is self.hand


@lru_cache(maxsize=RIGS)
def _digest_by_identity(identity: _Identity) -> str:
    return hand_digest(identity.hand)
