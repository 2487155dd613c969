"""Performance profiles of solvers, and the benchmark that feeds them."""

from xml.etree import ElementTree

import numpy as np
import pytest

from xdex_drake.bench.problems import bench_problems, profile_picture, profile_ratios, summary
from xdex_drake.bench.watch import Watch
from xdex_drake.hand.library import load_hand
from xdex_drake.programs.force_closure import force_closure_program
from xdex_drake.programs.program import GraspProgram, OutOfTime
from xdex_drake.programs.solve import solve
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene


def run(problem, solver, seconds, solved=True, feasible=True, cost=1.0):
    return {
        "problem": problem,
        "start": 0,
        "solver": solver,
        "feasible": feasible,
        "solved": solved,
        "worst": "" if solved else "cone",
        "seconds": seconds,
        "cost": cost,
    }


RUNS = [
    run("a", "x", 0.1),
    run("a", "y", 0.3, cost=0.5),
    run("b", "x", 0.2),
    run("b", "y", 0.1, solved=False),
    run("c", "x", 0.1, solved=False),
    run("c", "y", 9.0, solved=False),
    run("d", "x", 0.1, solved=False, feasible=False),
    run("d", "y", 0.1, solved=False, feasible=False),
]


def test_ratios_count_what_nobody_solved_and_leave_out_what_has_no_solution():
    ratios = profile_ratios(RUNS)
    assert np.allclose(ratios["x"][:2], 1.0) and np.isinf(ratios["x"][2])
    assert np.isclose(ratios["y"][0], 3.0) and np.isinf(ratios["y"][1:]).all()
    told = summary(RUNS)
    assert told["x"]["solved"] == 0.667 and told["x"]["cost, relative to the least"] == 1.5
    assert told["y"]["fastest"] == 0.0 and told["y"]["within 4 times the fastest"] == 0.333
    assert profile_ratios(RUNS[-2:]) == {}


def test_the_picture_is_valid_svg():
    for runs in (RUNS, RUNS[-2:], []):
        root = ElementTree.fromstring(profile_picture("a < b", runs))
        lines = [element for element in root.iter() if element.tag.endswith("polyline")]
        assert len(lines) == len(profile_ratios(runs))


def test_two_problems_by_two_solvers():
    watch, ticks = Watch(), []
    bench_problems(
        watch,
        ("allegro_flat_brick", "wrench_weak_fingers"),
        starts=1,
        time_limit_s=0.5,
        tick=lambda: ticks.append(1),
        solvers=("sequential", "snopt"),
    )
    assert len(ticks) == 2 and [row["solver"] for row in watch.runs] == ["sequential", "snopt"]
    assert all(not row["solved"] and not row["feasible"] and row["worst"] for row in watch.runs)
    assert all(row["seconds"] < 1.5 for row in watch.runs)
    assert watch.facts["wrench problems that reach their goals"] == 1


@pytest.fixture(scope="module")
def can_program() -> GraspProgram:
    hand, scene = load_hand("allegro"), make_scene(load_object("can"))
    return force_closure_program(hand, scene, starts=4)


def test_a_solver_without_a_limit_of_its_own_is_stopped(can_program: GraspProgram):
    result = solve(can_program, solver="snopt", time_limit_s=1e-3)
    assert result.seconds < 0.5 and result.violations.keys() == {block.name for block in can_program.constraints}
    x = can_program.values(can_program.start)
    x[0] += 0.01
    with pytest.raises(OutOfTime), can_program.limited(-1.0):
        can_program.point(x)
    assert can_program.point(x).size == can_program.start.size
