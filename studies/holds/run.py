"""Which squeeze lets an object survive two seconds and six pushes of its weight, and what foretells that it does?

python studies/holds/run.py OUT.csv [HAND:OBJECT:COUNT ...]; with the file alone it prints its tables again.

Grasps are those that a search certifies, lifted or not. Each is held twice by the protocol `hold`: with the squeeze
that applies its certificate's forces, and with the one of `grasping.passive`. What is asked to foretell was computed
before, for the forces of each squeeze, and chose none of the grasps.
"""

import csv
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from scipy.stats import rankdata

from xdex_drake.contact.passive import SqueezeSettings, assessed
from xdex_drake.grasping.passive import elastic_grasp, foretold_motion, holding_squeeze
from xdex_drake.grasping.squeeze import squeezed
from xdex_drake.grasping.synthesis import certified_grasps
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene
from xdex_drake.simulation.lift import lift_rig, simulate_lift
from xdex_drake.simulation.protocol import HOLD

SIGNS = {
    "task_margin": 1,
    "friction_left": 1,
    "ball_margin": 1,
    "elastic_margin": 1,
    "slip_margin": 1,
    "K_q": 1,
    "K_x": 1,
    "spread_deg": -1,
    "foretold": -1,
}
"""What is asked to foretell, and whether more is better."""

FLOORS = (0.5, 0.0, -0.5, -1.0, -1.5)


def rows_of(hand_name: str, object_name: str, count: int) -> Iterator[dict]:
    """Both squeezes of some grasps: what could foretell, and what became of them."""
    hand, scene = load_hand(hand_name), make_scene(load_object(object_name))
    kp, rig = HOLD.plant.kp, lift_rig(hand, scene, protocol=HOLD)
    for number, grasp in enumerate(islice(certified_grasps(hand, scene, seed=0, time_limit_s=120.0), count)):
        proof, k = grasp.certificate, Configuration.at(hand, grasp.X_WH, grasp.q)
        assert proof is not None
        found = holding_squeeze(hand, k, scene, proof, kp=kp)
        elastic = elastic_grasp(hand, k, scene, proof, kp)
        stored = np.array([contact.f_C for contact in proof.contacts]).ravel()
        none = np.zeros((len(elastic.loads.pushes), len(proof.contacts), 2))
        first = assessed(elastic.stiffness, elastic.loads, stored, 0.0, none, SqueezeSettings())
        same = {"hand": hand_name, "object": Path(object_name).stem, "grasp": number}
        same |= {"task_margin": proof.task_margin, "friction_left": proof.friction_left}
        same |= {"ball_margin": proof.margin_lower, "spread_deg": float(np.rad2deg(found.spread.mean()))}
        other = squeezed(hand, grasp, found.squeeze.torques, kp)
        trials = (
            ("certificate", grasp, first, foretold_motion(elastic, stored)),
            ("passive", other, found.squeeze, found.foretold),
        )
        for name, tried, squeeze, foretold in trials:
            verdict = simulate_lift(rig, tried)
            hold = verdict.hold
            row = same | {"squeeze": name, "slip_margin": squeeze.margin, "elastic_margin": squeeze.elastic_margin}
            row |= {"K_q": squeeze.joint_eigenvalue, "K_x": squeeze.object_eigenvalue, "foretold": foretold}
            row |= {"greatest_n": float(squeeze.f[2::3].max()), "seconds": squeeze.seconds}
            row |= {"lifted": int(verdict.success), "holds": int(verdict.passed)}
            row |= {"reason": verdict.failure_reason or (hold.reason if hold is not None else "")}
            yield {key: round(value, 5) if isinstance(value, float) else value for key, value in row.items()}


def auc(values: np.ndarray, success: np.ndarray) -> float:
    """Probability that a success has the greater value than a failure; ties count one half."""
    good, bad = int(success.sum()), int((~success).sum())
    if not good or not bad:
        return float("nan")
    return float((rankdata(values)[success].sum() - good * (good + 1) / 2) / (good * bad))


def summarize(table: list[dict]) -> None:
    """Prints survival by squeeze, what foretells it, and what a floor would keep."""
    for name in dict.fromkeys(row["squeeze"] for row in table):
        rows = [row for row in table if row["squeeze"] == name]
        lifted = [row for row in rows if int(row["lifted"])]
        holds = np.array([int(row["holds"]) for row in lifted], dtype=bool)
        print(f"{name}: {len(rows)} grasps, {len(lifted)} lifted, {holds.sum()} hold ({holds.mean():.3f} of lifted)")
        for column, sign in SIGNS.items():
            print(f"  {column:<15} {auc(sign * np.array([float(row[column]) for row in lifted]), holds):.3f}")
        foretold = np.array([float(row["foretold"]) for row in lifted])
        for floor in FLOORS:
            kept = foretold < floor
            share = holds[kept].mean() if kept.any() else float("nan")
            print(f"  foretold < {floor:4}: {kept.mean():.2f} kept, {share:.3f} of them hold")
        for hand in dict.fromkeys(row["hand"] for row in lifted):
            chosen = np.array([row["hand"] == hand for row in lifted])
            print(f"  {hand:<12} {chosen.sum():>3} lifted, {holds[chosen].mean():.2f} hold")


def main() -> None:
    """Runs what is asked for and prints the tables."""
    out = Path(sys.argv[1])
    if jobs := [job.rsplit(":", 2) for job in sys.argv[2:]]:
        out.parent.mkdir(parents=True, exist_ok=True)
        writer = None
        with out.open("w", newline="") as file:
            for hand, model, count in ((hand, model, int(count)) for hand, model, count in jobs):
                for row in rows_of(hand, model, count):
                    if writer is None:
                        writer = csv.DictWriter(file, list(row), lineterminator="\n")
                        writer.writeheader()
                    writer.writerow(row)
                    file.flush()
    with out.open() as file:
        summarize(list(csv.DictReader(file)))


if __name__ == "__main__":
    main()
