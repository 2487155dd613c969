"""Carries a grasp from one hand to another and finishes it: certificate, pre-grasp, squeeze."""

from __future__ import annotations

from dataclasses import replace

from xdex_drake.grasp import Grasp
from xdex_drake.grasping.finish import Outcome, polish
from xdex_drake.hand.description import Hand
from xdex_drake.programs.force_closure import PolishSettings
from xdex_drake.programs.retargeting import refined_start, retargeting_program
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
) -> Outcome:
    """Retargets one grasp by Eq. (2) under the constraints of force closure.

    Args:
        grasp: The source grasp.
        source_hand: Its hand.
        target: The target hand.
        scene: Their scene.
        settings: Numbers of the hard constraints; the defaults where None.
        protocol: The protocol whose gains the squeeze is for.

    Returns:
        The target's grasp, not lifted yet, or the reason why there is none.
    """
    program = retargeting_program(grasp, source_hand, target, scene, settings=settings)
    outcome = polish(program, protocol=protocol)
    if outcome.grasp is None:
        # Hands that differ much start deep in the object, from where local convex steps do not get out.
        start = refined_start(grasp, source_hand, target, scene)
        program = retargeting_program(grasp, source_hand, target, scene, start=start, settings=settings)
        outcome = polish(program, protocol=protocol)
    if outcome.grasp is None:
        return outcome
    named = replace(
        outcome.grasp, grasp_id=f"{grasp.grasp_id}>{target.name}", source_grasp_id=grasp.grasp_id or "unnamed"
    )
    return Outcome(named, "")
