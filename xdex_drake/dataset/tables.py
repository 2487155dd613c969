"""Compact tables: a folder of files to which units are appended, and which are never rewritten.

`manifest.json` is that of the data set. `0000.rows`, `0001.rows`, ... hold records, each a mark, the length and SHA-256
of a unit's bytes, and these. A record that was cut off or damaged is passed over and named; a reader finds the next
mark.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from xdex_drake.dataset.compact import CompactUnit, from_bytes, to_bytes
from xdex_drake.errors import DatasetError

_log = logging.getLogger(__name__)

MARK = b"\x89xdexrow"
LARGEST = 9_500_000
"""Size at which a file is full [bytes], so that it fits where files above 10 MB are refused."""

_HEAD = struct.Struct("<I32s")
_FILE = re.compile(r"\d{4}\.rows")


@dataclass(frozen=True)
class Damage:
    """A part of a table that is no sound record.

    Attributes:
        path: The file.
        offset: Where the part begins [bytes].
        reason: What is wrong.
    """

    path: Path
    offset: int
    reason: str

    def __str__(self) -> str:
        """One line."""
        return f"{self.path}, byte {self.offset}: {self.reason}"


def table_files(folder: str | Path) -> list[Path]:
    """The files of a table, in order."""
    target = Path(folder)
    return sorted(path for path in target.iterdir() if _FILE.fullmatch(path.name)) if target.is_dir() else []


def read_records(folder: str | Path) -> Iterator[CompactUnit | Damage]:
    """The units of a table in the order in which they were appended, and what is damaged.

    Args:
        folder: The table's folder.

    Yields:
        Each sound unit, and each damage where it stands; a unit that was appended twice comes once.

    Raises:
        DatasetError: A file cannot be read.
    """
    seen: set[str] = set()
    for path in table_files(folder):
        try:
            data = path.read_bytes()
        except OSError as error:
            raise DatasetError(f"{path}: cannot be read: {error.strerror}") from error
        for offset, record in _records(data):
            if isinstance(record, str):
                yield Damage(path, offset, record)
                continue
            try:
                unit = from_bytes(record, f"{path}, byte {offset}")
            except DatasetError as error:
                yield Damage(path, offset, str(error))
                continue
            if unit.header.unit not in seen:
                seen.add(unit.header.unit)
                yield unit


def read_units(folder: str | Path) -> Iterator[CompactUnit]:
    """The sound units of a table; what is damaged is told in the log."""
    for record in read_records(folder):
        if isinstance(record, Damage):
            _log.warning("%s; the unit will be made again", record)
        else:
            yield record


def append_unit(folder: str | Path, unit: CompactUnit) -> None:
    """Appends a unit to a table; it is on the disk when this returns.

    Args:
        folder: The table's folder, which exists; one process writes to it at a time.
        unit: The unit.

    Raises:
        DatasetError: It cannot be written; what was there before still is, and what was written of the unit is cut off
            by the next call.
    """
    data = to_bytes(unit)
    record = MARK + _HEAD.pack(len(data), hashlib.sha256(data).digest()) + data
    files = table_files(folder)
    path = files[-1] if files else Path(folder) / "0000.rows"
    try:
        if path.exists() and path.stat().st_size + len(record) > LARGEST:
            path = path.with_name(f"{int(path.stem) + 1:04d}.rows")
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        with os.fdopen(descriptor, "r+b") as file:
            end = _sound_end(file.read())
            file.seek(end)
            file.write(record)
            file.truncate()
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise DatasetError(f"{path}: cannot be written: {error.strerror}; its units up to now are whole") from error


def _sound_end(data: bytes) -> int:
    """Where the next record goes: after the last byte, or over a last record that was cut off."""
    last = len(data)
    for offset, record in _records(data):
        last = offset if isinstance(record, str) else len(data)
    return last


def _records(data: bytes) -> Iterator[tuple[int, bytes | str]]:
    """Offset and bytes of each record, or what is wrong with it."""
    position = 0
    while position < len(data):
        begin = position
        head = begin + len(MARK)
        if data[begin:head] == MARK and len(data) >= head + _HEAD.size:
            length, digest = _HEAD.unpack_from(data, head)
            content = data[head + _HEAD.size : head + _HEAD.size + length]
            if len(content) == length and hashlib.sha256(content).digest() == digest:
                yield begin, content
                position = head + _HEAD.size + length
                continue
        following = data.find(MARK, begin + 1)
        position = len(data) if following < 0 else following
        yield begin, "a record is cut off" if following < 0 else "a record is damaged"
