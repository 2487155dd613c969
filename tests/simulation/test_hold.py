"""Holding and pushing a lifted object."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from xdex_drake.grasping.synthesis import SynthesisSettings, candidates_of_batch
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.library import load_hand
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene
from xdex_drake.simulation.hold import NOT_LIFTED, PUSHES, slip_and_turn
from xdex_drake.simulation.lift import lift_rig, simulate_lift
from xdex_drake.simulation.protocol import HOLD, LIFT
from xdex_drake.simulation.robust import RobustSettings, robust_lift


@pytest.fixture(scope="module")
def hand():
    return load_hand("allegro")


@pytest.fixture(scope="module")
def scene():
    return make_scene(load_object("can"))


@pytest.fixture(scope="module")
def rig(hand, scene):
    return lift_rig(hand, scene, protocol=HOLD)


@pytest.fixture(scope="module")
def grasps(hand, scene):
    settings = replace(SynthesisSettings(), batch=24)
    return list(candidates_of_batch(hand, scene, seed=0, settings=settings, tally=Tally()))


@pytest.fixture(scope="module")
def verdicts(rig, grasps):
    return [simulate_lift(rig, grasp) for grasp in grasps]


def test_the_lift_is_the_one_without_what_comes_after(hand, scene, grasps, verdicts):
    plain = lift_rig(hand, scene)
    for grasp, verdict in zip(grasps[:3], verdicts, strict=False):
        alone = simulate_lift(plain, grasp)
        assert alone.hold is None and alone.passed == alone.success
        assert replace(verdict, hold=None, protocol=LIFT.name, seconds=0.0) == replace(alone, seconds=0.0)


def test_verdicts_say_what_went_wrong_and_when(verdicts):
    assert any(v.passed for v in verdicts)
    bounds = HOLD.hold.max_slip_m, HOLD.hold.max_turn_rad
    for v in verdicts:
        if not v.success:
            assert v.hold == NOT_LIFTED
            continue
        within = v.hold.slip_m < bounds[0] and v.hold.turn_rad < bounds[1]
        assert v.hold.holds == (v.hold.reason == "") == within == v.passed
        if not v.hold.holds:
            problem, phase = v.hold.reason.split(":")
            assert problem == ("slipped" if v.hold.slip_m >= bounds[0] else "turned")
            assert phase in ("lift", "still", *PUSHES)


def test_weaker_pushes_move_the_object_less(hand, scene, grasps, verdicts):
    held = next(grasp for grasp, v in zip(grasps, verdicts, strict=True) if v.passed)
    moved = []
    for weights in (0.0, 0.5, 1.0):
        protocol = replace(HOLD, hold=replace(HOLD.hold, weights=weights))
        moved.append(simulate_lift(lift_rig(hand, scene, protocol=protocol), held).hold)
    assert moved[0].turn_rad < moved[1].turn_rad < moved[2].turn_rad
    strong = replace(HOLD, hold=replace(HOLD.hold, weights=20.0))
    assert not simulate_lift(lift_rig(hand, scene, protocol=strong), held).passed


def test_a_state_that_is_restored_goes_on_as_it_did(rig, grasps):
    rig.start(grasps[0])
    rig.advance_to(1.0)
    state, ways = rig.state(), []
    for _ in range(2):
        rig.restore(state)
        rig.push(np.array([0.5, 0.0, 0.2]))
        rig.advance_to(1.1)
        rig.push(np.zeros(3))
        rig.advance_to(1.3)
        ways.append(rig.state()[1])
    np.testing.assert_array_equal(*ways)
    rig.start(grasps[0])
    rig.advance_to(1.3)
    unpushed = rig.state()[1]
    assert np.abs(unpushed - ways[0]).max() > 1e-4
    rig.restore(state)
    rig.advance_to(1.3)
    np.testing.assert_array_equal(rig.state()[1], unpushed)


def test_a_push_accelerates_the_center_of_mass_alone(rig, grasps, scene):
    """Off the table and far from the hand: three weights upward lift with 2 g, along a parabola, without a turn."""
    away = RigidTransform([0.0, 0.0, 1.0])
    up = replace(grasps[0], X_WO=away @ grasps[0].X_WO)
    rig.start(up)
    p_OOcm, weight = scene.object.p_OOcm, 9.81 * scene.object.mass
    before = rig.X_WO() @ p_OOcm
    rig.push(np.array([weight, 0.0, 3.0 * weight]))
    rig.advance_to(0.1)
    rig.push(np.zeros(3))
    n, h = 20, HOLD.plant.time_step
    way = 9.81 * np.array([1.0, 0.0, 2.0]) * h * h * n * (n + 1) / 2.0  # symplectic Euler's sum
    np.testing.assert_allclose(rig.X_WO() @ p_OOcm - before, way, atol=1e-9)
    np.testing.assert_allclose(rig.X_WO().rotation().matrix(), up.X_WO.rotation().matrix(), atol=1e-9)


def test_slip_is_of_the_center_of_mass_and_turn_about_any_axis():
    p_OOcm = np.array([0.01, 0.02, 0.05])
    X = RigidTransform(RollPitchYaw(0.3, -0.2, 1.0), [0.1, 0.0, 0.2])
    turn = RotationMatrix(RollPitchYaw(0.0, 0.3, 0.0))
    about_center = RigidTransform(turn, p_OOcm - turn @ p_OOcm)
    slip, angle = slip_and_turn(X, X @ about_center, p_OOcm)
    assert slip == pytest.approx(0.0, abs=1e-12) and angle == pytest.approx(0.3)
    slip, angle = slip_and_turn(X, X @ RigidTransform([0.003, 0.0, 0.004]), p_OOcm)
    assert slip == pytest.approx(0.005) and angle == pytest.approx(0.0, abs=1e-7)


def test_a_robust_hold_fails_where_one_repeat_does(hand, scene, grasps, verdicts):
    held = next(grasp for grasp, v in zip(grasps, verdicts, strict=True) if v.passed)
    found = robust_lift(
        held, hand, scene, protocol=HOLD, settings=RobustSettings(repeats=1, position_m=1e-6, angle_rad=0)
    )
    every = (*found.poses, found.slippery, found.heavy)
    assert found.lift.passed == all(one.passed for one in every)
    assert found.lift.success == all(one.success for one in every)
    assert found.poses[0].passed and found.share == np.mean([one.passed for one in every])
