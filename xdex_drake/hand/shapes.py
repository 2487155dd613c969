"""The shapes that links are made of, and all that is asked of each. A new shape is written here.

Everything is in the frame L of the shape's link. `Sphere` and `Capsule` are round: swept by a ball. `Box` and `Convex`
are solids: bounded by planes. What other formats make of a shape stays with them: Drake in `plant.drake_shape`, URDF in
`export`, the hand's own file in `yaml_file`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError

FLIP = np.array([1.0, -1.0, 1.0])
"""Diagonal of the reflection S in the plane y = 0."""

_SIGNS = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
_RING = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)


class Volume(NamedTuple):
    """What a solid body's mass properties follow from.

    Attributes:
        volume: Volume [m^3].
        p_LCenter: Centroid in L [m], shape (3,).
        moments: Rotational inertia about the centroid at unit density, axes of L [m^5], shape (3, 3).
    """

    volume: float
    p_LCenter: Array
    moments: Array


class Shape(Protocol):
    """What every shape of a link can be asked."""

    def moved(self, R: Array, p: Array) -> Self:
        """The shape in another frame.

        Args:
            R: Rotation of L in that frame, shape (3, 3).
            p: Origin of L in that frame [m], shape (3,).
        """
        ...

    def scaled(self, factor: float) -> Self:
        """The shape enlarged by a factor about the origin of L."""
        ...

    def mirrored(self) -> Self:
        """The mirror image in the plane y = 0."""
        ...

    def signed_distance(self, p_LPs: ArrayLike) -> Array:
        """Signed distance from points to the surface, negative inside.

        Exact for spheres, capsules and boxes. For a convex hull exact inside and wherever the nearest point is on a
        face; beyond an edge or a vertex it is the distance to the farthest face's plane, a lower bound.

        Args:
            p_LPs: Points in L [m], shape (..., 3).

        Returns:
            Distances [m], shape (...).

        Raises:
            HandFileError: The vertices of a convex hull do not span a volume.
        """
        ...

    def support(self, direction: Array) -> float:
        """Support function: how far the shape extends along a unit direction of L, shape (3,) [m]."""
        ...

    def bounds(self) -> Array:
        """Least and greatest coordinates in L [m], shape (2, 3)."""
        ...

    def bounding_sphere(self) -> tuple[Array, float]:
        """A ball around the shape: its center in L [m], shape (3,), and its radius [m]."""
        ...

    def corners(self) -> Array:
        """Points of the surface that span it, in L [m], shape (n, 3): all corners of a solid."""
        ...

    def volume(self) -> Volume:
        """Volume, centroid and moments."""
        ...

    def area(self) -> float:
        """Area of the surface [m^2]."""
        ...

    def sample(self, count: int, rng: np.random.Generator) -> Array:
        """Independent points, uniform on the surface, in L [m], shape (count, 3)."""
        ...


@dataclass(frozen=True)
class Sphere:
    """A ball.

    Attributes:
        center: Center in L [m], shape (3,).
        radius: Radius [m].
    """

    center: Array
    radius: float

    def moved(self, R: Array, p: Array) -> Sphere:
        """See `Shape.moved`."""
        return Sphere(p + R @ self.center, self.radius)

    def scaled(self, factor: float) -> Sphere:
        """See `Shape.scaled`."""
        return Sphere(factor * self.center, factor * self.radius)

    def mirrored(self) -> Sphere:
        """See `Shape.mirrored`."""
        return Sphere(self.center * FLIP, self.radius)

    def signed_distance(self, p_LPs: ArrayLike) -> Array:
        """See `Shape.signed_distance`."""
        return np.sqrt(((np.asarray(p_LPs, dtype=float) - self.center) ** 2).sum(axis=-1)) - self.radius

    def support(self, direction: Array) -> float:
        """See `Shape.support`."""
        return float(self.center @ direction) + self.radius

    def bounds(self) -> Array:
        """See `Shape.bounds`."""
        return np.stack([self.center - self.radius, self.center + self.radius])

    def bounding_sphere(self) -> tuple[Array, float]:
        """See `Shape.bounding_sphere`."""
        return np.asarray(self.center, dtype=float), self.radius

    def corners(self) -> Array:
        """See `Shape.corners`: the ends of three diameters."""
        return self.center + self.radius * np.concatenate([np.eye(3), -np.eye(3)])

    def volume(self) -> Volume:
        """See `Shape.volume`."""
        volume = 4.0 / 3.0 * np.pi * self.radius**3
        return Volume(volume, self.center, 0.4 * volume * self.radius**2 * np.eye(3))

    def area(self) -> float:
        """See `Shape.area`."""
        return 4.0 * np.pi * self.radius**2

    def sample(self, count: int, rng: np.random.Generator) -> Array:
        """See `Shape.sample`."""
        return self.center + self.radius * _directions(count, rng)

    def balls(self, scallop: float, most: int) -> Array:
        """The ball itself; see `Capsule.balls`."""
        return np.array([[*self.center, self.radius]])


@dataclass(frozen=True)
class Capsule:
    """All points within `radius` of the segment from `p0` to `p1`; where both ends agree, a ball.

    Attributes:
        p0: First end of the segment in L [m], shape (3,).
        p1: Second end of the segment in L [m], shape (3,).
        radius: Radius [m].
    """

    p0: Array
    p1: Array
    radius: float

    @property
    def length(self) -> float:
        """Length of the segment [m]."""
        return float(np.linalg.norm(self.p1 - self.p0))

    @property
    def axis(self) -> Array:
        """Unit vector from `p0` to `p1`, shape (3,); that of z where they agree."""
        length = self.length
        return (self.p1 - self.p0) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])

    def moved(self, R: Array, p: Array) -> Capsule:
        """See `Shape.moved`."""
        return Capsule(p + R @ self.p0, p + R @ self.p1, self.radius)

    def scaled(self, factor: float) -> Capsule:
        """See `Shape.scaled`."""
        return Capsule(factor * self.p0, factor * self.p1, factor * self.radius)

    def mirrored(self) -> Capsule:
        """See `Shape.mirrored`."""
        return Capsule(self.p0 * FLIP, self.p1 * FLIP, self.radius)

    def signed_distance(self, p_LPs: ArrayLike) -> Array:
        """See `Shape.signed_distance`."""
        along = np.asarray(self.p1, dtype=float) - self.p0
        offset = np.asarray(p_LPs, dtype=float) - self.p0
        # A capsule whose ends agree is a ball.
        t = np.clip(offset @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
        return np.sqrt(((offset - t[..., None] * along) ** 2).sum(axis=-1)) - self.radius

    def support(self, direction: Array) -> float:
        """See `Shape.support`."""
        return float(max(self.p0 @ direction, self.p1 @ direction)) + self.radius

    def bounds(self) -> Array:
        """See `Shape.bounds`."""
        return np.stack([np.minimum(self.p0, self.p1) - self.radius, np.maximum(self.p0, self.p1) + self.radius])

    def bounding_sphere(self) -> tuple[Array, float]:
        """See `Shape.bounding_sphere`."""
        p0, p1 = np.asarray(self.p0, dtype=float), np.asarray(self.p1, dtype=float)
        return 0.5 * (p0 + p1), self.radius + 0.5 * float(np.linalg.norm(p1 - p0))

    def corners(self) -> Array:
        """See `Shape.corners`: a ring about each end, and both poles."""
        ring = circle(self.axis, self.radius, _RING)
        poles = np.stack([self.p0 - self.radius * self.axis, self.p1 + self.radius * self.axis])
        return np.concatenate([self.p0 + ring, self.p1 + ring, poles])

    def volume(self) -> Volume:
        """See `Shape.volume`."""
        r, length, u = self.radius, self.length, self.axis
        cylinder, ball = np.pi * r**2 * length, 4.0 / 3.0 * np.pi * r**3
        axial = 0.5 * cylinder * r**2 + 0.4 * ball * r**2
        # Half balls at the ends: their centroid lies 3r/8 from the flat face.
        across = cylinder * (length**2 / 12.0 + r**2 / 4.0) + ball * (0.4 * r**2 + 0.375 * r * length + length**2 / 4.0)
        moments = across * np.eye(3) + (axial - across) * np.outer(u, u)
        return Volume(cylinder + ball, 0.5 * (self.p0 + self.p1), moments)

    def area(self) -> float:
        """See `Shape.area`."""
        return 2.0 * np.pi * self.radius * (self.length + 2.0 * self.radius)

    def sample(self, count: int, rng: np.random.Generator) -> Array:
        """See `Shape.sample`: the side and the two half balls by area."""
        length, axis = self.length, self.axis
        direction = _directions(count, rng)
        on_side = rng.random(count) < length / (length + 2.0 * self.radius)
        radial = direction - (direction @ axis)[:, None] * axis
        radial /= np.maximum(np.linalg.norm(radial, axis=1, keepdims=True), 1e-12)
        side = self.p0 + rng.random(count)[:, None] * (self.p1 - self.p0) + self.radius * radial
        cap = np.where((direction @ axis)[:, None] > 0.0, self.p1, self.p0) + self.radius * direction
        return np.where(on_side[:, None], side, cap)

    def balls(self, scallop: float, most: int) -> Array:
        """Balls along the axis, both ends among them, that stand for the shape.

        Args:
            scallop: Greatest depth of the groove between neighbors [m], where the number allows it.
            most: Greatest number.

        Returns:
            Rows (x, y, z, radius) in L [m], shape (n, 4).
        """
        scallop = min(scallop, self.radius)
        spacing = 2.0 * np.sqrt(2.0 * self.radius * scallop - scallop**2)
        count = min(most, int(np.ceil(self.length / spacing - 1e-9)) + 1)
        s = np.linspace(0.0, 1.0, count)[:, None]
        centers = self.p0 + s * (self.p1 - self.p0)
        return np.column_stack([centers, np.full(count, self.radius)])


@dataclass(frozen=True)
class Box:
    """A box, its edges along the axes of its own frame G.

    Attributes:
        size: Full edge lengths [m], shape (3,).
        p_LG: Center in L [m], shape (3,).
        R_LG: Rotation of the box in L, shape (3, 3).
    """

    size: Array
    p_LG: Array
    R_LG: Array = field(default_factory=lambda: np.eye(3))

    def moved(self, R: Array, p: Array) -> Box:
        """See `Shape.moved`."""
        return Box(self.size, p + R @ self.p_LG, R @ self.R_LG)

    def scaled(self, factor: float) -> Box:
        """See `Shape.scaled`."""
        return Box(factor * self.size, factor * self.p_LG, self.R_LG)

    def mirrored(self) -> Box:
        """See `Shape.mirrored`."""
        return Box(self.size, self.p_LG * FLIP, self.R_LG * np.outer(FLIP, FLIP))

    def signed_distance(self, p_LPs: ArrayLike) -> Array:
        """See `Shape.signed_distance`."""
        p_LPs = np.asarray(p_LPs, dtype=float)
        excess = np.abs((p_LPs - self.p_LG) @ np.asarray(self.R_LG)) - 0.5 * np.asarray(self.size)
        outside = np.sqrt((np.maximum(excess, 0.0) ** 2).sum(axis=-1))
        return outside + np.minimum(excess.max(axis=-1), 0.0)

    def support(self, direction: Array) -> float:
        """See `Shape.support`."""
        return float(self.p_LG @ direction + 0.5 * self.size @ np.abs(self.R_LG.T @ direction))

    def bounds(self) -> Array:
        """See `Shape.bounds`."""
        reach = np.abs(self.R_LG) @ (0.5 * self.size)
        return np.stack([self.p_LG - reach, self.p_LG + reach])

    def bounding_sphere(self) -> tuple[Array, float]:
        """See `Shape.bounding_sphere`."""
        return np.asarray(self.p_LG, dtype=float), 0.5 * float(np.linalg.norm(self.size))

    def corners(self) -> Array:
        """See `Shape.corners`."""
        return self.p_LG + (_SIGNS * self.size) @ self.R_LG.T

    def volume(self) -> Volume:
        """See `Shape.volume`."""
        volume = float(np.prod(self.size))
        x, y, z = self.size**2
        moments = volume / 12.0 * np.diag([y + z, x + z, x + y])
        return Volume(volume, self.p_LG, self.R_LG @ moments @ self.R_LG.T)

    def area(self) -> float:
        """See `Shape.area`."""
        x, y, z = self.size
        return 2.0 * float(x * y + y * z + z * x)

    def sample(self, count: int, rng: np.random.Generator) -> Array:
        """See `Shape.sample`."""
        x, y, z = self.size
        faces = np.array([y * z, z * x, x * y])
        axis = rng.choice(3, count, p=faces / faces.sum())
        points = rng.uniform(-0.5, 0.5, (count, 3))
        points[np.arange(count), axis] = rng.choice([-0.5, 0.5], count)
        return (points * self.size) @ self.R_LG.T + self.p_LG

    def half_spaces(self) -> tuple[Array, Array]:
        """The box as {p: normals p <= offsets}; see `Convex.half_spaces`."""
        normals = np.concatenate([self.R_LG.T, -self.R_LG.T])
        return normals, normals @ self.p_LG + np.tile(0.5 * self.size, 2)


class Hull(NamedTuple):
    """The faces of a convex hull.

    Attributes:
        planes: Rows (n, c) with unit outward normals n, n . p + c <= 0 inside, one a plane: triangles in the same plane
            share one, shape (m, 4).
        triangles: Indices of the vertices of the triangles of its surface, shape (k, 3).
        used: Indices of the vertices that are corners, shape (c,).
        area: Area of the surface [m^2].
    """

    planes: Array
    triangles: NDArray[np.int64]
    used: NDArray[np.int64]
    area: float


@dataclass(frozen=True)
class Convex:
    """The convex hull of some points.

    Attributes:
        vertices: Points in L [m], shape (n, 3).
    """

    vertices: Array

    @cached_property
    def hull(self) -> Hull:
        """Its faces.

        Raises:
            HandFileError: The vertices do not span a volume.
        """
        try:
            hull = ConvexHull(np.asarray(self.vertices, dtype=float))
        except (QhullError, ValueError) as error:
            raise HandFileError(
                "geometry convex, vertices: they do not span a volume; give at least 4 not in a plane"
            ) from error
        # Qhull splits faces into triangles: rows that agree to rounding are one face.
        size = float(np.ptp(self.vertices, axis=0).max())
        rounded = np.round(hull.equations / [1e-9, 1e-9, 1e-9, 1e-9 * size])
        _, first = np.unique(rounded, axis=0, return_index=True)
        planes = np.ascontiguousarray(hull.equations[np.sort(first)])
        return Hull(planes, hull.simplices.astype(np.int64), hull.vertices.astype(np.int64), float(hull.area))

    def moved(self, R: Array, p: Array) -> Convex:
        """See `Shape.moved`."""
        return Convex(self.vertices @ R.T + p)

    def scaled(self, factor: float) -> Convex:
        """See `Shape.scaled`."""
        return Convex(factor * self.vertices)

    def mirrored(self) -> Convex:
        """See `Shape.mirrored`."""
        return Convex(self.vertices * FLIP)

    def signed_distance(self, p_LPs: ArrayLike) -> Array:
        """See `Shape.signed_distance`."""
        planes = self.hull.planes
        return (np.asarray(p_LPs, dtype=float) @ planes[:, :3].T + planes[:, 3]).max(axis=-1)

    def support(self, direction: Array) -> float:
        """See `Shape.support`."""
        return float((self.vertices @ direction).max())

    def bounds(self) -> Array:
        """See `Shape.bounds`."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    def bounding_sphere(self) -> tuple[Array, float]:
        """See `Shape.bounding_sphere`."""
        vertices = np.asarray(self.vertices, dtype=float)
        center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        return center, float(np.sqrt(((vertices - center) ** 2).sum(axis=1).max()))

    def corners(self) -> Array:
        """See `Shape.corners`."""
        return self.vertices[self.hull.used]

    def volume(self) -> Volume:
        """See `Shape.volume`: a sum over the tetrahedra between an inner point and the faces."""
        origin = self.corners().mean(axis=0)
        corners = self.vertices[self.hull.triangles] - origin  # (n, 3, 3)
        volumes = np.abs(np.linalg.det(corners)) / 6.0
        volume = float(volumes.sum())
        center = (volumes[:, None] * corners.sum(axis=1)).sum(axis=0) / (4.0 * volume)
        # Integral of x x^T over a tetrahedron with a corner at 0: V / 20 (sum_ij p_i p_j^T + sum_i p_i p_i^T).
        totals = corners.sum(axis=1)
        second = np.einsum("n,ni,nj->ij", volumes, totals, totals)
        second = (second + np.einsum("n,nki,nkj->ij", volumes, corners, corners)) / 20.0
        second = second - volume * np.outer(center, center)
        return Volume(volume, origin + center, np.trace(second) * np.eye(3) - second)

    def area(self) -> float:
        """See `Shape.area`."""
        return self.hull.area

    def sample(self, count: int, rng: np.random.Generator) -> Array:
        """See `Shape.sample`."""
        a, b, c = self.vertices[self.hull.triangles].transpose(1, 0, 2)
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) + 1e-15
        face = rng.choice(len(areas), count, p=areas / areas.sum())
        s, t = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
        return a[face] * (1.0 - s) + b[face] * (s * (1.0 - t)) + c[face] * (s * t)

    def half_spaces(self) -> tuple[Array, Array]:
        """The hull as {p: normals p <= offsets}.

        Returns:
            Outward unit normals in L, shape (n, 3), and offsets [m], shape (n,).
        """
        planes = self.hull.planes
        return planes[:, :3], -planes[:, 3]


Round = Sphere | Capsule
"""Shapes swept by a ball: they have `balls`."""

Solid = Box | Convex
"""Shapes bounded by planes: they have `half_spaces`."""

Geometry = Round | Solid


def values_of(shape: Geometry) -> list[Any]:
    """The kind and the numbers that make a shape what it is: equal lists mean equal shapes."""
    return [type(shape).__name__, *(getattr(shape, part.name) for part in fields(shape))]


def circle(axis: Array, radius: float, angles: Array) -> Array:
    """Points of a circle about an axis through the origin.

    Args:
        axis: Unit vector, shape (3,).
        radius: Radius [m].
        angles: Where on the circle, from a direction that the axis alone decides [rad], shape (n,).

    Returns:
        Points [m], shape (n, 3).
    """
    across = np.linalg.svd(axis[None])[2][1:]  # (2, 3)
    return radius * np.column_stack([np.cos(angles), np.sin(angles)]) @ across


def _directions(count: int, rng: np.random.Generator) -> Array:
    """Unit vectors, uniform on the sphere, shape (count, 3)."""
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)
