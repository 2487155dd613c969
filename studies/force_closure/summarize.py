"""Tables of the study: what was certified, what lifted, how fast, how deep, and which objects defeated a hand.

python studies/force_closure/summarize.py RESULTS.csv...
"""

import csv
import sys
from collections import Counter
from pathlib import Path

import numpy as np

LOW_MM = 22.0
"""Objects that rest lower than this are lower than a fingertip of Allegro is thick."""


def summarize(path: Path) -> None:
    """Prints the tables of one file."""
    rows = list(csv.DictReader(path.open(encoding="utf-8")))
    found = [row for row in rows if row["certified"] == "1"]
    if not found:
        print(f"{path.name}: no certified grasp among {len(rows)}")
        return
    lifted = np.array([row["lifted"] == "1" for row in found])
    height = np.array([float(row["height_mm"]) for row in found])
    seconds = np.array([float(row["certify_s"]) for row in found])
    lift_s = np.array([float(row["lift_s"]) for row in found])
    missing = Counter(row["object"] for row in rows if row["certified"] == "0")
    hand, protocol = rows[0]["hand"], rows[0]["protocol"]
    print(f"{hand}, {protocol}: {len({row['object'] for row in rows})} objects, {len(rows)} grasps wanted")
    print(f"  certified {len(found)}; lifted {lifted.sum()} ({lifted.mean():.1%}), with no selection")
    tall = height >= LOW_MM
    share = f"{lifted[tall].sum()} of {tall.sum()} ({lifted[tall].mean():.1%})"
    print(f"  on objects {LOW_MM:.0f} mm high or higher: lifted {share}")
    rate = len(found) / seconds.sum()
    print(f"  processor time a certified grasp: median {np.median(seconds):.3f} s, {rate:.1f} a second")
    per_object = {row["object"]: [] for row in found}
    for row, s in zip(found, seconds, strict=True):
        per_object[row["object"]].append(s)
    rates = sorted(len(s) / sum(s) for s in per_object.values())
    print(f"  the same, by object: median {np.median(rates):.1f} a second, {rates[0]:.2f} to {rates[-1]:.1f}")
    rate = lifted.sum() / (seconds.sum() + lift_s.sum())
    print(f"  a lift: median {np.median(lift_s):.2f} s; lifted grasps a second, all included: {rate:.2f}")
    for column in ("penetration_parts_mm", "penetration_mesh_mm"):
        depth = np.array([float(row[column]) for row in found])
        shares = f"p95 {np.quantile(depth, 0.95):.3f}, within 1 mm {np.mean(depth <= 1.0):.1%}"
        print(f"  {column}: mean {depth.mean():.3f}, {shares}")
    print(f"  worst wrench residual {max(float(row['residual']) for row in found):.1e} m g")
    print(f"  reasons of failed lifts: {dict(Counter(row['reason'] for row in found if row['lifted'] == '0'))}")
    for name, n in missing.items():
        row = next(row for row in rows if row["object"] == name and row["certified"] == "0")
        print(f"  missing {n} on {name} ({row['height_mm']} mm high), refused of {row['tried']}: {row['rejected']}")


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        summarize(Path(argument))
