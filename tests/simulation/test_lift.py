"""Lifts: what succeeds, what fails and why, and that the same inputs give the same verdict."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.contact import HeldObject, check_certificate
from xdex_drake.grasping.approach import straight_approach
from xdex_drake.grasping.pregrasp import CLEARANCE, pregrasp
from xdex_drake.grasping.squeeze import RULE_CLOSING, squeeze, squeeze_by_rule
from xdex_drake.grasping.synthesis import SynthesisSettings, candidates_of_batch
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene
from xdex_drake.simulation.drake import lift, lift_rig, shared_rig, simulate_lift
from xdex_drake.simulation.protocol import LIFT
from xdex_drake.simulation.trajectory import target_rates, targets
from xdex_drake.simulation.verdict import FAILURE_REASONS


@pytest.fixture(scope="module")
def hand():
    return load_hand("allegro")


@pytest.fixture(scope="module")
def scene():
    return make_scene(load_object("can"))


@pytest.fixture(scope="module")
def rig(hand, scene):
    return lift_rig(hand, scene)


@pytest.fixture(scope="module")
def grasps(hand, scene):
    settings = replace(SynthesisSettings(), batch=24)
    grasps = list(candidates_of_batch(hand, scene, seed=0, settings=settings, tally=Tally()))
    assert grasps, "a search of 24 candidates gave no certified grasp of a can"
    return grasps


@pytest.fixture(scope="module")
def verdicts(rig, grasps):
    return [simulate_lift(rig, grasp) for grasp in grasps]


def test_certified_grasps_lift(verdicts):
    assert np.mean([v.success for v in verdicts]) >= 0.6
    for v in verdicts:
        assert v.success == (v.failure_reason == "")
        assert v.failure_reason in ("", *FAILURE_REASONS)
        if v.success:
            assert v.lift_height_m >= LIFT.success_m and len(v.fingertips) >= LIFT.fingertips


def test_certificates_hold_without_a_solver(grasps, hand, scene):
    for grasp in grasps:
        residuals = check_certificate(grasp.certificate)
        assert residuals.passes(1e-6), residuals
        assert residuals.wrench <= 1e-6
        assert grasp.penetration_parts_m <= 1e-3
        assert np.all((grasp.q >= hand.limits[0]) & (grasp.q <= hand.limits[1]))


def test_the_pregrasp_clears_the_object(grasps, hand, scene):
    opened = pregrasp(hand, scene, grasps[0].X_WH, grasps[0].q)
    assert opened.clearance > 0.8 * CLEARANCE
    assert np.allclose(opened.X_WH.rotation().matrix(), grasps[0].X_WH.rotation().matrix())


def test_verdicts_repeat_in_any_order(rig, grasps, verdicts, hand, scene):
    again = simulate_lift(rig, grasps[0])
    fresh = simulate_lift(lift_rig(hand, scene), grasps[0])
    for other in (again, fresh):
        assert replace(other, seconds=0.0) == replace(verdicts[0], seconds=0.0)


def far(grasp, offset):
    """The same grasp with the hand moved away."""
    shift = RigidTransform(np.asarray(offset, dtype=float))
    return replace(grasp, X_WH=shift @ grasp.X_WH, X_WH_pregrasp=shift @ grasp.X_WH_pregrasp)


def test_a_hand_that_never_touches_never_lifts(rig, grasps):
    verdict = simulate_lift(rig, far(grasps[0], [0.0, 0.0, 0.4]))
    assert not verdict.success and verdict.failure_reason == "not_grasped"
    assert abs(verdict.lift_height_m) < 2e-3


def test_a_pregrasp_in_contact_is_named(rig, grasps):
    start = replace(grasps[0], q_pregrasp=grasps[0].q + grasps[0].tau_squeeze, X_WH_pregrasp=grasps[0].X_WH)
    assert simulate_lift(rig, start).failure_reason == "pregrasp_in_contact"


def test_a_hand_in_the_table_is_named(rig, grasps):
    verdict = simulate_lift(rig, far(grasps[0], [0.5, 0.0, -0.3]))
    assert verdict.failure_reason == "table_collision"


def test_a_heavy_object_slips(hand, grasps):
    heavy = make_scene(load_object("can", mass=3.0))
    verdict = simulate_lift(lift_rig(hand, heavy), grasps[0])
    assert verdict.failure_reason in ("slipped", "not_grasped")


def test_targets_start_at_the_pregrasp_and_end_at_the_squeeze(grasps):
    q, offset = targets(grasps[0], LIFT, 0.0)
    assert np.allclose(q, grasps[0].q_pregrasp)
    q, offset = targets(grasps[0], LIFT, LIFT.duration_s)
    assert np.allclose(q, grasps[0].q + grasps[0].tau_squeeze / LIFT.plant.kp) and np.allclose(
        offset, [0.0, 0.0, LIFT.rise_m]
    )


def test_a_shared_rig_gives_the_same_numbers(grasps, verdicts, hand, scene):
    rig = shared_rig(hand, scene)
    assert shared_rig(load_hand("allegro"), make_scene(load_object("can"))) is rig
    assert shared_rig(hand, make_scene(load_object("can"), seed=3)) is not rig
    assert shared_rig(hand, scene, protocol=replace(LIFT, rise_m=0.3)) is not rig
    for grasp, verdict in zip(grasps[::-1], verdicts[::-1], strict=True):
        assert replace(lift(grasp, hand, scene), seconds=0.0) == replace(verdict, seconds=0.0)
    for mass in (0.11, 0.12, 0.13, 0.14):
        shared_rig(hand, make_scene(load_object("can", mass=mass)))
    assert shared_rig(hand, scene) is not rig, "rigs are kept without bound"


def test_the_sources_play_the_targets(rig, grasps):
    simulate_lift(rig, grasps[0])
    context = rig.scene_plant.diagram.CreateDefaultContext()
    for t in np.linspace(0.0, LIFT.duration_s, 50):
        context.SetTime(max(t - LIFT.plant.time_step, 0.0))
        q, offset = targets(grasps[0], LIFT, max(t, LIFT.plant.time_step))
        for source, value in ((rig.hand_source, q), (rig.carriage_source, offset)):
            played = source.get_output_port().Eval(source.GetMyContextFromRoot(context))
            np.testing.assert_allclose(played[: len(value)], value, atol=1e-12)
            # Rates are those of the targets while the hand closes; squeeze and rise are said to stand still.
            which = source is rig.carriage_source
            ahead = targets(grasps[0], LIFT, max(t, LIFT.plant.time_step) + 1e-6)[which]
            rate = (ahead - value) / 1e-6 if t < LIFT.close_s - 1e-6 else np.zeros(len(value))
            np.testing.assert_allclose(played[len(value) :], rate, atol=1e-4)
            told = target_rates(grasps[0], LIFT, max(t, LIFT.plant.time_step))[which]
            np.testing.assert_allclose(told, rate, atol=1e-4)


def test_every_pregrasp_is_clear_and_reached_by_a_straight_way(grasps, hand, scene):
    for grasp in grasps[:8]:
        way = straight_approach(hand, scene, grasp.X_WH_pregrasp, grasp.q_pregrasp)
        assert way is not None and np.linalg.norm(way.direction_W) == pytest.approx(1.0)
        assert way.clearance >= 2e-3
        for share in (0.0, 0.033, 0.1):
            X_WH = RigidTransform(
                grasp.X_WH_pregrasp.rotation(), grasp.X_WH_pregrasp.translation() + share * way.direction_W
            )
            k = Configuration.at(hand, X_WH, grasp.q_pregrasp)
            centers = k.points(hand.sphere_links, hand.spheres[:, :3])
            gaps = scene.object.exact.query((scene.X_WO.inverse() @ centers.T).T).distance - hand.spheres[:, 3]
            assert gaps.min() >= (CLEARANCE if share == 0.0 else 1.9e-3)


def test_large_spheres_pass_through_free_space(grasps, hand, scene):
    links = tuple(
        replace(link, spheres=np.column_stack([link.spheres[:, :3], np.full(len(link.spheres), 0.06)]))
        for link in hand.links
    )
    swollen = replace(hand, links=links)
    up = RigidTransform(grasps[0].X_WH.rotation(), scene.X_WO.translation() + np.array([0.0, 0.0, 0.6]))
    way = straight_approach(swollen, scene, up, hand.q_rest)
    assert way is not None and way.clearance > 0.1


def test_a_hand_that_holds_the_object_has_no_straight_way(grasps, hand, scene):
    assert straight_approach(hand, scene, grasps[0].X_WH, grasps[0].q) is None


def test_hydroelastic_contact_lifts_the_same_grasp(hand, scene, grasps, verdicts):
    lifted = next(grasp for grasp, verdict in zip(grasps, verdicts, strict=False) if verdict.success)
    protocol = replace(LIFT, plant=replace(LIFT.plant, hydroelastic_modulus=1e7))
    verdict = simulate_lift(lift_rig(hand, scene, protocol=protocol), lifted)
    assert verdict.success and len(verdict.fingertips) >= 2


def test_a_finished_grasp_has_a_straight_approach(grasps, hand, scene):
    for grasp in grasps:
        way = straight_approach(hand, scene, grasp.X_WH_pregrasp, grasp.q_pregrasp)
        assert way is not None and way.clearance >= 2e-3
        assert np.linalg.norm(way.direction_W) == pytest.approx(1.0)


def pressing(grasp, hand, scene, factor):
    """The grasp with the least forces that carry the object at the peak of the rise, for friction mu / factor."""
    cp = pytest.importorskip("cvxpy")
    contacts = grasp.certificate.contacts
    p_OCs, n_OCs = np.array([c.p_OC for c in contacts]), np.array([c.n_OC for c in contacts])
    G = HeldObject.of(scene).grasp_map(p_OCs, n_OCs).G
    load = scene.object.mass * (9.81 + 6.0 * LIFT.rise_m / LIFT.rise_s**2)
    f = cp.Variable((len(contacts), 3))
    scale = np.array([1e2, 1e2, 1e2, 1.0, 1.0, 1.0])
    balance = (scale[:, None] * G) @ cp.vec(f, order="C") == np.array([0.0, 0.0, 0.0, 0.0, 0.0, load])
    cones = [cp.SOC(scene.object.friction / factor * f[k, 2], f[k, :2]) for k in range(len(contacts))]
    cp.Problem(cp.Minimize(cp.sum(f[:, 2])), [balance, *cones]).solve(solver="CLARABEL")
    pressed = tuple(replace(c, f_C=force) for c, force in zip(contacts, f.value, strict=True))
    other = replace(grasp, certificate=replace(grasp.certificate, contacts=pressed))
    return squeeze(hand, other, scene, LIFT.plant.kp)


def test_a_hand_lifts_with_a_fifth_more_than_friction_needs_and_not_with_a_third_less(
    rig, hand, scene, grasps, verdicts
):
    lifted = [grasp for grasp, verdict in zip(grasps, verdicts, strict=True) if verdict.success][:3]
    for grasp in lifted:
        assert simulate_lift(rig, pressing(grasp, hand, scene, 1.2)).success
        assert simulate_lift(rig, pressing(grasp, hand, scene, 0.65)).failure_reason == "slipped"


def test_grasps_without_a_certificate_are_squeezed_by_one_rule(rig, hand, scene, grasps, verdicts):
    lifted = 0
    for grasp in grasps[:8]:
        bare = replace(grasp, certificate=None, q_squeeze=None, tau_squeeze=None)
        by_rule = squeeze_by_rule(hand, bare, scene, LIFT.plant.kp)
        assert np.all(np.abs(by_rule.tau_squeeze) <= hand.effort)
        lifted += simulate_lift(rig, by_rule).success
    assert lifted >= sum(v.success for v in verdicts[:8]) - 2


def test_a_hand_away_from_the_object_closes_by_a_tenth_of_its_range(hand, scene, grasps):
    grasp = grasps[0]
    aside = RigidTransform(grasp.X_WH.rotation(), grasp.X_WH.translation() + np.array([0.0, 0.0, 0.5]))
    squeezed = squeeze_by_rule(hand, replace(grasp, X_WH=aside), scene, LIFT.plant.kp)
    step = squeezed.q_squeeze - grasp.q
    np.testing.assert_allclose(squeezed.tau_squeeze, LIFT.plant.kp * step, atol=1e-12)
    low, high = hand.limits
    closed = np.sign(grasp.q - grasp.q_pregrasp)
    assert np.all(step * closed >= 0.0) and np.all(np.abs(step) <= RULE_CLOSING * (high - low) + 1e-12)
    inside = np.abs(np.clip(grasp.q, low + 0.2 * (high - low), high - 0.2 * (high - low)) - grasp.q) == 0.0
    np.testing.assert_allclose(np.abs(step[inside]), (RULE_CLOSING * (high - low) * np.abs(closed))[inside])
