"""`xdex bench`: how long each stage takes on this machine."""

from __future__ import annotations

import json
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from xdex_drake.cli.output import check_output_file, keeping_finished_work, one_thread, progress, table


@dataclass(frozen=True)
class Bench:
    """How long search, polish, certificate and lift take here, by the median and the spread of repeats.

    Times are of one thread, wall and processor; a wall time well above the other says that the machine was busy.
    Try `xdex bench`, or `xdex bench wrench` for the convex programs alone.

    Attributes:
        name: What to time: `force_closure` for a whole synthesis, `wrench` for the convex programs.
        hand: The hand.
        object: The object.
        repeats: Number of candidates that are timed.
        out: A file for the same figures as JSON.
    """

    name: tyro.conf.Positional[Literal["all", "force_closure", "wrench"]] = "all"
    hand: str = "allegro"
    object: str = "can"
    repeats: int = 20
    out: Path = Path("bench.json")

    def run(self) -> int:
        """Times, writes, prints a table."""
        one_thread()
        from xdex_drake.errors import ConfigError

        if self.repeats < 1:
            raise ConfigError(f"--repeats is {self.repeats}; give 1 or more")
        check_output_file(self.out, ".json")
        watch = _Watch()
        with keeping_finished_work() as interruption:
            if self.name in ("all", "wrench"):
                _wrench(watch, self.repeats)
            if self.name in ("all", "force_closure"):
                _force_closure(watch, self.hand, self.object, self.repeats)
        rows = watch.rows()
        print(table(rows, ("stage", "n", "median ms", "p90 ms", "processor ms")))
        from importlib.metadata import version

        from xdex_drake.cli.show import write_text

        names = ("stage", "n", "median_ms", "p90_ms", "processor_ms")
        content: dict[str, Any] = {
            "benchmark": self.name,
            "hand": self.hand,
            "object": self.object,
            "machine": f"{platform.machine()}, Python {platform.python_version()}",
            "versions": {package: version(package) for package in ("xdex_drake", "drake", "torch", "clarabel", "daqp")},
            "counts": watch.counts,
            "stages": [dict(zip(names, row, strict=True)) for row in rows],
        }
        write_text(self.out, json.dumps(content, indent=1) + "\n")
        print(", ".join(f"{name} {count}" for name, count in watch.counts.items()) + f"\nwritten to {self.out}")
        return interruption.status(0 if rows else 1)


class _Watch:
    """Times of stages, and counts of what came of them."""

    def __init__(self) -> None:
        self.times: dict[str, list[tuple[float, float]]] = {}
        self.counts: dict[str, int] = {}

    def time(self, stage: str, work: Callable[[], Any], share: int = 1) -> Any:
        """Runs work once and keeps its time, divided by `share`."""
        wall, processor = time.perf_counter(), time.process_time()
        value = work()
        took = (time.perf_counter() - wall, time.process_time() - processor)
        self.times.setdefault(stage, []).append((took[0] / share, took[1] / share))
        return value

    def count(self, name: str, more: int = 1) -> None:
        """Counts an event."""
        self.counts[name] = self.counts.get(name, 0) + more

    def rows(self) -> list[tuple[str, int, float, float, float]]:
        """One row a stage."""
        rows = []
        for stage, times in self.times.items():
            walls = sorted(1e3 * wall for wall, _ in times)
            p90 = walls[min(len(walls) - 1, int(0.9 * len(walls)))]
            processor = statistics.median(1e3 * cpu for _, cpu in times)
            rows.append((stage, len(times), statistics.median(walls), p90, processor))
        return rows


def _wrench(watch: _Watch, repeats: int) -> None:
    """The convex programs on random four-contact grasps of a ball."""
    import numpy as np

    from xdex_drake import contact

    rng = np.random.default_rng(0)
    gravity, pushes = contact.gravity_wrench(0.1), contact.push_wrenches(0.1)
    with progress(repeats, "wrench") as bar:
        for _ in range(repeats):
            out = rng.normal(size=(4, 3)) + 1.5 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
            out /= np.linalg.norm(out, axis=1, keepdims=True)
            G = contact.grasp_matrix(0.035 * out, contact.contact_frames(-out), np.zeros(3))
            watch.time("balance", lambda G=G: contact.balance(G, 0.6, gravity, length=0.035))
            watch.time("task margin", lambda G=G: contact.task_margin(G, 0.6, gravity, pushes, length=0.035))
            watch.time("ball margin", lambda G=G: contact.ball_margin(G, 0.6, length=0.035))
            bar.update()


def _force_closure(watch: _Watch, hand_name: str, object_name: str, repeats: int) -> None:
    """Search, polish, certificate and lift of the candidates of one search."""
    import torch

    from xdex_drake.dataset.synthesis import finish_grasp
    from xdex_drake.hand.library import load_hand
    from xdex_drake.programs.force_closure import program_of_candidate
    from xdex_drake.programs.search import search
    from xdex_drake.programs.solve import solve
    from xdex_drake.scene.object import load_object
    from xdex_drake.scene.tabletop import make_scene
    from xdex_drake.simulation.lift import lift_rig, simulate_lift

    torch.set_num_threads(1)
    hand = load_hand(hand_name)
    model = watch.time("object (cached where it was used before)", lambda: load_object(object_name))
    scene = watch.time("scene", lambda: make_scene(model))
    watch.time("distance grid (cached likewise)", lambda: model.grid)
    rig = watch.time("lift rig", lambda: lift_rig(hand, scene))
    found = watch.time("search, a candidate of 64", lambda: search(hand, scene, count=64, seed=0), share=64)
    with progress(repeats, f"{hand.name} {model.name}") as bar:
        for row in range(min(repeats, 64)):
            program = program_of_candidate(hand, scene, found, row)
            result = watch.time("polish", lambda program=program: solve(program))
            watch.count("tried")
            if result.success:
                outcome = watch.time("certificate and pre-grasp", lambda r=result: finish_grasp(hand, r.point))
                if outcome.grasp is not None:
                    watch.count("certified")
                    lift = watch.time("lift", lambda grasp=outcome.grasp: simulate_lift(rig, grasp))
                    watch.count("lifted", int(lift.success))
            bar.update()
