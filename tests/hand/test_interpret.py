"""Hands found in robot files: made up ones, files that make no sense, and the vendors' own."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Box, Capsule, Convex, Hand, Sphere
from xdex_drake.hand.importing.interpret import Imported, interpret
from xdex_drake.hand.importing.model import (
    Cylinder,
    FileGeometry,
    FileInertia,
    FileJoint,
    FileLink,
    FileMimic,
    FileModel,
    TriangleMesh,
)
from xdex_drake.hand.importing.urdf import read_urdf
from xdex_drake.hand.kinematics import Configuration, forward_kinematics, rotation_about
from xdex_drake.hand.plant import add_hand

VENDORS = ("ability", "allegro", "inspire", "schunk_svh", "shadow")
X, Y, Z = np.eye(3)


# ---- robots made up for the tests


def joint(kind: str, parent: str, child: str, at: tuple = (0, 0, 0), axis: Array = Y, **more) -> FileJoint:
    """A joint named after its child; turns from 0 to 1.6 rad where nothing else is said."""
    defaults = {"lower": 0.0, "upper": 1.6, "effort": 1.0} if kind != "fixed" else {}
    p, R = np.array(at, dtype=float), more.pop("R", np.eye(3))
    name = more.pop("name", f"to_{child}")
    return FileJoint(name, kind, parent, child, p, R, np.asarray(axis, dtype=float), **{**defaults, **more})


def bone(name: str, length: float, radius: float = 0.008, axis: Array = Z) -> FileLink:
    return FileLink(name, (), (Capsule(np.zeros(3), (length - radius) * axis, radius),))


def model(links: list[FileLink], joints: list[FileJoint], name: str = "robot") -> FileModel:
    return FileModel(name, f"{name}.urdf", tuple(links), tuple(joints))


def gripper() -> FileModel:
    """Two jaws that slide along y and close at zero, one coupled to the other."""
    jaw = Box(np.array([0.02, 0.01, 0.05]), np.array([0.0, 0.005, 0.025]))
    other = replace(jaw, p_LG=np.array([0.0, -0.005, 0.025]))
    palm = Box(np.array([0.06, 0.16, 0.06]), np.array([0.0, 0.0, 0.03]))
    return model(
        [FileLink("base", (), (palm,)), FileLink("jaw_a", (), (jaw,)), FileLink("jaw_b", (), (other,))],
        [
            joint("prismatic", "base", "jaw_a", (0, 0, 0.06), Y, upper=0.04, effort=70.0),
            joint("prismatic", "base", "jaw_b", (0, 0, 0.06), -Y, upper=0.04, mimic=FileMimic("to_jaw_a", 1.0, 0.0)),
        ],
    )


def claw() -> FileModel:
    """Two fingers on one side, one on the other, all bending inwards from upright."""
    links = [FileLink("base", (), (Cylinder(np.zeros(3), 0.06 * Z, 0.05),))]
    joints = []
    for name, x, y, axis in (("a", -0.04, 0.03, Y), ("b", -0.04, -0.03, Y), ("c", 0.04, 0.0, -Y)):
        links += [bone(f"{name}1", 0.05), bone(f"{name}2", 0.04)]
        joints += [
            joint("revolute", "base", f"{name}1", (x, y, 0.06), axis),
            joint("revolute", f"{name}1", f"{name}2", (0, 0, 0.05), axis),
        ]
    return model(links, joints)


def five_fingers(side: str = "right", *, named: bool = False, R_base: Array | None = None) -> FileModel:
    """A hand whose palm lies in the y-z plane of its base, thumb on the index finger's side; axes as makers have them.

    Args:
        side: The side; a left hand is the mirror image in y.
        named: Whether links bear the names of fingers.
        R_base: Rotation of the whole hand in its root link.
    """
    m = 1.0 if side == "right" else -1.0
    palm = Box(np.array([0.03, 0.09, 0.1]), np.array([-0.01, 0.0, 0.05]))
    links, joints = [FileLink("root"), FileLink("palm", (), (palm,))], []
    joints.append(joint("fixed", "root", "palm", R=np.eye(3) if R_base is None else R_base))
    names = ("index", "middle", "ring", "little") if named else ("f4", "f3", "f2", "f1")
    for name, y in zip(names, (0.033, 0.011, -0.011, -0.033), strict=True):
        links += [bone(f"{name}_1", 0.045), bone(f"{name}_2", 0.03), bone(f"{name}_3", 0.025), FileLink(f"{name}_tip")]
        joints += [
            joint("revolute", "palm", f"{name}_1", (0, m * y, 0.1), Y, lower=-0.2),
            joint("revolute", f"{name}_1", f"{name}_2", (0, 0, 0.045), Y),
            joint("revolute", f"{name}_2", f"{name}_3", (0, 0, 0.03), Y),
            joint("fixed", f"{name}_3", f"{name}_tip", (0, 0, 0.024)),
        ]
    thumb = "thumb" if named else "f0"
    out = np.column_stack([m * Z, X, m * Y])  # Sideways, across the palm; the thumb's z points away from the hand.
    links += [bone(f"{thumb}_{k}", length) for k, length in ((1, 0.02), (2, 0.04), (3, 0.03))]
    joints += [
        joint("revolute", "palm", f"{thumb}_1", (0.0, m * 0.035, 0.03), -X, R=out, lower=-0.3, upper=1.6),
        joint("revolute", f"{thumb}_1", f"{thumb}_2", (0, 0, 0.02), m * Y, R=rotation_about(Z, m * 0.6), upper=1.2),
        joint("revolute", f"{thumb}_2", f"{thumb}_3", (0, 0, 0.04), m * Y, upper=1.4),
    ]
    return model(links, joints)


def on_forearm(hand: FileModel) -> FileModel:
    """A hand on a wrist of two joints, behind a forearm fixed to the world."""
    arm = [FileLink("world"), bone("forearm", 0.2, 0.04), bone("wrist", 0.03, 0.02)]
    joints = [
        joint("fixed", "world", "forearm"),
        joint("revolute", "forearm", "wrist", (0, 0, 0.2), Y, lower=-0.5, upper=0.5),
        joint("revolute", "wrist", "root", (0, 0, 0.03), X, lower=-0.5, upper=0.5),
    ]
    return replace(hand, links=(*arm, *hand.links), joints=(*joints, *hand.joints))


def tips_and_pads(hand: Hand, q: Array) -> tuple[dict[str, Array], dict[str, Array]]:
    """Tip points and pad directions in H."""
    cfg = Configuration.at(hand, RigidTransform(), q)
    tips, pads = {}, {}
    for finger in hand.fingers:
        k = np.array([hand.link_index[finger.tip_link]])
        tips[finger.name] = cfg.points(k, finger.p_LTip[None])[0]
        pads[finger.name] = cfg.vectors(k, finger.n_LPad[None])[0]
    return tips, pads


def said(imported: Imported, word: str) -> list[str]:
    return [str(decision) for decision in imported.decisions if word in str(decision)]


# ---- what is found


def test_gripper() -> None:
    hand = interpret(gripper(), name="gripper").hand
    assert [finger.name for finger in hand.fingers] == ["thumb", "index"]
    assert hand.joint_names == ("to_jaw_a",)
    tips, pads = tips_and_pads(hand, hand.q_rest)
    across = tips["thumb"] - tips["index"]
    assert hand.q_rest == pytest.approx([0.02])  # half open
    assert pads["index"] == pytest.approx([1.0, 0.0, 0.0])  # the index finger closes out of the palm
    assert pads["thumb"] == pytest.approx([-1.0, 0.0, 0.0])
    assert across[0] > 0.03
    assert tips["index"][2] == pytest.approx(0.11, abs=2e-3)
    assert hand.joints[0].effort == 70.0


def test_claw_of_three() -> None:
    hand = interpret(claw(), name="claw").hand
    assert {f.name: f.links[0] for f in hand.fingers} == {"thumb": "c1", "index": "a1", "middle": "b1"}
    assert pytest.approx(np.eye(3), abs=1e-9) == hand.R_HB
    tips, pads = tips_and_pads(hand, hand.q_rest)
    for name in ("index", "middle"):
        assert pads[name] @ (tips["thumb"] - tips[name]) > 0.0
        assert pads["thumb"] @ (tips[name] - tips["thumb"]) > 0.0


def test_of_equal_fingers_the_first_is_the_thumb() -> None:
    links = [FileLink("plate", (), (Box(np.array([0.1, 0.1, 0.03]), np.zeros(3)),))]
    joints = []
    for k, turn in enumerate(np.deg2rad([0.0, 120.0, 240.0])):
        R, at = rotation_about(Z, turn), (0.045 * np.cos(turn), 0.045 * np.sin(turn), 0.02)
        links += [bone(f"f{k}a", 0.06), bone(f"f{k}b", 0.05)]
        joints += [joint("revolute", "plate", f"f{k}a", at, -Y, R=R, lower=-0.6, upper=1.2)]
        joints += [joint("revolute", f"f{k}a", f"f{k}b", (0, 0, 0.062), -Y, lower=-0.3, upper=1.4)]
    imported = interpret(model(links, joints), name="three")
    assert imported.hand.fingers[0].name == "thumb"
    assert imported.hand.fingers[0].links == ("f0a", "f0b")
    assert said(imported, "comes first in the file")


def test_contacts_that_need_not_count_are_told() -> None:
    told = replace(five_fingers(), ignored_pairs=(("f2_3", "f0_3"), ("root", "f1_1"), ("f2_tip", "f0_3")))
    imported = interpret(told, name="hand")
    assert imported.hand.ignored_contacts[:2] == (("f2_3", "f0_3"), ("root", "f1_1"))  # tips are one with their links
    assert said(imported, "rules out contact between f2_3 and f0_3, root and f1_1")
    # A second link that turns inside of the palm.
    base = gripper()
    links = [bone("inner", 0.02), bone("outer", 0.05)]
    more = [
        joint("revolute", "base", "inner", (0.02, 0.0, 0.0), Y, lower=-0.5),
        joint("revolute", "inner", "outer", (0, 0, 0.01), Y, lower=-0.5),
    ]
    nested = interpret(replace(base, links=(*base.links, *links), joints=(*base.joints, *more)), name="nested")
    assert nested.hand.ignored_contacts == (("base", "outer"),)
    assert said(nested, "overlap at the zero posture")


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("side", ["right", "left"])
def test_five_fingers(side: str, named: bool) -> None:
    imported = interpret(five_fingers(side, named=named), name="hand")
    hand = imported.hand
    assert hand.side == side
    assert [finger.name for finger in hand.fingers] == ["thumb", "index", "middle", "ring", "little"]
    roots = {"thumb": "f0_1", "index": "f4_1", "middle": "f3_1", "ring": "f2_1", "little": "f1_1"}
    if not named:
        assert {finger.name: finger.links[0] for finger in hand.fingers} == roots
    assert pytest.approx(np.eye(3), abs=1e-6) == hand.R_HB
    assert hand.fingers[1].p_LTip == pytest.approx([0.0, 0.0, 0.024])  # the file's tip frame
    assert hand.fingers[0].p_LTip == pytest.approx([0.0, 0.0, 0.03], abs=2e-3)  # the end of the shape
    for finger in hand.fingers[1:]:
        assert finger.n_LPad == pytest.approx(X, abs=1e-9)
    tips, pads = tips_and_pads(hand, hand.q_rest)
    across = tips["index"] - tips["thumb"]
    assert 0.02 < np.linalg.norm(across) < 0.09
    assert pads["thumb"] @ across > 0.3 * np.linalg.norm(across)
    assert tips["index"][1] * (1.0 if side == "right" else -1.0) > 0.0


def test_the_wrist_frame_does_not_depend_on_the_files_axes() -> None:
    R = RotationMatrix(rotation_about(np.array([0.6, 0.0, 0.8]), 1.1)).matrix()
    straight = interpret(five_fingers(), name="hand").hand
    turned = interpret(five_fingers(R_base=R), name="hand").hand
    assert pytest.approx(straight.R_HB @ R.T, abs=1e-6) == turned.R_HB
    assert turned.p_HB == pytest.approx(straight.p_HB, abs=1e-6)


def test_forearm_and_wrist_are_left_out() -> None:
    alone = interpret(five_fingers(), name="hand").hand
    imported = interpret(on_forearm(five_fingers()), name="hand")
    assert imported.hand.joint_names == alone.joint_names
    assert imported.hand.links[0].name == "root"
    assert pytest.approx(alone.R_HB, abs=1e-9) == imported.hand.R_HB
    assert imported.hand.p_HB == pytest.approx([0.0, 0.0, 0.0])  # at the last wrist joint
    assert said(imported, "left out are world, forearm, wrist behind it")


def test_the_palm_can_be_said() -> None:
    hand = interpret(on_forearm(five_fingers()), name="hand", palm="palm").hand
    assert hand.links[0].name == "root"  # the link that the palm is fixed to
    with pytest.raises(HandFileError, match="palm 'pulm' is no link"):
        interpret(five_fingers(), name="hand", palm="pulm")


def test_an_arm_without_a_hand_is_refused() -> None:
    links = [bone(f"l{k}", 0.2, 0.04) for k in range(7)]
    joints = [joint("revolute", f"l{k}", f"l{k + 1}", (0, 0, 0.2)) for k in range(6)]
    with pytest.raises(HandFileError, match="without a branch"):
        interpret(model(links, joints), name="arm")


def test_two_hands_are_refused() -> None:
    left, right = five_fingers("left"), five_fingers()

    def renamed(hand: FileModel, word: str) -> tuple[list[FileLink], list[FileJoint]]:
        links = [replace(k, name=f"{word}{k.name}") for k in hand.links]
        joints = [
            replace(j, name=f"{word}{j.name}", parent=f"{word}{j.parent}", child=f"{word}{j.child}")
            for j in hand.joints
        ]
        return links, joints

    links, joints = [FileLink("torso")], []
    for word, hand, y in (("l", left, 0.6), ("r", right, -0.6)):
        more_links, more_joints = renamed(hand, word)
        links += more_links
        joints += [*more_joints, joint("revolute", "torso", f"{word}root", (0, y, 0), Z)]
    with pytest.raises(HandFileError, match="several hands"):
        interpret(model(links, joints), name="both")
    assert interpret(model(links, joints), name="one", palm="lpalm").hand.side == "left"


def test_bars_of_a_gear_are_no_fingers() -> None:
    links = [FileLink("base", (), (Box(np.array([0.05, 0.12, 0.05]), 0.025 * Z),))]
    joints = []
    for name, y, sign in (("a", 0.04, 1.0), ("b", -0.04, -1.0)):
        # A parallelogram: bar and knuckle turn alike, the finger at their ends keeps its direction.
        law = None if name == "a" else FileMimic("to_a_knuckle", 1.0, 0.0)
        links += [bone(f"{name}_knuckle", 0.04), bone(f"{name}_finger", 0.04), bone(f"{name}_bar", 0.04)]
        turn = {"axis": sign * X, "upper": 0.6}
        back = {"axis": sign * X, "lower": -0.6, "upper": 0.0}
        joints += [
            joint("revolute", "base", f"{name}_knuckle", (0, y, 0.05), mimic=law, **turn),
            joint("revolute", f"{name}_knuckle", f"{name}_finger", (0, 0, 0.04),
                  mimic=FileMimic("to_a_knuckle", -1.0, 0.0), **back),
            joint("revolute", "base", f"{name}_bar", (0, y - sign * 0.02, 0.05),
                  mimic=FileMimic("to_a_knuckle", 1.0, 0.0), **turn),
        ]  # fmt: skip
    imported = interpret(model(links, joints), name="gripper")
    assert [f.links for f in imported.hand.fingers] == [("b_knuckle", "b_finger"), ("a_knuckle", "a_finger")]
    assert said(imported, "a_bar, b_bar: not taken as a finger")
    tips, pads = tips_and_pads(imported.hand, imported.hand.q_rest)
    assert pads["index"] @ (tips["thumb"] - tips["index"]) > 0.0


def test_chains_of_mimic_laws_become_one() -> None:
    base = gripper()
    links = (*base.links, bone("jaw_c", 0.03))
    third = joint("prismatic", "base", "jaw_c", (0.05, 0, 0.06), Y, upper=0.1, mimic=FileMimic("to_jaw_b", 2.0, 0.01))
    second = replace(base.joints[1], mimic=FileMimic("to_jaw_a", 0.5, 0.002))
    hand = interpret(replace(base, links=links, joints=(base.joints[0], second, third)), name="x").hand
    law = hand.joints[2].coupling
    assert law is not None
    assert (law.master, law.multiplier, law.offset) == ("to_jaw_a", 1.0, pytest.approx(0.014))


def test_fixed_links_are_merged_and_found_again() -> None:
    imported = interpret(five_fingers(named=True), name="hand")
    assert len(imported.hand.links) == 16
    frame = imported.frames["index_tip"]
    assert frame.link == "index_3"
    assert frame.X_LF[:3, 3] == pytest.approx([0.0, 0.0, 0.024])
    assert imported.frames["palm"].link == "root"


# ---- what is mended


def changed(base: FileModel, name: str, **values) -> FileModel:
    return replace(base, joints=tuple(replace(j, **values) if j.name == name else j for j in base.joints))


def test_limits_are_mended() -> None:
    swapped = interpret(changed(claw(), "to_a1", lower=1.6, upper=0.0), name="claw")
    assert (swapped.hand.joints[0].lower, swapped.hand.joints[0].upper) == (0.0, 1.6)
    assert said(swapped, "wrong way round")
    endless = interpret(changed(claw(), "to_a1", kind="continuous", lower=-np.inf, upper=np.inf), name="claw")
    assert endless.hand.joints[0].upper == pytest.approx(np.pi)
    huge = interpret(changed(claw(), "to_a1", lower=-0.1, upper=1e10), name="claw")
    assert (huge.hand.joints[0].lower, huge.hand.joints[0].upper) == (-0.1, pytest.approx(np.pi))
    still = interpret(changed(claw(), "to_a2", lower=0.3, upper=0.3), name="claw")
    assert len(still.hand.joints) == 5
    assert said(still, "no range")
    assert still.frames["a2"].link == "a1"
    assert still.frames["a2"].X_LF[:3, :3] == pytest.approx(rotation_about(Y, 0.3))


def test_a_coupled_joint_does_not_block_its_master() -> None:
    imported = interpret(changed(gripper(), "to_jaw_b", lower=-0.04, upper=0.0), name="gripper")
    assert imported.hand.limits[:, 0] == pytest.approx([0.0, 0.04])
    assert said(imported, "would keep its master")


def test_inertias_are_mended() -> None:
    I = np.diag([1.0, 1.0, 3.0]) * 1e-5  # noqa: E741  violates the triangle inequality
    given = {
        "a1": FileInertia(0.03, 0.02 * Z, np.diag([2.0, 2.0, 1.0]) * 1e-5),
        "a2": FileInertia(0.03, np.zeros(3), I),
        "b1": FileInertia(-1.0, np.zeros(3), np.eye(3)),
        "b2": FileInertia(0.02, np.zeros(3), np.eye(3)),
    }
    base = claw()
    links = tuple(replace(k, inertia=given.get(k.name)) for k in base.links)
    imported = interpret(replace(base, links=links), name="claw")
    by_name = {link.name: link for link in imported.hand.links}
    assert (by_name["a1"].mass, by_name["a2"].mass, by_name["b2"].mass) == (0.03, 0.03, 0.02)
    assert by_name["a1"].I_LLcm == pytest.approx(np.diag([2.0, 2.0, 1.0]) * 1e-5 + 2e-6 * np.eye(3))
    assert by_name["b2"].I_LLcm.max() < 1e-4
    for link in imported.hand.links:
        a, b, c = np.linalg.eigvalsh(link.I_LLcm)
        assert link.mass > 0.0
        assert a > 0.0
        assert a + b >= c
    assert said(imported, "a2, b2: moments of inertia that no body")
    assert said(imported, "b1: a mass in the file that is not positive")
    assert said(imported, "base, c1, c2, b1: no inertia") or said(imported, "no inertia in the file")


@pytest.mark.parametrize("effort", [None, 0.0, 1000.0])
def test_placeholder_efforts_are_replaced(effort: float | None) -> None:
    imported = interpret(changed(claw(), "to_a1", effort=effort), name="claw")
    assert imported.hand.effort[0] == pytest.approx(10.0 * 0.09, rel=0.03)  # 10 N at the tip
    assert imported.hand.effort[1] == 1.0
    assert said(imported, "to_a1 (")


def test_a_shape_in_millimetres_is_shrunk() -> None:
    base = claw()
    slip = Capsule(np.zeros(3), 42.0 * Z, 8.0)
    links = tuple(replace(k, collision=(slip,)) if k.name == "a1" else k for k in base.links)
    imported = interpret(replace(base, links=links), name="claw")
    assert said(imported, "link a1: its shape is hundreds of times")
    shape = next(link for link in imported.hand.links if link.name == "a1").geometry[0]
    assert isinstance(shape, Capsule)
    assert shape.radius == pytest.approx(0.008)


# ---- shapes


def box_mesh(size: tuple[float, float, float], center: tuple[float, float, float]) -> tuple[Array, np.ndarray]:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return corners * np.array(size) + np.array(center), np.array(faces)


def with_palm(shape: FileGeometry) -> Hand:
    base = claw()
    return interpret(replace(base, links=(FileLink("base", (), (shape,)), *base.links[1:])), name="claw").hand


def test_pieces_of_a_mesh_become_parts() -> None:
    a, faces = box_mesh((0.04, 0.02, 0.02), (0.0, 0.05, 0.02))
    b, _ = box_mesh((0.04, 0.02, 0.02), (0.0, -0.05, 0.02))
    hand = with_palm(TriangleMesh(np.concatenate([a, b]), np.concatenate([faces, faces + 8])))
    parts = hand.links[0].geometry
    assert len(parts) == 2
    assert all(isinstance(part, Convex) and np.ptp(part.vertices, axis=0) == pytest.approx([0.04, 0.02, 0.02])
               for part in parts)  # fmt: skip


def test_a_concavity_is_not_filled() -> None:
    # A bracket of two plates at right angles, as one connected surface.
    outline = np.array([[0, 0], [0.08, 0], [0.08, 0.012], [0.012, 0.012], [0.012, 0.08], [0, 0.08]])
    low, high = (np.column_stack([outline, np.full(6, z)]) for z in (0.0, 0.04))
    flat = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    faces = [[a, c, b] for a, b, c in flat] + [[a + 6, b + 6, c + 6] for a, b, c in flat]
    for k in range(6):
        n = (k + 1) % 6
        faces += [[k, n, n + 6], [k, n + 6, k + 6]]
    hand = with_palm(TriangleMesh(np.concatenate([low, high]), np.array(faces)))
    parts = hand.links[0].geometry
    assert 2 <= len(parts) <= 8
    inside = np.array([0.05, 0.05, 0.02])  # In the hull of the bracket, not in the bracket.
    from scipy.spatial import ConvexHull

    for part in parts:
        assert isinstance(part, Convex)
        assert len(part.vertices) <= 40
        equations = ConvexHull(part.vertices).equations
        assert (equations[:, :3] @ inside + equations[:, 3]).max() > 5e-3


def test_cylinders_become_capsules_or_prisms() -> None:
    long = with_palm(Cylinder(np.zeros(3), 0.06 * Z, 0.01)).links[0].geometry[0]
    assert isinstance(long, Capsule)
    volume = np.pi * 0.01**2 * np.linalg.norm(long.p1 - long.p0) + 4.0 / 3.0 * np.pi * 0.01**3
    assert volume == pytest.approx(np.pi * 0.01**2 * 0.06)
    flat = with_palm(Cylinder(np.zeros(3), 0.02 * Z, 0.05)).links[0].geometry[0]
    assert isinstance(flat, Convex)
    assert np.ptp(flat.vertices[:, 2]) == pytest.approx(0.02)


def test_visual_shapes_stand_in() -> None:
    base = claw()
    ball = Sphere(0.02 * Z, 0.01)
    swap = {"a1": FileLink("a1", (ball,), ())}
    imported = interpret(replace(base, links=tuple(swap.get(k.name, k) for k in base.links)), name="claw")
    shape = imported.hand.links[imported.hand.link_index["a1"]].geometry[0]
    assert isinstance(shape, Sphere)
    assert shape.radius == ball.radius
    assert said(imported, "decided: link a1: has no collision shape")


def test_spheres_of_parts_reach_as_far_as_the_shape() -> None:
    hand = interpret(five_fingers(), name="hand").hand
    for finger in hand.fingers:
        spheres = hand.links[hand.link_index[finger.tip_link]].spheres
        gap = np.linalg.norm(spheres[:, :3] - finger.p_LTip, axis=1) - spheres[:, 3]
        assert gap.min() < 1e-3


# ---- what is refused


def in_a_circle(base: FileModel) -> FileModel:
    return replace(base, joints=(*base.joints, joint("fixed", "jaw_a", "base", name="back")))


def bad(edit: Callable[[FileModel], FileModel]) -> Callable[[], FileModel]:
    return lambda: edit(gripper())


BAD = {
    "link 'jaw_a' is the child of two joints": bad(
        lambda b: replace(b, joints=(*b.joints, joint("fixed", "base", "jaw_a", name="again")))
    ),
    "is its own ancestor": bad(in_a_circle),
    "2 links without a parent": bad(lambda b: replace(b, links=(*b.links, FileLink("stray")))),
    "joint 'to_jaw_a': its lower limit is not a number": bad(lambda b: changed(b, "to_jaw_a", lower=np.nan)),
    "joint 'to_jaw_a': its axis is zero": bad(lambda b: changed(b, "to_jaw_a", axis=np.zeros(3))),
    "joint 'to_jaw_a': its origin is not finite": bad(lambda b: changed(b, "to_jaw_a", p_PJ=np.full(3, np.inf))),
    "joint 'to_jaw_a': its origin is 60 m": bad(lambda b: changed(b, "to_jaw_a", p_PJ=60.0 * Z)),
    "joint 'to_jaw_a': its origin is no rotation": bad(lambda b: changed(b, "to_jaw_a", R_PJ=2.0 * np.eye(3))),
    "joint 'to_jaw_a': its parent 'arm' is no link": bad(lambda b: changed(b, "to_jaw_a", parent="arm")),
    "joint 'to_jaw_a' is of type 'ball'": bad(lambda b: changed(b, "to_jaw_a", kind="ball")),
    "mimic master 'nothing' is no joint": bad(lambda b: changed(b, "to_jaw_b", mimic=FileMimic("nothing", 1.0, 0.0))),
    "follows the joint itself": bad(lambda b: changed(b, "to_jaw_a", mimic=FileMimic("to_jaw_b", 1.0, 0.0))),
    "its mimic law is not finite": bad(lambda b: changed(b, "to_jaw_b", mimic=FileMimic("to_jaw_a", np.nan, 0.0))),
    "no movable joint": bad(lambda b: replace(b, joints=tuple(replace(j, kind="fixed") for j in b.joints))),
    "has no link": bad(lambda b: replace(b, links=(), joints=())),
    "is described twice": bad(lambda b: replace(b, links=(*b.links, b.links[0]))),
    "600 links, more than 500": lambda: model([FileLink(f"l{k}") for k in range(600)], []),
    "write lengths in metres": lambda: model(
        [FileLink("base"), bone("a", 0.002, 0.0005), bone("b", 0.002, 0.0005)],
        [joint("revolute", "base", "a", (0, 0.001, 0)), joint("revolute", "base", "b", (0, -0.001, 0))],
    ),
}


@pytest.mark.parametrize("message", BAD)
def test_bad_robots_are_refused(message: str) -> None:
    with pytest.raises(HandFileError, match=message.replace("(", r"\(")) as error:
        interpret(BAD[message](), name="x")
    assert "robot.urdf: " in str(error.value)
    assert "; " in str(error.value)  # what is wrong, and how to mend it


def test_a_wrong_side_is_refused() -> None:
    with pytest.raises(HandFileError, match="give right or left"):
        interpret(gripper(), name="x", side="top")


# ---- the vendors' files, as they are


@pytest.fixture(scope="module", params=VENDORS)
def vendor(request: pytest.FixtureRequest, reference: Path, reference_kinematics: dict) -> tuple[Imported, dict, Path]:
    facts = reference_kinematics[request.param]
    path = reference / "hands_reference" / facts["urdf"]
    return interpret(read_urdf(path), name=request.param), facts, path


def base_rotation(facts: dict) -> Array:
    """Rotation of our base in the file's root at zero."""
    R = np.eye(3)
    if facts["palm"]["palm_link"] == "palm" and facts["base_link"] == "world":  # Shadow: the base is the palm.
        for link in facts["links"]:
            if link["name"] in ("forearm", "wrist", "palm"):
                R = R @ np.array(link["joint"]["origin_rotation"])
    return R


def test_vendor_palm_and_finger_direction(vendor) -> None:
    imported, facts, _ = vendor
    R = base_rotation(facts)
    for row, fact in ((0, "palm_normal_in_base"), (2, "finger_direction_in_base")):
        angle = np.degrees(np.arccos(np.clip(imported.hand.R_HB[row] @ R.T @ facts["palm"][fact], -1.0, 1.0)))
        assert angle < 1.0, fact  # 10 degrees are asked for
    assert imported.hand.side == "right"


def test_vendor_fingers_and_tips(vendor) -> None:
    imported, facts, _ = vendor
    names = {"pinky": "little"}
    fingers = {finger.name: finger for finger in imported.hand.fingers}
    assert set(fingers) == {names.get(name, name) for name in facts["fingers"]}
    for name, fact in facts["fingers"].items():
        finger = fingers[names.get(name, name)]
        assert finger.tip_link == fact["distal_link"]
        assert finger.p_LTip == pytest.approx(fact["tip_point_in_distal_link"], abs=1e-9)
        own = [step["link"] for step in fact["chain"] if step["link"] in imported.hand.link_index]
        assert set(finger.links) <= set(own)
        assert len(own) - len(finger.links) <= 1  # SVH's half of the palm is shared by two fingers


def test_vendor_without_names_and_tip_frames(vendor) -> None:
    # Names that say nothing and no marks at the tips: fingers follow from motion, tips from the ends of the shapes.
    _, facts, path = vendor
    file = read_urdf(path)
    marks = {link.name for link in file.links if "tip" in link.name and not link.visual and not link.collision}
    link_names = {link.name: f"l{k}" for k, link in enumerate(file.links)}
    joint_names = {j.name: f"j{k}" for k, j in enumerate(file.joints)}
    joints = []
    for j in file.joints:
        law = None if j.mimic is None else replace(j.mimic, master=joint_names[j.mimic.master])
        ends = {"parent": link_names[j.parent], "child": link_names[j.child]}
        if j.child not in marks:
            joints.append(replace(j, name=joint_names[j.name], mimic=law, **ends))
    links = tuple(replace(k, name=link_names[k.name]) for k in file.links if k.name not in marks)
    imported = interpret(replace(file, name="robot", links=links, joints=tuple(joints)), name="anonymous")
    names = {link_names[fact["distal_link"]]: name for name, fact in facts["fingers"].items()}
    assert imported.hand.side == "right"
    for finger in imported.hand.fingers:
        name = names[finger.tip_link]
        assert finger.name == {"pinky": "little"}.get(name, name)
        assert np.linalg.norm(finger.p_LTip - facts["fingers"][name]["tip_point_in_distal_link"]) < 7.5e-3


def test_vendor_couplings_and_limits(vendor) -> None:
    imported, facts, _ = vendor
    fact_of = {link["joint"]["name"]: link["joint"] for link in facts["links"] if link["joint"]}
    wrist = {"WRJ1", "WRJ2"}
    assert set(imported.hand.joint_names) == set(facts["actuated_joint_order"]) - wrist
    for made in imported.hand.joints:
        fact = fact_of[made.name]
        assert (made.lower, made.upper) == (pytest.approx(fact["lower"]), pytest.approx(fact["upper"]))
        if fact["mimic"] is None:
            assert made.coupling is None
        else:
            assert made.coupling is not None
            assert made.coupling.master == fact["mimic"]["joint"]
            assert made.coupling.multiplier == fact["mimic"]["multiplier"]
            assert made.coupling.offset == fact["mimic"]["offset"]


def test_vendor_kinematics_agree_with_yourdfpy(vendor) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    imported, _, path = vendor
    hand = imported.hand
    robot = yourdfpy.URDF.load(str(path), load_meshes=False, load_collision_meshes=False, build_scene_graph=True)
    rng = np.random.default_rng(0)
    base = next(name for name, frame in imported.frames.items() if np.array_equal(frame.X_LF, np.eye(4))
                and frame.link == hand.links[0].name)  # fmt: skip
    for _ in range(5):
        q = hand.limits[0] + rng.random(len(hand.joint_names)) * (hand.limits[1] - hand.limits[0])
        R, p = forward_kinematics(hand, RigidTransform(), q)
        values = dict.fromkeys(robot.actuated_joint_names, 0.0)
        values.update(dict(zip(hand.joint_names, q, strict=True)))
        robot.update_cfg(values)
        for name, frame in imported.frames.items():
            k = hand.link_index[frame.link]
            X_HL = np.eye(4)
            X_HL[:3, :3], X_HL[:3, 3] = R[k], p[k]
            X_BF = robot.get_transform(name, base)
            X_HB = np.eye(4)
            X_HB[:3, :3], X_HB[:3, 3] = hand.R_HB, hand.p_HB
            assert np.abs(X_HL @ frame.X_LF - X_HB @ X_BF).max() < 1e-9, name


def test_vendor_rest_posture(vendor) -> None:
    imported, _, _ = vendor
    hand = imported.hand
    assert (hand.q_rest >= hand.limits[0] - 1e-12).all()
    assert (hand.q_rest <= hand.limits[1] + 1e-12).all()
    tips, pads = tips_and_pads(hand, hand.q_rest)
    for name in ("index", "middle"):
        across = tips[name] - tips["thumb"]
        distance = np.linalg.norm(across)
        assert 0.03 < distance < 0.085
        assert pads["thumb"] @ across > 0.4 * distance
        assert pads[name] @ -across > 0.5 * distance
    assert not said(imported, "links overlap by")


def test_vendor_rests_in_simulation(vendor) -> None:
    hand = vendor[0].hand
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.005)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    instance = add_hand(plant, hand, pd_gains=(1.0, 0.1), point_stiffness=1e5)
    base = plant.GetBodyByName(hand.links[0].name, instance).body_frame()
    plant.WeldFrames(plant.world_frame(), base, RigidTransform(RotationMatrix(hand.R_HB), hand.p_HB))
    plant.set_gravity_enabled(instance, False)
    plant.Finalize()
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.get_desired_state_input_port(instance).FixValue(context, np.concatenate([hand.q_rest, 0.0 * hand.q_rest]))
    start = plant.GetPositions(context, instance).copy()
    simulator.AdvanceTo(0.3)
    assert np.abs(plant.GetPositions(context, instance) - start).max() < 1e-5


def test_vendor_parts_are_few(vendor) -> None:
    hand = vendor[0].hand
    for link in hand.links:
        convex = [shape for shape in link.geometry if isinstance(shape, Convex)]
        assert len(convex) <= 9
        assert all(len(shape.vertices) <= 40 for shape in convex)
    assert sum(len(link.geometry) for link in hand.links) <= 80
