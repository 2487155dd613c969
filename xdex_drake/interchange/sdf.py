"""Writes a hand as an SDFormat file with OBJ meshes, for Gazebo and Drake."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.hand.collision import ignored_pairs
from xdex_drake.hand.description import Convex, Hand, Joint, Link
from xdex_drake.interchange.parts import ModelFile, file_name, hull_obj, marked_frames, number, numbers
from xdex_drake.interchange.urdf import rpy_of, simple_parts

VERSION = "1.9"


def export_sdf(hand: Hand, folder: str | Path) -> Path:
    """Writes NAME.sdf and meshes/*.obj into a folder.

    Names, frames, limits, efforts, couplings and inertias are the hand's; the model's frame is that of the base link.
    Frames `wrist` and `FINGER_tip` mark the wrist frame and the tip points. Coupling laws and pairs of links that may
    not collide are written as Drake reads them (`drake:` elements), which other readers pass over.

    Args:
        hand: The hand.
        folder: The folder; made where it does not exist.

    Returns:
        Path of the file.

    Raises:
        ConfigError: The folder cannot be written.
    """
    return hand_sdf(hand).write(Path(folder) / f"{file_name(hand.name)}.sdf")


def hand_sdf(hand: Hand) -> ModelFile:
    """A hand as SDFormat; see `export_sdf`."""
    root = Element("sdf", {"version": VERSION, "xmlns:drake": "http://drake.mit.edu"})
    model = SubElement(root, "model", {"name": hand.name, "canonical_link": hand.links[0].name})
    meshes: dict[str, str] = {}
    for link, joint in zip(hand.links, (None, *hand.joints), strict=True):
        _add_link(model, link, joint, meshes)
    for joint in hand.joints:
        _add_joint(model, joint)
    for name, link, p, R in marked_frames(hand):
        _add_pose(SubElement(model, "frame", {"name": name, "attached_to": link}), p, R)
    for i, j in ignored_pairs(hand):
        names = [hand.links[k].name for k in (i, j)]
        group = SubElement(model, "drake:collision_filter_group", {"name": "-".join(names)})
        for name in names:
            SubElement(group, "drake:member").text = name
        SubElement(group, "drake:ignored_collision_filter_group").text = "-".join(names)
    indent(root)
    return ModelFile(tostring(root, encoding="unicode") + "\n", meshes)


def _add_pose(element: Element, p: Array, R: Array | None, relative_to: str = "") -> None:
    attributes = {"relative_to": relative_to} if relative_to else {}
    rpy = np.zeros(3) if R is None else rpy_of(R)
    SubElement(element, "pose", attributes).text = numbers(np.concatenate([p, rpy]))


def _add_link(model: Element, link: Link, joint: Joint | None, meshes: dict[str, str]) -> None:
    element = SubElement(model, "link", {"name": link.name})
    if joint is not None:
        _add_pose(element, joint.p_PJ, joint.R_PJ, joint.parent)
    add_inertial(element, link.mass, link.p_LLcm, link.I_LLcm)
    parts = [part for shape in link.geometry for part in simple_parts(shape)]
    for k, (kind, attributes, p, R) in enumerate(parts):
        for role in ("visual", "collision"):
            entry = SubElement(element, role, {"name": f"{link.name}_{role}_{k}"})
            _add_pose(entry, p, R)
            geometry = SubElement(SubElement(entry, "geometry"), kind)
            if isinstance(attributes, Convex):
                name = f"{file_name(link.name)}_{k}.obj"
                meshes[name] = hull_obj(attributes.vertices)
                attributes = {"uri": f"meshes/{name}"}
            for key, value in attributes.items():
                SubElement(geometry, key).text = value


def add_inertial(element: Element, mass: float, p_BBcm: Array, I_BBcm: Array) -> None:
    """Adds mass, center of mass [m] and inertia about it [kg m^2], in the axes of the body."""
    inertial = SubElement(element, "inertial")
    _add_pose(inertial, p_BBcm, None)
    SubElement(inertial, "mass").text = number(mass)
    inertia = SubElement(inertial, "inertia")
    for k, row in enumerate("xyz"):
        for m, column in enumerate("xyz"):
            if k <= m:
                SubElement(inertia, f"i{row}{column}").text = number(I_BBcm[k, m])


def _add_joint(model: Element, joint: Joint) -> None:
    element = SubElement(model, "joint", {"name": joint.name, "type": joint.kind})
    SubElement(element, "parent").text = joint.parent
    SubElement(element, "child").text = joint.child
    axis = SubElement(element, "axis")
    SubElement(axis, "xyz").text = numbers(joint.axis)
    limit = SubElement(axis, "limit")
    # In Drake a joint whose effort limit is zero has no motor.
    effort = joint.effort if joint.coupling is None else 0.0
    for key, value in (("lower", joint.lower), ("upper", joint.upper), ("effort", effort)):
        SubElement(limit, key).text = number(value)
    if joint.coupling is not None:
        law = {"multiplier": number(joint.coupling.multiplier), "offset": number(joint.coupling.offset)}
        SubElement(element, "drake:mimic", {"joint": joint.coupling.master, **law})
