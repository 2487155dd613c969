"""`xdex dataset ...`: paired data sets."""

from __future__ import annotations

import json
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from xdex_drake.cli.output import (
    check_output_file,
    check_writable,
    facts,
    keeping_finished_work,
    one_thread,
    print_yaml,
    progress,
    table,
)

if TYPE_CHECKING:
    from xdex_drake.jobs.processes import UnitResult


LISTED = 40
"""Hands and objects of a data set that are listed."""


@dataclass(frozen=True)
class DatasetGenerate:
    """Makes a paired data set: grasps of a source hand, and the same grasps by other hands.

    A run that was stopped goes on when the same command is given again, and the same configuration gives the same rows
    whatever the number of workers. Without a configuration file, its keys and defaults are printed.
    Try `xdex dataset generate --print-config > pairs.yaml`, then `xdex dataset generate pairs.yaml --out pairs`.

    Attributes:
        config: A YAML file; what it leaves out keeps its default.
        out: Folder of the data set.
        workers: Number of processes.
        shard: Make only a part of the units, 2/8 for the second of eight; parts may run at once.
        table: A compact table: units that it holds are not made again, and those that are made are appended to it.
        ray: Let a Ray cluster work instead of processes here: its address HOST:6379, auto, or local for one that is
            started here; needs `pip install 'xdex_drake[ray]'` on every machine.
        print_config: Print the resolved configuration and do nothing.
    """

    config: tyro.conf.Positional[Path | None] = None
    out: Path = Path("dataset")
    workers: int = 2
    shard: str | None = None
    table: Path | None = None
    ray: str | None = None
    print_config: tyro.conf.FlagCreatePairsOff[bool] = False

    def run(self) -> int:
        """Generates, then tells what the folder holds."""
        one_thread()
        from xdex_drake.dataset.folder import completed_units
        from xdex_drake.errors import ConfigError
        from xdex_drake.jobs.compaction import table_units
        from xdex_drake.jobs.pairs import DatasetConfig, generate, part_of, plan
        from xdex_drake.typed_yaml import read_typed_yaml

        config = DatasetConfig() if self.config is None else read_typed_yaml(self.config, DatasetConfig)
        if self.print_config:
            return print_yaml(config)
        if self.config is None:
            raise ConfigError("no configuration file is given; begin with `xdex dataset generate --print-config`")
        if self.workers < 0:
            raise ConfigError(f"--workers is {self.workers}; give 0 or more")
        if self.ray is not None:
            from xdex_drake.jobs.ray import ray_module

            ray_module()
        shard = None if self.shard is None else _part(self.shard)
        units = part_of(plan(config), shard)
        check_writable(self.out / "manifest.json")
        done = completed_units(self.out) | (set() if self.table is None else table_units(self.table))
        missing = len({unit.name for unit in units} - done)
        with keeping_finished_work() as interruption, progress(missing, "units") as bar:

            def tell(done: UnitResult) -> None:
                bar.set_postfix_str(done.unit.name, refresh=False)
                bar.update()

            generate(config, self.out, workers=self.workers, shard=shard, table=self.table, ray=self.ray, on_done=tell)
        if not (self.out / "manifest.json").exists():
            return interruption.status(1)
        rows = _print_info(self.out)
        if interruption.happened:
            print("interrupted: give the same command again to go on")
        return interruption.status(0 if rows else 1)


@dataclass(frozen=True)
class DatasetInfoCommand:
    """Counts what a data set holds, by hand and by object.

    Attributes:
        folder: Folder of the data set.
    """

    folder: tyro.conf.Positional[Path]

    def run(self) -> int:
        """Prints tables."""
        return 0 if _print_info(self.folder) else 1


@dataclass(frozen=True)
class DatasetVerify:
    """Checks a data set: that every shard is whole, every grasp unique, every source there, every certificate sound.

    Certificates are checked in plain NumPy, without a solver.

    Attributes:
        folder: Folder of the data set.
        json: Print the report as JSON.
    """

    folder: tyro.conf.Positional[Path]
    json: tyro.conf.FlagCreatePairsOff[bool] = False

    def run(self) -> int:
        """Prints what was checked and everything that is wrong; exit status 1 where something is."""
        from xdex_drake.dataset.verify import verify
        from xdex_drake.typed_yaml import to_plain

        report = verify(self.folder)
        if self.json:
            print(json.dumps(to_plain(report), indent=1))
            return 0 if report.ok else 1
        lines = [
            ("shards", report.shards),
            ("rows", report.rows),
            ("lifted", report.successes),
            ("certificates checked", report.certificates_checked),
            ("units still to be made", len(report.missing_units)),
            ("problems", len(report.problems)),
        ]
        print(facts(lines))
        if report.problems:
            rows = [(problem.unit, problem.grasp_id, problem.reason) for problem in report.problems]
            print("\n" + table(rows, ("unit", "grasp", "what is wrong")))
        return 0 if report.ok else 1


@dataclass(frozen=True)
class DatasetCard:
    """Writes the card of a data set: what it holds, what was attempted, what lifted, and why the rest did not.

    Pictures show grasps that were carried to most hands; they are written beside the card.
    Try `xdex dataset card pairs --out pairs/README.md`.

    Attributes:
        folder: Folder of the data set.
        out: The Markdown file; `README.md` in the folder where none is given.
        pictures: Greatest number of pictures; 0 for none.
    """

    folder: tyro.conf.Positional[Path]
    out: Path | None = None
    pictures: int = 3

    def run(self) -> int:
        """Writes the card and prints it."""
        one_thread()
        from xdex_drake.dataset.card import card
        from xdex_drake.whole_file import write_text

        out = self.out or self.folder / "README.md"
        check_writable(out)
        text = card(self.folder, self._pictures(out))
        write_text(out, text)
        print(text, end="")
        return 0

    def _pictures(self, out: Path) -> list[tuple[str, str]]:
        """Writes the pictures; their paths relative to the card, and what they show."""
        from PIL import Image

        from xdex_drake.dataset.versions import most_carried
        from xdex_drake.visualization.pictures import can_render
        from xdex_drake.visualization.versions import picture_of_versions
        from xdex_drake.whole_file import whole_file

        if self.pictures < 1:
            return []
        if not can_render():
            print("xdex: pictures cannot be rendered on this machine, and are left out", file=sys.stderr)
            return []
        folder, told = out.parent / f"{out.stem}_pictures", []
        for k, versions in enumerate(most_carried(self.folder, sources=self.pictures)):
            folder.mkdir(parents=True, exist_ok=True)
            with whole_file(folder / f"{k}.jpg") as unfinished:
                Image.fromarray(picture_of_versions(versions)).save(unfinished, format="JPEG", quality=88)
            first = versions[0]
            caption = f"{first.scene.object.name}: a grasp by {first.hand.name} and its versions by other hands"
            told.append((f"{folder.name}/{k}.jpg", caption))
        return told


@dataclass(frozen=True)
class DatasetView:
    """The grasps of a data set that are most likely to hold: a table, and on demand a page.

    P(lift) and P(hold) are foretold from what is stored with a grasp, by the scores that ship with the library. Of each
    hand and scene the best grasp is listed. Try `xdex dataset view pairs --html best.html`.

    Attributes:
        folder: Folder of the data set.
        count: Greatest number of grasps.
        hand: Grasps of this hand alone.
        html: Also write a page that shows them side by side.
    """

    folder: tyro.conf.Positional[Path]
    count: int = 12
    hand: str | None = None
    html: Path | None = None

    def run(self) -> int:
        """Ranks, prints, writes the page."""
        one_thread()
        from xdex_drake.cli.show import score_cells
        from xdex_drake.dataset.ranking import best_grasps
        from xdex_drake.errors import ConfigError

        if self.count < 1:
            raise ConfigError(f"--count is {self.count}; give 1 or more")
        if self.html is not None:
            check_output_file(self.html, ".html")
        best = best_grasps(self.folder, count=self.count, hand=self.hand)
        cells = score_cells([ranked.grasp for ranked in best])
        rows = [
            (ranked.grasp.grasp_id, *probabilities, *ranked.outcome())
            for ranked, probabilities in zip(best, cells, strict=True)
        ]
        print(table(rows, ("grasp", "P(lift)", "P(hold)", "lifted", "held")))
        if best and self.html is not None:
            from xdex_drake.dataset.ranking import stored_grasps
            from xdex_drake.visualization.replay import grasp_page
            from xdex_drake.whole_file import write_text

            stored = stored_grasps(self.folder, best)
            shown = [item.grasp for item in stored], [item.hand for item in stored], [item.scene for item in stored]
            write_text(self.html, grasp_page(*shown))
            print(f"written to {self.html}")
        return 0 if best else 1


@dataclass(frozen=True)
class DatasetMetrics:
    """How consistent a data set's lifted grasps are across hands, and how many different ways lift an object.

    Position difference: mean distance of corresponding fingertips and wrists in the world; vector difference: that of
    fingertips in the wrist frame. Grasps are distinct where they are 2 cm or more apart by position difference.

    Attributes:
        folder: Folder of the data set.
        units: Greatest number of units that are read, evenly spread.
    """

    folder: tyro.conf.Positional[Path]
    units: int = 50

    def run(self) -> int:
        """Measures, prints."""
        one_thread()
        from xdex_drake.errors import ConfigError
        from xdex_drake.evaluation.measure import measure

        if self.units < 1:
            raise ConfigError(f"--units is {self.units}; give 1 or more")
        found = measure(self.folder, units=self.units)
        kinds = {"versions of one grasp": found.matched, "any two of one scene": found.all}
        rows = [(name, c.pairs, f"{c.position_cm:.2f}", f"{c.vector_cm:.2f}") for name, c in kinds.items()]
        print(table(rows, ("pairs by different hands", "pairs", "position difference [cm]", "vector difference [cm]")))
        lines = [
            ("lifted grasps", found.grasps),
            ("scenes", found.scenes),
            ("distinct grasps a scene", f"{found.distinct:.1f}"),
            ("surface near a contact", f"{found.coverage:.2f}"),
            ("normalised entropy of joint values", f"{found.entropy:.2f}"),
        ]
        print("\n" + facts(lines))
        return 0 if found.grasps else 1


@dataclass(frozen=True)
class DatasetCompact:
    """Keeps a data set in some 60 bytes a grasp, in files below 10 MB that are appended to and never rewritten.

    Certificates, pre-grasps and squeezes are left out and computed again by `xdex dataset expand`.
    Try `xdex dataset compact pairs --out table`, then `xdex dataset expand table --out pairs2`.

    Attributes:
        folder: Folder of the data set.
        out: Folder of the compact table; units that it lacks are appended.
    """

    folder: tyro.conf.Positional[Path]
    out: Path = Path("table")

    def run(self) -> int:
        """Appends what is missing, prints what the table holds."""
        one_thread()
        from xdex_drake.dataset.folder import open_dataset, read_manifest
        from xdex_drake.dataset.lock import locked
        from xdex_drake.dataset.tables import table_files
        from xdex_drake.jobs.compaction import compact_dataset

        manifest = read_manifest(self.folder)
        check_writable(self.out / "manifest.json")
        open_dataset(self.out, manifest)
        with locked(self.out):
            units, rows = compact_dataset(self.folder, self.out)
        size = sum(path.stat().st_size for path in table_files(self.out))
        print(facts([("units appended", units), ("rows appended", rows), ("size [MB]", f"{size / 1e6:.3f}")]))
        return 0 if size else 1


@dataclass(frozen=True)
class DatasetExpand:
    """Makes a data set from a compact table: certificates, pre-grasps and squeezes are computed again.

    Attributes:
        table: Folder of the table.
        out: Folder of the data set; units that are there stay.
        workers: Number of processes.
    """

    table: tyro.conf.Positional[Path]
    out: Path = Path("dataset")
    workers: int = 2

    def run(self) -> int:
        """Expands, then tells what the folder holds and what of the table is damaged."""
        one_thread()
        from xdex_drake.dataset.folder import completed_units, read_manifest
        from xdex_drake.dataset.tables import Damage, read_records
        from xdex_drake.errors import ConfigError
        from xdex_drake.jobs.compaction import expand_table, table_units

        if self.workers < 0:
            raise ConfigError(f"--workers is {self.workers}; give 0 or more")
        read_manifest(self.table)
        check_writable(self.out / "manifest.json")
        missing = len(table_units(self.table) - completed_units(self.out))
        with keeping_finished_work() as interruption, progress(missing, "units") as bar:

            def tell(done: UnitResult) -> None:
                bar.set_postfix_str(done.unit.header.unit, refresh=False)
                bar.update()

            expand_table(self.table, self.out, workers=self.workers, on_done=tell)
        damages = [record for record in read_records(self.table) if isinstance(record, Damage)]
        rows = _print_info(self.out)
        if damages:
            print("\n" + table([(str(damage),) for damage in damages], ("damaged",)))
        return interruption.status(0 if rows and not damages else 1)


@dataclass(frozen=True)
class DatasetPack:
    """Packs a data set or its compact table into one file with all that training needs, read where torch alone is.

    Then `python -m xdex_drake.learning.training CONFIG.yaml --pack FILE.safetensors --out DIR` trains on any machine.
    Try `xdex dataset pack pairs --out pairs.safetensors`.

    Attributes:
        folder: Folder of the data set, or of its compact table.
        out: The file.
        splits: A YAML file that lists `validation_scenes` and `validation_hands`; training chooses scenes without it.
        failures: Grasps that did not lift to keep, at most this many for each that did.
    """

    folder: tyro.conf.Positional[Path]
    out: Path = Path("pack.safetensors")
    splits: Path | None = None
    failures: float = 1.0

    def run(self) -> int:
        """Packs, prints what the file holds."""
        one_thread()
        from xdex_drake.errors import ConfigError
        from xdex_drake.learning.pack import LIFTED, write_pack
        from xdex_drake.learning.samples import Splits, pack_dataset
        from xdex_drake.typed_yaml import read_typed_yaml

        if not self.failures >= 0.0:
            raise ConfigError(f"--failures is {self.failures}; give 0 or more")
        check_output_file(self.out, ".safetensors")
        splits = None if self.splits is None else read_typed_yaml(self.splits, Splits)
        pack = pack_dataset(self.folder, splits=splits, failures=self.failures)
        write_pack(pack, self.out)
        lines = [
            ("hands", len(pack.hand_names)),
            ("scenes", len(pack.scene_names)),
            ("grasps that lifted", int((pack.outcome == LIFTED).sum())),
            ("grasps that did not", int((pack.outcome != LIFTED).sum())),
            ("scenes that validate", int(pack.held_scenes.sum())),
            ("hands that validate", int(pack.held_hands.sum())),
            ("size [MB]", f"{self.out.stat().st_size / 1e6:.2f}"),
            ("file", str(self.out)),
        ]
        print(facts(lines))
        return 0


@dataclass(frozen=True)
class Train:
    """Trains the cross-embodiment model on a paired data set or a training pack, on a CPU or a GPU.

    Ctrl-C ends the run after the current step with everything saved, and a run that was killed lost five minutes at the
    most; the same command goes on from there. A long training is a list of runs, each --from the one before.
    Try `xdex train --print-config > train.yaml`, then `xdex train train.yaml --data pairs --out model`.

    Attributes:
        config: A YAML file; what it leaves out keeps its default. Without it, all defaults hold.
        data: Folder of the data set.
        pack: A training pack, instead of a data set.
        out: Folder for the model, its log and the state to go on from.
        start: A checkpoint whose weights to start from: the run before, or a model to teach one's own hands.
        steps: Another number of steps than the configuration's.
        minutes: Another limit of time than the configuration's.
        print_config: Print the resolved configuration and do nothing.
    """

    config: tyro.conf.Positional[Path | None] = None
    data: Path | None = None
    pack: Path | None = None
    out: Path = Path("model")
    start: Annotated[Path | None, tyro.conf.arg(name="from")] = None
    steps: int | None = None
    minutes: float | None = None
    print_config: tyro.conf.FlagCreatePairsOff[bool] = False

    def run(self) -> int:
        """Trains, prints what was done."""
        from xdex_drake.errors import ConfigError
        from xdex_drake.learning.training import read_train_config, train

        config = read_train_config(self.config, steps=self.steps, minutes=self.minutes)
        if self.print_config:
            return print_yaml(config)
        if self.data is not None and self.pack is not None:
            raise ConfigError("--data and --pack are both given; give one of them")
        check_writable(self.out / "model.safetensors")
        if self.pack is not None:
            from xdex_drake.learning.pack import read_pack

            pack = read_pack(self.pack)
        else:
            from xdex_drake.learning.samples import pack_dataset

            pack = pack_dataset(self.data or Path("dataset"))
        report = train(config, pack, self.out, start=self.start)
        print(facts(report.lines()))
        return 130 if report.stopped == "interrupted" else 0


def _part(text: str) -> tuple[int, int]:
    """The two numbers of `2/8`."""
    from xdex_drake.errors import ConfigError

    number, slash, count = text.partition("/")
    if not (slash and number.isdecimal() and count.isdecimal()):
        raise ConfigError(f"--shard is {text!r}; give the part and how many there are, like 2/8")
    return int(number), int(count)


def _print_info(folder: Path) -> int:
    """Prints what a data set holds; returns the number of its rows."""
    from xdex_drake.dataset.summary import info
    from xdex_drake.grasping.tally import counted

    summary = info(folder)
    print(
        facts(
            [
                ("units", f"{summary.units_done} of {summary.units_planned}"),
                ("grasps", summary.rows),
                ("lifted", summary.successes),
                ("source grasps", summary.sources),
                ("lifts failed by", counted(Counter(summary.failure_reasons))),
                ("seconds of work", f"{summary.seconds:.0f}"),
                ("size [MB]", f"{summary.bytes / 1e6:.2f}"),
            ]
        )
    )
    for title, groups in (("hand", summary.by_hand), ("object", summary.by_object)):
        rows = [(name, c.rows, c.successes, f"{100.0 * c.successes / c.rows:.0f} %") for name, c in groups.items()]
        if rows:
            print("\n" + table(rows[:LISTED], (title, "grasps", "lifted", "rate")))
        if len(rows) > LISTED:
            print(f"... and {len(rows) - LISTED} more")
    if summary.failures:
        print("\n" + table(sorted(summary.failures.items()), ("failed unit", "reason")))
    return summary.rows
