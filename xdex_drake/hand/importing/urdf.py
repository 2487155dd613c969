"""Reads URDF files: links, joints, mimic laws, meshes; nothing is decided here."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Box, Capsule, Sphere
from xdex_drake.hand.importing.mesh_files import Allowed, MeshFiles, MissingMesh, ellipsoid, notes_of_lost, placed
from xdex_drake.hand.importing.model import (
    Cylinder,
    FileGeometry,
    FileInertia,
    FileJoint,
    FileLink,
    FileMimic,
    FileModel,
    TriangleMesh,
    color_of,
)
from xdex_drake.hand.importing.tree import as_one_tree, check_mimics
from xdex_drake.hand.importing.xml_file import Element, Place, check_names, read_xml
from xdex_drake.hand.yaml_file import rpy_matrix

WHAT = "a URDF file of one hand"
MAX_PAIRS = 10_000
KINDS = ("revolute", "continuous", "prismatic", "fixed")


def read_urdf(path: str | Path, allowed: Allowed | None = None) -> FileModel:
    """Reads a URDF file.

    Meshes (OBJ, STL, PLY, OFF, glTF, COLLADA) are read from the hand's folder only, see `mesh_files`; one that is
    missing or broken is told with its link, not an error.

    Args:
        path: The file.
        allowed: What may be read besides the hand's folder.

    Returns:
        The robot as the file has it.

    Raises:
        HandFileError: The file is not a URDF file, is not one tree of links, or leads out of the hand's folder; the
            message names file, element and remedy.
    """
    path = Path(path)
    root = read_xml(path, WHAT)
    _refuse_xacro(root, path)
    if root.tag != "robot":
        raise HandFileError(f"{path}: its root element is <{root.tag[:40]}>, not <robot>; give {WHAT}")
    source = str(path)
    notes: list[str] = []
    links, joints = _named(root, "link", source), _named(root, "joint", source)
    if not links:
        raise HandFileError(f"{path}: has no links; give {WHAT}")
    meshes = MeshFiles(path, allowed)
    palette = _palette(root)
    file_links = tuple(_link(name, place, meshes, notes, palette) for name, place in links.items())
    file_joints = tuple(
        joint for name, place in joints.items() if (joint := _joint(name, place, links, notes)) is not None
    )
    check_mimics(file_joints, source)
    file_links, file_joints = as_one_tree(source, file_links, file_joints, notes)
    pairs = _filtered(root, {link.name for link in file_links})
    name = root.get("name") or path.stem
    return FileModel(
        name,
        source,
        file_links,
        file_joints,
        pairs,
        (*dict.fromkeys(notes), *notes_of_lost(file_links)),
        meshes.decisions,
    )


def _refuse_xacro(root: Element, path: Path) -> None:
    for element in root.iter():
        if element.tag.startswith("xacro:") or any("${" in v or "$(" in v for v in element.attrib.values()):
            raise HandFileError(
                f"{path}: is a xacro file (it holds <{element.tag[:40]}> or ${{...}}); expand it first: "
                f"`xacro {path.name} > hand.urdf`"
            )


def _named(root: Element, tag: str, source: str) -> dict[str, Place]:
    places = [Place(element, source, f"a {tag}") for element in root.findall(tag)]
    names = [place.text("name") for place in places]
    check_names(names, tag, source)
    return {name: Place(p.element, source, f"{tag} {name!r}") for name, p in zip(names, places, strict=True)}


def _filtered(root: Element, names: set[str]) -> tuple[tuple[str, str], ...]:
    """Pairs of links that Drake's collision filter groups keep from colliding."""
    members: dict[str, list[str]] = {}
    ignored: list[tuple[str, str]] = []
    for group in root.findall("drake:collision_filter_group"):
        name = group.get("name", "")
        members[name] = [k for m in group.findall("drake:member") if (k := m.get("link", "")) in names]
        ignored += [(name, other.get("name", "")) for other in group.findall("drake:ignored_collision_filter_group")]
    pairs: dict[tuple[str, str], None] = {}
    for first, second in ignored:
        for a in members.get(first, ()):
            for b in members.get(second, ()):
                if a != b:
                    pairs[min(a, b), max(a, b)] = None
                if len(pairs) > MAX_PAIRS:
                    return tuple(pairs)
    return tuple(pairs)


def _pose(place: Place | None) -> tuple[Array, Array]:
    """Rotation and position of an `<origin>`; the identity where there is none."""
    if place is None:
        return np.eye(3), np.zeros(3)
    return rpy_matrix(place.numbers("rpy", 3, np.zeros(3))), place.numbers("xyz", 3, np.zeros(3))


def _palette(root: Element) -> dict[str, Element]:
    """The `<color>` of each material that has a name."""
    colors = {}
    for material in root.iter("material"):
        color = material.find("color")
        if color is not None and (name := material.get("name")):
            colors[name] = color
    return colors


def _color(part: Place, palette: dict[str, Element]) -> tuple[float, float, float] | None:
    """Color of a shape: its material's own, or the one that its name stands for; None where there is none."""
    material = part.element.find("material")
    if material is None:
        return None
    color = material.find("color")
    color = palette.get(material.get("name", "")) if color is None else color
    return None if color is None else color_of(color.get("rgba", ""))


def _link(name: str, place: Place, meshes: MeshFiles, notes: list[str], palette: dict[str, Element]) -> FileLink:
    shapes: dict[str, list[FileGeometry]] = {"visual": [], "collision": []}
    lost: dict[str, None] = {}
    for kind, mine in shapes.items():
        for element in place.element.findall(kind):
            part = Place(element, place.source, f"<{kind}> of {place.place}")
            try:
                shape = _shape(part, meshes, notes)
            except MissingMesh as cause:
                lost[str(cause)] = None
                continue
            if isinstance(shape, TriangleMesh):
                shape = replace(shape, color=_color(part, palette))
            if shape is not None:
                mine.append(shape)
    return FileLink(name, tuple(shapes["visual"]), tuple(shapes["collision"]), _inertia(place, notes), tuple(lost))


def _inertia(place: Place, notes: list[str]) -> FileInertia | None:
    inertial = place.child("inertial")
    if inertial is None:
        return None
    mass = inertial.child("mass")
    if mass is None:
        notes.append(f"{place.place} has an <inertial> without mass, which is left out")
        return None
    R_LI, p_LLcm = _pose(inertial.child("origin"))
    moments = inertial.child("inertia")
    I_I = np.zeros((3, 3))
    if moments is not None:
        for k, row in enumerate("xyz"):
            for m, column in enumerate("xyz"):
                if k <= m:
                    I_I[k, m] = I_I[m, k] = moments.number(f"i{row}{column}", 0.0)
    return FileInertia(mass.number("value"), p_LLcm, R_LI @ I_I @ R_LI.T)


def _shape(place: Place, meshes: MeshFiles, notes: list[str]) -> FileGeometry | None:
    geometry = place.child("geometry")
    if geometry is None or len(geometry.element) == 0:
        notes.append(f"{place.place} is empty")
        return None
    element = geometry.element[0]
    shape = Place(element, place.source, f"<{element.tag[:40]}> of {place.place}")
    R_LG, p_LG = _pose(place.child("origin"))
    kind = element.tag.removeprefix("drake:")
    if kind == "mesh":
        scale = shape.list_of_numbers("scale")
        if len(scale) not in (0, 1, 3):
            raise shape.fail(f"has {len(scale)} scale factors", "give one or three")
        mesh = meshes.read(shape.text("filename"), np.ones(3) if len(scale) == 0 else np.ones(3) * scale)
        return placed(mesh, R_LG, p_LG)
    if kind == "box":
        return Box(_positive(shape, shape.numbers("size", 3)), p_LG, R_LG)
    if kind == "sphere":
        return Sphere(p_LG, float(_positive(shape, shape.number("radius"))))
    if kind in ("cylinder", "capsule"):
        radius = float(_positive(shape, shape.number("radius")))
        half = 0.5 * float(_positive(shape, shape.number("length"))) * R_LG[:, 2]
        return (Cylinder if kind == "cylinder" else Capsule)(p_LG - half, p_LG + half, radius)
    if kind == "ellipsoid":
        return placed(ellipsoid(_positive(shape, np.array([shape.number(k) for k in "abc"]))), R_LG, p_LG)
    raise shape.fail("is no shape that is known", "use mesh, box, sphere, cylinder or capsule")


def _positive(place: Place, size: Array | float) -> Array:
    if (np.asarray(size) <= 0.0).any():
        raise place.fail(f"has the size {np.asarray(size).tolist()}", "give sizes greater than zero")
    return np.asarray(size, dtype=np.float64)


def _joint(name: str, place: Place, links: dict[str, Place], notes: list[str]) -> FileJoint | None:
    kind = place.text("type")
    ends = {}
    for end in ("parent", "child"):
        element = place.child(end)
        if element is None:
            raise place.fail(f"has no <{end}>", f'add <{end} link="..."/>')
        ends[end] = element.text("link")
        if ends[end] not in links:
            raise place.fail(f"names the {end} {ends[end]!r}, which is no link", "name one of the file's links")
    if kind == "floating":
        notes.append(f"{place.place}, a floating joint, is left out: a hand's base is always free")
        return None
    if kind not in KINDS:
        raise place.fail(f"is of the type {kind[:40]!r}", f"only {', '.join(KINDS)} joints can be imported")
    R_PJ, p_PJ = _pose(place.child("origin"))
    axis = np.array([1.0, 0.0, 0.0])
    if kind != "fixed" and (element := place.child("axis")) is not None:
        axis = element.numbers("xyz", 3, axis)
        if np.linalg.norm(axis) < 1e-9:
            raise element.fail("is zero", "give the direction that the joint turns about or slides along")
    lower, upper, effort = -np.inf, np.inf, None
    limit = place.child("limit")
    if limit is not None and kind != "fixed":
        if kind != "continuous":
            lower = limit.number("lower", 0.0, allow_infinite=True)
            upper = limit.number("upper", 0.0, allow_infinite=True)
        effort = limit.number("effort", np.nan, allow_infinite=True)
        effort = None if not np.isfinite(effort) else effort
    mimic = None
    if (law := place.child("mimic")) is not None:
        if kind == "fixed":
            notes.append(f"{place.place} is fixed; its <mimic> is left out")
        else:
            mimic = FileMimic(law.text("joint"), law.number("multiplier", 1.0), law.number("offset", 0.0))
    return FileJoint(name, kind, ends["parent"], ends["child"], p_PJ, R_PJ, axis, lower, upper, effort, mimic)
