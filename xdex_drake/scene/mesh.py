"""Reads a mesh file of any usual format into a clean triangle mesh, or says in one line what is wrong with it."""

import math
from dataclasses import dataclass
from pathlib import Path

import igl
import numpy as np
import trimesh

from xdex_drake.errors import ObjectFileError
from xdex_drake.mesh_file import Array, Faces, read_triangles

MAX_TRIANGLES = 2_000_000
MANY_TRIANGLES = 50_000


@dataclass(frozen=True)
class TriangleMesh:
    """A triangle mesh with shared vertices and outward winding.

    Attributes:
        vertices: Vertices in O [m], shape (n, 3).
        faces: Indices of the corners, counter-clockwise from outside, shape (m, 3).
        watertight: Whether each edge belongs to exactly two triangles that agree on its direction.
        repairs: What was changed in the file's mesh, in words.
    """

    vertices: Array
    faces: Faces
    watertight: bool
    repairs: tuple[str, ...] = ()


def read_mesh(path: str | Path, *, scale: float = 1.0) -> TriangleMesh:
    """Reads a mesh file, merges what belongs together and turns the surface outwards.

    All meshes of a scene file are joined. Files that the mesh refers to (glTF buffers) must lie in or below its folder;
    materials and textures are not read.

    Args:
        path: File of one of the types `xdex_drake.mesh_file.MESH_SUFFIXES`.
        scale: Factor from the file's unit to metres, greater than zero.

    Returns:
        The mesh, scaled.

    Raises:
        ObjectFileError: The file is missing, is not a mesh, or holds no usable triangles.
    """
    path = Path(path)
    if not (math.isfinite(scale) and scale > 0.0):
        raise ObjectFileError(f"{path}: scale is {scale}; give a finite number greater than zero")
    vertices, faces = read_triangles(path, ObjectFileError)
    try:
        return clean_mesh(vertices * scale, faces)
    except ObjectFileError as error:
        raise ObjectFileError(f"{path}: {error}") from None


def clean_mesh(vertices: Array, faces: Faces) -> TriangleMesh:
    """Merges duplicate vertices, drops degenerate triangles, and turns the surface outwards.

    Args:
        vertices: Vertices [m], shape (n, 3).
        faces: Vertex indices, shape (m, 3).

    Returns:
        The clean mesh, with the list of repairs.

    Raises:
        ObjectFileError: No usable surface is left; the message names what is wrong, without the file.
    """
    if len(faces) == 0 or len(vertices) == 0:
        raise ObjectFileError("has no triangles; export a triangle mesh, not points or curves")
    if len(faces) > MAX_TRIANGLES:
        raise ObjectFileError(f"has {len(faces)} triangles, more than {MAX_TRIANGLES}; simplify the mesh first")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ObjectFileError("a triangle refers to a vertex that does not exist; export it again")
    if not np.isfinite(vertices[np.unique(faces)]).all():
        raise ObjectFileError("has a vertex coordinate that is not a finite number; export it again")
    size = float(np.linalg.norm(np.ptp(vertices[np.unique(faces)], axis=0)))
    if size > 1e4 or size < 1e-6:
        raise ObjectFileError(f"is {size:.3g} m across; set the scale so that the object is in metres")

    repairs: list[str] = []
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    merged = len(np.unique(faces)) - len(mesh.vertices)
    if merged > 0:
        repairs.append(f"merged {merged} duplicate vertices")
    keep = mesh.nondegenerate_faces(height=1e-12) & mesh.unique_faces()
    if not keep.all():
        repairs.append(f"removed {int((~keep).sum())} degenerate or duplicate triangles")
        mesh.update_faces(keep)
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces) < 4:
        raise ObjectFileError(
            f"has {len(mesh.faces)} usable triangles, a body needs at least 4; export a closed surface"
        )
    extent = np.linalg.svd(mesh.vertices - mesh.vertices.mean(axis=0), compute_uv=False) / math.sqrt(len(mesh.vertices))
    if extent[2] < 1e-5:
        raise ObjectFileError("is flat; give the object a thickness")
    if not mesh.is_watertight:
        mesh = _without_fragments(mesh, repairs)
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
        repairs.append("made the winding consistent")
    if not mesh.is_watertight:
        mesh = _without_small_holes(mesh, repairs)
    mesh = _outward(mesh, repairs)
    if not mesh.is_watertight:
        repairs.append("left open: the surface is not watertight")
    if len(mesh.faces) > MANY_TRIANGLES:
        repairs.append(f"kept {len(mesh.faces)} triangles: simplifying the mesh would make everything faster")
    return TriangleMesh(
        np.ascontiguousarray(mesh.vertices, dtype=np.float64),
        np.ascontiguousarray(mesh.faces, dtype=np.int64),
        bool(mesh.is_watertight and mesh.is_winding_consistent),
        tuple(repairs),
    )


def _bodies(mesh: trimesh.Trimesh) -> list[Faces]:
    """Faces of each connected body; they are connected across edges of exactly two triangles."""
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    return [np.flatnonzero(labels == k) for k in range(labels.max() + 1)]


def _without_fragments(mesh: trimesh.Trimesh, repairs: list[str]) -> trimesh.Trimesh:
    """Drops scraps, as scanners leave them: open pieces with less than a thousandth of the area."""
    keep, scraps = np.ones(len(mesh.faces), dtype=bool), 0
    for body in _bodies(mesh):
        if (
            mesh.area_faces[body].sum() < 1e-3 * mesh.area
            and not trimesh.Trimesh(mesh.vertices, mesh.faces[body], process=False).is_watertight
        ):
            keep[body] = False
            scraps += 1
    if scraps == 0:
        return mesh
    repairs.append(f"removed {scraps} loose scraps of {int((~keep).sum())} triangles")
    return trimesh.Trimesh(*_used(mesh.vertices, mesh.faces[keep]), process=False)


def _used(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    used, index = np.unique(faces, return_inverse=True)
    return np.asarray(vertices)[used], index.reshape(-1, 3)


def _without_small_holes(mesh: trimesh.Trimesh, repairs: list[str]) -> trimesh.Trimesh:
    """Closes each hole that a fan of at most 2 % of the surface's area covers; the mouth of an open bowl stays open."""
    half_edges = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    present = {(int(u), int(v)) for u, v in half_edges}
    follows: dict[int, int] = {}
    for u, v in present:
        if (v, u) not in present:
            if v in follows:
                return mesh  # Holes that touch: leave them to the decomposition's own repair.
            follows[v] = u
    vertices, faces, filled = [np.asarray(mesh.vertices)], [np.asarray(mesh.faces)], 0
    count = len(mesh.vertices)
    while follows:
        first = min(follows)
        loop = [first]
        while (step := follows.pop(loop[-1], first)) != first:
            loop.append(step)
        corners = mesh.vertices[loop]
        center = corners.mean(axis=0)
        fan = np.cross(corners - center, np.roll(corners, -1, axis=0) - center)
        if len(loop) < 3 or 0.5 * np.linalg.norm(fan, axis=1).sum() > 0.02 * mesh.area:
            continue
        vertices.append(center[None])
        faces.append(np.column_stack((loop, np.roll(loop, -1), np.full(len(loop), count))))
        count, filled = count + 1, filled + 1
    if filled == 0:
        return mesh
    repairs.append(f"filled {filled} small holes")
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)


def _outward(mesh: trimesh.Trimesh, repairs: list[str]) -> trimesh.Trimesh:
    """Turns each body outwards; a body inside of another one is a void and is turned inwards."""
    bodies = _bodies(mesh) if mesh.is_watertight else [np.arange(len(mesh.faces))]
    faces, turned = mesh.faces.copy(), 0
    volume = np.einsum("ij,ij->i", mesh.triangles[:, 0], np.cross(mesh.triangles[:, 1], mesh.triangles[:, 2]))
    for body in bodies:
        if volume[body].sum() < 0.0 and not _is_void(mesh, bodies, body):
            faces[body] = faces[body][:, ::-1]
            turned += len(body)
    if turned == 0:
        return mesh
    repairs.append(f"turned {turned} triangles outwards")
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def _is_void(mesh: trimesh.Trimesh, bodies: list[Faces], body: Faces) -> bool:
    """Whether an inward body lies within one of the others."""
    point = np.ascontiguousarray(mesh.vertices[mesh.faces[body[0], :1]])
    vertices = np.ascontiguousarray(mesh.vertices)
    return any(
        abs(float(np.asarray(igl.fast_winding_number(vertices, np.ascontiguousarray(mesh.faces[other]), point))[0]))
        > 0.5
        for other in bodies
        if other is not body
    )
