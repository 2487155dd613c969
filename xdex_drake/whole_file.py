"""Files that appear whole or not at all, whatever ends the program that writes them."""

import logging
import os
import re
import secrets
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_log = logging.getLogger(__name__)

PARTIAL = re.compile(r"\.(?P<name>.+)\.(?P<host>[^.]+)\.(?P<pid>\d+)\.[0-9a-f]+\.partial")
"""Names of files that are being written."""


@contextmanager
def whole_file(target: Path) -> Iterator[Path]:
    """A hidden path beside a file, to write to, which takes its place only when all of it is on the disk.

    A process that is killed leaves a hidden `.partial` file behind; the next writer of `target` on that machine removes
    it once its process is gone.

    Args:
        target: The file; its folder must be there.

    Yields:
        Where to write; no such file is there yet.

    Raises:
        OSError: The file cannot take its place; what was there before still is.
    """
    host = re.sub(r"[^A-Za-z0-9-]", "-", socket.gethostname()) or "host"
    _remove_leftovers(target, host)
    partial = target.with_name(f".{target.name}.{host}.{os.getpid()}.{secrets.token_hex(4)}.partial")
    try:
        yield partial
        _sync(partial)
        partial.replace(target)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    try:
        _sync(target.parent)  # the names in it
    except OSError:
        _log.debug("%s: this file system cannot sync a folder", target.parent)


def _sync(path: Path) -> None:
    """Has the disk hold what a file, or a folder, holds."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove_leftovers(target: Path, host: str) -> None:
    """Removes what killed writers of `target` on this machine have left."""
    for path in target.parent.glob(f".{target.name}.{host}.*.partial"):
        match = PARTIAL.fullmatch(path.name)
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
