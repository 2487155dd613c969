"""URDF files of hands, as other tools read them."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
import yourdfpy
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.collision import ignored_pairs
from xdex_drake.hand.description import Convex, Hand
from xdex_drake.hand.importing.urdf import read_urdf
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.mirror import replace_tip
from xdex_drake.interchange.urdf import export_urdf, rpy_of

HANDS = ["allegro", "ability", "inspire", "shadow", "schunk_svh"]


@pytest.fixture(scope="module", params=HANDS)
def exported(request, tmp_path_factory) -> tuple[Hand, Path]:
    hand = load_hand(request.param)
    if hand.name == "allegro":  # No library hand has convex parts of its own.
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 4)]) * 0.008
        hand = replace_tip(hand, "thumb", [Convex(corners)])
    return hand, export_urdf(hand, tmp_path_factory.mktemp(request.param))


def poses_in_base(hand: Hand, q: Array) -> list[Array]:
    """X_BL of each link, homogeneous."""
    R, p = forward_kinematics(hand, RigidTransform(), q)
    X = np.tile(np.eye(4), (len(hand.links), 1, 1))
    X[:, :3, :3], X[:, :3, 3] = R, p
    return [np.linalg.inv(X[0]) @ X_HL for X_HL in X]


def samples(hand: Hand) -> list[Array]:
    rng = np.random.default_rng(5)
    return [hand.q_rest, *(rng.uniform(*hand.limits) for _ in range(3))]


def test_yourdfpy_agrees(exported) -> None:
    hand, file = exported
    robot = yourdfpy.URDF.load(str(file), load_meshes=True)
    for q in samples(hand):
        robot.update_cfg(dict(zip(hand.joint_names, q, strict=True)))
        for link, X in zip(hand.links, poses_in_base(hand, q), strict=True):
            np.testing.assert_allclose(robot.get_transform(link.name, hand.links[0].name), X, atol=1e-9)


def test_mujoco_agrees(exported) -> None:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
    hand, file = exported
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    for q in samples(hand):
        for joint, value in zip(hand.joints, hand.q_full(q), strict=True):
            data.qpos[model.jnt_qposadr[model.joint(joint.name).id]] = value
        mujoco.mj_kinematics(model, data)
        for link, X in list(zip(hand.links, poses_in_base(hand, q), strict=True))[1:]:
            body = model.body(link.name).id
            np.testing.assert_allclose(data.xpos[body], X[:3, 3], atol=1e-9)
            np.testing.assert_allclose(data.xmat[body].reshape(3, 3), X[:3, :3], atol=1e-9)


def test_pinocchio_agrees(exported) -> None:
    pin = pytest.importorskip("pinocchio", reason="pin is not installed")
    hand, file = exported
    model = pin.buildModelFromUrdf(str(file))
    data = model.createData()
    for q in samples(hand):
        values = dict(zip((joint.name for joint in hand.joints), hand.q_full(q), strict=True))
        full = np.array([values[name] for name in list(model.names)[1:]])
        pin.framesForwardKinematics(model, data, full)
        for link, X in zip(hand.links, poses_in_base(hand, q), strict=True):
            np.testing.assert_allclose(data.oMf[model.getFrameId(link.name)].homogeneous, X, atol=1e-9)


def test_our_reader_finds_what_was_written(exported) -> None:
    hand, file = exported
    model = read_urdf(file)
    assert model.notes == ()
    names = [link.name for link in hand.links]
    assert set(model.ignored_pairs) == {tuple(sorted((names[i], names[j]))) for i, j in ignored_pairs(hand)}
    joints = {joint.name: joint for joint in model.joints}
    links = {link.name: link for link in model.links}
    for joint in hand.joints:
        written = joints[joint.name]
        assert (written.lower, written.upper, written.effort) == (joint.lower, joint.upper, joint.effort)
        assert (written.mimic is None) == (joint.coupling is None)
        np.testing.assert_allclose(written.R_PJ, joint.R_PJ, atol=1e-14)
    for link in hand.links:
        inertia = links[link.name].inertia
        assert inertia is not None
        assert inertia.mass == link.mass
        np.testing.assert_allclose(inertia.I_LLcm, link.I_LLcm, atol=1e-18)
    for finger in hand.fingers:
        np.testing.assert_array_equal(joints[f"{finger.name}_tip_fixed"].p_PJ, finger.p_LTip)


def test_meshes_are_convex_closed_and_have_normals(exported) -> None:
    hand, file = exported
    convex = sum(isinstance(shape, Convex) for link in hand.links for shape in link.geometry)
    meshes = sorted((file.parent / "meshes").glob("*.obj"))
    assert len(meshes) == convex
    for path in meshes:
        text = path.read_text()
        assert "vn " in text
        mesh = trimesh.load_mesh(path, process=True)
        mesh.merge_vertices(merge_norm=True)
        assert mesh.is_watertight
        assert mesh.volume > 0.0


def test_drake_loads_it_with_its_filters(exported) -> None:
    hand, file = exported
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    Parser(plant).AddModels(file)
    plant.Finalize()
    ids = [plant.GetCollisionGeometriesForBody(plant.GetBodyByName(link.name)) for link in hand.links]
    inspector = scene_graph.model_inspector()
    for i, j in ignored_pairs(hand):
        assert all(inspector.CollisionFiltered(a, b) for a in ids[i] for b in ids[j])


@pytest.mark.parametrize("angles", [(0.3, 0.5 * np.pi, -1.0), (1.0, -0.5 * np.pi + 1e-9, 2.0), (3.0, 0.1, -3.0)])
def test_angles_are_exact_also_where_they_are_ill_determined(angles) -> None:
    R = Rotation.from_euler("xyz", angles).as_matrix()
    np.testing.assert_allclose(Rotation.from_euler("xyz", rpy_of(R)).as_matrix(), R, atol=1e-14)


def test_a_folder_that_cannot_be_written(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(HandFileError, match="choose another folder"):
        export_urdf(load_hand("allegro"), tmp_path / "file")
