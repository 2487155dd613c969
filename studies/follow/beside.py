"""Following a clip beside objects by the five hands: depth, steps and time, with the object in mind and without.

    python studies/follow/beside.py --out studies/follow/beside.csv
    python studies/follow/beside.py --summarize studies/follow/beside.csv

The clip is that of tutorial 10; each object is put where the hand's own fingers would meet.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.evaluation.judge import certified_as_given
from xdex_drake.grasp import Grasp
from xdex_drake.grasping.finish import penetrations
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.retargeting.clip import reach_grasp_lift
from xdex_drake.retargeting.hand_retargeter import HandRetargeter
from xdex_drake.retargeting.object_stream import follow_beside
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import Scene

HANDS = ("allegro", "shadow", "ability", "inspire", "schunk_svh")
OBJECTS = (("ball", 0.5), ("ball", 0.7), ("box", 0.5), ("mug", 0.6))
COLUMNS = (
    *("hand", "object", "scale", "plain_mm", "deepest_mm", "plain_step_rad", "step_rad", "wrist_mm", "touching"),
    *("certified", "ms", "slowest_ms"),
)
EVERY = 3
"""Frames whose depth is measured, against parts and mesh at 4,096 points each."""


def row(name: str, object_name: str, scale: float) -> tuple:
    """What a clip of 90 frames shows."""
    hand, thing, clip = load_hand(name), load_object(object_name, scale=scale), reach_grasp_lift(noise_m=5e-4)
    retargeter = HandRetargeter(hand, "vector").calibrated(clip.points[:10])
    closed = retargeter.scaled_points(clip.points)[62]
    X_WO = RigidTransform(0.5 * (closed[4] + closed[[8, 12]].mean(axis=0)) - thing.p_OOcm)
    frames, times = [], [time.process_time()]
    for frame in follow_beside(retargeter, clip.points, thing, X_WO):
        frames.append(frame)
        times.append(time.process_time())

    def depth(X_WH: RigidTransform, q: np.ndarray, X_WO: RigidTransform) -> float:
        return 1e3 * max(penetrations(hand, Configuration.at(hand, X_WH, q), Scene(thing, X_WO, "")))

    plain, ours = [], []
    for f in frames[::EVERY]:
        wrist = RigidTransform(RotationMatrix.ProjectToRotationMatrix(f.wanted.R_WH), f.wanted.p_WH)
        plain.append(depth(wrist, f.wanted.q, f.X_WO))
        ours.append(depth(f.X_WH, f.q, f.X_WO))
    steps = [float(np.abs(np.diff(qs, axis=0)).max()) for qs in ([f.wanted.q for f in frames], [f.q for f in frames])]
    shift = 1e3 * max(float(np.linalg.norm(f.X_WH.translation() - f.wanted.p_WH)) for f in frames)
    held = [f for f in frames if f.touching][::EVERY]
    proofs = [
        certified_as_given(hand, Scene(thing, f.X_WO, ""), Grasp(hand.name, thing.name, f.X_WO, f.X_WH, f.q))[
            1
        ].certificate
        for f in held
    ]
    spent = 1e3 * np.diff(times)
    numbers = (max(plain), max(ours), *steps, shift)
    counts = (sum(bool(f.touching) for f in frames), f"{sum(p is not None for p in proofs)}/{len(proofs)}")
    return (
        name,
        object_name,
        scale,
        *(f"{x:.3f}" for x in numbers),
        *counts,
        f"{spent.mean():.1f}",
        f"{spent.max():.1f}",
    )


def main() -> None:
    """Makes the rows, or prints the table of README.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("studies/follow/beside.csv"))
    parser.add_argument("--summarize", type=Path)
    options = parser.parse_args()
    if options.summarize is None:
        with options.out.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            for name in HANDS:
                for object_name, scale in OBJECTS:
                    writer.writerow(row(name, object_name, scale))
                    file.flush()
        return
    rows = list(csv.DictReader(options.summarize.open()))
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for one in rows:
        print(f"| {' | '.join(one[name] for name in COLUMNS)} |")


if __name__ == "__main__":
    main()
