"""Reads `.npy` files that hold a pickled dictionary of arrays, and refuses every pickle that holds anything else.

A pickle is a program. Here it may call nothing but our own stand-ins for the three functions by which NumPy rebuilds
arrays, types and scalars; every other name is refused before anything of it runs.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from xdex_drake.errors import GraspFileError
from xdex_drake.interchange.records import check_size

MAX_ELEMENTS = 100_000_000
"""Greatest size of an array that is rebuilt."""

_SIMPLE = re.compile(r"[biufSU]\d{1,4}|O8?")
"""Types of arrays that may be rebuilt: numbers, texts, and containers of what is rebuilt itself."""


class _Refused(pickle.UnpicklingError):
    """Something that is no array, dictionary, list, number or text."""


class _NdarrayName:
    """Stands for the class `numpy.ndarray`, which a pickle names and hands to `_reconstruct`."""


class _Type:
    """Stands for `numpy.dtype`: only the letter, the size and the byte order of a simple type."""

    def __init__(self, code: object, *flags: object) -> None:
        if not isinstance(code, str) or not _SIMPLE.fullmatch(code.lstrip("<>|=")):
            raise _Refused(f"the type {code!r:.40}")
        self.code, self.order = code.lstrip("<>|="), code[0] if code[0] in "<>|=" else "="

    def __setstate__(self, state: object) -> None:
        plain = isinstance(state, tuple) and len(state) >= 5 and state[2:5] == (None, None, None)
        if not plain or state[1] not in ("<", ">", "|", "="):  # type: ignore[index]
            raise _Refused("a type of several parts")
        self.order = state[1]  # type: ignore[index]

    def dtype(self) -> np.dtype:
        return np.dtype(self.code if self.order == "|" else self.order + self.code)


class _Array:
    """Stands for an array while its content is awaited."""

    def __init__(self, kind: object = _NdarrayName, *empty: object) -> None:
        if kind is not _NdarrayName:
            raise _Refused("a kind of array that is not NumPy's own")
        self.content: tuple[Any, ...] = (0, (0,), _Type("f8"), False, b"")

    def __setstate__(self, state: object) -> None:
        if not (isinstance(state, tuple) and len(state) == 5):
            raise _Refused("an array of an unknown layout")
        self.content = state

    def array(self, plain: Callable[[Any], Any]) -> np.ndarray:
        _, shape, kind, fortran, raw = self.content
        sizes = isinstance(shape, tuple) and all(isinstance(n, int) and 0 <= n <= MAX_ELEMENTS for n in shape)
        if not (sizes and isinstance(kind, _Type) and math.prod(shape) <= MAX_ELEMENTS):
            raise _Refused("an array of an unknown layout")
        order = "F" if fortran else "C"
        if kind.code.startswith("O"):
            if not isinstance(raw, list) or len(raw) != math.prod(shape):
                raise _Refused("an array of objects that is no list")
            filled = np.empty(len(raw), dtype=object)
            filled[:] = [plain(item) for item in raw]
            return filled.reshape(shape, order=order)
        return np.frombuffer(raw, kind.dtype(), math.prod(shape)).reshape(shape, order=order)


def _from_buffer(buffer: Any, kind: Any, shape: Any, order: Any) -> _Array:
    array = _Array()
    array.content = (0, shape, kind, order == "F", buffer)
    return array


def _scalar(kind: Any, content: Any = b"") -> Any:
    if not (isinstance(kind, _Type) and isinstance(content, bytes)) or kind.code.startswith("O"):
        raise _Refused("a scalar that is no number or text")
    return np.frombuffer(content, kind.dtype(), 1)[0].item()


def _bytes(text: Any, encoding: Any) -> bytes:
    """Bytes as pickles for Python 2 spell them."""
    if not isinstance(text, str) or encoding != "latin1":
        raise _Refused("bytes in another spelling")
    return text.encode("latin1")


_KNOWN: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): _NdarrayName,
    ("numpy", "dtype"): _Type,
    ("_codecs", "encode"): _bytes,
}
for _core in ("numpy.core", "numpy._core"):
    _KNOWN |= {
        (f"{_core}.multiarray", "_reconstruct"): _Array,
        (f"{_core}.multiarray", "scalar"): _scalar,
        (f"{_core}.numeric", "_frombuffer"): _from_buffer,
    }


class _PlainUnpickler(pickle.Unpickler):
    """Calls nothing but the stand-ins."""

    def find_class(self, module: str, name: str) -> Any:
        try:
            return _KNOWN[module, name]
        except KeyError:
            raise _Refused(f"{module}.{name}") from None

    def persistent_load(self, pid: Any) -> Any:
        raise _Refused("a reference to something outside")


def _plain(value: Any, seen: dict[int, Any]) -> Any:
    """The same with arrays in place of their stand-ins; what is met again is not unfolded again."""
    if isinstance(value, str | bytes | int | float | bool | None):
        return value
    if id(value) in seen:
        return seen[id(value)]
    seen[id(value)] = None
    if isinstance(value, _Array):
        done: Any = value.array(lambda item: _plain(item, seen))
    elif isinstance(value, dict):
        done = {_plain(key, seen): _plain(item, seen) for key, item in value.items()}
    elif isinstance(value, list | tuple):
        done = [_plain(item, seen) for item in value]
    else:
        raise _Refused(f"a {type(value).__name__.lstrip('_')}")
    seen[id(value)] = done
    return done


def read_plain_npy(path: str | Path) -> Any:
    """Reads a `.npy` file: a plain array, or a pickled one of arrays, dictionaries, lists, numbers and texts.

    Args:
        path: The file.

    Returns:
        The array; what it holds where it is one object alone.

    Raises:
        GraspFileError: It cannot be read, is too large, or its pickle holds anything else; nothing of it was run.
    """
    path = Path(path)
    check_size(path)
    file = io.BytesIO(path.read_bytes())
    try:
        version = np.lib.format.read_magic(file)
        read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
        shape, _, kind = read(file)
        if not kind.hasobject:
            file.seek(0)
            return np.lib.format.read_array(file, allow_pickle=False)
        content = _plain(_PlainUnpickler(file).load(), {})
    except _Refused as error:
        raise GraspFileError(
            f"{path}: its pickle holds {error}, and a pickle can run anything; convert it, where you trust it, to .npz "
            "of plain arrays"
        ) from None
    except Exception as error:
        said = " ".join(str(error).split())[:80] or type(error).__name__
        raise GraspFileError(f"{path}: is no .npy file of arrays and dictionaries ({said})") from None
    if isinstance(content, np.ndarray) and content.shape == () == shape:
        return content.item()
    return content
