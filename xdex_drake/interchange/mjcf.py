"""Writes hands and scenes as MJCF, the format of MuJoCo, with all that MuJoCo needs to play them as they are.

MuJoCo's defaults are not those of a light hand. A contact there is as soft as the bodies that meet are light: pressed
with a force f it sinks by (1 - d) tau^2 f / m, with d the greatest impedance of `solimp`, tau the time constant of
`solref`, and 1 / m the sum of what MuJoCo takes for the inverse masses of both sides. So an exported model sets time
constant and impedance of every contact and, as hands with geared motors have it, an armature at every joint, which is
most of what a fingertip weighs then. `docs/mujoco.md` gives the numbers, measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.hand.collision import ignored_pairs
from xdex_drake.hand.description import Box, Capsule, Convex, Geometry, Hand, Joint, Link, Sphere
from xdex_drake.hand.looks import link_colors
from xdex_drake.hand.plant import JOINT_DAMPING
from xdex_drake.interchange.parts import ModelFile, file_name, hull_obj, marked_frames, number, numbers
from xdex_drake.scene.bodies import FIXTURE_COLOR, TABLE_COLOR, visual_obj
from xdex_drake.scene.materials import object_color
from xdex_drake.scene.object import ObjectModel
from xdex_drake.scene.plant import CARRIAGE_MASS, CARRIAGE_RADIUS, PlantSettings
from xdex_drake.scene.tabletop import Scene

LEAST_RANGE = 1e-6
"""Range of a joint whose limits are equal, which MuJoCo refuses [rad or m]."""

BODY_ORDER = ("inertial", "freejoint", "joint", "geom", "site", "body")
"""What stands first in a body; MuJoCo does not mind, people do."""


@dataclass(frozen=True)
class MjcfSettings:
    """What an exported model says of MuJoCo's physics besides the hand's own facts.

    Attributes:
        time_step: Length of a step [s].
        time_constant: Time constant of contacts, limits and couplings, `solref` [s]; at least two steps.
        impedance: Impedance of contacts at zero and at full depth, and that depth [m]: `solimp`.
        impratio: How much stiffer friction is than normal contact; MuJoCo's friction creeps, the less the greater.
        armature: Inertia that the motor adds to a revolute joint [kg m^2].
        slide_armature: Mass that the motor adds to a prismatic joint [kg]: that of `armature` at a lever of 5 cm.
    """

    time_step: float = 0.002
    time_constant: float = 0.004
    impedance: tuple[float, float, float] = (0.95, 0.99, 0.001)
    impratio: float = 10.0
    armature: float = 5e-4
    slide_armature: float = 0.2


MJCF = MjcfSettings()


def export_mjcf(hand: Hand, folder: str | Path) -> Path:
    """Writes NAME.xml and meshes/*.obj into a folder: a hand that MuJoCo opens; see `hand_mjcf`.

    Args:
        hand: The hand.
        folder: The folder; made where it does not exist.

    Returns:
        Path of the MJCF file.

    Raises:
        ConfigError: The folder cannot be written.
    """
    return hand_mjcf(hand).write(Path(folder) / f"{file_name(hand.name)}.xml")


def hand_mjcf(hand: Hand, *, plant: PlantSettings | None = None, settings: MjcfSettings = MJCF) -> ModelFile:
    """A hand as MJCF, its wrist frame H fixed in the world's.

    Bodies, joints, limits, couplings, inertias and shapes are the hand's; a body's frame is L. Every actuated joint has
    a position actuator of its name with torque kp (ctrl - q) - kd dq/dt within its effort. As in the lifts of this
    library the hand feels no gravity. Sites mark the wrist frame and the fingertips. Pairs of links whose contact is
    ignored (`hand.collision`) are excluded.

    Args:
        hand: The hand.
        plant: Gains and friction; the library's where None.
        settings: MuJoCo's physics.

    Returns:
        The model.
    """
    plant = plant or PlantSettings()
    model = _Model(hand.name, settings)
    mount = SubElement(model.world, "body", {"name": _unused("mount", hand)})
    model.add_hand(mount, hand, plant)
    return model.finished()


@dataclass(frozen=True)
class KeyFrame:
    """A moment of a lift that a scene remembers.

    Attributes:
        name: Its name.
        q: Joint values, shape (n,).
        targets: Targets of the actuated joints, shape (n,).
        offset: Offset of the carriage, of its targets too [m], shape (3,).
    """

    name: str
    q: Array
    targets: Array
    offset: Array


def scene_mjcf(
    hand: Hand,
    scene: Scene,
    *,
    plant: PlantSettings | None = None,
    X_WH: RigidTransform | None = None,
    keyframes: Sequence[KeyFrame] = (),
    name: str = "",
    settings: MjcfSettings = MJCF,
) -> ModelFile:
    """A hand on a carriage, an object and a table as MJCF.

    The carriage's three slides along x, y and z of W come first among bodies, joints and actuators, then the body that
    carries the wrist frame, then the hand as in `hand_mjcf`, last the object with its free joint. Masses, inertias and
    gains are those of the Drake plant. The object collides by its convex parts and shows its mesh; every contact of it
    has the friction that Drake makes of both surfaces', 2 mu_1 mu_2 / (mu_1 + mu_2).

    Args:
        hand: The hand.
        scene: The object on its table.
        plant: Gains and friction; the library's where None.
        X_WH: Where the wrist stands while the carriage has no offset; the world's frame where None.
        keyframes: What the scene remembers by name.
        name: Name of the model; hand and object where empty.
        settings: MuJoCo's physics.

    Returns:
        The model.
    """
    plant = plant or PlantSettings()
    model = _Model(name or f"{hand.name}-{scene.object.name}", settings)
    model.add_surroundings(scene, plant)
    mount = model.add_carriage(hand, plant, X_WH or RigidTransform())
    model.add_hand(mount, hand, plant)
    model.add_obstacles(hand, scene)
    model.add_object(hand, scene.object, plant, scene.X_WO)
    if keyframes:
        model.add_keyframes(hand, scene.X_WO, keyframes)
    return model.finished()


def object_mjcf(thing: ObjectModel, *, plant: PlantSettings | None = None, settings: MjcfSettings = MJCF) -> ModelFile:
    """An object as MJCF, free, its frame O at the origin; see `scene_mjcf` for what it collides by.

    Args:
        thing: The object.
        plant: Friction of what it will touch; the library's where None.
        settings: MuJoCo's physics.

    Returns:
        The model.
    """
    model = _Model(thing.name, settings)
    model.add_object(None, thing, plant or PlantSettings(), RigidTransform())
    return model.finished()


def body_name(link: Link) -> str:
    """Name of a link's body; `world` is taken by MuJoCo."""
    return link.name if link.name != "world" else "world_link"


def obstacle_name(index: int, hand: Hand) -> str:
    """Name of the body of an obstacle of a scene."""
    return _unused(f"obstacle_{index}", hand)


def _unused(name: str, hand: Hand | None) -> str:
    """A name like the given one that neither link nor joint of a hand has."""
    if hand is None:
        return name
    taken = {body_name(link) for link in hand.links} | {joint.name for joint in hand.joints}
    while name in taken:
        name += "_"
    return name


def depth_first(hand: Hand) -> list[int]:
    """The order of MuJoCo's joint values: indices into `hand.joints`, every finger to its tip before the next one."""
    order, stack = [], [0]
    while stack:
        link = stack.pop()
        if link:
            order.append(link - 1)
        stack += reversed(np.flatnonzero(hand.parents == link).tolist())
    return order


class _Model:
    """An MJCF file while it is written."""

    def __init__(self, name: str, settings: MjcfSettings) -> None:
        self.settings = settings
        self.meshes: dict[str, str] = {}
        self.root = Element("mujoco", {"model": name})
        SubElement(self.root, "compiler", {"angle": "radian", "autolimits": "true", "meshdir": "meshes"})
        option = {"timestep": number(settings.time_step), "integrator": "implicitfast"}
        SubElement(self.root, "option", {**option, "cone": "elliptic", "impratio": number(settings.impratio)})
        self.defaults = SubElement(self.root, "default")
        self.asset = SubElement(self.root, "asset")
        self.world = SubElement(self.root, "worldbody")
        self.contact = SubElement(self.root, "contact")
        self.equality = SubElement(self.root, "equality")
        self.actuator = SubElement(self.root, "actuator")

    def finished(self) -> ModelFile:
        """The file; sections without content are left out."""
        for section in (self.asset, self.contact, self.equality, self.actuator):
            if not len(section):
                self.root.remove(section)
        for body in self.world.iter("body"):
            body[:] = sorted(body, key=lambda element: BODY_ORDER.index(element.tag))
        indent(self.root)
        return ModelFile(tostring(self.root, encoding="unicode") + "\n", self.meshes)

    @property
    def soft(self) -> tuple[str, str]:
        """The time constant with critical damping, and the impedance, as MuJoCo's `solref` and `solimp`."""
        return f"{number(self.settings.time_constant)} 1.0", numbers(np.array(self.settings.impedance))

    def add_surroundings(self, scene: Scene, plant: PlantSettings) -> None:
        """Adds table, light, and what a viewer looks at."""
        view = {"center": numbers(scene.X_WO @ scene.object.p_OOcm), "extent": "0.4"}
        self.root.insert(2, Element("statistic", view))
        SubElement(self.world, "light", {"pos": "0 0 2", "dir": "0 0 -1"})
        solref, solimp = self.soft
        friction = {"condim": "3", "friction": number(plant.friction)}
        if scene.table is not None:
            table = {"name": "table", "type": "plane", "size": "1 1 0.1", "rgba": numbers(np.array(TABLE_COLOR))}
            if scene.table != 0.0:
                table["pos"] = numbers(np.array([0.0, 0.0, scene.table]))
            SubElement(self.world, "geom", {**table, **friction, "solref": solref, "solimp": solimp})

    def add_obstacles(self, hand: Hand, scene: Scene) -> None:
        """Adds what is fixed in the world beside the object, a body each."""
        solref, solimp = self.soft
        for index, fixture in enumerate(scene.obstacles):
            X_WF, thing = fixture.X_WF, fixture.object
            pose = {"pos": numbers(X_WF.translation()), "quat": _quaternion(X_WF.rotation().matrix())}
            body = SubElement(self.world, "body", {"name": obstacle_name(index, hand), **pose})
            label = file_name(f"{thing.name}-{thing.digest[:8]}-{index}")
            surface = {"type": "mesh", "condim": "3", "friction": number(thing.friction)}
            for k, (vertices, _) in enumerate(thing.parts):
                mesh = self.add_mesh(f"{label}_part_{k}", hull_obj(vertices))
                looks = {"mesh": mesh, "rgba": numbers(np.array(FIXTURE_COLOR))}
                SubElement(body, "geom", {**looks, **surface, "solref": solref, "solimp": solimp})

    def add_carriage(self, hand: Hand, plant: PlantSettings, X_WH: RigidTransform) -> Element:
        """Adds the three driven slides that carry the wrist; returns the body whose frame is H."""
        body = self.world
        gains = {"kp": number(plant.carriage_kp), "kv": number(plant.carriage_kd)}
        for letter, axis in zip("xyz", np.eye(3), strict=True):
            name = _unused(f"carriage_{letter}", hand)
            body = SubElement(body, "body", {"name": name, "gravcomp": "1"})
            SubElement(body, "joint", {"name": name, "type": "slide", "axis": numbers(axis)})
            _add_inertial(body, CARRIAGE_MASS, np.zeros(3), 0.4 * CARRIAGE_MASS * CARRIAGE_RADIUS**2 * np.eye(3))
            SubElement(self.actuator, "position", {"name": name, "joint": name, **gains})
        pose = {"pos": numbers(X_WH.translation()), "quat": _quaternion(X_WH.rotation().matrix())}
        return SubElement(body, "body", {"name": _unused("mount", hand), **pose})

    def add_object(self, hand: Hand | None, thing: ObjectModel, plant: PlantSettings, X_WO: RigidTransform) -> None:
        """Adds the object, free, at a pose."""
        name = _unused("object", hand)
        friction = 2.0 * plant.friction * thing.friction / max(plant.friction + thing.friction, 1e-12)
        solref, solimp = self.soft
        default = SubElement(self.defaults, "default", {"class": "object"})
        # Where priorities differ, all of a contact's parameters are those of the greater one.
        surface = {"type": "mesh", "condim": "3", "priority": "1", "friction": number(friction), "group": "3"}
        SubElement(default, "geom", {**surface, "solref": solref, "solimp": solimp})
        pose = {"pos": numbers(X_WO.translation()), "quat": _quaternion(X_WO.rotation().matrix())}
        body = SubElement(self.world, "body", {"name": name, "childclass": "object", **pose})
        _add_inertial(body, thing.mass, thing.p_OOcm, thing.I_OcmO)
        SubElement(body, "freejoint", {"name": name})
        label = file_name(f"{thing.name}-{thing.digest[:8]}")
        for k, (vertices, _) in enumerate(thing.parts):
            mesh = self.add_mesh(f"{label}_part_{k}", hull_obj(vertices))
            SubElement(body, "geom", {"name": f"{name}_part_{k}", "mesh": mesh})
        # Only to be seen: its volume, zero where the mesh is open, counts for nothing.
        mesh = self.add_mesh(label, visual_obj(thing), inertia="shell")
        looks = {
            "group": "2",
            "contype": "0",
            "conaffinity": "0",
            "rgba": numbers(np.array([*object_color(thing.name), 1.0])),
        }
        SubElement(body, "geom", {"name": f"{name}_mesh", "mesh": mesh, **looks})

    def add_keyframes(self, hand: Hand, X_WO: RigidTransform, keyframes: Sequence[KeyFrame]) -> None:
        """Adds moments, the object where it lies."""
        keyframe = SubElement(self.root, "keyframe")
        pose = np.concatenate([X_WO.translation(), X_WO.rotation().ToQuaternion().wxyz()])
        for frame in keyframes:
            qpos = np.concatenate([frame.offset, hand.q_full(frame.q)[depth_first(hand)], pose])
            ctrl = np.concatenate([frame.offset, frame.targets])
            SubElement(keyframe, "key", {"name": frame.name, "qpos": numbers(qpos), "ctrl": numbers(ctrl)})

    def add_hand(self, mount: Element, hand: Hand, plant: PlantSettings) -> None:
        """Adds a hand below a body whose frame is H."""
        mount.set("childclass", "hand")
        solref, solimp = self.soft
        default = SubElement(self.defaults, "default", {"class": "hand"})
        armature = {"armature": number(self.settings.armature), "damping": number(JOINT_DAMPING)}
        SubElement(default, "joint", {**armature, "solreflimit": solref, "solimplimit": solimp})
        surface = {"solref": solref, "solimp": solimp, "condim": "3", "friction": number(plant.friction)}
        SubElement(default, "geom", surface)
        gains = {"kp": number(plant.kp), "kv": number(plant.kd)}
        SubElement(default, "position", gains)
        poses = [(hand.p_HB, hand.R_HB), *((joint.p_PJ, joint.R_PJ) for joint in hand.joints)]
        bodies: list[Element] = []
        for link, parent, (p, R) in zip(hand.links, hand.parents, poses, strict=True):
            above = bodies[int(parent)] if bodies else mount
            place = {"name": body_name(link), "pos": numbers(p), "quat": _quaternion(R)}
            bodies.append(SubElement(above, "body", {**place, "gravcomp": "1"}))
        for body, link, color in zip(bodies, hand.links, link_colors(hand), strict=True):
            _add_inertial(body, link.mass, link.p_LLcm, link.I_LLcm)
            for k, shape in enumerate(link.geometry):
                name = f"{link.name}_{k}"
                attributes = self._shape(shape, file_name(f"{hand.name}_{name}"))
                SubElement(body, "geom", {"name": name, **attributes, "rgba": numbers(color)})
        for body, joint in zip(bodies[1:], hand.joints, strict=True):
            self._add_joint(body, joint)
        for name, link, p, R in marked_frames(hand):
            place = {"name": name, "pos": numbers(p), "quat": _quaternion(R), "size": "0.002"}
            SubElement(bodies[hand.link_index[link]], "site", place)
        for i, j in ignored_pairs(hand):
            pair = {"body1": body_name(hand.links[i]), "body2": body_name(hand.links[j])}
            SubElement(self.contact, "exclude", pair)
        self._add_couplings_and_actuators(hand, plant)

    def _add_joint(self, body: Element, joint: Joint) -> None:
        upper = max(joint.upper, joint.lower + LEAST_RANGE)
        attributes = {"name": joint.name, "axis": numbers(joint.axis), "range": numbers(np.array([joint.lower, upper]))}
        if joint.kind == "prismatic":
            attributes |= {"type": "slide", "armature": number(self.settings.slide_armature)}
        SubElement(body, "joint", attributes)

    def _add_couplings_and_actuators(self, hand: Hand, plant: PlantSettings) -> None:
        solref, solimp = self.soft
        for joint in hand.joints:
            if joint.coupling is not None:
                law = np.array([joint.coupling.offset, joint.coupling.multiplier, 0.0, 0.0, 0.0])
                pair = {"joint1": joint.name, "joint2": joint.coupling.master, "polycoef": numbers(law)}
                SubElement(self.equality, "joint", {**pair, "solref": solref, "solimp": solimp})
                continue
            # Targets beyond the limits press against an object; farther out than this they ask for more than effort.
            reach = joint.effort / plant.kp
            bounds = {
                "forcerange": numbers(np.array([-joint.effort, joint.effort])),
                "ctrlrange": numbers(np.array([joint.lower - reach, joint.upper + reach])),
            }
            SubElement(self.actuator, "position", {"name": joint.name, "class": "hand", "joint": joint.name, **bounds})

    def add_mesh(self, name: str, text: str, *, inertia: str = "convex") -> str:
        """Adds an OBJ file as a mesh; returns the mesh's name."""
        self.meshes[f"{name}.obj"] = text
        SubElement(self.asset, "mesh", {"name": name, "file": f"{name}.obj", "inertia": inertia})
        return name

    def _shape(self, shape: Geometry, mesh_name: str) -> dict[str, str]:
        """A primitive as the attributes of a geom."""
        if isinstance(shape, Box):
            return {
                "type": "box",
                "size": numbers(0.5 * shape.size),
                "pos": numbers(shape.p_LG),
                "quat": _quaternion(shape.R_LG),
            }
        if isinstance(shape, Convex):
            return {"type": "mesh", "mesh": self.add_mesh(mesh_name, hull_obj(shape.vertices))}
        if isinstance(shape, Capsule) and float(np.linalg.norm(shape.p1 - shape.p0)) >= 1e-9:
            ends = numbers(np.concatenate([shape.p0, shape.p1]))
            return {"type": "capsule", "size": number(shape.radius), "fromto": ends}
        center = shape.center if isinstance(shape, Sphere) else shape.p0
        return {"type": "sphere", "size": number(shape.radius), "pos": numbers(center)}


def _quaternion(R: Array) -> str:
    """A rotation as w, x, y, z."""
    return numbers(RotationMatrix(R).ToQuaternion().wxyz())


def _add_inertial(body: Element, mass: float, p_BBcm: Array, I_BBcm: Array) -> None:
    moments = I_BBcm[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    SubElement(body, "inertial", {"pos": numbers(p_BBcm), "mass": number(mass), "fullinertia": numbers(moments)})
