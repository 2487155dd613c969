import numpy as np
import pytest
import trimesh
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

from xdex_drake.errors import ConfigError
from xdex_drake.scene.bodies import COARSE_FEET, FOOT_RADIUS, RESTING_FEET, add_object, add_table, feet
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import (
    drop,
    make_scene,
    point_cloud,
    pose_of,
    random_scene,
    same_pose,
    stable_pose,
    stable_poses,
)


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
    pose = RigidTransform([0.1, 0.0, 0.0])
    scenes = [
        make_scene(objects["box"]),
        make_scene(objects["box"], seed=1),
        make_scene(objects["can"]),
        make_scene(objects["box"], pose=pose),
        make_scene(objects["box"], pose=RigidTransform(RotationMatrix.MakeZRotation(0.1), [0.0, 0.0, 0.0])),
    ]
    assert len({scene.scene_id for scene in scenes}) == len(scenes)
    assert make_scene(objects["box"], pose=pose).scene_id == scenes[3].scene_id
    assert scenes[3].X_WO is pose


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ([0.0, 0.0, -0.03], "lowest point is 30 mm below the table"),
        ([0.5, 0.0, 0.75], "lowest point is 750 mm above the table"),
        ([3.0, 1.0, 0.0], "beyond the table"),
    ],
)
def test_poses_of_a_users_own_are_checked(objects, place, said):
    with pytest.raises(ConfigError, match=said):
        make_scene(objects["box"], pose=RigidTransform(place))


def test_poses_have_the_numbers_that_are_shown(objects):
    poses = stable_poses(objects["can"])
    for k, pose in enumerate(poses):
        assert pose_of(objects["can"], number=k).IsExactlyEqualTo(pose.X_WO)
    upright = make_scene(objects["can"], pose=pose_of(objects["can"], upright=True))
    assert upright.X_WO.rotation().matrix()[2, 2] > 0.99
    for number in (len(poses), -1):
        with pytest.raises(ConfigError, match=f"no pose {number}"):
            pose_of(objects["can"], number=number)


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


def test_stable_poses_of_a_box_are_three_and_add_up(objects):
    poses = stable_poses(objects["box"])
    size = np.ptp(objects["box"].vertices, axis=0)
    assert len(poses) == 3
    assert sum(pose.probability for pose in poses) == pytest.approx(1.0)
    assert [pose.probability for pose in poses] == sorted((pose.probability for pose in poses), reverse=True)
    heights = [2.0 * (pose.X_WO @ objects["box"].p_OOcm)[2] for pose in poses]
    np.testing.assert_allclose(sorted(heights), sorted(size), atol=5e-4)
    assert np.argmin(heights) == 0  # The lowest center of mass is the most probable.
    assert all(pose.tilt_rad < np.deg2rad(0.5) for pose in poses)


def test_facets_that_trimesh_loses_to_slivers_are_found_again(objects, monkeypatch):
    real, hulls = trimesh.poses.compute_stable_poses, []

    def lossy(hull, **options):
        hulls.append(hull)
        poses, probabilities = real(hull, **options)
        return (poses, probabilities) if len(hulls) > 1 else (poses[:0], probabilities[:0])

    monkeypatch.setattr(trimesh.poses, "compute_stable_poses", lossy)
    poses = stable_poses(objects["box"])
    assert len(hulls) == 2 and len(poses) == 3
    assert sum(pose.probability for pose in poses) == pytest.approx(1.0)


def test_symmetry_makes_one_pose_of_many_facets(objects):
    assert len(stable_poses(objects["can"])) == 2  # On its side, and on either end.


@pytest.mark.parametrize(("shape", "tolerance"), [("box", 0.15), ("cone", 0.15)])
def test_drops_agree_with_the_hull_method(tmp_path, shape, tolerance):
    if shape == "cone":
        trimesh.creation.cone(radius=0.035, height=0.05, sections=24).export(tmp_path / "cone.obj")
    model = load_object(tmp_path / "cone.obj" if shape == "cone" else shape)
    poses, rests = stable_poses(model), drop(model, count=40, seed=3)
    assert len(rests) >= 36
    found = [
        next((k for k, pose in enumerate(poses) if same_pose(model, pose.X_WO.rotation(), X.rotation())), -1)
        for X in rests
    ]
    assert found.count(-1) <= 1
    for k, pose in enumerate(poses):
        # The standard deviation of a share of 40 is at most 0.08; the hull method knows no momentum.
        assert found.count(k) / len(found) == pytest.approx(pose.probability, abs=tolerance + 0.05)


def test_spread_moves_the_object_and_nothing_else(objects):
    still, moved = make_scene(objects["box"], seed=2), make_scene(objects["box"], seed=2, spread_m=0.1)
    offset = moved.X_WO.translation() - still.X_WO.translation()
    np.testing.assert_array_equal(moved.X_WO.rotation().matrix(), still.X_WO.rotation().matrix())
    assert offset[2] == 0.0 and 0.0 < np.abs(offset[:2]).max() <= 0.1
    assert moved.scene_id != still.scene_id
    for wrong in (-0.1, 2.0):
        with pytest.raises(ConfigError, match="spread_m"):
            make_scene(objects["box"], spread_m=wrong)


def test_random_scenes_vary_in_size_place_and_pose():
    scenes = [random_scene("box", seed=k) for k in range(1, 7)]
    assert len({scene.object.scale for scene in scenes}) > 2
    assert all(0.8 <= scene.object.scale <= 1.2 for scene in scenes)
    assert len({tuple(scene.X_WO.translation()) for scene in scenes}) == len(scenes)
    again = random_scene("box", seed=3)
    np.testing.assert_array_equal(again.X_WO.GetAsMatrix34(), scenes[2].X_WO.GetAsMatrix34())
    assert again.scene_id == scenes[2].scene_id
    with pytest.raises(ConfigError, match="scale"):
        random_scene("box", seed=1, scale=(1.0, 0.5))
