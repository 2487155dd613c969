"""From hand and scene to certified grasps: search, polish, certify, pre-grasp, squeeze, lift."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from xdex_drake.contact.certificate import certify, contact_geometry
from xdex_drake.contact.cones import effort_map
from xdex_drake.contact.penetration import penetration_depth
from xdex_drake.grasp import Array, Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.force_closure import PolishSettings, program_of_candidate, wishes
from xdex_drake.programs.point import Point
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.search import SearchSettings, search
from xdex_drake.programs.solve import solve
from xdex_drake.scene.distance import sample_surface
from xdex_drake.scene.object import ObjectModel
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.lift import LiftRig, lift_rig, simulate_lift
from xdex_drake.simulation.pregrasp import pregrasp, squeeze_targets, straight_approach
from xdex_drake.simulation.protocol import LIFT, LiftProtocol

_log = logging.getLogger(__name__)

LENIENT_EVERY = 3
"""One batch in so many is lenient; see `settings_of_batch`."""

WINDOW = 8
"""Candidates over which `worth_going_on` takes the rate at the margin."""

SEARCH_COST = 0.25
"""What a candidate of a search costs, in polished ones."""

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
class SynthesisSettings:
    """Settings of synthesis.

    Attributes:
        search: Settings of the batched search.
        polish: Numbers of the hard constraints.
        batch: Candidates of one search.
        solver: Solver of the polish.
        demands: What grasps must meet that a search finds.
    """

    search: SearchSettings = field(default_factory=SearchSettings)
    polish: PolishSettings = field(default_factory=lambda: PolishSettings(friction_fraction=0.5))
    batch: int = 80
    solver: str = "sequential"
    demands: Demands = SEARCHED


@dataclass(frozen=True)
class Outcome:
    """What became of one candidate.

    Attributes:
        grasp: The certified grasp, None where there is none.
        reason: Why there is none: the constraint that could not be met, "certificate: ...", "task margin",
            "penetration", "pregrasp" (no clearance), or "approach" (no straight way of 10 cm to the pre-grasp).
    """

    grasp: Grasp | None
    reason: str


@dataclass
class Tally:
    """Counts and seconds of a synthesis, for its closing table.

    Attributes:
        tried: Candidates polished.
        certified: Candidates that were certified.
        lifted: Certified grasps that lifted.
        rejected: How often each reason rejected a candidate.
        failed: How often each reason failed a lift.
        seconds: Wall time.
    """

    tried: int = 0
    certified: int = 0
    lifted: int = 0
    rejected: dict[str, int] = field(default_factory=dict)
    failed: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0


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
    """
    scene, k, obj = point.scene, point.k, point.scene.object
    R_OW = scene.X_WO.rotation().matrix().T
    p_WCs, n_WCs = point.exact_contacts()
    p_OCs = (p_WCs - scene.X_WO.translation()) @ R_OW.T
    n_OCs = n_WCs @ R_OW.T
    links = [hand.links[link].name for link in point.contacts.links]
    weight = obj.mass * 9.81
    result = None
    for safety, least in demands.squeezes:
        result = certify(
            p_OCs,
            n_OCs,
            links,
            mu=obj.friction,
            mass=obj.mass,
            p_OOcm=obj.p_OOcm,
            length=obj.length,
            R_WO=scene.X_WO.rotation().matrix(),
            A=_effort_map(k, point, p_WCs, p_OCs, n_OCs),
            effort=hand.effort,
            safety=safety,
            min_normal=least * weight,
        )
        if result.certificate is not None:
            break
    assert result is not None
    if result.certificate is None:
        return Outcome(None, f"certificate: {result.reason}")
    if len(links) > 2 and result.certificate.task_margin < demands.task_margin:
        return Outcome(None, "task margin")
    depth_parts, depth_mesh = penetrations(hand, k, scene)
    if depth_parts > demands.penetration_m:
        return Outcome(None, "penetration")
    opened = pregrasp(hand, scene, k.X_WH, k.q)
    if opened.clearance < 1e-3:
        return Outcome(None, "pregrasp")
    if straight_approach(hand, scene, opened.X_WH, opened.q) is None:
        return Outcome(None, "approach")
    grasp = Grasp(
        hand=hand.name,
        object=obj.name,
        X_WO=scene.X_WO,
        X_WH=k.X_WH,
        q=np.clip(k.q, hand.limits[0], hand.limits[1]),
        certificate=result.certificate,
        X_WH_pregrasp=opened.X_WH,
        q_pregrasp=opened.q,
        penetration_parts_m=depth_parts,
        penetration_mesh_m=depth_mesh,
    )
    return Outcome(replace(grasp, q_squeeze=squeeze_targets(hand, grasp, scene, protocol.plant.kp)), "")


def _effort_map(k: Configuration, point: Point, p_WCs: Array, p_OCs: Array, n_OCs: Array) -> Array:
    """A = C^T J^T in the certificate's contact frames, shape (n, 3 nc)."""
    R_WCs, _ = contact_geometry(p_OCs, n_OCs, point.scene.X_WO.rotation().matrix(), point.scene.object.p_OOcm)
    return effort_map(k.jacobian(point.contacts.links, p_WCs)[:, :, 6:], R_WCs)


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
        return Outcome(None, result.worst)
    outcome = finish_grasp(program.hand, result.point, protocol=protocol, demands=demands)
    if outcome.grasp is None:
        return outcome
    return Outcome(replace(outcome.grasp, seconds=time.perf_counter() - start), "")


def candidates_of_batch(
    hand: Hand, scene: Scene, *, seed: int, settings: SynthesisSettings, tally: Tally
) -> Iterator[Grasp]:
    """Certified grasps of one batch: a search whose best candidates are polished and certified.

    Args:
        hand: The hand.
        scene: The scene.
        seed: Seed of the search.
        settings: Settings.
        tally: Counts to add to.

    Yields:
        Certified grasps, not yet lifted; their time includes their share of the search.
    """
    start = time.perf_counter()
    found = search(hand, scene, count=settings.batch, seed=seed, settings=settings.search)
    share = (time.perf_counter() - start) / settings.batch
    costs = wishes(hand, settings.search)
    hits: list[bool] = []
    for row in range(len(found.energy)):
        if not worth_going_on(hits, settings.batch):
            return
        tally.tried += 1
        program = program_of_candidate(hand, scene, found, row, settings=settings.polish, extra_costs=costs)
        outcome = polish(program, solver=settings.solver, demands=settings.demands)
        hits.append(outcome.grasp is not None)
        if outcome.grasp is None:
            tally.rejected[outcome.reason] = tally.rejected.get(outcome.reason, 0) + 1
            continue
        tally.certified += 1
        yield replace(outcome.grasp, grasp_id=str(row), seconds=outcome.grasp.seconds + share)


def worth_going_on(hits: Sequence[bool], batch: int) -> bool:
    """Whether the next candidates of a batch, best first, pay as well as a new batch would.

    Candidates of low energy are certified far more often than others: on most objects none after the first half. A
    forager's rule (Charnov, 1976): leave where the rate at the margin, over the last few candidates, falls below the
    average rate, the search included. It counts instead of timing, so that a seed gives the same grasps everywhere.

    Args:
        hits: Which candidates so far were certified.
        batch: Candidates of the search.

    Returns:
        Whether to go on.
    """
    tried, latest = len(hits), sum(hits[-WINDOW:])
    if tried < WINDOW:
        return True
    return latest * (SEARCH_COST * batch + tried) >= WINDOW * sum(hits) and latest > 0


def certified_grasps(
    hand: Hand,
    scene: Scene,
    *,
    seed: int = 0,
    time_limit_s: float = float("inf"),
    settings: SynthesisSettings | None = None,
    tally: Tally | None = None,
) -> Iterator[Grasp]:
    """Certified grasps, batch after batch.

    Args:
        hand: The hand.
        scene: The scene.
        seed: Seed.
        time_limit_s: Wall time after which no further batch is begun [s].
        settings: Settings; the defaults where None.
        tally: Counts to add to.

    Yields:
        Certified grasps, not yet lifted; see `candidates_of_batch`.
    """
    start = time.perf_counter()
    settings = settings or SynthesisSettings()
    tally = tally if tally is not None else Tally()
    batch = 0
    while time.perf_counter() - start < time_limit_s:
        grasps = candidates_of_batch(
            hand, scene, seed=batch_seed(seed, batch), settings=settings_of_batch(settings, batch), tally=tally
        )
        for grasp in grasps:
            yield replace(grasp, grasp_id=f"{hand.name}-{scene.object.name}-{seed}-{batch}-{grasp.grasp_id}")
        batch += 1


def settings_of_batch(settings: SynthesisSettings, batch: int) -> SynthesisSettings:
    """Settings of a batch of a run: every third one is lenient about friction.

    Some shapes, a cone on its base for one, cannot be held with half of the friction to spare. The rule depends on the
    batch's number alone, so that batches can be spread over processes.

    Args:
        settings: Settings of the run.
        batch: Number of the batch, from 0.

    Returns:
        The settings, in every third batch with the polish's default friction and all squeezes.
    """
    if batch % LENIENT_EVERY < LENIENT_EVERY - 1:
        return settings
    polish = replace(settings.polish, friction_fraction=PolishSettings().friction_fraction)
    return replace(settings, polish=polish, demands=replace(settings.demands, squeezes=GIVEN.squeezes))


def batch_seed(seed: int, batch: int) -> int:
    """A seed for each batch, the same in every process."""
    return int(np.random.SeedSequence([seed, batch]).generate_state(1)[0])


def lift_all(rig: LiftRig, grasps: Iterator[Grasp], tally: Tally) -> Iterator[Grasp]:
    """Lifts grasps one by one.

    Args:
        rig: The rig of their hand and scene.
        grasps: Certified grasps.
        tally: Counts to add to.

    Yields:
        Each grasp with its lift, successful or not.
    """
    for grasp in grasps:
        verdict = simulate_lift(rig, grasp)
        if verdict.success:
            tally.lifted += 1
        else:
            tally.failed[verdict.failure_reason] = tally.failed.get(verdict.failure_reason, 0) + 1
        yield replace(grasp, lift=verdict)


def synthesize(
    hand: Hand,
    scene: Scene,
    *,
    count: int,
    seed: int = 0,
    time_limit_s: float = 120.0,
    settings: SynthesisSettings | None = None,
    protocol: LiftProtocol = LIFT,
    tally: Tally | None = None,
) -> Iterator[Grasp]:
    """Grasps that are certified and lifted.

    Args:
        hand: The hand.
        scene: The scene.
        count: How many lifted grasps are wanted.
        seed: Seed.
        time_limit_s: Wall time after which what was found is all there is [s].
        settings: Settings; the defaults where None.
        protocol: Lift protocol.
        tally: Counts to add to.

    Yields:
        Every certified grasp with its lift, failed ones too, until `count` have lifted or time is up.
    """
    tally = tally if tally is not None else Tally()
    start = time.perf_counter()
    rig = lift_rig(hand, scene, protocol=protocol)
    found = certified_grasps(hand, scene, seed=seed, time_limit_s=time_limit_s, settings=settings, tally=tally)
    for grasp in lift_all(rig, found, tally):
        tally.seconds = time.perf_counter() - start
        yield grasp
        if tally.lifted >= count or tally.seconds > time_limit_s:
            return
