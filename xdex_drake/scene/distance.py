"""Signed distance to an object: exact, and on a regular grid for batches."""

import atexit
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakSet

import igl
import manifold3d
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from xdex_drake.arrays import Array

Faces = NDArray[np.int64]
Part = tuple[Array, Faces]

GRID_MARGIN = 0.03
GRID_SPACING = 0.0023
GRID_CELLS = 72

_CORNERS = np.array(list(np.ndindex(2, 2, 2)))
"""Corners of a grid's cell, shape (8, 3)."""

_SIGNS = 2.0 * _CORNERS - 1.0


@dataclass(frozen=True)
class DistanceResult:
    """Signed distances of points from a surface.

    Attributes:
        distance: Distance [m], negative inside, shape (n,).
        gradient: Unit direction in which the distance grows, in O, shape (n, 3).
        closest: Closest point of the surface, in O [m], shape (n, 3).
        face: Triangle that holds the closest point, shape (n,).
    """

    distance: Array
    gradient: Array
    closest: Array
    face: Faces


class HalfSpaces:
    """The convex parts of an object as half-spaces, which tell inside from outside."""

    def __init__(self, parts: Sequence[Part]) -> None:
        """Collects the face planes of closed convex meshes.

        Args:
            parts: Vertices (n, 3) and outward faces (m, 3) of each part.
        """
        normals, offsets, starts = [], [], [0]
        for vertices, faces in parts:
            a, b, c = (vertices[faces[:, k]] for k in range(3))
            normal = np.cross(b - a, c - a)
            length = np.linalg.norm(normal, axis=1)
            normal = normal[length > 1e-16] / length[length > 1e-16, None]
            offset = np.einsum("ij,ij->i", normal, a[length > 1e-16])
            _, first = np.unique(np.round(np.column_stack((normal, offset)), 9), axis=0, return_index=True)
            normals.append(normal[first])
            offsets.append(offset[first])
            starts.append(starts[-1] + len(first))
        self.normals = np.concatenate(normals)
        self.offsets = np.concatenate(offsets)
        self.starts = np.array(starts[:-1])
        self.lower = np.min([vertices.min(axis=0) for vertices, _ in parts], axis=0)
        self.upper = np.max([vertices.max(axis=0) for vertices, _ in parts], axis=0)

    def contains(self, points: Array, *, tolerance: float = 1e-9) -> NDArray[np.bool_]:
        """Whether points lie in at least one part.

        Args:
            points: Points in O [m], shape (n, 3).
            tolerance: Points this far outside of a part count as in it [m]: the walls that parts share are inside.

        Returns:
            Booleans, shape (n,).
        """
        inside = ((points >= self.lower - tolerance) & (points <= self.upper + tolerance)).all(axis=1)
        rows = np.flatnonzero(inside)
        chunk = max(1, 4_000_000 // len(self.offsets))
        for k in range(0, len(rows), chunk):
            some = rows[k : k + chunk]
            inside[some] = self.excess(points[some]) <= tolerance
        return inside

    def excess(self, points: Array) -> Array:
        """Greatest height of each point above the face planes of a part, least over the parts; not above its distance.

        Args:
            points: Points in O [m], shape (n, 3).

        Returns:
            Heights [m], zero or less inside, shape (n,).
        """
        return np.maximum.reduceat(points @ self.normals.T - self.offsets, self.starts, axis=1).min(axis=1)


_ALIVE: WeakSet["ExactDistance"] = WeakSet()


@atexit.register
def _drop_trees() -> None:
    """Drops all trees while there is an interpreter: one that outlives it has its library print lines about leaks.

    Drake keeps a user's function, which keeps all that its module holds, the program among it: such a circle goes
    through C++, where no garbage collector sees it.
    """
    for distance in _ALIVE:
        vars(distance).pop("_tree", None)


class ExactDistance:
    """Exact signed distance to a closed surface, negative inside.

    The closest point comes from a bounding volume tree (libigl). The sign comes from the convex parts where they are
    given, exactly; otherwise from the generalised winding number of the mesh, which also copes with small holes.
    """

    def __init__(self, vertices: Array, faces: Faces, *, parts: Sequence[Part] | None = None) -> None:
        """Builds the tree once; queries do not change it.

        Args:
            vertices: Vertices in O [m], shape (n, 3).
            faces: Outward triangles, shape (m, 3).
            parts: Convex parts whose union has this surface.
        """
        self.vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        self._half_spaces = None if parts is None else HalfSpaces(parts)
        self.lower, self.upper = self.vertices.min(axis=0), self.vertices.max(axis=0)
        self._tree = igl.AABB()
        self._tree.init(self.vertices, self.faces)
        _ALIVE.add(self)

    def query(self, points_O: Array) -> DistanceResult:
        """Signed distances of points.

        Args:
            points_O: Points in O [m], shape (n, 3).

        Returns:
            Distances, gradients, closest points. On the surface itself the gradient is the normal of the triangle.
        """
        points = np.ascontiguousarray(points_O, dtype=np.float64).reshape(-1, 3)
        if len(points) == 0:
            return DistanceResult(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.int64))
        closest, face = self.closest(points)
        offset = points - closest
        distance = np.sqrt((offset * offset).sum(1))
        sign = np.where(self.contains(points), -1.0, 1.0)
        near = distance < 1e-9
        gradient = sign[:, None] * offset / np.where(near, 1.0, distance)[:, None]
        gradient[near] = self.normals[face[near]]
        return DistanceResult(sign * distance, gradient, closest, face)

    def closest(self, points_O: Array) -> tuple[Array, Faces]:
        """The closest points of the surface, without a sign, which costs most of a query.

        Args:
            points_O: Points in O [m], shape (n, 3), n at least 1.

        Returns:
            The closest points in O [m], shape (n, 3), and the triangle of each, shape (n,).
        """
        _, face, closest = self._tree.squared_distance(self.vertices, self.faces, np.ascontiguousarray(points_O))
        return np.reshape(closest, (-1, 3)), np.reshape(face, -1)

    def contains(self, points_O: Array) -> NDArray[np.bool_]:
        """Whether points lie inside.

        Args:
            points_O: Points in O [m], shape (n, 3).

        Returns:
            Booleans, shape (n,).
        """
        if self._half_spaces is not None:
            return self._half_spaces.contains(points_O)
        inside = ((points_O >= self.lower) & (points_O <= self.upper)).all(axis=1)
        if inside.any():
            some = np.ascontiguousarray(points_O[inside])
            inside[inside] = np.asarray(igl.fast_winding_number(self.vertices, self.faces, some)) > 0.5
        return inside


def union_surface(parts: Sequence[Part]) -> Part:
    """The outer surface of a union of convex parts, as one closed mesh (manifold3d); closed inner voids are filled.

    Args:
        parts: Vertices (n, 3) and faces (m, 3) of each part.

    Returns:
        Vertices (n, 3) [m] and outward faces (m, 3).
    """
    hulls = [manifold3d.Manifold.hull_points(np.ascontiguousarray(vertices)) for vertices, _ in parts]
    union = manifold3d.Manifold.batch_boolean(hulls, manifold3d.OpType.Add)
    solids = [solid for solid in union.decompose() if solid.volume() > 0.0]
    mesh = manifold3d.Manifold.compose(solids).to_mesh64()
    return np.array(mesh.vert_properties, dtype=np.float64)[:, :3], np.array(mesh.tri_verts, dtype=np.int64)


def sample_surface(vertices: Array, faces: Faces, n: int, seed: int) -> tuple[Array, Faces]:
    """Points spread evenly at random over a surface.

    Args:
        vertices: Vertices [m], shape (m, 3).
        faces: Triangles, shape (k, 3).
        n: Number of points.
        seed: Seed.

    Returns:
        Points [m], shape (n, 3), and the triangle of each, shape (n,).
    """
    rng = np.random.default_rng(seed)
    corners = vertices[faces]
    edges = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).cumsum()
    face = np.searchsorted(area, rng.uniform(0.0, area[-1], n)).clip(max=len(faces) - 1)
    uv = rng.random((n, 2))
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1.0, 1.0 - uv, uv)
    return corners[face, 0] + np.einsum("nk,nkx->nx", uv, edges[face]), face


@dataclass(frozen=True)
class DistanceGrid:
    """Signed distance on a regular grid around an object, for batches of many points.

    Attributes:
        values: Distances at the grid points [m], negative inside, float32, shape (nx, ny, nz).
        gradients: Unit gradients at the grid points, float32, shape (nx, ny, nz, 3).
        origin: The grid point of index (0, 0, 0), in O [m], shape (3,).
        spacing: Distance between neighbours along each axis [m].
    """

    values: NDArray[np.float32]
    gradients: NDArray[np.float32]
    origin: Array
    spacing: float

    @cached_property
    def upper(self) -> Array:
        """The last grid point, in O [m], shape (3,)."""
        return self.origin + self.spacing * (np.array(self.values.shape) - 1)

    def interpolate(self, points_O: Array) -> tuple[Array, Array]:
        """Trilinear distances and gradients.

        For a point outside the grid, the distance is that to the surface point found from the nearest point of the
        grid's box, which does not fall short of the true one by more than the grid's own error.

        Args:
            points_O: Points in O [m], shape (n, 3).

        Returns:
            Distances [m], shape (n,), and unit gradients, shape (n, 3).
        """
        points = np.asarray(points_O, dtype=np.float64).reshape(-1, 3)
        inside = np.clip(points, self.origin, self.upper)
        cell = (inside - self.origin) / self.spacing
        low = np.minimum(cell.astype(np.int64), np.array(self.values.shape) - 2)
        t = cell - low
        distance, gradient = np.zeros(len(points)), np.zeros((len(points), 3))
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(corner, t, 1.0 - t), axis=1)
            i, j, k = (low + corner).T
            distance += weight * self.values[i, j, k]
            gradient += weight[:, None] * self.gradients[i, j, k]
        gradient /= np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-9)
        beyond = (inside != points).any(axis=1)
        if beyond.any():
            offset = points[beyond] - inside[beyond] + distance[beyond, None] * gradient[beyond]
            distance[beyond] = np.linalg.norm(offset, axis=1)
            gradient[beyond] = offset / distance[beyond, None]
        return distance, gradient

    def lower_bounds(self, points_O: Array) -> Array:
        """Trilinear distances; beyond the grid a bound that no true distance falls short of.

        A point p beyond the grid's box, which holds the whole surface, and the nearest point b of the box: the angle at
        b between p and any surface point is a right one or wider, so that distance(p)^2 >= distance(b)^2 + |p - b|^2.

        Args:
            points_O: Points in O [m], shape (n, 3).

        Returns:
            Distances [m], negative inside, shape (n,); exact but for the grid's own error on it.
        """
        cells = ((points_O - self.origin) / self.spacing).T
        distance = ndimage.map_coordinates(self.values, cells, order=1, mode="nearest")
        beyond = np.maximum(np.maximum(self.origin - points_O, points_O - self.upper), 0.0)
        return np.hypot(distance, np.sqrt((beyond * beyond).sum(axis=1))) * np.where(distance < 0.0, -1.0, 1.0)

    def smooth(self, points_O: Array) -> tuple[Array, Array, Array]:
        """Trilinear distances and unit gradients, with the derivative of the gradients that belongs to them.

        Args:
            points_O: Points in O [m], shape (n, 3); those outside of the grid are moved onto its boundary.

        Returns:
            Distances [m], shape (n,), unit gradients, shape (n, 3), and their Jacobians [1/m], shape (n, 3, 3).
        """
        ends = np.array(self.values.shape) - 1
        cell = np.minimum(np.maximum((points_O - self.origin) / self.spacing, 0.0), ends)
        low = np.minimum(cell.astype(np.int64), ends - 1)
        w = _SIGNS * (cell - low)[:, None, :] + (1.0 - _CORNERS)  # (n, 8, 3)
        strides = np.array([self.values.shape[1] * self.values.shape[2], self.values.shape[2], 1])
        rows = (low @ strides)[:, None] + _CORNERS @ strides
        values = self.values.reshape(-1).take(rows)
        gradients = self.gradients.reshape(-1, 3).take(rows, axis=0).astype(float)
        x, y, z = w[..., 0], w[..., 1], w[..., 2]
        yz = y * z
        weights = np.stack([_SIGNS[:, 0] * yz, _SIGNS[:, 1] * (x * z), _SIGNS[:, 2] * (x * y), x * yz], axis=-1)
        # Derivatives of the gradient, and in the last column the gradient itself.
        jacobian = np.swapaxes(gradients, 1, 2) @ weights
        distance = (weights[..., 3] * values).sum(1)
        gradient = jacobian[..., 3]
        size = np.maximum(np.sqrt((gradient * gradient).sum(1, keepdims=True)), 1e-9)
        unit = gradient / size
        slope = jacobian[..., :3] / (self.spacing * size[..., None])
        return distance, unit, slope - unit[:, :, None] * (unit[:, None, :] @ slope)


def build_grid(
    exact: ExactDistance, *, margin: float = GRID_MARGIN, spacing: float = GRID_SPACING, cells: int = GRID_CELLS
) -> DistanceGrid:
    """Samples a signed distance on a grid around its surface.

    Distances are exact inside, and in a band of two to three cells outside. Each point beyond takes the closest surface
    point of the nearest point of the band, found by a distance transform: its error is a small part of the spacing.

    Args:
        exact: The distance to sample.
        margin: How far the grid reaches beyond the surface's bounding box [m].
        spacing: Distance between grid points [m], made larger where `cells` would be exceeded.
        cells: Greatest number of grid points along an axis.

    Returns:
        The grid.
    """
    lower, upper = exact.vertices.min(axis=0) - margin, exact.vertices.max(axis=0) + margin
    spacing = max(spacing, float((upper - lower).max()) / (cells - 1))
    shape = np.ceil((upper - lower) / spacing).astype(int) + 1
    origin = 0.5 * (lower + upper) - 0.5 * spacing * (shape - 1)

    near = np.zeros(shape, dtype=bool)
    index = np.rint((_cover_surface(exact, 0.6 * spacing) - origin) / spacing).astype(int)
    near[tuple(index.T)] = True
    band = np.asarray(ndimage.binary_dilation(near, np.ones((3, 3, 3), dtype=bool), iterations=2), dtype=np.bool_)

    position = origin + spacing * np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    result = exact.query(position[band])
    closest, sign = np.zeros((*shape, 3)), np.zeros(shape)
    closest[band], sign[band] = result.closest, np.where(result.distance < 0.0, -1.0, 1.0)
    source = tuple(np.asarray(ndimage.distance_transform_edt(~band, return_distances=False, return_indices=True)))
    closest, sign = closest[source], sign[source]
    inside = ~band & (sign < 0.0)
    closest[inside] = exact.query(position[inside]).closest

    offset = position - closest
    distance = np.linalg.norm(offset, axis=-1)
    gradients = sign[..., None] * offset / np.maximum(distance, 1e-12)[..., None]
    gradients[band] = result.gradient
    return DistanceGrid((sign * distance).astype(np.float32), gradients.astype(np.float32), origin, spacing)


def _cover_surface(exact: ExactDistance, step: float) -> Array:
    """Points on a surface, none of whose points is farther than about `step` from one of them; without randomness."""
    a, b, c = (exact.vertices[exact.faces[:, k]] for k in range(3))
    longest = np.sqrt(np.maximum.reduce([np.sum((u - v) ** 2, axis=1) for u, v in ((a, b), (b, c), (c, a))]))
    divisions = np.maximum(1, np.ceil(longest / step)).astype(int)
    points = []
    for n in np.unique(divisions):
        rows = np.flatnonzero(divisions == n)
        u, v = (grid.ravel() / n for grid in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
        u, v = u[u + v <= 1.0 + 1e-9], v[u + v <= 1.0 + 1e-9]
        weights = np.column_stack((1.0 - u - v, u, v))
        corners = np.stack((a[rows], b[rows], c[rows]), axis=1)
        points.append(np.einsum("pk,fkx->fpx", weights, corners).reshape(-1, 3))
    return np.concatenate(points)
