"""Lifts in MuJoCo on the exported scenes."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.errors import ConfigError, MissingExtra
from xdex_drake.grasping.synthesis import SynthesisSettings, candidates_of_batch
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.library import load_hand
from xdex_drake.interchange.mjcf import MJCF, MjcfSettings
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene
from xdex_drake.simulation import drake
from xdex_drake.simulation.mujoco import lift, load_model, mujoco_rig, simulate_lift
from xdex_drake.simulation.protocol import LIFT
from xdex_drake.simulation.scenes import export_scenes, lift_scene
from xdex_drake.simulation.trajectory import target_rates, targets

mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")


@pytest.fixture(scope="module", params=["allegro", "ability"])
def hand(request):
    return load_hand(request.param)


@pytest.fixture(scope="module")
def scene():
    return make_scene(load_object("can"))


@pytest.fixture(scope="module")
def rig(hand, scene):
    return mujoco_rig(hand, scene)


@pytest.fixture(scope="module")
def grasps(hand, scene):
    settings = replace(SynthesisSettings(), batch=24)
    grasps = list(candidates_of_batch(hand, scene, seed=0, settings=settings, tally=Tally()))
    assert len(grasps) >= 3, "a search of 24 candidates gave too few certified grasps of a can"
    return grasps[:6]


def test_what_drake_lifts_mujoco_lifts(rig, grasps, hand, scene):
    verdicts = [simulate_lift(rig, grasp) for grasp in grasps]
    assert all(v.protocol == "mujoco:lift-0.2/2tips" for v in verdicts)
    lifted = [v for v, grasp in zip(verdicts, grasps, strict=True) if drake.lift(grasp, hand, scene).success]
    assert np.mean([v.success for v in lifted]) >= 0.9
    for verdict in lifted:
        assert abs(verdict.lift_height_m - LIFT.rise_m) < 5e-3 or not verdict.success
    again = lift(grasps[0], hand, scene)
    assert replace(again, seconds=0.0) == replace(verdicts[0], seconds=0.0)


def test_forces_are_the_certificates(rig, grasps):
    for grasp in grasps:
        if not simulate_lift(rig, grasp).success:
            continue
        normal = 0.0
        for k in range(rig.data.ncon):
            bodies = {int(rig.model.geom_bodyid[geom]) for geom in rig.data.contact[k].geom}
            if rig.object_body in bodies and 0 not in bodies:
                force = np.zeros(6)
                mujoco.mj_contactForce(rig.model, rig.data, k, force)
                normal += force[0]
        assert normal == pytest.approx(sum(contact.f_C[2] for contact in grasp.certificate.contacts), rel=0.08)


def test_contacts_sink_by_the_closed_form(hand, scene, grasps):
    """r = (1 - d) tau^2 f / m: millimetres at MuJoCo's own contacts without armature, hundredths of one as exported."""
    soft = MjcfSettings(time_constant=0.02, impedance=(0.9, 0.95, 0.001), armature=0.0)
    for settings, least, most in ((soft, 1e-3, 2e-2), (MJCF, 1e-6, 1e-4)):
        rig = mujoco_rig(hand, scene, settings=settings, protocol=replace(LIFT, rise_m=0.0))
        deepest = 0.0
        for grasp in grasps[:3]:
            rig.start(grasp)
            rig.advance_to(LIFT.duration_s)
            rig.restore(rig.state())
            for k in range(rig.data.ncon):
                contact, force = rig.data.contact[k], np.zeros(6)
                bodies = [int(rig.model.geom_bodyid[geom]) for geom in contact.geom]
                if rig.object_body not in bodies or 0 in bodies or abs(rig.data.efc_vel[contact.efc_address]) > 3e-5:
                    continue
                mujoco.mj_contactForce(rig.model, rig.data, k, force)
                one_over_m = sum(rig.model.body_invweight0[body, 0] for body in bodies)
                d = rig.data.efc_KBIP[contact.efc_address, 2]
                sunk = (1.0 - d) * (settings.impedance[1] / d) ** 2 * settings.time_constant**2 * force[0] * one_over_m
                assert -contact.dist == pytest.approx(sunk, rel=0.1)
                deepest = max(deepest, sunk)
        assert least < deepest < most


def test_couplings_hold_under_load(rig, grasps, hand):
    simulate_lift(rig, grasps[0])
    q_full = rig.data.qpos[rig.joint_addresses]
    q = q_full[[joint.coupling is None for joint in hand.joints]]
    np.testing.assert_allclose(q_full, hand.q_full(q), atol=2e-3)


def far(grasp, offset):
    """The same grasp with the hand moved away."""
    shift = RigidTransform(np.asarray(offset, dtype=float))
    return replace(grasp, X_WH=shift @ grasp.X_WH, X_WH_pregrasp=shift @ grasp.X_WH_pregrasp)


def test_failures_are_named_as_in_drake(rig, grasps, hand):
    away = simulate_lift(rig, far(grasps[0], [0.0, 0.0, 0.4]))
    assert away.failure_reason == "not_grasped" and abs(away.lift_height_m) < 2e-3
    closed = replace(grasps[0], q_pregrasp=grasps[0].q_squeeze, X_WH_pregrasp=grasps[0].X_WH)
    assert simulate_lift(rig, closed).failure_reason == "pregrasp_in_contact"
    assert simulate_lift(rig, far(grasps[0], [0.5, 0.0, -0.3])).failure_reason == "table_collision"
    heavy = mujoco_rig(hand, make_scene(load_object("can", mass=3.0)))
    assert simulate_lift(heavy, grasps[0]).failure_reason in ("slipped", "not_grasped")


def test_a_broken_state_is_a_failed_simulation(hand, scene, grasps, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rig = mujoco_rig(hand, scene)
    rig.model.opt.gravity[2] = np.nan
    assert simulate_lift(rig, grasps[0]).failure_reason == "simulation_failed"
    assert not list(tmp_path.iterdir()), "MuJoCo left a log file"


def test_the_rig_is_the_exported_scene(rig, grasps, hand, scene):
    grasp = grasps[1]
    model = load_model(lift_scene(hand, scene, grasp=grasp))
    rig.start(grasp)
    for name in (
        "body_pos",
        "body_quat",
        "body_invweight0",
        "dof_invweight0",
        "qpos0",
        "geom_friction",
        "dof_armature",
    ):
        np.testing.assert_allclose(getattr(model, name), getattr(rig.model, name), atol=1e-12, err_msg=name)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("pregrasp").id)
    np.testing.assert_allclose(data.qpos, rig.data.qpos, atol=1e-15)
    step, plant = model.opt.timestep, LIFT.plant
    while data.time < LIFT.close_s + LIFT.squeeze_s - 0.5 * step:
        (q, offset), (q_rate, offset_rate) = (f(grasp, LIFT, data.time + step) for f in (targets, target_rates))
        carriage = offset + plant.carriage_kd / plant.carriage_kp * offset_rate
        data.ctrl[:] = np.concatenate([carriage, q + plant.kd / plant.kp * q_rate])
        mujoco.mj_step(model, data)
    rig.advance_to(LIFT.close_s + LIFT.squeeze_s)
    np.testing.assert_allclose(data.qpos, rig.data.qpos, atol=1e-9)
    np.testing.assert_allclose(data.ctrl, model.key("squeeze").ctrl, atol=1e-12)


def test_a_scene_lifts_by_its_key_frames_alone(grasps, hand, scene, rig, tmp_path):
    lifted = [grasp for grasp in grasps if simulate_lift(rig, grasp).success][:2]
    named = [(replace(grasp, grasp_id=f"{hand.name}/{k}"), hand, scene) for k, grasp in enumerate(lifted)]
    files = export_scenes(named, tmp_path)
    for file in files:
        model = mujoco.MjModel.from_xml_path(str(file))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("pregrasp").id)
        start, stages = data.qpos[-5], ["pregrasp", "grasp", "squeeze", "squeeze"]
        ctrl = [model.key(name).ctrl.copy() for name in stages]
        ctrl[-1][2] += 0.25
        for begin, end, seconds in zip(ctrl, ctrl[1:], (1.0, 0.4, 0.7), strict=False):
            for s in np.linspace(0.0, 1.0, round(seconds / model.opt.timestep)):
                data.ctrl[:] = begin + s * (end - begin)
                mujoco.mj_step(model, data)
        assert data.qpos[-5] - start > 0.2
        assert not any(int(warning.number) for warning in data.warning)
    with pytest.raises(ConfigError, match="identifier"):
        export_scenes(named[:1] * 2, tmp_path)
    with pytest.raises(ConfigError, match="no pre-grasp or squeeze"):
        export_scenes([(replace(lifted[0], tau_squeeze=None), hand, scene)], tmp_path)


def test_masses_and_friction_of_the_scene(hand):
    thing = load_object("mug", mass=0.23, friction=0.3)
    scene = make_scene(thing)
    model = load_model(lift_scene(hand, scene))
    body = model.body("object")
    assert body.mass[0] == 0.23
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, body.iquat)
    I_OcmO = R.reshape(3, 3) @ np.diag(body.inertia) @ R.reshape(3, 3).T
    np.testing.assert_allclose(I_OcmO, thing.I_OcmO, atol=1e-9 * np.linalg.norm(thing.I_OcmO))
    np.testing.assert_array_equal(body.ipos, thing.p_OOcm)
    parts = [model.geom(f"object_part_{k}") for k in range(len(thing.parts))]
    assert all(part.friction[0] == pytest.approx(2 * 0.6 * 0.3 / 0.9) and part.priority[0] == 1 for part in parts)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for part, (vertices, _) in zip(parts, thing.parts, strict=True):
        mesh = part.dataid[0]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        placed = (
            model.mesh_vert[first : first + count] @ data.geom(part.id).xmat.reshape(3, 3).T + data.geom(part.id).xpos
        )
        lowest, highest = (scene.X_WO @ vertices.T).min(axis=1), (scene.X_WO @ vertices.T).max(axis=1)
        np.testing.assert_allclose([placed.min(axis=0), placed.max(axis=0)], [lowest, highest], atol=1e-6)


def test_pushes_and_states(rig, grasps, scene):
    rig.start(grasps[0])
    rig.advance_to(LIFT.duration_s)
    held = rig.state()

    def way_under(f_W):
        rig.restore(held)
        begin = rig.X_WO().translation()
        rig.push(np.asarray(f_W))
        rig.advance_to(LIFT.duration_s + 0.1)
        rig.push(np.zeros(3))
        return rig.X_WO().translation() - begin

    weight = 9.81 * scene.object.mass
    still, pushed = way_under([0.0, 0.0, 0.0]), way_under([20.0 * weight, 0.0, 0.0])
    np.testing.assert_array_equal(way_under([0.0, 0.0, 0.0]), still)
    assert np.linalg.norm(still) < 2e-3 < pushed[0]


def test_without_mujoco_the_extra_is_named(hand, scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtra, match=r"xdex_drake\[mujoco\]"):
        mujoco_rig(hand, scene)
