"""Carries a grasp from one hand to another and finishes it: certificate, pre-grasp, squeeze."""

from __future__ import annotations

from xdex_drake.grasp import Grasp
from xdex_drake.grasping.finish import Outcome, finish
from xdex_drake.grasping.proposers import Retarget
from xdex_drake.hand.description import Hand
from xdex_drake.programs.force_closure import PolishSettings
from xdex_drake.programs.retargeting import RETRY, RetrySettings
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LIFT, LiftProtocol


def retarget(
    grasp: Grasp,
    source_hand: Hand,
    target: Hand,
    scene: Scene,
    *,
    settings: PolishSettings | None = None,
    protocol: LiftProtocol = LIFT,
    retry: RetrySettings = RETRY,
    seed: int = 0,
) -> Outcome:
    """Retargets one grasp by Eq. (2) under the constraints of force closure.

    The first start is the kinematic one, the second the same after a short descent; where neither ends in a grasp,
    jittered starts follow, some of which touch with other fingers.

    Args:
        grasp: The source grasp.
        source_hand: Its hand.
        target: The target hand.
        scene: Their scene.
        settings: Numbers of the hard constraints; the defaults where None.
        protocol: The protocol whose gains the squeeze is for.
        retry: How it is tried again where it does not carry over as it is.
        seed: Seed of the jittered starts.

    Returns:
        The target's grasp, not lifted yet, or the reason why there is none.
    """
    (candidate,) = Retarget((grasp,), source_hand, settings, retry)(target, scene, count=1, seed=seed)
    return finish(candidate, protocol=protocol)
