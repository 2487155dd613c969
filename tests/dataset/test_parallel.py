"""A lift whose process crashes costs only itself, and is never a success."""

import math
import os
from dataclasses import dataclass

from xdex_drake.dataset.parallel import LiftUnit, in_order, lost_lift


@dataclass(frozen=True)
class Unit:
    """Stands for a lift."""

    index: int
    protocol: str = "lift-0.2/2tips"
    robust: int = 0
    simulator: str = "drake"


def lost(unit, failure):
    return lost_lift(unit, failure)


def work(unit):
    if unit.index == 2:
        os.abort()
    return f"lift {unit.index}"


def test_a_crash_costs_one_lift_and_the_order_stays():
    units = [Unit(k) for k in range(5)]
    done = list(in_order(units, work, workers=2, lost=lost))
    assert [unit.index for unit, _ in done] == [0, 1, 2, 3, 4]
    assert [value for unit, value in done if unit.index != 2] == ["lift 0", "lift 1", "lift 3", "lift 4"]
    verdict = done[2][1]
    assert not verdict.success and verdict.failure_reason == "simulation_failed"
    assert math.isnan(verdict.lift_height_m)
    assert [unit.index for unit, _ in in_order(units, work, workers=2)] == [0, 1, 3, 4]


def test_a_lift_out_of_time_is_a_timeout():
    unit: LiftUnit = Unit(0, robust=3)  # type: ignore[assignment]
    verdict = lost_lift(unit, "timeout: more than 300 s")
    assert verdict.failure_reason == "timeout" and verdict.protocol == "robust:lift-0.2/2tips"
