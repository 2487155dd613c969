"""Protocols by name, what each of them asks for, and lifts under errors."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.errors import ConfigError
from xdex_drake.grasping.synthesis import SynthesisSettings, candidates_of_batch
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.library import load_hand
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene
from xdex_drake.simulation.drake import lift, lift_rig, simulate_lift
from xdex_drake.simulation.protocol import (
    BENCH_FC,
    BENCH_LIFT,
    FROGGER_LIFT,
    GRAV_6_ALL,
    GRAV_6_ANY,
    LIFT,
    LIFT_05,
    PROTOCOLS,
    PUSH_6_WEAK,
    SHAKE_6,
    PushProtocol,
    find_protocol,
    protocol_scene,
)
from xdex_drake.simulation.pushes import between_fractions, closing_senses, dipped, from_afar
from xdex_drake.simulation.robust import RobustSettings, displaced, robust_lift
from xdex_drake.simulation.trajectory import targets
from xdex_drake.simulation.verdict import FAILURE_REASONS


@pytest.fixture(scope="module")
def hand():
    return load_hand("allegro")


@pytest.fixture(scope="module")
def scene():
    return make_scene(load_object("can"))


@pytest.fixture(scope="module")
def grasps(hand, scene):
    settings = replace(SynthesisSettings(), batch=8)
    return list(candidates_of_batch(hand, scene, seed=0, settings=settings, tally=Tally()))[:4]


def test_protocols_are_found_by_name():
    assert find_protocol("lift-0.2/2tips") is LIFT
    assert list(PROTOCOLS)[:5] == ["lift-0.2/2tips", "hold", "frogger-lift", "bench-lift", "lift-0.5-like"]
    without_weight = ["bench-fc", "push-6-weak", "grav-6-all", "grav-6-any", "shake-6-like"]
    assert [name for name, protocol in PROTOCOLS.items() if isinstance(protocol, PushProtocol)] == without_weight
    assert all(protocol.differs for name, protocol in PROTOCOLS.items() if name not in (LIFT.name, "hold", "release"))
    with pytest.raises(ConfigError, match="did you mean bench-lift"):
        find_protocol("bench-lft")
    with pytest.raises(ConfigError, match="use one of"):
        find_protocol("")


def test_published_numbers():
    assert FROGGER_LIFT.plant.time_step == 1e-3 and FROGGER_LIFT.density == 150.0 and FROGGER_LIFT.rise_m == 0.1
    assert np.rad2deg(FROGGER_LIFT.max_turn_rad) == pytest.approx(30.0) and FROGGER_LIFT.max_height_error_m == 0.075
    assert BENCH_LIFT.plant.time_step == 4e-3 and BENCH_LIFT.mass_kg == 0.1 and BENCH_LIFT.plant.kp == 5.0
    assert np.rad2deg(BENCH_LIFT.max_turn_rad) == pytest.approx(15.0) and BENCH_LIFT.max_shift_m == 0.05
    for protocol in (FROGGER_LIFT, BENCH_LIFT):
        assert protocol.differs


def test_a_protocol_sets_mass_and_friction(scene):
    light = protocol_scene(scene, FROGGER_LIFT).object
    assert light.mass == pytest.approx(150.0 * np.pi * 0.033**2 * 0.11, rel=0.01)
    assert light.friction == 0.5
    np.testing.assert_allclose(light.I_OcmO * scene.object.mass, scene.object.I_OcmO * light.mass)
    assert protocol_scene(scene, LIFT) is scene


def test_another_gain_commands_the_same_torque(grasps):
    grasp, end = grasps[0], BENCH_LIFT.duration_s
    ours = targets(grasp, LIFT, LIFT.duration_s)[0] - grasp.q
    theirs = targets(grasp, BENCH_LIFT, end)[0] - grasp.q
    np.testing.assert_allclose(theirs * BENCH_LIFT.plant.kp, ours * LIFT.plant.kp, atol=1e-12)


def test_frogger_shakes_by_3_mm_while_it_rises(grasps, hand, scene):
    begin = FROGGER_LIFT.close_s + FROGGER_LIFT.squeeze_s
    straight = replace(FROGGER_LIFT, shaking=None)
    for t, shakes in ((begin + 0.2, False), (begin + 0.3, True), (begin + 0.9, True), (begin + 1.2, False)):
        offset = targets(grasps[0], FROGGER_LIFT, t)[1] - targets(grasps[0], straight, t)[1]
        if shakes:
            clock = 0.2 + t - begin
            expected = 3e-3 * np.array([np.sin(5.0 * clock), np.cos(4.0 * clock), np.cos(3.0 * clock)])
            np.testing.assert_allclose(offset, expected, atol=1e-12)
        else:
            np.testing.assert_array_equal(offset, 0.0)
    rig = lift_rig(hand, scene, protocol=replace(FROGGER_LIFT, rise_s=0.4, hold_s=0.0))
    simulate_lift(rig, grasps[0])
    context = rig.scene_plant.diagram.CreateDefaultContext()
    t = begin + 0.35
    context.SetTime(t - 1e-3)
    played = rig.carriage_source.get_output_port().Eval(rig.carriage_source.GetMyContextFromRoot(context))
    np.testing.assert_allclose(played[:3], targets(grasps[0], rig.protocol, t)[1], atol=1e-9)


@pytest.mark.parametrize("protocol", [FROGGER_LIFT, BENCH_LIFT], ids=lambda p: p.name)
def test_certified_grasps_lift_by_the_peers_protocols(grasps, hand, scene, protocol):
    verdicts = [lift(grasp, hand, scene, protocol=protocol) for grasp in grasps[:3]]
    assert all(v.protocol == protocol.name and v.failure_reason in ("", *FAILURE_REASONS) for v in verdicts)
    assert any(v.success for v in verdicts)
    shift = RigidTransform([0.0, 0.0, 0.4])
    away = replace(grasps[0], X_WH=shift @ grasps[0].X_WH, X_WH_pregrasp=shift @ grasps[0].X_WH_pregrasp)
    assert lift(away, hand, scene, protocol=protocol).failure_reason == "not_grasped"


def test_an_object_that_turns_in_the_hand_fails(grasps, hand, scene):
    strict = replace(LIFT, max_turn_rad=1e-6)
    reasons = {lift(grasp, hand, scene, protocol=strict).failure_reason for grasp in grasps}
    assert "turned" in reasons and "" not in reasons


def test_errors_of_pose_stay_within_their_bounds(grasps, scene):
    rng = np.random.default_rng(0)
    p_WOcm = grasps[0].X_WO @ scene.object.p_OOcm
    shifts, angles = [], []
    for _ in range(200):
        error = displaced(grasps[0], scene, rng).X_WH @ grasps[0].X_WH.inverse()
        shifts.append(np.linalg.norm(error @ p_WOcm - p_WOcm))
        angles.append(abs(error.rotation().ToAngleAxis().angle()))
    assert 4e-3 < max(shifts) <= 5e-3 + 1e-12
    assert 4.0 < np.rad2deg(max(angles)) <= 5.0 + 1e-9


def test_a_robust_lift_is_no_easier_and_repeats(grasps, hand, scene):
    settings = RobustSettings(repeats=2)
    first = robust_lift(grasps[0], hand, scene, settings=settings)
    again = robust_lift(grasps[0], hand, scene, settings=settings)
    every = (*first.poses, first.slippery, first.heavy)
    assert replace(first.lift, seconds=0.0) == replace(again.lift, seconds=0.0)
    assert first.lift.protocol == "robust:lift-0.2/2tips"
    assert first.lift.success == all(one.success for one in every)
    assert first.share == np.mean([one.success for one in every])
    none = RobustSettings(repeats=1, position_m=0.0, angle_rad=0.0, friction_factor=1.0, mass_factor=1.0)
    exact = robust_lift(grasps[0], hand, scene, settings=none)
    assert exact.lift.success == lift(grasps[0], hand, scene).success
    feeble = robust_lift(grasps[0], hand, scene, settings=replace(none, friction_factor=0.05))
    assert not feeble.slippery.success and not feeble.lift.success


def test_published_numbers_of_pushes():
    assert PUSH_6_WEAK.grip.density == 500.0 and PUSH_6_WEAK.grip.friction == 3.0 and PUSH_6_WEAK.max_shift_m == 0.02
    assert PUSH_6_WEAK.grip.plant.kp == 1000.0 and PUSH_6_WEAK.grip.plant.kd == 200.0
    assert not PUSH_6_WEAK.reset and PUSH_6_WEAK.only_end and PUSH_6_WEAK.max_turn_rad is None
    # They cancel in pairs, which a drift out and back passes.
    np.testing.assert_allclose(np.sum(PUSH_6_WEAK.accelerations, axis=0), 0.0)
    assert set(np.linalg.norm(PUSH_6_WEAK.accelerations, axis=1)) == {0.5}
    assert GRAV_6_ALL.push_s == pytest.approx(100 / 60) and GRAV_6_ALL.grip.plant.kd == 0.0 and GRAV_6_ALL.contact
    assert (GRAV_6_ALL.needed, GRAV_6_ANY.needed) == (6, 1) and GRAV_6_ANY.max_depth_m == 5e-3
    assert BENCH_FC.push_s == 2.0 and BENCH_FC.grip.plant.kp == 5.0 and BENCH_FC.grip.mass_kg == 0.1
    assert SHAKE_6.max_shift_m == 0.02 and LIFT_05.rise_m == 0.5 and LIFT_05.start_offset_H == (-0.03, 0.0, -0.03)


def test_a_firm_grasp_passes_and_a_far_one_does_not(hand, scene, grasps):
    shift = RigidTransform([0.0, 0.0, 0.15])
    far = replace(grasps[0], X_WH=shift @ grasps[0].X_WH, X_WH_pregrasp=shift @ grasps[0].X_WH_pregrasp)
    for protocol in (GRAV_6_ANY, SHAKE_6):
        verdict = lift(grasps[0], hand, scene, protocol=protocol)
        assert verdict.success and verdict.protocol == protocol.name, (protocol.name, verdict.failure_reason)
    # Closing by fractions of the joints' ranges shoves some objects out of the hand.
    assert any(lift(grasp, hand, scene, protocol=PUSH_6_WEAK).success for grasp in grasps)
    # Nothing holds it: it drifts under the first push, and contact is lost.
    assert lift(far, hand, scene, protocol=SHAKE_6).failure_reason == "slipped:+x"
    assert lift(far, hand, scene, protocol=GRAV_6_ALL).failure_reason == "lost:-y"
    assert not lift(far, hand, scene, protocol=PUSH_6_WEAK).success


def test_a_free_object_moves_as_newton_has_it(hand, scene, grasps):
    shift = RigidTransform([0.0, 0.0, 0.15])
    far = replace(grasps[0], X_WH=shift @ grasps[0].X_WH, X_WH_pregrasp=shift @ grasps[0].X_WH_pregrasp)
    bound = 0.5 * 0.4 * 0.3**2
    gentle = replace(SHAKE_6, accelerations=((0.4, 0.0, 0.0),), push_s=0.3)
    assert lift(far, hand, scene, protocol=replace(gentle, max_shift_m=1.03 * bound)).success
    assert not lift(far, hand, scene, protocol=replace(gentle, max_shift_m=0.97 * bound)).success


def test_a_deep_grasp_is_refused_where_penetration_counts(hand, scene, grasps):
    toward = grasps[0].X_WO.translation() - grasps[0].X_WH.translation()
    shift = RigidTransform(0.03 * toward / np.linalg.norm(toward))
    deep = replace(grasps[0], X_WH=shift @ grasps[0].X_WH)
    assert lift(deep, hand, scene, protocol=GRAV_6_ANY).failure_reason == "penetrating"


def test_closings(hand, scene, grasps):
    grasp = grasps[0]
    low, high = hand.limits
    sense = closing_senses(hand, grasp, scene)
    assert np.count_nonzero(sense) > 0 and set(sense) <= {-1.0, 0.0, 1.0}
    # Flexing closes: the joints next to the tips of fingers that touch.
    touching = {contact.link for contact in grasp.certificate.contacts}
    for finger in hand.fingers:
        if finger.tip_link in touching and finger.name != "thumb":
            last = hand.joint_names.index(next(j.name for j in hand.joints if j.child == finger.tip_link))
            assert sense[last] == 1.0
    between = between_fractions(grasp, hand, scene)
    moved = sense > 0.0
    np.testing.assert_allclose(between.q_pregrasp[moved], (grasp.q + 0.25 * (low - grasp.q))[moved])
    np.testing.assert_allclose(between.q[moved], (grasp.q + 0.15 * (high - grasp.q))[moved])
    np.testing.assert_array_equal(between.q[sense == 0.0], grasp.q[sense == 0.0])
    dip = dipped(grasp, hand, scene)
    assert 0.0 < np.abs(dip.q - grasp.q).max() < 0.3 and np.array_equal(dip.q, dip.q_pregrasp)
    afar = from_afar(grasp, hand, np.array([-0.03, 0.0, -0.03]))
    np.testing.assert_allclose(
        (grasp.X_WH.inverse() @ afar.X_WH_pregrasp).translation(), [-0.03, 0.0, -0.03], atol=1e-12
    )
