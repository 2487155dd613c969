"""Reads MJCF, the format of MuJoCo, without MuJoCo: bodies, joints, geoms, couplings, actuators.

What differs from other formats is brought into theirs: a body with several joints becomes a chain of links, a link's
frame lies at its joint, joint values count as in the file (`ref` included), `<equality>` of two joints, or of fixed
tendons over two joints, becomes a mimic law, `<connect>` and `<weld>` become points that coincide. Other tendons, sites
and sensors are left out.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

import numpy as np
from scipy.spatial.transform import Rotation

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Box, Capsule, Sphere
from xdex_drake.hand.importing.decisions import Decision, join
from xdex_drake.hand.importing.mesh_files import Allowed, MeshFiles, MissingMesh, ellipsoid, notes_of_lost, placed
from xdex_drake.hand.importing.model import (
    Cylinder,
    FileGeometry,
    FileInertia,
    FileJoint,
    FileLink,
    FileLoop,
    FileMimic,
    FileModel,
    TriangleMesh,
    color_of,
)
from xdex_drake.hand.importing.tree import as_one_tree, check_mimics
from xdex_drake.hand.importing.xml_file import MAX_BYTES, MAX_ELEMENTS, Element, Place, check_names, read_xml

WHAT = "an MJCF file of one hand"
ROOTS = ("mujoco", "mujocoinclude")
MAX_INCLUDES = 50
ACTUATORS = ("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle", "dcmotor")
UNSUPPORTED = ("attach", "replicate", "composite", "flexcomp")
WORLD = "world"

MOST_TURN_OF_DEGREES = 1.01 * np.deg2rad(4.0 * np.pi)
"""Greatest range of a hand whose joint limits were meant in radians, two turns at most, and taken as degrees."""

SCENERY = 0.5
"""A geom of the world that is longer than this is a floor, a wall or a table, not a part of the hand [m]."""

Pose = tuple[Array, Array]
"""Rotation matrix, shape (3, 3), and position [m], shape (3,)."""


def read_mjcf(path: str | Path, allowed: Allowed | None = None) -> FileModel:
    """Reads an MJCF file and the files that it includes.

    Included files and meshes are read from the hand's folder only, see `mesh_files`. Geoms that collide with nothing
    (contype and conaffinity zero) are visual, the others collision geometry, and visual too where a body has no other.
    Where the file does not say in which unit its angles are, MuJoCo takes degrees; here they are radians if no joint
    could turn otherwise, as in files that are made to be included.

    Args:
        path: The file.
        allowed: What may be read besides the hand's folder.

    Returns:
        The robot as the file has it.

    Raises:
        HandFileError: The file is not an MJCF file, holds no jointed body, uses an element whose meaning cannot be
            kept, or leads out of the hand's folder; the message names file, element and remedy.
    """
    path = Path(path)
    root = read_xml(path, WHAT)
    if root.tag not in ROOTS:
        raise HandFileError(f"{path}: its root element is <{root.tag[:40]}>, not <mujoco>; give {WHAT}")
    meshes = MeshFiles(path, allowed)
    _Includes(path, meshes).expand(root, meshes.folder, 0)
    if bodies := root.findall("body"):  # A fragment that others include within their <worldbody>.
        world = Element("worldbody")
        world.extend(bodies)
        root.append(world)
    reader = _Reader(path, root, meshes)
    model = reader.model()
    turns = [j.upper - j.lower for j in reader.joints if j.kind == "revolute" and np.isfinite(j.upper - j.lower)]
    if reader.compiler.angle is not None or not turns or max(turns) > MOST_TURN_OF_DEGREES:
        return model
    text = (
        "its angles are taken as radians, for in degrees, as MuJoCo takes them where the file does not say, no joint "
    )
    text += f'would turn by more than {np.degrees(max(turns)):.1f} degrees; <compiler angle="..."/> would say.'
    model = _Reader(path, root, meshes, angle="radian").model()
    return replace(model, decisions=(Decision("decided", "file", text), *model.decisions))


class _Includes:
    """Puts included files in the place of their `<include>` elements."""

    def __init__(self, path: Path, meshes: MeshFiles) -> None:
        self.path, self.meshes = path, meshes
        self.seen = {path.resolve()}
        self.bytes_left, self.elements_left = MAX_BYTES, MAX_ELEMENTS

    def expand(self, element: Element, folder: Path, depth: int) -> None:
        children = []
        for child in element:
            if child.tag != "include":
                self.expand(child, folder, depth)
                children.append(child)
                continue
            name = Place(child, str(self.path), "<include>").text("file")
            file = self._locate(name, folder)
            if file in self.seen:
                raise HandFileError(f"{self.path}: includes {name[:200]!r} twice, or in a circle; include it once")
            if len(self.seen) > MAX_INCLUDES:
                raise HandFileError(f"{self.path}: includes more than {MAX_INCLUDES} files; join them")
            self.seen.add(file)
            self.bytes_left -= file.stat().st_size
            if self.bytes_left < 0:
                raise HandFileError(f"{self.path}: its included files have more than {MAX_BYTES} bytes; shorten them")
            included = read_xml(file, WHAT, max_elements=self.elements_left)
            self.elements_left -= sum(1 for _ in included.iter())
            self.expand(included, file.parent, depth + 1)
            children.extend(included)
        element[:] = children

    def _locate(self, name: str, folder: Path) -> Path:
        for start in (self.meshes.folder, folder):
            try:
                return self.meshes.locate(name, folder=start)
            except MissingMesh:
                continue
        raise HandFileError(f"{self.path}: includes {name[:200]!r}, which does not exist; put that file beside it")


@dataclass
class _Compiler:
    """The settings of `<compiler>` that change what other elements mean."""

    angle: str | None = None
    eulerseq: str = "xyz"
    meshdir: str = ""
    strippath: bool = False
    autolimits: bool = True
    inertia_from_geoms: bool = False

    @property
    def unit(self) -> float:
        """The file's unit of angles [rad]."""
        return 1.0 if self.angle == "radian" else np.pi / 180.0

    def read(self, place: Place) -> None:
        element = place.element
        if element.get("coordinate", "local") != "local":
            raise place.fail("uses global coordinates", "save the file anew by a MuJoCo before 2.3.4")
        self.angle = element.get("angle", self.angle)
        if self.angle not in (None, "degree", "radian"):
            raise place.fail(f"has angle={self.angle[:40]!r}", "write degree or radian")
        self.eulerseq = element.get("eulerseq", self.eulerseq)
        if len(self.eulerseq) != 3 or set(self.eulerseq.lower()) - set("xyz"):
            raise place.fail(f"has eulerseq={self.eulerseq[:40]!r}", "write three of x, y, z")
        self.meshdir = element.get("meshdir", element.get("assetdir", self.meshdir))
        self.strippath = element.get("strippath", str(self.strippath)).lower() == "true"
        self.autolimits = element.get("autolimits", str(self.autolimits)).lower() == "true"
        self.inertia_from_geoms = element.get("inertiafromgeom", str(self.inertia_from_geoms)).lower() == "true"


@dataclass
class _Body:
    """A link in the making.

    Attributes:
        name: Name of the link.
        X_LB: Pose of the body's frame in the link's, which lies at the body's last joint.
        X_WB: Pose of the body's frame in the world, all joints at their reference values.
        visual: Geoms that collide with nothing.
        collision: Geoms that collide.
        bits: The different pairs (contype, conaffinity) of the geoms that collide.
        inertia: As the file gives it.
        lost: Why geoms could not be read.
    """

    name: str
    X_LB: Pose
    X_WB: Pose = field(default_factory=lambda: _shift(np.zeros(3)))
    visual: list[FileGeometry] = field(default_factory=list)
    collision: list[FileGeometry] = field(default_factory=list)
    bits: set[tuple[int, int]] = field(default_factory=set)
    inertia: FileInertia | None = None
    lost: list[str] = field(default_factory=list)

    def link(self) -> FileLink:
        lost = tuple(dict.fromkeys(self.lost))
        return FileLink(self.name, tuple(self.visual or self.collision), tuple(self.collision), self.inertia, lost)


def _times(X: Pose, Y: Pose) -> Pose:
    return X[0] @ Y[0], X[0] @ Y[1] + X[1]


def _shift(p: Array) -> Pose:
    return np.eye(3), np.asarray(p, dtype=np.float64)


class _Reader:
    """One reading of one file; `model` is its only use."""

    def __init__(self, path: Path, root: Element, meshes: MeshFiles, *, angle: str | None = None) -> None:
        self.source, self.root, self.meshes, self.path = str(path), root, meshes, path
        self.notes: list[str] = []
        self.decisions: list[Decision] = []
        self.compiler = _Compiler()
        for element in root.findall("compiler"):
            self.compiler.read(Place(element, self.source, "<compiler>"))
        self.compiler.angle = angle or self.compiler.angle
        self.defaults: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        for element in root.findall("default"):
            self._read_defaults(element, "main", "main")
        self.assets = {name: place for name, place in self._assets()}
        self.materials = {element.get("name", ""): element for element in self.root.iter("material")}
        self.bodies: list[_Body] = []
        self.joints: list[FileJoint] = []
        self.refs: dict[str, float] = {}
        self.told_tendons: set[str] = set()

    def model(self) -> FileModel:
        source = self.source
        tops = [p for element in self.root.findall("worldbody") for p in self._children(element, "main", ("body",))]
        if not tops:
            raise HandFileError(f"{source}: has no bodies; give {WHAT}")
        jointed = [top for top in tops if any(j.get("type") != "free" for j in top[0].element.iter("joint"))]
        if not jointed:
            raise HandFileError(f"{source}: has no joints; give {WHAT}")
        # The world is a link of its own only where joints or several bodies hang on it.
        to_world = len(jointed) > 1 or any(True for _ in self._joints_of(jointed[0][0].element, "main"))
        if to_world:
            self.bodies.append(_Body(WORLD, _shift(np.zeros(3))))
            self._read_world(self.bodies[0])
        fixed = [top for top in tops if to_world and top not in jointed and not _is_free(top[0].element)]
        if len(jointed) + len(fixed) < len(tops):
            loose = [top[0].place for top in tops if top not in jointed and top not in fixed]
            self.notes.append(f"{join(loose, 3)} of the world, which no joint ties to the hand, left out")
        for place, X_WF, childclass in tops:
            if (place, X_WF, childclass) in jointed or (place, X_WF, childclass) in fixed:
                self._read_body(place, X_WF, childclass, self.bodies[0] if to_world else None)
        check_names([body.name for body in self.bodies], "link", source)
        check_names([joint.name for joint in self.joints], "joint", source)
        joints = self._with_actuators(self._with_equalities(tuple(self.joints)))
        check_mimics(joints, source)
        links, joints = as_one_tree(source, tuple(body.link() for body in self.bodies), joints, self.notes)
        name = self.root.get("model") or self.path.stem
        return FileModel(
            name,
            source,
            links,
            joints,
            (*self._excluded(), *self._kept_apart_by_bits()),
            (*dict.fromkeys(self.notes), *notes_of_lost(links)),
            (*self.meshes.decisions, *self.decisions),
            tuple(self._loops()),
        )

    def _read_world(self, world: _Body) -> None:
        """The world's own geoms, among them the base of a hand that is fixed there; scenery is left out."""
        large = []
        for element in self.root.findall("worldbody"):
            for geom, X_WF, inner in self._children(element, "main", ("geom",)):
                before = len(world.visual), len(world.collision)
                self._read_geom(self._complete(geom.element, inner, f"{geom.place} of the world"), X_WF, world)
                for shapes, count in zip((world.visual, world.collision), before, strict=True):
                    if len(shapes) > count and _extent(shapes[-1]) > SCENERY:
                        shapes.pop()
                        large.append(geom.place)
        if large:
            self.notes.append(f"of the world's geoms {join(large)}, longer than {SCENERY:g} m, left out as scenery")

    # ---- defaults

    def _read_defaults(self, element: Element, name: str, parent: str) -> None:
        table = self.defaults.setdefault(name, {tag: dict(v) for tag, v in self.defaults[parent].items()})
        for child in element:
            if child.tag != "default":
                # All kinds of actuators share one set of defaults.
                tag = "actuator" if child.tag in ACTUATORS else child.tag
                table.setdefault(tag, {}).update(child.attrib)
        for child in element.findall("default"):
            nested = Place(child, self.source, f"<default> within {name!r}").text("class")
            if nested in self.defaults and nested != "main":
                raise HandFileError(f"{self.source}: defines the default class {nested!r} twice; rename one")
            self._read_defaults(child, nested, name)

    def _complete(self, element: Element, childclass: str, place: str) -> Place:
        """An element with the attributes of its default class filled in."""
        name = element.get("class", childclass)
        if name not in self.defaults:
            raise HandFileError(
                f"{self.source}: {place} is of the class {name!r}, which no <default> defines; define it, or "
                "give the file that includes this one"
            )
        tag = "actuator" if element.tag in ACTUATORS else element.tag
        return Place(Element(element.tag, {**self.defaults[name].get(tag, {}), **element.attrib}), self.source, place)

    def _assets(self) -> Iterator[tuple[str, Place]]:
        for section in self.root.findall("asset"):
            for element in section.findall("mesh"):
                place = self._complete(element, "main", "a mesh asset")
                name = place.element.get("name") or PurePosixPath(place.element.get("file", "mesh")).stem
                yield name, Place(place.element, self.source, f"mesh {name!r}")

    # ---- bodies

    def _children(self, element: Element, childclass: str, tags: tuple[str, ...]) -> Iterator[tuple[Place, Pose, str]]:
        """Children with some tags, through `<frame>` elements: each with its frame's pose in the body, and class."""
        for child in element:
            if child.tag in UNSUPPORTED:
                raise HandFileError(
                    f"{self.source}: uses <{child.tag}>, which is not read; save the compiled model from MuJoCo "
                    "(mj_saveLastXML) and import that"
                )
            if child.tag in tags:
                label = f"{child.tag} {child.get('name')!r}" if child.get("name") else f"a {child.tag}"
                yield Place(child, self.source, label), _shift(np.zeros(3)), childclass
            elif child.tag == "frame":
                X_BF = self._pose(Place(child, self.source, "a frame"))
                for place, X_FC, inner in self._children(child, child.get("childclass", childclass), tags):
                    yield place, _times(X_BF, X_FC), inner

    def _joints_of(self, element: Element, childclass: str) -> Iterator[tuple[Place, Pose, str]]:
        for place, X_BF, inner in self._children(element, childclass, ("joint",)):
            complete = self._complete(place.element, inner, place.place)
            if complete.element.get("type") != "free":
                yield complete, X_BF, inner

    def _read_body(self, place: Place, X_PF: Pose, childclass: str, parent: _Body | None) -> None:
        element = place.element
        name = element.get("name") or f"body_{len(self.bodies)}"
        place = Place(element, self.source, f"body {name!r}")
        childclass = element.get("childclass", childclass)
        joints = list(self._joints_of(element, childclass))
        if element.find("freejoint") is not None or len(joints) < len(element.findall("joint")):
            self.notes.append(f"{place.place} has a free joint, which is left out: a hand's base is always free")
        body = _Body(name, _shift(np.zeros(3)))
        X_PB = _times(X_PF, self._pose(place))
        X_WB = X_PB
        if parent is not None:
            X_WB = _times(parent.X_WB, X_PB)
            body = self._attach(body, joints, parent, _times(parent.X_LB, X_PB))
        body.X_WB = X_WB
        self.bodies.append(body)
        body.inertia = self._inertia(place, body)
        for geom, X_BF, inner in self._children(element, childclass, ("geom",)):
            self._read_geom(self._complete(geom.element, inner, f"{geom.place} of {place.place}"), X_BF, body)
        for child, X_BF, inner in self._children(element, childclass, ("body",)):
            self._read_body(child, X_BF, inner, body)

    def _attach(self, body: _Body, joints: list[tuple[Place, Pose, str]], parent: _Body, X_PB: Pose) -> _Body:
        """Adds the body's joints, outermost first, with a bare link after each but the last."""
        if not joints:
            fixed = FileJoint(f"{body.name}_fixed", "fixed", parent.name, body.name, X_PB[1], X_PB[0], np.eye(3)[0])
            self.joints.append(fixed)
            return body
        before, X_LB = parent.name, X_PB
        for k, (place, X_BF, _) in enumerate(joints):
            last = k == len(joints) - 1
            name = place.element.get("name") or f"{body.name}_joint_{k}"
            place = Place(place.element, self.source, f"joint {name!r}")
            child = body.name if last else f"{body.name}_after_{name}"
            p_BJ = X_BF[0] @ place.numbers("pos", 3, np.zeros(3)) + X_BF[1]
            self.joints.append(self._joint(place, name, before, child, _times(X_LB, _shift(p_BJ)), X_BF[0]))
            before, X_LB = child, _shift(-p_BJ)
            if not last:
                self.bodies.append(_Body(child, _shift(np.zeros(3))))
        return _Body(body.name, X_LB)

    def _joint(self, place: Place, name: str, parent: str, child: str, X_PJ: Pose, R_BF: Array) -> FileJoint:
        kind = place.element.get("type", "hinge")
        if kind not in ("hinge", "slide"):
            raise place.fail(f"is of the type {kind[:40]!r}", "only hinge and slide joints can be imported")
        axis = R_BF @ place.numbers("axis", 3, np.array([0.0, 0.0, 1.0]))
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise place.fail("has an axis of zero", "give the direction that the joint turns about or slides along")
        axis = axis / length
        unit = self.compiler.unit if kind == "hinge" else 1.0
        ref = unit * place.number("ref", 0.0)
        self.refs[name] = ref
        if ref and kind == "hinge":
            X_PJ = _times(X_PJ, (Rotation.from_rotvec(-ref * axis).as_matrix(), np.zeros(3)))
        elif ref:
            X_PJ = _times(X_PJ, _shift(-ref * axis))
        lower, upper = -np.inf, np.inf
        if self._limited(place, "limited", "range"):
            lower, upper = unit * place.numbers("range", 2, np.zeros(2))
        effort = None
        if self._limited(place, "actuatorfrclimited", "actuatorfrcrange"):
            effort = float(np.abs(place.numbers("actuatorfrcrange", 2, np.zeros(2))).max())
        moving = "prismatic" if kind == "slide" else "revolute" if np.isfinite(upper) else "continuous"
        return FileJoint(name, moving, parent, child, X_PJ[1], X_PJ[0], axis, float(lower), float(upper), effort)

    def _limited(self, place: Place, switch: str, values: str) -> bool:
        word = place.element.get(switch, "auto")
        return word == "true" or (word == "auto" and self.compiler.autolimits and values in place.element.attrib)

    def _pose(self, place: Place) -> Pose:
        return self._rotation(place), place.numbers("pos", 3, np.zeros(3))

    def _rotation(self, place: Place) -> Array:
        """Rotation from whichever of MJCF's five ways an element uses; the identity where it uses none."""
        attributes = place.element.attrib
        unit = self.compiler.unit
        if "quat" in attributes:
            quat = place.numbers("quat", 4)
            if np.linalg.norm(quat) < 1e-9:
                raise place.fail("has a quaternion of zero", "write 1 0 0 0 for no rotation")
            return Rotation.from_quat(quat[[1, 2, 3, 0]]).as_matrix()
        if "axisangle" in attributes:
            values = place.numbers("axisangle", 4)
            return Rotation.from_rotvec(self._unit(place, values[:3]) * values[3] * unit).as_matrix()
        if "euler" in attributes:
            sequence = self.compiler.eulerseq
            if sequence != sequence.lower() and sequence != sequence.upper():
                raise place.fail(f"mixes fixed and moving axes in eulerseq {sequence!r}", "use quat instead")
            # Lower case stands for moving axes in MuJoCo, upper case for fixed ones; SciPy has it the other way round.
            angles = unit * place.numbers("euler", 3)
            R = np.eye(3)
            for letter, angle in zip(sequence, angles, strict=True):
                turn = Rotation.from_rotvec(angle * np.eye(3)["xyz".index(letter.lower())]).as_matrix()
                R = R @ turn if sequence.islower() else turn @ R
            return R
        if "xyaxes" in attributes:
            values = place.numbers("xyaxes", 6)
            x = self._unit(place, values[:3])
            y = self._unit(place, values[3:] - (values[3:] @ x) * x)
            return np.column_stack((x, y, np.cross(x, y)))
        if "zaxis" in attributes:
            return _shortest_to(self._unit(place, place.numbers("zaxis", 3)))
        return np.eye(3)

    def _unit(self, place: Place, v: Array) -> Array:
        length = float(np.linalg.norm(v))
        if length < 1e-9:
            raise place.fail("has a direction of zero", "give a direction")
        return v / length

    def _inertia(self, place: Place, body: _Body) -> FileInertia | None:
        inertial = place.child("inertial")
        if inertial is None or self.compiler.inertia_from_geoms:
            return None
        R_LI, p_LI = _times(body.X_LB, self._pose(inertial))
        if "fullinertia" in inertial.element.attrib:
            xx, yy, zz, xy, xz, yz = inertial.numbers("fullinertia", 6)
            I_I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        else:
            I_I = np.diag(inertial.numbers("diaginertia", 3, np.zeros(3)))
        return FileInertia(inertial.number("mass"), p_LI, R_LI @ I_I @ R_LI.T)

    # ---- geoms

    def _read_geom(self, place: Place, X_BF: Pose, body: _Body) -> None:
        try:
            shape = self._shape(place, _times(body.X_LB, X_BF))
        except MissingMesh as cause:
            body.lost.append(str(cause))
            return
        if shape is None:
            return
        bits = int(place.number("contype", 1.0)), int(place.number("conaffinity", 1.0))
        if bits == (0, 0):
            body.visual.append(self._painted(shape, place))
        else:
            body.collision.append(shape)
            body.bits.add(bits)

    def _painted(self, shape: FileGeometry, place: Place) -> FileGeometry:
        """A mesh with the color of its geom or of the geom's material."""
        if not isinstance(shape, TriangleMesh):
            return shape
        material = self.materials.get(place.element.get("material", ""))
        rgba = place.element.get("rgba") or (material.get("rgba", "") if material is not None else "")
        return replace(shape, color=color_of(rgba))

    def _shape(self, place: Place, X_LF: Pose) -> FileGeometry | None:
        kind = place.element.get("type", "sphere")
        if kind in ("plane", "hfield", "sdf"):
            self.notes.append(f"{place.place}, a {kind}, is left out")
            return None
        if "mesh" in place.element.attrib:
            if kind != "mesh":
                self.notes.append(f"{place.place} is its mesh itself, not the {kind} fitted to it")
            return self._mesh(place, X_LF)
        size = place.list_of_numbers("size")
        R_FG, p_FG = self._pose(place)
        if kind in ("capsule", "cylinder", "box", "ellipsoid") and "fromto" in place.element.attrib:
            ends = place.numbers("fromto", 6).reshape(2, 3)
            length = float(np.linalg.norm(ends[1] - ends[0]))
            if length < 1e-9 or len(size) < 1:
                raise place.fail("has a fromto of no length or no size", "give two points and a radius")
            # MuJoCo's z axis runs from the second point to the first.
            R_FG, p_FG = _shortest_to((ends[0] - ends[1]) / length), ends.mean(axis=0)
            half = 0.5 * length
            size = np.array([size[0], half] if kind in ("capsule", "cylinder") else [size[0], size[0], half])
        needed = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}.get(kind)
        if needed is None:
            raise place.fail(f"is of the type {kind[:40]!r}", "use sphere, capsule, cylinder, box, ellipsoid or mesh")
        if len(size) < needed or (size[:needed] <= 0.0).any():
            raise place.fail(f"has the size {size.tolist()}", f"a {kind} needs {needed} sizes greater than zero")
        R, p = _times(X_LF, (R_FG, p_FG))
        if kind == "sphere":
            return Sphere(p, float(size[0]))
        if kind == "box":
            return Box(2.0 * size[:3], p, R)
        if kind == "ellipsoid":
            return placed(ellipsoid(size[:3]), R, p)
        axis = float(size[1]) * R[:, 2]
        return (Capsule if kind == "capsule" else Cylinder)(p - axis, p + axis, float(size[0]))

    def _mesh(self, place: Place, X_LF: Pose) -> TriangleMesh:
        name = place.text("mesh")
        asset = self.assets.get(name)
        if asset is None:
            raise place.fail(f"names the mesh {name!r}, which is no asset", "add it to <asset>")
        scale = asset.numbers("scale", 3, np.ones(3))
        if "file" in asset.element.attrib:
            file = asset.text("file").replace("\\", "/")
            if self.compiler.strippath:
                file = PurePosixPath(file).name
            mesh = self.meshes.read(str(PurePosixPath(self.compiler.meshdir.replace("\\", "/")) / file), scale)
        else:
            mesh = _inline_mesh(asset, scale)
        # The mesh is moved so that its own frame `ref` becomes the origin.
        R_MR = np.eye(3)
        if "refquat" in asset.element.attrib:
            R_MR = Rotation.from_quat(asset.numbers("refquat", 4)[[1, 2, 3, 0]]).as_matrix()
        vertices = (mesh.vertices - asset.numbers("refpos", 3, np.zeros(3))) @ R_MR
        return placed(TriangleMesh(vertices, mesh.faces, mesh.source), *_times(X_LF, self._pose(place)))

    # ---- what ties joints together, and what drives them

    def _section(self, name: str) -> Iterator[Element]:
        for section in self.root.findall(name):
            yield from section

    def _with_equalities(self, joints: tuple[FileJoint, ...]) -> tuple[FileJoint, ...]:
        by_name = {joint.name: joint for joint in joints}
        for element in self._section("equality"):
            place = self._complete(element, "main", f"<equality><{element.tag[:40]}>")
            if place.element.get("active", "true") == "false":
                continue
            if element.tag in ("connect", "weld"):
                continue
            if element.tag == "tendon":
                self._couple_by_tendons(place, by_name)
                continue
            if element.tag != "joint":
                self.notes.append(f"{place.place} is left out: only couplings of two joints are read")
                continue
            first = place.text("joint1")
            if first not in by_name:
                raise place.fail(f"names the joint {first!r}, which does not exist", "name a joint")
            place = Place(place.element, self.source, f"the coupling of joint {first!r}")
            second = place.element.get("joint2")
            if second is None:
                self.notes.append(f"{place.place} holds it at one value; it is left free")
                continue
            if second not in by_name:
                raise place.fail(f"names the joint {second!r}, which does not exist", "name a joint")
            if by_name[first].mimic is not None:
                self.notes.append(f"{place.place} to {second!r} is left out: the joint is coupled already")
                continue
            law = self._affine(place, by_name[second])
            offset = law[0] + self.refs[first] - law[1] * self.refs[second]
            by_name[first] = _changed(by_name[first], mimic=FileMimic(second, law[1], offset))
        self._note_tendons(by_name)
        return tuple(by_name.values())

    def _couple_by_tendons(self, place: Place, by_name: dict[str, FileJoint]) -> None:
        """A law between two joints from an equality of one or two fixed tendons that pass over these alone."""
        coefficients = np.zeros(5)
        coefficients[1] = 1.0
        given = place.list_of_numbers("polycoef")
        coefficients[: len(given[:5])] = given[:5]
        first, second = place.element.get("tendon1", ""), place.element.get("tendon2")
        terms = self._tendon_terms(first)
        other = self._tendon_terms(second) if second is not None else {}
        if terms is None or other is None or not set(terms) | set(other) <= set(by_name):
            self._leave_out(place, first, "only fixed tendons over joints are read")
            return
        for joint, coefficient in other.items():
            terms[joint] = terms.get(joint, 0.0) - coefficients[1] * coefficient
        terms = {joint: coefficient for joint, coefficient in terms.items() if coefficient != 0.0}
        if len(terms) != 2 or (other and coefficients[2:].any()):
            self._leave_out(place, first, f"it ties {len(terms)} joints, not two by a line; they count as independent")
            return
        # The joint that has a motor leads; else the one nearer to the palm, which comes first.
        order = [joint.name for joint in self.joints]
        leader, follower = sorted(terms, key=lambda name: (name not in self._motors(), order.index(name)))
        if by_name[follower].mimic is not None or _leads_to(by_name, leader, follower):
            self._leave_out(place, first, f"joint {follower!r} is coupled already")
            return
        slope = -terms[leader] / terms[follower]
        offset = coefficients[0] / terms[follower] + self.refs[follower] - slope * self.refs[leader]
        by_name[follower] = _changed(by_name[follower], mimic=FileMimic(leader, slope, offset))

    def _leave_out(self, place: Place, tendon: str, why: str) -> None:
        self.notes.append(f"{place.place} of {tendon!r} is left out: {why}")
        self.told_tendons.add(tendon)

    def _tendon_terms(self, name: str) -> dict[str, float] | None:
        """Coefficient of each joint of a fixed tendon; None for one along sites, or one that does not exist."""
        tendon = next((t for t in self._section("tendon") if t.get("name") == name), None)
        if tendon is None or tendon.tag != "fixed":
            return None
        terms: dict[str, float] = {}
        for part in tendon.findall("joint"):
            joint = part.get("joint", "")
            terms[joint] = terms.get(joint, 0.0) + Place(part, self.source, f"tendon {name!r}").number("coef", 1.0)
        return terms

    def _motors(self) -> set[str]:
        """Names of the joints that an actuator drives by itself."""
        actuators = (element for element in self._section("actuator") if element.tag in ACTUATORS)
        return {element.get("joint", element.get("jointinparent", "")) for element in actuators}

    def _note_tendons(self, by_name: dict[str, FileJoint]) -> None:
        """Says which tendons tie joints that stay independent; those of one joint or of a coupling say nothing."""
        free = {}
        for tendon in self._section("tendon"):
            if tendon.get("name", "") in self.told_tendons:
                continue
            parts = [child.get("joint", "") for child in tendon.findall("joint")]
            coupled = sum(part in by_name and by_name[part].mimic is not None for part in parts)
            if not parts or (len(parts) > 1 and coupled < len(parts) - 1):
                free[tendon.get("name", "")] = f"over {' and '.join(parts)}" if parts else "along sites"
        if free:
            told = join([f"tendon {name!r} {what}" for name, what in free.items()], 4)
            self.notes.append(f"left out: {told}; the joints that they tie count as independent")

    def _affine(self, place: Place, master: FileJoint) -> tuple[float, float]:
        """The coupling's offset and slope about the reference values; a curve is fitted over the master's range."""
        given = place.list_of_numbers("polycoef")
        if len(given) > 5:
            raise place.fail(f"has {len(given)} coefficients", "give at most five")
        coefficients = np.array([0.0, 1.0, 0.0, 0.0, 0.0])
        coefficients[: len(given)] = given
        if not coefficients[2:].any():
            return float(coefficients[0]), float(coefficients[1])
        ends = np.array([master.lower, master.upper]) - self.refs[master.name]
        if not np.isfinite(ends).all() or ends[1] <= ends[0]:
            self.notes.append(f"{place.place} is a curve, taken as its tangent at zero")
            return float(coefficients[0]), float(coefficients[1])
        x = np.linspace(ends[0], ends[1], 101)
        y = np.polynomial.polynomial.polyval(x, coefficients)
        offset, slope = np.polynomial.polynomial.polyfit(x, y, 1)
        error = float(np.abs(offset + slope * x - y).max())
        self.notes.append(f"{place.place} is a curve, taken as the straight line that is within {error:.3g} of it")
        return float(offset), float(slope)

    def _with_actuators(self, joints: tuple[FileJoint, ...]) -> tuple[FileJoint, ...]:
        by_name = {joint.name: joint for joint in joints}
        tendons = {tendon.get("name"): tendon for tendon in self._section("tendon")}
        driven: dict[str, float | None] = {}
        actuators = [element for element in self._section("actuator") if element.tag in ACTUATORS]
        for element in actuators:
            label = f"{element.tag} {element.get('name')!r}" if element.get("name") else f"a {element.tag}"
            place = self._complete(element, "main", label)
            effort = self._effort(place, element.tag)
            joint = place.element.get("joint", place.element.get("jointinparent"))
            if joint is not None:
                if joint not in by_name:
                    raise place.fail(f"drives the joint {joint!r}, which does not exist", "name a joint")
                _note_effort(driven, joint, effort, 1.0)
            elif (tendon := tendons.get(place.element.get("tendon"))) is not None and tendon.tag == "fixed":
                for part in tendon.findall("joint"):
                    if part.get("joint") in by_name:
                        coefficient = Place(part, self.source, f"tendon {tendon.get('name')!r}").number("coef", 1.0)
                        _note_effort(driven, str(part.get("joint")), effort, abs(coefficient))
            elif tendon is None:  # That one along sites is left out is told with the tendon.
                self.notes.append(f"{place.place} drives no joint and is left out")
        if not actuators:
            return joints
        out = []
        for joint in joints:
            efforts = [e for e in (joint.effort, driven.get(joint.name)) if e is not None]
            moving = None if joint.kind == "fixed" else joint.name in driven
            out.append(_changed(joint, effort=min(efforts) if efforts else None, driven=moving))
        return tuple(out)

    def _effort(self, place: Place, tag: str) -> float | None:
        """Greatest force at the joint that an actuator can reach, where the file bounds it."""
        gear = place.list_of_numbers("gear")
        ratio = abs(float(gear[0])) if len(gear) else 1.0
        bounds = []
        if self._limited(place, "forcelimited", "forcerange"):
            bounds.append(float(np.abs(place.numbers("forcerange", 2, np.zeros(2))).max()))
        direct = tag == "motor" or (tag == "general" and place.element.get("biastype", "none") == "none")
        if direct and self._limited(place, "ctrllimited", "ctrlrange"):
            gain = place.list_of_numbers("gainprm") if tag == "general" else np.ones(1)
            control = float(np.abs(place.numbers("ctrlrange", 2, np.zeros(2))).max())
            bounds.append(control * (abs(float(gain[0])) if len(gain) else 1.0))
        bounds = [bound for bound in bounds if bound > 0.0]
        return ratio * min(bounds) if bounds else None

    def _excluded(self) -> tuple[tuple[str, str], ...]:
        names = {body.name for body in self.bodies}
        pairs = []
        for element in self._section("contact"):
            pair = (element.get("body1", ""), element.get("body2", ""))
            if element.tag == "exclude" and set(pair) <= names:
                pairs.append(pair)
        return tuple(pairs)

    def _kept_apart_by_bits(self) -> tuple[tuple[str, str], ...]:
        """Pairs of bodies none of whose geoms may touch by their contact bits.

        Where no two bodies at all may touch, that saves a simulator time; it does not mean that they cannot.
        """
        solid = [body for body in self.bodies if body.bits]
        pairs = [
            (a.name, b.name)
            for n, a in enumerate(solid)
            for b in solid[n + 1 :]
            if not any(c1 & a2 or c2 & a1 for c1, a1 in a.bits for c2, a2 in b.bits)
        ]
        if pairs and len(pairs) == len(solid) * (len(solid) - 1) // 2:
            text = "its contact bits let no two of its links touch; they are kept apart nevertheless."
            self.decisions.append(Decision("decided", "file", text))
            return ()
        return tuple(pairs)

    def _loops(self) -> Iterator[FileLoop]:
        """The points that `<connect>` and `<weld>` hold together at the reference values."""
        by_name = {body.name: body for body in self.bodies}
        sites = {name: entry for body in self.root.iter("body") for name, entry in _sites(body)}
        for element in self._section("equality"):
            place = self._complete(element, "main", f"<equality><{element.tag[:40]}>")
            if element.tag not in ("connect", "weld") or place.element.get("active", "true") == "false":
                continue
            first, second = place.element.get("body1"), place.element.get("body2", WORLD)
            anchor = place.numbers("anchor", 3, np.zeros(3))
            if first is None and place.element.get("site1") in sites:
                first, site = sites[place.element.get("site1", "")]
                anchor = Place(site, self.source, "a site").numbers("pos", 3, np.zeros(3))
                second = sites.get(place.element.get("site2", ""), (WORLD, site))[0]
            if first not in by_name or second not in by_name:
                self.notes.append(
                    f"{place.place} holds body {first or second!r} to what is no part of the hand; left out"
                )
                continue
            a, b = by_name[first], by_name[second]
            if element.tag == "weld" and "anchor" not in place.element.attrib:
                R, p = a.X_WB
                anchor = R.T @ (b.X_WB[1] - p)  # The origin of the second body.
            # A weld holds three points that are not on a line.
            offsets = np.zeros((1, 3)) if element.tag == "connect" else 0.02 * np.eye(3)
            for p_A in anchor + offsets:
                p_W = a.X_WB[0] @ p_A + a.X_WB[1]
                p_B = b.X_WB[0].T @ (p_W - b.X_WB[1])
                points = [X_LB[0] @ q + X_LB[1] for X_LB, q in ((a.X_LB, p_A), (b.X_LB, p_B))]
                yield FileLoop((a.name, b.name), np.array(points))


def _sites(body: Element) -> Iterator[tuple[str, tuple[str, Element]]]:
    """Name of each site that stands in a body, with the body's name and the site."""
    for site in body.findall("site"):
        yield site.get("name", ""), (body.get("name", ""), site)


def _is_free(body: Element) -> bool:
    return body.find("freejoint") is not None or any(joint.get("type") == "free" for joint in body.findall("joint"))


def _extent(shape: FileGeometry) -> float:
    """Longest side of a shape's box [m]."""
    if isinstance(shape, Sphere):
        return 2.0 * shape.radius
    if isinstance(shape, Box):
        return float(np.max(shape.size))
    if isinstance(shape, TriangleMesh):
        return float(np.ptp(shape.vertices, axis=0).max())
    return float(np.linalg.norm(shape.p1 - shape.p0)) + 2.0 * shape.radius


def _leads_to(joints: dict[str, FileJoint], leader: str, follower: str) -> bool:
    """Whether a joint follows another one, over whatever others."""
    for _ in joints:
        law = joints[leader].mimic
        if law is None:
            return False
        leader = law.master
        if leader == follower:
            return True
    return False


def _changed(joint: FileJoint, **values: object) -> FileJoint:
    return FileJoint(**{**vars(joint), **values})


def _note_effort(driven: dict[str, float | None], joint: str, effort: float | None, factor: float) -> None:
    """Joints with two actuators, one for each direction, keep the stronger one's effort."""
    value = None if effort is None else effort * factor
    before = driven.get(joint)
    driven[joint] = before if value is None else max(value, before or 0.0)


def _inline_mesh(asset: Place, scale: Array) -> TriangleMesh:
    """A mesh whose vertices stand in the file; without faces it is their convex hull."""
    vertices = asset.list_of_numbers("vertex")
    if len(vertices) < 12 or len(vertices) % 3:
        raise MissingMesh(f"{asset.place} has neither a file nor vertices")
    vertices = vertices.reshape(-1, 3) * scale
    faces = asset.list_of_numbers("face").astype(np.int64)
    if len(faces) == 0:
        from scipy.spatial import ConvexHull, QhullError

        try:
            faces = ConvexHull(vertices).simplices.astype(np.int64)
        except (QhullError, ValueError):
            raise MissingMesh(f"{asset.place} is flat") from None
    elif len(faces) % 3 or faces.min() < 0 or faces.max() >= len(vertices):
        raise asset.fail("has faces of vertices that do not exist", "give three indices for each triangle")
    return TriangleMesh(vertices, faces.reshape(-1, 3), asset.place)


def _shortest_to(z: Array) -> Array:
    """The smallest rotation that takes the z axis to a unit vector, shape (3, 3)."""
    cosine = float(np.clip(z[2], -1.0, 1.0))
    axis = np.array([-z[1], z[0], 0.0])  # z axis x z
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.eye(3) if cosine > 0.0 else np.diag([1.0, -1.0, -1.0])
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine)).as_matrix()
