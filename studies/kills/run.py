"""Kills runs of `xdex dataset generate` at random moments and goes on with them; nothing may be lost or come twice.

    python studies/kills/run.py DATASET studies/kills/results.json --kills 50 --disk

A run makes shards and a compact table at once. Its units give the rows of one shard of DATASET, under names of their
own, after a pause of some milliseconds: what is tried is the engine, not the grasps. Each run is a process of its own,
killed by SIGKILL at a moment drawn by seed; some work alone, some through a worker. Runs follow each other on one
folder until it is whole, then the next folder begins. After every kill, what was whole before must be there to the last
byte, and a whole folder must equal one of an unbroken run: every shard, and every record of the table.
"""

import argparse
import collections
import hashlib
import json
import os
import signal
import subprocess
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from xdex_drake.dataset.compact import to_bytes
from xdex_drake.dataset.folder import completed_units, shard_paths
from xdex_drake.dataset.grasp_file import read_grasps
from xdex_drake.dataset.schema import Row
from xdex_drake.dataset.tables import Damage, read_records
from xdex_drake.errors import XdexError
from xdex_drake.jobs import pairs
from xdex_drake.jobs.pairs import DatasetConfig, PairUnit, UnitRows, generate

CONFIG = DatasetConfig(hands=("g0-0000..g0-0099",), objects=("s0-0000..s0-0005",), units_per_scene=4, targets=6)
"""Twenty-four units."""

PAUSE_S = 0.02
LATEST_S = 2.5
"""A run is killed within so many seconds."""


def renamed(rows: list[Row], unit: PairUnit) -> list[Row]:
    """The rows, under names of this unit."""
    return [
        {**row, "grasp_id": f"{unit.name}/{row['grasp_id']}"}
        | {"source_grasp_id": row["source_grasp_id"] and f"{unit.name}/{row['source_grasp_id']}"}
        for row in rows
    ]


def repeated(unit: PairUnit, config: DatasetConfig, rows: list[Row]) -> UnitRows:
    """Stands in for the work of a unit."""
    time.sleep(PAUSE_S)
    return UnitRows(tuple(renamed(rows, unit)), ())


def contents(folder: Path) -> dict[str, str]:
    """Digests of the shards and of the table's records of a folder, by name; a damaged record is none."""
    found = {path.name: path.read_bytes() for path in shard_paths(folder / "data")}
    counts: collections.Counter[str] = collections.Counter()
    for record in read_records(folder / "table"):
        if not isinstance(record, Damage):
            counts[record.header.unit] += 1
            found[f"{record.header.unit}#{counts[record.header.unit]}"] = to_bytes(record)
    return {name: hashlib.sha256(data).hexdigest() for name, data in found.items()}


def run_killed(folder: Path, workers: int, moment_s: float) -> bool:
    """Runs in a process that is killed after some time; whether it ended by itself before."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.setsid()
            generate(CONFIG, folder / "data", table=folder / "table", workers=workers)
            status = 0
        finally:
            os._exit(status)
    end = time.monotonic() + moment_s
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            if status:
                raise RuntimeError(f"a run ended with status {status}")
            return True
        time.sleep(0.001)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


def study(rows: list[Row], kills: int, seed: int) -> dict[str, Any]:
    """Kills runs and counts what was wrong afterwards."""
    setattr(pairs, "run_unit", partial(repeated, rows=rows))  # noqa: B010 - where `generate` looks it up
    rng, done, folders = np.random.default_rng(seed), 0, 0
    wrong: collections.Counter[str] = collections.Counter(dict.fromkeys(("lost", "changed", "twice", "unequal"), 0))
    moments, left_over = [], 0
    with tempfile.TemporaryDirectory() as home:
        unbroken = Path(home) / "unbroken"
        generate(CONFIG, unbroken / "data", table=unbroken / "table", workers=0)
        whole = contents(unbroken)
        while done < kills:
            folder, before, is_whole = Path(home) / f"killed-{folders}", {}, False
            folders += 1
            while not is_whole:
                moment = float(rng.uniform(0.0, LATEST_S)) if done < kills else float("inf")
                begun = time.monotonic()
                is_whole = run_killed(folder, int(rng.integers(2)), moment)
                if not is_whole:
                    done += 1
                    moments.append(time.monotonic() - begun)
                after = contents(folder) if (folder / "table").exists() else {}
                wrong["lost"] += len(before.keys() - after.keys())
                wrong["changed"] += sum(after[name] != digest for name, digest in before.items() if name in after)
                left_over += sum(1 for _ in folder.rglob("*.partial"))
                before = after
            wrong["twice"] += sum(name.endswith("#2") for name in before)
            wrong["unequal"] += before != whole
    return {
        "kills": done,
        "folders": folders,
        "units": len(pairs.plan(CONFIG)),
        "rows_a_unit": len(rows),
        "killed_after_s": {"least": round(min(moments), 3), "most": round(max(moments), 3)},
        "partial_files_seen": left_over,
        "wrong": dict(wrong),
    }


def disk_study(rows: list[Row]) -> dict[str, Any]:
    """Fills a disk of 200 kB in mid-run, then makes it read-only, then larger, and goes on."""
    setattr(pairs, "run_unit", partial(repeated, rows=rows))  # noqa: B010 - where `generate` looks it up
    with tempfile.TemporaryDirectory() as home:
        unbroken, disk = Path(home) / "unbroken", Path(home) / "disk"
        generate(CONFIG, unbroken / "data", table=unbroken / "table", workers=0)
        disk.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(disk)], check=True)
        try:
            told = {"full": refused(disk)}
            at_full = contents(disk)
            subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
            told["read_only"] = refused(disk)
            kept = contents(disk) == at_full
            subprocess.run(["mount", "-o", "remount,rw,size=64m", str(disk)], check=True)
            generate(CONFIG, disk / "data", table=disk / "table", workers=0)
            after = contents(disk)
        finally:
            subprocess.run(["umount", str(disk)], check=True)
        return {
            "errors": {name: text.replace(str(disk), "DISK") for name, text in told.items()},
            "shards_when_full": sum(name.endswith(".parquet") for name in at_full),
            "all_kept_when_read_only": kept,
            "lost_or_changed": sum(after.get(name) != digest for name, digest in at_full.items()),
            "equal_in_the_end": after == contents(unbroken),
        }


def refused(disk: Path) -> str:
    """What a run says that cannot write."""
    try:
        generate(CONFIG, disk / "data", table=disk / "table", workers=0)
    except XdexError as error:
        return f"{type(error).__name__}: {error}"
    raise RuntimeError("a run that could not write said nothing")


def main() -> None:
    """Runs the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--disk", action="store_true", help="also fill a small disk; needs the right to mount one")
    options = parser.parse_args()
    assert completed_units(options.dataset), "give a data set with a shard"
    shard = min((path for path in shard_paths(options.dataset) if read_grasps(path)), key=lambda p: p.stat().st_size)
    rows = read_grasps(shard)
    result = study(rows, options.kills, options.seed)
    if options.disk:
        result["disk"] = disk_study(rows)
    options.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
