"""Grasp programs: Jacobians, solvers, openness, infeasibility, inverse kinematics, retargeting."""

import numpy as np
import pytest
import torch
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from xdex_drake.errors import ConfigError
from xdex_drake.hand.batched_kinematics import BatchedHand
from xdex_drake.hand.kinematics import Configuration, forward_kinematics
from xdex_drake.hand.library import load_hand
from xdex_drake.programs.force_closure import (
    PolishSettings,
    force_closure_program,
    polish_program,
    program_of_candidate,
)
from xdex_drake.programs.inverse_kinematics import PointTargets, _LinkMoments, keypoint_targets, solve_points
from xdex_drake.programs.link_pose_ik import link_pose_ik
from xdex_drake.programs.margin_cost import margin_cost
from xdex_drake.programs.retargeting import corresponding_fingers
from xdex_drake.programs.search import random_rotations
from xdex_drake.programs.solve import judge, solve
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene


def again(result, costs=()):
    """The program that starts from a solved one's point."""
    k, contacts = result.point.k, result.point.contacts
    fingers = np.isin(np.arange(len(k.hand.fingers)), contacts.fingers)
    return polish_program(k.hand, result.point.scene, k.X_WH, k.q, fingers, extra_costs=costs)


def test_the_margin_cost_agrees_with_differences(solved):
    cost, point = margin_cost(weight=2.0), solved[1].point
    rng, h = np.random.default_rng(1), 1e-6
    for _ in range(4):
        step = rng.normal(size=point.size)
        difference = (cost.value(point.moved(h * step)) - cost.value(point.moved(-h * step))) / (2.0 * h)
        # A point's Jacobian takes distance and normal from a grid, between which there is a percent.
        assert cost.gradient(point) @ step == pytest.approx(difference, rel=3e-2)


def test_the_margin_cost_raises_margins(allegro, can_scene, found):
    tried = risen = 0
    for row in range(5):
        first = solve(program_of_candidate(allegro, can_scene, found, row))
        if not first.success:
            continue
        cost = margin_cost(least=6.0)
        firmer = solve(again(first, (cost,)))
        tried += 1
        before, after = (7.0 * np.exp(-cost.at(result.point)[0].max()) - 1.0 for result in (first, firmer))
        risen += firmer.success and after > 1.1 * before
    assert tried >= 3 and risen >= 0.7 * tried


def test_jacobians_of_all_blocks_agree_with_differences(allegro, can_scene, found):
    program = program_of_candidate(allegro, can_scene, found, 0)
    rng = np.random.default_rng(0)
    point = program.start.moved(1e-3 * rng.normal(size=program.start.size))
    h = 1e-6
    for block in program.constraints:
        # The pyramid's edges may spin about the normal, which its rows leave out: they are held to less.
        for evaluate, loose in ((block.evaluate, False), (block.inner, True)):
            if evaluate is None:
                continue
            g, J = evaluate(point)
            numeric = np.zeros_like(J)
            for c in range(point.size):
                d = np.zeros(point.size)
                d[c] = h
                numeric[:, c] = (evaluate(point.moved(d))[0] - evaluate(point.moved(-d))[0]) / (2 * h)
            # Rows that are 2 cm from active are known to need no derivative; facets' edges cost a few rows.
            near = np.abs(g) < 20.0 if block.unit == "mm" else np.ones(len(g), dtype=bool)
            if not near.any():
                continue
            error = np.abs(J - numeric)[near].max(axis=1) / max(1.0, np.abs(numeric[near]).max())
            limit = 5e-2 if loose else 1e-2 if block.name == "wrench" else 1e-5
            assert np.mean(error <= limit) > 0.8, block.name
    for cost in program.costs:
        numeric = [(cost.value(point.moved(d)) - cost.value(point.moved(-d))) / (2 * h) for d in h * np.eye(point.size)]
        assert np.abs(cost.gradient(point) - numeric).max() < 1e-5 * max(1.0, np.abs(numeric).max())


def test_a_solved_program_touches_and_does_not_penetrate(allegro, can_scene, solved):
    _, result = solved
    point = result.point
    assert np.abs(point.contact_gaps).max() < 2e-4
    _, gaps, _ = point.object_distances
    assert gaps.min() > -3e-4
    assert (point.centers_W[:, 2] - allegro.spheres[:, 3]).min() > 0.0
    assert result.worst == "" and "wrench" in result.violations


def test_drake_solvers_read_the_same_program(allegro, can_scene, found, solved):
    row, ours = solved
    program = program_of_candidate(allegro, can_scene, found, row)
    x0 = program.prog.initial_guess()
    # The MathematicalProgram's constraints are the blocks.
    bindings = {b.evaluator().get_description(): b for b in program.prog.generic_constraints()}
    for block in program.constraints:
        if block.name in bindings:
            value = bindings[block.name].evaluator().Eval(x0)
            assert np.allclose(value, block.at(program.start)[0], atol=1e-9)
    # What our solver calls solved, SNOPT does too: it may lower the costs, but finds no constraint to mend.
    program.prog.SetInitialGuess(program.variables, program.values(ours.point))
    assert solve(program, solver="snopt").success


def test_rates_of_the_decision_variables(allegro, can_scene, found):
    program = program_of_candidate(allegro, can_scene, found, 1)
    x = program.prog.initial_guess()
    T, h = program.rates(x), 1e-6
    k0 = program.point(x).k
    for c in range(7):
        d = np.zeros(len(x))
        d[c] = h
        k1 = program.point(x + d).k
        turn = (k1.X_WH.rotation() @ k0.X_WH.rotation().inverse()).ToAngleAxis()
        tangent = np.concatenate([turn.angle() * turn.axis(), k1.X_WH.translation() - k0.X_WH.translation()]) / h
        assert np.abs(tangent - T[:6, c]).max() < 1e-4


def test_a_users_own_cost_has_its_effect(allegro, can_scene, found, solved):
    row, plain = solved
    program = program_of_candidate(allegro, can_scene, found, row)
    program.add_cost("straight index", lambda k: float(k.q[1] ** 2 + k.q[2] ** 2), weight=5.0)
    result = solve(program)
    assert result.costs["straight index"] < 5.0 * float(plain.point.k.q[1] ** 2 + plain.point.k.q[2] ** 2)
    assert "straight index" in str(program)


def test_an_impossible_problem_names_its_constraint(allegro):
    # A box far larger than the hand: no contact set can hold it within the cones.
    scene = make_scene(load_object("box", scale=8.0))
    program = force_closure_program(allegro, scene, starts=8)
    result = solve(program)
    assert not result.success
    assert result.worst in {block.name for block in program.constraints}
    assert judge(program, result.point)[1] == result.worst


def test_unknown_solver(allegro, can_scene, found):
    with pytest.raises(ConfigError, match="choose one of"):
        solve(program_of_candidate(allegro, can_scene, found, 0), solver="magic")


@pytest.mark.parametrize("name", ["allegro", "shadow", "ability", "inspire", "schunk_svh"])
def test_link_poses_to_configuration_and_back(name):
    hand, rng, B = load_hand(name), np.random.default_rng(0), 16
    R0, _ = forward_kinematics(hand, RigidTransform(), np.zeros(len(hand.q_rest)))
    qs = rng.uniform(hand.limits[0], hand.limits[1], size=(B, len(hand.q_rest)))
    Xs = [RigidTransform(RollPitchYaw(rng.uniform(-3, 3, 3)), 0.2 * rng.normal(size=3)) for _ in range(B)]
    poses = [forward_kinematics(hand, X, q) for X, q in zip(Xs, qs, strict=True)]
    found = link_pose_ik(hand, np.array([R @ np.swapaxes(R0, 1, 2) for R, _ in poses]), np.array([p for _, p in poses]))
    assert found.errors.max() < 1e-6
    assert np.abs(found.qs - qs).max() < 1e-4


def test_keypoints_of_the_same_hand_are_met_exactly(allegro):
    rng = np.random.default_rng(0)
    X_WH = RigidTransform(RollPitchYaw(0.3, -0.2, 1.0), [0.1, 0.0, 0.3])
    q = np.clip(allegro.q_rest + 0.1 * rng.normal(size=16), *allegro.limits)
    targets = keypoint_targets(allegro, X_WH, q, allegro)
    start = X_WH.translation() + 0.02
    found = solve_points(allegro, targets, X_WH.rotation().matrix()[None], start[None], allegro.q_rest[None])
    assert found.errors[0] < 1e-4
    assert isinstance(Configuration.at(allegro, X_WH, q), Configuration)


def test_fingers_correspond_by_name():
    shadow = load_hand("shadow")
    chosen = corresponding_fingers({"thumb", "index", "ring"}, shadow)
    assert [f.name for f, c in zip(shadow.fingers, chosen, strict=True) if c] == ["thumb", "index", "ring"]
    assert corresponding_fingers({"thumb"}, shadow).sum() == 3


def test_tighter_friction_asks_for_more(allegro, can_scene, solved):
    # A point that satisfies the cones of a small coefficient satisfies those of a larger one.
    _, result = solved
    point = result.point
    from xdex_drake.programs.constraints import cone_block

    nc = len(point.contacts.spheres)
    wide, narrow = cone_block(nc, 0.6), cone_block(nc, 0.6 * PolishSettings().friction_fraction)
    assert wide.violation(point) <= narrow.violation(point)


@pytest.mark.parametrize("name", ["ability", "schunk_svh"])
def test_normal_equations_by_moments_are_those_of_the_jacobian(name):
    hand, rng = load_hand(name), np.random.default_rng(2)
    links = rng.integers(0, len(hand.links), size=30)
    targets = PointTargets(
        links, rng.normal(scale=0.03, size=(30, 3)), rng.normal(size=(4, 30, 3)), rng.uniform(0.5, 2.0, size=30)
    )
    batched = BatchedHand(hand, dtype=torch.float64)
    R = torch.as_tensor(random_rotations(rng, 4))
    q = torch.as_tensor(rng.uniform(*hand.limits, size=(4, len(hand.q_rest))))
    poses = batched.forward(R, torch.as_tensor(rng.normal(size=(4, 3))), q)
    points = batched.points(poses, torch.as_tensor(links), torch.as_tensor(targets.p_LPs))
    error = points - torch.as_tensor(targets.p_WPs)
    J, w = batched.jacobian(poses, torch.as_tensor(links), points), torch.as_tensor(targets.weights)
    H, g = _LinkMoments(batched, targets, torch.as_tensor).normal_equations(poses, error.transpose(1, 2))
    assert torch.allclose(H, torch.einsum("m,bmki,bmkj->bij", w, J, J), atol=1e-11)
    assert torch.allclose(g, torch.einsum("m,bmki,bmk->bi", w, J, error), atol=1e-11)


def test_one_pose_and_a_batch_of_two_come_to_the_same():
    hand, rng = load_hand("inspire"), np.random.default_rng(0)
    R_WH, p_WH = random_rotations(rng, 1)[0], np.array([0.1, 0.0, 0.2])
    links = np.array([hand.link_index[finger.tip_link] for finger in hand.fingers] + [0, 0, 0])
    p_LPs = np.concatenate([[finger.p_LTip for finger in hand.fingers], 0.03 * np.eye(3)])
    goal = Configuration.at(
        hand, RigidTransform(RotationMatrix.ProjectToRotationMatrix(R_WH), p_WH), hand.limits.mean(axis=0)
    )
    targets = PointTargets(links, p_LPs, goal.points(links, p_LPs)[None], np.ones(len(links)))
    start = (R_WH[None], p_WH[None] + 0.02, hand.q_rest[None])
    one = solve_points(hand, targets, *start)
    two = solve_points(hand, targets, *(np.concatenate([value, value]) for value in start))
    assert one.errors[0] < 1e-5 and np.all(two.errors < 1e-5)
    assert np.allclose(one.p_WHs[0], two.p_WHs[0], atol=1e-4)


def test_a_point_far_from_the_start_is_held_to_all_spheres(allegro, can_scene, found):
    program = program_of_candidate(allegro, can_scene, found, 0)
    rows = {block.name: len(block.lower) for block in program.constraints}
    down = np.zeros(program.start.size)
    down[5] = -0.2
    violations, worst = judge(program, program.start.moved(down))
    # Most spheres are far from the table at the start, and the program has no rows for them.
    assert rows["table"] < len(allegro.spheres) and violations["table"] > 50.0 and worst
