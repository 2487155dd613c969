"""From hand and scene to certified grasps: search, polish, certify, pre-grasp, squeeze, lift."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Grasp
from xdex_drake.grasping.finish import GIVEN, SEARCHED, Demands, Outcome, finish
from xdex_drake.grasping.proposers import Search
from xdex_drake.grasping.reasons import Reason, Rejection
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.description import Hand
from xdex_drake.programs.force_closure import PolishSettings
from xdex_drake.programs.search import SearchSettings
from xdex_drake.programs.terms import FIRM
from xdex_drake.programs.terms.region import lies_in
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.drake import LiftRig, lift_rig, simulate_lift
from xdex_drake.simulation.protocol import LiftProtocol

LENIENT_EVERY = 3
"""One batch in so many is lenient; see `settings_of_batch`."""


WINDOW = 8
"""Candidates over which `worth_going_on` takes the rate at the margin."""


SEARCH_COST = 0.25
"""What a candidate of a search costs, in polished ones."""


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

    search: SearchSettings = field(default_factory=lambda: SearchSettings(terms=FIRM))
    polish: PolishSettings = field(default_factory=lambda: PolishSettings(friction_fraction=0.5))
    batch: int = 80
    solver: str = "sequential"
    demands: Demands = SEARCHED


def candidates_of_batch(
    hand: Hand, scene: Scene, *, seed: int, settings: SynthesisSettings, tally: Tally, until: float = float("inf")
) -> Iterator[Grasp]:
    """Certified grasps of one batch: a search whose best candidates are polished and certified.

    Args:
        hand: The hand.
        scene: The scene.
        seed: Seed of the search.
        settings: Settings.
        tally: Counts to add to.
        until: Time of `time.perf_counter` after which no further candidate is begun [s].

    Yields:
        Certified grasps, not yet lifted; their time includes their share of the search.
    """
    hits: list[bool] = []
    for candidate in Search(settings.search, settings.polish)(hand, scene, settings.batch, seed):
        if not worth_going_on(hits, settings.batch) or time.perf_counter() > until:
            return
        outcome = finish(candidate, solver=settings.solver, demands=settings.demands)
        region = settings.search.region
        if region is not None and outcome.grasp is not None and not lies_in(outcome.grasp, region):
            outcome = Outcome(None, Rejection(Reason.CONSTRAINT, "region"))
        tally.add(outcome)
        hits.append(outcome.grasp is not None)
        if outcome.grasp is not None:
            yield outcome.grasp


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
        time_limit_s: Wall time after which no further candidate is begun [s].
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
            hand,
            scene,
            seed=batch_seed(seed, batch),
            settings=settings_of_batch(settings, batch),
            tally=tally,
            until=start + time_limit_s,
        )
        for grasp in grasps:
            yield named(grasp, scene, seed, batch)
        batch += 1


def settings_of_batch(settings: SynthesisSettings, batch: int) -> SynthesisSettings:
    """Settings of a batch of a run: every third one is lenient about friction and pushes.

    Some shapes, a cone on its base for one, cannot be held with half of the friction to spare, and some by no grasp
    that bears pushes. The rule depends on the batch's number alone, so that batches can be spread over processes.

    Args:
        settings: Settings of the run.
        batch: Number of the batch, from 0.

    Returns:
        The settings, in every third batch with the polish's default friction, all squeezes, and whatever is foretold.
    """
    if batch % LENIENT_EVERY < LENIENT_EVERY - 1:
        return settings
    polish = replace(settings.polish, friction_fraction=PolishSettings().friction_fraction)
    demands = replace(settings.demands, squeezes=GIVEN.squeezes, foretold=GIVEN.foretold)
    return replace(settings, polish=polish, demands=demands)


def batch_seed(seed: int, batch: int) -> int:
    """A seed for each batch, the same in every process."""
    return int(np.random.SeedSequence([seed, batch]).generate_state(1)[0])


def named(grasp: Grasp, scene: Scene, seed: int, batch: int) -> Grasp:
    """The grasp with an identifier of its own: hand, scene, seed, batch and the candidate's name in the batch."""
    return replace(grasp, grasp_id=f"{grasp.hand}-{scene.scene_id}-{seed}-{batch}-{grasp.grasp_id}")


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
        tally.add_lift(verdict)
        yield replace(grasp, lift=verdict)


def synthesize(
    hand: Hand,
    scene: Scene,
    *,
    count: int,
    seed: int = 0,
    time_limit_s: float = 120.0,
    settings: SynthesisSettings | None = None,
    protocol: LiftProtocol | None = None,
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
        protocol: Lift protocol; where None `LIFT`, or `RELEASE` in a scene without a table.
        tally: Counts to add to.

    Yields:
        Every certified grasp with its lift, failed ones too, until `count` have lifted or time is up.

    Raises:
        ConfigError: `count` is less than 1.
    """
    if count < 1:
        raise ConfigError(f"count is {count}; give 1 or more")
    tally = tally if tally is not None else Tally()
    start = time.perf_counter()
    rig = lift_rig(hand, scene, protocol=protocol)
    found = certified_grasps(hand, scene, seed=seed, time_limit_s=time_limit_s, settings=settings, tally=tally)
    for grasp in lift_all(rig, found, tally):
        tally.seconds = time.perf_counter() - start
        yield grasp
        if tally.lifted >= count or tally.seconds > time_limit_s:
            return
