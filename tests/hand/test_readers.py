"""Readers of robot files: what they read, and how they refuse what is broken or hostile."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Box, Capsule, Sphere
from xdex_drake.hand.importing.drake_plant import model_from_plant
from xdex_drake.hand.importing.files import hand_from_plant, hand_name, model_digest, read_model
from xdex_drake.hand.importing.mjcf import read_mjcf
from xdex_drake.hand.importing.model import Cylinder, FileModel, TriangleMesh
from xdex_drake.hand.importing.sdformat import read_sdf
from xdex_drake.hand.importing.urdf import read_urdf
from xdex_drake.hand.kinematics import forward_kinematics, rotation_about
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.plant import add_hand

LONGEST = 5.0
"""No file may keep a reader busy for longer [s]."""


def link_poses(model: FileModel, q: dict[str, float]) -> dict[str, Array]:
    """Pose of each link in the base link, homogeneous."""
    inbound = {joint.child: joint for joint in model.joints}
    poses: dict[str, Array] = {}

    def pose(name: str) -> Array:
        if name not in poses:
            poses[name] = np.eye(4)
            if name in inbound:
                joint, X = inbound[name], np.eye(4)
                axis = joint.axis / np.linalg.norm(joint.axis)
                X[:3, :3], X[:3, 3] = joint.R_PJ, joint.p_PJ
                if joint.kind == "prismatic":
                    X[:3, 3] += joint.R_PJ @ axis * q[joint.name]
                elif joint.kind != "fixed":
                    X[:3, :3] = X[:3, :3] @ rotation_about(axis, q[joint.name])
                poses[name] = pose(joint.parent) @ X
        return poses[name]

    for link in model.links:
        pose(link.name)
    return poses


# ---- URDF

URDF = """<?xml version="1.0"?>
<robot name="tiny">
  <link name="palm">
    <inertial><origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/><mass value="0.5"/>
      <inertia ixx="1e-3" iyy="2e-3" izz="2.5e-3" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="meshes/part.stl" scale="0.001 0.001 -0.001"/></geometry></visual>
    <collision><origin xyz="0 0 1"/><geometry><box size="1 2 3"/></geometry></collision>
  </link>
  <link name="finger">
    <collision><origin xyz="0 0 0.02"/><geometry><cylinder radius="0.01" length="0.04"/></geometry></collision>
    <collision><geometry><sphere radius="0.02"/></geometry></collision>
    <visual><geometry><mesh filename="meshes/absent.dae"/></geometry></visual>
  </link>
  <link name="tip"><collision><geometry><capsule radius="0.01" length="0.02"/></geometry></collision></link>
  <joint name="a" type="revolute"><parent link="palm"/><child link="finger"/><origin xyz=" 1  2 3" rpy="0 0 0.5"/>
    <axis xyz="0 2 0"/><limit lower="-1" upper="2" effort="3" velocity="1"/></joint>
  <joint name="b" type="prismatic"><parent link="finger"/><child link="tip"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.05" effort="0" velocity="1"/><mimic joint="a" multiplier="0.5" offset="0.1"/></joint>
</robot>
"""


def write(folder: Path, text: str, name: str = "hand.urdf") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def write_mesh(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box([10.0, 20.0, 30.0]).export(path)


def test_a_urdf_file_is_read_as_it_stands(tmp_path) -> None:
    write_mesh(tmp_path / "meshes" / "part.stl")
    model = read_urdf(write(tmp_path, URDF))
    assert [link.name for link in model.links] == ["palm", "finger", "tip"]
    palm, finger, tip = model.links
    assert palm.inertia is not None
    np.testing.assert_allclose(palm.inertia.I_LLcm, np.diag([2e-3, 1e-3, 2.5e-3]), atol=1e-18)
    np.testing.assert_array_equal(palm.inertia.p_LLcm, [0.0, 0.0, 0.1])
    (mesh,), (box,) = palm.visual, palm.collision
    assert isinstance(mesh, TriangleMesh)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces)
    assert solid.volume == pytest.approx(6e-6)  # A mirroring scale still leaves the surface outwards.
    assert isinstance(box, Box)
    np.testing.assert_array_equal(box.size, [1.0, 2.0, 3.0])
    cylinder, ball = finger.collision
    assert isinstance(cylinder, Cylinder)
    np.testing.assert_allclose([cylinder.p0, cylinder.p1], [[0, 0, 0], [0, 0, 0.04]], atol=1e-15)
    assert isinstance(ball, Sphere)
    assert isinstance(tip.collision[0], Capsule)
    assert len(model.notes) == 1
    assert "absent.dae" in model.notes[0]
    a, b = model.joints
    assert (a.kind, a.lower, a.upper, a.effort, a.mimic, a.driven) == ("revolute", -1.0, 2.0, 3.0, None, None)
    np.testing.assert_array_equal(a.p_PJ, [1.0, 2.0, 3.0])
    assert b.mimic is not None
    assert (b.mimic.master, b.mimic.multiplier, b.mimic.offset) == ("a", 0.5, 0.1)


@pytest.mark.parametrize("hand", ["allegro", "inspire", "ability", "schunk_svh", "shadow"])
def test_vendor_files_are_read_with_exact_kinematics(reference, hand) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    (path,) = (reference / "hands_reference" / hand).glob("*.urdf")
    model = read_urdf(path)
    robot = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    rng = np.random.default_rng(1)
    q = {j.name: rng.uniform(j.lower, j.upper) for j in model.joints if j.kind != "fixed" and j.mimic is None}
    robot.update_cfg(q)
    for joint in model.joints:
        if joint.mimic is not None:
            q[joint.name] = joint.mimic.multiplier * q[joint.mimic.master] + joint.mimic.offset
    for name, X in link_poses(model, q).items():
        np.testing.assert_allclose(robot.get_transform(name, robot.base_link), X, atol=1e-12)


def test_meshes_of_a_package(tmp_path) -> None:
    write_mesh(tmp_path / "my_hand" / "meshes" / "part.stl")
    (tmp_path / "my_hand" / "package.xml").write_text("<package/>")
    urdf = write(tmp_path, URDF.replace("meshes/part.stl", "package://my_hand/meshes/part.stl"), "my_hand/a/b/x.urdf")
    assert len(read_urdf(urdf).links[0].visual) == 1
    # Without package.xml: beside a folder for robot files, under another name of the package.
    write_mesh(tmp_path / "other" / "meshes" / "part.stl")
    urdf = write(tmp_path, URDF.replace("meshes/part.stl", "package://my_hand/meshes/part.stl"), "other/urdf/x.urdf")
    assert len(read_urdf(urdf).links[0].visual) == 1
    urdf = write(tmp_path, URDF.replace("meshes/part.stl", "../meshes/part.stl"), "other/urdf/y.urdf")
    assert len(read_urdf(urdf).links[0].visual) == 1


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".glb", ".dae"])
def test_mesh_formats(tmp_path, suffix) -> None:
    write_mesh(tmp_path / "meshes" / f"part{suffix}")
    mesh = read_urdf(write(tmp_path, URDF.replace("part.stl", f"part{suffix}"))).links[0].visual[0]
    assert isinstance(mesh, TriangleMesh)
    np.testing.assert_allclose(np.sort(np.ptp(mesh.vertices, axis=0)), [0.01, 0.02, 0.03], rtol=1e-6)


def test_a_broken_mesh_is_a_note(tmp_path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "part.stl").write_bytes(os.urandom(300))
    model = read_urdf(write(tmp_path, URDF))
    assert model.links[0].visual == ()
    assert any("part.stl" in note for note in model.notes)


# ---- MJCF

MJCF = """<mujoco model="claw">
  <compiler angle="degree" eulerseq="XYZ" meshdir="stl"/>
  <default>
    <joint damping="0.1"/> <mesh scale="0.001 0.001 0.001"/>
    <default class="finger"><geom type="capsule" size="0.01 0.02"/><joint axis="0 1 0" range="-10 90"/>
      <default class="seen"><geom contype="0" conaffinity="0" type="mesh"/></default></default>
    <position kp="3" forcerange="-2 2"/>
  </default>
  <asset><mesh name="part" file="part.stl"/></asset>
  <include file="world.xml"/>
  <equality><joint joint1="tip" joint2="knuckle" polycoef="0.1 0.8"/></equality>
  <contact><exclude body1="palm" body2="distal"/></contact>
  <tendon><fixed name="pair"><joint joint="spread" coef="1"/><joint joint="knuckle" coef="0.5"/></fixed></tendon>
  <actuator><position joint="spread" gear="3"/><motor joint="knuckle" forcelimited="false" ctrlrange="-4 4" gear="0.5"/>
    </actuator>
</mujoco>
"""
WORLD = """<mujoco><worldbody>
  <geom type="plane" size="1 1 1"/>
  <body name="ball" pos="1 1 1"><freejoint/><geom size="0.1"/></body>
  <body name="palm" pos="0.1 0 0.2" euler="10 20 30"><freejoint/>
    <inertial pos="0 0 0.01" mass="0.4" diaginertia="1e-4 2e-4 2e-4" quat="0.7071067811865476 0 0 0.7071067811865476"/>
    <geom type="box" size="0.02 0.03 0.04" zaxis="1 0 0"/>
    <frame pos="0 0 0.05" axisangle="0 0 1 90">
      <body name="proximal" childclass="finger" pos="0.01 0 0" xyaxes="0 1 0 -1 0 0">
        <joint name="spread" axis="0 0 1" pos="0 0 -0.01" ref="5"/>
        <joint name="knuckle" pos="0.002 0 0.003"/>
        <geom/> <geom class="seen" mesh="part" pos="0 0 0.01"/>
        <body name="distal" pos="0 0 0.05" quat="2 0 0 2">
          <joint name="tip"/> <geom fromto="0 0 0 0 0 0.03" size="0.008"/>
          <geom type="ellipsoid" size="0.01 0.02 0.03"/><geom type="cylinder" size="0.01 0.02" zaxis="0 1 0"/>
          <body name="nail" pos="0 0.01 0.03"><joint name="slider" type="slide" axis="1 1 0" range="0 0.01"/>
            <geom type="sphere" size="0.004"/></body>
        </body>
      </body>
    </frame>
  </body>
</worldbody></mujoco>
"""


def write_mjcf(folder: Path) -> Path:
    write_mesh(folder / "stl" / "part.stl")
    write(folder, WORLD, "world.xml")
    return write(folder, MJCF, "claw.xml")


def test_an_mjcf_file_is_read(tmp_path) -> None:
    model = read_mjcf(write_mjcf(tmp_path))
    links = {link.name: link for link in model.links}
    joints = {joint.name: joint for joint in model.joints}
    assert list(links) == ["palm", "proximal_after_spread", "proximal", "distal", "nail"]
    assert len(links["proximal"].collision) == 1
    mesh = links["proximal"].visual[0]
    assert isinstance(mesh, TriangleMesh)
    np.testing.assert_allclose(mesh.vertices.mean(axis=0), [-0.002, 0.0, 0.007], atol=1e-12)
    np.testing.assert_allclose([joints["tip"].lower, joints["tip"].upper], np.deg2rad([-10.0, 90.0]))
    assert joints["tip"].mimic is not None
    assert joints["tip"].mimic.master == "knuckle"
    assert (joints["tip"].mimic.multiplier, joints["tip"].mimic.offset) == pytest.approx((0.8, 0.1))
    assert (joints["spread"].effort, joints["knuckle"].effort, joints["slider"].effort) == (6.0, 2.0, None)
    assert (joints["spread"].driven, joints["knuckle"].driven, joints["tip"].driven) == (True, True, False)
    assert model.ignored_pairs == (("palm", "distal"),)
    assert joints["slider"].kind == "prismatic"
    told = " ".join(model.notes)
    assert "tendon 'pair'" in told
    assert "no joint ties" in told


def test_loops_are_points_that_coincide(tmp_path) -> None:
    bodies = "".join(
        f"<body name='{n}' pos='{x} 0 0'><joint name='j{n}' pos='0 0 0.01'/><geom size='0.01'/></body>"
        for n, x in (("a", 0.1), ("b", -0.1))
    )
    loop = "<equality><{} body1='a' body2='b' {}/></equality>"
    robot = f"<mujoco><worldbody><body name='base'>{bodies}</body></worldbody>"
    path = write(tmp_path, robot + loop.format("connect", "anchor='0 0 0.1'") + "</mujoco>", "loop.xml")
    (found,) = read_mjcf(path).loops
    assert found.links == ("a", "b")
    np.testing.assert_allclose(found.points, [[0.0, 0.0, 0.09], [0.2, 0.0, 0.09]], atol=1e-15)
    path = write(tmp_path, robot + loop.format("weld", "") + "</mujoco>", "loop.xml")
    assert len(read_mjcf(path).loops) == 3


def test_mujoco_agrees_with_the_reader(tmp_path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
    path = write_mjcf(tmp_path)
    model = read_mjcf(path)
    mj = mujoco.MjModel.from_xml_path(str(path))
    data, rng = mujoco.MjData(mj), np.random.default_rng(2)
    for _ in range(4):
        q = {joint.name: rng.uniform(-0.1, 1.0) for joint in model.joints}
        for name, value in q.items():
            data.qpos[mj.jnt_qposadr[mj.joint(name).id]] = value
        mujoco.mj_kinematics(mj, data)
        poses = link_poses(model, q)
        palm = mj.body("palm").id
        X_WP = np.eye(4)
        X_WP[:3, :3], X_WP[:3, 3] = data.xmat[palm].reshape(3, 3), data.xpos[palm]
        for joint in model.joints:
            X, k = X_WP @ poses[joint.child], mj.joint(joint.name).id
            if joint.kind != "prismatic":
                np.testing.assert_allclose(X[:3, 3], data.xanchor[k], atol=1e-12)
            np.testing.assert_allclose(X[:3, :3] @ joint.axis, data.xaxis[k], atol=1e-12)
        for link in model.links:
            if not link.collision:
                continue
            X, body = X_WP @ poses[link.name], mj.body(link.name).id
            first = mj.body_geomadr[body]
            for k, shape in enumerate(link.collision):
                center, direction = _center_and_axis(shape)
                np.testing.assert_allclose(X[:3, :3] @ center + X[:3, 3], data.geom_xpos[first + k], atol=1e-9)
                z = data.geom_xmat[first + k].reshape(3, 3)[:, 2]
                if direction is not None:
                    assert abs(X[:3, :3] @ direction @ z) == pytest.approx(1.0, abs=1e-12)


def _center_and_axis(shape: object) -> tuple[Array, Array | None]:
    if isinstance(shape, Sphere):
        return shape.center, None
    if isinstance(shape, Box):
        return shape.p_LG, shape.R_LG[:, 2]
    if isinstance(shape, Capsule | Cylinder):
        d = shape.p1 - shape.p0
        return 0.5 * (shape.p0 + shape.p1), d / np.linalg.norm(d)
    assert isinstance(shape, TriangleMesh)
    return shape.vertices.mean(axis=0), None


def test_arm_joints_at_the_root_hang_on_the_world(tmp_path) -> None:
    path = write(
        tmp_path, '<mujoco><worldbody><body name="a"><joint name="j"/><geom size="1"/></body></worldbody></mujoco>'
    )
    model = read_mjcf(path.rename(tmp_path / "a.xml"))
    assert [link.name for link in model.links] == ["world", "a"]
    assert model.joints[0].kind == "continuous"


# ---- SDFormat and Drake plants

SDF = """<?xml version="1.0"?>
<sdf version="1.9"><model name="pincer">
  <link name="palm"><collision name="c"><geometry><mesh><uri>part.stl</uri><scale>0.001 0.001 0.001</scale></mesh>
    </geometry></collision></link>
  <link name="jaw"><pose relative_to="hinge"/>
    <visual name="v"><geometry><sphere><radius>0.01</radius></sphere></geometry></visual><visual name="w"><geometry><mesh><uri>model://pincer/absent.dae</uri></mesh></geometry></visual></link>
  <joint name="hinge" type="revolute"><parent>palm</parent><child>jaw</child>
    <pose relative_to="palm">0 0 0.1 0 0 0.5</pose>
    <axis><xyz>0 1 0</xyz><limit><lower>-0.5</lower><upper>1</upper><effort>2</effort></limit></axis></joint>
</model></sdf>
"""


def test_an_sdformat_file_is_read(tmp_path) -> None:
    write_mesh(tmp_path / "part.stl")
    model = read_sdf(write(tmp_path, SDF, "hand.sdf"))
    (joint,) = model.joints
    assert (joint.kind, joint.lower, joint.upper) == ("revolute", -0.5, 1.0)
    np.testing.assert_allclose(joint.p_PJ, [0.0, 0.0, 0.1], atol=1e-15)
    mesh = model.links[0].collision[0]
    assert isinstance(mesh, TriangleMesh)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.01, 0.02, 0.03], rtol=1e-6)
    assert mesh.source == "part.stl"
    assert len(model.links[1].visual) == 1
    assert any("absent.dae" in note for note in model.notes)


def test_coupled_joints_of_an_sdformat_file(tmp_path) -> None:
    more = """<link name="tip"><pose relative_to="bend"/></link>
      <joint name="bend" type="revolute"><parent>jaw</parent><child>tip</child>
      <pose relative_to="jaw">0 0 0.1 0 0 0</pose>
      <axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>1</upper></limit>
      <mimic joint="hinge"><multiplier>0.5</multiplier>
      <offset>0.3</offset><reference>0.2</reference></mimic></axis></joint></model>"""
    write_mesh(tmp_path / "part.stl")
    model = read_sdf(write(tmp_path, SDF.replace("</model>", more).replace("1.9", "1.11"), "hand.sdf"))
    law = model.joints[1].mimic
    assert law is not None
    assert (law.master, law.multiplier, law.offset) == ("hinge", 0.5, pytest.approx(0.2))


@pytest.mark.parametrize("name", ["ability", "shadow"])
@pytest.mark.parametrize("finalized", [True, False])
def test_a_hand_in_a_plant_is_read_back(name, finalized) -> None:
    hand = load_hand(name)
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    instance = add_hand(plant, hand)
    if finalized:
        plant.Finalize()
    model = model_from_plant(plant, instance, scene_graph=scene_graph if finalized else None)
    rng = np.random.default_rng(4)
    for q in (hand.q_rest, rng.uniform(*hand.limits)):
        R, p = forward_kinematics(hand, RigidTransform(), q)
        X_HB = np.eye(4)
        X_HB[:3, :3], X_HB[:3, 3] = R[0], p[0]
        values = dict(zip((j.name for j in hand.joints), hand.q_full(q), strict=True))
        poses = link_poses(model, values)
        for k, link in enumerate(hand.links):
            X = X_HB @ poses[link.name]
            np.testing.assert_allclose(X[:3, 3], p[k], atol=1e-12)
            np.testing.assert_allclose(X[:3, :3], R[k], atol=1e-12)
    for joint, read in zip(hand.joints, model.joints, strict=True):
        assert (read.name, read.lower, read.upper) == (joint.name, joint.lower, joint.upper)
        assert read.driven == (joint.coupling is None)
        if joint.coupling is None:
            assert read.effort == joint.effort
        elif finalized:
            assert read.mimic is not None
            assert read.mimic.master == joint.coupling.master
            assert (read.mimic.multiplier, read.mimic.offset) == (joint.coupling.multiplier, joint.coupling.offset)
    for link, read in zip(hand.links, model.links, strict=True):
        assert len(read.collision) == len(link.geometry)
        assert read.inertia is not None
        np.testing.assert_allclose(read.inertia.I_LLcm, link.I_LLcm, atol=1e-12)


def test_a_plant_gives_a_hand() -> None:
    hand = load_hand("allegro")
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    instance = add_hand(plant, hand)
    plant.Finalize()
    imported = hand_from_plant(plant, instance, scene_graph=scene_graph).hand
    assert imported.joint_names == hand.joint_names
    assert {finger.name for finger in imported.fingers} == {finger.name for finger in hand.fingers}
    bare = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)[0]
    with pytest.raises(HandFileError, match="no bodies"):
        hand_from_plant(bare, bare.AddModelInstance("nothing"))


def test_the_digest_is_that_of_all_that_is_read(tmp_path) -> None:
    write_mesh(tmp_path / "meshes" / "part.stl")
    path = write(tmp_path, URDF)
    first = model_digest(read_model(path))
    assert model_digest(read_model(path)) == first
    trimesh.creation.box([10.0, 20.0, 31.0]).export(tmp_path / "meshes" / "part.stl")
    assert model_digest(read_model(path)) != first
    assert hand_name(read_model(path)) == "tiny"  # "hand" says nothing.
    assert hand_name(read_model(path.rename(tmp_path / "My Hand-2.urdf"))) == "my_hand_2"


# ---- broken and hostile files

LINK = '<link name="{}"/>'
JOINT = '<joint name="{0}" type="fixed"><parent link="{1}"/><child link="{2}"/></joint>'


def robot(inner: str) -> str:
    return f'<robot name="r">{inner}</robot>'


def chain(count: int) -> str:
    links = "".join(LINK.format(f"l{k}") for k in range(count))
    return robot(links + "".join(JOINT.format(f"j{k}", f"l{k}", f"l{k + 1}") for k in range(count - 1)))


def moving(kind: str = "revolute", inner: str = '<limit lower="0" upper="1" effort="1" velocity="1"/>') -> str:
    joint = f'<joint name="j" type="{kind}"><parent link="a"/><child link="b"/>{inner}</joint>'
    return robot(LINK.format("a") + LINK.format("b") + joint)


def meshed(name: str) -> str:
    return robot(f'<link name="a"><visual><geometry><mesh filename="{name}"/></geometry></visual></link>')


BOMB = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa">{}]>'.format(
    "".join(f'<!ENTITY {x} "{f"&{y};" * 10}">' for x, y in zip("bcdefghij", "abcdefghi", strict=True))
)

URDF_CASES: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", "is empty"),
    "blank": ("  \n\t\n", "is empty"),
    "binary": (bytes(range(256)) * 20, "not valid XML"),
    "half a file": (URDF[:700], "not valid XML"),
    "wrong root": ("<html><body/></html>", "root element is <html>"),
    "billion laughs": (BOMB + robot("&j;"), "document type"),
    "external entity": ('<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>' + robot("&x;"), "document type"),
    "external subset": ('<!DOCTYPE r SYSTEM "http://example.org/x.dtd">' + robot(LINK), "document type"),
    "deep nesting": ("<robot>" + "<a>" * 5000 + "</a>" * 5000 + "</robot>", "nested deeper"),
    "many elements": ("<robot>" + "<a/>" * 300_000 + "</robot>", "more than 200000 elements"),
    "10,000 links": (chain(10_000), "10000 links, more than 500"),
    "no links": (robot(""), "has no links"),
    "unnamed link": (robot("<link/>"), "no attribute 'name'"),
    "two links of one name": (robot(LINK.format("a") * 2), "two links named 'a'"),
    "two joints of one name": (
        robot("".join(map(LINK.format, "abc")) + JOINT.format("j", "a", "b") + JOINT.format("j", "a", "c")),
        "two joints named 'j'",
    ),
    "circle": (
        robot("".join(map(LINK.format, "abc")) + JOINT.format(1, "a", "b") + JOINT.format(2, "b", "a")),
        "form a circle",
    ),
    "own parent": (robot(LINK.format("a") + JOINT.format(1, "a", "a")), "form a circle"),
    "two parents": (
        robot("".join(map(LINK.format, "abc")) + JOINT.format(1, "a", "c") + JOINT.format(2, "b", "c")),
        "child of several",
    ),
    "two trees": (
        robot("".join(map(LINK.format, "abcd")) + JOINT.format(1, "a", "b") + JOINT.format(2, "c", "d")),
        "2 base links",
    ),
    "joint to nothing": (robot(LINK.format("a") + JOINT.format(1, "a", "z")), "child 'z', which is no link"),
    "joint without child": (
        robot(LINK.format("a") + '<joint name="j" type="fixed"><parent link="a"/></joint>'),
        "child",
    ),
    "unknown joint type": (moving("ball"), "type 'ball'"),
    "NaN limit": (moving(inner='<limit lower="nan" upper="1" effort="1"/>'), "finite number"),
    "infinite origin": (moving(inner='<origin xyz="inf 0 0"/>'), "finite number"),
    "huge origin": (moving(inner='<origin xyz="1e300 0 0"/>'), "finite number"),
    "words for numbers": (moving(inner='<origin xyz="one two three"/>'), "write a number"),
    "two numbers": (moving(inner='<origin xyz="1 2"/>'), "give 3"),
    "axis of zero": (moving(inner='<axis xyz="0 0 0"/>'), "is zero"),
    "mimic of nothing": (moving(inner='<mimic joint="k"/>'), "no moving joint"),
    "mimic of itself": (moving(inner='<mimic joint="j"/>'), "in a circle"),
    "negative radius": (
        robot('<link name="a"><visual><geometry><sphere radius="-1"/></geometry></visual></link>'),
        "greater than zero",
    ),
    "unknown shape": (
        robot('<link name="a"><visual><geometry><torus radius="1"/></geometry></visual></link>'),
        "no shape that is known",
    ),
    "xacro": (robot('<xacro:macro name="m"/>'), "expand it first"),
    "xacro value": (moving(inner='<limit lower="${low}" upper="1"/>'), "expand it first"),
    "mesh above": (meshed("../../secret.stl"), "outside the hand's folder"),
    "absolute mesh": (meshed("/etc/passwd"), "outside the hand's folder"),
    "file address": (meshed("file:///etc/passwd"), "outside the hand's folder"),
    "package that climbs": (meshed("package://x/../../../etc/passwd"), "outside the hand's folder"),
    "package of another name that climbs": (meshed("package://../secret.stl"), "outside the hand's folder"),
    "mesh on another machine": (meshed("http://example.org/a.stl"), "save that file beside"),
    "unknown encoding": ('<?xml version="1.0" encoding="klingon"?><robot/>', "XML"),
}

MJCF_HEAD = '<mujoco><worldbody><body name="a"><body name="b">'
MJCF_TAIL = "</body></body></worldbody></mujoco>"
MJCF_JOINT = '<joint name="j"/>'

MJCF_CASES: dict[str, tuple[str | bytes, str]] = {
    "no joints": ("<mujoco><worldbody><body/></worldbody></mujoco>", "no joints"),
    "no bodies": ("<mujoco/>", "no bodies"),
    "include above": ('<mujoco><include file="../secret.xml"/></mujoco>', "outside the hand's folder"),
    "absolute include": ('<mujoco><include file="/etc/passwd"/></mujoco>', "outside the hand's folder"),
    "missing include": ('<mujoco><include file="absent.xml"/></mujoco>', "does not exist"),
    "include of itself": ('<mujoco><include file="hand.xml"/></mujoco>', "in a circle"),
    "ball joint": (MJCF_HEAD + '<joint name="j" type="ball"/>' + MJCF_TAIL, "type 'ball'"),
    "unknown class": (MJCF_HEAD + '<joint name="j" class="none"/>' + MJCF_TAIL, "class 'none'"),
    "NaN range": (MJCF_HEAD + '<joint name="j" range="nan 1"/>' + MJCF_TAIL, "finite number"),
    "quaternion of zero": (MJCF_HEAD + '<joint name="j"/><geom quat="0 0 0 0" size="1"/>' + MJCF_TAIL, "quaternion"),
    "mesh above": (
        '<mujoco><asset><mesh name="m" file="../../secret.stl"/></asset>'
        + MJCF_HEAD.removeprefix("<mujoco>")
        + '<joint name="j"/><geom type="mesh" mesh="m"/>'
        + MJCF_TAIL,
        "outside the hand's folder",
    ),
    "folder above": (
        '<mujoco><compiler meshdir="/etc"/><asset><mesh name="m" file="passwd"/></asset>'
        + MJCF_HEAD.removeprefix("<mujoco>")
        + '<joint name="j"/><geom type="mesh" mesh="m"/>'
        + MJCF_TAIL,
        "outside the hand's folder",
    ),
    "coupling to nothing": (
        MJCF_HEAD
        + MJCF_JOINT
        + "</body></body></worldbody><equality><joint joint1='j' joint2='k'/></equality></mujoco>",
        "'k', which does not exist",
    ),
    "actuator of nothing": (
        MJCF_HEAD + MJCF_JOINT + "</body></body></worldbody><actuator><motor joint='k'/></actuator></mujoco>",
        "'k', which does not exist",
    ),
    "attached models": (MJCF_HEAD + MJCF_JOINT + '<attach model="x"/>' + MJCF_TAIL, "<attach>"),
    "10,000 bodies": (MJCF_HEAD + MJCF_JOINT + "<body/>" * 10_000 + MJCF_TAIL, "more than 500"),
    "bodies in bodies": (MJCF_HEAD + MJCF_JOINT + "<body>" * 300 + "</body>" * 300 + MJCF_TAIL, "nested deeper"),
    "entities": (BOMB + "<mujoco>&j;</mujoco>", "document type"),
    "wrong root": ("<svg/>", "root element is <svg>"),
}


def sdf(inner: str) -> str:
    links = '<link name="a"/><link name="b"/>'
    return f'<sdf version="1.9"><model name="m">{links}{inner}</model></sdf>'


def sdf_joint(kind: str, limit: str) -> str:
    return sdf(
        f'<joint name="j" type="{kind}"><parent>a</parent><child>b</child><axis><xyz>0 0 1</xyz><limit>{limit}</limit>'
        "</axis></joint>"
    )


def sdf_mesh(uri: str) -> str:
    return sdf("").replace(
        '<link name="a"/>',
        f'<link name="a"><visual name="v"><geometry><mesh><uri>{uri}</uri></mesh></geometry></visual></link>',
    )


SDF_CASES: dict[str, tuple[str | bytes, str]] = {
    "limits out of order": (sdf_joint("revolute", "<lower>1</lower><upper>0</upper>"), "exchange them"),
    "NaN limit": (sdf_joint("revolute", "<lower>nan</lower><upper>1</upper>"), "finite number"),
    "include": (sdf("<include><uri>model://other</uri></include>"), "<include>"),
    "mesh above": (sdf_mesh("../../secret.stl"), "outside the hand's folder"),
    "absolute mesh": (sdf_mesh("file:///etc/passwd"), "outside the hand's folder"),
    "ball joint": (sdf('<joint name="j" type="ball"><parent>a</parent><child>b</child></joint>'), "only revolute"),
    "no link": ('<sdf version="1.9"><model name="m"/></sdf>', "no links"),
    "two models": (
        '<sdf version="1.9"><world name="w"><model name="m"><link name="a"/></model><model name="n"><link name="b"/>'
        "</model></world></sdf>",
        "2 models",
    ),
    "joint to nothing": (sdf('<joint name="j" type="fixed"><parent>a</parent><child>z</child></joint>'), "parser"),
    "entities": (BOMB + "<sdf>&j;</sdf>", "document type"),
}


def refusal(read: Callable[[Path], object], path: Path) -> str:
    """The message of the one error, which comes soon and tells the file."""
    start = time.perf_counter()
    with pytest.raises(HandFileError) as caught:
        read(path)
    assert time.perf_counter() - start < LONGEST
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    assert ";" in message  # What to do about it.
    return message


def hostile(tmp_path: Path, name: str, content: str | bytes) -> Path:
    (tmp_path / "secret.stl").write_bytes(b"solid secret")
    (tmp_path / "secret.xml").write_text(WORLD)
    path = tmp_path / "in" / "here" / name
    path.parent.mkdir(parents=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("case", URDF_CASES)
def test_refused_urdf_files(tmp_path, case) -> None:
    content, told = URDF_CASES[case]
    assert told in refusal(read_model, hostile(tmp_path, "hand.urdf", content))


@pytest.mark.parametrize("case", MJCF_CASES)
def test_refused_mjcf_files(tmp_path, case) -> None:
    content, told = MJCF_CASES[case]
    assert told in refusal(read_model, hostile(tmp_path, "hand.xml", content))


@pytest.mark.parametrize("case", SDF_CASES)
def test_refused_sdformat_files(tmp_path, case) -> None:
    content, told = SDF_CASES[case]
    assert told in refusal(read_model, hostile(tmp_path, "hand.sdf", content))


def test_a_link_of_the_file_system_does_not_lead_out(tmp_path) -> None:
    write_mesh(tmp_path / "secret" / "part.stl")
    path = write(tmp_path, meshed("part.stl"), "hand/hand.urdf")
    (path.parent / "part.stl").symlink_to(tmp_path / "secret" / "part.stl")
    assert "outside the hand's folder" in refusal(read_urdf, path)
    (path.parent / "part.stl").unlink()
    (path.parent / "part.stl").symlink_to("part.stl")  # To itself.
    assert read_urdf(path).links[0].visual == ()


def test_a_mesh_does_not_lead_out_either(tmp_path) -> None:
    (tmp_path / "secret.bin").write_bytes(bytes(100))
    gltf = '{"asset": {"version": "2.0"}, "buffers": [{"uri": "../secret.bin", "byteLength": 100}], "bufferViews": []}'
    write(tmp_path, gltf, "hand/part.gltf")
    model = read_urdf(write(tmp_path, meshed("part.gltf"), "hand/hand.urdf"))
    assert model.links[0].visual == ()
    assert "part.gltf" in model.notes[0]


def test_entities_in_a_mesh(tmp_path) -> None:
    write(tmp_path, BOMB + "<COLLADA>&j;</COLLADA>", "part.dae")
    model = read_urdf(write(tmp_path, meshed("part.dae")))
    assert "document type" in model.notes[0]


def test_files_that_are_too_large(tmp_path) -> None:
    path = tmp_path / "hand.urdf"
    with path.open("wb") as stream:  # Takes no room on the disk.
        stream.truncate(10**9)
    assert "1000000000 bytes" in refusal(read_model, path)
    with (tmp_path / "part.stl").open("wb") as stream:
        stream.truncate(10**9)
    path.write_text(meshed("part.stl"))
    assert "more than 200000000 bytes" in refusal(read_model, path)


def test_files_that_are_none(tmp_path) -> None:
    assert "no such file" in refusal(read_model, tmp_path / "absent.urdf")
    (tmp_path / "folder.urdf").mkdir()
    assert "is a folder" in refusal(read_model, tmp_path / "folder.urdf")
    assert "expand it first" in refusal(read_model, tmp_path / "hand.urdf.xacro")
    assert "unknown type" in refusal(read_model, tmp_path / "hand.step")
