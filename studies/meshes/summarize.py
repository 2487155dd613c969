"""Tables of `run.sh`: what was lifted in which time, and what the stored grasps say of themselves when checked again.

python studies/meshes/summarize.py LOG OUT_FOLDER
"""

import re
import sys
from pathlib import Path

import numpy as np

import xdex_drake as xd


def main(log: Path, folder: Path) -> None:
    """Prints one CSV line a run, then what all stored grasps have in common."""
    print("hand,object,tried,certified,lifted,seconds,preparation_seconds")
    for block in log.read_text().split("=== ")[1:]:
        hand, name = block.splitlines()[0].split()
        values = dict(re.findall(r"^(\w+(?: \w+)*?) {2,}(\S.*)$", block, re.MULTILINE))
        columns = ("tried", "certified", "lifted", "seconds", "preparation seconds")
        print(hand, name, *(values.get(column, "").strip() for column in columns), sep=",")
    stored = [item.grasp for path in sorted(folder.glob("*.parquet")) for item in xd.load_grasps(path)]
    residual = max(xd.check_certificate(grasp.certificate).wrench for grasp in stored)
    parts = 1e3 * np.array([grasp.penetration_parts_m for grasp in stored])
    mesh = 1e3 * np.array([grasp.penetration_mesh_m for grasp in stored])
    print(f"# {len(stored)} certified grasps; worst wrench residual / (m g), checked without a solver: {residual:.1e}")
    for what, depth in (("parts", parts), ("mesh", mesh)):
        shallow = f"<= 1 mm {100.0 * np.mean(depth <= 1.0):.0f} %"
        print(f"# penetration, {what}: mean {depth.mean():.2f} mm, p95 {np.quantile(depth, 0.95):.2f} mm, {shallow}")


main(Path(sys.argv[1]), Path(sys.argv[2]))
