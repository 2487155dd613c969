"""Proposers give candidates: whoever has an idea of a grasp, a search, another hand's grasp or a model.

All candidates are finished by one rule (`grasping.finish`), so that methods compare.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.grasp import Grasp
from xdex_drake.grasping.reasons import Rejection
from xdex_drake.hand.description import Hand
from xdex_drake.programs.force_closure import PolishSettings, program_of_candidate
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.retargeting import RETRY, RetrySettings, refined_starts, retargeting_program
from xdex_drake.programs.search import SearchSettings, search
from xdex_drake.scene.tabletop import Scene


@dataclass(frozen=True, eq=False)
class Candidate:
    """An idea of a grasp.

    Attributes:
        name: Its name among the candidates of one call, part of the grasp's identifier.
        programs: Gives the programs that are solved in turn until one of them ends in a grasp, built one by one; in the
            place of a program may stand a grasp, which is taken as it is, or the reason why there is none.
        seconds: Its share of what was done for all candidates at once [s].
        source_grasp_id: Identifier of the grasp that it comes from; empty where it comes from none.
    """

    name: str
    programs: Callable[[], Iterator[GraspProgram | Grasp | Rejection]]
    seconds: float = 0.0
    source_grasp_id: str = ""


class Proposer(Protocol):
    """Gives candidates of grasps by a hand in a scene; a plain value that can be sent to another process."""

    def __call__(self, hand: Hand, scene: Scene, count: int, seed: int) -> Iterator[Candidate]:
        """Gives candidates, the most promising first.

        Args:
            hand: The hand.
            scene: The scene.
            count: How many, at the most.
            seed: Seed; equal arguments give equal candidates.

        Yields:
            The candidates.
        """
        ...


@dataclass(frozen=True)
class Search:
    """Proposes what a batched search of Eq. (1) finds, least energy first.

    Attributes:
        settings: Settings of the search.
        polish: Numbers of the hard constraints of the candidates' programs.
    """

    settings: SearchSettings = field(default_factory=SearchSettings)
    polish: PolishSettings = field(default_factory=PolishSettings)

    def __call__(self, hand: Hand, scene: Scene, count: int, seed: int) -> Iterator[Candidate]:
        """Searches once, at the first candidate; see `Proposer`."""
        start = time.perf_counter()
        found = search(hand, scene, count=count, seed=seed, settings=self.settings)
        share = (time.perf_counter() - start) / count
        build = partial(program_of_candidate, hand, scene, found, settings=self.polish, asked=self.settings)
        for row in range(len(found.energy)):
            yield Candidate(str(row), lambda row=row: iter((build(row),)), share)


@dataclass(frozen=True, eq=False)
class Retarget:
    """Proposes grasps of one hand for another, one candidate a grasp, by Eq. (2).

    Attributes:
        grasps: The source grasps, in the scene that is proposed for.
        source_hand: Their hand.
        polish: Numbers of the hard constraints; the defaults where None.
        retry: How a grasp is tried again that does not carry over as it is.
    """

    grasps: tuple[Grasp, ...]
    source_hand: Hand
    polish: PolishSettings | None = None
    retry: RetrySettings = RETRY

    def __call__(self, hand: Hand, scene: Scene, count: int, seed: int) -> Iterator[Candidate]:
        """Carries the first `count` grasps over; the seed draws the starts of further attempts. See `Proposer`."""
        for number, grasp in enumerate(self.grasps[:count]):
            own = int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
            programs = partial(self._programs, grasp, hand, scene, own)
            yield Candidate(f"{grasp.grasp_id}>{hand.name}", programs, source_grasp_id=grasp.grasp_id or "unnamed")

    def _programs(self, grasp: Grasp, hand: Hand, scene: Scene, seed: int) -> Iterator[GraspProgram]:
        build = partial(retargeting_program, grasp, self.source_hand, hand, scene, settings=self.polish)
        yield build()
        # Hands that differ much start deep in the object, from where local convex steps do not get out.
        found = refined_starts(grasp, self.source_hand, hand, scene, seed=seed, retry=self.retry)
        for R_WH, p_WH, q, fingers in zip(found.R_WHs, found.p_WHs, found.qs, found.fingers, strict=True):
            X_WH = RigidTransform(RotationMatrix.ProjectToRotationMatrix(R_WH), p_WH)
            yield build(start=(X_WH, q), fingers=fingers)
