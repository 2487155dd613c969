"""The library's problems can be loaded and reach what they say."""

from dataclasses import asdict

import pytest

from xdex_drake.dataset.problem_runs import solve_problem
from xdex_drake.programs.force_closure import PolishSettings
from xdex_drake.programs.problems import list_problems, load_problem


def test_all_problems_load():
    assert len(list_problems()) >= 6
    for name in list_problems():
        problem = load_problem(name)
        assert problem.name == name and problem.title
    assert any(load_problem(name).reaches.status == "infeasible" for name in list_problems())


def test_a_path_works_like_a_name(tmp_path):
    (tmp_path / "mine.yaml").write_text("title: mine\nhand: allegro\nobject: {name: can}\npolish: {effort: 0.2}\n")
    problem = load_problem(tmp_path / "mine.yaml")
    assert asdict(problem.polish) == {**asdict(PolishSettings()), "effort": 0.2}


def test_the_first_problem_reaches_its_goals():
    solution = solve_problem("allegro_can")
    assert solution.grasp is not None and solution.missed == ()
    assert solution.result.violations.keys() == {block.name for block in solution.program.constraints}


def test_the_infeasible_problem_says_so():
    solution = solve_problem("slippery_can")
    assert solution.grasp is None and solution.missed == ()
    assert solution.result.worst and solution.violated


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(list_problems()) - {"allegro_can", "slippery_can"}))
def test_every_other_problem_reaches_its_goals(name):
    assert solve_problem(name).missed == ()
