"""Synthesis in several processes, with grasps that depend on the seed alone.

The unit of work is one batch: a search, and the polish, certificate and lift of its candidates, best first. Batches are
numbered and their results are taken in that order, so that two workers find what one worker finds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import count as count_from
from typing import TYPE_CHECKING

from xdex_drake.grasp import Grasp
from xdex_drake.jobs.processes import UnitResult, run_units

if TYPE_CHECKING:
    pass
from xdex_drake.jobs.ordered import _log

QUOTA = 10
"""Lifted grasps after which a batch is left: a smaller number loses less at Ctrl-C, a greater one searches less."""


PATIENCE = 3
"""Batches in a row that may crash or run out of time before a run is given up."""


@dataclass(frozen=True)
class GraspRequest:
    """Hand, object and scene of a synthesis, by what a fresh process needs to build them.

    Attributes:
        hand: Name or path of the hand.
        object: Name or path of the object.
        scale: Factor from the mesh file's unit to metres.
        mass: Mass of the object [kg].
        friction: Coefficient of friction.
        scene_seed: Choice of the stable pose.
        seed: Seed of the searches.
        solver: Solver of the polish.
    """

    hand: str
    object: str
    scale: float = 1.0
    mass: float = 0.1
    friction: float = 0.6
    scene_seed: int = 0
    seed: int = 0
    solver: str = "sequential"


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
        batch: Number of the batch.
        grasps: Certified grasps with their lifts, failed ones too, in the order in which they were tried.
        tried: Candidates polished.
        rejected: How often each reason rejected a candidate.
        preparation_s: Time of building hand, object, scene and rig, in the process that did it [s].
        seconds: Time of the batch without preparation [s].
    """

    batch: int
    grasps: tuple[Grasp, ...]
    tried: int
    rejected: dict[str, int]
    preparation_s: float
    seconds: float


@dataclass
class RequestTally:
    """Counts over the batches of a request.

    Attributes:
        batches: Batches whose results were taken.
        tried: Candidates polished.
        certified: Candidates certified.
        lifted: Certified grasps that lifted.
        rejected: How often each reason rejected a candidate.
        failed: How often each reason failed a lift.
        crashed: Batches without a result, with the reason.
        preparation_s: Greatest time of preparation in a process [s].
        seconds: Wall time [s].
    """

    batches: int = 0
    tried: int = 0
    certified: int = 0
    lifted: int = 0
    rejected: dict[str, int] = field(default_factory=dict)
    failed: dict[str, int] = field(default_factory=dict)
    crashed: list[str] = field(default_factory=list)
    preparation_s: float = 0.0
    seconds: float = 0.0

    def add(self, result: BatchResult) -> None:
        """Adds the counts of a batch."""
        self.batches += 1
        self.tried += result.tried
        self.certified += len(result.grasps)
        for reason, times in result.rejected.items():
            self.rejected[reason] = self.rejected.get(reason, 0) + times
        for grasp in result.grasps:
            assert grasp.lift is not None
            if grasp.lift.success:
                self.lifted += 1
            else:
                reason = grasp.lift.failure_reason
                self.failed[reason] = self.failed.get(reason, 0) + 1
        self.preparation_s = max(self.preparation_s, result.preparation_s)


@lru_cache(maxsize=1)
def _bench(request: GraspRequest) -> tuple:
    """Hand, scene and lift rig of a request; kept for the next batch of the same process."""
    from xdex_drake.hand.library import load_hand
    from xdex_drake.scene.object import load_object
    from xdex_drake.scene.tabletop import make_scene
    from xdex_drake.simulation.lift import lift_rig

    hand = load_hand(request.hand)
    model = load_object(request.object, scale=request.scale, mass=request.mass, friction=request.friction)
    scene = make_scene(model, seed=request.scene_seed)
    return hand, scene, lift_rig(hand, scene)


def run_batch(unit: BatchUnit) -> BatchResult:
    """Searches, polishes, certifies and lifts one batch.

    Args:
        unit: The batch.

    Returns:
        What came of it; it depends on the unit alone, as long as the deadline is not met.
    """
    import torch

    from xdex_drake.grasping.synthesis import (
        SynthesisSettings,
        batch_seed,
        candidates_of_batch,
        lift_all,
        settings_of_batch,
    )
    from xdex_drake.grasping.tally import Tally

    torch.set_num_threads(1)
    request, begin = unit.request, time.perf_counter()
    known = _bench.cache_info().misses
    hand, scene, rig = _bench(request)
    prepared = time.perf_counter()
    settings = settings_of_batch(SynthesisSettings(solver=request.solver), unit.batch)
    tally = Tally()
    found = candidates_of_batch(hand, scene, seed=batch_seed(request.seed, unit.batch), settings=settings, tally=tally)
    grasps: list[Grasp] = []
    for grasp in lift_all(rig, found, tally):
        name = f"{hand.name}-{scene.scene_id}-{request.seed}-{unit.batch}-{grasp.grasp_id}"
        grasps.append(replace(grasp, grasp_id=name))
        if tally.lifted >= unit.quota or time.time() > unit.deadline:
            break
    preparation_s = prepared - begin if _bench.cache_info().misses > known else 0.0
    seconds = time.perf_counter() - prepared
    return BatchResult(unit.batch, tuple(grasps), tally.tried, tally.rejected, preparation_s, seconds)


def synthesize_batches(
    request: GraspRequest,
    *,
    count: int,
    workers: int = 2,
    time_limit_s: float = 120.0,
    tally: RequestTally | None = None,
) -> Iterator[BatchResult]:
    """Batches of grasps until enough have lifted.

    Every batch aims at half of `count`, at most `QUOTA`, so that two workers share even a small request; the results
    are the same for any number of workers unless time runs out.

    Args:
        request: Hand, object, scene, seed.
        count: How many lifted grasps are wanted.
        workers: Number of processes; 0 works in this one.
        time_limit_s: Wall time after which what was found is all there is [s].
        tally: Counts to add to.

    Yields:
        Results in the order of the batches, each as soon as it and those before it are there.

    Raises:
        RuntimeError: A batch met a bug; the message holds its traceback.
    """
    tally = tally if tally is not None else RequestTally()
    begin = time.perf_counter()
    quota, deadline = max(1, min(math.ceil(count / 2), QUOTA)), time.time() + time_limit_s
    units = (BatchUnit(request, batch, quota, deadline) for batch in count_from())
    waiting: dict[int, UnitResult[BatchUnit, BatchResult]] = {}
    results = run_units(units, run_batch, workers=workers, timeout_s=max(60.0, 2.0 * time_limit_s))
    lost = 0
    try:
        for done in results:
            waiting[done.unit.batch] = done
            while (ready := waiting.pop(tally.batches + len(tally.crashed), None)) is not None:
                if ready.value is None:
                    if ready.trace:
                        raise RuntimeError(f"batch {ready.unit.batch} of {request}:\n{ready.trace}")
                    _log.warning("batch %d: %s", ready.unit.batch, ready.failure)
                    tally.crashed.append(ready.failure)
                    lost += 1
                    continue
                lost = 0
                tally.add(ready.value)
                tally.seconds = time.perf_counter() - begin
                yield ready.value
                if tally.lifted >= count:
                    return
            if time.time() > deadline or lost >= PATIENCE:
                return
    finally:
        tally.seconds = time.perf_counter() - begin
        results.close()  # type: ignore[attr-defined]
        if workers == 0:
            _bench.cache_clear()
