"""MJCF files as MuJoCo reads them, and as we read them ourselves."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.collision import ignored_pairs
from xdex_drake.hand.description import Convex, Hand
from xdex_drake.hand.fingertip import replace_tip
from xdex_drake.hand.importing.mjcf import read_mjcf
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.library import load_hand
from xdex_drake.interchange.mjcf import MJCF, depth_first, export_mjcf, hand_mjcf
from xdex_drake.scene.plant import PlantSettings

mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")

HANDS = ["allegro", "ability", "inspire", "shadow", "schunk_svh", "g0-0137"]


@pytest.fixture(scope="module", params=HANDS)
def exported(request, tmp_path_factory) -> tuple[Hand, Path]:
    hand = load_hand(request.param)
    if hand.name == "allegro":  # No library hand has convex parts of its own.
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 4)]) * 0.008
        hand = replace_tip(hand, "thumb", [Convex(corners)])
    return hand, export_mjcf(hand, tmp_path_factory.mktemp(request.param))


@pytest.fixture
def model(exported, capfd):
    """The model; neither the compiler nor a first step may have anything to say."""
    model = mujoco.MjModel.from_xml_path(str(exported[1]))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    assert not any(int(warning.number) for warning in data.warning)
    told = capfd.readouterr()
    assert told.out + told.err == ""
    return model


def set_joints(model, data, hand: Hand, q: Array) -> None:
    for joint, value in zip(hand.joints, hand.q_full(q), strict=True):
        data.joint(joint.name).qpos[0] = value


def test_every_link_is_where_we_have_it(exported, model) -> None:
    hand, _ = exported
    data, rng = mujoco.MjData(model), np.random.default_rng(5)
    for q in [hand.q_rest, *(rng.uniform(*hand.limits) for _ in range(3))]:
        set_joints(model, data, hand, q)
        mujoco.mj_kinematics(model, data)
        for link, R, p in zip(hand.links, *forward_kinematics(hand, RigidTransform(), q), strict=True):
            np.testing.assert_allclose(data.body(link.name).xpos, p, atol=1e-9)
            np.testing.assert_allclose(data.body(link.name).xmat.reshape(3, 3), R, atol=1e-9)
        R, p = forward_kinematics(hand, RigidTransform(), q)
        np.testing.assert_allclose(data.site("wrist").xpos, 0.0, atol=1e-12)
        for finger in hand.fingers:
            k = hand.link_index[finger.tip_link]
            np.testing.assert_allclose(data.site(f"{finger.name}_tip").xpos, R[k] @ finger.p_LTip + p[k], atol=1e-9)


def test_inertias_are_the_hands(exported, model) -> None:
    hand, _ = exported
    for link in hand.links:
        body = model.body(link.name)
        assert body.mass[0] == link.mass
        np.testing.assert_array_equal(body.ipos, link.p_LLcm)
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, body.iquat)
        I_LLcm = R.reshape(3, 3) @ np.diag(body.inertia) @ R.reshape(3, 3).T
        np.testing.assert_allclose(I_LLcm, link.I_LLcm, atol=1e-9 * np.linalg.norm(link.I_LLcm))


def test_limits_efforts_and_couplings_are_the_hands(exported, model) -> None:
    hand, _ = exported
    assert [model.joint(k).name for k in range(model.njnt)] == [hand.joints[k].name for k in depth_first(hand)]
    laws = {model.joint(model.eq_obj1id[k]).name: k for k in range(model.neq)}
    assert set(laws) == {joint.name for joint in hand.joints if joint.coupling is not None}
    for joint in hand.joints:
        written = model.joint(joint.name)
        np.testing.assert_array_equal(written.range, [joint.lower, joint.upper])
        assert written.qposadr.size == 1 and written.limited[0]
        if joint.coupling is None:
            np.testing.assert_array_equal(model.actuator(joint.name).forcerange, [-joint.effort, joint.effort])
        else:
            k = laws[joint.name]
            assert model.joint(model.eq_obj2id[k]).name == joint.coupling.master
            law = [joint.coupling.offset, joint.coupling.multiplier, 0.0, 0.0, 0.0]
            np.testing.assert_array_equal(model.eq_data[k, :5], law)
    assert [model.actuator(k).name for k in range(model.nu)] == list(hand.joint_names)


def test_actuators_follow_the_protocols_law(exported, model) -> None:
    hand, _ = exported
    plant, data, rng = PlantSettings(), mujoco.MjData(model), np.random.default_rng(3)
    for spread in (0.2, 20.0):  # Within the effort, and far beyond it.
        q, aim = rng.uniform(*hand.limits), rng.uniform(*hand.limits)
        v = rng.normal(size=len(q)) * 0.1
        target = q + spread * (aim - q)
        set_joints(model, data, hand, q)
        for name, one, rate in zip(hand.joint_names, target, v, strict=True):
            data.joint(name).qvel[0] = rate
            data.actuator(name).ctrl[0] = one
        mujoco.mj_forward(model, data)
        low, high = model.actuator_ctrlrange.T
        wanted = plant.kp * (np.clip(target, low, high) - q) - plant.kd * v
        np.testing.assert_allclose(data.actuator_force, np.clip(wanted, -hand.effort, hand.effort), atol=1e-12)
        # Where the range of targets cuts one off, it asks for more than the effort anyway.
        np.testing.assert_array_less(
            np.where((target > high) | (target < low), hand.effort, 0.0) - 1e-9, abs(wanted + plant.kd * v)
        )


def test_links_collide_as_in_our_programs(exported, model) -> None:
    hand, _ = exported
    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
    pairs = {(model.body(hand.links[i].name).id, model.body(hand.links[j].name).id) for i, j in ignored_pairs(hand)}
    assert {tuple(sorted(pair)) for pair in excluded} == {tuple(sorted(pair)) for pair in pairs}
    shapes = sum(len(link.geometry) for link in hand.links)
    assert model.ngeom == shapes and np.all(model.geom_contype == 1) and np.all(model.geom_conaffinity == 1)


def test_a_hand_at_rest_stays_at_rest(exported, model) -> None:
    hand, _ = exported
    data = mujoco.MjData(model)
    set_joints(model, data, hand, hand.q_rest)
    data.ctrl[:] = hand.q_rest
    for _ in range(500):
        mujoco.mj_step(model, data)
    q = np.array([data.joint(joint.name).qpos[0] for joint in hand.joints])
    np.testing.assert_allclose(q, hand.q_full(hand.q_rest), atol=1e-6)


def test_our_reader_finds_what_was_written(exported) -> None:
    hand, file = exported
    read = read_mjcf(file)
    joints = {joint.name: joint for joint in read.joints}
    for joint in hand.joints:
        assert (joints[joint.name].lower, joints[joint.name].upper) == (joint.lower, joint.upper)
        assert (joints[joint.name].mimic is None) == (joint.coupling is None)
        if joint.coupling is None:
            assert joints[joint.name].effort == joint.effort
    names = [link.name for link in hand.links]
    assert {tuple(sorted((names[i], names[j]))) for i, j in ignored_pairs(hand)} <= {
        tuple(sorted(pair)) for pair in read.ignored_pairs
    }


def test_settings_reach_the_model() -> None:
    settings = replace(MJCF, armature=2e-3, time_step=0.001, time_constant=0.003)
    text = hand_mjcf(load_hand("allegro"), plant=PlantSettings(kp=3.0, friction=0.4), settings=settings).xml
    model = mujoco.MjModel.from_xml_string(text)
    assert model.opt.timestep == 0.001
    assert np.all(model.dof_armature == 2e-3) and np.all(model.geom_solref[:, 0] == 0.003)
    assert np.all(model.actuator_gainprm[:, 0] == 3.0) and np.all(model.geom_friction[:, 0] == 0.4)


def test_a_folder_that_cannot_be_written(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="choose another folder"):
        export_mjcf(load_hand("allegro"), tmp_path / "file")
