"""The library's problems can be loaded, reach what they say, and say in words what cannot be reached."""

import time
from dataclasses import asdict

import numpy as np
import pytest

from xdex_drake.cli.app import run
from xdex_drake.errors import ProblemFileError
from xdex_drake.grasping.reasons import WORDS, Reason, Rejection, in_words
from xdex_drake.hand.library import load_hand
from xdex_drake.problems.files import Problem, list_problems, load_any_problem, load_problem
from xdex_drake.problems.solve import solve_problem
from xdex_drake.problems.wrench import WrenchProblem, solve_wrench_problem
from xdex_drake.programs.force_closure import PolishSettings, force_closure_program
from xdex_drake.programs.grasp_types import contact_slots
from xdex_drake.programs.obstacles import CONSTRAINT_WORDS, find_obstacles, largest_opening, sizes
from xdex_drake.programs.search import SearchSettings
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene

WRENCH = [name for name in list_problems() if isinstance(load_any_problem(name), WrenchProblem)]
OTHERS = [name for name in list_problems() if name not in WRENCH]
INFEASIBLE = [name for name in OTHERS if load_problem(name).reaches.status == "infeasible"]


def test_there_are_problems_of_every_kind():
    problems = [load_any_problem(name) for name in list_problems()]
    assert len(problems) >= 20 and all(problem.name and problem.title for problem in problems)
    assert {problem.program for problem in problems} == {"force_closure", "retargeting", "link_pose_ik", "wrench"}
    grasps = [problem for problem in problems if isinstance(problem, Problem)]
    assert {problem.hand for problem in grasps} >= {"allegro", "shadow", "ability", "schunk_svh", "inspire"}
    assert {problem.grasp_type for problem in grasps} == {"any", "pinch", "tripod", "power"}
    assert any(problem.hand.startswith("g0-") for problem in grasps)
    assert any(problem.object.name.startswith("s0-") for problem in grasps)
    assert {problem.reaches.obstacle for problem in grasps} >= {"table", "opening", "friction"}
    assert any(problem.approach is not None for problem in grasps)


def test_a_path_works_like_a_name(tmp_path):
    (tmp_path / "mine.yaml").write_text("title: mine\nhand: allegro\nobject: {name: can}\npolish: {effort: 0.2}\n")
    problem = load_problem(tmp_path / "mine.yaml")
    assert asdict(problem.polish) == {**asdict(PolishSettings()), "effort": 0.2}


@pytest.mark.parametrize("name", WRENCH)
def test_wrench_problems_reach_their_goals(name):
    problem = load_any_problem(name)
    assert isinstance(problem, WrenchProblem)
    result = solve_wrench_problem(problem)
    assert problem.missed(result) == () and (result.status == "solved") == (result.reason == "")
    if problem.solve == "balance" and result.status == "solved":
        assert np.allclose(result.forces.sum(axis=0), [0.0, 0.0, 9.81 * problem.mass], atol=1e-6)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("contacts: []", "contacts is empty"),
        ("contacts: [{p: [0, 0], n: [1, 0, 0]}]", "give three numbers"),
        ("contacts: [{p: [0, 0, 0], n: [0, 0, 0]}]", "n is zero"),
        ("contacts: [{p: [0, 0, 0], n: [1, 0, 0]}]\nmass: 0", "mass is 0"),
        ("contacts: [{p: [0, 0, 0], n: [1, 0, 0]}]\nsolve: epsilon\nmost_force: 1", "most_force does not matter"),
        ("contacts: [{p: [0, 0, 0], n: [1, 0, 0]}]\nhand: allegro", "unknown key 'hand'"),
    ],
)
def test_wrong_wrench_problems_are_refused(tmp_path, text, said):
    solve = "" if "solve" in text else "solve: balance\n"
    (tmp_path / "wrong.yaml").write_text(f"title: wrong\nprogram: wrench\n{solve}{text}\n")
    with pytest.raises(ProblemFileError, match=said):
        load_any_problem(tmp_path / "wrong.yaml")


def test_a_wrench_problem_is_no_grasp_problem(capsys):
    with pytest.raises(ProblemFileError, match="program is wrench"):
        load_problem(WRENCH[0])
    assert run(["solve", "wrench_weak_fingers"]) == 1
    told = capsys.readouterr().out
    assert "infeasible: the effort limits" in told and "reaches its goals  yes" in told


def test_the_first_problem_reaches_its_goals():
    solution = solve_problem("allegro_can")
    assert solution.grasp is not None and solution.missed == ()
    assert solution.result.violations.keys() == {block.name for block in solution.program.constraints}


@pytest.mark.parametrize("name", INFEASIBLE)
def test_infeasible_problems_say_so_soon_and_in_words(name):
    load_hand(load_problem(name).hand)
    begin = time.process_time()
    solution = solve_problem(name)
    assert time.process_time() - begin < 10.0
    assert solution.grasp is None and solution.missed == ()
    assert solution.result.worst and solution.violated and " " in solution.reason
    if solution.obstacles:
        assert solution.tried == 1 and solution.reason == solution.obstacles[0].message
    else:
        assert solution.reason.split(":")[0] in {**CONSTRAINT_WORDS, **WORDS}


def test_obstacles_name_what_is_in_the_way_and_no_others():
    allegro, ability = load_hand("allegro"), load_hand("ability")
    for hand, name, scale, friction, expected in (
        (allegro, "can", 1.0, 0.6, []),
        (allegro, "mug", 1.0, 0.6, []),
        (allegro, "brick", 0.15, 0.6, ["table"]),
        (allegro, "can", 1.0, 0.005, ["friction"]),
        (ability, "box", 5.0, 0.6, ["opening"]),
        (ability, "box", 1.0, 0.6, []),
    ):
        scene = make_scene(load_object(name, scale=scale, friction=friction))
        assert [obstacle.name for obstacle in find_obstacles(hand, scene)] == expected, (hand.name, name, scale)


def test_an_opening_is_reached_by_some_posture_and_passed_by_none():
    hand = load_hand("ability")
    slots = contact_slots(hand)[:-1]
    radius = float(min(hand.spheres[slot.spheres, 3].min() for slot in slots))
    opening = largest_opening(hand, slots, radius=radius)
    assert opening == pytest.approx(largest_opening(hand, slots, radius=radius, seed=1), abs=2e-3)
    assert 0.1 < opening < 0.3
    assert f"{1e3 * (opening - 2 * radius):.0f} mm apart" in sizes(hand, make_scene(load_object("can")))


def test_every_constraint_of_our_programs_has_its_words():
    settings = SearchSettings(approach=(0.0, 0.0, -1.0), spread=0.02, iterations=5)
    program = force_closure_program(
        load_hand("allegro"), make_scene(load_object("can")), approach=settings.approach, search_settings=settings
    )
    names = {block.name for block in program.constraints}
    # A scene without obstacles, no part of the object asked for, and no prediction to stay near.
    assert names == set(CONSTRAINT_WORDS) - {"obstacle", "region", "reach"}


def test_reasons_are_put_in_words():
    assert in_words("pad").startswith("pad: fingers touch")
    assert Rejection(Reason.CERTIFICATE, "no forces").in_words().endswith("(no forces)")
    assert Rejection(Reason.CONSTRAINT, "pad").in_words() == in_words("pad")
    assert set(WORDS) == set(Reason) - {Reason.CONSTRAINT}
    assert in_words("something else") == "something else"


def test_grasp_refuses_what_cannot_be_held_at_once(tmp_path, capsys):
    out = tmp_path / "none.parquet"
    arguments = ["grasp", "--hand", "allegro", "--object", "torus", "--scale", "0.3", "--out", str(out)]
    assert run(arguments) == 1
    assert "no space under the object: it is 8 mm high" in capsys.readouterr().out and not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(OTHERS) - {"allegro_can", *INFEASIBLE}))
def test_every_other_problem_reaches_its_goals(name):
    assert solve_problem(name).missed == ()
