"""A unit whose process crashes costs only itself; a lift that is lost is never a success."""

import math
import os
from types import SimpleNamespace

import pytest

from xdex_drake.errors import ConfigError
from xdex_drake.jobs.ordered import in_order
from xdex_drake.jobs.processes import Failure, FailureKind
from xdex_drake.jobs.stored import LiftUnit, lost_lift


def work(unit):
    if unit == 2:
        os.abort()
    return f"lift {unit}"


def refuse(unit):
    raise ConfigError(f"unit {unit}: give another")


def test_a_crash_costs_one_unit_and_the_order_stays():
    done = list(in_order(range(5), work, workers=2))
    assert [result.unit for result in done] == [0, 1, 2, 3, 4]
    assert [result.value for result in done] == ["lift 0", "lift 1", None, "lift 3", "lift 4"]
    assert done[2].failure is not None and done[2].failure.kind is FailureKind.CRASHED


@pytest.mark.parametrize("workers", [0, 1])
def test_input_that_cannot_be_used_is_an_error_of_ours(workers):
    with pytest.raises(ConfigError, match="unit 0: give another"):
        list(in_order(range(3), refuse, workers=workers))


@pytest.mark.parametrize(
    ("kind", "robust", "reason"),
    [(FailureKind.CRASHED, 0, "simulation_failed"), (FailureKind.TIMEOUT, 3, "timeout")],
)
def test_a_lost_lift_has_failed(kind, robust, reason):
    table = SimpleNamespace(table=0.0)
    unit = LiftUnit(0, None, table, "allegro", robust=robust)  # type: ignore[arg-type]
    verdict = lost_lift(unit, Failure(kind, "what happened"))
    assert not verdict.success and verdict.failure_reason == reason and math.isnan(verdict.lift_height_m)
    assert verdict.protocol == ("robust:lift-0.2/2tips" if robust else "lift-0.2/2tips")
