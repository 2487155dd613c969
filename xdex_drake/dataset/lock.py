"""One run at a time on a data set's folder; the lock goes with the process that holds it, however that ends."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from xdex_drake.errors import DatasetError

WHOLE = ".lock"
"""Held alone by a run on all units, and shared by runs on parts of them."""


@contextmanager
def locked(folder: str | Path, shard: tuple[int, int] | None = None) -> Iterator[None]:
    """Keeps other runs off a folder, or off one part of its units.

    The locks are the system's record locks: they end with this process, and processes that it forks do not share them.

    Args:
        folder: Folder of the data set; it must exist.
        shard: Number of this part, from 1, and how many there are; None for all units.

    Raises:
        DatasetError: Another run has the folder or the part, or the lock cannot be written.
    """
    with ExitStack() as held:
        if shard is None:
            held.enter_context(_lock(Path(folder) / WHOLE, fcntl.LOCK_EX))
        else:
            held.enter_context(_lock(Path(folder) / WHOLE, fcntl.LOCK_SH))
            held.enter_context(_lock(Path(folder) / f"{WHOLE}-{shard[0]}-of-{shard[1]}", fcntl.LOCK_EX))
        yield


def is_lock(name: str) -> bool:
    """Whether a file of this name is a lock."""
    return name == WHOLE or name.startswith(f"{WHOLE}-")


@contextmanager
def _lock(path: Path, kind: int) -> Iterator[None]:
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be written: {error.strerror}; choose a folder that can be") from error
    try:
        try:
            fcntl.lockf(descriptor, kind | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            raise DatasetError(
                f"{path.parent}: another run is at work on it; wait for that one, or give each a --shard of its own"
            ) from None
        except OSError as error:
            raise DatasetError(
                f"{path}: cannot be locked: {error.strerror}; choose a folder on another disk"
            ) from error
        yield
    finally:
        os.close(descriptor)
