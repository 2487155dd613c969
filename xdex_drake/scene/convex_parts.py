"""Convex decomposition of a mesh, cached: the shape that is simulated, touched and kept clear of."""

import hashlib
import logging
import resource
import zipfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.cache import cache_folder, write_cache_file
from xdex_drake.mesh_file import Faces
from xdex_drake.scene.distance import ExactDistance, Part, sample_surface, union_surface
from xdex_drake.scene.hulls import hull_part
from xdex_drake.scene.split_process import split_in_process
from xdex_drake.scene.splitting import SAMPLES, fit

_log = logging.getLogger(__name__)
RECIPE = 7  # Raise whenever the way from a mesh to its parts changes: it is part of the cache's key.
HULL_BULGE = 0.5e-3  # A mesh whose own hull bulges less is one part [m].
FEW_SAMPLES = 1000  # The same for a mesh that is hardly one of an object: each of its points can take milliseconds.


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
    hull = hull_part(vertices, 0.0)
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
