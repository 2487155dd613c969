"""The same grasps through every protocol, and sweeps of what two of them leave unpublished.

    python studies/protocols/run.py judge GRASPS --out studies/protocols/results.csv
    python studies/protocols/run.py sweep GRASPS --out studies/protocols/sweep.csv
    python studies/protocols/run.py summarize studies/protocols/results.csv --sweep studies/protocols/sweep.csv

GRASPS is a folder of files of grasps, such as `studies/judges/run.py make` writes; `--count` grasps of each file are
taken. What is there already is not made again.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from xdex_drake.dataset.files import StoredGrasp, load_grasps
from xdex_drake.simulation import drake
from xdex_drake.simulation.protocol import LIFT_05, PROTOCOLS, SHAKE_6, AnyProtocol, LiftProtocol, PushProtocol

COLUMNS = ("hand", "object", "grasp", "protocol", "passed", "reason", "cpu_s")


def shaken(size: float, push_s: float, friction: float) -> PushProtocol:
    """`shake-6-like` with other loads [g], durations [s] and friction."""
    accelerations = tuple(tuple(size * a for a in one) for one in SHAKE_6.accelerations)
    plant = replace(SHAKE_6.grip.plant, friction=friction)
    grip = replace(SHAKE_6.grip, plant=plant, friction=friction)
    name = f"shake-6-like, {size:g} g, {push_s:g} s, friction {friction:g}"
    return replace(SHAKE_6, name=name, accelerations=accelerations, push_s=push_s, grip=grip)  # type: ignore[arg-type]


def lifted(friction: float, mass_kg: float, rise_s: float) -> LiftProtocol:
    """`lift-0.5-like` with another friction, mass [kg] and time of the rise [s]."""
    plant = replace(LIFT_05.plant, friction=friction)
    name = f"lift-0.5-like, friction {friction:g}, {mass_kg:g} kg, {rise_s:g} s"
    return replace(LIFT_05, name=name, plant=plant, friction=friction, mass_kg=mass_kg, rise_s=rise_s)


SWEEP = (
    *(shaken(size, 1.0, 0.6) for size in (0.5, 1.0, 2.0)),
    *(shaken(1.0, push_s, 0.6) for push_s in (0.3, 3.0)),
    *(shaken(1.0, 1.0, friction) for friction in (0.4, 1.0)),
    *(lifted(friction, 0.1, 1.0) for friction in (0.4, 0.6, 1.0)),
    *(lifted(0.6, mass_kg, 1.0) for mass_kg in (0.03, 0.3)),
    *(lifted(0.6, 0.1, rise_s) for rise_s in (0.5, 2.0)),
)


def run(folder: Path, out: Path, count: int, protocols: dict[str, AnyProtocol]) -> None:
    """Judges grasps of a folder by protocols and appends a row for each verdict."""
    known = {tuple(row[n] for n in COLUMNS[:4]) for row in csv.DictReader(out.open())} if out.exists() else set()
    with out.open("a", newline="") as file:
        writer = csv.writer(file)
        if not known:
            writer.writerow(COLUMNS)
        for path in sorted(folder.glob("*.parquet")):
            for item in load_grasps(path)[:count]:
                for name, protocol in protocols.items():
                    key = (item.hand.name, item.scene.object.name, item.grasp.grasp_id, name)
                    if key not in known:
                        writer.writerow((*key, *verdict(item, protocol)))
                        file.flush()


def verdict(item: StoredGrasp, protocol: AnyProtocol) -> tuple[int, str, str]:
    """Whether a grasp passes, why not, and the processor time that it took to tell."""
    begin = time.process_time()
    found = drake.lift(item.grasp, item.hand, item.scene, protocol=protocol)
    reason = found.failure_reason or (found.hold.reason if found.hold is not None else "")
    return int(found.passed), reason, f"{time.process_time() - begin:.2f}"


def summarize(path: Path, key: Callable[[dict[str, str]], str]) -> None:
    """Prints a line for each protocol: share that passes by hand, what failed, time."""
    rows = list(csv.DictReader(path.open()))
    hands = list(dict.fromkeys(row["hand"] for row in rows))
    names = list(dict.fromkeys(key(row) for row in rows))
    # Only grasps that went through all.
    went = Counter((row["hand"], row["object"], row["grasp"]) for row in rows)
    rows = [row for row in rows if went[row["hand"], row["object"], row["grasp"]] == len(names)]
    print(f"{len(rows) // len(names)} grasps\n")
    print(f"| protocol | passed | {' | '.join(hands)} | failed by | CPU [s] |")
    print("|---|---|" + "---|" * (len(hands) + 2))
    for name in names:
        these = [row for row in rows if key(row) == name]
        share = [[row["passed"] == "1" for row in these if hand in ("", row["hand"])] for hand in ("", *hands)]
        cells = " | ".join(f"{100.0 * sum(part) / max(1, len(part)):.0f} %" for part in share)
        failed = Counter(row["reason"].split(":")[0] for row in these if row["passed"] == "0")
        told = ", ".join(f"{reason} {n}" for reason, n in failed.most_common()) or "-"
        print(f"| {name} | {cells} | {told} | {sum(float(row['cpu_s']) for row in these) / len(these):.2f} |")


def main() -> None:
    """Runs one of the steps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("judge", "sweep", "summarize"))
    parser.add_argument("path", type=Path)
    parser.add_argument("--out", type=Path, default=Path("studies/protocols/results.csv"))
    parser.add_argument("--sweep", type=Path)
    parser.add_argument("--count", type=int, default=2, help="grasps of each file")
    options = parser.parse_args()
    if options.step == "summarize":
        summarize(options.path, lambda row: row["protocol"])
        if options.sweep is not None:
            print()
            summarize(options.sweep, lambda row: row["protocol"])
        return
    chosen = dict(PROTOCOLS) if options.step == "judge" else {protocol.name: protocol for protocol in SWEEP}
    run(options.path, options.out, options.count, chosen)


if __name__ == "__main__":
    main()
