"""Do verdicts of `hold` depend on the step? Half steps, and error-controlled integration.

python studies/steps/run.py OUT.csv FILE.parquet ... plays grasps of files that the library wrote; with OUT.csv alone
it prints the table of the rows again. Rows are appended, and grasps that are known are left out.
"""

import csv
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from xdex_drake.dataset.files import load_grasps
from xdex_drake.simulation.drake import lift_rig, simulate_lift
from xdex_drake.simulation.protocol import HOLD

STEP = HOLD.plant.time_step
WAYS = {
    "step": HOLD.plant,
    "half step": replace(HOLD.plant, time_step=0.5 * STEP),
    "CENIC 1e-2": replace(HOLD.plant, accuracy=1e-2),
    "CENIC 1e-3": replace(HOLD.plant, accuracy=1e-3),
}
COLUMNS = ("grasp_id", "way", "lifts", "failure_reason", "holds", "hold_reason", "slip_mm", "turn_deg", "cpu_s")


def run(out: Path, files: list[str]) -> None:
    """Appends rows."""
    known = set()
    if out.exists():
        with out.open(newline="") as file:
            known = {(row["grasp_id"], row["way"]) for row in csv.DictReader(file)}
    with out.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if not known:
            writer.writerow(COLUMNS)
        for path in files:
            for way, plant in WAYS.items():
                rig, key = None, None
                for item in load_grasps(path):
                    if (item.grasp.grasp_id, way) in known:
                        continue
                    if rig is None or key != (item.hand.name, item.scene.scene_id):
                        key = (item.hand.name, item.scene.scene_id)
                        rig = lift_rig(item.hand, item.scene, protocol=replace(HOLD, plant=plant))
                    start = time.process_time()
                    v = simulate_lift(rig, item.grasp)
                    cpu = time.process_time() - start
                    assert v.hold is not None
                    moved = (f"{1e3 * v.hold.slip_m:.2f}", f"{np.rad2deg(v.hold.turn_rad):.2f}")
                    row = (item.grasp.grasp_id, way, int(v.success), v.failure_reason, int(v.hold.holds))
                    writer.writerow((*row, v.hold.reason, *moved, f"{cpu:.3f}"))
                    file.flush()


def summarize(path: Path) -> None:
    """Prints how many verdicts of each way differ from those of the protocol's step."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    verdicts = {(row["grasp_id"], row["way"]): row for row in rows}
    for way in WAYS:
        pairs = [
            (verdicts[grasp, "step"], row)
            for (grasp, other), row in verdicts.items()
            if other == way and (grasp, "step") in verdicts
        ]
        lifts, holds = (sum(a[column] != b[column] for a, b in pairs) for column in ("lifts", "holds"))
        share = [np.mean([int(row[column]) for _, row in pairs]) for column in ("lifts", "holds")]
        cpu = np.mean([float(row["cpu_s"]) for _, row in pairs])
        print(
            f"{way:<12} {len(pairs):>4} grasps  lift {share[0]:.3f}  hold {share[1]:.3f}  "
            f"other lifts {lifts}  other holds {holds}  CPU {cpu:.2f} s"
        )
        for a, b in pairs:
            if (a["lifts"], a["holds"]) != (b["lifts"], b["holds"]):
                told = [f"{x['failure_reason'] or x['hold_reason'] or 'holds'} {x['slip_mm']} mm" for x in (a, b)]
                print(f"    {a['grasp_id']}: {told[0]}; {told[1]}")


if __name__ == "__main__":
    target = Path(sys.argv[1])
    if len(sys.argv) > 2:
        run(target, sys.argv[2:])
    summarize(target)
