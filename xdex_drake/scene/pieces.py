"""Loose pieces of a mesh: vertices that only nearly agree, the debris of a scan, and several bodies in one file."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from xdex_drake.arrays import Array

Faces = NDArray[np.int64]

NEAR = (1e-5, 3e-5, 1e-4, 3e-4, 1e-3)
"""Distances within which vertices of loose edges are merged [sizes of the mesh], the least that closes it is taken."""

DEBRIS_SHARE = 5e-3
"""Greatest area of debris [areas of the largest body]."""

TOUCHING = 1e-3
"""Bodies nearer than this to each other touch [sizes of the mesh]."""

LISTED = 6
"""Bodies of which a message tells."""


@dataclass(frozen=True)
class Body:
    """A connected surface of a mesh.

    Attributes:
        faces: Its triangles, as rows of the mesh's faces.
        area: Its area [m^2].
        size: Sides of its bounding box [m], shape (3,).
    """

    faces: Faces
    area: float
    size: Array

    def __str__(self) -> str:
        """Its size, in centimetres."""
        return " x ".join(f"{100.0 * side:.3g}" for side in self.size) + " cm"


def merge_near_vertices(vertices: Array, faces: Faces) -> tuple[Array, Faces, float]:
    """Merges vertices of loose edges that agree but for rounding, where that closes the surface.

    A distance is tried only as long as it is less than a third of the shortest edge but slivers: detail stays.

    Args:
        vertices: Vertices, shape (n, 3).
        faces: Triangles, shape (m, 3).

    Returns:
        Vertices, triangles, and the distance that was merged, 0 where nothing was.
    """
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    loose = _loose_edges(faces)
    if len(loose) == 0:
        return vertices, faces, 0.0
    rows = np.unique(loose)
    lengths = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
    shortest = float(np.percentile(lengths, 2))
    tree = KDTree(vertices[rows])
    for near in NEAR:
        reach = near * size
        if reach > shortest / 3.0:
            break
        pairs = tree.query_pairs(reach, output_type="ndarray")
        graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(rows), len(rows)))
        label = connected_components(graph, directed=False)[1]
        first = np.unique(label, return_index=True)[1]
        to = np.arange(len(vertices))
        to[rows] = rows[first[label]]
        merged = to[faces]
        merged = merged[
            (merged[:, 0] != merged[:, 1]) & (merged[:, 1] != merged[:, 2]) & (merged[:, 2] != merged[:, 0])
        ]
        # A surface with a mouth keeps its rim; one that was cut along its edges loses nearly all loose ones.
        if len(merged) > 0.95 * len(faces) and len(_loose_edges(merged)) < 0.1 * len(loose):
            return vertices, merged, reach
    return vertices, faces, 0.0


def _loose_edges(faces: Faces) -> Faces:
    """Edges of one triangle alone, shape (k, 2)."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    found, count = np.unique(edges, axis=0, return_counts=True)
    return found[count == 1]


def bodies_of(mesh: trimesh.Trimesh) -> list[Body]:
    """The connected surfaces of a mesh, the largest area first; surfaces that share a vertex are one.

    Args:
        mesh: The mesh.

    Returns:
        The bodies.
    """
    faces, n = np.asarray(mesh.faces), len(mesh.vertices)
    rows, columns = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    label = connected_components(coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(n, n)), directed=False)[1]
    order = np.argsort(label[faces[:, 0]], kind="stable")
    starts = np.flatnonzero(np.diff(label[faces[order, 0]])) + 1
    found = []
    for body in np.split(order, starts):
        corners = np.asarray(mesh.vertices)[faces[body]].reshape(-1, 3)
        found.append(Body(body, float(mesh.area_faces[body].sum()), np.ptp(corners, axis=0)))
    return sorted(found, key=lambda body: -body.area)


def split_debris(mesh: trimesh.Trimesh, bodies: list[Body]) -> tuple[list[Body], list[Body]]:
    """Tells bodies from what floats about them: small pieces at some distance from all that is large.

    Args:
        mesh: The mesh.
        bodies: Its bodies, the largest first.

    Returns:
        The bodies that stay, and the debris.
    """
    large = [body for body in bodies if body.area >= DEBRIS_SHARE * bodies[0].area]
    small = bodies[len(large) :]
    if not small:
        return bodies, []
    vertices, faces = np.ascontiguousarray(mesh.vertices), np.asarray(mesh.faces)
    kept = np.ascontiguousarray(faces[np.concatenate([body.faces for body in large])], dtype=np.int64)
    tree = igl.AABB()
    tree.init(vertices, kept)
    debris = []
    for body in small:
        points = np.ascontiguousarray(vertices[np.unique(faces[body.faces])])
        gap = float(np.sqrt(np.min(np.asarray(tree.squared_distance(vertices, kept, points)[0]))))
        if gap > 0.5 * body.size.max():
            debris.append(body)
    left = {id(body) for body in debris}
    return [body for body in bodies if id(body) not in left], debris


def apart(mesh: trimesh.Trimesh, bodies: list[Body]) -> str:
    """What to say where a mesh is of several bodies that do not hang together, or lies on a sheet; else nothing.

    Args:
        mesh: The mesh.
        bodies: Its bodies, the largest first.

    Returns:
        A sentence that lists the bodies, or the empty string.
    """
    if len(bodies) < 2:
        return ""
    boxes = np.array([_box(mesh, body) for body in bodies])  # (k, 2, 3)
    gap = np.maximum(boxes[:, None, 0] - boxes[None, :, 1], boxes[None, :, 0] - boxes[:, None, 1]).clip(min=0.0)
    distance = np.linalg.norm(gap, axis=2)
    size = float(np.linalg.norm(np.ptp(np.asarray(mesh.vertices), axis=0)))
    groups = connected_components(distance < TOUCHING * size, directed=False)[0]
    listed = "; ".join(f"#{k} {body}" for k, body in enumerate(bodies[:LISTED]))
    listed += "; ..." if len(bodies) > LISTED else ""
    if groups > 1:
        wide = f"up to {_widest(distance):.3g} m apart"
        return f"{len(bodies)} bodies, {wide}, count as one ({listed}); FILE#0 takes the first alone"
    sheet = next((k for k, body in enumerate(bodies) if _is_ground(body, bodies)), None)
    if sheet is None:
        return ""
    a, b = sorted(bodies[sheet].size)[1:]
    other = 1 if sheet == 0 else 0
    return (
        f"a sheet of {a:.2g} x {b:.2g} m touches the rest and counts with it ({listed}); FILE#{other} takes one alone"
    )


def _widest(distance: Array) -> float:
    """Greatest distance of a body from the nearest other one [m]."""
    return float(np.max(np.min(distance + np.diag(np.full(len(distance), np.inf)), axis=1)))


def _box(mesh: trimesh.Trimesh, body: Body) -> Array:
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)[body.faces]].reshape(-1, 3)
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def _is_ground(body: Body, bodies: list[Body]) -> bool:
    """Whether a body is a thin sheet, twice as wide as all others."""
    thin, a, _ = sorted(body.size)
    others = max(float(other.size.max()) for other in bodies if other is not body)
    return thin < 0.05 * a and a > 2.0 * others
