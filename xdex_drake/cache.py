"""Where results are kept between runs."""

import logging
import os
import tempfile
from pathlib import Path

_log = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Folder of the results that are kept between runs: XDEX_CACHE, or `xdex_drake` in the user's cache folder."""
    if folder := os.environ.get("XDEX_CACHE"):
        return Path(folder)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "xdex_drake"


def write_text_whole(file: Path, text: str) -> None:
    """Writes a cached text file, so that other processes see the whole file or none.

    A folder that cannot be written to costs time in the next run, no more.

    Args:
        file: File in the cache folder.
        text: What to write.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=file.parent, prefix=".", suffix=file.suffix)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                stream.write(text)
            os.replace(temporary, file)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        _log.warning("cannot write the cache file %s: %s", file, error)
