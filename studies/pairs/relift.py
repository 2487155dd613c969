"""Whether grasps of a compact table lift as those did that it was made of.

Units of a data set are compacted, expanded, and every grasp is lifted again by the protocol of its row.

Run `python studies/pairs/relift.py out/pairs --count 300 --out studies/pairs/relift.csv`.
"""

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path

from xdex_drake.dataset.compact import to_bytes
from xdex_drake.dataset.folder import read_rejected, shard_paths
from xdex_drake.dataset.grasp_file import read_grasps
from xdex_drake.dataset.schema import grasp_from_row
from xdex_drake.jobs.compaction import compact_rows, expand_unit
from xdex_drake.jobs.workbench import hand_of, rig_of
from xdex_drake.simulation.drake import simulate_lift
from xdex_drake.simulation.protocol import find_protocol

COLUMNS = ("grasp", "protocol", "certified", "before", "after", "held_before", "held_after", "bytes")


def relift(path: Path) -> Iterator[tuple[object, ...]]:
    """What became of each grasp of a shard."""
    rows, unit = read_grasps(path), path.name.removesuffix(".parquet")
    compact = compact_rows(unit, rows, path.parent.parent, rejected=read_rejected(path))
    if compact is None:
        return
    size = len(to_bytes(compact)) / len(rows)
    for before, row in zip(rows, expand_unit(compact, path.parent.parent), strict=True):
        assert before["grasp_id"] == row["grasp_id"]
        grasp = grasp_from_row(row)
        certified = grasp.certificate is not None
        lift = None
        if certified:
            hand_of(row["hand"])
            lift = simulate_lift(rig_of(row["hand"], compact.header.scene, find_protocol(row["protocol"]).grip), grasp)
        held = None if lift is None or lift.hold is None else lift.hold.holds
        success = lift is not None and lift.success
        yield (
            row["grasp_id"],
            row["protocol"],
            certified,
            before["success"],
            success,
            before["holds"],
            held,
            round(size, 1),
        )


def main() -> None:
    """Writes a row a grasp and prints the shares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--out", type=Path, default=Path("relift.csv"))
    options = parser.parse_args()
    rows: list[tuple[object, ...]] = []
    for path in shard_paths(options.folder):
        if len(rows) < options.count:
            rows += relift(path)
    with options.out.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([COLUMNS, *rows])
    same = sum(row[3] == row[4] for row in rows)
    pushed = [row for row in rows if row[5] is not None and row[6] is not None]
    print(f"{len(rows)} grasps, {sum(bool(row[2]) for row in rows)} certified again, {same} with the same verdict")
    print(f"{len(pushed)} pushed, {sum(row[5] == row[6] for row in pushed)} with the same verdict of holding")


if __name__ == "__main__":
    main()
