"""Counts what a data set holds."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from xdex_drake.dataset.folder import failed_units, iter_shards, read_manifest, shard_paths


@dataclass(frozen=True)
class Count:
    """Number of grasps, and of those whose lift succeeded."""

    rows: int
    successes: int


@dataclass(frozen=True)
class DatasetInfo:
    """Summary of a data set.

    Attributes:
        units_planned: Number of units in the manifest.
        units_done: Number of units that have a shard.
        failures: Reason of each unit that failed.
        rows: Number of grasps.
        successes: Number of grasps whose lift succeeded.
        sources: Number of grasps that were not retargeted from another.
        by_hand: Counts by the hand's name.
        by_object: Counts by the object's name.
        failure_reasons: Number of failed lifts by their reason.
        seconds: Wall time spent on all grasps, lifts included.
        bytes: Size of all shards.
    """

    units_planned: int
    units_done: int
    failures: dict[str, str]
    rows: int
    successes: int
    sources: int
    by_hand: dict[str, Count]
    by_object: dict[str, Count]
    failure_reasons: dict[str, int]
    seconds: float
    bytes: int


def info(folder: str | Path) -> DatasetInfo:
    """Summary of a data set.

    Args:
        folder: Folder of the data set.

    Returns:
        Counts, times and sizes.

    Raises:
        DatasetError: The folder is no data set.
        GraspFileError: A shard is damaged.
    """
    manifest = read_manifest(folder)
    names = ["hand", "object", "success", "failure_reason", "source_grasp_id", "seconds", "lift_seconds"]
    by_hand: Counter[tuple[str, bool]] = Counter()
    by_object: Counter[tuple[str, bool]] = Counter()
    failure_reasons: Counter[str] = Counter()
    done = sources = 0
    seconds = 0.0
    for _, table in iter_shards(folder, names):
        done += 1
        for row in table.to_pylist():
            success = row["success"] is True
            by_hand[row["hand"], success] += 1
            by_object[row["object"], success] += 1
            failure_reasons.update([row["failure_reason"]] if row["failure_reason"] else [])
            sources += not row["source_grasp_id"]
            seconds += row["seconds"] + (row["lift_seconds"] or 0.0)
    return DatasetInfo(
        units_planned=len(manifest.units),
        units_done=done,
        failures=failed_units(folder),
        rows=by_hand.total(),
        successes=sum(count for (_, success), count in by_hand.items() if success),
        sources=sources,
        by_hand=_counts(by_hand),
        by_object=_counts(by_object),
        failure_reasons=dict(failure_reasons.most_common()),
        seconds=seconds,
        bytes=sum(path.stat().st_size for path in shard_paths(folder)),
    )


def _counts(counter: Counter[tuple[str, bool]]) -> dict[str, Count]:
    """Counts by name, from counts by name and success."""
    names = sorted({name for name, _ in counter})
    return {name: Count(counter[name, True] + counter[name, False], counter[name, True]) for name in names}
