"""SDFormat files of hands, and objects alone, as Drake and MuJoCo read them."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from xdex_drake.hand.collision import ignored_pairs
from xdex_drake.hand.importing.files import import_hand
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.library import load_hand
from xdex_drake.interchange.objects import export_object
from xdex_drake.interchange.sdf import export_sdf
from xdex_drake.interchange.urdf import export_urdf
from xdex_drake.scene.object import load_object


def parsed(file):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    Parser(plant).AddModels(str(file))
    return builder, plant, scene_graph


@pytest.mark.parametrize("name", ["allegro", "ability", "schunk_svh"])
def test_drake_reads_the_same_hand_from_sdf_as_we_have(name, tmp_path):
    hand = load_hand(name)
    file = export_sdf(hand, tmp_path)
    _, plant, scene_graph = parsed(file)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(hand.links[0].name))
    plant.Finalize()
    assert plant.num_actuators() == len(hand.joint_names)
    assert plant.num_constraints() == sum(joint.coupling is not None for joint in hand.joints)
    context = plant.CreateDefaultContext()
    q = np.random.default_rng(3).uniform(*hand.limits)
    for joint, value in zip(hand.joints, hand.q_full(q), strict=True):
        plant.GetJointByName(joint.name).set_angle(context, value)
    X_HB = RigidTransform(RotationMatrix(hand.R_HB), hand.p_HB)
    R, p = forward_kinematics(hand, X_HB.inverse(), q)
    for k, link in enumerate(hand.links):
        body = plant.GetBodyByName(link.name)
        X = plant.EvalBodyPoseInWorld(context, body)
        np.testing.assert_allclose(X.translation(), p[k], atol=1e-9)
        np.testing.assert_allclose(X.rotation().matrix(), R[k], atol=1e-9)
        inertia = body.default_spatial_inertia()
        assert inertia.get_mass() == pytest.approx(link.mass)
        np.testing.assert_allclose(inertia.get_com(), link.p_LLcm, atol=1e-12)
    inspector = scene_graph.model_inspector()
    for i, j in ignored_pairs(hand):
        pairs = (plant.GetCollisionGeometriesForBody(plant.GetBodyByName(hand.links[k].name)) for k in (i, j))
        one, other = (ids[:1] for ids in pairs)
        assert all(inspector.CollisionFiltered(a, b) for a in one for b in other)
    again = import_hand(file).hand
    assert set(again.joint_names) == set(hand.joint_names)
    np.testing.assert_allclose(again.effort[0], hand.effort[list(hand.joint_names).index(again.joint_names[0])])


def test_actuated_joints_have_motors_in_urdf(tmp_path):
    hand = load_hand("ability")
    _, plant, _ = parsed(export_urdf(hand, tmp_path))
    plant.Finalize()
    assert plant.num_actuators() == len(hand.joint_names)


@pytest.mark.parametrize("format", ["urdf", "sdf", "mjcf"])
def test_an_object_has_its_mass_parts_and_friction(format, tmp_path):
    thing = load_object("mug", mass=0.3, friction=0.4)
    file = export_object(thing, tmp_path, format=format)
    if format == "mjcf":
        mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
        model = mujoco.MjModel.from_xml_path(str(file))
        np.testing.assert_allclose(model.body("object").mass, thing.mass)
        np.testing.assert_allclose(model.body("object").ipos, thing.p_OOcm, atol=1e-12)
        assert model.ngeom == len(thing.parts) + 1
        return
    _, plant, scene_graph = parsed(file)
    plant.Finalize()
    body = plant.GetBodyByName("mug")
    inertia = body.default_spatial_inertia()
    np.testing.assert_allclose(inertia.get_com(), thing.p_OOcm, atol=1e-12)
    about_center = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    np.testing.assert_allclose(about_center, thing.I_OcmO, atol=1e-9)
    geometries = plant.GetCollisionGeometriesForBody(body)
    assert len(geometries) == len(thing.parts)
    material = scene_graph.model_inspector().GetProximityProperties(geometries[0])
    assert material.GetProperty("material", "coulomb_friction").static_friction() == pytest.approx(0.4)
