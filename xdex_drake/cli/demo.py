"""`xdex demo`: the whole path in minutes, on one page."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from xdex_drake.cli.output import check_writable, counts, keeping_finished_work, one_thread, progress, table

if TYPE_CHECKING:
    from xdex_drake.dataset.files import SceneFacts
    from xdex_drake.dataset.schema import Row
    from xdex_drake.grasp import Grasp
    from xdex_drake.visualization.report import ReportGrasp, ReportRow, ReportSection

OBJECTS = ("can", "bottle", "mug")
SOURCE = "allegro"
TARGETS = ("shadow", "ability")
PREDICTED = ("inspire", "ability")
TIME_LIMIT = 60.0


@dataclass(frozen=True)
class Demo:
    """The whole path: grasps by one hand, the same grasps by others, lifts, a model's predictions, one report page.

    Takes a few minutes on two cores. Open `report/index.html` in a browser; every grasp has a picture and a replay.
    Try `xdex demo --quick` for one object and one other hand.

    Attributes:
        out: Folder of the report.
        quick: One object and one other hand.
        seed: Seed; another seed gives other grasps.
        workers: Number of processes; one at a time where 1.
    """

    out: Path = Path("report")
    quick: tyro.conf.FlagCreatePairsOff[bool] = False
    seed: int = 0
    workers: int = 2

    def run(self) -> int:
        """Runs the stages; what is finished when Ctrl-C comes is still written."""
        one_thread()
        from xdex_drake.errors import ConfigError

        if self.seed < 0 or self.workers < 1:
            raise ConfigError("--seed must be 0 or more, --workers 1 or more")
        check_writable(self.out / "index.html")
        begin = time.perf_counter()
        path = _Path(self.seed, 0 if self.workers == 1 else self.workers)
        objects, targets = (OBJECTS[:1], TARGETS[:1]) if self.quick else (OBJECTS, TARGETS)
        with keeping_finished_work() as interruption:
            path.synthesize(objects, count=2 if self.quick else 6)
            path.retarget(targets)
            path.predict(PREDICTED[:1] if self.quick else PREDICTED, objects[0], count=8 if self.quick else 16)
            path.show(most=1 if self.quick else 2)
        index = path.write(self.out, f"xdex demo{' --quick' if self.quick else ''} --seed {self.seed}")
        rows = [
            (stage.title, r.hand, r.object, r.tried, r.certified, r.lifted, counts({**r.rejected, **r.failed}))
            for stage in path.stages
            for r in stage.rows.values()
        ]
        header = ("stage", "hand", "object", "tried", "certified", "lifted", "rejected or failed by")
        print(table(rows, header))
        print(f"{time.perf_counter() - begin:.0f} s; open {index}")
        return interruption.status(0 if any(row[5] for row in rows) else 1)


@dataclass
class _Stage:
    """What came of a stage.

    Attributes:
        title: Heading.
        text: What it did.
        rows: Counts by hand and object.
        grasps: Certified grasps with their lifts and scenes.
        shown: Those that have a picture.
    """

    title: str
    text: str
    rows: dict[tuple[str, str], ReportRow] = field(default_factory=dict)
    grasps: list[tuple[Grasp, SceneFacts]] = field(default_factory=list)
    shown: list[ReportGrasp] = field(default_factory=list)

    def add(self, row: ReportRow) -> None:
        """Adds counts to those of the same hand and object."""
        key = (row.hand, row.object)
        old = self.rows.get(key)
        if old is None:
            self.rows[key] = row
            return
        self.rows[key] = replace(
            old,
            tried=old.tried + row.tried,
            certified=old.certified + row.certified,
            lifted=old.lifted + row.lifted,
            seconds=old.seconds + row.seconds,
            rejected=_sum(old.rejected, row.rejected),
            failed=_sum(old.failed, row.failed),
        )

    def section(self) -> ReportSection:
        """The stage as a part of the report."""
        from xdex_drake.visualization.report import ReportSection

        return ReportSection(self.title, self.text, tuple(self.rows.values()), tuple(self.shown))


class _Path:
    """The stages of the demonstration and what they have made so far."""

    def __init__(self, seed: int, workers: int) -> None:
        self.seed, self.workers = seed, workers
        self.stages: list[_Stage] = []
        self.file_rows: list[Row] = []

    def synthesize(self, objects: Sequence[str], count: int) -> None:
        """Grasps of each object by the source hand."""
        from xdex_drake.dataset.files import SceneFacts, rows_of
        from xdex_drake.hand.library import load_hand
        from xdex_drake.jobs.grasps import BatchUnit, GraspRequest, run_batch
        from xdex_drake.jobs.ordered import in_order
        from xdex_drake.scene.object import load_object
        from xdex_drake.scene.tabletop import make_scene
        from xdex_drake.visualization.report import ReportRow

        hand = load_hand(SOURCE)
        text = "Found by a batched search, polished by a mathematical program, proved by a convex program, then lifted."
        stage = _Stage(f"Grasps by {hand.display_name}", text)
        self.stages.append(stage)
        scenes = []
        with progress(len(objects), "prepare objects") as bar:
            for name in objects:
                model = load_object(name)
                model.grid  # noqa: B018 - computed once, here, and read from the cache by the workers
                scenes.append(make_scene(model))
                bar.update()
        deadline = time.time() + TIME_LIMIT * len(objects)
        units = [BatchUnit(GraspRequest(SOURCE, name, seed=self.seed), 0, count, deadline) for name in objects]
        with progress(len(units), "synthesise") as bar:
            for scene, (_, batch) in zip(scenes, in_order(units, run_batch, workers=self.workers), strict=False):
                rows = rows_of(batch.grasps, hand, scene)
                self.file_rows += rows
                stage.grasps += [(g, SceneFacts.of_row(row)) for g, row in zip(batch.grasps, rows, strict=True)]
                lifted, failed = _verdicts(batch.grasps)
                certified = len(batch.grasps)
                name = scene.object.name
                stage.add(
                    ReportRow(hand.name, name, batch.tried, certified, lifted, batch.seconds, batch.rejected, failed)
                )
                bar.update()

    def retarget(self, targets: Sequence[str]) -> None:
        """The lifted grasps of the first stage by other hands."""
        from xdex_drake.dataset.files import rows_of
        from xdex_drake.hand.library import load_hand
        from xdex_drake.jobs.ordered import in_order
        from xdex_drake.jobs.stored import RetargetUnit, run_retarget
        from xdex_drake.visualization.report import ReportRow

        text = "Fingertips and wrist are matched by name, under the same constraints as any grasp."
        stage = _Stage("The same grasps by other hands", text)
        self.stages.append(stage)
        sources = [(g, scene) for g, scene in self.stages[0].grasps if g.lift is not None and g.lift.success]
        hands = {name: load_hand(name) for name in targets}
        points = {row["grasp_id"]: row["object_point_O"] for row in self.file_rows}
        scenes = {facts: facts.build() for facts in dict.fromkeys(scene for _, scene in sources)}
        units = [
            RetargetUnit(k, grasp, scene, SOURCE, target)
            for target in targets
            for k, (grasp, scene) in enumerate(sources)
        ]
        with progress(len(units), "retarget") as bar:
            for unit, outcome in in_order(units, run_retarget, workers=self.workers):
                grasps = () if outcome.grasp is None else (outcome.grasp,)
                lifted, failed = _verdicts(grasps)
                rejected = {} if grasps else {outcome.reason: 1}
                seconds = sum(grasp.seconds for grasp in grasps)
                stage.add(ReportRow(unit.target, unit.grasp.object, 1, len(grasps), lifted, seconds, rejected, failed))
                stage.grasps += [(grasp, unit.scene) for grasp in grasps]
                self.file_rows += rows_of(grasps, hands[unit.target], scenes[unit.scene], source_points=points)
                bar.update()

    def predict(self, hands: Sequence[str], name: str, count: int) -> None:
        """Grasps from the model that the library ships."""
        from xdex_drake.dataset.files import SceneFacts, rows_of
        from xdex_drake.hand.library import load_hand
        from xdex_drake.learning.checkpoint import FILE_NAME, load_checkpoint
        from xdex_drake.learning.proposer import default_checkpoint, propose
        from xdex_drake.scene.object import load_object
        from xdex_drake.scene.tabletop import make_scene
        from xdex_drake.simulation.lift import lift_rig, simulate_lift
        from xdex_drake.visualization.report import ReportRow

        text = (
            "Link poses are drawn by the small model that the library ships, then polished and proved like any grasp."
        )
        stage = _Stage("Predicted by the model", text)
        if not (default_checkpoint() / FILE_NAME).is_file():
            stage.text = "The library was installed without its small model, so that this stage was left out."
            self.stages.append(stage)
            return
        model = load_checkpoint(default_checkpoint())
        self.stages.append(stage)
        scene = make_scene(load_object(name))
        with progress(count * len(hands), "predict") as bar:
            for hand in (load_hand(name) for name in hands):
                rig = lift_rig(hand, scene)
                begin = time.perf_counter()
                for outcome in propose(model, hand, scene, count=count, seed=self.seed):
                    seconds, begin = time.perf_counter() - begin, time.perf_counter()
                    grasps: tuple[Grasp, ...] = ()
                    if outcome.grasp is not None:
                        grasps = (replace(outcome.grasp, lift=simulate_lift(rig, outcome.grasp)),)
                        begin = time.perf_counter()
                    lifted, failed = _verdicts(grasps)
                    rejected = {} if grasps else {outcome.reason: 1}
                    stage.add(ReportRow(hand.name, name, 1, len(grasps), lifted, seconds, rejected, failed))
                    rows = rows_of(grasps, hand, scene)
                    self.file_rows += rows
                    stage.grasps += [(g, SceneFacts.of_row(row)) for g, row in zip(grasps, rows, strict=True)]
                    bar.update()

    def show(self, most: int) -> None:
        """Pictures and replays of the first lifted grasps of each hand and object."""
        from xdex_drake.jobs.ordered import in_order

        units = []
        for number, stage in enumerate(self.stages):
            shown: dict[tuple[str, str], int] = {}
            for grasp, scene in stage.grasps:
                key = (grasp.hand, grasp.object)
                if grasp.lift is not None and grasp.lift.success and shown.get(key, 0) < most:
                    shown[key] = shown.get(key, 0) + 1
                    units.append(ShowUnit(number, grasp, scene, replay=shown[key] == 1))
        with progress(len(units), "pictures and replays") as bar:
            for unit, shown_grasp in in_order(units, run_show, workers=self.workers):
                self.stages[unit.stage].shown.append(shown_grasp)
                bar.update()

    def write(self, folder: Path, command: str) -> Path:
        """Writes the report and the file of grasps."""
        from xdex_drake.dataset.grasp_file import write_grasps
        from xdex_drake.visualization.report import write_report

        if self.file_rows:
            write_grasps(folder / "grasps.parquet", self.file_rows)
        intro = (
            "Grasps of everyday shapes by one hand, the same grasps by other hands, and what a model that learned from "
            "such pairs proposes for hands; every one proved by a convex program and lifted in simulation."
        )
        sections = [stage.section() for stage in self.stages]
        return write_report(
            folder, sections, title="From one hand to others", intro=intro, seed=self.seed, command=command
        )


@dataclass(frozen=True)
class ShowUnit:
    """A grasp that shall be shown.

    Attributes:
        stage: Number of its stage.
        grasp: The grasp.
        scene: Its scene.
        replay: Whether its lift is recorded.
    """

    stage: int
    grasp: Grasp
    scene: SceneFacts
    replay: bool


def run_show(unit: ShowUnit) -> ReportGrasp:
    """Takes the picture of a grasp and records its lift.

    Args:
        unit: The grasp.

    Returns:
        The grasp with picture and replay.
    """
    from xdex_drake.hand.library import load_hand
    from xdex_drake.visualization.report import show_grasp

    # Meshcat tells of each address that it listens at.
    logging.getLogger("drake").setLevel(logging.WARNING)
    return show_grasp(unit.grasp, load_hand(unit.grasp.hand), unit.scene.build(), replay=unit.replay)


def _verdicts(grasps: Sequence[Grasp]) -> tuple[int, dict[str, int]]:
    """How many grasps lifted, and how often each reason failed one."""
    lifted, failed = 0, dict[str, int]()
    for grasp in grasps:
        if grasp.lift is not None and grasp.lift.success:
            lifted += 1
        elif grasp.lift is not None:
            failed[grasp.lift.failure_reason] = failed.get(grasp.lift.failure_reason, 0) + 1
    return lifted, failed


def _sum(one: Mapping[str, int], other: Mapping[str, int]) -> dict[str, int]:
    return dict(Counter(one) + Counter(other))
