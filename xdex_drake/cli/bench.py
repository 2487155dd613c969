"""`xdex bench`: how long each stage takes on this machine."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from xdex_drake.cli.output import (
    check_output_file,
    check_writable,
    facts,
    keeping_finished_work,
    one_thread,
    progress,
    table,
)

if TYPE_CHECKING:
    from xdex_drake.bench.watch import Watch

HANDS = ("allegro", "shadow", "ability", "schunk_svh", "inspire")


@dataclass(frozen=True)
class Bench:
    """How long the library takes here, by the median and the spread of repeats, and what came of it.

    Times are of one thread, wall and processor; a wall time well above the other says that the machine was busy.
    `force_closure` times a whole synthesis stage by stage, `wrench` the convex programs and certificates, `retargeting`
    grasps of one hand carried to the other hands, `ik` link-pose inverse kinematics of all hands in batches of 128.
    `problems` runs every problem of the library by every solver and draws their performance profiles beside it.
    Try `xdex bench wrench`. A table is printed, and written as JSON with machine, versions and seed beside a picture.

    Attributes:
        name: What to time.
        hand: The hand; for `retargeting` the source hand.
        object: The object.
        repeats: Number of candidates or grasps that are timed; of `ik` batches and starts of `problems`, a tenth of it.
        seed: Seed.
        out: A .json file for the figures; a picture of the same name is written beside it.
        time_limit: Seconds after which Drake's solvers give up on one start of `problems`.
    """

    name: tyro.conf.Positional[Literal["all", "force_closure", "wrench", "retargeting", "ik", "problems"]] = "all"
    hand: str = "allegro"
    object: str = "can"
    repeats: int = 20
    seed: int = 0
    out: Path = Path("bench.json")
    time_limit: float = 5.0

    def run(self) -> int:
        """Times, writes, prints a table for each benchmark."""
        one_thread()
        from xdex_drake.errors import ConfigError

        if self.repeats < 1:
            raise ConfigError(f"--repeats is {self.repeats}; give 1 or more")
        if not self.time_limit > 0.0:
            raise ConfigError(f"--time-limit is {self.time_limit:g}; give a number of seconds greater than zero")
        if self.seed < 0:
            raise ConfigError(f"--seed is {self.seed}; give 0 or more")
        check_output_file(self.out, ".json")
        check_writable(self.out.with_suffix(".svg"))
        import torch

        from xdex_drake.bench.problems import profile_picture
        from xdex_drake.bench.watch import Watch, content, picture
        from xdex_drake.whole_file import write_text

        torch.set_num_threads(1)
        conditions = {"hand": self.hand, "object": self.object, "repeats": self.repeats}
        contents, stages, runs = [], (), []
        with keeping_finished_work() as interruption:
            for name in _RUNS if self.name == "all" else (self.name,):
                watch = Watch()
                try:
                    _RUNS[name](self, watch)
                finally:  # what was timed before Ctrl-C is told
                    contents.append(content(name, watch, seed=self.seed, conditions=conditions))
                    stages += watch.stages()
                    runs += watch.runs
                    _print(name, watch)
        if not stages:
            return interruption.status(1)
        result: Any = contents[0] if len(contents) == 1 else {"benchmark": "all", "parts": contents}
        write_text(self.out, json.dumps(result, indent=1) + "\n")
        title = f"xdex bench {self.name}: times of one thread"
        write_text(self.out.with_suffix(".svg"), picture(title, stages))
        print(f"written to {self.out} and {self.out.with_suffix('.svg')}")
        if runs:
            profile = self.out.with_name(f"{self.out.stem}_profile.svg")
            write_text(profile, profile_picture("share of problems solved within a multiple of the fastest time", runs))
            print(f"performance profiles: {profile}")
        return interruption.status(0)


def _print(name: str, watch: Watch) -> None:
    """One table of times and one of facts."""
    rows = [
        (s.name, s.count, s.median_ms, s.p90_ms, s.processor_ms, "" if s.target_ms is None else f"{s.target_ms:g}")
        for s in watch.stages()
    ]
    print(table(rows, (name, "n", "median ms", "p90 ms", "processor ms", "target")))
    if watch.facts:
        print(facts(list(watch.facts.items())))
    print()


def _force_closure(command: Bench, watch: Watch) -> None:
    from xdex_drake.bench.force_closure import CANDIDATES, bench_force_closure
    from xdex_drake.hand.library import load_hand

    hand = load_hand(command.hand)
    with progress(min(command.repeats, CANDIDATES), f"{hand.name} {command.object}") as bar:
        bench_force_closure(watch, hand, command.object, repeats=command.repeats, seed=command.seed, tick=bar.update)


def _wrench(command: Bench, watch: Watch) -> None:
    from xdex_drake.bench.wrench import bench_wrench

    with progress(3 * command.repeats, "wrench") as bar:
        bench_wrench(watch, repeats=command.repeats, seed=command.seed, tick=bar.update)


def _retargeting(command: Bench, watch: Watch) -> None:
    from xdex_drake.bench.retargeting import bench_retargeting
    from xdex_drake.hand.library import load_hand
    from xdex_drake.scene.object import load_object
    from xdex_drake.scene.tabletop import make_scene

    source, scene = load_hand(command.hand), make_scene(load_object(command.object))
    targets = tuple(load_hand(name) for name in HANDS if name != source.name)
    with progress(command.repeats * len(targets), "retargeting") as bar:
        bench_retargeting(watch, source, targets, scene, repeats=command.repeats, seed=command.seed, tick=bar.update)


def _ik(command: Bench, watch: Watch) -> None:
    from xdex_drake.bench.ik import bench_ik
    from xdex_drake.hand.library import load_hand

    hands, repeats = tuple(load_hand(name) for name in HANDS), max(1, command.repeats // 10)
    with progress(repeats * len(hands), "ik") as bar:
        bench_ik(watch, hands, repeats=repeats, batch=128, seed=command.seed, tick=bar.update)


def _problems(command: Bench, watch: Watch) -> None:
    from xdex_drake.bench.problems import bench_problems
    from xdex_drake.problems.files import list_problems

    names, starts = list_problems(), max(1, command.repeats // 10)
    with progress(len(names), "problems") as bar:
        bench_problems(watch, names, starts=starts, time_limit_s=command.time_limit, tick=bar.update)
    solvers = list(dict.fromkeys(run["solver"] for run in watch.runs))
    cells: dict[str, dict[str, list[str]]] = {}
    for run in watch.runs:
        cell = f"{1e3 * run['seconds']:.0f} ms" if run["solved"] else run["worst"]
        cells.setdefault(run["problem"], {}).setdefault(run["solver"], []).append(cell)
    rows = [(name, *(", ".join(row.get(solver, [])) for solver in solvers)) for name, row in cells.items()]
    print(table(rows, ("problem: time, or the constraint left", *solvers)) + "\n")


_RUNS: dict[str, Callable[[Bench, Watch], None]] = {
    "wrench": _wrench,
    "ik": _ik,
    "retargeting": _retargeting,
    "force_closure": _force_closure,
    "problems": _problems,
}
