"""How well do margins tell which grasps lift? The area under the ROC curve, and what a floor would keep.

python studies/margins/run.py OUT_FOLDER [POPULATION:HAND:OBJECT:COUNT ...]; with the folder alone it prints the tables
of OUT_FOLDER/results.csv again. README.md beside this file has the committed command.

Grasps come from two populations. *touching*: polished until they touch, clear and within limits, with no constraint on
forces, so that nothing that a certificate measures has chosen them; those that no forces hold have margins of 0 and are
squeezed by the rule for grasps without a certificate. *certified*: those of a search that asks for forces in the cones,
where margins have chosen already and so can tell less.

Every grasp is lifted twice: as it is, and hard, with 0.75 times the friction and twice the mass. Grasps squeeze with
the forces of their certificate in both, so that a hard lift asks for what the margins promise.
"""

import csv
import itertools
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import rankdata

import xdex_drake as xd
from xdex_drake.contact import certified_map, epsilon_linearized
from xdex_drake.grasping.finish import GIVEN, Demands, finish_grasp
from xdex_drake.grasping.pregrasp import pregrasp
from xdex_drake.grasping.squeeze import squeeze_by_rule
from xdex_drake.grasping.synthesis import SynthesisSettings, batch_seed, certified_grasps
from xdex_drake.programs.force_closure import PolishSettings, program_of_candidate, wrench_blocks
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.search import SearchSettings, search
from xdex_drake.programs.solve import solve
from xdex_drake.simulation.lift import lift, lift_rig, simulate_lift
from xdex_drake.simulation.protocol import LIFT, with_physics

MARGINS = ("task_margin", "ball_margin", "epsilon", "friction_left")
FLOORS = (0.0, 0.25, 0.5, 1.01, 2.0, 4.0)
FRICTION, MASS = 0.75, 2.0
ANY = Demands(squeezes=(*GIVEN.squeezes, (0.99, 0.1)))
"""Whatever forces there are."""


def certified(hand: xd.Hand, scene: xd.Scene) -> Iterator[xd.Grasp]:
    """Grasps of a search for forces in the cones."""
    return certified_grasps(hand, scene, seed=0, settings=SynthesisSettings(demands=GIVEN))


def touching(hand: xd.Hand, scene: xd.Scene) -> Iterator[xd.Grasp]:
    """Grasps that touch, whether forces hold the object or not, in random order."""
    settings = SearchSettings(survivors=1.0)
    for batch in itertools.count():
        found = search(hand, scene, count=64, seed=batch_seed(0, batch), settings=settings)
        for row in np.random.default_rng(batch).permutation(len(found.energy)):
            whole = program_of_candidate(hand, scene, found, int(row))
            forces = {block.name for block in wrench_blocks(whole.start, PolishSettings())}
            free = tuple(block for block in whole.constraints if block.name not in forces)
            result = solve(GraspProgram("touch", whole.start, tuple(whole.costs), free), improvement=np.inf)
            if not result.success:
                continue
            outcome = finish_grasp(hand, result.point, demands=ANY)
            if outcome.grasp is not None:
                yield outcome.grasp
            elif outcome.reason.startswith("certificate"):
                k = result.point.k
                opened = pregrasp(hand, scene, k.X_WH, k.q)
                bare = xd.Grasp(hand.name, scene.object.name, scene.X_WO, k.X_WH, np.clip(k.q, *hand.limits))
                bare = replace(bare, X_WH_pregrasp=opened.X_WH, q_pregrasp=opened.q)
                if opened.clearance >= 1e-3:
                    yield squeeze_by_rule(hand, bare, scene, LIFT.plant.kp)


POPULATIONS = {"touching": touching, "certified": certified}


def rows_of(population: str, hand_name: str, object_name: str, count: int) -> Iterator[dict]:
    """Margins and lifts of some grasps."""
    hand, scene = xd.load_hand(hand_name), xd.make_scene(xd.load_object(object_name))
    rig, model = lift_rig(hand, scene), scene.object
    hard_scene = with_physics(scene, mass=MASS * model.mass, friction=FRICTION * model.friction)
    hard = replace(LIFT, plant=replace(LIFT.plant, friction=FRICTION * LIFT.plant.friction))
    for grasp in itertools.islice(POPULATIONS[population](hand, scene), count):
        margins = dict.fromkeys(MARGINS, 0.0)
        if (proof := grasp.certificate) is not None:
            margins = {
                "task_margin": proof.task_margin,
                "ball_margin": proof.margin_lower,
                "epsilon": epsilon_linearized(certified_map(proof)),
                "friction_left": proof.friction_left,
            }
        verdicts = simulate_lift(rig, grasp), lift(grasp, hand, hard_scene, protocol=hard)
        row = {"population": population, "hand": hand_name, "object": Path(object_name).stem}
        row |= {"proof": int(proof is not None)} | {name: round(value, 5) for name, value in margins.items()}
        row |= {
            name: verdict.failure_reason or "lifted"
            for name, verdict in zip(("lift", "hard_lift"), verdicts, strict=True)
        }
        print(*row.values(), sep=",", flush=True)
        yield row


def auc(values: np.ndarray, success: np.ndarray) -> float:
    """Probability that a success has the greater value than a failure; ties count one half."""
    good, bad = int(success.sum()), int((~success).sum())
    if not good or not bad:
        return float("nan")
    return float((rankdata(values)[success].sum() - good * (good + 1) / 2) / (good * bad))


def summarize(table: list[dict]) -> dict:
    """Prints the tables of one population and returns their figures."""
    columns = {name: np.array([float(row[name]) for row in table]) for name in MARGINS}
    pairs = np.array([f"{row['hand']} {row['object']}" for row in table])
    summary: dict = {"grasps": len(table), "with_proof": sum(int(row["proof"]) for row in table)}
    for outcome in ("lift", "hard_lift"):
        success = np.array([row[outcome] == "lifted" for row in table])
        print(f"  {outcome}: {success.sum()} of {len(success)} lifted; area under the ROC curve")
        summary[outcome] = {"lifted": int(success.sum())}
        for name in MARGINS:
            summary[outcome][f"auc_{name}"] = round(auc(columns[name], success), 3)
            print(f"    {name:<13} {auc(columns[name], success):.3f}")
        for pair in dict.fromkeys(pairs):
            chosen = pairs == pair
            values = ", ".join(f"{name} {auc(columns[name][chosen], success[chosen]):.2f}" for name in MARGINS)
            print(f"    {pair:<26} {success[chosen].sum():>3} of {chosen.sum():<3} {values}")
        print("    floor on the task margin: kept, lifted of kept")
        summary[outcome]["floors"] = []
        for floor in FLOORS:
            kept = columns["task_margin"] >= floor
            share = float(success[kept].mean()) if kept.any() else float("nan")
            summary[outcome]["floors"].append({"floor": floor, "kept": int(kept.sum()), "lifted": round(share, 3)})
            print(f"      {floor:<5} {kept.sum():>4} {100 * share:5.1f} %")
    return summary


def main() -> None:
    """Runs what is asked for, and prints and writes the tables."""
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    jobs = [job.split(":") for job in sys.argv[2:]]
    if jobs:
        rows = [row for population, hand, model, count in jobs for row in rows_of(population, hand, model, int(count))]
        with (out / "results.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            writer.writerows(rows)
    with (out / "results.csv").open() as file:
        table = list(csv.DictReader(file))
    summary: dict = {"hard": {"friction": FRICTION, "mass": MASS}}
    for population in dict.fromkeys(row["population"] for row in table):
        chosen = [row for row in table if row["population"] == population]
        print(f"{population}: {len(chosen)} grasps, {sum(int(row['proof']) for row in chosen)} with a certificate")
        summary[population] = summarize(chosen)
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")


if __name__ == "__main__":
    main()
