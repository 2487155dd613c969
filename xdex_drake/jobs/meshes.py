"""Sets of meshes: files checked, repaired, scaled and indexed; generated shapes written."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
import trimesh

from xdex_drake.arrays import Array
from xdex_drake.errors import XdexError
from xdex_drake.mesh_file import MESH_SUFFIXES, Faces
from xdex_drake.scene.generator import family_name, generated_mesh, shape_name
from xdex_drake.scene.object import ObjectModel, load_object
from xdex_drake.whole_file import write_text

MOST_BULGE_MM = 1.0
"""Meshes whose parts bulge more are named at import."""


@dataclass(frozen=True)
class MeshRow:
    """A line of the index of imported meshes; numbers are text as they are written, empty where the file was refused.

    Attributes:
        name: Name of the object in the set.
        file: The cleaned mesh in the set's folder.
        source: The file it came from.
        scale: Factor from the file's unit to metres.
        x_m: Size along x [m].
        y_m: Size along y [m].
        z_m: Size along z [m].
        triangles: Number of triangles.
        closed: Whether the surface is closed.
        parts: Number of convex parts.
        bulge_p99_mm: How far the parts stand out of the mesh, 99th percentile [mm].
        gap_p99_mm: How far the mesh stands out of the parts, 99th percentile [mm].
        seconds: Processor time of the preparation [s].
        volume_cm3: Volume of the material [cm^3].
        wall_mm: Thickness of the walls, on average, of a shell [mm].
        repairs: What was mended, or why the file was refused.
    """

    name: str
    file: str = ""
    source: str = ""
    scale: str = ""
    x_m: str = ""
    y_m: str = ""
    z_m: str = ""
    triangles: str = ""
    closed: str = ""
    parts: str = ""
    bulge_p99_mm: str = ""
    gap_p99_mm: str = ""
    seconds: str = ""
    volume_cm3: str = ""
    wall_mm: str = ""
    repairs: str = ""


@dataclass(frozen=True, eq=False)
class ImportedMesh:
    """What became of a mesh file.

    Attributes:
        row: Its line of the index.
        model: The object, None where the file was refused.
        refused: Why it was refused, empty where it was not.
    """

    row: MeshRow
    model: ObjectModel | None
    refused: str = ""

    @property
    def remarks(self) -> list[str]:
        """What a person should know: repairs, and parts that bulge."""
        if self.model is None:
            return []
        report, name = self.model.report, self.row.name
        told = [f"{name}: {repair}" for repair in report.repairs]
        if 1e3 * report.bulge_p99_m > MOST_BULGE_MM:
            told.append(f"{name}: its parts stand out of the mesh by {self.row.bulge_p99_mm} mm (p99)")
        return told


def import_meshes(paths: Sequence[Path], out: Path, *, scale: float | None = None) -> Iterator[ImportedMesh]:
    """Imports mesh files one by one: each is prepared, cleaned, and written as OBJ in metres.

    Args:
        paths: The files.
        out: Folder of the cleaned meshes; made where it does not exist.
        scale: Factor from the files' unit to metres; guessed for each by its size where None.

    Yields:
        What became of each; a file that cannot be used is told and does not end the rest.
    """
    taken: set[str] = set()
    for path in paths:
        try:
            model = load_object(path, scale=scale)
        except XdexError as error:
            row = MeshRow(path.stem, source=str(path), repairs=str(error))
            yield ImportedMesh(row, None, str(error))
            continue
        target = out / f"{_free_name(model.name, taken)}.obj"
        write_obj(target, model.vertices, model.faces)
        yield ImportedMesh(_row(model, target, path), model)


def _row(model: ObjectModel, target: Path, source: Path) -> MeshRow:
    report, size = model.report, np.ptp(model.vertices, axis=0)
    return MeshRow(
        name=target.stem,
        file=target.name,
        source=str(source),
        scale=f"{model.scale:g}",
        x_m=f"{size[0]:.6f}",
        y_m=f"{size[1]:.6f}",
        z_m=f"{size[2]:.6f}",
        triangles=str(len(model.faces)),
        closed=str(report.watertight),
        parts=str(report.parts),
        bulge_p99_mm=f"{1e3 * report.bulge_p99_m:.3f}",
        gap_p99_mm=f"{1e3 * report.gap_p99_m:.3f}",
        seconds=f"{report.seconds:.2f}",
        volume_cm3=f"{1e6 * report.volume:.4g}",
        wall_mm="" if report.wall is None else f"{1e3 * report.wall:.3g}",
        repairs="; ".join(report.repairs),
    )


def write_index(path: Path, rows: Iterable[MeshRow]) -> None:
    """Writes the index of a set as CSV, whole or not at all."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(MeshRow)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    write_text(path, text.getvalue())


@dataclass(frozen=True, eq=False)
class WrittenShape:
    """A generated shape that was written.

    Attributes:
        name: Its name, by which every command builds it again.
        family: Its family.
        vertices: Its vertices [m], shape (n, 3).
        faces: Its triangles, shape (m, 3).
        volume_m3: Its volume [m^3].
    """

    name: str
    family: str
    vertices: Array
    faces: Faces
    volume_m3: float


def write_shapes(count: int, seed: int, out: Path, *, prepare: bool = False) -> Iterator[WrittenShape]:
    """Builds the first shapes of a seed and writes them as OBJ in metres.

    Args:
        count: Number of shapes.
        seed: Seed of the set.
        out: Folder of the meshes; made where it does not exist.
        prepare: Also compute the convex parts, which takes seconds a shape, and keep them in the cache.

    Yields:
        Each shape once it is written.
    """
    for index in range(count):
        name = shape_name(seed, index)
        vertices, faces = generated_mesh(name)
        write_obj(out / f"{name}.obj", vertices, faces)
        if prepare:
            load_object(name)
        volume = float(trimesh.Trimesh(vertices, faces, process=False).volume)
        yield WrittenShape(name, family_name(name), vertices, faces, volume)


def mesh_files(path: Path) -> list[Path]:
    """The mesh files of a folder and its folders, in order; a file is itself."""
    if not path.is_dir():
        return [path]
    return sorted(p for p in path.rglob("*") if p.suffix.lower() in MESH_SUFFIXES and p.is_file())


def write_obj(path: Path, vertices: Array, faces: Faces) -> None:
    """Writes a mesh as OBJ, whole or not at all.

    Raises:
        ConfigError: The file cannot be written.
    """
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    write_text(path, "\n".join(lines) + "\n")


def _free_name(name: str, taken: set[str]) -> str:
    """A name that no other mesh of the set has."""
    free, k = name, 2
    while free in taken:
        free, k = f"{name}_{k}", k + 1
    taken.add(free)
    return free
