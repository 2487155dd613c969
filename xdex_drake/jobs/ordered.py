"""Results of units of work in the order of the units, whatever the number of processes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar, cast

from xdex_drake.jobs.processes import UnitResult, run_units

Unit = TypeVar("Unit")
Value = TypeVar("Value")


def in_order(
    units: Iterable[Unit],
    work: Callable[[Unit], Value],
    *,
    workers: int,
    timeout_s: float = 300.0,
    until: float = math.inf,
) -> Iterator[UnitResult[Unit, Value]]:
    """Runs work on each unit and gives the results in the order of the units.

    Args:
        units: The units, finitely many or not; taken one by one as processes become free.
        work: A function at the top level of a module.
        workers: Number of processes; 0 works in this one, where a crash ends everything.
        timeout_s: Longest wall time of a unit [s].
        until: Time of `time.monotonic` at which units that are under way are given up [s].

    Yields:
        What became of each unit; one that crashed its process or took too long has a failure and no value.

    Raises:
        RuntimeError: The work met a bug; the message holds its traceback.
        XdexError: The input of a unit cannot be used.
    """
    waiting: dict[int, UnitResult[Any, Value]] = {}
    position = 0
    numbered = run_units(enumerate(units), _Numbered(work), workers=workers, timeout_s=timeout_s, until=until)
    with closing(numbered) as results:  # type: ignore[type-var]
        for done in results:
            waiting[done.unit[0]] = done
            while (ready := waiting.pop(position, None)) is not None:
                if ready.failure is not None and ready.failure.error is not None:
                    raise ready.failure.error
                if ready.failure is not None and ready.failure.trace:
                    raise RuntimeError(f"unit {position}:\n{ready.failure.trace}")
                position += 1
                yield cast("UnitResult[Unit, Value]", replace(ready, unit=ready.unit[1]))


@dataclass(frozen=True)
class _Numbered(Generic[Unit, Value]):
    """Work on units that carry their number."""

    work: Callable[[Unit], Value]

    def __call__(self, unit: tuple[int, Unit]) -> Value:
        return self.work(unit[1])
