"""Convex hulls with few vertices, and bodies that are grown by a distance."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from xdex_drake.arrays import Array
from xdex_drake.errors import ObjectFileError
from xdex_drake.mesh_file import Faces
from xdex_drake.scene.distance import HalfSpaces, Part

HULL_VERTICES = 256  # Four times as many vertices as 64 cost Drake's queries a quarter more time, measured.
HULL_TOLERANCE = 5e-5


def hull_part(points: Array, growth: float) -> Part:
    """Hull of few vertices, grown by at least `growth`, and by half of what leaving out vertices has cost."""
    vertices, faces = convex_hull(points)
    lost = max(float(HalfSpaces([(vertices, faces)]).excess(points).max()), 0.0)
    growth = max(growth, 0.5 * lost)
    return grow(vertices, faces, growth) if growth > 1e-7 else (vertices, faces)


def grow(vertices: Array, faces: Faces, distance: float) -> Part:
    """Moves the vertices of a convex body outwards so that its faces move by a distance.

    Neighbouring parts, which share the wall where they were cut apart, then overlap: their union has no slits, which
    would make points deep inside the object look close to its surface.

    Args:
        vertices: Vertices [m], shape (n, 3).
        faces: Outward triangles, shape (m, 3).
        distance: How far the faces move [m], inwards where negative; a sharp vertex moves by at most three times as
            much.

    Returns:
        Vertices (k, 3) and outward faces (l, 3) of the hull of the moved vertices.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    moved = vertices.copy()
    for k in range(len(vertices)):
        around = normals[(faces == k).any(axis=1)]
        step = np.linalg.lstsq(around, np.full(len(around), distance), rcond=0.05)[0]
        moved[k] += step * min(1.0, 3.0 * abs(distance) / max(float(np.linalg.norm(step)), 1e-30))
    return convex_hull(moved, limit=len(moved), tolerance=0.0)


def convex_hull(points: Array, *, limit: int = HULL_VERTICES, tolerance: float = HULL_TOLERANCE) -> Part:
    """A convex hull of few vertices: the points that matter most, taken greedily from the farthest.

    Args:
        points: Points [m], shape (n, 3).
        limit: Greatest number of vertices.
        tolerance: No vertex is added once all points lie within this distance of the hull [m].

    Returns:
        Vertices (m, 3) and outward faces (k, 3).

    Raises:
        ObjectFileError: The points lie in a plane.
    """
    try:
        points = np.asarray(points, dtype=np.float64)
        points = points[ConvexHull(points).vertices]
        if limit < len(points) or tolerance > 0.0:
            points = _important(points, limit, tolerance)
        hull = ConvexHull(points)
    except QhullError:
        raise ObjectFileError("is flat, or a part of it is; give the object a thickness") from None
    faces = hull.simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return np.ascontiguousarray(points), faces


def _important(points: Array, limit: int, tolerance: float) -> Array:
    """Points whose hull comes within a tolerance of the hull of all; each round adds the farthest ones, one a facet."""
    chosen = _tetrahedron(points)
    while True:
        equations = ConvexHull(points[chosen]).equations
        excess = points @ equations[:, :3].T + equations[:, 3]
        facet = excess.argmax(axis=1)
        excess = excess[np.arange(len(points)), facet]
        worst = excess.max()
        if worst <= tolerance or len(chosen) >= min(limit, len(points)):
            break
        order = np.argsort(-excess, kind="stable")
        order = order[np.sort(np.unique(facet[order], return_index=True)[1])]  # The farthest point beyond each facet.
        order = order[excess[order] > max(tolerance, 0.9 * worst)]
        chosen.extend(order[: limit - len(chosen)].tolist())
    chosen_points = points[chosen]
    return chosen_points[ConvexHull(chosen_points).vertices]


def _tetrahedron(points: Array) -> list[int]:
    """Four corners of a point set that span a large tetrahedron."""
    first = int(points[:, 0].argmin())
    offset = points - points[first]
    second = int((offset**2).sum(axis=1).argmax())
    axis = offset[second] / np.linalg.norm(offset[second])
    third = int(((offset - np.outer(offset @ axis, axis)) ** 2).sum(axis=1).argmax())
    fourth = int(np.abs(offset @ np.cross(axis, offset[third])).argmax())
    return [first, second, third, fourth]
