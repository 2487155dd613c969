"""What every benchmark shares: times of stages, their report, its JSON and its picture."""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from html import escape
from importlib.metadata import version
from math import ceil, floor, log10
from typing import Any

from xdex_drake.bench.svg import duration, picture_of, room_for

PACKAGES = ("xdex_drake", "drake", "torch", "numpy", "clarabel", "daqp")

Tick = Callable[[], Any]
"""Called after each step of a benchmark, to move a progress bar."""


@dataclass(frozen=True)
class Stage:
    """Times of one stage.

    Attributes:
        name: What was timed.
        count: How often.
        median_ms: Median wall time [ms].
        p90_ms: 90th percentile of the wall time [ms].
        processor_ms: Median processor time [ms]; a wall time well above it says that the machine was busy.
        target_ms: What the median is meant to stay under [ms]; None where nothing is stated.
    """

    name: str
    count: int
    median_ms: float
    p90_ms: float
    processor_ms: float
    target_ms: float | None = None


@dataclass
class Watch:
    """Times of stages, and facts that came of them.

    Attributes:
        times: Wall and processor seconds of each stage.
        targets: What medians are meant to stay under [ms].
        facts: Counts and figures beside times, by name.
        runs: Rows of plain values, one for each solve, where a benchmark keeps them.
    """

    times: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    targets: dict[str, float] = field(default_factory=dict)
    facts: dict[str, float] = field(default_factory=dict)
    runs: list[dict[str, Any]] = field(default_factory=list)

    def time(self, stage: str, work: Callable[[], Any], *, share: int = 1, target_ms: float | None = None) -> Any:
        """Runs work once and keeps its time.

        Args:
            stage: Name of the stage.
            work: What to run.
            share: What the time is divided by, for work on a batch.
            target_ms: What the median is meant to stay under [ms].

        Returns:
            What the work returned.
        """
        wall, processor = time.perf_counter(), time.process_time()
        value = work()
        took = (time.perf_counter() - wall, time.process_time() - processor)
        self.times.setdefault(stage, []).append((took[0] / share, took[1] / share))
        if target_ms is not None:
            self.targets[stage] = target_ms
        return value

    def time_often(self, stage: str, work: Callable[[], Any], *, often: int = 5, target_ms: float | None = None) -> Any:
        """Runs work of less than milliseconds several times in a row, each of them timed, so that caches are warm."""
        return [self.time(stage, work, target_ms=target_ms) for _ in range(often)][-1]

    def count(self, name: str, more: float = 1) -> None:
        """Counts an event."""
        self.facts[name] = self.facts.get(name, 0) + more

    def stages(self) -> tuple[Stage, ...]:
        """The stages in the order in which they began."""
        stages = []
        for name, times in self.times.items():
            walls = sorted(1e3 * wall for wall, _ in times)
            p90 = walls[min(len(walls) - 1, int(0.9 * len(walls)))]
            processor = statistics.median(1e3 * cpu for _, cpu in times)
            target = self.targets.get(name)
            stages.append(Stage(name, len(times), statistics.median(walls), p90, processor, target))
        return tuple(stages)


def machine() -> dict[str, Any]:
    """What a published time depends on: processor, system, Python, versions of packages."""
    return {
        "machine": platform.machine(),
        "processor": _processor(),
        "system": platform.system(),
        "python": platform.python_version(),
        "threads": 1,
        "versions": {package: version(package) for package in PACKAGES},
    }


def _processor() -> str:
    """Name of the processor, as far as the system tells."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            return next(line.split(":", 1)[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def content(name: str, watch: Watch, *, seed: int, conditions: dict[str, Any]) -> dict[str, Any]:
    """A benchmark as JSON.

    Args:
        name: Name of the benchmark.
        watch: Its times and facts.
        seed: Its seed.
        conditions: What else it was run with: hand, object, repeats.

    Returns:
        Plain dictionaries, lists and numbers.
    """
    return {
        "benchmark": name,
        "seed": seed,
        **conditions,
        **machine(),
        "facts": watch.facts,
        "stages": [vars(stage) for stage in watch.stages()],
        **({"runs": watch.runs} if watch.runs else {}),
    }


def picture(title: str, stages: tuple[Stage, ...]) -> str:
    """Bars of the medians on a logarithmic axis, with lines to the 90th percentiles and ticks at the targets, as SVG.

    Args:
        title: Title of the picture.
        stages: The stages.

    Returns:
        The text of an SVG file.
    """
    least = 1e-3  # of what a logarithm can show [ms]
    values = [max(v, least) for s in stages for v in (s.median_ms, s.p90_ms, s.target_ms) if v is not None] or [1.0]
    low, high = floor(log10(min(values)) - 0.05), ceil(log10(max(values)) + 0.05)
    left, width, row, top = 24.0 + room_for([stage.name for stage in stages]), 480.0, 24, 62
    bottom, column = top + row * len(stages), left + width + 84.0  # medians stand in a column of their own

    def x(ms: float) -> float:
        return left + width * (log10(max(ms, least)) - low) / max(high - low, 1)

    lines = [f'<text class="soft" x="{column:.1f}" y="{top - 8}" text-anchor="end">median</text>']
    lines += _legend(left, any(stage.target_ms is not None for stage in stages))
    for power in range(low, high + 1):
        at = x(10.0**power)
        lines.append(f'<line class="faint" x1="{at:.1f}" y1="{top - 2}" x2="{at:.1f}" y2="{bottom}"/>')
        lines.append(f'<text x="{at:.1f}" y="{bottom + 18}" text-anchor="middle">{duration(10.0**power)}</text>')
    for k, stage in enumerate(stages):
        y = top + row * k
        end = x(stage.median_ms)
        lines += [
            f'<text x="{left - 10:.1f}" y="{y + 13}" text-anchor="end">{escape(stage.name)}</text>',
            f'<rect class="bar" x="{left:.1f}" y="{y}" width="{max(end - left, 1):.1f}" height="16"/>',
            f'<line class="tail" x1="{end:.1f}" y1="{y + 8}" x2="{x(stage.p90_ms):.1f}" y2="{y + 8}"/>',
            f'<text x="{column:.1f}" y="{y + 13}" text-anchor="end">{duration(stage.median_ms)}</text>',
        ]
        if stage.target_ms is not None:
            at = x(stage.target_ms)
            lines.append(f'<line class="target" x1="{at:.1f}" y1="{y - 3}" x2="{at:.1f}" y2="{y + 19}"/>')
    return picture_of(title, column + 16, bottom + 32, lines)


def _legend(x: float, targets: bool) -> list[str]:
    """What bar, line and tick mean, in one line under the title."""
    lines = [
        f'<rect class="bar" x="{x:.1f}" y="37" width="18" height="10"/>',
        f'<text class="soft" x="{x + 24:.1f}" y="46">median</text>',
        f'<line class="tail" x1="{x + 84:.1f}" y1="42" x2="{x + 104:.1f}" y2="42"/>',
        f'<text class="soft" x="{x + 110:.1f}" y="46">to the 90th percentile</text>',
    ]
    if targets:
        lines += [
            f'<line class="target" x1="{x + 258:.1f}" y1="36" x2="{x + 258:.1f}" y2="48"/>',
            f'<text class="soft" x="{x + 266:.1f}" y="46">target</text>',
        ]
    return lines
