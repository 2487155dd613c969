"""Grasps exported to each format and judged again: how many get the verdict of the original.

`judge` writes a row for each grasp and format, `summarize` prints the table of README.md:

    python studies/interchange/run.py judge GRASPS --out studies/interchange/results.csv
    python studies/interchange/run.py summarize studies/interchange/results.csv

GRASPS is a folder of files of grasps, such as `studies/judges/run.py make` writes. What is there already is not made
again. A format's file is written, read by its reader alone, resolved by names and judged as `xdex judge` does.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from xdex_drake.dataset.files import StoredGrasp, load_grasps
from xdex_drake.evaluation.judge import Judgement, JudgeUnit, judge, placed
from xdex_drake.grasp import Grasp
from xdex_drake.interchange.dexgraspdb import fits
from xdex_drake.interchange.formats import FORMATS
from xdex_drake.interchange.naming import HandRecord, record_of, resolve

COLUMNS = ("hand", "object", "grasp", "format", "certified", "lifted", "task_margin", "penetration_mm", "off")
BARE = "isaac_grasp, bare"
"""Isaac's own keys alone: neither squeeze nor the wrist's pose before."""


def ways(item: StoredGrasp) -> Iterator[tuple[str, str, bool]]:
    """Name of each way out and in again, its format, and whether only the format's own keys travel."""
    record = record_of(item.grasp, item.hand, item.scene)
    for format in FORMATS:
        if format != "dexgraspdb" or fits(record):
            yield format, format, False
    yield BARE, "isaac_grasp", True


def again(item: StoredGrasp, format: str, bare: bool, folder: Path) -> HandRecord:
    """A grasp that went out to a file and in again."""
    form = FORMATS[format]
    record = record_of(item.grasp, item.hand, item.scene, all_joints=form.all_joints)
    if bare:
        opened = None if record.pregrasp is None else replace(record.pregrasp, X_OG=record.grasp.X_OG)
        record = replace(record, pregrasp=opened, squeeze=None, torques=None)
    path = folder / f"x{form.suffixes[0]}"
    form.write(path, [record])
    (read,) = form.read(path)
    return resolve(read, item.hand, str(path))


def difference(item: StoredGrasp, record: HandRecord) -> float:
    """Greatest difference of what travelled: wrist pose and joints of each stage, torques."""
    grasp, found = item.grasp, [0.0]
    X_WO = item.scene.X_WO
    for stage, X_WH, q in (
        (record.grasp, grasp.X_WH, grasp.q),
        (record.pregrasp, grasp.X_WH_pregrasp, grasp.q_pregrasp),
    ):
        if stage is not None and X_WH is not None and q is not None:
            found += [np.abs((X_WO @ stage.X_OH).GetAsMatrix34() - X_WH.GetAsMatrix34()).max(), abs(stage.q - q).max()]
    if record.tau is not None and grasp.tau_squeeze is not None:
        found.append(abs(record.tau - grasp.tau_squeeze).max())
    return float(max(found))


def judged(item: StoredGrasp, grasp: Grasp) -> Judgement:
    """The verdict of certificate and lift, in this process."""
    unit = JudgeUnit(0, replace(grasp, lift=None), item.facts, item.hand_path, 0.0, ("lift-0.2/2tips",), ("drake",))
    return judge(unit)[0]


def run(folder: Path, out: Path, count: int) -> None:
    """Judges grasps of a folder before and after each way, a row each; as they are is the format `-`."""
    known = {tuple(row[n] for n in COLUMNS[:4]) for row in csv.DictReader(out.open())} if out.exists() else set()
    with out.open("a", newline="") as file, tempfile.TemporaryDirectory() as temporary:
        writer = csv.writer(file)
        if not known:
            writer.writerow(COLUMNS)
        for path in sorted(folder.glob("*.parquet")):
            for item in load_grasps(path)[:count]:
                key = (item.hand.name, item.scene.object.name, item.grasp.grasp_id)
                for name, format, bare in (("-", "", False), *ways(item)):
                    if (*key, name) in known:
                        continue
                    grasp, off = item.grasp, 0.0
                    if format:
                        record = again(item, format, bare, Path(temporary))
                        grasp = placed(record, item.hand, item.scene, FORMATS[format].kp)
                        off = 0.0 if bare else difference(item, record)
                    found = judged(item, grasp)
                    numbers = (f"{found.task_margin:.6f}", f"{1e3 * found.penetration_m:.6f}", f"{off:.2e}")
                    writer.writerow((*key, name, int(found.certified), int(found.verdicts[0].passed), *numbers))
                file.flush()


def summarize(path: Path) -> None:
    """Prints the table of README.md."""
    rows = list(csv.DictReader(path.open()))
    ours = {(r["hand"], r["object"], r["grasp"]): r for r in rows if r["format"] == "-"}
    print(f"{len(ours)} grasps, {sum(r['certified'] == '1' for r in ours.values())} certified as given, ", end="")
    print(f"{sum(r['lifted'] == '1' for r in ours.values())} lifted\n")
    print("| format | grasps | greatest difference of what travels | same certificate | same lift | same of both |")
    print("|---|---|---|---|---|---|")
    for name in dict.fromkeys(r["format"] for r in rows if r["format"] != "-"):
        pairs = [(r, ours[r["hand"], r["object"], r["grasp"]]) for r in rows if r["format"] == name]
        same = np.array([[a[c] == b[c] for c in ("certified", "lifted")] for a, b in pairs])
        shares = " | ".join(f"{100.0 * part:.1f} %" for part in (*same.mean(axis=0), same.all(axis=1).mean()))
        off = "-" if name == BARE else f"{max(float(a['off']) for a, _ in pairs):.0e}"
        print(f"| {name} | {len(pairs)} | {off} | {shares} |")


def main() -> None:
    """Runs one of the steps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("judge", "summarize"))
    parser.add_argument("path", type=Path)
    parser.add_argument("--out", type=Path, default=Path("studies/interchange/results.csv"))
    parser.add_argument("--count", type=int, default=5, help="grasps of each file")
    options = parser.parse_args()
    if options.step == "judge":
        run(options.path, options.out, options.count)
    else:
        summarize(options.path)


if __name__ == "__main__":
    main()
