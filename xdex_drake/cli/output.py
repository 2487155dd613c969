"""What commands share: tables, progress bars, interruption, checks of where results shall go."""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from xdex_drake.errors import ConfigError

if TYPE_CHECKING:
    from xdex_drake.scene.object import ObjectModel

SECONDS_A_LINE = 5.0
"""Least time between two lines of progress where there is no terminal [s]."""

FIRST_WORD_S = 1.5
"""Time after which it is said what takes long [s]."""


def table(rows: Sequence[Sequence[object]], header: Sequence[str] = ()) -> str:
    """Rows as aligned columns; numbers to the right, texts to the left."""
    texts = [[_text(cell) for cell in row] for row in ([header] if header else []) + list(rows)]
    if not texts:
        return ""
    widths = [max(len(row[k]) for row in texts) for k in range(len(texts[0]))]
    right = [bool(rows) and all(isinstance(row[k], int | float) for row in rows) for k in range(len(widths))]
    lines = []
    for row in texts:
        cells = [cell.rjust(w) if r else cell.ljust(w) for cell, w, r in zip(row, widths, right, strict=True)]
        lines.append("  ".join(cells).rstrip())
    if header:
        lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join(lines)


def _text(cell: object) -> str:
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def facts(pairs: Sequence[tuple[str, object]]) -> str:
    """Names and values, one pair a line."""
    width = max(len(name) for name, _ in pairs) + 2
    return "\n".join(f"{name:<{width}}{_text(value)}" for name, value in pairs)


def counts(reasons: Mapping[str, int]) -> str:
    """How often each reason came up, the most frequent first."""
    short: dict[str, int] = {}
    for reason, count in reasons.items():
        # What follows a second colon explains.
        name = ":".join(reason.split(":")[:2])
        short[name] = short.get(name, 0) + count
    ordered = sorted(short.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{name} {count}" for name, count in ordered) or "-"


class Lines(tqdm):
    """Progress where there is no terminal: plain lines, seldom enough for a log, instead of a bar that is redrawn."""

    def __init__(self, *args: Any, **options: Any) -> None:
        """As of `tqdm`; writes the first line."""
        self.told, self.due = None, 0.0
        super().__init__(*args, **options, ncols=0, mininterval=SECONDS_A_LINE)

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:
        """Writes a line where it is time for one, and there is news since the last."""
        if time.monotonic() >= self.due and self.told != (self.n, self.postfix):
            self.told, self.due = (self.n, self.postfix), time.monotonic() + SECONDS_A_LINE
            self.fp.write(f"{self}\n")
        return True

    def clear(self, nolock: bool = False) -> None:
        """Nothing: what was written stays."""

    def close(self) -> None:
        """Writes the last line."""
        if not self.disable:
            self.due = 0.0
            self.display()
            self.disable = True


def progress(total: int | None, what: str) -> tqdm:
    """A progress bar on standard error; plain lines where that is no terminal."""
    # Without a thread of its own: a signal that it received would interrupt the start of a worker half-way.
    tqdm.monitor_interval = 0
    if not sys.stderr.isatty():
        return Lines(total=total, desc=what, smoothing=0.1)
    return tqdm(total=total, desc=what, dynamic_ncols=True, smoothing=0.1, mininterval=0.2)


@contextmanager
def waiting(what: str) -> Iterator[Callable[[float], None]]:
    """Says on standard error what takes long, and for how long already.

    Args:
        what: What is done, in words.

    Yields:
        A function to be called again and again meanwhile, with the seconds so far: on a terminal it writes one line
        anew, elsewhere a line after a second and a half and then one in `SECONDS_A_LINE`.
    """
    terminal, due = sys.stderr.isatty(), FIRST_WORD_S
    said = False

    def tell(seconds: float) -> None:
        nonlocal due, said
        if seconds < due:
            return
        due, said = (0.0 if terminal else seconds + SECONDS_A_LINE), True
        line = f"xdex: {what}, {seconds:.0f} s"
        print(f"\r{line}" if terminal else line, end="" if terminal else "\n", file=sys.stderr, flush=True)

    try:
        yield tell
    finally:
        if said and terminal:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


@dataclass
class Interruption:
    """Whether Ctrl-C came while work was done."""

    happened: bool = False

    def status(self, status: int) -> int:
        """The exit status: 130 where the work was interrupted."""
        return 130 if self.happened else status


@contextmanager
def keeping_finished_work() -> Iterator[Interruption]:
    """Ends a block at Ctrl-C and goes on after it, so that what was finished is written and told."""
    interruption = Interruption()
    try:
        yield interruption
    except KeyboardInterrupt:
        interruption.happened = True


def check_writable(path: Path) -> None:
    """Refuses an output path before hours of work end in an error.

    Args:
        path: File or folder that shall be written; its folder need not exist yet.

    Raises:
        ConfigError: The path is a folder where a file is meant, or its folder cannot be written.
    """
    folder = path if path.is_dir() else path.parent
    while not folder.exists():
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); choose another --out") from None


def check_output_file(path: Path, suffix: str, *, overwrite: bool = True) -> None:
    """Refuses an output file of another type, a folder in its place, or a folder that cannot be written.

    Args:
        path: The file.
        suffix: Its type.
        overwrite: Whether what is there already may go: not where it may be a user's own work.

    Raises:
        ConfigError: One of these; the message names the path.
    """
    if not overwrite and path.exists():
        raise ConfigError(f"{path}: exists already, and may have been edited; choose another --out, or give --force")
    if path.suffix.lower() != suffix:
        raise ConfigError(f"{path}: results are written as {suffix}; choose a path that ends in {suffix}")
    if path.is_dir():
        raise ConfigError(f"{path}: is a folder; choose the path of a file")
    check_writable(path)


def tell_repairs(model: "ObjectModel") -> None:
    """Says on standard error what was guessed about an object's file, or left out of it."""
    if model.path is not None:
        for repair in model.report.repairs:
            print(f"xdex: {model.path.name}: {repair}", file=sys.stderr)


def one_thread() -> None:
    """Lets linear algebra use one thread, before it is imported.

    Small matrices gain nothing from more, workers are processes, and sums then have one order: the same seed gives the
    same grasps whatever the number of workers.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    # Arrow's allocator would have a thread of its own, and only a process of one thread is forked for its workers.
    os.environ.setdefault("JE_ARROW_MALLOC_CONF", "background_thread:false")


def print_yaml(config: object) -> int:
    """Prints a configuration as YAML, ready to be changed; returns 0."""
    import yaml

    from xdex_drake.typed_yaml import to_plain

    print(yaml.safe_dump(to_plain(config), sort_keys=False, default_flow_style=None), end="")
    return 0
