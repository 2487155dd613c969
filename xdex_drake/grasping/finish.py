"""Finishes a candidate: a certified grasp with pre-grasp, approach and squeeze, or the reason why there is none."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.contact.certificate import certify
from xdex_drake.contact.cones import contact_frames, effort_map
from xdex_drake.contact.grasp_map import Effort
from xdex_drake.contact.held_object import HeldObject
from xdex_drake.contact.penetration import penetration_depth
from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Certificate, Grasp
from xdex_drake.grasping.approach import straight_approach
from xdex_drake.grasping.idle import rest_idle_fingers
from xdex_drake.grasping.pregrasp import pregrasp
from xdex_drake.grasping.proposers import Candidate
from xdex_drake.grasping.reasons import Reason, Rejection
from xdex_drake.grasping.squeeze import squeeze
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.point import Point
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.solve import solve
from xdex_drake.scene.distance import sample_surface
from xdex_drake.scene.object import ObjectModel
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LIFT, LiftProtocol

SURFACE_POINTS = 4096
"""Points of the object's surface at which penetration is measured."""


@dataclass(frozen=True)
class Demands:
    """What a certified grasp must meet.

    Attributes:
        squeezes: Fractions of the friction and least normal forces [in units of m g] that the certificate's forces try
            in turn.
        task_margin: Least task margin of three or more contacts. (Pinches have little or none.)
        penetration_m: Deepest penetration, against the parts [m].
    """

    squeezes: tuple[tuple[float, float], ...] = ((0.55, 1.5), (0.7, 1.0), (0.85, 0.5))
    task_margin: float = 0.0
    penetration_m: float = 1e-3


GIVEN = Demands()
"""For other hands' grasps and predictions: better a weak grasp than none."""


SEARCHED = Demands(squeezes=((0.55, 1.5),), task_margin=1.01)
"""For grasps that a search finds, since it finds more. Measured on Allegro: of grasps whose forces need at most 0.55 of
the friction 84 % lift, on meshes where half lift of those that need up to 0.7, and 29 % of the others
(`studies/force_closure`); 87 % lift of those with a task margin above 1, and 63 % of those below, which do not even
resist a push of their own weight (`studies/margins`)."""


@dataclass(frozen=True)
class Outcome:
    """What became of one candidate.

    Attributes:
        grasp: The certified grasp, None where there is none.
        reason: Why there is none; None where there is one.
    """

    grasp: Grasp | None
    reason: Rejection | None = None


@lru_cache(maxsize=8)
def _surface_points(obj: ObjectModel) -> tuple[Array, Array]:
    """Points of the surface of the parts and of the mesh, in O."""
    return (
        sample_surface(*obj.surface, SURFACE_POINTS, 0)[0],
        sample_surface(obj.vertices, obj.faces, SURFACE_POINTS, 0)[0],
    )


def penetrations(hand: Hand, k: Configuration, scene: Scene) -> tuple[float, float]:
    """Depth of the deepest object surface point in the hand, against the parts and against the mesh.

    Args:
        hand: The hand.
        k: Its configuration.
        scene: The scene.

    Returns:
        Depth against the convex parts and against the mesh [m].
    """
    parts, mesh = _surface_points(scene.object)
    return (
        float(penetration_depth(hand, k.R_WLs, k.p_WLs, (scene.X_WO @ parts.T).T)),
        float(penetration_depth(hand, k.R_WLs, k.p_WLs, (scene.X_WO @ mesh.T).T)),
    )


def finish_grasp(hand: Hand, point: Point, *, protocol: LiftProtocol = LIFT, demands: Demands = GIVEN) -> Outcome:
    """Certifies a polished point, measures its penetration and prepares its lift.

    Args:
        hand: The hand.
        point: A point whose contacts touch.
        protocol: The protocol whose gains the squeeze is for.
        demands: What the grasp must meet.

    Returns:
        The grasp, or the reason why there is none.

    Raises:
        ConfigError: The point is of another hand.
    """
    scene, k = point.scene, point.k
    if k.hand is not hand and k.hand.name != hand.name:
        raise ConfigError(f"the point is of hand {k.hand.name!r}, not of {hand.name!r}; give its own hand")
    R_OW = scene.X_WO.rotation().matrix().T
    p_WCs, n_WCs = point.exact_contacts()
    p_OCs = (p_WCs - scene.X_WO.translation()) @ R_OW.T
    n_OCs = n_WCs @ R_OW.T
    links = [hand.links[link].name for link in point.contacts.links]
    held = HeldObject.of(scene)
    J = k.jacobian(point.contacts.links, p_WCs)[:, :, 6:]
    effort = Effort(effort_map(J, held.R_WO @ contact_frames(n_OCs)), hand.effort)
    result = None
    for safety, least in demands.squeezes:
        result = certify(p_OCs, n_OCs, links, held, effort=effort, safety=safety, min_normal=least * held.weight)
        if result.certificate is not None:
            break
    assert result is not None
    if result.certificate is None:
        return Outcome(None, Rejection(Reason.CERTIFICATE, result.reason))
    if len(links) > 2 and result.certificate.task_margin < demands.task_margin:
        return Outcome(None, Rejection(Reason.TASK_MARGIN))
    rested = rest_idle_fingers(hand, scene, k, links)
    outcome = prepared(hand, scene, rested, result.certificate, protocol=protocol, demands=demands)
    if outcome.grasp is None and rested is not k:
        # Idle fingers near the object may bar the way to it: then they stay as they were.
        return prepared(hand, scene, k, result.certificate, protocol=protocol, demands=demands)
    return outcome


def prepared(
    hand: Hand, scene: Scene, k: Configuration, certificate: Certificate, *, protocol: LiftProtocol, demands: Demands
) -> Outcome:
    """Measures the penetration of a certified grasp, opens it and squeezes it.

    Args:
        hand: The hand.
        scene: The scene.
        k: The grasp's configuration.
        certificate: Its certificate.
        protocol: The protocol whose gains the squeeze is for.
        demands: What the grasp must meet.

    Returns:
        The grasp, or the reason why there is none.
    """
    depth_parts, depth_mesh = penetrations(hand, k, scene)
    if depth_parts > demands.penetration_m:
        return Outcome(None, Rejection(Reason.PENETRATION))
    opened = pregrasp(hand, scene, k.X_WH, k.q)
    if opened.clearance < 1e-3:
        return Outcome(None, Rejection(Reason.PREGRASP))
    if straight_approach(hand, scene, opened.X_WH, opened.q) is None:
        return Outcome(None, Rejection(Reason.APPROACH))
    grasp = Grasp(
        hand=hand.name,
        object=scene.object.name,
        X_WO=scene.X_WO,
        X_WH=k.X_WH,
        q=np.clip(k.q, hand.limits[0], hand.limits[1]),
        certificate=certificate,
        X_WH_pregrasp=opened.X_WH,
        q_pregrasp=opened.q,
        penetration_parts_m=depth_parts,
        penetration_mesh_m=depth_mesh,
    )
    return Outcome(squeeze(hand, grasp, scene, protocol.plant.kp))


def polish(
    program: GraspProgram,
    *,
    solver: str = "sequential",
    protocol: LiftProtocol = LIFT,
    demands: Demands = GIVEN,
) -> Outcome:
    """Solves a program and finishes the grasp; see `finish_grasp`."""
    start = time.perf_counter()
    # Posture and effort are preferences, not goals: the first point that holds is as good as the nearest one.
    result = solve(program, solver=solver, improvement=np.inf)
    if not result.success:
        return Outcome(None, Rejection(Reason.CONSTRAINT, result.worst))
    outcome = finish_grasp(program.hand, result.point, protocol=protocol, demands=demands)
    if outcome.grasp is None:
        return outcome
    return Outcome(replace(outcome.grasp, seconds=time.perf_counter() - start))


def finish(
    candidate: Candidate,
    *,
    solver: str = "sequential",
    protocol: LiftProtocol = LIFT,
    demands: Demands = GIVEN,
) -> Outcome:
    """Makes of a candidate a certified grasp, or says why there is none.

    Args:
        candidate: The candidate; its programs are solved in turn.
        solver: Solver of the programs.
        protocol: The protocol whose gains the squeeze is for.
        demands: What the grasp must meet.

    Returns:
        The first program's grasp, named by the candidate, its share of the proposer's time included; where no program
        ends in a grasp, the last one's reason.
    """
    outcome = None
    for program in candidate.programs():
        outcome = polish(program, solver=solver, protocol=protocol, demands=demands)
        if outcome.grasp is not None:
            grasp = replace(
                outcome.grasp,
                grasp_id=candidate.name,
                source_grasp_id=candidate.source_grasp_id,
                seconds=outcome.grasp.seconds + candidate.seconds,
            )
            return Outcome(grasp)
    assert outcome is not None, "a candidate has at least one program"
    return outcome
