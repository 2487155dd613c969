"""Who is still held after two seconds and six pushes, in two simulators, and what foretells it.

    python studies/holds/survival.py run MESH_FOLDER OUT.csv [--meshes 24] [--count 4] [--mujoco]
    python studies/holds/survival.py summarize OUT.csv

For each hand and mesh, at its most probable pose, the first COUNT grasps that are certified under the demands of a
search, but whatever is foretold of them, are lifted, held and pushed by the protocol `hold`. A row a grasp; a cell that
stands in the file is not run again.
"""

import argparse
import csv
import itertools
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

HANDS = ("allegro", "shadow", "ability", "inspire", "schunk_svh")
COLUMNS = (
    "hand", "object", "trial", "tried", "certify_s", "foretold", "elastic", "stiffness", "task_margin", "ball_margin",
    "friction_left", "lifted", "held", "reason", "slip_mm", "turn_deg", "hold_s", "mujoco_lifted", "mujoco_held",
    "mujoco_reason",
)  # fmt: skip
PREDICTORS = ("foretold", "elastic", "stiffness", "task_margin", "ball_margin", "friction_left")


def rows_of_cell(hand_name: str, mesh: Path, count: int, with_mujoco: bool) -> list[dict[str, Any]]:
    """Rows of one hand and mesh; times are processor seconds."""
    from xdex_drake.grasping.synthesis import SynthesisSettings, certified_grasps
    from xdex_drake.grasping.tally import Tally
    from xdex_drake.hand.library import load_hand
    from xdex_drake.scene.object import load_object
    from xdex_drake.scene.tabletop import make_scene
    from xdex_drake.simulation import drake, mujoco
    from xdex_drake.simulation.protocol import find_protocol

    hand, scene, protocol = load_hand(hand_name), make_scene(load_object(mesh)), find_protocol("hold")
    _ = scene.object.grid, scene.object.exact
    settings = SynthesisSettings()
    settings = replace(settings, demands=replace(settings.demands, foretold=float("inf")))
    tally, rows, begin = Tally(), [], time.process_time()
    found = certified_grasps(hand, scene, seed=0, time_limit_s=40.0, settings=settings, tally=tally)
    for trial, grasp in enumerate(itertools.islice(found, count)):
        certified = time.process_time()
        lift = drake.lift(grasp, hand, scene, protocol=protocol)
        held = time.process_time()
        other = mujoco.lift(grasp, hand, scene, protocol=protocol) if with_mujoco else None
        proof, hold = grasp.certificate, lift.hold
        assert proof is not None and hold is not None
        row = {
            "hand": hand_name, "object": mesh.stem, "trial": trial, "tried": tally.tried,
            "certify_s": certified - begin, "foretold": grasp.foretold_motion, "elastic": grasp.squeeze_margin,
            "stiffness": grasp.stiffness_least, "task_margin": proof.task_margin, "ball_margin": proof.margin_lower,
            "friction_left": proof.friction_left, "lifted": int(lift.success), "held": int(lift.passed),
            "reason": lift.failure_reason or hold.reason, "slip_mm": 1e3 * hold.slip_m,
            "turn_deg": np.degrees(hold.turn_rad), "hold_s": held - certified,
        }  # fmt: skip
        if other is not None:
            why = other.failure_reason or ("" if other.hold is None else other.hold.reason)
            row |= {"mujoco_lifted": int(other.success), "mujoco_held": int(other.passed), "mujoco_reason": why}
        rows.append({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()})
        begin = time.process_time()
    return rows or [{"hand": hand_name, "object": mesh.stem, "trial": -1, "tried": tally.tried, "reason": "no grasp"}]


def run(meshes: list[Path], out: Path, count: int, with_mujoco: bool) -> None:
    """Appends the cells that are missing, mesh by mesh."""
    from tqdm import tqdm

    done = set()
    if out.exists():
        done = {(row["hand"], row["object"]) for row in csv.DictReader(out.open(encoding="utf-8"))}
    else:
        out.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
    cells = [(hand, mesh) for mesh in meshes for hand in HANDS if (hand, mesh.stem) not in done]
    for hand, mesh in tqdm(cells, unit="cell"):
        rows = rows_of_cell(hand, mesh, count, with_mujoco)
        with out.open("a", newline="", encoding="utf-8") as stream:
            csv.DictWriter(stream, COLUMNS, restval="", lineterminator="\n").writerows(rows)


def area(score: np.ndarray, good: np.ndarray) -> float:
    """Area under the ROC curve: the chance that a good one has the greater score."""
    a, b = score[good][:, None], score[~good][None]
    return float(((a > b) + 0.5 * (a == b)).mean())


def summarize(out: Path) -> None:
    """Prints survival, what foretells it, and survival against yield."""
    rows = [row for row in csv.DictReader(out.open(encoding="utf-8")) if int(row["trial"]) >= 0]
    judges = {"drake": ("lifted", "held"), "mujoco": ("mujoco_lifted", "mujoco_held")}
    values = {name: np.array([float(row[name]) for row in rows]) for name in PREDICTORS}
    foretold = np.where(np.isnan(values["foretold"]), np.inf, values["foretold"])
    hands = np.array([row["hand"] for row in rows])
    for judge, (lifted_column, held_column) in judges.items():
        if not rows or not rows[0][lifted_column]:
            continue
        lifted = np.array([row[lifted_column] == "1" for row in rows])
        held = np.array([row[held_column] == "1" for row in rows])
        print(f"{judge}: {len(rows)} certified grasps, {lifted.sum()} lifted, {held.sum()} held")
        for hand in HANDS:
            here = (hands == hand) & lifted
            kept = here & (foretold <= 0.0)
            print(f"  {hand:11s} held of lifted {held[here].sum()} of {here.sum()}", end="")
            print(f"; of those foretold to hold {held[kept].sum()} of {kept.sum()}")
        for share in (1.0, 0.7, 0.5, 0.4, 0.3):
            kept = lifted & (foretold <= np.quantile(foretold, share, method="lower"))
            print(f"  yield {share:.1f}: {held[kept].sum()} of {kept.sum()} held, {held[kept].mean():.3f}")
        for name, score in values.items():
            known = lifted & ~np.isnan(score)
            sign = -1.0 if name == "foretold" else 1.0
            if held[known].any() and not held[known].all():
                print(f"  AUC of {name}: {area(sign * score[known], held[known]):.3f}")
    if rows and rows[0]["mujoco_lifted"]:
        for what in ("lifted", "held"):
            same = np.mean([row[what] == row[f"mujoco_{what}"] for row in rows])
            print(f"both simulators agree on {what}: {same:.3f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "summarize"))
    parser.add_argument("paths", nargs="+", type=Path, help="MESH_FOLDER OUT.csv, or OUT.csv")
    parser.add_argument("--meshes", type=int, default=24, help="how many, in the order of their names")
    parser.add_argument("--count", type=int, default=4)
    parser.add_argument("--mujoco", action="store_true", help="ask MuJoCo as well")
    options = parser.parse_args()
    if options.what == "run":
        folder, target = options.paths
        run(sorted(folder.glob("*.obj"))[: options.meshes], target, options.count, options.mujoco)
    else:
        summarize(options.paths[0])
