"""Reads a mesh file of any usual format into a clean triangle mesh, or says in one line what is wrong with it."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import igl
import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.errors import ObjectFileError
from xdex_drake.mesh_file import Faces, read_triangles
from xdex_drake.scene.pieces import apart, bodies_of, merge_near_vertices, split_debris

MAX_BYTES = 500_000_000
"""Largest mesh file: two million triangles written as text."""

MAX_TRIANGLES = 2_000_000
MANY_TRIANGLES = 50_000
"""Meshes of more triangles are simplified to at most this many."""

CLUSTER_TRIANGLES = 300_000
"""Meshes of far more triangles are brought to about this many by merging vertices in small cells, which is fast."""

LARGEST_M = 2.0
"""Greatest extent of an object whose file is taken to be in metres."""

UNITS = ((LARGEST_M, 1.0, "metres"), (30.0, 0.01, "centimetres"), (3000.0, 0.001, "millimetres"))
"""Greatest extent [file units] at which a unit is guessed, its factor to metres, and its name."""

HOLE_SHARE = 0.02
"""Holes up to this share of the surface's area are filled."""

OPEN_SHARE = 0.05
"""A surface with holes of more than this share of its area is open: a shell without a thickness."""

MOST_SHEETS = 10
"""Greatest number of open surfaces that are taken as shells."""

WALL_M = 2e-3
"""Thickness that an open surface is given: it is taken as a thin shell [m]."""


@dataclass(frozen=True)
class TriangleMesh:
    """A triangle mesh with shared vertices and outward winding.

    Attributes:
        vertices: Vertices in O [m], shape (n, 3).
        faces: Indices of the corners, counter-clockwise from outside, shape (m, 3).
        watertight: Whether each edge belongs to exactly two triangles that agree on its direction.
        repairs: What was changed in the file's mesh, in words.
        scale: Factor from the file's unit to metres that was applied.
        shell: Whether the surface was open and has been given a wall of `WALL_M`.
        bodies: Number of connected surfaces.
    """

    vertices: Array
    faces: Faces
    watertight: bool
    repairs: tuple[str, ...] = ()
    scale: float = 1.0
    shell: bool = False
    bodies: int = 1


def guess_scale(extent: float) -> tuple[float, str]:
    """The factor to metres of a mesh of unknown unit, by its size: nothing that a hand holds is larger than 2 m.

    Args:
        extent: Greatest side of the bounding box [file units].

    Returns:
        The factor, and a sentence about it, empty where the unit is metres.

    Raises:
        ObjectFileError: No usual unit makes an object of it.
    """
    for limit, factor, name in UNITS:
        if extent <= limit:
            said = f"took the unit for {name} (scale {factor:g}), as {extent:.3g} m would be no object for a hand"
            return factor, "" if factor == 1.0 else said
    raise ObjectFileError(f"is {extent:.3g} units across, an object in no usual unit; set the scale to metres")


def check_scale(scale: float | None, what: object) -> None:
    """Refuses a scale that is no finite number greater than zero.

    Args:
        scale: The scale; None is guessed and passes.
        what: The object, for the message.

    Raises:
        ObjectFileError: It is none.
    """
    if scale is not None and not (math.isfinite(scale) and scale > 0.0):
        raise ObjectFileError(f"{what}: scale is {scale}; give a finite number greater than zero")


def read_mesh(path: str | Path, *, scale: float | None = None) -> TriangleMesh:
    """Reads a mesh file, merges what belongs together and turns the surface outwards.

    All meshes of a scene file are joined. Files that the mesh refers to (glTF buffers) must lie in or below its folder;
    materials and textures are not read.

    Args:
        path: File of one of the types `xdex_drake.mesh_file.MESH_SUFFIXES`; `FILE#1` takes the second largest of its
            bodies alone.
        scale: Factor from the file's unit to metres, greater than zero; guessed where None, see `guess_scale`.

    Returns:
        The mesh, scaled.

    Raises:
        ObjectFileError: The file is missing, is not a mesh, or holds no usable triangles.
    """
    path, body = body_of_path(Path(path))
    check_scale(scale, path)
    vertices, faces = read_triangles(path, ObjectFileError, max_bytes=MAX_BYTES)
    said = ""
    try:
        if scale is None:
            _check(vertices, faces)
            scale, said = guess_scale(float(np.ptp(_corners(vertices, faces), axis=0).max()))
        mesh = clean_mesh(vertices * scale, faces, body=body)
        return replace(mesh, scale=scale, repairs=(*([said] if said else []), *mesh.repairs))
    except ObjectFileError as error:
        raise ObjectFileError(f"{path}: {error}") from None


def body_of_path(path: Path) -> tuple[Path, int | None]:
    """The file of a path, and the number of the one body that `FILE#1` asks for; None where it asks for all."""
    name, mark, number = path.name.rpartition("#")
    if mark and number.isdecimal() and not path.exists():
        return path.with_name(name), int(number)
    return path, None


def clean_mesh(vertices: Array, faces: Faces, *, body: int | None = None) -> TriangleMesh:
    """Merges duplicate vertices, drops degenerate triangles, and turns the surface outwards.

    Args:
        vertices: Vertices [m], shape (n, 3).
        faces: Vertex indices, shape (m, 3).
        body: Which of its bodies to take, 0 for the largest; all as one where None.

    Returns:
        The clean mesh, with the list of repairs.

    Raises:
        ObjectFileError: No usable surface is left; the message names what is wrong, without the file.
    """
    _check(vertices, faces)
    size = float(np.linalg.norm(np.ptp(_corners(vertices, faces), axis=0)))
    if size > 1e4 or size < 1e-6:
        raise ObjectFileError(f"is {size:.3g} m across; set the scale so that the object is in metres")

    repairs: list[str] = []
    if len(faces) > MANY_TRIANGLES:
        vertices, faces = _simplified(vertices, faces, repairs)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    merged = len(_corners(vertices, faces)) - len(mesh.vertices)
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
    mesh = _in_one_piece(mesh, repairs, body)
    if not mesh.is_watertight:
        mesh = _without_fragments(mesh, repairs)
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
        repairs.append("made the winding consistent")
    if not mesh.is_watertight:
        mesh = _without_small_holes(mesh, repairs)
    mesh = _outward(mesh, repairs)
    bodies = len(_bodies(mesh))
    # Many loose sheets are no shell but a broken mesh.
    walled = _with_wall(mesh) if not mesh.is_watertight and bodies <= MOST_SHEETS and _is_open(mesh) else None
    if walled is not None:
        mesh = walled
        repairs.append(f"took the open surface for a shell and gave it a wall of {1e3 * WALL_M:g} mm")
    if not mesh.is_watertight:
        repairs.append("left open: the surface is not watertight")
    return TriangleMesh(
        np.ascontiguousarray(mesh.vertices, dtype=np.float64),
        np.ascontiguousarray(mesh.faces, dtype=np.int64),
        bool(mesh.is_watertight and mesh.is_winding_consistent),
        tuple(repairs),
        shell=walled is not None,
        bodies=bodies,
    )


def _in_one_piece(mesh: trimesh.Trimesh, repairs: list[str], number: int | None) -> trimesh.Trimesh:
    """Closes what was cut along its edges, leaves debris out, and tells of several bodies, or takes one of them."""
    if not mesh.is_watertight:
        vertices, faces, reach = merge_near_vertices(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        if reach > 0.0:
            mesh = trimesh.Trimesh(*_used(vertices, faces), process=False)
            repairs.append(f"merged near vertices, up to {1e6 * reach:.2g} micrometres apart")
    bodies = bodies_of(mesh)
    if len(bodies) > 8 and len(bodies) > 0.5 * len(mesh.faces):
        raise ObjectFileError(f"is {len(mesh.faces)} loose triangles; merge its vertices, or export a closed surface")
    bodies, debris = split_debris(mesh, bodies)
    if number is None:
        if debris:
            repairs.append(f"left out {len(debris)} loose bits, as the debris of a scan; the largest is {debris[0]}")
        if said := apart(mesh, bodies):
            repairs.append(said)
        kept = bodies
    elif number < len(bodies):
        kept = [bodies[number]]
    else:
        raise ObjectFileError(f"has {len(bodies)} bodies, #0 to #{len(bodies) - 1}, and no #{number}")
    rows = np.sort(np.concatenate([body.faces for body in kept]))
    if len(rows) == len(mesh.faces):
        return mesh
    return trimesh.Trimesh(*_used(np.asarray(mesh.vertices), np.asarray(mesh.faces)[rows]), process=False)


def _check(vertices: Array, faces: Faces) -> None:
    """Raises the error of a mesh that holds nothing usable."""
    if len(faces) == 0 or len(vertices) == 0:
        raise ObjectFileError("has no triangles; export a triangle mesh, not points or curves")
    if len(faces) > MAX_TRIANGLES:
        raise ObjectFileError(f"has {len(faces)} triangles, more than {MAX_TRIANGLES}; simplify the mesh first")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ObjectFileError("a triangle refers to a vertex that does not exist; export it again")
    if not np.isfinite(_corners(vertices, faces)).all():
        raise ObjectFileError("has a vertex coordinate that is not a finite number; export it again")


def _simplified(vertices: Array, faces: Faces, repairs: list[str]) -> tuple[Array, Faces]:
    """A mesh of at most `MANY_TRIANGLES`, with the error told.

    A closed surface keeps its topology: edges are collapsed within a tolerance that grows until they are few enough.
    Another one, and one of far too many triangles before that, has its vertices merged in the cells of a grid.
    """
    vertices, faces = _merged(*_used(vertices, faces))
    before, samples = len(faces), vertices[:: max(1, len(vertices) // 20_000)]
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if len(faces) > 2 * CLUSTER_TRIANGLES:
        vertices, faces = _clustered(vertices, faces, CLUSTER_TRIANGLES)
    solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))
    if solid.status() == manifold3d.Error.NoError:
        tolerance = 1e-4 * size
        while solid.num_tri() > MANY_TRIANGLES and tolerance < 0.02 * size:
            solid, tolerance = solid.simplify(tolerance), 2.5 * tolerance
        mesh = solid.to_mesh64()
        vertices = np.array(mesh.vert_properties, dtype=np.float64)[:, :3]
        faces = np.array(mesh.tri_verts, dtype=np.int64)
    if len(faces) > MANY_TRIANGLES:
        vertices, faces = _clustered(vertices, faces, MANY_TRIANGLES)
    if len(faces) == 0:
        raise ObjectFileError("has nothing left when it is simplified; export a closed surface with fewer triangles")
    tree = igl.AABB()
    tree.init(np.ascontiguousarray(vertices), np.ascontiguousarray(faces))
    square = np.array(tree.squared_distance(vertices, faces, np.ascontiguousarray(samples))[0], dtype=np.float64)
    error = np.sqrt(np.percentile(square, 99))
    repairs.append(f"simplified {before} triangles to {len(faces)}, p99 of the error {1e3 * error:.2g} mm")
    return vertices, faces


def _merged(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """Merges vertices that agree to 10 nm: as trimesh does, ten times as fast."""
    keys = np.rint(vertices * 1e8).astype(np.int64)
    # A hash that wraps around; should two keys ever share one, rows are compared instead.
    mixed = keys @ np.array([-7046029254386353131, -4417276706812531889, 1609587929392839161])
    _, first, index = np.unique(mixed, return_index=True, return_inverse=True)
    if (keys[first][index] != keys).any():
        _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return vertices[first], index.reshape(-1)[faces]


def _clustered(vertices: Array, faces: Faces, most: int) -> tuple[Array, Faces]:
    """Merges the vertices in each cell of a grid into their mean; cells grow until at most `most` faces are left."""
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    lower, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    # Two triangles a cell of the surface; crumpled surfaces have more area than the cells of their box.
    cell = max(min(math.sqrt(2.0 * area / most), float(size.max()) / 16.0), float(size.max()) / 4000.0)
    while True:
        index = np.floor((vertices - lower) / cell).astype(np.int64)
        counts = index.max(axis=0) + 1
        _, group = np.unique((index[:, 0] * counts[1] + index[:, 1]) * counts[2] + index[:, 2], return_inverse=True)
        members = np.bincount(group)
        few = group[faces]
        few = few[(few[:, 0] != few[:, 1]) & (few[:, 1] != few[:, 2]) & (few[:, 2] != few[:, 0])]
        few = few[
            np.unique(np.sort(few, axis=1) @ np.array([len(members) ** 2, len(members), 1]), return_index=True)[1]
        ]
        if len(few) <= most:
            means = np.column_stack([np.bincount(group, vertices[:, k]) for k in range(3)]) / members[:, None]
            return _used(means, few)
        cell *= 1.25


def _is_open(mesh: trimesh.Trimesh) -> bool:
    """Whether a surface has holes as large as one round hole of `OPEN_SHARE` of its area."""
    edges = mesh.edges_sorted[trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)]
    length = float(np.linalg.norm(mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]], axis=1).sum())
    return length**2 > 4.0 * math.pi * OPEN_SHARE * mesh.area


def _with_wall(mesh: trimesh.Trimesh) -> trimesh.Trimesh | None:
    """An open surface as a thin closed wall, half of it on either side; None where the surface branches."""
    vertices, faces, n = np.asarray(mesh.vertices), np.asarray(mesh.faces), len(mesh.vertices)
    offset = 0.5 * WALL_M * np.asarray(mesh.vertex_normals)
    inverse = np.array(mesh.edges_unique_inverse, dtype=np.int64)
    rim = np.flatnonzero(np.bincount(inverse) == 1)
    edges = mesh.edges[np.isin(inverse, rim)]
    sides = np.concatenate(
        [
            np.column_stack((edges[:, 1], edges[:, 0], edges[:, 0] + n)),
            np.column_stack((edges[:, 1], edges[:, 0] + n, edges[:, 1] + n)),
        ]
    )
    walled = trimesh.Trimesh(
        np.concatenate([vertices + offset, vertices - offset]),
        np.concatenate([faces, faces[:, ::-1] + n, sides]),
        process=False,
    )
    sound = walled.is_watertight and walled.is_winding_consistent
    return walled if sound and 0.3 < walled.volume / (WALL_M * mesh.area) < 2.0 else None


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
    used = _is_used(vertices, faces)
    return np.asarray(vertices)[used], (np.cumsum(used) - 1)[faces]


def _corners(vertices: Array, faces: Faces) -> Array:
    """The vertices that belong to triangles."""
    return vertices[_is_used(vertices, faces)]


def _is_used(vertices: Array, faces: Faces) -> NDArray[np.bool_]:
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[faces] = True
    return used


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
        if len(loop) < 3 or 0.5 * np.linalg.norm(fan, axis=1).sum() > HOLE_SHARE * mesh.area:
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
