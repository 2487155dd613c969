"""What every reader (URDF, MJCF, SDFormat, a Drake plant) brings a robot file into, before anything is decided.

Nothing is merged, guessed or mended here: links without inertia, fixed joints, joints with impossible limits and
meshes that could not be read all appear as they stand in the file, and `notes` says what a reader had to leave out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Box, Capsule, Sphere
from xdex_drake.hand.importing.decisions import Decision
from xdex_drake.hand.shapes import circle


@dataclass(frozen=True)
class Cylinder:
    """A cylinder about the segment from `p0` to `p1`, with flat ends.

    Attributes:
        p0: Middle of one end in L [m], shape (3,).
        p1: Middle of the other end in L [m], shape (3,).
        radius: Radius [m].
    """

    p0: Array
    p1: Array
    radius: float

    def moved(self, R: Array, p: Array) -> "Cylinder":
        """See `shapes.Shape.moved`."""
        return Cylinder(p + R @ self.p0, p + R @ self.p1, self.radius)

    def scaled(self, factor: float) -> "Cylinder":
        """See `shapes.Shape.scaled`."""
        return Cylinder(factor * self.p0, factor * self.p1, factor * self.radius)

    def corners(self) -> Array:
        """See `shapes.Shape.corners`: points on both rims."""
        d = self.p1 - self.p0
        u = d / max(float(np.linalg.norm(d)), 1e-12)
        rim = circle(u, self.radius, np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False))
        return np.concatenate([self.p0 + rim, self.p1 + rim])


@dataclass(frozen=True)
class TriangleMesh:
    """A surface of triangles, possibly open, possibly of several pieces.

    Attributes:
        vertices: Corners in L [m], shape (n, 3), the file's scale already applied.
        faces: Corner indices, shape (m, 3).
        source: The file it came from, for messages.
        color: Red, green, blue, where the robot file gives one.
    """

    vertices: Array
    faces: NDArray[np.int64]
    source: str = ""
    color: tuple[float, float, float] | None = None

    def moved(self, R: Array, p: Array) -> "TriangleMesh":
        """See `shapes.Shape.moved`."""
        return TriangleMesh(self.vertices @ R.T + p, self.faces, self.source, self.color)

    def scaled(self, factor: float) -> "TriangleMesh":
        """See `shapes.Shape.scaled`."""
        return TriangleMesh(factor * self.vertices, self.faces, self.source, self.color)

    def corners(self) -> Array:
        """See `shapes.Shape.corners`: all vertices that belong to a triangle."""
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces.ravel()] = True  # faster than sorting the faces
        return self.vertices[used]


def color_of(text: str) -> tuple[float, float, float] | None:
    """A color from the text of an rgba attribute; None where it is none."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return None
    if len(values) < 3 or not all(0.0 <= value <= 1.0 for value in values):
        return None
    return values[0], values[1], values[2]


FileGeometry = Sphere | Capsule | Box | Cylinder | TriangleMesh


@dataclass(frozen=True)
class FileInertia:
    """A link's inertia as the file has it, valid or not.

    Attributes:
        mass: Mass [kg].
        p_LLcm: Center of mass in L [m], shape (3,).
        I_LLcm: Rotational inertia about the center of mass, axes of L [kg m^2], shape (3, 3).
    """

    mass: float
    p_LLcm: Array
    I_LLcm: Array


@dataclass(frozen=True)
class FileLink:
    """A link as the file has it.

    Attributes:
        name: Its name.
        visual: What is drawn, in L.
        collision: What collides, in L.
        inertia: None where the file gives none.
        lost: For each shape that the file names but that could not be read, why.
    """

    name: str
    visual: tuple[FileGeometry, ...] = ()
    collision: tuple[FileGeometry, ...] = ()
    inertia: FileInertia | None = None
    lost: tuple[str, ...] = ()

    @property
    def has_shape(self) -> bool:
        """Whether the file gives the link a shape, readable or not."""
        return bool(self.visual or self.collision or self.lost)


@dataclass(frozen=True)
class FileMimic:
    """q = multiplier * q_master + offset, as the file has it; the master may itself be a mimic joint."""

    master: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class FileJoint:
    """A joint as the file has it.

    Attributes:
        name: Its name.
        kind: "fixed", "revolute", "continuous" or "prismatic".
        parent: Name of the parent link.
        child: Name of the child link, whose frame is the joint's at q = 0.
        p_PJ: Origin in the parent link's frame [m], shape (3,).
        R_PJ: Rotation in the parent link's frame, shape (3, 3).
        axis: Axis in the joint's frame, shape (3,), of any length but zero.
        lower: Lower limit [rad or m]; -inf where there is none.
        upper: Upper limit [rad or m]; inf where there is none.
        effort: Greatest torque or force [N m or N]; None where the file does not say.
        mimic: Law of a coupled joint.
        driven: False where the file says that nothing moves the joint (an MJCF joint without actuator); None where the
            format does not say.
    """

    name: str
    kind: str
    parent: str
    child: str
    p_PJ: Array
    R_PJ: Array
    axis: Array
    lower: float = -np.inf
    upper: float = np.inf
    effort: float | None = None
    mimic: FileMimic | None = None
    driven: bool | None = None


@dataclass(frozen=True)
class FileLoop:
    """A point of one link that coincides with a point of another: what closes a chain of joints to a loop.

    Attributes:
        links: Names of the two links.
        points: The point in the frame of each [m], shape (2, 3).
    """

    links: tuple[str, str]
    points: Array


@dataclass(frozen=True)
class FileModel:
    """A robot as its file has it: a tree of links.

    Attributes:
        name: Name of the robot.
        source: Path of the file, or what else it came from.
        links: Links; the root is the one that is nobody's child.
        joints: Joints.
        ignored_pairs: Pairs of links whose collision the file rules out.
        notes: What the reader had to leave out or change, one sentence each.
        decisions: What the reader decided or mended.
        loops: Points that hold together besides the tree's joints.
    """

    name: str
    source: str
    links: tuple[FileLink, ...]
    joints: tuple[FileJoint, ...]
    ignored_pairs: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    decisions: tuple[Decision, ...] = ()
    loops: tuple[FileLoop, ...] = ()
