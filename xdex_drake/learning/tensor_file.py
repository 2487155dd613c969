"""Files of arrays: safetensors with a JSON header of ours, checked before an array is read. None of them can run code.

Checkpoints, training packs and the states of training runs are such files.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from xdex_drake.errors import CheckpointError, XdexError
from xdex_drake.whole_file import whole_file

MAX_HEADER = 1 << 24
MAX_FILE = 1 << 30
_KEY = "xdex_drake"


@dataclass(frozen=True)
class FileType:
    """A type of file, for what is said where one cannot be used.

    Attributes:
        name: What it is, as in "no such checkpoint".
        absent: How to get one.
        remedy: What to do about a damaged one.
        error: Class of the errors to raise.
    """

    name: str
    absent: str
    remedy: str
    error: type[XdexError] = CheckpointError


@dataclass(frozen=True)
class Description:
    """What a file says it holds.

    Attributes:
        header: Our header.
        shapes: Shape of each array by its name.
        dtypes: Type of each array as safetensors names it, such as `F32`.
    """

    header: dict[str, Any]
    shapes: dict[str, tuple[int, ...]]
    dtypes: dict[str, str]


def write_tensor_file(file: Path, arrays: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> None:
    """Writes arrays, whole or not at all; the same arrays and header give the same bytes.

    Args:
        file: The file; its folder is made where there is none.
        arrays: The arrays.
        header: What else to say, as JSON.

    Raises:
        OSError: The file cannot be written; what was there before still is.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    whole = {name: np.ascontiguousarray(array) if array.ndim else array for name, array in arrays.items()}
    with whole_file(file) as unfinished:
        unfinished.write_bytes(save_arrays(whole, metadata={_KEY: json.dumps(header, allow_nan=False)}))


def describe(file: Path, what: FileType) -> Description:
    """What a file says it holds, without touching the bytes of its arrays.

    Args:
        file: The file.
        what: Its type.

    Returns:
        The description; the file is as long as it says.

    Raises:
        XdexError: Of the type's class: there is no such file, or it is oversized, cut short or of another origin.
    """
    if not file.is_file():
        raise what.error(f"{file}: no such {what.name}; {what.absent}")
    size = file.stat().st_size
    if size > MAX_FILE:
        raise what.error(f"{file}: {size} bytes are more than a {what.name} may have ({MAX_FILE})")
    try:
        with file.open("rb") as stream:
            length = int.from_bytes(stream.read(8), "little")
            if size < 8 or length > min(MAX_HEADER, size - 8):
                raise what.error(f"{file}: not a safetensors file, or cut short; {what.remedy}")
            table = json.loads(stream.read(length))
        header = json.loads(table.pop("__metadata__")[_KEY])
        shapes = {name: tuple(int(n) for n in entry["shape"]) for name, entry in table.items()}
        dtypes = {name: str(entry["dtype"]) for name, entry in table.items()}
        end = max((entry["data_offsets"][1] for entry in table.values()), default=0)
        if not isinstance(header, dict) or not isinstance(end, int):
            raise TypeError
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as cause:
        raise what.error(f"{file}: its header is not that of a {what.name} of xdex_drake; {what.remedy}") from cause
    if 8 + length + end != size:
        raise what.error(f"{file}: cut short or damaged; {what.remedy}")
    return Description(header, shapes, dtypes)


def read_arrays(file: Path, what: FileType) -> dict[str, np.ndarray]:
    """The arrays of a file that `describe` has let pass.

    Args:
        file: The file.
        what: Its type.

    Returns:
        The arrays by their names; those of real numbers hold finite ones only.

    Raises:
        XdexError: Of the type's class: the file is damaged.
    """
    try:
        arrays = load_arrays(file.read_bytes())
    except (OSError, SafetensorError, ValueError, KeyError, TypeError, MemoryError) as cause:
        raise what.error(f"{file}: damaged ({cause}); {what.remedy}") from cause
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise what.error(f"{file}: '{name}' holds numbers that are not finite; {what.remedy}")
    return arrays


def versions() -> dict[str, str]:
    """Versions of the libraries that a file depends on, for its header."""
    return {name: _version(name) for name in ("xdex_drake", "torch", "numpy", "safetensors")}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
