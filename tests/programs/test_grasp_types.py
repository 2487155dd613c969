"""Grasp types, approach and spread: in the contact sets, in the search, in a program, in a problem file."""

from dataclasses import replace

import numpy as np
import pytest

from xdex_drake.errors import ConfigError, ProblemFileError
from xdex_drake.hand.library import load_hand
from xdex_drake.problems.files import load_problem
from xdex_drake.programs.force_closure import PolishSettings, conditions, polish_program, program_of_candidate, wishes
from xdex_drake.programs.grasp_types import (
    GraspType,
    approach_axis,
    contact_slots,
    random_contact_sets,
)
from xdex_drake.programs.search import SearchSettings, evaluate, sample_starts, search, search_problem, turned_towards
from xdex_drake.programs.solve import solve
from xdex_drake.programs.terms.approach import approach_block
from xdex_drake.programs.terms.spread import spread_cost

ABOVE = (0.0, 0.0, -1.0)


@pytest.fixture(scope="module")
def allegro():
    return load_hand("allegro")


@pytest.mark.parametrize("name", ["allegro", "shadow"])
def test_types_choose_fingers_and_palm(name):
    hand = load_hand(name)
    n = len(hand.fingers)
    thumb = [f.name for f in hand.fingers].index("thumb")
    expected: dict[GraspType, set[int]] = {"any": {3, 4}, "pinch": {2}, "tripod": {3}, "power": {3, 4}}
    for kind, fingers in expected.items():
        sets = random_contact_sets(hand, np.random.default_rng(0), 50, 4, kind)
        assert sets.shape == (50, n + (kind == "power"))
        assert set(sets[:, :n].sum(axis=1)) <= fingers and sets[:, thumb].all() and sets[:, n:].all()
        others = np.delete(sets[:, :n], thumb, axis=1)
        assert (np.abs(np.diff(others.astype(int), prepend=0, append=0, axis=1)).sum(axis=1) == 2).all()  # neighbours


def test_the_palm_faces_as_the_hand_approaches():
    for name in ("allegro", "shadow", "ability", "schunk_svh", "inspire"):
        hand = load_hand(name)
        slots = contact_slots(hand)
        assert slots[-1].name == "palm" and len(slots) == len(hand.fingers) + 1
        assert all((hand.sphere_links[slot.spheres] == slot.link).all() and len(slot.spheres) for slot in slots)
        assert (hand.R_HB @ slots[-1].n_LPad) @ approach_axis(hand)[1] > 0.0, name


def test_rotations_are_turned_by_the_least_angle():
    rng = np.random.default_rng(0)
    from xdex_drake.programs.search import random_rotations

    R, axis = random_rotations(rng, 20), np.array([0.6, 0.0, 0.8])
    goal = rng.normal(size=(20, 3))
    goal /= np.linalg.norm(goal, axis=1, keepdims=True)
    turned = turned_towards(R, axis, goal)
    assert turned @ axis == pytest.approx(goal)
    assert np.swapaxes(turned, 1, 2) @ turned == pytest.approx(np.broadcast_to(np.eye(3), R.shape), abs=1e-9)
    angle = np.arccos(np.clip((np.trace(turned @ np.swapaxes(R, 1, 2), axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert angle == pytest.approx(np.arccos(((R @ axis) * goal).sum(1)), abs=1e-6)


@pytest.mark.parametrize("kind", ["power", "tripod"])
def test_the_search_obeys(kind, allegro, can_scene):
    settings = replace(SearchSettings(), iterations=80, grasp_type=kind, approach=ABOVE, spread=0.02)
    found = search(allegro, can_scene, count=16, seed=0, settings=settings)
    assert found.fingers.shape[1] == len(allegro.fingers) + (kind == "power")
    assert {"approach", "spread"} <= set(found.terms)
    cosine = (found.R_WHs @ approach_axis(allegro)[1]) @ np.array(ABOVE)
    assert np.median(cosine) > 0.85
    program = polish_program(
        allegro,
        can_scene,
        *_start(found),
        found.fingers[0],
        settings=PolishSettings(),
        extra_costs=wishes(settings),
        extra_constraints=conditions(settings, int(found.fingers[0].sum())),
    )
    assert "spread" in {cost.name for cost in program.costs}
    assert "palm direction" in {block.name for block in program.constraints}
    links = [allegro.links[link].name for link in program.contacts.links]
    assert (allegro.links[0].name in links) == (kind == "power")
    assert len(links) == found.fingers[0].sum()


def _start(found):
    from pydrake.math import RigidTransform, RotationMatrix

    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(found.R_WHs[0]), found.p_WHs[0]), found.qs[0]


def test_the_gradient_of_the_wishes_agrees_with_differences(allegro, can_scene):
    import copy

    import torch

    from tests.programs.test_search import BY_NORMALS, Ball
    from xdex_drake.hand.batched_kinematics import rotation_step

    settings = replace(
        SearchSettings(), terms=BY_NORMALS, grasp_type="power", approach=(1.0, 0.0, -1.0), spread=0.08, contacts=3
    )
    problem = search_problem(allegro, can_scene, settings, dtype=torch.float64)
    problem = replace(problem, grid=Ball(can_scene.object.p_OOcm, 0.04))
    state = sample_starts(problem, allegro, can_scene, 4, 0)
    state.q = torch.minimum(torch.maximum(state.q, problem.batched.limits[0] + 1e-3), problem.batched.limits[1] - 1e-3)
    _, gradient, values = evaluate(problem, copy.copy(state))
    assert values["approach"].max() > 0.0 or values["spread"].max() > 0.0
    h = 1e-7
    for k in range(gradient.shape[1]):
        energies = []
        for sign in (1.0, -1.0):
            moved = copy.copy(state)
            step = torch.zeros_like(gradient)
            step[:, k] = sign * h
            moved.R_WH = rotation_step(state.R_WH, step[:, :3])
            moved.p_WH, moved.q = state.p_WH + step[:, 3:6], state.q + step[:, 6:]
            energies.append(evaluate(problem, moved)[0])
        differences = (energies[0] - energies[1]) / (2 * h)
        assert torch.allclose(gradient[:, k], differences, rtol=1e-3, atol=1e-3 * float(gradient.abs().max()))


def test_costs_in_a_program_agree_with_differences(allegro, can_scene):
    found = search(allegro, can_scene, count=4, seed=1, settings=replace(SearchSettings(), iterations=40))
    program = polish_program(allegro, can_scene, *_start(found), found.fingers[0])
    program.add(spread_cost(0.1))
    rng = np.random.default_rng(0)
    point = program.start
    for cost in program.costs[-1:]:
        assert cost.value(point) > 0.0
        step = np.concatenate([rng.normal(size=6 + len(point.k.q)), np.zeros(point.forces.size)])
        h = 1e-6
        slope = (cost.value(point.moved(h * step)) - cost.value(point.moved(-h * step))) / (2 * h)
        assert cost.gradient(point) @ step == pytest.approx(slope, rel=1e-4, abs=1e-4)


def test_the_palm_keeps_within_its_cone(allegro, can_scene):
    aside, least = (1.0, 0.2, -0.3), 0.98
    settings = replace(SearchSettings(), approach=aside, approach_cosine=least)
    found, solved = search(allegro, can_scene, count=40, seed=0, settings=settings), 0
    for row in range(len(found.energy)):
        program = program_of_candidate(allegro, can_scene, found, row, asked=settings)
        result = solve(program)
        if not result.success:
            continue
        solved += 1
        palm = result.point.k.X_WH.rotation() @ approach_axis(allegro)[1]
        angle = np.arccos(palm @ np.array(aside) / np.linalg.norm(aside))
        assert angle < np.arccos(least) + 2e-3
    assert solved >= 3


def test_the_cone_agrees_with_differences_and_refuses_what_is_no_direction(allegro, can_scene):
    found = search(allegro, can_scene, count=4, seed=1, settings=replace(SearchSettings(), iterations=40))
    program = program_of_candidate(allegro, can_scene, found, 0)
    block, h = approach_block((1.0, 0.2, 0.0)), 1e-6
    step = np.random.default_rng(0).normal(size=program.start.size)
    ahead, behind = (block.at(program.start.moved(sign * h * step))[0] for sign in (1.0, -1.0))
    assert block.at(program.start)[1] @ step == pytest.approx((ahead - behind) / (2 * h), rel=1e-6)
    # Radians to the cone's surface: a palm that stands across misses a cone of 20 degrees by more than one.
    palm = program.start.k.X_WH.rotation() @ approach_axis(allegro)[1]
    across = np.cross(palm, [0.0, 0.0, 1.0])
    assert approach_block(across).violation(program.start) == pytest.approx(0.94 / np.sqrt(1.0 - 0.94**2))
    for wrong in ((0.0, 0.0, 0.0), (0.0, 1.0), (np.nan, 0.0, 1.0)):
        with pytest.raises(ConfigError, match="three numbers"):
            SearchSettings(approach=wrong)
    with pytest.raises(ConfigError, match="below the table"):
        search(allegro, can_scene, count=1, settings=SearchSettings(approach=(0.0, 0.0, 1.0)))
    with pytest.raises(ConfigError, match="between -1 and 1"):
        approach_block(ABOVE, least=1.0)


def test_problem_files_take_them(tmp_path):
    text = "title: t\nhand: allegro\nobject: {name: can}\ngrasp_type: tripod\napproach: [0, 0, -1]\nspread: 0.02\n"
    path = tmp_path / "p.yaml"
    path.write_text(text)
    problem = load_problem(path)
    assert (problem.grasp_type, problem.approach, problem.spread) == ("tripod", ABOVE, 0.02)
    for wrong, named in (("[0, 0, 0]", "approach"), ("[0, 1]", "approach"), ("up", "approach")):
        path.write_text(text.replace("[0, 0, -1]", wrong))
        with pytest.raises(ProblemFileError, match=named):
            load_problem(path)
    path.write_text(text.replace("tripod", "hook"))
    with pytest.raises(ProblemFileError, match="pinch"):
        load_problem(path)
