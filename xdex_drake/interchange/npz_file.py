"""Archives of plain arrays, from outside and for others."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from xdex_drake.errors import ConfigError, GraspFileError
from xdex_drake.interchange.records import MAX_BYTES, check_size, text_of
from xdex_drake.whole_file import whole_file, write_text


def read_npz(path: Path) -> dict[str, Any]:
    """The arrays of an archive, none of them pickled, and those that a JSON file beside it names.

    Args:
        path: The `.npz` file; NAME.json beside it adds what arrays cannot hold, such as names.

    Returns:
        Arrays, and the JSON file's values, by name.

    Raises:
        GraspFileError: It is no such archive, unfolds to more than `MAX_BYTES`, or holds pickled objects.
    """
    check_size(path)
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
            if size > MAX_BYTES:
                raise GraspFileError(f"{path}: unfolds to {size / 1e6:.0f} MB, more than {MAX_BYTES / 1e6:.0f}")
        with np.load(path, allow_pickle=False) as arrays:
            content: dict[str, Any] = {name: arrays[name] for name in arrays.files}
    except GraspFileError:
        raise
    except Exception as error:
        said = " ".join(str(error).split())[:100] or type(error).__name__
        raise GraspFileError(f"{path}: is no .npz archive of plain arrays ({said})") from None
    beside = path.with_suffix(".json")
    return content | (read_json(beside) if beside.exists() else {})


def read_json(path: Path) -> dict[str, Any]:
    """A JSON file whose outermost value is an object; a GraspFileError where it is not."""
    try:
        content = json.loads(text_of(path))
    except (ValueError, RecursionError) as error:
        raise GraspFileError(f"{path}: is no valid JSON ({' '.join(str(error).split())[:100]})") from None
    if not isinstance(content, dict):
        raise GraspFileError(f"{path}: is no JSON object, {{name: value, ...}}")
    return content


def write_npz(path: Path, arrays: Mapping[str, Any], beside: Mapping[str, Any]) -> None:
    """Writes arrays, and plain values as NAME.json beside; each file appears whole or not at all.

    Args:
        path: The `.npz` file.
        arrays: Arrays by name.
        beside: What JSON can hold, by name.

    Raises:
        ConfigError: A file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as unfinished, unfinished.open("wb") as file:
            np.savez_compressed(file, **arrays)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}; choose another path") from None
    write_text(path.with_suffix(".json"), json.dumps(beside, indent=1, allow_nan=False) + "\n")
