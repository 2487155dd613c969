"""Data set folders: what is planned, what is done, what failed.

A data set is a folder with `manifest.json`, which says what the data set is to hold, and `shards/UNIT.parquet`, a file
of grasps for each unit of work. `failures/UNIT.json` says why a unit has no shard. What a unit tried without finding a
grasp stands in the metadata of its shard.
"""

import json
import logging
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import pyarrow as pa

from xdex_drake.dataset.grasp_file import READABLE, REMEDY, read_metadata, read_table, write_grasps
from xdex_drake.dataset.lock import is_lock
from xdex_drake.dataset.schema import SCHEMA, SCHEMA_VERSION, Row
from xdex_drake.errors import DatasetError, GraspFileError
from xdex_drake.whole_file import PARTIAL, whole_file

_log = logging.getLogger(__name__)


REJECTED = "xdex_rejected"
"""Entry of a shard's metadata: the attempts of its unit that found no grasp."""

_UNIT_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._+=-]{0,199}")


@dataclass(frozen=True)
class Manifest:
    """What a data set is to hold; equal manifests mean equal rows.

    Attributes:
        config: Resolved configuration: numbers, strings, booleans, None, lists and dictionaries with string keys.
        seed: Seed of the whole data set.
        units: Names of the units of work, in order: letters, digits and `._+=-`.
        versions: Version of each library that the rows depend on.
        digests: Digest of each input, under `hand/NAME` and `object/NAME`; `verify` holds the rows against them.
        schema_version: Version of the columns.
    """

    config: Mapping[str, Any]
    seed: int
    units: tuple[str, ...]
    versions: Mapping[str, str]
    digests: Mapping[str, str]
    schema_version: int = SCHEMA_VERSION


@dataclass(frozen=True)
class Rejected:
    """An attempt that found no grasp: little to store, and something to learn from.

    Attributes:
        hand: Name of the hand.
        source_grasp_id: The grasp that it should have carried over.
        reason: Why there is none, by `Rejection.name`.
    """

    hand: str
    source_grasp_id: str
    reason: str


def open_dataset(folder: str | Path, manifest: Manifest) -> None:
    """Begins a data set, or goes on with one that was begun with an equal manifest.

    Args:
        folder: Folder of the data set; made where there is none.
        manifest: What it is to hold.

    Raises:
        DatasetError: The folder holds another data set, is not empty, or cannot be written; or the manifest has unit
            names that cannot be file names, or repeats one.
    """
    target = Path(folder)
    wrong = [unit for unit in manifest.units if not _UNIT_NAME.fullmatch(unit)]
    repeated = [unit for unit, count in Counter(unit.lower() for unit in manifest.units).items() if count > 1]
    if wrong or repeated:
        raise DatasetError(f"{target}: unit names must be distinct, of letters, digits and ._+=-: {wrong or repeated}")
    path = target / "manifest.json"
    text = _manifest_text(manifest)
    if path.exists():
        _check_same_manifest(read_manifest(target), manifest, path)
        return
    if target.exists() and (
        not target.is_dir()
        or any(not PARTIAL.fullmatch(entry.name) and not is_lock(entry.name) for entry in target.iterdir())
    ):
        raise DatasetError(f"{target}: holds something else than a data set; choose a new or empty folder")
    try:
        target.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as unfinished:
            unfinished.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DatasetError(f"{path}: cannot be written: {error}") from error


def read_manifest(folder: str | Path) -> Manifest:
    """Manifest of a data set.

    Args:
        folder: Folder of the data set.

    Returns:
        The manifest, its lists and dictionaries as JSON holds them.

    Raises:
        DatasetError: There is none, it cannot be read, or it is of another version.
    """
    path = Path(folder) / "manifest.json"
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        names = {entry.name for entry in fields(Manifest)}
        if not isinstance(values, dict) or set(values) != names:
            raise DatasetError(f"{path}: must have exactly the fields {', '.join(sorted(names))}")
        manifest = Manifest(**{**values, "units": tuple(values["units"])})
    except FileNotFoundError as error:
        raise DatasetError(
            f"{Path(folder)}: is no data set, it has no manifest.json; name the folder of one"
        ) from error
    except (OSError, TypeError, ValueError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}; {REMEDY}") from error
    if str(manifest.schema_version) not in READABLE:
        raise DatasetError(
            f"{path}: schema_version is {manifest.schema_version}, but this version of the library reads "
            f"{' and '.join(sorted(READABLE))}"
        )
    return manifest


def write_shard(
    folder: str | Path, unit: str, rows: Iterable[Row], *, metadata: Mapping[str, str] | None = None
) -> None:
    """Writes the shard of a unit, which is complete from then on.

    Args:
        folder: Folder of the data set.
        unit: Name of the unit.
        rows: Its rows; there may be none.
        metadata: More to say about the unit. What varies from run to run, as a time does, makes the bytes vary.

    Raises:
        DatasetError: The unit's name cannot be a file name.
        GraspFileError: A row has unknown, missing or wrong columns, or the file cannot be written.
    """
    write_grasps(_shard(folder, unit), rows, metadata=metadata)
    _failure(folder, unit).unlink(missing_ok=True)


def rejected_entry(rejected: Iterable[Rejected]) -> dict[str, str]:
    """The metadata entry of a shard that holds what was tried without finding a grasp."""
    return {REJECTED: json.dumps([(r.hand, r.source_grasp_id, r.reason) for r in rejected])}


def iter_rejected(folder: str | Path) -> Iterator[tuple[str, tuple[Rejected, ...]]]:
    """What the units of a data set tried without finding a grasp, in the order of their names.

    Args:
        folder: Folder of the data set.

    Yields:
        Name of the unit and its attempts.

    Raises:
        DatasetError: The folder is no data set, or an entry cannot be read.
        GraspFileError: A shard is damaged.
    """
    read_manifest(folder)
    for path in shard_paths(folder):
        yield path.name.removesuffix(".parquet"), read_rejected(path)


def read_rejected(path: str | Path) -> tuple[Rejected, ...]:
    """What the unit of a shard tried without finding a grasp; see `iter_rejected`."""
    text = read_metadata(path).get(REJECTED, "[]")
    try:
        return tuple(Rejected(*(str(part) for part in entry)) for entry in json.loads(text))
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{path}: {REJECTED} of its metadata cannot be read: {error}; {REMEDY}") from error


def write_failure(folder: str | Path, unit: str, reason: str) -> None:
    """Records why a unit has no shard. A later run tries it again, and its shard removes the record.

    Args:
        folder: Folder of the data set.
        unit: Name of the unit.
        reason: Why.

    Raises:
        DatasetError: The unit's name cannot be a file name, or the record cannot be written.
    """
    path = _failure(folder, unit)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as unfinished:
            unfinished.write_text(json.dumps({"unit": unit, "reason": reason}, indent=2), encoding="utf-8")
    except OSError as error:
        raise DatasetError(f"{path}: cannot be written: {error}") from error


def completed_units(folder: str | Path) -> set[str]:
    """Units that have a whole shard.

    Shards appear whole, so that one which cannot be read was damaged later; it counts as not complete, so that a run
    that resumes makes it again.

    Args:
        folder: Folder of the data set.

    Returns:
        Names of the units; none where the folder does not exist.
    """
    done = set()
    for path in shard_paths(folder):
        try:
            read_metadata(path)
            done.add(path.name.removesuffix(".parquet"))
        except GraspFileError as error:
            _log.warning("%s; the unit will be made again", error)
    return done


def failed_units(folder: str | Path) -> dict[str, str]:
    """Units that failed and have no shard.

    Args:
        folder: Folder of the data set.

    Returns:
        The reason of each.

    Raises:
        DatasetError: A record cannot be read.
    """
    reasons = {}
    for path in sorted((Path(folder) / "failures").glob("[!.]*.json")):
        try:
            reasons[path.name.removesuffix(".json")] = str(json.loads(path.read_text(encoding="utf-8"))["reason"])
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise DatasetError(f"{path}: cannot be read: {error}; remove it") from error
    return reasons


def iter_shards(folder: str | Path, columns: Sequence[str] | None = None) -> Iterator[tuple[str, pa.Table]]:
    """The shards of a data set, one at a time, in the order of their names.

    Args:
        folder: Folder of the data set.
        columns: Names of the columns to read; all where it is None.

    Yields:
        Name of the unit and its table.

    Raises:
        DatasetError: The folder is no data set.
        GraspFileError: A shard is damaged, or there is no such column.
    """
    read_manifest(folder)
    for path in shard_paths(folder):
        yield path.name.removesuffix(".parquet"), read_table(path, columns)


def read_dataset(folder: str | Path, columns: Sequence[str] | None = None) -> pa.Table:
    """All rows of a data set, in the order of the names of their units.

    Args:
        folder: Folder of the data set.
        columns: Names of the columns to read; all where it is None.

    Returns:
        One table.

    Raises:
        DatasetError: The folder is no data set.
        GraspFileError: A shard is damaged, or there is no such column.
    """
    schema = SCHEMA if columns is None else pa.schema([SCHEMA.field(name) for name in columns if name in SCHEMA.names])
    tables = [table.replace_schema_metadata(None) for _, table in iter_shards(folder, columns)]
    return pa.concat_tables([schema.remove_metadata().empty_table(), *tables]).replace_schema_metadata(SCHEMA.metadata)


def _shard(folder: str | Path, unit: str) -> Path:
    return _unit_path(folder, "shards", unit, ".parquet")


def _failure(folder: str | Path, unit: str) -> Path:
    return _unit_path(folder, "failures", unit, ".json")


def _unit_path(folder: str | Path, kind: str, unit: str, suffix: str) -> Path:
    if not _UNIT_NAME.fullmatch(unit):
        raise DatasetError(f"{folder}: {unit!r} cannot be the name of a unit; use letters, digits and ._+=-")
    return Path(folder) / kind / f"{unit}{suffix}"


def shard_paths(folder: str | Path) -> list[Path]:
    """Paths of the shards, in the order of their names; partial files are hidden."""
    return sorted((Path(folder) / "shards").glob("[!.]*.parquet"))


def _manifest_text(manifest: Manifest) -> str:
    """The manifest as JSON."""
    try:
        values = {entry.name: getattr(manifest, entry.name) for entry in fields(Manifest)}
        return json.dumps(values, indent=2, sort_keys=True, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise DatasetError(f"a manifest can hold only what JSON can: {error}") from error


def _check_same_manifest(old: Manifest, new: Manifest, path: Path) -> None:
    """Raises where two manifests differ, and says in which entries."""
    before, after = json.loads(_manifest_text(old)), json.loads(_manifest_text(new))
    changes = []
    for name, old_value in before.items():
        new_value = after[name]
        if old_value == new_value:
            continue
        if isinstance(old_value, dict) and isinstance(new_value, dict):
            keys = sorted(old_value.keys() | new_value.keys())
            changes.extend(f"{name}.{key}" for key in keys if old_value.get(key) != new_value.get(key))
        else:
            changes.append(name)
    if changes:
        raise DatasetError(
            f"{path}: the folder holds a data set of another {', '.join(changes)}; go on with the same, or choose a "
            "new folder"
        )
