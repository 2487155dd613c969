"""Writes an object alone, as URDF, SDFormat or MJCF: it shows its mesh and collides by its convex parts."""

from __future__ import annotations

from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from xdex_drake.interchange.mjcf import object_mjcf
from xdex_drake.interchange.parts import ModelFile, file_name, hull_obj, number, numbers
from xdex_drake.interchange.sdf import VERSION, add_inertial
from xdex_drake.scene.bodies import visual_obj
from xdex_drake.scene.materials import object_color
from xdex_drake.scene.object import ObjectModel

ObjectFormat = Literal["urdf", "sdf", "mjcf"]


def export_object(thing: ObjectModel, folder: str | Path, *, format: ObjectFormat = "urdf") -> Path:
    """Writes NAME.urdf, NAME.sdf or NAME.xml (MJCF) and meshes/*.obj into a folder.

    The model's frame is O, that of the mesh file, in metres; mass, center of mass and inertia are the object's.

    Args:
        thing: The object.
        folder: The folder; made where it does not exist.
        format: The format.

    Returns:
        Path of the main file.

    Raises:
        ConfigError: The folder cannot be written.
    """
    write = {"urdf": object_urdf, "sdf": object_sdf, "mjcf": object_mjcf}[format]
    return write(thing).write(Path(folder) / f"{file_name(thing.name)}.{'xml' if format == 'mjcf' else format}")


def _meshes(thing: ObjectModel) -> dict[str, str]:
    """The mesh first, then the convex parts, by their files' names."""
    name = file_name(thing.name)
    parts = {f"{name}_part_{k}.obj": hull_obj(vertices) for k, (vertices, _) in enumerate(thing.parts)}
    return {f"{name}.obj": visual_obj(thing), **parts}


def object_urdf(thing: ObjectModel) -> ModelFile:
    """An object as URDF; see `export_object`."""
    root = Element("robot", {"name": thing.name, "xmlns:drake": "http://drake.mit.edu"})
    link = SubElement(root, "link", {"name": thing.name})
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", {"xyz": numbers(thing.p_OOcm)})
    SubElement(inertial, "mass", {"value": number(thing.mass)})
    moments = {f"i{'xyz'[k]}{'xyz'[m]}": number(thing.I_OcmO[k, m]) for k in range(3) for m in range(k, 3)}
    SubElement(inertial, "inertia", moments)
    meshes = _meshes(thing)
    for k, name in enumerate(meshes):
        element = SubElement(link, "visual" if k == 0 else "collision", {"name": Path(name).stem})
        SubElement(SubElement(element, "geometry"), "mesh", {"filename": f"meshes/{name}"}).extend(
            [Element("drake:declare_convex")] if k else []
        )
        if k == 0:
            color = SubElement(element, "material", {"name": "object"})
            SubElement(color, "color", {"rgba": numbers(np.array([*object_color(thing.name), 1.0]))})
        else:
            properties = SubElement(element, "drake:proximity_properties")
            SubElement(properties, "drake:mu_static", {"value": number(thing.friction)})
            SubElement(properties, "drake:mu_dynamic", {"value": number(thing.friction)})
    indent(root)
    return ModelFile(tostring(root, encoding="unicode") + "\n", meshes)


def object_sdf(thing: ObjectModel) -> ModelFile:
    """An object as SDFormat; see `export_object`."""
    root = Element("sdf", {"version": VERSION, "xmlns:drake": "http://drake.mit.edu"})
    link = SubElement(SubElement(root, "model", {"name": thing.name}), "link", {"name": thing.name})
    add_inertial(link, thing.mass, thing.p_OOcm, thing.I_OcmO)
    meshes = _meshes(thing)
    for k, name in enumerate(meshes):
        element = SubElement(link, "visual" if k == 0 else "collision", {"name": Path(name).stem})
        mesh = SubElement(SubElement(element, "geometry"), "mesh")
        SubElement(mesh, "uri").text = f"meshes/{name}"
        if k == 0:
            SubElement(SubElement(element, "material"), "diffuse").text = numbers(
                np.array([*object_color(thing.name), 1.0])
            )
        else:
            SubElement(mesh, "drake:declare_convex")
            friction = SubElement(SubElement(SubElement(element, "surface"), "friction"), "ode")
            SubElement(friction, "mu").text = SubElement(friction, "mu2").text = number(thing.friction)
    indent(root)
    return ModelFile(tostring(root, encoding="unicode") + "\n", meshes)
