"""Broken files: each is read or refused in one clear line, in time and in memory, and never ends in a traceback.

`python studies/mutants/run.py hands --count 500` breaks that many files in the ways of `hands.py`, reads each in a
process of its own, and writes hands.csv, one line for each way: how many files were read after all, how many refused,
and how many ended as none may. `--keep FOLDER` keeps those. A file may take 30 s of processor time and 2 GB.
"""

import argparse
import csv
import importlib
import multiprocessing
import os
import resource
import shutil
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from xdex_drake.errors import XdexError

KINDS = ("hands", "meshes")
LIMIT_S = 30
LIMIT_BYTES = 2_000_000_000
LONGEST_LINE = 600
BAD = ("traceback", "unclear", "late", "ended")


def outcome(read: Callable[[Path], None], path: Path) -> tuple[str, str]:
    """What reading one file leads to: read, refused, or one of `BAD`; and what was said."""
    try:
        read(path)
    except XdexError as error:
        said = str(error)
        clear = "\n" not in said and len(said) <= LONGEST_LINE and path.name in said
        return ("refused" if clear else "unclear"), said
    except Exception:
        return "traceback", traceback.format_exc(limit=-4)
    return "read", ""


def in_a_process(read: Callable[[Path], None], path: Path) -> tuple[str, str, float]:
    """The outcome in a forked process with limits, and the processor time that it took [s]."""

    def work(end: Connection) -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S))
        used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES, used + LIMIT_BYTES))
        start = time.process_time()
        end.send((*outcome(read, path), time.process_time() - start))

    ours, theirs = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("fork").Process(target=work, args=(theirs,))
    process.start()
    theirs.close()
    try:
        found = ours.recv()
    except EOFError:
        process.join()
        late = process.exitcode in (-24, -9)
        found = ("late" if late else "ended", f"exit code {process.exitcode}", float(LIMIT_S) if late else 0.0)
    process.join()
    return found


def main() -> None:
    """Breaks files, reads them and writes the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="a folder for the files that ended as none may")
    options = parser.parse_args()
    kind = importlib.import_module(options.kind)
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    slowest: defaultdict[str, float] = defaultdict(float)
    with tempfile.TemporaryDirectory() as folder:
        for way, path in kind.mutants(Path(folder), options.count, options.seed):
            found, said, seconds = in_a_process(kind.read, path)
            counts[way][found] += 1
            slowest[way] = max(slowest[way], seconds)
            if found in BAD:
                print(f"{way}: {path.name}: {found}: {said}", flush=True)
                if options.keep is not None:
                    options.keep.mkdir(parents=True, exist_ok=True)
                    shutil.copy(path, options.keep / f"{way}_{path.name}")
            path.unlink(missing_ok=True)
    columns = ("way", "files", "read", "refused", *BAD, "slowest_cpu_s")
    with (Path(__file__).parent / f"{options.kind}.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        for way, count in counts.items():
            numbers = [count[name] for name in ("read", "refused", *BAD)]
            writer.writerow([way, count.total(), *numbers, f"{slowest[way]:.1f}"])
    print(sum((count for count in counts.values()), Counter()))


if __name__ == "__main__":
    main()
