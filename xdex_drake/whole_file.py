"""Files that appear whole or not at all, whatever ends the program that writes them."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A hidden path beside a file, to write to; it takes the file's place when the block ends without an error.

    Args:
        path: The file.

    Yields:
        Where to write.

    Raises:
        OSError: The file cannot take its place.
    """
    unfinished = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        yield unfinished
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
