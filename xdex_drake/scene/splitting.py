"""Ways to split a mesh into convex bodies: CoACD, planes, and what is done where these are not enough."""

import logging

import coacd
import manifold3d
import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import ObjectFileError
from xdex_drake.mesh_file import Faces
from xdex_drake.scene.distance import ExactDistance, Part, build_grid, sample_surface, union_surface
from xdex_drake.scene.hulls import hull_part
from xdex_drake.scene.plane_cuts import Bulge, split_by_planes

_log = logging.getLogger(__name__)

GROWTH = 5e-5
TARGET_BULGE = 1e-3
CONCAVITY = 3e-3
FINE_CONCAVITY = 2e-3
REFINE_PARTS = 40
MAX_PARTS = 64
SAMPLES = 8000  # Points at which parts are compared with their mesh.
CUT_SHARE = 0.007  # Of the area may bulge more than the target, so that the 99th percentile stays below it.
CUT_PIECES = 128
COARSE_PIECES = 48
LIGHT_TRIANGLES = 8000
"""A surface is simplified to about this many triangles before it is split, as far as that costs less than 1 mm."""


class TooDetailed(RuntimeError):
    """A mesh whose fine split would take minutes."""


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
            parts.append(hull_part(points, GROWTH))
        except ObjectFileError:
            _log.debug("left out a flat part of %d points", len(points))
    if not parts:
        raise ObjectFileError("has no part with a volume; give the object a thickness")
    return tuple(parts)


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
