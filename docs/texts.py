"""Commands and public names in texts: which there are, and whether they exist."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import fields
from importlib import import_module

NAME = re.compile(r"^xd\.(\w+)(\(.*\))?$")
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: str, language: str) -> list[str]:
    """Code blocks of a page in Markdown, in order."""
    return [text for found, text in BLOCK.findall(page) if found == language]


def wrong_command(line: str) -> str | None:
    """What is wrong with a line of a shell that begins with `xdex`, or None.

    Args:
        line: The line, as it stands in a text.

    Returns:
        The first command or option that does not exist.
    """
    from xdex_drake.cli.app import COMMANDS

    words = shlex.split(line, comments=True)[1:]
    if not words or words[0].startswith("-") or words[0] == "COMMAND":
        return None
    name = next((" ".join(words[:n]) for n in (2, 1) if " ".join(words[:n]) in COMMANDS), None)
    if name is None:
        groups = {command.split()[0] for command in COMMANDS if " " in command}
        return None if words[0] in groups and len(words) == 1 else f"there is no command {' '.join(words[:2])!r}"
    entry = COMMANDS[name]
    command = getattr(import_module(f"xdex_drake.cli.{entry.module}"), entry.name)
    known = {"--help", *(f"--{field.name.replace('_', '-')}" for field in fields(command))}
    typed = [word.strip("[]").partition("=")[0] for word in words if word.strip("[").startswith("--")]
    return next((f"`xdex {name}` has no option {o}" for o in typed if o.replace("--no-", "--") not in known), None)


def commands_in(text: str) -> Iterator[str]:
    """Lines of a text that call `xdex`, continued ones in one piece."""
    for line in text.replace("\\\n", " ").splitlines():
        if re.match(r"^(\$ )?xdex( |$)", line.strip()):
            yield line.strip().removeprefix("$ ")
