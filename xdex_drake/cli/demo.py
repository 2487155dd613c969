"""`xdex demo`: the whole path in minutes, on one page."""

from __future__ import annotations

import logging
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from xdex_drake.cli.output import check_writable, keeping_finished_work, one_thread, progress, table

if TYPE_CHECKING:
    from xdex_drake.dataset.schema import Row
    from xdex_drake.grasp import Grasp
    from xdex_drake.grasping.tally import Tally
    from xdex_drake.scene.facts import SceneFacts
    from xdex_drake.visualization.report import ReportGrasp, ReportSection

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
            path.synthesize(objects, count=2 if self.quick else 4)
            path.retarget(targets)
            path.predict(PREDICTED[:1] if self.quick else PREDICTED, objects[0], count=8 if self.quick else 16)
            path.show()
        index = path.write(self.out, f"xdex demo{' --quick' if self.quick else ''} --seed {self.seed}")
        rows = [(stage.title, *key, *tally.row()) for stage in path.stages for key, tally in stage.tallies.items()]
        header = ("stage", "hand", "object", "tried", "certified", "lifted", "rejected by", "failed by")
        print(table(rows, header))
        print(f"{time.perf_counter() - begin:.0f} s; open {index}")
        return interruption.status(0 if any(row[5] for row in rows) else 1)


def _tallies() -> defaultdict[tuple[str, str], Tally]:
    from xdex_drake.grasping.tally import Tally

    return defaultdict(Tally)


@dataclass
class _Stage:
    """What came of a stage.

    Attributes:
        title: Heading.
        text: What it did.
        tallies: Counts by hand and object.
        grasps: Certified grasps with their lifts and scenes.
        shown: Those that have a picture.
    """

    title: str
    text: str
    tallies: defaultdict[tuple[str, str], Tally] = field(default_factory=_tallies)
    grasps: list[tuple[Grasp, SceneFacts]] = field(default_factory=list)
    shown: list[ReportGrasp] = field(default_factory=list)

    def section(self) -> ReportSection:
        """The stage as a part of the report."""
        from xdex_drake.visualization.report import ReportRow, ReportSection

        rows = tuple(ReportRow(*key, tally) for key, tally in self.tallies.items())
        return ReportSection(self.title, self.text, rows, tuple(self.shown))


class _Path:
    """The stages of the demonstration and what they have made so far."""

    def __init__(self, seed: int, workers: int) -> None:
        self.seed, self.workers = seed, workers
        self.stages: list[_Stage] = []
        self.file_rows: list[Row] = []

    def _begin(self, title: str, text: str) -> _Stage:
        """A new stage, which shows from now on."""
        stage = _Stage(title, text)
        self.stages.append(stage)
        return stage

    def synthesize(self, objects: Sequence[str], count: int) -> None:
        """Grasps of each object by the source hand."""
        from xdex_drake.dataset.rows import rows_of
        from xdex_drake.hand.library import load_hand
        from xdex_drake.jobs.grasps import BatchUnit, GraspRequest, run_batch
        from xdex_drake.jobs.ordered import in_order
        from xdex_drake.scene.facts import SceneFacts
        from xdex_drake.scene.object import load_object
        from xdex_drake.scene.tabletop import make_scene

        hand = load_hand(SOURCE)
        text = "Found by a batched search, polished by a mathematical program, proved by a convex program, then lifted."
        stage = self._begin(f"Grasps by {hand.display_name}", text)
        scenes = {}
        with progress(len(objects), "prepare objects") as bar:
            for name in objects:
                model = load_object(name)
                model.grid  # noqa: B018 - computed once, here, and read from the cache by the workers
                scene = make_scene(model)
                scenes[SceneFacts.of(scene)] = scene
                bar.update()
        deadline = time.time() + TIME_LIMIT * len(objects)
        units = [BatchUnit(GraspRequest(SOURCE, scene, seed=self.seed), 0, count, deadline) for scene in scenes]
        with progress(len(units), "synthesise") as bar:
            for done in in_order(units, run_batch, workers=self.workers):
                facts, batch = done.unit.request.scene, done.value
                if batch is not None:
                    scene = scenes[facts]
                    self.file_rows += rows_of(batch.grasps, hand, scene)
                    stage.grasps += [(grasp, facts) for grasp in batch.grasps]
                    stage.tallies[hand.name, scene.object.name].merge(batch.tally)
                bar.update()

    def retarget(self, targets: Sequence[str]) -> None:
        """The lifted grasps of the first stage by other hands."""
        from xdex_drake.dataset.rows import rows_of
        from xdex_drake.hand.library import load_hand
        from xdex_drake.jobs.stored import RetargetUnit, retarget_all

        text = (
            "Fingertips and wrist are matched by name, under the same constraints as any grasp. For each hand and "
            "object the lifted grasps are carried over in turn until one of them lifts."
        )
        stage = self._begin("The same grasps by other hands", text)
        sources: defaultdict[str, list[tuple[Grasp, SceneFacts]]] = defaultdict(list)
        for grasp, scene in self.stages[0].grasps:
            if grasp.lift is not None and grasp.lift.success:
                sources[grasp.object].append((grasp, scene))
        hands = {name: load_hand(name) for name in targets}
        points = {row["grasp_id"]: row["object_point_O"] for row in self.file_rows}
        scenes = {
            facts: facts.build() for facts in dict.fromkeys(scene for each in sources.values() for _, scene in each)
        }
        wanted = {(target, name) for target in targets for name in sources}
        with progress(len(wanted), "retarget") as bar:
            for k in range(max((len(each) for each in sources.values()), default=0)):
                units = [
                    RetargetUnit(k, *sources[name][k], SOURCE, target)
                    for target, name in sorted(wanted)
                    if k < len(sources[name])
                ]
                for unit, outcome in retarget_all(units, workers=self.workers):
                    tally = stage.tallies[unit.target, unit.grasp.object]
                    tally.add(outcome)
                    if outcome.grasp is None:
                        continue
                    tally.seconds += outcome.grasp.seconds
                    stage.grasps.append((outcome.grasp, unit.scene))
                    self.file_rows += rows_of(
                        [outcome.grasp], hands[unit.target], scenes[unit.scene], source_points=points
                    )
                    if outcome.grasp.lift is not None and outcome.grasp.lift.success:
                        wanted.remove((unit.target, unit.grasp.object))
                        bar.update()

    def predict(self, hands: Sequence[str], name: str, count: int) -> None:
        """Grasps from the model that the library ships."""
        from xdex_drake.dataset.rows import rows_of
        from xdex_drake.hand.library import load_hand
        from xdex_drake.jobs.grasps import propose_batches
        from xdex_drake.learning.checkpoint import FILE_NAME
        from xdex_drake.learning.proposer import ModelProposer, default_checkpoint
        from xdex_drake.scene.facts import SceneFacts
        from xdex_drake.scene.object import load_object
        from xdex_drake.scene.tabletop import make_scene

        text = (
            "Link poses are drawn by the small model that the library ships, then polished and proved like any grasp."
        )
        stage = self._begin("Predicted by the model", text)
        if not (default_checkpoint() / FILE_NAME).is_file():
            stage.text = "The library was installed without its small model, so that this stage was left out."
            return
        scene = make_scene(load_object(name))
        facts = SceneFacts.of(scene)
        batches = propose_batches(
            ModelProposer(str(default_checkpoint())), hands, facts, count=count, seed=self.seed, workers=self.workers
        )
        with progress(count * len(hands), "predict") as bar:
            for unit, batch in batches:
                hand = load_hand(unit.hand)
                stage.tallies[hand.name, name].merge(batch.tally)
                self.file_rows += rows_of(batch.grasps, hand, scene)
                stage.grasps += [(grasp, facts) for grasp in batch.grasps]
                bar.update(unit.count)

    def show(self) -> None:
        """Pictures and replays: a lifted grasp of each hand and object, and the grasps that it comes from."""
        from xdex_drake.jobs.ordered import in_order

        chosen: list[ShowUnit] = []
        sources: set[str] = set()
        # From the last stage to the first: what is carried over is shown beside what it comes from.
        for number, stage in reversed(list(enumerate(self.stages))):
            shown: set[str] = set()
            lifted = [(g, scene) for g, scene in stage.grasps if g.lift is not None and g.lift.success]
            lifted.sort(key=lambda item: item[0].grasp_id not in sources)
            for grasp, scene in lifted:
                key = f"{grasp.hand} {grasp.object}"
                if key not in shown or grasp.grasp_id in sources:
                    shown.add(key)
                    sources.add(grasp.source_grasp_id)
                    chosen.append(ShowUnit(number, grasp, scene))
        chosen.reverse()
        with progress(len(chosen), "pictures and replays") as bar:
            for done in in_order(chosen, run_show, workers=self.workers):
                if done.value is not None:
                    self.stages[done.unit.stage].shown.append(done.value)
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
    """

    stage: int
    grasp: Grasp
    scene: SceneFacts


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
    return show_grasp(unit.grasp, load_hand(unit.grasp.hand), unit.scene.build())
