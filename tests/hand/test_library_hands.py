"""The five hands of the library against the reference data, and what every hand of the library must satisfy."""

import dataclasses

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation, MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from xdex_drake.errors import ConfigError
from xdex_drake.hand.collision import ignored_pairs, self_collision_pairs
from xdex_drake.hand.description import Box, Capsule, Hand, Sphere
from xdex_drake.hand.kinematics import Configuration, forward_kinematics
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.hand.plant import add_hand
from xdex_drake.hand.yaml_file import hand_digest, read_hand, write_hand

HANDS = ("ability", "allegro", "inspire", "schunk_svh", "shadow")
ACTUATED = {"ability": 6, "allegro": 16, "inspire": 6, "schunk_svh": 9, "shadow": 22}
# The reference has 12 digits; the files round positions of merged links to 1e-9 m.
FK_TOLERANCE = 2e-9


@pytest.fixture(scope="module", params=HANDS)
def hand(request: pytest.FixtureRequest) -> Hand:
    return load_hand(request.param)


def welded(hand: Hand, **options: object):
    """A discrete plant with the hand's wrist frame at the world's origin: diagram, plant, instance."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.005)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    instance = add_hand(plant, hand, **options)
    base = plant.GetBodyByName(hand.links[0].name, instance).body_frame()
    plant.WeldFrames(plant.world_frame(), base, RigidTransform(RotationMatrix(hand.R_HB), hand.p_HB))
    plant.set_gravity_enabled(instance, False)
    plant.Finalize()
    return builder.Build(), plant, instance


def test_the_library_has_the_five_hands() -> None:
    assert set(HANDS) <= set(list_hands())


def test_numpy_kinematics_agree_with_the_reference(hand, fk_cases) -> None:
    for case in fk_cases(hand):
        R, p = forward_kinematics(hand, RigidTransform(), case["q"])
        for name, p_B in case["links"].items():
            assert np.abs(p[hand.link_index[name]] - (hand.p_HB + hand.R_HB @ p_B)).max() < FK_TOLERANCE, name
        for finger in hand.fingers:
            k = hand.link_index[finger.tip_link]
            tip = p[k] + R[k] @ finger.p_LTip
            expected = hand.p_HB + hand.R_HB @ case["tips"][finger.name]
            assert np.abs(tip - expected).max() < FK_TOLERANCE, finger.name


def test_drake_kinematics_agree_with_the_reference(hand, fk_cases) -> None:
    _, plant, instance = welded(hand)
    context = plant.CreateDefaultContext()
    for case in fk_cases(hand):
        plant.SetPositions(context, instance, hand.q_full(case["q"]))
        for finger in hand.fingers:
            X_WL = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(finger.tip_link, instance))
            expected = hand.p_HB + hand.R_HB @ case["tips"][finger.name]
            assert np.abs(X_WL @ finger.p_LTip - expected).max() < FK_TOLERANCE, finger.name


def test_joints_and_couplings_agree_with_the_reference(hand, reference_kinematics) -> None:
    facts = {link["joint"]["name"]: link["joint"] for link in reference_kinematics[hand.name]["links"] if link["joint"]}
    assert len(hand.joint_names) == ACTUATED[hand.name]
    for joint in hand.joints:
        fact = facts[joint.name]
        assert joint.lower == pytest.approx(fact["lower"], abs=1e-12)
        assert joint.upper == pytest.approx(fact["upper"], abs=1e-12)
        if fact["mimic"] is None:
            assert joint.coupling is None
        else:
            law = joint.coupling
            assert law is not None
            assert law.master == fact["mimic"]["joint"]
            assert (law.multiplier, law.offset) == (fact["mimic"]["multiplier"], fact["mimic"]["offset"])
    for k, name in enumerate(hand.joint_names):
        assert hand.limits[0, k] == pytest.approx(facts[name]["effective_lower"], abs=1e-9)
        assert hand.limits[1, k] == pytest.approx(facts[name]["effective_upper"], abs=1e-9)


def test_wrist_frame_agrees_with_the_reference(hand, reference_kinematics) -> None:
    palm = reference_kinematics[hand.name]["palm"]
    if hand.name == "shadow":
        pytest.skip("the reference states Shadow's palm in the forearm's frame; the wrist is at the palm's origin here")
    assert hand.R_HB @ palm["palm_normal_in_base"] == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)
    assert hand.R_HB @ palm["finger_direction_in_base"] == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
    wrist = hand.p_HB + hand.R_HB @ palm["wrist_position_zero_pose"]
    assert wrist == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_wrist_frame_follows_the_convention(hand) -> None:
    # At the zero configuration fingers point along +z and the index finger of a right hand lies on the +y side.
    assert np.linalg.det(hand.R_HB) == pytest.approx(1.0)
    _, p = forward_kinematics(hand, RigidTransform(), np.clip(0.0, *hand.limits))
    root = {finger.name: p[hand.link_index[finger.links[0]]] for finger in hand.fingers}
    tip = {finger.name: p[hand.link_index[finger.tip_link]] for finger in hand.fingers}
    assert root["index"][1] > root["middle"][1] > root["ring"][1]
    direction = tip["middle"] - root["middle"]
    assert direction[2] / np.linalg.norm(direction) > 0.9


def test_pads_face_where_the_fingers_bend(hand) -> None:
    cfg = Configuration.at(hand, RigidTransform(), hand.q_rest)
    for finger in hand.fingers:
        k = np.array([hand.link_index[finger.tip_link]])
        tip = cfg.points(k, finger.p_LTip[None])
        n = cfg.vectors(k, finger.n_LPad[None])[0]
        assert np.linalg.norm(n) == pytest.approx(1.0)
        # The last actuated joint of the finger bends it: positive values flex in all five hands.
        J = cfg.jacobian(k, tip)[0, :, 6:]
        chain = [joint for joint in hand.joints if joint.child in finger.links]
        master = chain[-1].name if chain[-1].coupling is None else chain[-1].coupling.master
        velocity = J[:, hand.joint_names.index(master)]
        assert velocity @ n > 0.6 * np.linalg.norm(velocity), finger.name


def test_at_rest_the_thumb_opposes_the_fingers(hand) -> None:
    cfg = Configuration.at(hand, RigidTransform(), hand.q_rest)
    tips, pads = {}, {}
    for finger in hand.fingers:
        k = np.array([hand.link_index[finger.tip_link]])
        tips[finger.name] = cfg.points(k, finger.p_LTip[None])[0]
        pads[finger.name] = cfg.vectors(k, finger.n_LPad[None])[0]
    assert hand.fingers[0].name == "thumb"
    for name in ("index", "middle"):
        across = tips[name] - tips["thumb"]
        distance = np.linalg.norm(across)
        assert 0.045 < distance < 0.075, name
        assert pads[name] @ -across > 0.6 * distance, name
        assert pads["thumb"] @ across > 0.4 * distance, name
    assert all(tip[0] > 0.015 for tip in tips.values())  # in front of the palm
    assert (hand.q_rest >= hand.limits[0]).all()
    assert (hand.q_rest <= hand.limits[1]).all()


def test_finger_geometry_reaches_the_tip(hand) -> None:
    for finger in hand.fingers:
        link = hand.links[hand.link_index[finger.tip_link]]
        gap = np.linalg.norm(link.spheres[:, :3] - finger.p_LTip, axis=1) - link.spheres[:, 3]
        assert -0.009 < gap.min() < 0.001, finger.name
        assert all(isinstance(shape, Capsule) for shape in link.geometry)


def test_geometry_is_near_the_makers(hand, reference_kinematics) -> None:
    # Tips reach as far as the reference's shapes do, within 1.5 mm.
    key = {"little": "pinky"}
    for finger in hand.fingers:
        fact = reference_kinematics[hand.name]["fingers"][key.get(finger.name, finger.name)]
        far = np.array(fact["distal_end_of_geometry_in_distal_link"])
        link = hand.links[hand.link_index[finger.tip_link]]
        u = far / np.linalg.norm(far)
        assert abs((link.spheres[:, :3] @ u + link.spheres[:, 3]).max() - np.linalg.norm(far)) < 2e-3, finger.name


@pytest.mark.parametrize("posture", ["rest", "zero"])
def test_no_self_contact(hand, posture) -> None:
    diagram, plant, instance = welded(hand)
    context = diagram.CreateDefaultContext()
    q = hand.q_rest if posture == "rest" else np.clip(0.0, *hand.limits)
    plant.SetPositions(plant.GetMyMutableContextFromRoot(context), instance, hand.q_full(q))
    results = plant.get_contact_results_output_port().Eval(plant.GetMyContextFromRoot(context))
    assert results.num_point_pair_contacts() == 0
    # Only joints nested by construction are left out: a link and its next solid ancestor. Nothing else overlaps.
    for i, j in ignored_pairs(dataclasses.replace(hand, q_rest=q)):
        above = hand.parents[j]
        while above >= 0 and not hand.links[above].geometry:
            above = hand.parents[above]
        assert above == i, (hand.links[i].name, hand.links[j].name)


def test_the_plant_and_the_pairs_agree(hand) -> None:
    # Drake itself filters parent and child; of all other pairs, it must test exactly ours.
    diagram, plant, instance = welded(hand)
    scene_graph = diagram.GetSubsystemByName("scene_graph")
    inspector = scene_graph.model_inspector()
    body_of = {plant.GetBodyByName(link.name, instance).index(): k for k, link in enumerate(hand.links)}
    tested = set()
    for a, b in inspector.GetCollisionCandidates():
        i, j = (body_of[plant.GetBodyFromFrameId(inspector.GetFrameId(g)).index()] for g in (a, b))
        tested.add((min(i, j), max(i, j)))
    assert tested == {(int(i), int(j)) for i, j in self_collision_pairs(hand)}


def test_rests_in_simulation(hand) -> None:
    diagram, plant, instance = welded(hand, pd_gains=(1.0, 0.1), point_stiffness=1e5)
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    desired = np.concatenate([hand.q_rest, np.zeros_like(hand.q_rest)])
    plant.get_desired_state_input_port(instance).FixValue(context, desired)
    start = plant.GetPositions(context, instance).copy()
    assert start == pytest.approx(hand.q_full(hand.q_rest))
    simulator.AdvanceTo(0.5)
    assert np.abs(plant.GetPositions(context, instance) - start).max() < 1e-6
    assert np.abs(plant.GetVelocities(context, instance)).max() < 1e-6


def test_follows_its_couplings_in_simulation(hand) -> None:
    diagram, plant, instance = welded(hand, pd_gains=(1.0, 0.1))
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    target = 0.9 * hand.q_rest + 0.1 * hand.limits.mean(axis=0)  # near enough for no finger to touch another
    plant.get_desired_state_input_port(instance).FixValue(context, np.concatenate([target, np.zeros_like(target)]))
    simulator.AdvanceTo(1.0)
    q_full = plant.GetPositions(context, instance)
    actuated = [k for k, joint in enumerate(hand.joints) if joint.coupling is None]
    # The coupler is enforced to solver accuracy; PD holds to the target without gravity.
    assert q_full == pytest.approx(hand.q_full(q_full[actuated]), abs=1e-4)
    assert q_full[actuated] == pytest.approx(target, abs=0.02)


def test_actuators_carry_the_efforts(hand) -> None:
    _, plant, instance = welded(hand)
    actuators = [plant.get_joint_actuator(k) for k in plant.GetJointActuatorIndices(instance)]
    assert tuple(a.joint().name() for a in actuators) == hand.joint_names
    assert [a.effort_limit() for a in actuators] == pytest.approx(hand.effort)
    # No maker's placeholder (10 or 1000 N m) slipped in.
    assert (hand.effort <= 5.0).all()


def test_inertias_are_physical(hand) -> None:
    for link in hand.links:
        moments = np.linalg.eigvalsh(link.I_LLcm)
        assert link.mass > 0.0
        assert moments[0] >= 2e-6 * (1.0 - 1e-9)
        assert moments[0] + moments[1] >= moments[2]
    assert 0.3 < sum(link.mass for link in hand.links) < 1.5


def test_sphere_counts_are_moderate(hand) -> None:
    for k, link in enumerate(hand.links):
        assert len(link.spheres) <= (90 if k == 0 else 25), link.name
        assert len(link.spheres) > 0 or not link.geometry


def test_each_fact_names_its_source(hand) -> None:
    assert {"kinematics", "efforts", "masses", "geometry", "wrist"} <= set(hand.sources)


def test_round_trip(hand, tmp_path) -> None:
    path = tmp_path / "copy.yaml"
    write_hand(hand, path)
    copy = read_hand(path)
    assert hand_digest(copy) == hand_digest(hand)
    assert copy.joint_names == hand.joint_names
    for a, b in zip(hand.links, copy.links, strict=True):
        assert a.name == b.name
        assert (a.mass, a.geometry.__repr__()) == (b.mass, b.geometry.__repr__())
        assert np.array_equal(a.spheres, b.spheres)
        assert np.array_equal(a.I_LLcm, b.I_LLcm)
    for a, b in zip(hand.joints, copy.joints, strict=True):
        assert np.array_equal(a.R_PJ, b.R_PJ)
        assert np.array_equal(a.p_PJ, b.p_PJ)
        assert (a.lower, a.upper, a.effort, a.coupling) == (b.lower, b.upper, b.effort, b.coupling)
    for a, b in zip(hand.fingers, copy.fingers, strict=True):
        assert np.array_equal(a.n_LPad, b.n_LPad)
    assert copy.sources == hand.sources


def test_digest_sees_a_change(hand) -> None:
    digest = hand_digest(hand)
    assert len(digest) == 64
    assert hand_digest(dataclasses.replace(hand, display_name="another")) == digest
    joints = (dataclasses.replace(hand.joints[0], upper=hand.joints[0].upper + 1e-6), *hand.joints[1:])
    assert hand_digest(dataclasses.replace(hand, joints=joints)) != digest


def test_adding_to_a_finished_plant_is_refused() -> None:
    plant = MultibodyPlant(0.005)
    plant.Finalize()
    with pytest.raises(ConfigError, match="finalized"):
        add_hand(plant, load_hand("allegro"))


def test_two_hands_in_a_plant_without_geometry() -> None:
    plant = MultibodyPlant(0.005)
    a = add_hand(plant, load_hand("ability"), model_name="a")
    b = add_hand(plant, load_hand("ability"), model_name="b")
    plant.Finalize()
    assert plant.num_positions(a) == plant.num_positions(b) == 10 + 7


def test_palms_are_boxes_capsules_and_balls(hand) -> None:
    assert all(isinstance(shape, Box | Capsule | Sphere) for shape in hand.links[0].geometry)
