"""Synthesis in several processes, with grasps that depend on the seed alone.

The unit of work is one batch: a search, and the polish, certificate and lift of its candidates, best first. Batches are
numbered and their results are taken in that order, so that two workers find what one worker finds.
"""

from __future__ import annotations

import importlib
import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import count as count_from
from typing import TYPE_CHECKING, Generic, TypeVar, cast

from xdex_drake.dataset.executors import UnitResult, run_units
from xdex_drake.dataset.files import SceneFacts
from xdex_drake.grasp import Grasp, Lift

if TYPE_CHECKING:
    from xdex_drake.dataset.synthesis import Outcome
    from xdex_drake.hand.description import Hand
    from xdex_drake.scene.tabletop import Scene
    from xdex_drake.simulation.lift import LiftRig

Unit = TypeVar("Unit")
Value = TypeVar("Value")

_log = logging.getLogger(__name__)

QUOTA = 10
"""Lifted grasps after which a batch is left: a smaller number loses less at Ctrl-C, a greater one searches less."""

SIMULATORS = {"drake": "xdex_drake.simulation.lift", "mujoco": "xdex_drake.simulation.mujoco"}
"""The module of each simulator's `lift`."""

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

    from xdex_drake.dataset.synthesis import (
        SynthesisSettings,
        Tally,
        batch_seed,
        candidates_of_batch,
        lift_all,
        settings_of_batch,
    )

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


# Stored grasps, one by one --------------------------------------------------------------------------------------------


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
        simulator: One of `SIMULATORS`.
    """

    index: int
    grasp: Grasp
    scene: SceneFacts
    hand: str
    protocol: str = "lift-0.2/2tips"
    robust: int = 0
    simulator: str = "drake"


def run_retarget(unit: RetargetUnit) -> Outcome:
    """Retargets a stored grasp and lifts the result.

    Args:
        unit: The grasp and the target.

    Returns:
        The lifted grasp, or the reason why there is none.
    """
    import torch

    from xdex_drake.dataset.retarget import retarget
    from xdex_drake.dataset.synthesis import Outcome
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
    from xdex_drake.simulation.protocol import find_protocol
    from xdex_drake.simulation.robust import RobustSettings, robust_lift

    hand, scene, protocol = _hand(unit.hand), _scene(unit.scene), find_protocol(unit.protocol)
    lift = importlib.import_module(SIMULATORS[unit.simulator]).lift
    if unit.robust:
        settings = RobustSettings(repeats=unit.robust)
        return robust_lift(unit.grasp, hand, scene, protocol=protocol, settings=settings, lift=lift).lift
    return lift(unit.grasp, hand, scene, protocol=protocol)


def lost_lift(unit: LiftUnit, failure: str) -> Lift:
    """The verdict of a lift whose process crashed or took too long: it failed.

    Args:
        unit: The lift.
        failure: What happened to it.

    Returns:
        The verdict.
    """
    reason = "timeout" if failure.startswith("timeout") else "simulation_failed"
    name = unit.protocol if unit.simulator == "drake" else f"{unit.simulator}:{unit.protocol}"
    name = f"robust:{name}" if unit.robust else name
    return Lift(name, False, reason, float("nan"), (), 0.0)


def in_order(
    units: Sequence[Unit],
    work: Callable[[Unit], Value],
    *,
    workers: int,
    lost: Callable[[Unit, str], Value] | None = None,
) -> Iterator[tuple[Unit, Value]]:
    """Runs work on each unit and gives the results in the order of the units.

    Args:
        units: The units.
        work: A function at the top level of a module.
        workers: Number of processes; 0 works in this one, where a crash ends everything.
        lost: Gives the result of a unit whose process crashed or took too long; they are left out where None.

    Yields:
        Each unit with its result; units that were lost are told by a warning.

    Raises:
        RuntimeError: The work met a bug; the message holds its traceback.
        XdexError: The input of a unit cannot be used.
    """
    waiting: dict[int, UnitResult[tuple[int, Unit], Value]] = {}
    results = run_units(list(enumerate(units)), _Numbered(work), workers=min(workers, len(units)), timeout_s=300.0)
    position = 0
    try:
        for done in results:
            waiting[done.unit[0]] = done
            while (ready := waiting.pop(position, None)) is not None:
                position += 1
                if ready.failure:
                    if ready.trace:
                        raise RuntimeError(f"unit {position - 1}:\n{ready.trace}")
                    _log.warning("unit %d: %s", position - 1, ready.failure)
                    if lost is not None:
                        yield ready.unit[1], lost(ready.unit[1], ready.failure)
                    continue
                yield ready.unit[1], cast("Value", ready.value)
    finally:
        results.close()  # type: ignore[attr-defined]
        if workers == 0:
            _rig.cache_clear()
            _scene.cache_clear()


@dataclass(frozen=True)
class _Numbered(Generic[Unit, Value]):
    """Work on units that carry their number."""

    work: Callable[[Unit], Value]

    def __call__(self, unit: tuple[int, Unit]) -> Value:
        return self.work(unit[1])


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
