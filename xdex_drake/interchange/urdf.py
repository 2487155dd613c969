"""Writes a hand as a URDF file with OBJ meshes, for other tools."""

from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.collision import ignored_pairs
from xdex_drake.hand.description import Box, Convex, Geometry, Hand, Joint, Link, Sphere
from xdex_drake.hand.looks import surface_obj
from xdex_drake.interchange.parts import file_name, hull_obj, marked_frames, number, numbers

VELOCITY = 10.0
"""Velocity limit that is written for every joint [rad/s or m/s]: the format demands one, and a hand states none."""


def export_urdf(hand: Hand, folder: str | Path, *, wrist_root: bool = False) -> Path:
    """Writes NAME.urdf and meshes/*.obj into a folder.

    Link and joint names, frames, limits, efforts, mimic laws and inertias are the hand's; the base link's frame is B.
    A link `wrist` marks the wrist frame H and links `FINGER_tip` the tip points. A capsule becomes a cylinder with two
    balls, since URDF has none; each convex part is a mesh of its own with normals. Actuated joints have transmissions.
    Pairs of links that may not collide are written for Drake.

    Args:
        hand: The hand.
        folder: The folder; made where it does not exist.
        wrist_root: Whether the link of the wrist frame is the root, for tools that compare poses in the root's frame.

    Returns:
        Path of the URDF file.

    Raises:
        HandFileError: The folder cannot be written.
    """
    folder = Path(folder)
    robot = Element("robot", {"name": hand.name, "xmlns:drake": "http://drake.mit.edu"})
    # MuJoCo looks for meshes in one folder, and drops visual geometry unless told otherwise.
    SubElement(
        SubElement(robot, "mujoco"), "compiler", {"meshdir": "meshes", "strippath": "true", "discardvisual": "false"}
    )
    meshes: dict[str, str] = {}
    marks = marked_frames(hand)
    if wrist_root:
        (wrist, base, *_), *marks = marks
        SubElement(robot, "link", {"name": wrist})
        _add_fixed(robot, f"{wrist}_fixed", wrist, base, hand.p_HB, hand.R_HB)
    for link in hand.links:
        _add_link(robot, link, meshes)
    for joint in hand.joints:
        _add_joint(robot, joint)
    for name in hand.joint_names:
        _add_transmission(robot, name)
    for name, link, p, R in marks:
        SubElement(robot, "link", {"name": name})
        _add_fixed(robot, f"{name}_fixed", link, name, p, R)
    _add_filters(robot, hand)
    indent(robot)
    file = folder / f"{hand.name}.urdf"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if meshes:
            (folder / "meshes").mkdir(exist_ok=True)
        for name, text in meshes.items():
            (folder / "meshes" / name).write_text(text, encoding="ascii")
        ElementTree(robot).write(file, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise HandFileError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from None
    return file


def rpy_of(R: Array) -> Array:
    """Fixed-axis angles (roll, pitch, yaw) with R = Rz Ry Rx [rad], shape (3,); exact also at a pitch of 90 degrees."""
    yaw = np.arctan2(R[1, 0], R[0, 0]) if np.hypot(R[0, 0], R[1, 0]) > 1e-12 else 0.0
    c, s = np.cos(yaw), np.sin(yaw)
    # What is left without the yaw is Ry Rx; an ill-determined yaw is made good by the roll.
    Q = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    return np.array([np.arctan2(-Q[1, 2], Q[1, 1]), np.arctan2(-Q[2, 0], Q[0, 0]), yaw])


def _add_origin(parent: Element, p: Array, R: Array | None = None) -> None:
    origin = SubElement(parent, "origin", {"xyz": numbers(p)})
    if R is not None:
        origin.set("rpy", numbers(rpy_of(R)))


def _add_link(robot: Element, link: Link, meshes: dict[str, str]) -> None:
    element = SubElement(robot, "link", {"name": link.name})
    inertial = SubElement(element, "inertial")
    _add_origin(inertial, link.p_LLcm)
    SubElement(inertial, "mass", {"value": number(link.mass)})
    moments = {
        f"i{row}{column}": number(link.I_LLcm[k, m])
        for k, row in enumerate("xyz")
        for m, column in enumerate("xyz")
        if k <= m
    }
    SubElement(inertial, "inertia", moments)
    parts = [part for shape in link.geometry for part in simple_parts(shape)]
    for k, (kind, attributes, p, R) in enumerate(parts):
        if isinstance(attributes, Convex):
            name = f"{file_name(link.name)}_{k}.obj"
            meshes[name] = hull_obj(attributes.vertices)
            attributes = {"filename": f"meshes/{name}"}
        for role in ("collision",) if link.surfaces else ("visual", "collision"):
            entry = SubElement(element, role, {"name": f"{link.name}_{role}_{k}"})
            _add_origin(entry, p, R)
            SubElement(SubElement(entry, "geometry"), kind, attributes)
    for k, surface in enumerate(link.surfaces):
        name = f"{file_name(link.name)}_look_{k}.obj"
        meshes[name] = surface_obj([surface])
        entry = SubElement(element, "visual", {"name": f"{link.name}_visual_{k}"})
        SubElement(SubElement(entry, "geometry"), "mesh", {"filename": f"meshes/{name}"})
        material = SubElement(entry, "material", {"name": f"{link.name}_color_{k}"})
        SubElement(material, "color", {"rgba": numbers(np.array([*surface.color, 1.0]))})


def simple_parts(shape: Geometry) -> list[tuple[str, dict[str, str] | Convex, Array, Array | None]]:
    """A primitive as URDF's shapes: element, attributes, and pose in L."""
    if isinstance(shape, Sphere):
        return [("sphere", {"radius": number(shape.radius)}, shape.center, None)]
    if isinstance(shape, Box):
        return [("box", {"size": numbers(shape.size)}, shape.p_LG, shape.R_LG)]
    if isinstance(shape, Convex):
        return [("mesh", shape, np.zeros(3), None)]
    balls = [simple_parts(Sphere(p, shape.radius))[0] for p in (shape.p0, shape.p1)]
    d = shape.p1 - shape.p0
    length = float(np.linalg.norm(d))
    if length < 1e-9:
        return balls[:1]
    attributes = {"radius": number(shape.radius), "length": number(length)}
    return [("cylinder", attributes, 0.5 * (shape.p0 + shape.p1), _rotation_to(d / length)), *balls]


def _rotation_to(z: Array) -> Array:
    """A rotation whose third column is a unit vector."""
    across = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x = across / float(np.linalg.norm(across))
    return np.array([x, np.cross(z, x), z], dtype=np.float64).T


def _add_joint(robot: Element, joint: Joint) -> None:
    element = SubElement(robot, "joint", {"name": joint.name, "type": joint.kind})
    _add_origin(element, joint.p_PJ, joint.R_PJ)
    SubElement(element, "parent", {"link": joint.parent})
    SubElement(element, "child", {"link": joint.child})
    SubElement(element, "axis", {"xyz": numbers(joint.axis)})
    limits = {"lower": joint.lower, "upper": joint.upper, "effort": joint.effort, "velocity": VELOCITY}
    SubElement(element, "limit", {key: number(value) for key, value in limits.items()})
    if joint.coupling is not None:
        law = {"multiplier": number(joint.coupling.multiplier), "offset": number(joint.coupling.offset)}
        SubElement(element, "mimic", {"joint": joint.coupling.master, **law})


def _add_fixed(robot: Element, name: str, parent: str, child: str, p: Array, R: Array) -> None:
    fixed = SubElement(robot, "joint", {"name": name, "type": "fixed"})
    _add_origin(fixed, p, R)
    SubElement(fixed, "parent", {"link": parent})
    SubElement(fixed, "child", {"link": child})


def _add_transmission(robot: Element, joint: str) -> None:
    """A motor without gear, which ROS and Drake ask for."""
    element = SubElement(robot, "transmission", {"name": f"{joint}_transmission"})
    SubElement(element, "type").text = "transmission_interface/SimpleTransmission"
    held = SubElement(element, "joint", {"name": joint})
    SubElement(held, "hardwareInterface").text = "hardware_interface/EffortJointInterface"
    actuator = SubElement(element, "actuator", {"name": f"{joint}_motor"})
    SubElement(actuator, "mechanicalReduction").text = "1"


def _add_filters(robot: Element, hand: Hand) -> None:
    """One group for each link that has a partner it may not collide with."""
    pairs = list(ignored_pairs(hand))
    for k in sorted({k for pair in pairs for k in pair}):
        name = hand.links[k].name
        group = SubElement(robot, "drake:collision_filter_group", {"name": f"only_{name}"})
        SubElement(group, "drake:member", {"link": name})
        for i, j in pairs:
            if i == k:
                ignored = {"name": f"only_{hand.links[j].name}"}
                SubElement(group, "drake:ignored_collision_filter_group", ignored)
