"""Grasps of one hand in one scene, made in several processes; they depend on the seed alone.

The unit of work is one batch: what a proposer gives for one seed, and the polish, certificate and lift of its
candidates. Batches are numbered and their results are taken in that order, so that two workers find what one finds.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import count as count_from
from typing import TYPE_CHECKING

from xdex_drake.jobs.deadline import ending_at
from xdex_drake.jobs.ordered import in_order
from xdex_drake.jobs.workbench import hand_of, rig_of, scene_of, use_one_thread
from xdex_drake.scene.facts import SceneFacts

if TYPE_CHECKING:
    from xdex_drake.grasp import Grasp
    from xdex_drake.grasping.proposers import Proposer
    from xdex_drake.grasping.tally import Tally
    from xdex_drake.hand.description import Hand
    from xdex_drake.programs.search import SearchSettings
    from xdex_drake.scene.tabletop import Scene
    from xdex_drake.simulation.drake import LiftRig

_log = logging.getLogger(__name__)

QUOTA = 10
"""Lifted grasps after which a batch is left: a smaller number loses less at Ctrl-C, a greater one searches less."""

DRAWS = 16
"""Proposals of a batch of `propose_batches`."""

PATIENCE_S = 1.0
"""Time after the limit in which batches end by themselves and tell what they found, before their processes are [s]."""

PATIENCE = 3
"""Batches in a row that may crash or run out of time before a run is given up."""


@dataclass(frozen=True)
class GraspRequest:
    """Hand and scene of a synthesis, by what a fresh process needs to build them.

    Attributes:
        hand: Name or path of the hand.
        scene: The scene.
        seed: Seed of the searches.
        solver: Solver of the polish.
        search: Settings of the searches; the defaults where None.
    """

    hand: str
    scene: SceneFacts
    seed: int = 0
    solver: str = "sequential"
    search: SearchSettings | None = None


@dataclass(frozen=True)
class BatchUnit:
    """One batch of a request.

    Attributes:
        request: The request.
        batch: Number of the batch.
        quota: Lifted grasps after which the batch is left.
        deadline: Time of `time.time` after which the batch is left [s].
    """

    request: GraspRequest
    batch: int
    quota: int
    deadline: float


@dataclass(frozen=True)
class BatchResult:
    """What came of a batch.

    Attributes:
        grasps: Certified grasps with their lifts, failed ones too, in the order in which they were tried.
        tally: Counts; its seconds leave out building hand, scene and rig.
        preparation_s: Time of building hand, scene and rig, where this process had to [s].
    """

    grasps: tuple[Grasp, ...]
    tally: Tally
    preparation_s: float


def run_batch(unit: BatchUnit) -> BatchResult:
    """Searches, polishes, certifies and lifts one batch.

    Args:
        unit: The batch.

    Returns:
        What came of it, up to the deadline; it depends on the unit alone, as long as that is not met.
    """
    from xdex_drake.grasping.tally import Tally

    use_one_thread()
    begin, grasps, tally = time.perf_counter(), list["Grasp"](), Tally()
    prepared = begin
    with ending_at(unit.deadline):
        request = unit.request
        hand, scene, rig = hand_of(request.hand), scene_of(request.scene), rig_of(request.hand, request.scene)
        prepared = time.perf_counter()
        _fill(grasps, tally, unit, hand, scene, rig)
    tally.seconds = time.perf_counter() - prepared
    return BatchResult(tuple(grasps), tally, prepared - begin)


def _fill(grasps: list[Grasp], tally: Tally, unit: BatchUnit, hand: Hand, scene: Scene, rig: LiftRig) -> None:
    """Adds the grasps of a batch, with their lifts, until its quota is met."""
    from xdex_drake.grasping.synthesis import (
        SynthesisSettings,
        batch_seed,
        candidates_of_batch,
        lift_all,
        named,
        settings_of_batch,
    )

    request = unit.request
    asked = SynthesisSettings(solver=request.solver)
    asked = asked if request.search is None else replace(asked, search=request.search)
    settings = settings_of_batch(asked, unit.batch)
    found = candidates_of_batch(hand, scene, seed=batch_seed(request.seed, unit.batch), settings=settings, tally=tally)
    for grasp in lift_all(rig, found, tally):
        grasps.append(named(grasp, scene, request.seed, unit.batch))
        if tally.lifted >= unit.quota:
            return


def synthesize_batches(
    request: GraspRequest,
    *,
    count: int,
    workers: int = 2,
    time_limit_s: float = 120.0,
    tally: Tally | None = None,
) -> Iterator[BatchResult]:
    """Batches of grasps until enough have lifted.

    Every batch aims at half of `count`, at most `QUOTA`, so that two workers share even a small request; the results
    are the same for any number of workers unless time runs out.

    Args:
        request: Hand, scene, seed.
        count: How many lifted grasps are wanted.
        workers: Number of processes; 0 works in this one.
        time_limit_s: Wall time after which what was found is all there is [s].
        tally: Counts to add to; its seconds are the wall time of this call.

    Yields:
        Results in the order of the batches, each as soon as it and those before it are there.

    Raises:
        RuntimeError: A batch met a bug; the message holds its traceback.
    """
    from xdex_drake.grasping.tally import Tally

    tally = tally if tally is not None else Tally()
    begin = time.perf_counter()
    quota, deadline = max(1, min(math.ceil(count / 2), QUOTA)), time.time() + time_limit_s
    units = (BatchUnit(request, batch, quota, deadline) for batch in count_from())
    lost = 0
    timeout_s = max(60.0, 2.0 * time_limit_s)
    until = time.monotonic() + time_limit_s + PATIENCE_S
    batches = in_order(units, run_batch, workers=workers, timeout_s=timeout_s, until=until)
    with closing(batches) as results:  # type: ignore[type-var]
        for done in results:
            if done.value is None and time.time() > deadline:
                return
            if done.value is None:
                _log.warning("batch %d: %s", done.unit.batch, done.failure)
                tally.lost.append(str(done.failure))
                lost += 1
            else:
                lost = 0
                tally.merge(done.value.tally)
                tally.seconds = time.perf_counter() - begin
                yield done.value
            if tally.lifted >= count or time.time() > deadline or lost >= PATIENCE:
                return


@dataclass(frozen=True)
class ProposalUnit:
    """One batch of proposals, all of which are finished.

    Attributes:
        hand: Name or path of the hand.
        scene: The scene.
        proposer: Who proposes.
        seed: Seed of the whole run.
        batch: Number of the batch.
        count: Proposals of the batch.
        lift: Whether certified grasps are lifted.
    """

    hand: str
    scene: SceneFacts
    proposer: Proposer
    seed: int
    batch: int
    count: int
    lift: bool


def run_proposals(unit: ProposalUnit) -> BatchResult:
    """Proposes, finishes and lifts one batch.

    Args:
        unit: The batch.

    Returns:
        What came of it; it depends on the unit alone.
    """
    from xdex_drake.grasping.finish import finish
    from xdex_drake.grasping.synthesis import batch_seed, named
    from xdex_drake.grasping.tally import Tally
    from xdex_drake.simulation.drake import simulate_lift

    use_one_thread()
    begin = time.perf_counter()
    hand, scene = hand_of(unit.hand), scene_of(unit.scene)
    rig = rig_of(unit.hand, unit.scene) if unit.lift else None
    prepared = time.perf_counter()
    tally, grasps, lifting = Tally(), [], 0.0
    for candidate in unit.proposer(hand, scene, unit.count, batch_seed(unit.seed, unit.batch)):
        outcome = finish(candidate)
        if outcome.grasp is not None:
            grasp = named(outcome.grasp, scene, unit.seed, unit.batch)
            if rig is not None:
                lift = simulate_lift(rig, grasp)
                lifting += lift.seconds
                grasp = replace(grasp, lift=lift)
            grasps.append(grasp)
            outcome = replace(outcome, grasp=grasp)
        tally.add(outcome)
    tally.seconds = time.perf_counter() - prepared - lifting
    return BatchResult(tuple(grasps), tally, prepared - begin)


def propose_batches(
    proposer: Proposer,
    hands: Sequence[str],
    scene: SceneFacts,
    *,
    count: int,
    seed: int = 0,
    lift: bool = True,
    workers: int = 2,
) -> Iterator[tuple[ProposalUnit, BatchResult]]:
    """Proposals for some hands in one scene, every one of them finished, and lifted where it is certified.

    Args:
        proposer: Who proposes; for equal seeds its proposals for different hands may correspond.
        hands: Names or paths of the hands.
        scene: The scene.
        count: Proposals for each hand.
        seed: Seed.
        lift: Whether certified grasps are lifted.
        workers: Number of processes; 0 works in this one.

    Yields:
        Batches with their results, hand by hand; one whose process crashed or ran out of time counts all of its
        proposals as tried and lost.

    Raises:
        RuntimeError: A batch met a bug; the message holds its traceback.
        XdexError: A hand or the proposer cannot be used.
    """
    from xdex_drake.grasping.tally import Tally

    units = [
        ProposalUnit(hand, scene, proposer, seed, batch, min(DRAWS, count - start), lift)
        for hand in hands
        for batch, start in enumerate(range(0, count, DRAWS))
    ]
    for done in in_order(units, run_proposals, workers=min(workers, len(units))):
        result = done.value
        if result is None:
            _log.warning("%s, batch %d: %s", done.unit.hand, done.unit.batch, done.failure)
            result = BatchResult((), Tally(tried=done.unit.count, lost=[str(done.failure)]), 0.0)
        yield done.unit, result
