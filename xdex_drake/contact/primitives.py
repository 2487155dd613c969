"""Signed distance from points to the primitives of a hand: spheres, capsules, boxes and convex hulls."""

import weakref
from typing import assert_never

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Array, Box, Capsule, Convex, Geometry, Sphere

# Half-spaces of convex geometries by the geometry's identity: they are plain values that cannot be hashed.
_HALF_SPACES: dict[int, tuple[weakref.ref[Convex], Array]] = {}


def half_spaces(convex: Convex) -> Array:
    """Half-spaces n . x + c <= 0 of a convex hull, computed once for each geometry.

    Args:
        convex: The geometry.

    Returns:
        Rows (n, c) with unit outward normals, coplanar facets merged, shape (m, 4).

    Raises:
        HandFileError: The vertices do not span a volume.
    """
    key = id(convex)
    known = _HALF_SPACES.get(key)
    if known is not None and known[0]() is convex:
        return known[1]
    try:
        equations = ConvexHull(np.asarray(convex.vertices, dtype=float)).equations
    except (QhullError, ValueError) as error:
        raise HandFileError(
            "geometry convex, vertices: they do not span a volume; give at least 4 not in a plane"
        ) from error
    # Qhull splits faces into triangles: rows that agree to rounding are one face.
    size = float(np.ptp(convex.vertices, axis=0).max())
    _, first = np.unique(np.round(equations / [1e-9, 1e-9, 1e-9, 1e-9 * size]), axis=0, return_index=True)
    equations = np.ascontiguousarray(equations[np.sort(first)])
    _HALF_SPACES[key] = (weakref.ref(convex, lambda _: _HALF_SPACES.pop(key, None)), equations)
    return equations


def bounding_sphere(geometry: Geometry) -> tuple[Array, float]:
    """A sphere around a geometry.

    Args:
        geometry: The geometry.

    Returns:
        Center in L [m], shape (3,), and radius [m].
    """
    match geometry:
        case Sphere():
            return np.asarray(geometry.center, dtype=float), geometry.radius
        case Capsule():
            p0, p1 = np.asarray(geometry.p0, dtype=float), np.asarray(geometry.p1, dtype=float)
            return 0.5 * (p0 + p1), geometry.radius + 0.5 * float(np.linalg.norm(p1 - p0))
        case Box():
            return np.asarray(geometry.p_LG, dtype=float), 0.5 * float(np.linalg.norm(geometry.size))
        case Convex():
            vertices = np.asarray(geometry.vertices, dtype=float)
            center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
            return center, float(np.sqrt(((vertices - center) ** 2).sum(axis=1).max()))
        case _:
            assert_never(geometry)


def signed_distance(geometry: Geometry, p_LPs: ArrayLike) -> Array:
    """Signed distance from points to the surface of a geometry, negative inside.

    Exact for spheres, capsules and boxes. For a convex hull exact inside and wherever the nearest point is on a face;
    beyond an edge or a vertex it is the distance to the farthest face's plane, a lower bound.

    Args:
        geometry: The geometry, in L.
        p_LPs: Points in L [m], shape (..., 3).

    Returns:
        Distances [m], shape (...).

    Raises:
        HandFileError: The vertices of a convex geometry do not span a volume.
    """
    p = np.asarray(p_LPs, dtype=float)
    match geometry:
        case Sphere():
            return np.sqrt(((p - geometry.center) ** 2).sum(axis=-1)) - geometry.radius
        case Capsule():
            along = np.asarray(geometry.p1, dtype=float) - geometry.p0
            offset = p - geometry.p0
            # A capsule whose ends agree is a ball.
            t = np.clip(offset @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
            return np.sqrt(((offset - t[..., None] * along) ** 2).sum(axis=-1)) - geometry.radius
        case Box():
            excess = np.abs((p - geometry.p_LG) @ np.asarray(geometry.R_LG)) - 0.5 * np.asarray(geometry.size)
            outside = np.sqrt((np.maximum(excess, 0.0) ** 2).sum(axis=-1))
            return outside + np.minimum(excess.max(axis=-1), 0.0)
        case Convex():
            planes = half_spaces(geometry)
            return (p @ planes[:, :3].T + planes[:, 3]).max(axis=-1)
        case _:
            assert_never(geometry)
