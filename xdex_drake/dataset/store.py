"""Files of grasps and data set folders: a file appears whole or not at all.

A data set is a folder with `manifest.json`, which says what the data set is to hold, and `shards/UNIT.parquet`, a file
of grasps for each unit of work. `failures/UNIT.json` says why a unit has no shard. The same rows give the same bytes.
"""

import json
import logging
import os
import re
import secrets
import socket
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq

from xdex_drake.dataset.schema import SCHEMA, SCHEMA_VERSION, Row, grasp_from_row
from xdex_drake.errors import DatasetError, GraspFileError, XdexError
from xdex_drake.grasp import Grasp

_log = logging.getLogger(__name__)

_ROWS_PER_GROUP = 4096
_UNIT_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._+=-]{0,199}")
_PARTIAL = re.compile(r"\.(?P<name>.+)\.(?P<host>[^.]+)\.(?P<pid>\d+)\.[0-9a-f]+\.partial")
_REMEDY = "make it again, or take it from its source"


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
class Problem:
    """Something wrong with a data set.

    Attributes:
        unit: The unit whose shard it is in.
        grasp_id: The grasp, empty where the whole shard is meant.
        reason: What is wrong.
    """

    unit: str
    grasp_id: str
    reason: str


@dataclass(frozen=True)
class VerifyReport:
    """What a check of a whole data set showed.

    Attributes:
        shards: Number of shards that were found.
        rows: Number of rows that could be read.
        successes: Number of rows whose lift succeeded.
        certificates_checked: Number of certificates that were checked again.
        missing_units: Planned units that have no shard yet.
        problems: Everything that is wrong.
    """

    shards: int
    rows: int
    successes: int
    certificates_checked: int
    missing_units: tuple[str, ...]
    problems: tuple[Problem, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong; units that are still to be made are not wrong."""
        return not self.problems


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


# Files of grasps ------------------------------------------------------------------------------------------------------


def write_grasps(path: str | Path, rows: Iterable[Row], *, metadata: Mapping[str, str] | None = None) -> None:
    """Writes a file of grasps, which appears whole or not at all.

    Args:
        path: The file; its folder is made where there is none, and an older file is replaced.
        rows: Rows, as `row_from_grasp` gives them.
        metadata: More to say about the file, such as the configuration and the seed; under `xdex_` names of its own.

    Raises:
        GraspFileError: A row has unknown, missing or wrong columns, or the file cannot be written; what was at `path`
            before is still there.
    """
    target = Path(path)
    table = _table(rows, target)
    if metadata:
        table = table.replace_schema_metadata({**(table.schema.metadata or {}), **metadata})
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with _whole_file(target) as sink:
            pq.write_table(
                table,
                sink,
                row_group_size=_ROWS_PER_GROUP,
                compression="zstd",
                compression_level=3,
                version="2.6",
                write_page_checksum=True,
            )
    except (OSError, pa.ArrowException) as error:
        raise GraspFileError(f"{target}: cannot be written: {error}; nothing was changed") from error


def read_grasps(path: str | Path) -> list[Row]:
    """Rows of a file of grasps.

    Args:
        path: A file that `write_grasps` made.

    Returns:
        One dictionary a grasp, with every column of the schema; `schema.grasp_from_row` makes it a `Grasp`.

    Raises:
        GraspFileError: The file is missing, damaged, or no file of grasps of this version.
    """
    return read_table(path).to_pylist()


def read_table(path: str | Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Arrow table of a file of grasps.

    Args:
        path: A file that `write_grasps` made.
        columns: Names of the columns to read; all where it is None.

    Returns:
        The table.

    Raises:
        GraspFileError: The file is missing, damaged, or no file of grasps of this version; or there is no such column.
    """
    target = Path(path)
    unknown = set(columns or ()) - set(SCHEMA.names)
    if unknown:
        raise GraspFileError(
            f"{target}: there is no column {', '.join(sorted(unknown))}; use {', '.join(SCHEMA.names)}"
        )
    # Without threads: they gain nothing on files of this size, and a process that has none can be forked.
    with _readable(target), pq.ParquetFile(target, page_checksum_verification=True, pre_buffer=False) as file:
        _check_schema(file.schema_arrow, target)
        table = file.read(columns=None if columns is None else list(columns), use_threads=False)
        table.validate(full=True)
        return table


def read_metadata(path: str | Path) -> dict[str, str]:
    """What `write_grasps` was given to say about the file, and the schema's own entries.

    Args:
        path: A file that `write_grasps` made.

    Returns:
        The text under each name.

    Raises:
        GraspFileError: The file is missing, damaged, or no file of grasps of this version.
    """
    target = Path(path)
    with _readable(target):
        schema = pq.read_schema(target)
        _check_schema(schema, target)
        return {key.decode(): value.decode() for key, value in (schema.metadata or {}).items()}


# Data set folders -----------------------------------------------------------------------------------------------------


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
        not target.is_dir() or any(not _PARTIAL.fullmatch(entry.name) for entry in target.iterdir())
    ):
        raise DatasetError(f"{target}: holds something else than a data set; choose a new or empty folder")
    try:
        target.mkdir(parents=True, exist_ok=True)
        with _whole_file(path) as sink:
            sink.write(text.encode())
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
        raise DatasetError(f"{path}: cannot be read: {error}; {_REMEDY}") from error
    if manifest.schema_version != SCHEMA_VERSION:
        raise DatasetError(
            f"{path}: schema_version is {manifest.schema_version}, but this version of the library reads "
            f"{SCHEMA_VERSION}"
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
        with _whole_file(path) as sink:
            sink.write(json.dumps({"unit": unit, "reason": reason}, indent=2).encode())
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
    for path in _shard_paths(folder):
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
    for path in _shard_paths(folder):
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


def verify(folder: str | Path, *, recheck: Callable[[Grasp], str] | None = None) -> VerifyReport:
    """Checks a whole data set: its shards, its rows, their certificates and where they come from.

    Every shard can be read to its last byte and has the schema; no grasp has the identifier of another; every row is a
    grasp; a grasp whose lift succeeded has a certificate that `recheck` accepts; every source grasp is there; hands and
    objects are those of the manifest.

    Args:
        folder: Folder of the data set.
        recheck: Checks a certificate again; returns an empty string, or what is wrong. None leaves that out.

    Returns:
        What was found; nothing wrong with the data is raised as an error.

    Raises:
        DatasetError: The folder is no data set.
    """
    manifest = read_manifest(folder)
    problems: list[Problem] = []
    unit_of: dict[str, str] = {}
    source_of: list[tuple[str, str, str]] = []
    shards = rows = successes = checked = 0
    seen_units = set()
    for path in _shard_paths(folder):
        unit = path.name.removesuffix(".parquet")
        seen_units.add(unit)
        shards += 1
        if unit not in manifest.units:
            problems.append(Problem(unit, "", "the manifest does not plan this unit"))
        try:
            shard_rows = read_grasps(path)
        except GraspFileError as error:
            problems.append(Problem(unit, "", str(error)))
            continue
        for row in shard_rows:
            rows += 1
            grasp_id = row["grasp_id"]
            if grasp_id in unit_of:
                problems.append(
                    Problem(unit, grasp_id, f"the identifier is that of a grasp of {unit_of[grasp_id]}, too")
                )
            unit_of.setdefault(grasp_id, unit)
            if row["source_grasp_id"]:
                source_of.append((unit, grasp_id, row["source_grasp_id"]))
            successes += row["success"] is True
            reasons, was_checked = _row_problems(row, manifest, recheck)
            checked += was_checked
            problems.extend(Problem(unit, grasp_id, reason) for reason in reasons)
    problems.extend(
        Problem(unit, grasp_id, f"its source grasp {source} is not in the data set")
        for unit, grasp_id, source in source_of
        if source not in unit_of
    )
    missing = tuple(unit for unit in manifest.units if unit not in seen_units)
    return VerifyReport(shards, rows, successes, checked, missing, tuple(problems))


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
        bytes=sum(path.stat().st_size for path in _shard_paths(folder)),
    )


# Helpers --------------------------------------------------------------------------------------------------------------


def _table(rows: Iterable[Row], target: Path) -> pa.Table:
    """Table of some rows, each of which must have exactly the columns of the schema."""
    listed = list(rows)
    expected = set(SCHEMA.names)
    for number, row in enumerate(listed):
        if row.keys() != expected:
            unknown, missing = sorted(row.keys() - expected), sorted(expected - row.keys())
            raise GraspFileError(f"{target}: row {number} has unknown columns {unknown} and lacks {missing}")
    try:
        table = pa.Table.from_pylist(listed, schema=SCHEMA)
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise GraspFileError(f"{target}: a row does not fit the schema: {error}") from error
    nulls = [field.name for field in SCHEMA if not field.nullable and table[field.name].null_count]
    if nulls:
        raise GraspFileError(f"{target}: these columns must have a value in every row: {', '.join(nulls)}")
    return table


@contextmanager
def _whole_file(target: Path) -> Iterator[BinaryIO]:
    """A file to write to, which takes the place of `target` only when all of it is on the disk.

    A process that is killed leaves a hidden `.partial` file behind; the next writer of `target` on that machine removes
    it once its process is gone.
    """
    host = re.sub(r"[^A-Za-z0-9-]", "-", socket.gethostname()) or "host"
    _remove_leftovers(target, host)
    partial = target.with_name(f".{target.name}.{host}.{os.getpid()}.{secrets.token_hex(4)}.partial")
    try:
        with partial.open("xb") as sink:
            yield sink
            sink.flush()
            os.fsync(sink.fileno())
        partial.replace(target)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    """Has the disk remember the names in a folder, where the system can."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(descriptor)
    except OSError:
        _log.debug("%s: this file system cannot sync a folder", folder)
    finally:
        os.close(descriptor)


def _remove_leftovers(target: Path, host: str) -> None:
    """Removes what killed writers of `target` on this machine have left."""
    for path in target.parent.glob(f".{target.name}.{host}.*.partial"):
        match = _PARTIAL.fullmatch(path.name)
        if match is not None and match["name"] == target.name and not _is_alive(int(match["pid"])):
            path.unlink(missing_ok=True)


def _is_alive(pid: int) -> bool:
    """Whether there is a process of this number on this machine."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turns what goes wrong while a file of grasps is read into one error that names the file."""
    try:
        yield
    except XdexError:
        raise
    except FileNotFoundError as error:
        raise GraspFileError(f"{path}: there is no such file") from error
    except (OSError, pa.ArrowException, ValueError, KeyError, MemoryError) as error:
        raise GraspFileError(f"{path}: damaged, or no Parquet file: {error}; {_REMEDY}") from error


def _check_schema(schema: pa.Schema, path: Path) -> None:
    """Raises where a file has other columns than this version of the library reads."""
    version = (schema.metadata or {}).get(b"xdex_schema_version")
    if version is None:
        raise GraspFileError(
            f"{path}: Parquet, but no file of grasps: xdex_schema_version is missing from its metadata"
        )
    if version != str(SCHEMA_VERSION).encode():
        raise GraspFileError(
            f"{path}: xdex_schema_version is {version.decode(errors='replace')}, but this version of the library reads "
            f"{SCHEMA_VERSION}; read it with the version that wrote it"
        )
    found = {field.name: field.type for field in schema}
    wanted = {field.name: field.type for field in SCHEMA}
    if found != wanted:
        wrong = sorted(name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name))
        raise GraspFileError(f"{path}: these columns are missing, unknown or of another type: {', '.join(wrong)}")


def _shard(folder: str | Path, unit: str) -> Path:
    return _unit_path(folder, "shards", unit, ".parquet")


def _failure(folder: str | Path, unit: str) -> Path:
    return _unit_path(folder, "failures", unit, ".json")


def _unit_path(folder: str | Path, kind: str, unit: str, suffix: str) -> Path:
    if not _UNIT_NAME.fullmatch(unit):
        raise DatasetError(f"{folder}: {unit!r} cannot be the name of a unit; use letters, digits and ._+=-")
    return Path(folder) / kind / f"{unit}{suffix}"


def _shard_paths(folder: str | Path) -> list[Path]:
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


def _row_problems(row: Row, manifest: Manifest, recheck: Callable[[Grasp], str] | None) -> tuple[list[str], bool]:
    """What is wrong with a row, and whether its certificate was checked again."""
    reasons = []
    for kind in ("hand", "object"):
        expected = manifest.digests.get(f"{kind}/{row[kind]}")
        if expected is not None and expected != row[f"{kind}_digest"]:
            reasons.append(f"{kind} {row[kind]} has another digest than in the manifest")
    try:
        grasp = grasp_from_row(row)
    except GraspFileError as error:
        return [*reasons, str(error)], False
    if grasp.lift is None or not grasp.lift.success:
        return reasons, False
    if grasp.certificate is None:
        return [*reasons, "its lift succeeded, but it has no certificate"], False
    if recheck is None:
        return reasons, False
    reason = recheck(grasp)
    return [*reasons, f"its certificate does not hold: {reason}"] if reason else reasons, True


def _counts(counter: Counter[tuple[str, bool]]) -> dict[str, Count]:
    """Counts by name, from counts by name and success."""
    names = sorted({name for name, _ in counter})
    return {name: Count(counter[name, True] + counter[name, False], counter[name, True]) for name in names}
