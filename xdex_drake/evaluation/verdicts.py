"""What became of predicted grasps, stage by stage: the rows from which tables are made.

A draw is judged whatever a filter would say of it; one that became no grasp is a failure with its reason.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Literal

import numpy as np

from xdex_drake.evaluation.metrics import wilson_interval
from xdex_drake.grasp import Grasp
from xdex_drake.grasping.finish import finish
from xdex_drake.grasping.proposers import Candidate
from xdex_drake.hand.description import Hand
from xdex_drake.learning.proposer import best_grasp, raw_candidates, refined_candidates, refined_starts
from xdex_drake.programs.search import Candidates
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.drake import LiftRig, simulate_lift
from xdex_drake.whole_file import whole_file

Stage = Literal["raw", "refined", "best"]


@dataclass(frozen=True)
class Verdict:
    """What became of one draw at one stage.

    Attributes:
        group: Group of the hand.
        hand: Name of the hand.
        scene: Name of the scene.
        stage: `raw`, `refined` or `best`; for a ladder its step goes before.
        sample: Number of the draw; equal numbers of one scene are corresponding draws of its hands.
        found: Whether it became a grasp.
        lifted: Whether that grasp was lifted.
        reason: Why not: why it is no grasp, or how the lift failed; empty where it lifted.
        penetration_cm: Deepest object point in the hand, against the mesh [cm]; NaN without a grasp.
        moved_cm: Distance of the wrist from the prediction's [cm]; NaN without a grasp.
        tip_mm: Mean distance of the fingertips from where they were predicted, after inverse kinematics [mm].
        seconds: Processor time of what was done for it after the draw, the lift left out [s].
    """

    group: str
    hand: str
    scene: str
    stage: str
    sample: int
    found: bool
    lifted: bool
    reason: str
    penetration_cm: float
    moved_cm: float
    tip_mm: float
    seconds: float


def judge(
    hand: Hand,
    scene: Scene,
    rig: LiftRig,
    raw: Candidates,
    stages: Sequence[Stage],
    *,
    judged: int,
    group: str = "",
    seed: int = 0,
) -> Iterator[tuple[Verdict, Grasp | None]]:
    """Takes draws to each stage and lifts what they became.

    Args:
        hand: The hand.
        scene: The scene.
        rig: Their rig, by whose protocol is lifted.
        raw: The draws, as `learning.proposer.draw_raw` gives them.
        stages: The stages. `best` is one grasp, chosen of all draws before any is lifted; the others judge the first
            draws one by one.
        judged: How many.
        group: Group of the hand.
        seed: Seed of the refinement's starts.

    Yields:
        Verdicts with the grasps that they speak of.
    """

    def verdict(stage: str, sample: int, grasp: Grasp | None, reason: str, seconds: float) -> Verdict:
        lift = None if grasp is None else grasp.lift
        moved = np.nan if grasp is None else 100.0 * np.linalg.norm(grasp.X_WH.translation() - raw.p_WHs[sample])
        return Verdict(
            group=group,
            hand=hand.name,
            scene=scene.scene_id,
            stage=stage,
            sample=sample,
            found=grasp is not None,
            lifted=lift is not None and lift.success,
            reason=reason if lift is None else lift.failure_reason,
            penetration_cm=np.nan if grasp is None else 100.0 * grasp.penetration_mesh_m,
            moved_cm=float(moved),
            tip_mm=1000.0 * float(raw.energy[sample]),
            seconds=seconds,
        )

    def finished(stage: str, candidates: Iterator[Candidate], before: float) -> Iterator[tuple[Verdict, Grasp | None]]:
        for sample, candidate in enumerate(candidates):
            begin = time.process_time()
            outcome = finish(candidate)
            seconds = before + time.process_time() - begin
            grasp = None if outcome.grasp is None else replace(outcome.grasp, grasp_id=f"{stage}-{candidate.name}")
            reason = "" if outcome.reason is None else outcome.reason.name
            yield verdict(stage, sample, grasp, reason, seconds), grasp

    def lifted(found: Verdict, grasp: Grasp | None) -> tuple[Verdict, Grasp | None]:
        if grasp is None:
            return found, None
        grasp = replace(grasp, lift=simulate_lift(rig, grasp))
        return verdict(found.stage, found.sample, grasp, "", found.seconds), grasp

    if "raw" in stages:
        few = raw.take(slice(judged))
        for found in finished("raw", raw_candidates(hand, scene, few), 0.0):
            yield lifted(*found)
    if "refined" not in stages and "best" not in stages:
        return
    some = raw if "best" in stages else raw.take(slice(judged))
    begin = time.process_time()
    starts = refined_starts(hand, scene, some, seed=seed)
    share = (time.process_time() - begin) / len(some.energy)
    refined = list(finished("refined", refined_candidates(hand, scene, starts), share))
    if "best" in stages:
        best = best_grasp([grasp for _, grasp in refined if grasp is not None])
        seconds = sum(found.seconds for found, _ in refined)
        sample = next((found.sample for found, grasp in refined if grasp is best and best is not None), 0)
        named = None if best is None else replace(best, grasp_id="best")
        yield lifted(verdict("best", sample, named, "none certified", seconds), named)
    if "refined" in stages:
        for found in refined[:judged]:
            yield lifted(*found)


def write_verdicts(path: Path, verdicts: Sequence[Verdict]) -> None:
    """Writes verdicts as CSV, whole or not at all."""
    with whole_file(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [f.name for f in fields(Verdict)], lineterminator="\n")
        writer.writeheader()
        for found in verdicts:
            row = {name: f"{value:.4f}" if isinstance(value, float) else value for name, value in asdict(found).items()}
            writer.writerow({name: int(value) if isinstance(value, bool) else value for name, value in row.items()})


def read_verdicts(path: Path) -> list[Verdict]:
    """Verdicts that `write_verdicts` wrote."""
    read = {"str": str, "int": int, "float": float, "bool": lambda text: text == "1"}
    with path.open(newline="", encoding="utf-8") as stream:
        return [
            Verdict(**{f.name: read[str(f.type)](row[f.name]) for f in fields(Verdict)})
            for row in csv.DictReader(stream)
        ]


@dataclass(frozen=True)
class Line:
    """A line of a table: one hand, or a group of hands, at one stage.

    Attributes:
        name: The hand, or the group.
        stage: The stage.
        trials: Judged draws.
        lifted: Share that lifted.
        low: Lower bound of the interval of 95 %: Wilson's for a hand; by bootstrap over hands and scenes for a group.
        high: Its upper bound.
        found: Share that became a grasp.
        penetration_cm: Mean over grasps [cm].
        moved_cm: Mean distance of the wrist from the prediction's [cm].
        tip_mm: Mean distance of the fingertips from where they were predicted [mm].
        seconds: Mean processor time a draw [s].
        reasons: How often each reason came up.
    """

    name: str
    stage: str
    trials: int
    lifted: float
    low: float
    high: float
    found: float
    penetration_cm: float
    moved_cm: float
    tip_mm: float
    seconds: float
    reasons: dict[str, int]


def lines(verdicts: Sequence[Verdict], *, seed: int = 0) -> list[Line]:
    """A table: every hand of a group, then the group, stage by stage.

    Args:
        verdicts: The verdicts.
        seed: Seed of the bootstrap.

    Returns:
        The lines.
    """
    made = []
    for stage in dict.fromkeys(v.stage for v in verdicts):
        for group in dict.fromkeys(v.group for v in verdicts):
            members = [v for v in verdicts if v.stage == stage and v.group == group]
            hands = list(dict.fromkeys(v.hand for v in members))
            for hand in hands:
                own = [v for v in members if v.hand == hand]
                interval = wilson_interval(sum(v.lifted for v in own), len(own))
                made.append(_line(hand, stage, own, interval))
            if len(hands) > 1:
                made.append(_line(f"all {group}".strip(), stage, members, bootstrap(members, seed=seed)))
    return made


def bootstrap(verdicts: Sequence[Verdict], *, draws: int = 2000, seed: int = 0) -> tuple[float, float]:
    """Interval of 95 % of the lifted share, over hands and scenes that are samples of many.

    Hands and scenes are drawn anew with replacement, and the mean over cells is taken.

    Args:
        verdicts: Verdicts of one stage.
        draws: Number of draws.
        seed: Seed.

    Returns:
        Lower and upper bound; (0, 1) without a verdict.
    """
    if not verdicts:
        return 0.0, 1.0
    hands, h = np.unique([v.hand for v in verdicts], return_inverse=True)
    scenes, s = np.unique([v.scene for v in verdicts], return_inverse=True)
    total, lifted = np.zeros((2, len(hands), len(scenes)))
    np.add.at(total, (h, s), 1.0)
    np.add.at(lifted, (h, s), [float(v.lifted) for v in verdicts])
    rng, rates = np.random.default_rng(seed), []
    for _ in range(draws):
        cells = np.ix_(rng.integers(len(hands), size=len(hands)), rng.integers(len(scenes), size=len(scenes)))
        if total[cells].sum() > 0:
            rates.append(lifted[cells].sum() / total[cells].sum())
    low, high = np.quantile(rates, [0.025, 0.975])
    return float(low), float(high)


def _line(name: str, stage: str, verdicts: Sequence[Verdict], interval: tuple[float, float]) -> Line:
    def mean(values: list[float]) -> float:
        finite = [value for value in values if np.isfinite(value)]
        return float(np.mean(finite)) if finite else float("nan")

    reasons: dict[str, int] = {}
    for found in verdicts:
        if found.reason:
            reasons[found.reason] = reasons.get(found.reason, 0) + 1
    return Line(
        name=name,
        stage=stage,
        trials=len(verdicts),
        lifted=mean([v.lifted for v in verdicts]),
        low=interval[0],
        high=interval[1],
        found=mean([v.found for v in verdicts]),
        penetration_cm=mean([v.penetration_cm for v in verdicts]),
        moved_cm=mean([v.moved_cm for v in verdicts]),
        tip_mm=mean([v.tip_mm for v in verdicts]),
        seconds=mean([v.seconds for v in verdicts]),
        reasons=dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0]))),
    )
