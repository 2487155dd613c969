"""Convex decomposition of a mesh, cached: the shape that is simulated, touched and kept clear of."""

import hashlib
import logging
import resource
import zipfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import coacd
import manifold3d
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from xdex_drake.arrays import Array
from xdex_drake.cache import cache_folder, write_cache_file
from xdex_drake.errors import ObjectFileError
from xdex_drake.scene.distance import ExactDistance, HalfSpaces, Part, build_grid, sample_surface, union_surface
from xdex_drake.scene.plane_cuts import Bulge, split_by_planes
from xdex_drake.scene.split_process import split_in_process

Faces = NDArray[np.int64]
_log = logging.getLogger(__name__)

RECIPE = 7  # Raise whenever the way from a mesh to its parts changes: it is part of the cache's key.
HULL_VERTICES = 256  # Four times as many vertices as 64 cost Drake's queries a quarter more time, measured.
HULL_TOLERANCE = 5e-5
GROWTH = 5e-5
HULL_BULGE = 0.5e-3  # A mesh whose own hull bulges less is one part [m].
TARGET_BULGE = 1e-3
CONCAVITY = 3e-3
FINE_CONCAVITY = 2e-3
REFINE_PARTS = 40
MAX_PARTS = 64
SAMPLES = 8000  # Points at which parts are compared with their mesh.
FEW_SAMPLES = 1000  # The same for a mesh that is hardly one of an object: each of its points can take milliseconds.
CUT_SHARE = 0.007  # Of the area may bulge more than the target, so that the 99th percentile stays below it.
CUT_PIECES = 128
COARSE_PIECES = 48
LIGHT_TRIANGLES = 8000
"""A surface is simplified to about this many triangles before it is split, as far as that costs less than 1 mm."""


class TooDetailed(RuntimeError):
    """A mesh whose fine split would take minutes."""


@dataclass(frozen=True)
class ConvexParts:
    """A mesh as a union of convex bodies.

    Attributes:
        parts: Vertices (n, 3) [m] and outward faces (m, 3) of each part, in the mesh's frame.
        surface: Vertices (n, 3) [m] and outward faces (m, 3) of their union.
        bulge_p99_m: 99th percentile over the union's surface of the distance by which it stands outside the mesh [m].
        gap_p99_m: 99th percentile over the mesh's surface of the distance by which it stands outside the union [m].
        seconds: Processor time that it took to compute [s]; that of the first time where it comes from the cache.
        cached: Whether it comes from the cache.
        note: What is not as usual about the split, in words.
    """

    parts: tuple[Part, ...]
    surface: Part
    bulge_p99_m: float
    gap_p99_m: float
    seconds: float
    cached: bool
    note: str = ""


def mesh_digest(vertices: Array, faces: Faces) -> str:
    """Fingerprint of a mesh: SHA-256 of its vertices in whole nanometres and of its faces.

    Args:
        vertices: Vertices [m], shape (n, 3).
        faces: Vertex indices, shape (m, 3).

    Returns:
        64 hexadecimal digits.
    """
    sha = hashlib.sha256(np.rint(np.asarray(vertices) * 1e9).astype("<i8").tobytes())
    sha.update(np.asarray(faces).astype("<i8").tobytes())
    return sha.hexdigest()


def convex_parts(vertices: Array, faces: Faces, *, likely: bool = True) -> ConvexParts:
    """Splits a mesh into convex parts, or reads them from the cache.

    Args:
        vertices: Vertices [m], shape (n, 3).
        faces: Outward triangles, shape (m, 3).
        likely: Whether the mesh looks like one of an object; others get less time (`xdex_drake.scene.split_process`).

    Returns:
        The parts, their union and how well it fits the mesh.

    Raises:
        ObjectFileError: The mesh cannot be decomposed.
    """
    file = cache_folder() / f"parts-{RECIPE}-{version('coacd')}-{mesh_digest(vertices, faces)[:32]}.npz"
    if (arrays := read_cache(file)) is not None:
        try:
            return _from_arrays(arrays)
        except (KeyError, ValueError, IndexError):
            _log.warning("%s is damaged and is computed again", file)
    start = _processor_s()
    hull = _part(vertices, 0.0)
    parts, note = (hull,), ""
    samples = SAMPLES if likely else FEW_SAMPLES
    if _is_hollow(vertices, faces, hull) or fit(vertices, faces, parts, hull, samples=samples)[0] > HULL_BULGE:
        parts, note = split_in_process(vertices, faces, likely=likely)
    surface = union_surface(parts)
    bulge, gap = fit(vertices, faces, parts, surface, samples=samples)
    result = ConvexParts(parts, surface, bulge, gap, _processor_s() - start, False, note)
    write_cache(file, _to_arrays(result))
    return result


def _is_hollow(vertices: Array, faces: Faces, hull: Part) -> bool:
    """Whether the first of the points of `fit` suffice to tell that the hull bulges: one percent of all do already."""
    points = sample_surface(*hull, SAMPLES, 0)[0][: SAMPLES // 20]
    bulging = ExactDistance(vertices, faces).query(points).distance > HULL_BULGE
    return int(np.count_nonzero(bulging)) > SAMPLES // 100


def split(vertices: Array, faces: Faces) -> tuple[Part, ...]:
    """Splits a mesh by CoACD, finer a second time where the first result bulges on few parts.

    The second pass depends on the number of parts and not on time, so that the result is the same on every machine. A
    mesh that CoACD must mend gets none: the mending costs more accuracy than a second pass would bring.

    Args:
        vertices: Vertices [m], shape (n, 3).
        faces: Outward triangles, shape (m, 3).

    Returns:
        The parts. Not for use in the caller's process: see `split_in_process`.
    """
    coacd.set_log_level("error")
    solid = _light_mesh(vertices, faces)
    parts = _run_coacd(solid or (vertices, faces), CONCAVITY, 2 * MAX_PARTS, mend=solid is None)
    bulge = fit(vertices, faces, parts, union_surface(parts))[0]
    if solid is not None and bulge > TARGET_BULGE and len(parts) <= REFINE_PARTS:
        finer = _run_coacd(solid, FINE_CONCAVITY, MAX_PARTS, mend=False)
        if fit(vertices, faces, finer, union_surface(finer))[0] < bulge:
            return finer
    return parts


def refine(vertices: Array, faces: Faces, parts: tuple[Part, ...]) -> tuple[Part, ...]:
    """Parts of a mesh that follow it better, by plane cuts, where those at hand bulge.

    Parts within `TARGET_BULGE` are handed back as they are. The work is limited by a number of pieces and not by time,
    so that the result is the same on every machine.

    Args:
        vertices: Vertices [m], shape (n, 3).
        faces: Outward triangles, shape (m, 3).
        parts: The parts at hand, from `split`.

    Returns:
        The parts from plane cuts where they reach the target, or come clearly nearer to it; else those at hand.
    """
    bulge = fit(vertices, faces, parts, union_surface(parts))[0]
    if bulge <= TARGET_BULGE or (light := _light_mesh(vertices, faces)) is None:
        return parts
    solid = manifold3d.Manifold(manifold3d.Mesh64(light[0], light[1].astype(np.uint64)))
    above = Bulge(vertices, faces, TARGET_BULGE - GROWTH - 2e-5)
    cut = _grown([points for points, _ in split_by_planes(solid, above, share=CUT_SHARE, most=CUT_PIECES)])
    reached = fit(vertices, faces, cut, union_surface(cut))[0]
    better = reached <= TARGET_BULGE or reached < 0.8 * bulge or (reached < bulge and len(cut) <= len(parts))
    return cut if better else parts


def split_coarsely(vertices: Array, faces: Faces) -> tuple[Part, ...]:
    """Splits a mesh by plane cuts into a limited number of parts, fast: where CoACD does not end, or takes minutes.

    Args:
        vertices: Vertices [m], shape (n, 3).
        faces: Outward triangles, shape (m, 3).

    Returns:
        The parts.

    Raises:
        ObjectFileError: The surface encloses nothing.
    """
    coacd.set_log_level("error")
    solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))
    if solid.status() != manifold3d.Error.NoError or solid.volume() <= 0.0:
        solid = _level_set(vertices, faces)
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    bodies = [body for body in solid.decompose() if body.volume() > 1e-6 * size**3]
    if len(bodies) > MAX_PARTS:
        raise ObjectFileError(f"consists of {len(bodies)} separate bodies; import them one by one")
    if not bodies:
        raise ObjectFileError("encloses no volume that could be split into convex parts; export a closed surface")
    solid, tolerance = manifold3d.Manifold.compose(bodies), 1e-3 * size
    while solid.num_tri() > 2000 and tolerance < 0.05 * size:
        solid, tolerance = solid.simplify(tolerance), 2.0 * tolerance
    mesh = solid.to_mesh64()
    light = np.array(mesh.vert_properties, dtype=np.float64)[:, :3], np.array(mesh.tri_verts, dtype=np.int64)
    cut = split_by_planes(solid, Bulge(*light, TARGET_BULGE - GROWTH), share=CUT_SHARE, most=COARSE_PIECES)
    return _grown([points for points, _ in cut])


def _light_mesh(vertices: Array, faces: Faces) -> Part | None:
    """The mesh as one closed surface without inner voids and detail below 0.15 mm; None where it cannot be had."""
    solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))
    if solid.status() != manifold3d.Error.NoError or solid.volume() <= 0.0:
        solid = _level_set(vertices, faces)
    bodies = [body for body in solid.decompose() if body.volume() > 0.0]
    if not bodies:
        return None
    solid, tolerance = manifold3d.Manifold.compose(bodies).simplify(1.5e-4), 3e-4
    while solid.num_tri() > LIGHT_TRIANGLES and tolerance < TARGET_BULGE:
        solid, tolerance = solid.simplify(tolerance), 1.5 * tolerance
    if solid.num_tri() > 2 * LIGHT_TRIANGLES:
        raise TooDetailed(f"has too much detail: {solid.num_tri()} triangles of more than 1 mm")
    mesh = solid.to_mesh64()
    light = np.array(mesh.vert_properties, dtype=np.float64)[:, :3], np.array(mesh.tri_verts, dtype=np.int64)
    outside = ExactDistance(*light).query(sample_surface(vertices, faces, 4000, 0)[0]).distance
    return light if np.percentile(outside, 99) < 1e-3 else None  # Thin open sheets are lost in a level set.


def _level_set(vertices: Array, faces: Faces) -> manifold3d.Manifold:
    """Closed surface of what has winding number one half or more: mends a mesh that is not a manifold."""
    exact = ExactDistance(vertices, faces)
    edge = float((np.ptp(vertices, axis=0) + 4e-3).prod() / 40_000) ** (1.0 / 3.0)
    grid = build_grid(exact, margin=3.0 * edge, spacing=edge, cells=400)
    values, (_, ny, nz) = (-grid.values).ravel().tolist(), grid.values.shape
    (x0, y0, z0), step = grid.origin.tolist(), 1.0 / grid.spacing

    def depth(x: float, y: float, z: float) -> float:  # Called for each point: plain floats are ten times as fast.
        u, v, w = (x - x0) * step, (y - y0) * step, (z - z0) * step
        i, j, k = int(u), int(v), int(w)
        u, v, w = u - i, v - j, w - k
        n = (i * ny + j) * nz + k
        m = n + ny * nz
        low = (1 - v) * ((1 - w) * values[n] + w * values[n + 1]) + v * (
            (1 - w) * values[n + nz] + w * values[n + nz + 1]
        )
        high = (1 - v) * ((1 - w) * values[m] + w * values[m + 1]) + v * (
            (1 - w) * values[m + nz] + w * values[m + nz + 1]
        )
        return (1 - u) * low + u * high

    bounds = [*(vertices.min(axis=0) - 0.5 * edge), *(vertices.max(axis=0) + 0.5 * edge)]
    return manifold3d.Manifold.level_set(depth, bounds, edge)


def _run_coacd(mesh: Part, concavity: float, most: int, *, mend: bool) -> tuple[Part, ...]:
    """Runs CoACD with a concavity in metres; few and shallow tree searches, which take most of its time.

    Its own mending of meshes moves the surface outwards, by 2 mm on a flashlight: only for what cannot be mended here.
    """
    pieces = coacd.run_coacd(
        coacd.Mesh(mesh[0], mesh[1].astype(np.int32)),
        threshold=concavity,
        real_metric=True,
        max_convex_hull=most,
        mcts_iterations=20,
        mcts_max_depth=2,
        mcts_nodes=10,
        resolution=1000,
        preprocess_mode="on" if mend else "off",
        preprocess_resolution=40,
        seed=1,
    )
    return _grown([np.asarray(points) for points, _ in pieces])


def _grown(pieces: list[Array]) -> tuple[Part, ...]:
    """The parts of point sets, without those that are flat."""
    parts = []
    for points in pieces:
        try:
            parts.append(_part(points, GROWTH))
        except ObjectFileError:
            _log.debug("left out a flat part of %d points", len(points))
    if not parts:
        raise ObjectFileError("has no part with a volume; give the object a thickness")
    return tuple(parts)


def _part(points: Array, growth: float) -> Part:
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


def fit(
    vertices: Array,
    faces: Faces,
    parts: list[Part] | tuple[Part, ...],
    surface: Part,
    *,
    samples: int = SAMPLES,
) -> tuple[float, float]:
    """How far the parts stand out of a mesh, and the mesh out of the parts.

    Args:
        vertices: Vertices of the mesh [m], shape (n, 3).
        faces: Faces of the mesh, shape (m, 3).
        parts: The convex parts.
        surface: The surface of their union.
        samples: Number of points on either surface.

    Returns:
        99th percentiles of the two distances over the points [m].
    """
    mesh, union = ExactDistance(vertices, faces), ExactDistance(*surface, parts=parts)
    out = mesh.query(sample_surface(*surface, samples, 0)[0]).distance
    missing = union.query(sample_surface(vertices, faces, samples, 0)[0]).distance
    return float(np.percentile(out.clip(0.0), 99)), float(np.percentile(missing.clip(0.0), 99))


def _processor_s() -> float:
    """Processor time of this process and of its children that have ended [s]."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def _to_arrays(result: ConvexParts) -> dict[str, NDArray]:
    return {
        "part_vertices": np.concatenate([v for v, _ in result.parts]),
        "part_faces": np.concatenate([f for _, f in result.parts]),
        "counts": np.array([(len(v), len(f)) for v, f in result.parts]),
        "surface_vertices": result.surface[0],
        "surface_faces": result.surface[1],
        "figures": np.array([result.bulge_p99_m, result.gap_p99_m, result.seconds]),
        "note": np.array(result.note),
    }


def _from_arrays(arrays: dict[str, NDArray]) -> ConvexParts:
    ends = arrays["counts"].cumsum(axis=0)[:-1]
    parts = zip(np.split(arrays["part_vertices"], ends[:, 0]), np.split(arrays["part_faces"], ends[:, 1]), strict=True)
    bulge, gap, seconds = (float(x) for x in arrays["figures"])
    surface = (arrays["surface_vertices"], arrays["surface_faces"])
    note = str(arrays["note"]) if "note" in arrays else ""
    return ConvexParts(tuple(parts), surface, bulge, gap, seconds, True, note)


def read_cache(file: Path) -> dict[str, NDArray] | None:
    """Reads a cached file of arrays; a damaged file counts as absent.

    Args:
        file: File in the cache folder.

    Returns:
        The arrays, or None.
    """
    try:
        with np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        _log.warning("%s is damaged and is computed again", file)
        return None


def write_cache(file: Path, arrays: dict[str, NDArray]) -> None:
    """Writes a cached file of arrays; see `write_cache_file`.

    Args:
        file: File in the cache folder.
        arrays: Arrays to keep.
    """

    def write(path: Path) -> None:
        with path.open("wb") as stream:
            np.savez_compressed(stream, **arrays)  # pyright: ignore[reportArgumentType]

    write_cache_file(file, write)
