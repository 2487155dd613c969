"""From a data set's shards to a compact table and back, unit by unit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from xdex_drake.dataset.assets import asset, copy_assets, mesh_path, with_kept_mesh
from xdex_drake.dataset.compact import (
    CompactUnit,
    compact_unit,
    ids_of_row,
    is_source_row,
    lift_of_row,
    pose_of_row,
    rejected_of,
)
from xdex_drake.dataset.files import scene_facts
from xdex_drake.dataset.folder import (
    Rejected,
    completed_units,
    open_dataset,
    read_manifest,
    read_rejected,
    rejected_entry,
    write_failure,
    write_shard,
)
from xdex_drake.dataset.grasp_file import read_grasps, read_metadata
from xdex_drake.dataset.lock import locked
from xdex_drake.dataset.rows import rows_of
from xdex_drake.dataset.schema import Row, grasp_from_row
from xdex_drake.dataset.tables import append_unit, read_units
from xdex_drake.errors import DatasetError
from xdex_drake.grasp import Grasp
from xdex_drake.grasping.restore import restore
from xdex_drake.hand.description import Hand
from xdex_drake.hand.yaml_file import hand_digest
from xdex_drake.jobs.processes import UnitResult, run_units
from xdex_drake.jobs.workbench import hand_of, scene_of, use_one_thread
from xdex_drake.scene.tabletop import Scene

NOTES = ("xdex_commit",)
"""Entries of a shard's metadata that its compact unit keeps."""


def compact_rows(
    unit: str,
    rows: Sequence[Row],
    folder: str | Path,
    *,
    rejected: Sequence[Rejected] = (),
    notes: Mapping[str, str] | None = None,
) -> CompactUnit | None:
    """A unit of a data set in few bytes.

    Args:
        unit: Name of the unit.
        rows: Its rows, all of one scene, sources before what came from them.
        folder: Folder of the data set, whose hands and meshes are used.
        rejected: What found nothing.
        notes: What else to keep about it.

    Returns:
        The unit; None where it has no rows, and so no scene.

    Raises:
        DatasetError: A row cannot be kept so; see `compact_unit`.
    """
    if not rows:
        return None
    scene = scene_of(scene_facts(rows[0], dataset=Path(folder)))
    if any(row["scene_id"] != scene.scene_id for row in rows):
        raise DatasetError(f"unit {unit}: has rows of several scenes, and so cannot be compacted")
    by_hand: dict[str, list[Grasp]] = {}
    for row in rows:
        by_hand.setdefault(row["hand"], []).append(grasp_from_row(row))
    digests = {row["hand"]: row["hand_digest"] for row in rows}
    hands = {name: hand_of(str(asset(folder, digest) or name)) for name, digest in digests.items()}
    grasps = [(hands[name], name, digests[name], some) for name, some in by_hand.items()]
    compact = compact_unit(unit, scene, grasps, rejected=rejected, notes=notes)
    facts = replace(compact.header.scene, object_path=rows[0]["object_path"])  # that in any folder, not in this one
    return replace(compact, header=replace(compact.header, scene=facts))


def compact_shard(folder: str | Path, unit: str, table: str | Path) -> int:
    """Appends one unit of a data set to a compact table; see `compact_dataset`.

    Args:
        folder: Folder of the data set.
        unit: Name of the unit.
        table: Folder of the table.

    Returns:
        Number of its rows.

    Raises:
        DatasetError: The unit cannot be compacted, or the table cannot be written.
        GraspFileError: The shard is damaged.
    """
    path = Path(folder) / "shards" / f"{unit}.parquet"
    metadata = read_metadata(path)
    notes = {key: metadata[key] for key in NOTES if key in metadata}
    compact = compact_rows(unit, read_grasps(path), folder, rejected=read_rejected(path), notes=notes)
    if compact is None:
        return 0
    append_unit(table, compact)
    return sum(map(len, compact.rows))


def compact_dataset(folder: str | Path, table: str | Path) -> tuple[int, int]:
    """Appends the units of a data set that a compact table lacks. The caller keeps other writers off the table.

    Args:
        folder: Folder of the data set.
        table: Folder of the table, begun with the data set's manifest.

    Returns:
        Number of units appended, and of rows in them; units without rows are left out.

    Raises:
        DatasetError: A unit cannot be compacted, or the table cannot be written.
        GraspFileError: A shard is damaged.
    """
    copy_assets(folder, table)
    there = table_units(table)
    counts = [compact_shard(folder, unit, table) for unit in sorted(completed_units(folder) - there)]
    return sum(count > 0 for count in counts), sum(counts)


def table_units(table: str | Path) -> set[str]:
    """Names of the sound units of a compact table."""
    return {unit.header.unit for unit in read_units(table)}


def stored_grasps(
    unit: CompactUnit, folder: str | Path
) -> Iterator[tuple[Hand, Scene, list[tuple[Grasp, NDArray[np.bool_]]]]]:
    """The grasps of a compact unit as they are stored: poses, names and lifts, without certificates.

    Args:
        unit: The unit.
        folder: Folder of its table or data set, whose hands and meshes are used.

    Yields:
        Each hand with the scene, and its grasps with the slots that touch.

    Raises:
        DatasetError: A hand is not the one it was made with.
        GraspFileError: The object is not the one it was made with.
    """
    header, facts = unit.header, unit.header.scene
    scene = scene_of(replace(facts, object_path=mesh_path(folder, facts.object_path, facts.digest)))
    for entry, table, is_source in zip(header.hands, unit.rows, is_source_row(header), strict=True):
        hand = hand_of(str(asset(folder, entry.digest) or entry.path))
        if hand_digest(hand) != entry.digest:
            raise DatasetError(f"unit {header.unit}: hand {entry.name} is not the one it was made with; restore it")
        grasps = []
        for row, first in zip(table, is_source.tolist(), strict=True):
            X_WH, q, slots = pose_of_row(row, hand, scene)
            name, source = ids_of_row(row, entry, header, is_source=first)
            lift = lift_of_row(row, hand, header)
            grasp = Grasp(
                hand.name, scene.object.name, scene.X_WO, X_WH, q, grasp_id=name, source_grasp_id=source, lift=lift
            )
            grasps.append((grasp, slots))
        yield hand, scene, grasps


def plain_rows(unit: CompactUnit, folder: str | Path) -> tuple[Row, ...]:
    """The rows of a compact unit without certificates, pre-grasps and squeezes; see `stored_grasps`."""
    parts = stored_grasps(unit, folder)
    rows = _with_points((hand, scene, [grasp for grasp, _ in some]) for hand, scene, some in parts)
    return tuple(with_kept_mesh(folder, rows))


def expand_unit(unit: CompactUnit, folder: str | Path) -> tuple[Row, ...]:
    """The rows of a compact unit, whole again.

    Args:
        unit: The unit.
        folder: Folder of its table or data set, whose hands and meshes are used.

    Returns:
        Its rows. Certificates, pre-grasps and squeezes are computed again; lifts are those that were stored. A grasp
        that cannot be certified again has no certificate.

    Raises:
        DatasetError: A hand is not the one it was made with.
        GraspFileError: The object is not the one it was made with.
    """
    use_one_thread()

    def whole(hand: Hand, scene: Scene, stored: Grasp, slots: NDArray[np.bool_]) -> Grasp:
        found = restore(hand, scene, stored.X_WH, stored.q, slots).grasp
        if found is None:
            return stored
        own = {"grasp_id": stored.grasp_id, "source_grasp_id": stored.source_grasp_id, "lift": stored.lift}
        return replace(found, **own, seconds=0.0)

    parts = stored_grasps(unit, folder)
    rows = _with_points((hand, scene, [whole(hand, scene, *entry) for entry in some]) for hand, scene, some in parts)
    return tuple(with_kept_mesh(folder, rows))


def _with_points(parts: Iterable[tuple[Hand, Scene, list[Grasp]]]) -> list[Row]:
    """Rows of a unit's grasps, sources first, whose object points those that come from them share."""
    rows: list[Row] = []
    points: dict[str, Sequence[float]] = {}
    for hand, scene, grasps in parts:
        made = rows_of(grasps, hand, scene, source_points=points)
        points |= {row["grasp_id"]: row["object_point_O"] for row in made}
        rows += made
    return rows


def expand_table(
    table: str | Path,
    folder: str | Path,
    *,
    workers: int = 2,
    on_done: Callable[[UnitResult[CompactUnit, tuple[Row, ...]]], None] | None = None,
) -> tuple[int, int]:
    """Makes a data set's shards from a compact table; those that are there stay.

    Args:
        table: Folder of the table.
        folder: Folder of the data set; made where there is none.
        workers: Number of processes; 0 works in this one.
        on_done: Called with each unit's result after its shard is written.

    Returns:
        Number of units made by this call, and of units that failed.

    Raises:
        DatasetError: The folder holds another data set, or cannot be written.
    """
    open_dataset(folder, read_manifest(table))
    copy_assets(table, folder)
    counts = [0, 0]

    def save(result: UnitResult[CompactUnit, tuple[Row, ...]]) -> None:
        header = result.unit.header
        if result.value is None:
            write_failure(folder, header.unit, str(result.failure))
            counts[1] += 1
        else:
            entries = rejected_entry(rejected_of(header)) | header.notes
            write_shard(folder, header.unit, result.value, metadata=entries)
            counts[0] += 1
        if on_done is not None:
            on_done(result)

    with locked(folder):
        done = completed_units(folder)
        missing = (unit for unit in read_units(table) if unit.header.unit not in done)
        for _ in run_units(missing, partial(expand_unit, folder=table), workers=workers, on_done=save):
            pass
    return counts[0], counts[1]
