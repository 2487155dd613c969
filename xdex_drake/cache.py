"""Where results are kept between runs."""

import logging
import os
from collections.abc import Callable
from pathlib import Path

from xdex_drake.whole_file import whole_file

_log = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Folder of the results that are kept between runs: XDEX_CACHE, or `xdex_drake` in the user's cache folder."""
    if folder := os.environ.get("XDEX_CACHE"):
        return Path(folder)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "xdex_drake"


def write_cache_file(file: Path, write: Callable[[Path], object]) -> None:
    """Writes a file of the cache, so that other processes see the whole file or none.

    A folder that cannot be written to costs time in the next run, no more.

    Args:
        file: File in the cache folder.
        write: Writes the content to the path that it is given.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(file) as unfinished:
            write(unfinished)
    except OSError as error:
        _log.warning("cannot write the cache file %s: %s", file, error)
