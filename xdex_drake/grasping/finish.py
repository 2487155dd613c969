"""Finishes a candidate: a certified grasp with pre-grasp, approach and squeeze, or the reason why there is none."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.contact.certificate import certify, with_forces
from xdex_drake.contact.cones import contact_frames, effort_map
from xdex_drake.contact.grasp_map import Effort
from xdex_drake.contact.held_object import HeldObject
from xdex_drake.contact.penetration import penetration_depth
from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Certificate, Grasp
from xdex_drake.grasping.approach import straight_approach
from xdex_drake.grasping.idle import rest_idle_fingers
from xdex_drake.grasping.passive import HoldingSqueeze, holding_squeeze
from xdex_drake.grasping.pregrasp import pregrasp
from xdex_drake.grasping.proposers import Candidate
from xdex_drake.grasping.reasons import Reason, Rejection
from xdex_drake.grasping.squeeze import squeezed
from xdex_drake.grasping.true_shapes import clear, lowest_height, touch
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.point import Point
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.solve import solve
from xdex_drake.programs.terms.surroundings import obstacle_gap
from xdex_drake.scene.distance import sample_surface
from xdex_drake.scene.object import ObjectModel
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LIFT, LiftProtocol

SURFACE_POINTS = 4096
"""Points of the object's surface, of parts and of mesh each, at which penetration and clearance are measured."""

PREGRASP_GAP = 1e-3
"""Least gap between the hand's shapes at the pre-grasp and these points [m]."""


@dataclass(frozen=True)
class Demands:
    """What a certified grasp must meet.

    Attributes:
        squeezes: Fractions of the friction and least normal forces [in units of m g] that the certificate's forces try
            in turn.
        task_margin: Least task margin of three or more contacts. (Pinches have little or none.)
        touch_m: Greatest gap between the hand's shapes and the mesh at a contact [m].
        smoothing_m: Greatest distance of parts and mesh at a contact [m].
        penetration_m: Deepest penetration, against parts and mesh alike [m].
        table_m: Least height of the hand's shapes above the table, at grasp and pre-grasp [m].
        foretold: Greatest motion under pushes that is foretold, as a logarithm: above zero the object leaves the bounds
            of the protocol `hold`; see `passive.foretold_motion`.
    """

    squeezes: tuple[tuple[float, float], ...] = ((0.55, 1.5), (0.7, 1.0), (0.85, 0.5))
    task_margin: float = 0.0
    touch_m: float = 3e-4
    smoothing_m: float = 5e-4
    penetration_m: float = 5e-4
    table_m: float = 2e-4
    foretold: float = float("inf")


GIVEN = Demands()
"""For other hands' grasps and predictions: better a weak grasp than none."""


SEARCHED = Demands(squeezes=((0.55, 1.5),), task_margin=1.01, foretold=0.0)
"""For grasps that a search finds, since it finds more. Measured on Allegro: of grasps whose forces need at most 0.55 of
the friction 84 % lift, on meshes where half lift of those that need up to 0.7, and 29 % of the others
(`studies/force_closure`); 87 % lift of those with a task margin above 1, and 63 % of those below, which do not even
resist a push of their own weight (`studies/margins`). Of lifted grasps that are foretold to hold, 86 % are held
and pushed without loss, and 64 % of all (`studies/holds`)."""


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


def certified(hand: Hand, point: Point, demands: Demands) -> tuple[Configuration, Certificate] | Rejection:
    """Lets the contacts of a point touch, and certifies them.

    Args:
        hand: The hand.
        point: A point whose contacts touch, as spheres on the parts.
        demands: What the grasp must meet.

    Returns:
        The configuration whose shapes touch the mesh, and the certificate there; or the reason why there is none.
    """
    scene, touches = point.scene, touch(hand, point)
    if np.abs(touches.gaps).max(initial=0.0) > demands.touch_m:
        return Rejection(Reason.TOUCH)
    if touches.smoothing.max(initial=0.0) > demands.smoothing_m:
        return Rejection(Reason.SURFACE)
    k, p_WCs, R_WO = touches.k, touches.p_WCs, scene.X_WO.rotation().matrix()
    p_OCs, n_OCs = (p_WCs - scene.X_WO.translation()) @ R_WO, touches.n_WCs @ R_WO
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
        return Rejection(Reason.CERTIFICATE, result.reason)
    if len(links) > 2 and result.certificate.task_margin < demands.task_margin:
        return Rejection(Reason.TASK_MARGIN)
    return k, result.certificate


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
    if point.k.hand is not hand and point.k.hand.name != hand.name:
        raise ConfigError(f"the point is of hand {point.k.hand.name!r}, not of {hand.name!r}; give its own hand")
    found = certified(hand, point, demands)
    if isinstance(found, Rejection):
        return Outcome(None, found)
    (k, certificate), scene = found, point.scene
    # Rejects most, and does not depend on idle fingers.
    holding = holding_squeeze(hand, k, scene, certificate, kp=protocol.plant.kp)
    if holding.foretold > demands.foretold:
        return Outcome(None, Rejection(Reason.HOLD))
    rested = rest_idle_fingers(hand, scene, k, [contact.link for contact in certificate.contacts])
    outcome = prepared(hand, scene, rested, certificate, holding, protocol=protocol, demands=demands)
    if outcome.grasp is not None or rested is k:
        return outcome
    # Idle fingers near the object may bar the way to it: then they stay as they were.
    return prepared(hand, scene, k, certificate, holding, protocol=protocol, demands=demands)


def prepared(
    hand: Hand,
    scene: Scene,
    k: Configuration,
    certificate: Certificate,
    holding: HoldingSqueeze,
    *,
    protocol: LiftProtocol,
    demands: Demands,
) -> Outcome:
    """Measures the penetration of a certified grasp, opens it and squeezes it.

    Args:
        hand: The hand.
        scene: The scene.
        k: The grasp's configuration.
        certificate: Its certificate.
        holding: Its squeeze.
        protocol: The protocol whose gains the squeeze is for.
        demands: What the grasp must meet.

    Returns:
        The grasp with the forces of its squeeze in its certificate, or the reason why there is none.
    """
    depth_parts, depth_mesh = penetrations(hand, k, scene)
    if max(depth_parts, depth_mesh) > demands.penetration_m:
        return Outcome(None, Rejection(Reason.PENETRATION))
    if lowest_height(hand, k) - scene.floor < demands.table_m:
        return Outcome(None, Rejection(Reason.CONSTRAINT, "table"))
    if obstacle_gap(k, scene) < 0.0:
        return Outcome(None, Rejection(Reason.CONSTRAINT, "obstacle"))
    opened = pregrasp(hand, scene, k.X_WH, k.q)
    open_k, surface = Configuration.at(hand, opened.X_WH, opened.q), np.concatenate(_surface_points(scene.object))
    if not clear(hand, open_k, (scene.X_WO @ surface.T).T, PREGRASP_GAP):
        return Outcome(None, Rejection(Reason.PREGRASP))
    if lowest_height(hand, open_k) - scene.floor < demands.table_m:
        return Outcome(None, Rejection(Reason.PREGRASP, "table"))
    if obstacle_gap(open_k, scene) < 0.0:
        return Outcome(None, Rejection(Reason.PREGRASP, "obstacle"))
    if straight_approach(hand, scene, opened.X_WH, opened.q) is None:
        return Outcome(None, Rejection(Reason.APPROACH))
    squeeze = holding.squeeze
    grasp = Grasp(
        hand=hand.name,
        object=scene.object.name,
        X_WO=scene.X_WO,
        X_WH=k.X_WH,
        q=np.clip(k.q, hand.limits[0], hand.limits[1]),
        certificate=with_forces(certificate, squeeze.f),
        X_WH_pregrasp=opened.X_WH,
        q_pregrasp=opened.q,
        penetration_parts_m=depth_parts,
        penetration_mesh_m=depth_mesh,
        squeeze_margin=squeeze.elastic_margin,
        stiffness_least=squeeze.object_eigenvalue,
        foretold_motion=holding.foretold,
    )
    return Outcome(squeezed(hand, grasp, squeeze.torques, protocol.plant.kp))


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
        if isinstance(program, Grasp):
            outcome = Outcome(program)
        elif isinstance(program, Rejection):
            outcome = Outcome(None, program)
        else:
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
