"""Hand files as makers write and copy them: what is a finger, a hand and a shape, and where H lies."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Box, Capsule, Hand
from xdex_drake.hand.importing.files import import_hand, read_model
from xdex_drake.hand.importing.interpret import Imported, interpret
from xdex_drake.hand.importing.model import FileInertia, FileJoint, FileLink, FileMimic, FileModel
from xdex_drake.hand.kinematics import rotation_about
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.hand.mirror import mirror
from xdex_drake.hand.yaml_file import hand_text, read_hand
from xdex_drake.interchange.urdf import export_urdf

X, Y, Z = np.eye(3)
FINGERS = ("index", "middle", "ring", "little")

Step = tuple[str, Array, tuple[float, float, float], tuple[float, float]]
"""A joint of a finger: name, axis, place in its parent's frame [m], limits [rad]."""


def joint(kind: str, parent: str, child: str, at=(0.0, 0.0, 0.0), axis: Array = Y, **more) -> FileJoint:
    values = {"lower": 0.0, "upper": 1.5, "effort": 1.0, **more} if kind != "fixed" else more
    R = values.pop("R", np.eye(3))
    name = values.pop("name", f"to_{child}")
    return FileJoint(name, kind, parent, child, np.array(at, dtype=float), R, np.asarray(axis, dtype=float), **values)


def part(name: str, size=(0.012, 0.012, 0.04), at=(0.0, 0.0, 0.02), mass: float = 0.05) -> FileLink:
    box = Box(np.array(size), np.array(at))
    return FileLink(name, (), (box,), FileInertia(mass, np.zeros(3), 2e-5 * np.eye(3)))


KNUCKLE: tuple[Step, ...] = (("prox", Y, (0.0, 0.0, 0.0), (0.0, 1.5)), ("dist", Y, (0.0, 0.0, 0.04), (0.0, 1.5)))


def box_hand(
    steps: tuple[Step, ...] = KNUCKLE,
    *,
    side: str = "right",
    prefix: str = "",
    lengths: dict[str, float] | None = None,
    R: Array | None = None,
) -> FileModel:
    """Five fingers of boxes on a palm in the y-z plane; a step whose name is hub is a small block.

    A left hand is the mirror image in y, joint values counting as on the right one.
    """
    m = 1.0 if side == "right" else -1.0
    root, palm = f"{prefix}base", f"{prefix}palm"
    links = [FileLink(root), part(palm, (0.03, 0.09, 0.1), (0.0, 0.0, 0.05), 0.3)]
    joints = [joint("fixed", root, palm, R=np.eye(3) if R is None else R)]

    def mirrored(v) -> Array:
        return np.array([v[0], m * v[1], v[2]])

    def turned(axis: Array) -> Array:
        return m * mirrored(axis)  # Axial vectors keep what polar ones lose.

    for finger, y in zip(FINGERS, (0.03, 0.01, -0.01, -0.03), strict=True):
        parent, place = palm, np.array([0.0, y, 0.105])
        for name, axis, at, (lower, upper) in steps:
            child = f"{prefix}{finger}_{name}"
            length = (lengths or {}).get(name, 0.04)
            hub = name.startswith("hub")
            size, middle = ((0.01, 0.01, 0.01), 0.0) if hub else ((0.012, 0.012, length), length / 2)
            links.append(part(child, size, (0.0, 0.0, middle)))
            joints.append(
                joint("revolute", parent, child, mirrored(place + at), turned(axis), lower=lower, upper=upper)
            )
            parent, place = child, np.zeros(3)
    parent = palm
    for name, at, axis, upper in (
        ("base", (0.02, 0.045, 0.03), -Z, 1.6),
        ("prox", (0.0, 0.03, 0.0), X, 1.2),
        ("dist", (0.0, 0.03, 0.0), X, 1.2),
    ):
        child = f"{prefix}thumb_{name}"
        links.append(part(child, (0.012, 0.03, 0.012), mirrored((0.0, 0.015, 0.0))))
        joints.append(joint("revolute", parent, child, mirrored(at), turned(axis), upper=upper))
        parent = child
    return FileModel(f"{prefix}hand", f"{prefix}hand.urdf", tuple(links), tuple(joints))


def off(imported: Imported, R: Array | None = None) -> tuple[float, float]:
    """Angles of x_H and z_H to where they should be [deg]."""
    R_HB = imported.hand.R_HB @ (np.eye(3) if R is None else R)
    return tuple(float(np.degrees(np.arccos(np.clip(R_HB[k, k], -1.0, 1.0)))) for k in (0, 2))  # pyright: ignore


def told(imported: Imported, severity: str = "warning") -> list[str]:
    return [str(d) for d in imported.decisions if d.severity == severity]


def fingers(imported: Imported) -> dict[str, str]:
    return {finger.name: finger.tip_link for finger in imported.hand.fingers}


# ---- directions of the wrist frame

HUBS = {
    "out": (0.014, 0.005, 0.0),
    "half out": (0.009, 0.0, 0.012),
    "back": (-0.016, 0.0, 0.006),
    "sideways": (0.0, -0.007, 0.006),
    "far out": (0.019, -0.008, 0.0),
}


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("hub", HUBS)
def test_a_hub_that_steps_aside_does_not_turn_the_wrist_frame(hub: str, side: str) -> None:
    steps = (("hub", X, (0.0, 0.0, 0.0), (-0.25, 0.25)), ("prox", Y, HUBS[hub], (0.0, 1.5)), KNUCKLE[1])
    imported = interpret(box_hand(steps, side=side), name="hand")
    assert max(off(imported)) < 5.0
    assert imported.hand.side == side
    assert len(imported.hand.ignored_contacts) in (0, 4)  # Fingers that are alike are judged alike.
    assert not told(imported)


@pytest.mark.parametrize("hub", HUBS)
def test_nor_does_one_between_joints_that_bend(hub: str) -> None:
    steps = (
        ("hub", Y, (0.0, 0.0, 0.0), (-0.1, 1.5)),
        ("hub2", X, HUBS[hub], (-0.25, 0.25)),
        ("prox", Y, (0.0, 0.0, 0.006), (-0.1, 1.5)),
        KNUCKLE[1],
    )
    R = rotation_about(np.array([0.6, 0.0, 0.8]), 0.9)
    assert max(off(interpret(box_hand(steps, R=R), name="hand"), R)) < 5.0


def test_a_crooked_fingertip_does_not_turn_the_wrist_frame_either() -> None:
    steps = (*KNUCKLE, ("tip", Y, (0.0, 0.0, 0.04), (0.0, 1.5)))
    hand = box_hand(steps, lengths={"tip": 0.03})
    crooked = tuple(replace(j, R_PJ=rotation_about(Y, 0.5)) if j.child.endswith("_tip") else j for j in hand.joints)
    assert max(off(interpret(replace(hand, joints=crooked), name="hand"))) < 5.0


def test_fingers_that_are_drawn_half_bent_do_not_turn_it_either() -> None:
    hand = box_hand((("prox", Y, (0.0, 0.0, 0.0), (-0.35, 1.1)), ("dist", Y, (0.0, 0.0, 0.04), (-0.4, 1.1))))
    bent = {"prox": rotation_about(Y, 0.35), "dist": rotation_about(Y, 0.4)}
    joints = (replace(j, R_PJ=bent[j.child[-4:]]) if j.child[-4:] in bent and j.axis[1] else j for j in hand.joints)
    assert max(off(interpret(replace(hand, joints=tuple(joints)), name="hand"))) < 5.0


def test_fingers_that_are_drawn_closed_and_open_as_their_joints_rise_do_not_turn_it_either() -> None:
    hand = box_hand((*KNUCKLE, ("tip", Y, (0.0, 0.0, 0.04), (0.0, 1.5))))
    turned = rotation_about(Y, 1.1)
    joints = (
        replace(j, R_PJ=turned, axis=-Y, upper=1.1) if j.axis[1] == 1.0 and j.kind != "fixed" else j
        for j in hand.joints
    )
    imported = interpret(replace(hand, joints=tuple(joints)), name="hand")
    assert max(off(imported)) < 5.0
    assert imported.hand.side == "right"


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_thumb_and_few_fingers_are_a_hand_and_no_claw(count: int) -> None:
    hand, gone = box_hand(), FINGERS[count:]
    links = tuple(link for link in hand.links if not link.name.startswith(gone))
    joints = tuple(j for j in hand.joints if not j.child.startswith(gone))
    imported = interpret(replace(hand, links=links, joints=joints), name="hand")
    assert len(imported.hand.fingers) == 1 + count
    assert max(off(imported)) < 5.0


# ---- what is a finger


def with_more(hand: FileModel, links: list[FileLink], joints: list[FileJoint]) -> FileModel:
    return replace(hand, links=(*hand.links, *links), joints=(*hand.joints, *joints))


def bare(name: str, mass: float = 0.01) -> FileLink:
    return FileLink(name, (), (), FileInertia(mass, np.zeros(3), 4e-6 * np.eye(3)))


def test_what_moves_no_shape_is_no_finger() -> None:
    motors = ("thumb_motor", "index_motor", "mrl_actuation")
    links = [bare(name) for name in motors] + [bare("ring_encoder"), bare("side_shaft")]
    joints = [joint("revolute", "palm", name, axis=X, lower=-2.5, upper=6.8) for name in motors]
    joints += [joint("revolute", "ring_dist", "ring_encoder"), joint("revolute", "index_prox", "side_shaft")]
    imported = interpret(with_more(box_hand(), links, joints), name="hand")
    right = dict(zip(("thumb", *FINGERS), ("thumb_dist", *(f"{f}_dist" for f in FINGERS)), strict=True))
    assert fingers(imported) == right
    assert len(imported.hand.joint_names) == 11
    assert len([d for d in imported.decisions if "moves nothing that has a shape" in d.text]) == 1
    assert not told(imported)


def test_joints_that_follow_a_motor_without_shape_follow_each_other() -> None:
    hand = box_hand()
    laws = {"to_index_prox": FileMimic("to_drive", 0.5, 0.1), "to_index_dist": FileMimic("to_drive", 0.4, 0.0)}
    hand = replace(hand, joints=tuple(replace(j, mimic=laws.get(j.name)) for j in hand.joints))
    imported = interpret(with_more(hand, [bare("drive")], [joint("prismatic", "palm", "drive")]), name="hand")
    law = next(j.coupling for j in imported.hand.joints if j.name == "to_index_dist")
    assert law is not None
    assert (law.master, law.multiplier, law.offset) == ("to_index_prox", pytest.approx(0.8), pytest.approx(-0.08))


@pytest.mark.parametrize("prismatic", [False, True])
def test_what_turns_in_its_place_is_no_finger(prismatic: bool, tmp_path: Path) -> None:
    knob = part("knob", (0.01, 0.01, 0.03), (0.0, 0.0, 0.015))
    kind = "prismatic" if prismatic else "revolute"
    more = joint(kind, "palm", "knob", (-0.015, 0.0, 0.05), Z, lower=-3.0, upper=3.0)
    if prismatic:
        more = replace(more, lower=0.0, upper=1e-3)  # A button is pressed by a millimetre.
    imported = interpret(with_more(box_hand(), [knob], [more]), name="hand")
    assert "knob" not in fingers(imported).values()
    assert len(imported.hand.fingers) == 5
    assert imported.frames["knob"].link == imported.hand.links[0].name
    (tmp_path / "hand.yaml").write_text(hand_text(imported.hand))
    assert len(read_hand(tmp_path / "hand.yaml").fingers) == 5


def jaws(bar_law: float) -> FileModel:
    """A parallel gripper whose bars hang on its fingers and lead back to the base."""
    links = [part("base", (0.07, 0.14, 0.06), (0.0, 0.0, 0.02), 0.8)]
    joints = []
    for name, m in (("left", 1.0), ("right", -1.0)):
        outer, inner, bar = (f"{name}_{word}" for word in ("outer", "inner", "bar"))
        links += [part(outer, (0.015, 0.012, 0.1), (0.0, 0.0, 0.05)), part(inner, (0.015, 0.01, 0.05), (0, 0, 0.025))]
        links += [part(bar, (0.01, 0.008, 0.09), (0.0, 0.0, -0.045))]
        back, along = (FileMimic(f"to_{outer}", slope, 0.0) for slope in (-1.0, bar_law))
        joints += [
            joint("revolute", "base", outer, (0.0, 0.06 * m, 0.05), m * X, upper=0.7),
            joint("revolute", outer, inner, (0.0, 0.0, 0.1), m * X, lower=-0.9, upper=0.9, mimic=back),
            joint("revolute", inner, bar, (0.0, -0.012 * m, 0.0), m * X, lower=-1.9, upper=1.9, mimic=along),
        ]
    return FileModel("gripper", "gripper.urdf", tuple(links), tuple(joints))


@pytest.mark.parametrize("bar_law", [1.0, 0.85])
def test_bars_that_hang_on_a_finger_are_no_fingertips(bar_law: float) -> None:
    imported = interpret(jaws(bar_law), name="gripper")
    assert set(fingers(imported).values()) == {"left_inner", "right_inner"}
    for finger in imported.hand.fingers:
        assert finger.p_LTip[2] == pytest.approx(0.05, abs=5e-3)
    pairs = {frozenset(pair) for pair in imported.hand.ignored_contacts}
    assert frozenset(("left_bar", "left_outer")) in pairs
    assert frozenset(("left_bar", "right_inner")) not in pairs


# ---- what is a hand


def mounted(at: float = 0.15, kind: str = "fixed", names: tuple[str, str] = ("left_", "right_")) -> FileModel:
    """A left and a right hand beside each other on one torso."""
    links, joints = [part("torso", (0.1, 0.1, 0.1), (0.0, 0.0, 0.0), 2.0)], []
    for side, prefix, y in (("left", names[0], at), ("right", names[1], -at)):
        hand = box_hand(side=side, prefix=prefix)
        links += hand.links
        joints += hand.joints
        joints += [joint(kind, "torso", f"{prefix}base", (0.0, y, 0.1), Z)]
    return FileModel("robot", "robot.urdf", tuple(links), tuple(joints))


@pytest.mark.parametrize("kind", ["fixed", "revolute"])
def test_two_hands_in_one_file_are_told_apart(kind: str) -> None:
    robot = mounted(kind=kind)
    with pytest.raises(HandFileError, match=r"several hands, at left_palm, right_palm.*--side right.*--palm left_palm"):
        interpret(robot, name="hand")
    for side in ("right", "left"):
        imported = interpret(robot, name="hand", side=side)
        assert imported.hand.side == side
        assert set(fingers(imported).values()) == {f"{side}_{f}_dist" for f in ("thumb", *FINGERS)}
        assert max(off(imported)) < 5.0
    assert interpret(robot, name="hand", palm="left_palm").hand.side == "left"


def test_hands_may_be_fixed_far_from_the_base() -> None:
    hand = box_hand()
    stand = joint("fixed", "world", "base", (0.3, 0.0, 1.0))
    imported = interpret(replace(hand, links=(FileLink("world"), *hand.links), joints=(stand, *hand.joints)), name="h")
    assert max(off(imported)) < 5.0
    assert len(imported.hand.fingers) == 5
    assert interpret(mounted(at=0.8), name="hand", side="left").hand.fingers[0].tip_link == "left_thumb_dist"


def test_two_hands_without_names_are_told_apart_by_their_thumbs() -> None:
    imported = interpret(mounted(names=("a_", "b_")), name="hand", side="left")
    assert imported.hand.fingers[0].tip_link == "a_thumb_dist"


def limb(name: str, count: int, length: float, mass: float, at: tuple, down: float = -1.0) -> tuple[list, list]:
    links = [part(f"{name}_{k}", (0.05, 0.05, length), (0, 0, down * length / 2), mass) for k in range(count)]
    joints = [joint("revolute", "chest", f"{name}_0", at, X, lower=-1.0, effort=60.0)]
    for k in range(count - 1):
        joints.append(joint("revolute", f"{name}_{k}", f"{name}_{k + 1}", (0, 0, down * length), (Y, X)[k % 2]))
    return links, joints


def torso(count: int, length: float, mass: float) -> FileModel:
    links, joints = [part("chest", (0.2, 0.3, 0.35), (0, 0, 0.15), 8.0)], []
    for name, at in (("l_arm", (0.0, 0.2, 0.3)), ("r_arm", (0.0, -0.2, 0.3))):
        more = limb(name, count, length, mass, at)
        links, joints = links + more[0], joints + more[1]
    more = limb("head", 2, 0.08, 0.8, (0.0, 0.0, 0.35), 1.0)
    return FileModel("robot", "robot.urdf", (*links, *more[0]), (*joints, *more[1]))


@pytest.mark.parametrize(("count", "length", "mass"), [(4, 0.12, 1.2), (6, 0.1, 0.3), (3, 0.09, 1.0)])
def test_a_robot_without_a_hand_is_refused(count: int, length: float, mass: float) -> None:
    with pytest.raises(HandFileError, match=r"there is no hand in it.*arm_") as error:
        interpret(torso(count, length, mass), name="hand")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("count", "length"), [(2, 0.1), (3, 0.07), (5, 0.05)])
def test_nor_is_a_toy_a_hand_whose_limbs_are_as_small_as_fingers(count: int, length: float) -> None:
    with pytest.raises(HandFileError, match=r"there is no hand in it.*arm_"):
        interpret(torso(count, length, 0.05), name="hand")


def test_a_gripper_on_a_robot_with_wheels_and_a_head_is_found() -> None:
    robot = torso(5, 0.2, 1.0)
    wheels = [part(f"wheel_{k}", (0.1, 0.03, 0.1), (0, 0, 0), 1.0) for k in range(4)]
    spots = ((0.1, 0.15, 0.0), (-0.1, 0.15, 0.0), (0.1, -0.15, 0.0), (-0.1, -0.15, 0.0))
    rolls = [joint("revolute", "chest", f"wheel_{k}", at, Y, lower=-3, upper=3) for k, at in enumerate(spots)]
    tips = [part(f"jaw_{k}", (0.02, 0.01, 0.05), (0, 0, -0.025), 0.05) for k in range(2)]
    slides = [
        joint("prismatic", "r_arm_4", f"jaw_{k}", (0, 0.0, -0.2), m * Y, upper=0.04) for k, m in enumerate((1, -1))
    ]
    imported = interpret(with_more(robot, wheels + tips, rolls + slides), name="gripper")
    assert set(fingers(imported).values()) == {"jaw_0", "jaw_1"}
    assert imported.hand.links[0].name == "r_arm_4"


def test_one_jaw_is_refused() -> None:
    robot = FileModel(
        "grip", "grip.urdf", (part("base"), part("jaw")), (joint("revolute", "base", "jaw", (0, 0, 0.04), X),)
    )
    for palm in (None, "base"):
        with pytest.raises(HandFileError, match="one finger or jaw alone moves"):
            interpret(robot, name="grip", palm=palm)


# ---- what is a shape


def test_frame_markers_are_no_shape() -> None:
    hand = box_hand()
    rods = tuple(Capsule(np.zeros(3), 0.15 * e, 0.002) for e in (X, Y, -Z))
    marks = [FileLink("frame", rods), FileLink("index_mark", rods)]
    joints = [joint("fixed", "palm", "frame"), joint("fixed", "index_dist", "index_mark", (0.0, 0.0, 0.02))]
    plain, marked = interpret(hand, name="hand").hand, interpret(with_more(hand, marks, joints), name="hand")
    assert [len(link.geometry) for link in marked.hand.links] == [len(link.geometry) for link in plain.links]
    np.testing.assert_allclose(marked.hand.p_HB, plain.p_HB)
    np.testing.assert_allclose(marked.hand.R_HB, plain.R_HB)
    for a, b in zip(marked.hand.fingers, plain.fingers, strict=True):
        np.testing.assert_allclose(a.p_LTip, b.p_LTip)
    assert len([d for d in marked.decisions if "marks" in d.text]) == 1


def stripped(hand: FileModel, where: Callable[[str], bool], lost: tuple[str, ...] = ()) -> FileModel:
    links = (replace(k, visual=(), collision=(), lost=lost) if where(k.name) else k for k in hand.links)
    return replace(hand, links=tuple(links))


def test_a_hand_or_fingertips_without_shape_are_refused_by_name() -> None:
    with pytest.raises(HandFileError, match="no link has a shape"):
        interpret(stripped(box_hand(), lambda name: True), name="hand")
    with pytest.raises(HandFileError, match=r"of 5 of 5 fingers.*index_dist.*thumb_dist"):
        interpret(stripped(box_hand(), lambda name: name.endswith("_dist")), name="hand")
    with pytest.raises(HandFileError, match=r"of 1 of 5 fingers.*ring_dist.*gone\.stl"):
        interpret(stripped(box_hand(), lambda name: name == "ring_dist", ("'gone.stl' does not exist",)), name="hand")


# ---- files


BOX = "\n".join(
    [f"v {x} {y} {z}" for z in (0, 40) for x, y in ((-6, -6), (6, -6), (6, 6), (-6, 6))]
    + [f"f {f}" for f in ("1 3 2", "1 4 3", "5 6 7", "5 7 8", "1 2 6", "1 6 5", "2 3 7", "2 7 6", "3 4 8", "3 8 7")]
    + ["f 4 1 5", "f 4 5 8"]
)


def meshed_urdf(mesh: str, scale: str = ' scale="0.001 0.001 0.001"') -> str:
    """A claw of three fingers whose links are all drawn by one mesh."""
    shape = f'<geometry><mesh filename="{mesh}"{scale}/></geometry>'
    link = '<link name="{0}"><visual>' + shape + "</visual><collision>" + shape + "</collision></link>"
    text = '<link name="palm"><collision><geometry><box size="0.06 0.06 0.03"/></geometry></collision></link>'
    bend = (
        '<joint name="{1}_j" type="revolute"><parent link="{0}"/><child link="{1}"/><origin xyz="{2}" rpy="0 0 {3}"/>'
    )
    bend += '<axis xyz="0 -1 0"/><limit lower="-0.2" upper="1.2" effort="1" velocity="1"/></joint>'
    for k, turn in enumerate(np.deg2rad([0.0, 120.0, 240.0])):
        at = f"{0.025 * np.cos(turn):.6f} {0.025 * np.sin(turn):.6f} 0.015"
        text += link.format(f"a{k}") + link.format(f"b{k}")
        text += bend.format("palm", f"a{k}", at, f"{turn:.6f}") + bend.format(f"a{k}", f"b{k}", "0 0 0.04", 0)
    return f'<robot name="claw">{text}</robot>'


def put(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def shaped(imported: Imported) -> int:
    return sum(bool(link.geometry) for link in imported.hand.links)


@pytest.mark.parametrize(
    "name", ["/home/ann/ws/claw/meshes/f.obj", "file:///opt/x/meshes/f.obj", "C:\\ann\\claw\\meshes\\f.obj"]
)
def test_a_path_of_another_computer_is_taken_by_its_end(tmp_path: Path, name: str) -> None:
    put(tmp_path / "claw" / "meshes" / "f.obj", BOX)
    imported = import_hand(put(tmp_path / "claw" / "urdf" / "claw.urdf", meshed_urdf(name)))
    assert shaped(imported) == 7
    (warning,) = told(imported)
    assert "by the end of that path, as meshes/f.obj" in warning
    with pytest.raises(HandFileError, match=r"g\.obj.*(outside the hand's folder.*--root|does not exist here)"):
        import_hand(put(tmp_path / "claw" / "urdf" / "other.urdf", meshed_urdf(name.replace("f.obj", "g.obj"))))


def test_a_neighbouring_folder_is_read_where_it_is_allowed(tmp_path: Path) -> None:
    put(tmp_path / "shared" / "f.obj", BOX)
    path = put(tmp_path / "claw_v2" / "claw.urdf", meshed_urdf("../shared/f.obj"))
    with pytest.raises(HandFileError, match=r"--root \.\."):
        import_hand(path)
    assert shaped(import_hand(path, root=tmp_path)) == 7
    with pytest.raises(HandFileError, match="outside"):
        import_hand(path, root=tmp_path / "claw_v2")
    with pytest.raises(HandFileError, match="is no folder"):
        import_hand(path, root=tmp_path / "absent")


def test_packages_are_found_by_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    put(tmp_path / "ws" / "claw_meshes" / "package.xml", "<package><name>parts</name></package>")
    put(tmp_path / "ws" / "claw_meshes" / "m" / "f.obj", BOX)
    text = meshed_urdf("package://parts/m/f.obj")
    # Beside the hand's own package.
    put(tmp_path / "ws" / "claw" / "package.xml", "<package><name>claw</name></package>")
    assert shaped(import_hand(put(tmp_path / "ws" / "claw" / "urdf" / "claw.urdf", text))) == 7
    # Elsewhere: by an option, or by the environment.
    path = put(tmp_path / "other" / "claw.urdf", text)
    with pytest.raises(HandFileError, match="--package parts=FOLDER"):
        import_hand(path)
    assert shaped(import_hand(path, packages={"parts": tmp_path / "ws" / "claw_meshes"})) == 7
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'absent'}:{tmp_path / 'ws'}")
    assert shaped(import_hand(path)) == 7
    # A package leads to what lies in it only.
    put(tmp_path / "ws" / "secret.obj", BOX)
    with pytest.raises(HandFileError, match="outside"):
        import_hand(put(tmp_path / "other" / "bad.urdf", meshed_urdf("package://parts/../secret.obj")))


def test_a_folder_above_may_bear_the_name_of_the_package(tmp_path: Path) -> None:
    put(tmp_path / "claw_model" / "meshes" / "f.obj", BOX)
    path = tmp_path / "claw_model" / "robots" / "r1" / "claw.urdf"
    assert shaped(import_hand(put(path, meshed_urdf("package://claw_model/meshes/f.obj")))) == 7


def test_meshes_in_millimetres_are_told_and_shrunk(tmp_path: Path) -> None:
    put(tmp_path / "f.obj", BOX)
    imported = import_hand(put(tmp_path / "claw.urdf", meshed_urdf("f.obj", "")))
    (mended,) = [text for text in told(imported, "mended") if "millimetres" in text]
    assert "f.obj with 40 m" in mended
    assert 'scale="0.001 0.001 0.001"' in mended
    right = import_hand(put(tmp_path / "scaled.urdf", meshed_urdf("f.obj"))).hand
    for a, b in zip(imported.hand.links, right.links, strict=True):
        np.testing.assert_allclose(a.spheres, b.spheres, atol=1e-9)


def test_flat_meshes_get_a_thickness(tmp_path: Path) -> None:
    flat = "v 0 0 0\nv 0.01 0 0\nv 0.01 0 0.04\nv 0 0 0.04\nf 1 2 3\nf 1 3 4"
    put(tmp_path / "f.obj", flat)
    assert shaped(import_hand(put(tmp_path / "claw.urdf", meshed_urdf("f.obj", "")))) == 7


def test_lfs_pointers_are_named_with_their_remedy(tmp_path: Path) -> None:
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1013429\n"
    put(tmp_path / "f.obj", pointer)
    with pytest.raises(HandFileError, match=r"f\.obj.*Git LFS pointer.*git lfs pull"):
        import_hand(put(tmp_path / "claw.urdf", meshed_urdf("f.obj")))
    with pytest.raises(HandFileError, match=r"claw\.xml: is a Git LFS pointer.*git lfs pull"):
        import_hand(put(tmp_path / "claw.xml", pointer))


def test_one_cause_is_told_once(tmp_path: Path) -> None:
    text = meshed_urdf("f.obj").replace('<link name="b0"><visual>', '<link name="b0"><visual/><visual>')
    put(tmp_path / "f.obj", BOX)
    gone = text.replace("f.obj", "gone.obj", 12).replace("gone.obj", "f.obj", 2)
    solid = "<collision><geometry><box size='0.01 0.01 0.04'/></geometry></collision></link>"
    imported = import_hand(put(tmp_path / "claw.urdf", gone.replace("</link>", solid)))
    (warning,) = [text for text in told(imported) if "gone.obj" in text]
    assert "b0, a1, b1" in warning


# ---- MJCF as makers write it


def mjcf(fingers: str, head: str = '<compiler angle="radian"/>', tail: str = "", geoms: str = "") -> str:
    palm = '<geom name="palm" type="box" size="0.015 0.045 0.05" pos="0 0 0.05"/>'
    return f"<mujoco>{head}<worldbody><body name='palm'>{palm}{geoms}{fingers}</body></worldbody>{tail}</mujoco>"


def mjcf_fingers(attributes: str = "", joint_attributes: str = "") -> str:
    text = ""
    box = '<geom type="box" size="0.006 0.006 0.02" pos="0 0 0.02"{}/>'
    for name, x, y, axis in (("a", -0.02, 0.03, "0 1 0"), ("b", -0.02, -0.03, "0 1 0"), ("c", 0.02, 0.0, "0 -1 0")):
        turn = f'axis="{axis}" range="0 1.4" {joint_attributes}'
        text += f'<body name="{name}1" pos="{x} {y} 0.105"><joint name="{name}_mcp" {turn}/>{box.format(attributes)}'
        text += f'<body name="{name}2" pos="0 0 0.04"><joint name="{name}_pip" {turn}/>{box.format("")}</body></body>'
    return text


def test_the_palm_may_stand_in_the_world(tmp_path: Path) -> None:
    floor = '<geom name="floor" type="plane" size="2 2 0.1"/><geom name="wall" type="box" size="2 0.1 1" pos="0 3 0"/>'
    text = (
        mjcf(mjcf_fingers(), geoms=floor)
        .replace("<body name='palm'>", "")
        .replace("</body></worldbody>", "</worldbody>")
    )
    for name, more in (("plain", ""), ("guard", "<body name='guard'><geom size='0.01' pos='0 0 -0.02'/></body>")):
        hand = import_hand(put(tmp_path / f"{name}.xml", text.replace("</worldbody>", more + "</worldbody>"))).hand
        assert len(hand.links[0].geometry) == 1 + bool(more)
        box = hand.links[0].geometry[0]
        assert isinstance(box, Box)
        np.testing.assert_allclose(box.size, [0.03, 0.09, 0.1])


def test_angles_of_a_fragment_are_radians(tmp_path: Path) -> None:
    imported = import_hand(
        put(tmp_path / "r.xml", mjcf(mjcf_fingers(' euler="0 0 1.5707963"', 'limited="true"'), head=""))
    )
    assert {joint.upper for joint in imported.hand.joints} == {1.4}
    (decided,) = [text for text in told(imported, "decided") if "radians" in text]
    assert "by more than 1.4 degrees" in decided
    # Also where a joint may turn twice, and where the file is a part that others include.
    twice = mjcf(mjcf_fingers().replace('range="0 1.4"', 'range="-6.28 6.28"', 1), head="").replace(
        "mujoco>", "mujocoinclude>"
    )
    for text in (twice, twice.replace("<worldbody>", "").replace("</worldbody>", "")):
        assert import_hand(put(tmp_path / "part.xml", text)).hand.joints[1].upper == 1.4
    # Degrees where the file says so, or where they make sense.
    for head, fingers in (
        ('<compiler angle="degree"/>', mjcf_fingers()),
        ("", mjcf_fingers().replace('range="0 1.4"', 'range="0 80"')),
    ):
        imported = import_hand(put(tmp_path / "d.xml", mjcf(fingers, head=head)))
        assert max(joint.upper for joint in imported.hand.joints) in (np.deg2rad(80.0), np.deg2rad(1.4))
        assert not [text for text in told(imported, "decided") if "radians" in text]


TENDON_OF_TWO = '<fixed name="t"><joint joint="a_mcp" coef="0.8"/><joint joint="a_pip" coef="-1"/></fixed>'
TENDONS_OF_ONE = (
    '<fixed name="t"><joint joint="a_mcp" coef="0.5"/></fixed><fixed name="u"><joint joint="a_pip" coef="2"/></fixed>'
)


@pytest.mark.parametrize(
    ("tendons", "equality", "slope", "offset"),
    [
        (TENDON_OF_TWO, '<tendon tendon1="t"/>', 0.8, 0.0),
        (TENDONS_OF_ONE, '<tendon tendon1="u" tendon2="t" polycoef="0.1 3"/>', 0.75, 0.05),
    ],
)
def test_an_equality_of_tendons_couples_two_joints(tmp_path: Path, tendons, equality, slope, offset) -> None:
    drive = "".join(f'<position joint="{name}"/>' for name in ("a_mcp", "b_mcp", "b_pip", "c_mcp", "c_pip"))
    tail = f"<tendon>{tendons}</tendon><equality>{equality}</equality><actuator>{drive}</actuator>"
    imported = import_hand(put(tmp_path / "t.xml", mjcf(mjcf_fingers(), tail=tail)))
    laws = {joint.name: joint.coupling for joint in imported.hand.joints if joint.coupling is not None}
    assert list(laws) == ["a_pip"]
    law = laws["a_pip"]
    assert (law.master, law.multiplier, law.offset) == ("a_mcp", pytest.approx(slope), pytest.approx(offset))
    assert not told(imported)


def test_a_tendon_that_cannot_be_kept_is_told_once(tmp_path: Path) -> None:
    three = "".join(f'<joint joint="{name}" coef="1"/>' for name in ("a_mcp", "a_pip", "b_mcp"))
    along = '<spatial name="s"><site site="p"/><site site="q"/></spatial>'
    drive = "".join(f'<motor joint="{f}_{j}"/>' for f in "abc" for j in ("mcp", "pip")) + '<motor tendon="s"/>'
    tail = f'<tendon><fixed name="t">{three}</fixed>{along}</tendon><equality><tendon tendon1="t"/></equality>'
    imported = import_hand(put(tmp_path / "t.xml", mjcf(mjcf_fingers(), tail=f"{tail}<actuator>{drive}</actuator>")))
    warnings = told(imported)
    assert len(warnings) == 2
    assert "ties 3 joints" in warnings[0]
    assert "'s' along sites" in warnings[1]


def test_contact_bits_rule_out_contact(tmp_path: Path) -> None:
    fingers = mjcf_fingers(' contype="2" conaffinity="2"')
    pairs = import_hand(put(tmp_path / "bits.xml", mjcf(fingers))).hand.ignored_contacts
    assert {("palm", "a1"), ("palm", "b1"), ("palm", "c1"), ("a1", "b2")} <= set(pairs)
    assert ("a1", "b1") not in pairs
    assert ("palm", "a2") not in pairs
    assert not import_hand(put(tmp_path / "one.xml", mjcf(mjcf_fingers()))).hand.ignored_contacts
    # Bits that let no two links touch spare a simulator work; links do not pass through each other for that.
    head = '<compiler angle="radian"/><default><geom contype="1" conaffinity="0"/></default>'
    imported = import_hand(put(tmp_path / "none.xml", mjcf(mjcf_fingers(), head=head)))
    assert not imported.hand.ignored_contacts
    assert [text for text in told(imported, "decided") if "kept apart nevertheless" in text]


# ---- closed loops


def linkage(rocker: float = 0.055, drive: bool = True) -> str:
    """Two four-bar fingers, crank and coupler on one side, a rocker of a given length on the other."""
    text = loops = ""
    for name, m in (("a", 1), ("b", -1)):
        axis = f'axis="{m} 0 0"'
        text += f"""<body name="{name}_crank" pos="0 {0.04 * m} 0.1"><joint name="{name}_drive" {axis} range="0 0.9"/>
          <geom type="capsule" fromto="0 0 0 0 0 0.05" size="0.006"/>
          <body name="{name}_tip" pos="0 0 0.05"><joint name="{name}_tip_j" {axis} range="-1.5 1.5"/>
            <geom type="box" size="0.008 0.005 0.03" pos="0 0 0.03"/></body></body>
          <body name="{name}_rocker" pos="0 {0.02 * m} {0.15 - rocker}">
            <joint name="{name}_rock" {axis} range="-1.5 1.5"/>
            <geom type="capsule" fromto="0 0 0 0 0 {rocker}" size="0.004"/></body>"""
        loops += f'<connect body1="{name}_tip" body2="{name}_rocker" anchor="0 {-0.02 * m} 0"/>'
    drives = '<actuator><position joint="a_drive"/><position joint="b_drive"/></actuator>' if drive else ""
    return mjcf(text, tail=f"<equality>{loops}</equality>{drives}")


@pytest.mark.parametrize("drive", [True, False])
def test_a_four_bar_linkage_becomes_affine_laws(tmp_path: Path, drive: bool) -> None:
    imported = import_hand(put(tmp_path / "bars.xml", linkage(drive=drive)))
    hand = imported.hand
    assert hand.joint_names == ("a_drive", "b_drive")
    assert set(fingers(imported).values()) == {"a_tip", "b_tip"}
    assert len([text for text in told(imported, "decided") if "around a closed loop" in text]) == 2
    # At the ends and in the middle of its range the loop is closed up to the error that was told.
    laws = {joint.name: joint.coupling for joint in hand.joints if joint.coupling is not None}
    law = laws["a_rock"]
    q = np.linspace(*hand.limits[:, 0], 5)
    for value in q:
        rock = law.multiplier * value + law.offset
        tip = laws["a_tip_j"].multiplier * value + laws["a_tip_j"].offset
        crank_end = rotation_about(X, value) @ (0.05 * Z)
        pin = crank_end + rotation_about(X, value + tip) @ (-0.02 * Y)
        rocker_end = np.array([0.0, -0.02, -0.005]) + rotation_about(X, rock) @ (0.055 * Z)
        assert np.linalg.norm(pin - rocker_end) < 5e-3


def test_a_parallelogram_is_exact(tmp_path: Path) -> None:
    hand = import_hand(put(tmp_path / "bars.xml", linkage(rocker=0.05))).hand
    laws = {joint.name: joint.coupling for joint in hand.joints if joint.coupling is not None}
    assert (laws["a_rock"].multiplier, laws["a_rock"].offset) == (pytest.approx(1.0), pytest.approx(0.0, abs=1e-6))
    assert (laws["a_tip_j"].multiplier, laws["a_tip_j"].offset) == (pytest.approx(-1.0), pytest.approx(0.0, abs=1e-6))


def test_a_rod_that_pushes_a_finger_is_none(tmp_path: Path) -> None:
    text = loops = ""
    for name, m in (("a", 1), ("b", -1)):
        axis = f'axis="{m} 0 0"'
        text += f"""<body name="{name}_finger" pos="0 {0.04 * m} 0.1">
          <joint name="{name}_bend" {axis} range="-0.2 1.2"/>
          <geom type="box" size="0.008 0.005 0.04" pos="0 0 0.04"/></body>
          <body name="{name}_rod" pos="0 {0.02 * m} 0.08">
            <joint name="{name}_push" type="slide" axis="0 0 1" range="-0.01 0.02"/>
            <geom type="box" size="0.003 0.003 0.01" contype="0" conaffinity="0"/>
            <body name="{name}_link"><joint name="{name}_pin" {axis} range="-2 2"/>
              <geom type="capsule" fromto="0 0 0 0 {0.02 * m} 0.005" size="0.002"/></body></body>"""
        loops += f'<connect body1="{name}_finger" body2="{name}_link" anchor="0 {-0.004 * m} 0"/>'
    drives = '<actuator><position joint="a_push"/><position joint="b_push"/></actuator>'
    imported = import_hand(put(tmp_path / "rods.xml", mjcf(text, tail=f"<equality>{loops}</equality>{drives}")))
    assert set(fingers(imported).values()) == {"a_finger", "b_finger"}
    assert imported.hand.joint_names == ("a_push", "b_push")


def test_a_loop_that_two_motors_drive_is_left_open_and_told(tmp_path: Path) -> None:
    text = linkage().replace('<position joint="a_drive"/>', '<position joint="a_drive"/><position joint="a_rock"/>')
    imported = import_hand(put(tmp_path / "bars.xml", text))
    (warning,) = [text for text in told(imported) if "loop" in text]
    assert "2 motors drive" in warning
    assert "a_drive" in imported.hand.joint_names
    assert "a_rock" in imported.hand.joint_names


# ---- left and right, and chance


def nested_hand(side: str, *, deep: float = 0.0) -> FileModel:
    """A hand whose proximal links turn inside of the palm."""
    steps = (
        ("hub", X, (0.0, 0.0, -0.02), (-0.25, 0.25)),
        ("prox", Y, (0.0, 0.0, 0.006 - deep), (-0.2, 1.5)),
        ("dist", Y, (0.0, 0.0, 0.04), (0.0, 1.5)),
    )
    return box_hand(steps, side=side)


def as_another_maker(hand: FileModel, seed: int) -> FileModel:
    """The same hand with its links in another order and some of its joints counted the other way round."""
    rng = np.random.default_rng(seed)
    sign = {j.name: -1.0 if rng.random() < 0.5 else 1.0 for j in hand.joints}
    joints = []
    for j in hand.joints:
        s = sign[j.name]
        law = j.mimic and FileMimic(j.mimic.master, s * sign[j.mimic.master] * j.mimic.multiplier, s * j.mimic.offset)
        lower, upper = sorted((s * j.lower, s * j.upper))
        joints.append(replace(j, axis=s * j.axis, lower=lower, upper=upper, mimic=law))
    rng.shuffle(joints)  # pyright: ignore[reportArgumentType]
    return replace(hand, joints=tuple(joints))


@pytest.mark.parametrize("deep", [0.0, 0.004, 0.007, 0.01])
def test_a_hand_and_its_mirror_image_get_the_same_decisions(deep: float) -> None:
    right = interpret(nested_hand("right", deep=deep), name="hand").hand
    values = dict(zip(right.joint_names, right.q_rest, strict=True))
    axes = {j.name: j.axis for j in right.joints}
    for seed in range(3):
        model = as_another_maker(nested_hand("left", deep=deep), seed)
        left = interpret(model, name="hand").hand
        assert left.side == "left"
        assert {frozenset(pair) for pair in left.ignored_contacts} == {frozenset(p) for p in right.ignored_contacts}
        assert len(right.ignored_contacts) in (0, 4)  # Fingers that are alike are judged alike.
        plain = {j.name: j.axis for j in nested_hand("left").joints}
        for name, value in zip(left.joint_names, left.q_rest, strict=True):
            turned = np.sign(plain[name] @ next(j.axis for j in left.joints if j.name == name))
            assert turned * value == pytest.approx(values[name], abs=0.02), name
    assert axes


def held_against_its_mirror_image(hand: Hand, folder: Path) -> None:
    """Imports a hand and its mirror image, the latter as another maker would write it, and compares the decisions."""
    hand = replace(hand, ignored_contacts=())
    right, left = (replace(read_model(export_urdf(h, folder / h.side)), ignored_pairs=()) for h in (hand, mirror(hand)))
    found = interpret(right, name="hand").hand
    other = as_another_maker(left, 0)
    twin = mirror(interpret(other, name="hand").hand)
    assert {frozenset(pair) for pair in twin.ignored_contacts} == {frozenset(pair) for pair in found.ignored_contacts}
    assert [f.name for f in twin.fingers] == [f.name for f in found.fingers]
    np.testing.assert_allclose(twin.R_HB, found.R_HB, atol=1e-3)
    np.testing.assert_allclose(twin.p_HB, found.p_HB, atol=1e-4)
    for a, b in zip(twin.fingers, found.fingers, strict=True):
        np.testing.assert_allclose(a.p_LTip, b.p_LTip, atol=1e-4)
    axes = {j.name: j.axis for j in left.joints}
    sense = {j.name: float(np.sign(j.axis @ axes[j.name])) for j in other.joints}
    values = dict(zip(found.joint_names, found.q_rest, strict=True))
    for name, value in zip(twin.joint_names, twin.q_rest, strict=True):
        assert sense[name] * value == pytest.approx(values[name], abs=0.02), name


@pytest.mark.parametrize("name", list_hands())
def test_so_do_a_hand_of_the_library_and_its_mirror_image(name: str, tmp_path: Path) -> None:
    held_against_its_mirror_image(load_hand(name), tmp_path)


@pytest.mark.parametrize("name", ["allegro", "schunk_svh", "shadow"])
def test_so_do_a_makers_hand_and_its_mirror_image(name: str, reference: Path, tmp_path: Path) -> None:
    path = reference / "hands_reference" / name / f"{name}_hand_right.urdf"
    held_against_its_mirror_image(import_hand(path).hand, tmp_path)


def test_links_that_overlap_in_most_postures_are_warned_of() -> None:
    hand = box_hand()
    guard = FileLink("guard", (), (Box(np.array([0.03, 0.09, 0.05]), np.array([0.045, 0.0, 0.095])),))
    imported = interpret(with_more(hand, [guard], [joint("fixed", "palm", "guard")]), name="hand")
    assert [text for text in told(imported) if "overlap" in text]
