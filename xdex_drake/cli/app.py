"""All commands, and what happens around each: parsing, errors, exit status."""

import contextlib
import dataclasses
import difflib
import gc
import importlib
import io
import logging
import os
import sys
from collections.abc import Sequence
from typing import NamedTuple, Protocol, cast, get_type_hints

from xdex_drake.errors import XdexError


class Command(Protocol):
    """A command with its parsed arguments."""

    def run(self) -> int:
        """Does the work and returns the exit status."""
        ...


class Entry(NamedTuple):
    """A command before its module is imported.

    Attributes:
        module: Module of `xdex_drake.cli`.
        name: Name of its frozen dataclass.
        summary: One line for the overview.
    """

    module: str
    name: str
    summary: str


COMMANDS: dict[str, Entry] = {
    "demo": Entry("demo", "Demo", "the whole path in minutes: grasps, other hands, lifts, a model, one report page"),
    "hand list": Entry("hands", "HandList", "the hands of the library"),
    "hand show": Entry("hands", "HandShow", "one hand: joints, fingers, where its facts come from"),
    "hand view": Entry("hands", "HandView", "one hand in Meshcat"),
    "hand import": Entry("hands", "HandImport", "a hand from a URDF, MJCF or SDFormat file, with no annotation"),
    "hand export": Entry("hands", "HandExport", "a hand as a URDF, SDFormat or MJCF file with meshes, for other tools"),
    "hand mirror": Entry("hands", "HandMirror", "the left hand of a right one"),
    "hand generate": Entry("hand_sets", "HandGenerate", "a thousand hands: human ones and variations of robot hands"),
    "hand stats": Entry("hand_sets", "HandStats", "count a folder of hands, and picture it"),
    "hand check": Entry("hand_sets", "HandCheck", "check hands, and let each rest for a second in Drake"),
    "hand browse": Entry("hand_sets", "HandBrowse", "hands in Meshcat with a slider for every joint"),
    "object list": Entry("objects", "ObjectList", "the shapes of the library"),
    "object show": Entry("objects", "ObjectShow", "one object: mass, convex parts, how good they are"),
    "object generate": Entry("objects", "ObjectGenerate", "generated shapes as mesh files, with a picture of them"),
    "object import": Entry("objects", "ObjectImport", "check, clean and scale mesh files"),
    "object export": Entry("objects", "ObjectExport", "an object as a URDF, SDFormat or MJCF file with its meshes"),
    "solve": Entry("solve", "Solve", "solve a problem file and read its costs and constraints"),
    "grasp": Entry("grasps", "GraspCommand", "grasps that are optimised, certified and lifted"),
    "retarget": Entry("grasps", "Retarget", "the same grasps by other hands"),
    "follow": Entry("follow", "Follow", "a hand follows a person's: key points of a camera to joint values"),
    "lift": Entry("grasps", "LiftCommand", "lift stored grasps again"),
    "judge": Entry(
        "judge", "Judge", "grasps of other tools, or stored ones: certified, measured, simulated by protocols"
    ),
    "dataset generate": Entry("datasets", "DatasetGenerate", "make a paired data set, or go on with one"),
    "dataset info": Entry("datasets", "DatasetInfoCommand", "count what a data set holds"),
    "dataset verify": Entry("datasets", "DatasetVerify", "check every row and every certificate of a data set"),
    "dataset card": Entry("datasets", "DatasetCard", "the card of a data set: counts, rates, reasons, distributions"),
    "dataset view": Entry("datasets", "DatasetView", "the grasps of a data set that are most likely to hold"),
    "dataset metrics": Entry("datasets", "DatasetMetrics", "consistency across hands, and distinct grasps"),
    "dataset compact": Entry("datasets", "DatasetCompact", "keep a data set in some 60 bytes a grasp"),
    "dataset expand": Entry("datasets", "DatasetExpand", "a data set from its compact table"),
    "dataset pack": Entry("datasets", "DatasetPack", "all that training needs, in one file"),
    "train": Entry("datasets", "Train", "train the cross-embodiment model"),
    "predict": Entry("predict", "Predict", "grasps from the model, made feasible and certified"),
    "evaluate": Entry("evaluate", "Evaluate", "judge a model: raw, refined, best of many, hand by hand; or the ladder"),
    "view": Entry("show", "View", "stored grasps in Meshcat, live or as one page"),
    "studio": Entry("studio", "StudioCommand", "a live page to play with: grasp, next, carry, lift, sliders"),
    "export": Entry("export", "Export", "stored grasps in other tools' formats"),
    "bench": Entry("bench", "Bench", "how long search, polish, certificate and lift take here"),
}

FOOTER = """\
HAND is a name from `xdex hand list`, a generated hand such as g0-0137, or the path of a .yaml, .urdf, .xml (MJCF) or
.sdf file; OBJECT is a name from `xdex object list` or the path of a mesh. `xdex COMMAND --help` tells more. Exit
status: 0 done; 1 nothing was found; 2 bad input, told in one line."""


def overview() -> str:
    """The help of `xdex` itself."""
    width = max(map(len, COMMANDS)) + 2
    lines = ["usage: xdex COMMAND ...", "", "Dexterous grasps by optimisation, for any hand and any mesh.", ""]
    lines += [f"  {name:<{width}}{entry.summary}" for name, entry in COMMANDS.items()]
    return "\n".join([*lines, "", FOOTER])


def run(argv: Sequence[str] | None = None) -> int:
    """Runs one command line; see `xdex_drake.cli.main`."""
    words = list(sys.argv[1:] if argv is None else argv)
    # Imports make some hundred thousand objects that stay: looking for garbage among them took a sixth of every start.
    gc.set_threshold(10_000)
    logging.basicConfig(level=logging.WARNING, format="xdex: %(message)s", stream=sys.stderr)
    logging.getLogger("drake").setLevel(logging.WARNING)
    try:
        return _run(words)
    except XdexError as error:
        return _refuse(str(error))
    except KeyboardInterrupt:
        print("\nxdex: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # Whoever read our output has gone, as `head` does; nothing may be written at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _run(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help", "help"):
        print(overview())
        return 0 if words else 2
    if words[0] == "--version":
        import xdex_drake

        print(f"xdex_drake {xdex_drake.__version__}")
        return 0
    for length in (2, 1):
        name = " ".join(words[:length])
        if name in COMMANDS:
            command = _parse(name, words[length:])
            if isinstance(command, int):
                return command
            try:
                return command.run()
            finally:
                # What is only reachable in circles holds on to native libraries, and must go before they do.
                gc.collect()
    return _unknown(words)


def _unknown(words: list[str]) -> int:
    """Answers a command that does not exist, or the name of a group alone."""
    members = {name: entry for name, entry in COMMANDS.items() if name.startswith(f"{words[0]} ")}
    if members and (len(words) == 1 or words[1] in ("-h", "--help")):
        width = max(map(len, members)) + 2
        print("\n".join(f"  xdex {name:<{width}}{entry.summary}" for name, entry in members.items()))
        return 0 if len(words) > 1 else 2
    typed = " ".join(words[:2]) if members else words[0]
    close = difflib.get_close_matches(typed, list(members or COMMANDS), n=1, cutoff=0.5)
    mend = f"did you mean `xdex {close[0]}`?" if close else f"there are {', '.join(members or COMMANDS)}"
    return _refuse(f"there is no command {typed!r}; {mend}")


def _parse(name: str, words: list[str]) -> Command | int:
    """The command with its arguments, or the exit status where there is nothing to run."""
    import tyro

    entry = COMMANDS[name]
    module = importlib.import_module(f"xdex_drake.cli.{entry.module}")
    command = getattr(module, entry.name)
    if (wrong := _unknown_option(command, words)) is not None:
        return _refuse(f"{wrong}; see `xdex {name} --help`")
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return cast(Command, tyro.cli(command, prog=f"xdex {name}", args=words))
    except SystemExit as stop:
        if not stop.code:
            return 0
        return _refuse(f"{_one_line(said.getvalue())}; see `xdex {name} --help`")


def _unknown_option(command: type, words: list[str]) -> str | None:
    """What to say of the first option that a command does not have; None where it has all of them."""
    options = ["--help", *(f"--{name}" for name in _option_names(command))]
    for word in words:
        if word == "--":
            return None
        typed = word.partition("=")[0]
        option = typed.replace("_", "-")
        # Negative numbers begin with one dash, and flags may be turned off.
        if not option.startswith("--") or {option, option.replace("--no-", "--", 1)} & {*options}:
            continue
        close = difflib.get_close_matches(option, options, n=1, cutoff=0.6)
        mend = f"did you mean {close[0]}?" if close else f"known are {', '.join(options)}"
        return f"there is no option {typed}; {mend}"
    return None


def _option_names(command: type) -> list[str]:
    """Names of a command's options: of its fields, or as an annotation has them where Python reserves the word."""
    hints = get_type_hints(command, include_extras=True)
    names = []
    for field in dataclasses.fields(command):
        given = [getattr(note, "name", None) for note in getattr(hints[field.name], "__metadata__", ())]
        names.append(next((name for name in given if name), field.name).replace("_", "-"))
    return names


def _one_line(box: str) -> str:
    """What the parser says in a box of several lines: its first section, in one line.

    The title stands in the box's frame, or, on a terminal without such characters, above a rule of its own.
    """
    sections: list[list[str]] = [[]]
    for line in box.splitlines():
        text = line.strip().strip("│").strip()
        if not text or text[0] in "╭╰":
            continue
        if text.strip("─-"):
            sections[-1].append(text)
        else:
            sections.append([])
    said = sections[0] if "╭" in box or len(sections) == 1 else sections[1]
    return " ".join(said) or "the options cannot be understood"


def _refuse(message: str) -> int:
    print("xdex: " + " ".join(message.split()), file=sys.stderr)
    return 2
