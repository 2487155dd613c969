"""Units of work in processes, their results in the order of the units."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar, cast

from xdex_drake.jobs.processes import UnitResult, run_units

if TYPE_CHECKING:
    pass
from xdex_drake.jobs.stored import _rig, _scene

Unit = TypeVar("Unit")


Value = TypeVar("Value")


_log = logging.getLogger(__name__)


def in_order(
    units: Sequence[Unit],
    work: Callable[[Unit], Value],
    *,
    workers: int,
    lost: Callable[[Unit, str], Value] | None = None,
) -> Iterator[tuple[Unit, Value]]:
    """Runs work on each unit and gives the results in the order of the units.

    Args:
        units: The units.
        work: A function at the top level of a module.
        workers: Number of processes; 0 works in this one, where a crash ends everything.
        lost: Gives the result of a unit whose process crashed or took too long; they are left out where None.

    Yields:
        Each unit with its result; units that were lost are told by a warning.

    Raises:
        RuntimeError: The work met a bug; the message holds its traceback.
        XdexError: The input of a unit cannot be used.
    """
    waiting: dict[int, UnitResult[tuple[int, Unit], Value]] = {}
    results = run_units(list(enumerate(units)), _Numbered(work), workers=min(workers, len(units)), timeout_s=300.0)
    position = 0
    try:
        for done in results:
            waiting[done.unit[0]] = done
            while (ready := waiting.pop(position, None)) is not None:
                position += 1
                if ready.failure:
                    if ready.trace:
                        raise RuntimeError(f"unit {position - 1}:\n{ready.trace}")
                    _log.warning("unit %d: %s", position - 1, ready.failure)
                    if lost is not None:
                        yield ready.unit[1], lost(ready.unit[1], ready.failure)
                    continue
                yield ready.unit[1], cast("Value", ready.value)
    finally:
        results.close()  # type: ignore[attr-defined]
        if workers == 0:
            _rig.cache_clear()
            _scene.cache_clear()


@dataclass(frozen=True)
class _Numbered(Generic[Unit, Value]):
    """Work on units that carry their number."""

    work: Callable[[Unit], Value]

    def __call__(self, unit: tuple[int, Unit]) -> Value:
        return self.work(unit[1])
