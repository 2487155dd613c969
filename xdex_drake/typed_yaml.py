"""Configuration files: YAML read into frozen dataclasses; an unknown key or a wrong type is an error in one line."""

import dataclasses
import difflib
import math
import types
import typing
from pathlib import Path
from typing import Any, TypeVar, Union

import yaml

from xdex_drake.errors import ConfigError, XdexError

T = TypeVar("T")

NOT_IN_FILE: dict[str, bool] = {"in_file": False}
"""Metadata of a dataclass's field that no file sets, such as the path that it was read from."""


def read_typed_yaml(path: str | Path, cls: type[T], *, error: type[XdexError] = ConfigError) -> T:
    """Reads a file into a frozen dataclass; what the file leaves out keeps its default.

    Args:
        path: The YAML file: a mapping whose keys are the dataclass's fields.
        cls: The dataclass; its fields are numbers, strings, booleans, tuples, dictionaries with string keys, None,
            literals, and dataclasses of these.
        error: Class of the error to raise.

    Returns:
        The value.

    Raises:
        XdexError: Of class `error`: the file is missing, is no YAML, has an unknown or missing key, or a value of the
            wrong type; the message names file, field and remedy.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise error(f"{file}: no such file; check the path") from None
    except (OSError, UnicodeDecodeError) as cause:
        raise error(f"{file}: cannot be read: {cause}; give a text file in YAML") from None
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as cause:
        mark = getattr(cause, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark is not None else ""
        what = getattr(cause, "problem", None) or "it cannot be parsed"
        raise error(f"{file}{where}: this is no valid YAML: {what}; mend that line") from None
    return typing.cast(T, _read(values, cls, str(file), "", error))


MAX_DEPTH = 16
"""Deepest nesting of YAML files that come from outside."""

YamlLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The faster of PyYAML's safe loaders."""


def plain_yaml(text: str, source: str, *, error: type[XdexError], mend: str, loader: Any = YamlLoader) -> Any:
    """Plain data from YAML text from outside. Aliases, which can unfold without bound, and deep nesting are refused.

    Args:
        text: The text.
        source: Where it comes from, for the message.
        error: Class of the error to raise.
        mend: What to do where it is nested too deep.
        loader: A safe loader.

    Returns:
        Dictionaries, lists, numbers and texts.

    Raises:
        XdexError: Of class `error`: it is no valid YAML, has an alias, or is nested deeper than `MAX_DEPTH`.
    """
    try:
        depth = 0
        for event in yaml.parse(text, Loader=loader):
            if isinstance(event, yaml.AliasEvent):
                line = event.start_mark.line + 1
                raise error(f"{source}: line {line} uses a YAML alias (*{event.anchor}); write the value out")
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                line = event.start_mark.line + 1
                raise error(f"{source}: line {line} is nested deeper than {MAX_DEPTH}; {mend}")
        return yaml.load(text, Loader=loader)  # a safe loader
    except (yaml.YAMLError, ValueError) as cause:
        said = " ".join(str(cause).split())
        raise error(f"{source}: this is not valid YAML ({said}); mend the syntax") from cause


def from_plain(values: Any, cls: type[T], source: str, *, field: str = "", error: type[XdexError] = ConfigError) -> T:
    """Reads plain dictionaries and lists, as YAML and JSON give them, into a frozen dataclass.

    Args:
        values: A mapping whose keys are the dataclass's fields; what it leaves out keeps its default.
        cls: The dataclass; see `read_typed_yaml`.
        source: Where the values come from, for the message.
        field: Name of the mapping there, for the message.
        error: Class of the error to raise.

    Returns:
        The value.

    Raises:
        XdexError: Of class `error`, as `read_typed_yaml`.
    """
    return typing.cast(T, _read(values, cls, source, field, error))


def to_plain(value: Any) -> Any:
    """Plain dictionaries and lists of a dataclass, for YAML and JSON."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {entry.name: to_plain(getattr(value, entry.name)) for entry in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: to_plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [to_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def _read(value: Any, kind: Any, file: str, field: str, error: type[XdexError]) -> Any:
    """The value as a type, or an error that names file and field."""
    origin = typing.get_origin(kind)
    if kind is Any:
        return value
    if origin in (Union, types.UnionType):
        if value is None and type(None) in typing.get_args(kind):
            return None
        (kind,) = (option for option in typing.get_args(kind) if option is not type(None))
        return _read(value, kind, file, field, error)
    if dataclasses.is_dataclass(kind):
        return _read_fields(value, typing.cast(type, kind), file, field, error)
    if origin is typing.Literal:
        options = typing.get_args(kind)
        if value not in options:
            raise error(f"{file}: {field} is {value!r}; choose one of {', '.join(map(str, options))}")
        return value
    if origin is tuple:
        if not isinstance(value, list):
            raise error(f"{file}: {field} is {value!r}; give a list")
        item = typing.get_args(kind)[0]
        return tuple(_read(entry, item, file, f"{field}[{k}]", error) for k, entry in enumerate(value))
    if origin is dict:
        if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
            raise error(f"{file}: {field} is {value!r}; give a mapping from names to values")
        item = typing.get_args(kind)[1]
        return {key: _read(entry, item, file, f"{field}.{key}", error) for key, entry in value.items()}
    return _read_scalar(value, kind, file, field, error)


def _read_scalar(value: Any, kind: Any, file: str, field: str, error: type[XdexError]) -> Any:
    if kind is bool and isinstance(value, bool):
        return value
    if kind is int and isinstance(value, int) and not isinstance(value, bool):
        return value
    if kind is str and isinstance(value, str):
        return value
    if kind is Path and isinstance(value, str):
        return Path(value)
    if kind is float and isinstance(value, int | float | str) and not isinstance(value, bool):
        try:  # YAML 1.1 takes 1e-3 for a string
            number = float(value)
        except ValueError:
            number = math.nan
        if math.isfinite(number):
            return number
    names = {bool: "true or false", int: "a whole number", str: "a text", float: "a finite number", Path: "a path"}
    raise error(f"{file}: {field} is {value!r}; give {names.get(kind, getattr(kind, '__name__', str(kind)))}")


def _read_fields(value: Any, cls: type, file: str, field: str, error: type[XdexError]) -> Any:
    where = f"{field} " if field else ""
    prefix = f"{field}." if field else ""
    if value is None and not field:
        value = {}
    if not isinstance(value, dict):
        raise error(f"{file}: {where or 'the file '}must be a mapping of keys to values")
    known = {entry.name: entry for entry in dataclasses.fields(cls) if entry.metadata.get("in_file", True)}
    hints = typing.get_type_hints(cls)
    for key in value:
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1, cutoff=0.5)
            mend = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(known)}"
            raise error(f"{file}: {where}has an unknown key {key!r}; {mend}")
    missing = [
        name
        for name, entry in known.items()
        if name not in value and entry.default is dataclasses.MISSING and entry.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise error(f"{file}: {where}lacks {', '.join(missing)}; add {'it' if len(missing) == 1 else 'them'}")
    arguments = {key: _read(item, hints[key], file, f"{prefix}{key}", error) for key, item in value.items()}
    try:
        return cls(**arguments)
    except XdexError as cause:
        raise error(f"{file}: {where}{cause}") from None
