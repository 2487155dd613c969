"""The bench: a model's draws for many hands on many scenes, taken to each stage and lifted; resumable, by jobs.

A unit is a hand on a scene. Its verdicts and its grasps become files whole or not at all; a run that was stopped goes
on with the units that are missing, and gives the same rows whatever the number of workers.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from xdex_drake.dataset.grasp_file import write_grasps
from xdex_drake.dataset.lock import locked
from xdex_drake.dataset.rows import rows_of, timeless
from xdex_drake.dataset.schema import Row
from xdex_drake.errors import ConfigError
from xdex_drake.evaluation.verdicts import Stage, Verdict, judge, read_verdicts, write_verdicts
from xdex_drake.jobs.population import expand_names
from xdex_drake.jobs.processes import run_units
from xdex_drake.jobs.workbench import hand_of, rig_of, scene_of, use_one_thread
from xdex_drake.learning.checkpoint import checkpoint_digest
from xdex_drake.learning.proposer import default_checkpoint, draw_raw, load_model
from xdex_drake.scene.facts import SceneFacts
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import resting_scene
from xdex_drake.typed_yaml import to_plain
from xdex_drake.whole_file import write_text


@dataclass(frozen=True)
class BenchConfig:
    """What to judge.

    Attributes:
        model: A checkpoint, or the folder that holds it; the library's own where None.
        hands: Names, paths or ranges of hands by groups, such as `unseen`.
        objects: Names, paths or ranges of objects.
        scenes_per_object: Poses at rest of each object.
        scale: Factor on the objects' sizes; None leaves a mesh the scale that is guessed.
        stages: Stages: `raw`, `refined`, `best`.
        draws: Draws of which the best is chosen.
        judged: Draws that are judged one by one, the first of them.
        seed: Seed of scenes and draws.
    """

    model: str | None = None
    hands: dict[str, tuple[str, ...]] = field(default_factory=dict)
    objects: tuple[str, ...] = ()
    scenes_per_object: int = 1
    scale: float | None = None
    stages: tuple[Stage, ...] = ("raw", "refined", "best")
    draws: int = 16
    judged: int = 4
    seed: int = 0


@dataclass(frozen=True)
class Cell:
    """A hand on a scene.

    Attributes:
        name: Name of its files.
        group: Group of the hand.
        hand: Name or path of the hand.
        scene: The scene.
        checkpoint: The model.
        stages: Stages.
        draws: Draws.
        judged: Draws that are judged one by one.
        seed: Seed of the draws; that of the scene, so that hands correspond.
    """

    name: str
    group: str
    hand: str
    scene: SceneFacts
    checkpoint: str
    stages: tuple[Stage, ...]
    draws: int
    judged: int
    seed: int


def cells(config: BenchConfig) -> list[Cell]:
    """The units of a bench.

    Args:
        config: What to judge.

    Returns:
        The cells, scene by scene.

    Raises:
        ConfigError: It names no hand, object or stage, or counts nothing.
        XdexError: An object cannot be used.
    """
    if not config.hands or not config.objects or not config.stages:
        raise ConfigError("'hands', 'objects' and 'stages' must each name something to judge")
    if min(config.draws, config.judged, config.scenes_per_object) < 1 or config.judged > config.draws:
        raise ConfigError("'draws', 'judged' and 'scenes_per_object' must be 1 or more, and 'judged' at most 'draws'")
    checkpoint = str(default_checkpoint() if config.model is None else config.model)
    hands = [(g, name) for g, names in config.hands.items() for name in expand_names(names, f"hands.{g}")]
    found = []
    for name in expand_names(config.objects, "objects"):
        model = load_object(name, scale=config.scale)
        for index in range(config.scenes_per_object):
            scene = resting_scene(model, index=index, seed=config.seed)
            facts = SceneFacts.of(scene)
            for group, hand in hands:
                unit = f"{scene.scene_id}-{group}-{Path(hand).stem}"
                seed = config.seed + int(model.digest[:6], 16) + index
                found.append(
                    Cell(unit, group, hand, facts, checkpoint, config.stages, config.draws, config.judged, seed)
                )
    return found


def run_cell(cell: Cell) -> tuple[list[Verdict], list[Row]]:
    """Judges a hand on a scene.

    Args:
        cell: The cell.

    Returns:
        Verdicts, and the rows of all grasps.
    """
    use_one_thread()
    hand, scene, rig = hand_of(cell.hand), scene_of(cell.scene), rig_of(cell.hand, cell.scene)
    raw = draw_raw(load_model(cell.checkpoint), hand, scene, count=cell.draws, seed=cell.seed)
    judged = judge(hand, scene, rig, raw, cell.stages, judged=cell.judged, group=cell.group, seed=cell.seed)
    verdicts, grasps = zip(*judged, strict=True)
    return list(verdicts), rows_of([timeless(grasp) for grasp in grasps if grasp is not None], hand, scene)


def run_bench(
    config: BenchConfig,
    out: str | Path,
    *,
    workers: int = 2,
    on_done: Callable[[Cell], None] | None = None,
) -> list[Verdict]:
    """Judges what is missing of a bench.

    Args:
        config: What to judge.
        out: Folder: `bench.json`, a CSV file of verdicts a cell, and a Parquet file of its grasps.
        workers: Number of processes; 0 works in this one.
        on_done: Called after each cell.

    Returns:
        All verdicts, in the order of the cells.

    Raises:
        ConfigError: The folder holds another bench, or a cell was lost.
        XdexError: Hands, objects or model cannot be used.
    """
    units, out = cells(config), Path(out)
    out.mkdir(parents=True, exist_ok=True)
    _same_bench(config, out / "bench.json", units[0].checkpoint)
    with locked(out):
        missing = [cell for cell in units if not _file(out, cell).exists()]
        for done in run_units(missing, run_cell, workers=workers, timeout_s=1800.0):
            if done.value is None:
                if done.failure is not None and done.failure.error is not None:
                    raise done.failure.error
                raise ConfigError(f"cell {done.unit.name} was lost: {done.failure}; give the command again to go on")
            verdicts, rows = done.value
            if rows:
                write_grasps(_file(out, done.unit).with_suffix(".parquet"), rows)
            write_verdicts(_file(out, done.unit), verdicts)
            if on_done is not None:
                on_done(done.unit)
    return list(finished(config, out))


def finished(config: BenchConfig, out: str | Path) -> Iterator[Verdict]:
    """Verdicts of the cells that are there, in the order of the cells."""
    for cell in cells(config):
        file = _file(Path(out), cell)
        if file.exists():
            yield from read_verdicts(file)


def missing_cells(config: BenchConfig, out: str | Path) -> int:
    """How many cells are still to be judged."""
    return sum(not _file(Path(out), cell).exists() for cell in cells(config))


def _file(out: Path, cell: Cell) -> Path:
    return out / "cells" / f"{cell.name}.csv"


def _same_bench(config: BenchConfig, file: Path, checkpoint: str) -> None:
    """Begins a folder, or refuses one of another bench."""
    said = json.loads(json.dumps({"config": to_plain(config), "model": checkpoint_digest(checkpoint)}))
    if not file.exists():
        (file.parent / "cells").mkdir(exist_ok=True)
        write_text(file, json.dumps(said, indent=1) + "\n")
        return
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError(f"{file}: is damaged; delete it, and the cells beside it") from error
    if found != said:
        raise ConfigError(f"{file}: the folder holds another bench, or one of another model; give another --out")
