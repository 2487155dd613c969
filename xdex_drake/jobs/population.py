"""Lists of hands and objects in few words: names, files, and ranges of generated ones."""

from __future__ import annotations

import re
from collections.abc import Iterable

from xdex_drake.errors import ConfigError

RANGE = re.compile(r"(?P<set>[gs]\d{1,9})-(?P<first>\d{4,9})\.\.(?P=set)-(?P<last>\d{4,9})(?:/(?P<step>\d{1,6}))?")
"""A range of generated hands or shapes: `g0-0000..g0-0999`, or every fifth of them: `g0-0000..g0-0995/5`."""


def expand_names(entries: Iterable[str], field: str) -> tuple[str, ...]:
    """Names in order, each once: `g0-0000..g0-0999` stands for a thousand, `-g0-0137` takes one away.

    Args:
        entries: Names, paths and ranges; those after a minus sign are taken away, wherever they stand.
        field: Where they stand, for the message.

    Returns:
        The names and paths.

    Raises:
        ConfigError: A range runs backwards or mixes sets, a step is 0, or what is taken away was not there.
    """
    names: dict[str, None] = {}
    away: list[str] = []
    for entry in entries:
        if entry.startswith("-"):
            away += _expand(entry[1:], field)
        else:
            names.update(dict.fromkeys(_expand(entry, field)))
    unknown = [name for name in away if name not in names]
    if unknown:
        raise ConfigError(
            f"{field}: {unknown[0]} is taken away, but is not among the names; mend or remove -{unknown[0]}"
        )
    taken = set(away)
    return tuple(name for name in names if name not in taken)


def _expand(entry: str, field: str) -> list[str]:
    """The names of one entry."""
    if ".." not in entry or "/.." in entry or entry.startswith(".."):
        return [entry]
    match = RANGE.fullmatch(entry)
    if match is None:
        raise ConfigError(f"{field}: {entry!r} is no range; write it like g0-0000..g0-0999, or g0-0000..g0-0995/5")
    first, last, step = int(match["first"]), int(match["last"]), int(match["step"] or 1)
    if last < first or step < 1:
        raise ConfigError(f"{field}: the range {entry} is empty; give the smaller number first, and a step above 0")
    return [f"{match['set']}-{index:04d}" for index in range(first, last + 1, step)]
