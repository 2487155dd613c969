import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation, MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from xdex_drake.scene.bodies import COARSE_FEET, FOOT_RADIUS, RESTING_FEET, add_object, add_table, feet
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene, point_cloud, stable_pose


@pytest.fixture(scope="module")
def objects():
    return {name: load_object(name) for name in ("box", "can", "hammer", "egg")}


def build(scene):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.005)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    body = add_object(plant, scene.object)
    add_table(plant, 0.6, [body])
    plant.Finalize()
    return builder, plant, scene_graph, body


@pytest.mark.parametrize("name", ["box", "can", "hammer", "egg"])
@pytest.mark.parametrize("seed", [0, 1])
def test_object_rests_and_stays(objects, name, seed):
    scene = make_scene(objects[name], seed=seed)
    p_WVs = np.concatenate([v for v, _ in scene.object.parts]) @ scene.X_WO.rotation().matrix().T
    assert (p_WVs + scene.X_WO.translation())[:, 2].min() == pytest.approx(0.0, abs=3e-4)
    p_WOcm = scene.X_WO @ scene.object.p_OOcm
    np.testing.assert_allclose(p_WOcm[:2], 0.0, atol=1e-9)

    builder, plant, _, body = build(scene)
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodyPose(context, body, scene.X_WO)
    simulator.AdvanceTo(1.0)
    X_WO = plant.EvalBodyPoseInWorld(context, body)
    assert np.linalg.norm(X_WO @ scene.object.p_OOcm - p_WOcm) < 3e-4
    turn = (scene.X_WO.inverse() @ X_WO).rotation().ToAngleAxis().angle()
    assert abs(turn) < np.deg2rad(0.1)


def test_poses_depend_on_the_seed_alone(objects):
    first, again = stable_pose(objects["can"], seed=3), stable_pose(objects["can"], seed=3)
    np.testing.assert_array_equal(first.GetAsMatrix34(), again.GetAsMatrix34())
    up = {tuple(np.round(stable_pose(objects["can"], seed=k).rotation().matrix()[2], 1)) for k in range(8)}
    assert len(up) > 1


def test_scene_ids_tell_scenes_apart(objects):
    pose = RigidTransform([0.0, 0.0, 0.2])
    scenes = [
        make_scene(objects["box"]),
        make_scene(objects["box"], seed=1),
        make_scene(objects["can"]),
        make_scene(objects["box"], pose=pose),
        make_scene(objects["box"], pose=RigidTransform(RotationMatrix.MakeXRotation(0.1), [0.0, 0.0, 0.2])),
    ]
    assert len({scene.scene_id for scene in scenes}) == len(scenes)
    assert make_scene(objects["box"], pose=pose).scene_id == scenes[3].scene_id
    assert scenes[3].X_WO is pose


def test_point_cloud_in_world_and_object(objects):
    scene = make_scene(objects["hammer"], seed=2)
    p_WPs, n_WPs = point_cloud(scene, 300, 7)
    p_OPs, n_OPs = point_cloud(scene, 300, 7, in_world=False)
    np.testing.assert_allclose((scene.X_WO @ p_OPs.T).T, p_WPs, atol=1e-12)
    np.testing.assert_allclose(n_OPs @ scene.X_WO.rotation().matrix().T, n_WPs, atol=1e-12)
    assert p_WPs[:, 2].min() > -1e-3


def test_body_has_the_objects_mass_and_parts(objects):
    scene = make_scene(objects["hammer"])
    _, plant, _, body = build(scene)
    inertia = body.default_spatial_inertia()
    assert inertia.get_mass() == scene.object.mass
    np.testing.assert_allclose(inertia.get_com(), scene.object.p_OOcm, atol=1e-12)
    np.testing.assert_allclose(inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3(),
                               scene.object.I_OcmO, atol=1e-12)  # fmt: skip
    shapes = plant.GetCollisionGeometriesForBody(body)
    assert len(shapes) == len(scene.object.parts) + len(feet(scene.object))


@pytest.mark.parametrize("name", ["box", "can", "hammer", "egg"])
def test_feet_stand_as_high_as_the_object(objects, name):
    scene = make_scene(objects[name], seed=1)
    for centers in (feet(scene.object), feet(scene.object, scene.X_WO)):
        heights = (scene.X_WO @ centers.T).T[:, 2] - FOOT_RADIUS
        assert heights.min() == pytest.approx(0.0, abs=3e-4)
        assert (heights < heights.min() + 3e-4).sum() >= 3
    assert len(feet(scene.object, scene.X_WO)) <= RESTING_FEET + COARSE_FEET


def test_without_a_scene_graph_the_body_has_no_shape(objects):
    plant = MultibodyPlant(0.005)
    assert plant.GetCollisionGeometriesForBody(add_object(plant, objects["box"])) == []


def test_a_camera_sees_the_mesh(objects):
    scene = make_scene(objects["box"])
    builder, plant, scene_graph, body = build(scene)
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant.SetFreeBodyPose(plant.GetMyMutableContextFromRoot(context), body, scene.X_WO)
    core = RenderCameraCore("vtk", CameraInfo(64, 48, 0.8), ClippingRange(0.01, 5.0), RigidTransform())
    X_WC = RigidTransform(Quaternion([0.0, 1.0, 0.0, 0.0]), [0.0, 0.0, 0.6])  # Looks straight down.
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
    depth = query.RenderDepthImage(DepthRenderCamera(core, DepthRange(0.01, 5.0)), scene_graph.world_frame_id(), X_WC)
    color = query.RenderColorImage(ColorRenderCamera(core), scene_graph.world_frame_id(), X_WC)
    height = 0.6 - np.asarray(depth.data)[24, 32, 0]
    assert height == pytest.approx(2.0 * scene.X_WO.multiply(scene.object.p_OOcm)[2], abs=2e-3)
    assert (np.asarray(color.data)[24, 32, :3] != np.asarray(color.data)[0, 0, :3]).any()
