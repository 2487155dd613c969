"""Reads a mesh file of any usual format into a clean triangle mesh, or says in one line what is wrong with it."""

import io
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import igl
import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.resolvers import Resolver

from xdex_drake.errors import ObjectFileError

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

MESH_SUFFIXES = (".obj", ".stl", ".ply", ".off", ".gltf", ".glb", ".dae")
MAX_TRIANGLES = 2_000_000
MANY_TRIANGLES = 50_000
MAX_BYTES = 1_000_000_000


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


class _FolderResolver(Resolver):
    """Gives a mesh file the files beside or below it, and no others."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()

    def get(self, key: str) -> bytes:
        target = (self.folder / str(key).strip()).resolve()
        if not target.is_relative_to(self.folder):
            raise ObjectFileError(f"refers to {key!r}, which is outside its folder; move that file beside the mesh")
        if not target.is_file():
            raise ObjectFileError(f"refers to {key!r}, which is missing; put that file beside the mesh")
        if target.stat().st_size > MAX_BYTES:
            raise ObjectFileError(f"refers to {key!r}, which exceeds {MAX_BYTES} bytes; use a smaller mesh")
        return target.read_bytes()

    def write(self, name: str, data: Any) -> None:
        raise ObjectFileError("mesh files are only read")

    def namespaced(self, namespace: str) -> Resolver:
        return _FolderResolver(self.folder)

    def keys(self) -> list[str]:
        return []


def read_mesh(path: str | Path, *, scale: float = 1.0) -> TriangleMesh:
    """Reads a mesh file, merges what belongs together and turns the surface outwards.

    All meshes of a scene file are joined. Files that the mesh refers to (glTF buffers) must lie in or below its folder;
    materials and textures are not read.

    Args:
        path: File of one of the types `MESH_SUFFIXES`.
        scale: Factor from the file's unit to metres, greater than zero.

    Returns:
        The mesh, scaled.

    Raises:
        ObjectFileError: The file is missing, is not a mesh, or holds no usable triangles.
    """
    path = Path(path)
    if not (math.isfinite(scale) and scale > 0.0):
        raise ObjectFileError(f"{path}: scale is {scale}; give a finite number greater than zero")
    vertices, faces = _read_triangles(path)
    try:
        return clean_mesh(vertices * scale, faces)
    except ObjectFileError as error:
        raise ObjectFileError(f"{path}: {error}") from None


def _read_triangles(path: Path) -> tuple[Array, Faces]:
    suffix = path.suffix.lower()
    if not path.exists():
        raise ObjectFileError(f"{path}: no such file; check the path")
    if not path.is_file():
        raise ObjectFileError(f"{path}: not a file; give the path of a mesh file")
    if suffix in (".urdf", ".sdf", ".xml"):
        raise ObjectFileError(f"{path}: a model description, not a mesh; give the mesh file that it refers to")
    if suffix not in MESH_SUFFIXES:
        raise ObjectFileError(f"{path}: unknown type {suffix!r}; convert the mesh to one of {', '.join(MESH_SUFFIXES)}")
    if path.stat().st_size == 0:
        raise ObjectFileError(f"{path}: the file is empty; export the mesh again")
    if path.stat().st_size > MAX_BYTES:
        raise ObjectFileError(f"{path}: larger than {MAX_BYTES} bytes; simplify the mesh first")
    data = path.read_bytes()
    options: dict[str, Any] = {"skip_materials": True} if suffix in (".obj", ".gltf", ".glb") else {}
    try:
        if suffix == ".gltf":
            json.loads(data)
        scene = trimesh.load_scene(
            io.BytesIO(data),
            file_type=suffix[1:],
            resolver=_FolderResolver(path.parent),
            process=False,
            **options,
        )
        mesh = scene.to_mesh()
    except ObjectFileError as error:
        raise ObjectFileError(f"{path}: {error}") from None
    except ImportError as error:
        raise ObjectFileError(
            f"{path}: reading {suffix} needs the package {error.name}; install it, or use OBJ"
        ) from None
    except Exception as error:  # The readers raise anything, from struct.error to RecursionError, on a broken file.
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise ObjectFileError(f"{path}: not a readable {suffix[1:]} mesh ({reason}); export it again") from None
    return np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3), np.asarray(mesh.faces, dtype=np.int64).reshape(
        -1, 3
    )


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
