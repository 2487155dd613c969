"""How well do margins tell which certified grasps lift? The area under the ROC curve, and what a floor would keep.

python studies/margins/run.py OUT_FOLDER [HAND:OBJECT:COUNT ...]; with the folder alone it prints the tables of
OUT_FOLDER/results.csv again. The committed rows: allegro:mug:60 shadow:mug:30 allegro:can:12 allegro:box:12
shadow:bottle:12 ability:can:10, about four minutes on one core.

Every certified grasp of a search is lifted twice: as it is, and hard, with 0.75 times the friction and twice the mass.
Grasps squeeze with the forces of their certificate in both, so that a hard lift asks for what the margins promise.
"""

import csv
import itertools
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import rankdata

import xdex_drake as xd
from xdex_drake.contact import contact_geometry, epsilon_linearized
from xdex_drake.dataset.synthesis import GIVEN, SynthesisSettings, certified_grasps
from xdex_drake.simulation.lift import lift, lift_rig, simulate_lift
from xdex_drake.simulation.protocol import LIFT, with_physics

MARGINS = ("task_margin", "ball_margin", "least", "epsilon", "contacts")
FRICTION, MASS = 0.75, 2.0


def rows_of(hand_name: str, object_name: str, count: int) -> list[dict]:
    """Margins and lifts of some certified grasps."""
    hand, scene = xd.load_hand(hand_name), xd.make_scene(xd.load_object(object_name))
    rig, model = lift_rig(hand, scene), scene.object
    hard_scene = with_physics(scene, mass=MASS * model.mass, friction=FRICTION * model.friction)
    hard = replace(LIFT, plant=replace(LIFT.plant, friction=FRICTION * LIFT.plant.friction))
    rows = []
    found = certified_grasps(hand, scene, seed=0, time_limit_s=120.0, settings=SynthesisSettings(demands=GIVEN))
    for grasp in itertools.islice(found, count):
        proof = grasp.certificate
        points, normals = np.array([c.p_OC for c in proof.contacts]), np.array([c.n_OC for c in proof.contacts])
        G = contact_geometry(points, normals, proof.R_WO, proof.p_OOcm)[1]
        easy, difficult = simulate_lift(rig, grasp), lift(grasp, hand, hard_scene, protocol=hard)
        rows.append(
            {
                "hand": hand_name,
                "object": Path(object_name).stem,
                "contacts": len(proof.contacts),
                "task_margin": round(proof.task_margin, 5),
                "ball_margin": round(proof.margin_lower, 5),
                "epsilon": round(epsilon_linearized(G, proof.contacts[0].mu, length=proof.length), 5),
                "lift": easy.failure_reason or "lifted",
                "hard_lift": difficult.failure_reason or "lifted",
            }
        )
        print(*rows[-1].values(), sep=",", flush=True)
    return rows


def auc(values: np.ndarray, success: np.ndarray) -> float:
    """Probability that a success has the greater value than a failure; ties count one half."""
    good, bad = int(success.sum()), int((~success).sum())
    if not good or not bad:
        return float("nan")
    return float((rankdata(values)[success].sum() - good * (good + 1) / 2) / (good * bad))


def main() -> None:
    """Runs what is asked for, and prints and writes the tables."""
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    if len(sys.argv) > 2:
        rows = [
            row
            for job in sys.argv[2:]
            for row in rows_of(*(part for part in job.split(":")[:2]), int(job.split(":")[2]))
        ]
        with (out / "results.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            writer.writerows(rows)
    with (out / "results.csv").open() as file:
        table = list(csv.DictReader(file))
    columns = {name: np.array([float(row[name]) for row in table]) for name in MARGINS if name != "least"}
    # Each in units of its own median: the least says which is short.
    columns["least"] = np.minimum(
        *(columns[name] / np.median(columns[name]) for name in ("task_margin", "ball_margin"))
    )
    summary: dict = {"grasps": len(table), "hard": {"friction": FRICTION, "mass": MASS}}
    pairs = np.array([f"{row['hand']} {row['object']}" for row in table])
    for outcome in ("lift", "hard_lift"):
        success = np.array([row[outcome] == "lifted" for row in table])
        print(f"\n{outcome}: {success.sum()} of {len(success)} lifted; AUC")
        summary[outcome] = {"lifted": int(success.sum())}
        for name in MARGINS:
            summary[outcome][f"auc_{name}"] = round(auc(columns[name], success), 3)
            print(f"  {name:<12} {auc(columns[name], success):.3f}")
        for pair in dict.fromkeys(pairs):
            chosen = pairs == pair
            values = ", ".join(f"{name} {auc(columns[name][chosen], success[chosen]):.2f}" for name in MARGINS[:4])
            print(f"  {pair:<28} {success[chosen].sum():>3} of {chosen.sum():<3} {values}")
        print("  floor on the task margin: kept, lifted of kept")
        summary[outcome]["floors"] = []
        for floor in (0.0, 0.25, 0.5, 1.01, 2.0, 4.0):
            kept = columns["task_margin"] >= floor
            share = float(success[kept].mean()) if kept.any() else float("nan")
            summary[outcome]["floors"].append({"floor": floor, "kept": int(kept.sum()), "lifted": round(share, 3)})
            print(f"    {floor:<5} {kept.sum():>4} {100 * share:5.1f} %")
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")


main()
