"""Files of grasps: Parquet, one row a grasp; a file appears whole or not at all. The same rows give the same bytes."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from xdex_drake.dataset.schema import SCHEMA, SCHEMA_VERSION, Row
from xdex_drake.dataset.version_1 import SCHEMA_1, upgraded
from xdex_drake.errors import GraspFileError, XdexError
from xdex_drake.whole_file import whole_file

_ROWS_PER_GROUP = 4096

READABLE = {str(SCHEMA_VERSION): SCHEMA, "1": SCHEMA_1}
"""Columns of each schema version that can be read."""


REMEDY = "make it again, or take it from its source"


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
        with whole_file(target) as unfinished, unfinished.open("xb") as sink:
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
        old = _check_schema(file.schema_arrow, target) == "1"
        table = file.read(columns=None if columns is None or old else list(columns), use_threads=False)
        table.validate(full=True)
        if not old:
            return table
        metadata = {**(table.schema.metadata or {}), **(SCHEMA.metadata or {})}
        table = upgraded(table).replace_schema_metadata(metadata)
        return table if columns is None else table.select(list(columns))


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
def _readable(path: Path) -> Iterator[None]:
    """Turns what goes wrong while a file of grasps is read into one error that names the file."""
    try:
        yield
    except XdexError:
        raise
    except FileNotFoundError as error:
        raise GraspFileError(f"{path}: there is no such file") from error
    except (OSError, pa.ArrowException, ValueError, KeyError, MemoryError) as error:
        raise GraspFileError(f"{path}: damaged, or no Parquet file: {error}; {REMEDY}") from error


def _check_schema(schema: pa.Schema, path: Path) -> str:
    """The schema version of a file; raises where it has other columns than this version of the library reads."""
    version = (schema.metadata or {}).get(b"xdex_schema_version")
    if version is None:
        raise GraspFileError(
            f"{path}: Parquet, but no file of grasps: xdex_schema_version is missing from its metadata"
        )
    known = version.decode(errors="replace")
    if known not in READABLE:
        raise GraspFileError(
            f"{path}: xdex_schema_version is {known}, but this version of the library reads "
            f"{' and '.join(sorted(READABLE))}; read it with the version that wrote it"
        )
    found = {field.name: field.type for field in schema}
    wanted = {field.name: field.type for field in READABLE[known]}
    if found != wanted:
        wrong = sorted(name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name))
        raise GraspFileError(f"{path}: these columns are missing, unknown or of another type: {', '.join(wrong)}")
    return known
