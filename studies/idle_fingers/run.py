"""What resting idle fingers near the object changes: gaps of fingertips, and verdicts of lifts, in pairs.

python studies/idle_fingers/run.py OUT.csv COUNT [HAND ...]; with OUT.csv alone it prints the table of the rows again.

Each candidate that is certified with idle fingers (some have none) is finished twice, with these fingers as the search
left them and at rest, and lifted twice. COUNT is the number of pairs of a hand and an object. Rows are appended, so
that a run that was stopped goes on.
"""

import csv
import sys
from collections.abc import Iterator
from itertools import count, islice
from pathlib import Path

import numpy as np

import xdex_drake as xd
from xdex_drake.grasping.finish import SEARCHED, finish_grasp, prepared
from xdex_drake.grasping.idle import idle_fingers
from xdex_drake.grasping.passive import holding_squeeze
from xdex_drake.grasping.synthesis import SynthesisSettings, batch_seed
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.force_closure import program_of_candidate
from xdex_drake.programs.search import search
from xdex_drake.programs.solve import solve
from xdex_drake.simulation.drake import lift_rig, simulate_lift
from xdex_drake.simulation.protocol import LIFT

OBJECTS = ("can", "box", "mug", "ball", "bottle", "s0-0003", "s0-0011", "s0-0027")
COLUMNS = (
    "hand",
    "object",
    "candidate",
    "gaps_mm",
    "gaps_rested_mm",
    "lifts",
    "lifts_rested",
    "reason",
    "reason_rested",
)


def pairs(hand: xd.Hand, scene: xd.Scene) -> Iterator[tuple[str, xd.Grasp, xd.Grasp]]:
    """Certified grasps with idle fingers: number of the candidate, as the search left them, and at rest."""
    settings = SynthesisSettings()
    for batch in count():
        found = search(hand, scene, count=settings.batch, seed=batch_seed(0, batch), settings=settings.search)
        for row in range(len(found.energy) // 2):
            program = program_of_candidate(hand, scene, found, row, settings=settings.polish)
            result = solve(program, solver=settings.solver, improvement=np.inf)
            if not result.success:
                continue
            rested = finish_grasp(hand, result.point, demands=SEARCHED).grasp
            if rested is None or not idle_fingers(hand, [c.link for c in rested.certificate.contacts]):
                continue
            k = result.point.k
            holding = holding_squeeze(hand, k, scene, rested.certificate, kp=LIFT.plant.kp)
            plain = prepared(hand, scene, k, rested.certificate, holding, protocol=LIFT, demands=SEARCHED).grasp
            if plain is not None:
                yield f"{batch}-{row}", plain, rested


def gaps(hand: xd.Hand, scene: xd.Scene, grasp: xd.Grasp) -> np.ndarray:
    """Gaps of idle fingertips from the object [m]."""
    fingers = idle_fingers(hand, [c.link for c in grasp.certificate.contacts])
    links = np.array([hand.link_index[finger.tip_link] for finger in fingers])
    tips = Configuration.at(hand, grasp.X_WH, grasp.q).points(links, np.array([finger.p_LTip for finger in fingers]))
    return scene.object.exact.query((scene.X_WO.inverse() @ tips.T).T).distance


def run(out: Path, number: int, hands: list[str]) -> None:
    """Appends rows."""
    known = set()
    if out.exists():
        with out.open(newline="") as file:
            known = {(row["hand"], row["object"]) for row in csv.DictReader(file)}
    with out.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if not known:
            writer.writerow(COLUMNS)
        for thing in OBJECTS:
            scene = xd.make_scene(xd.load_object(thing))
            for name in hands:
                if (name, thing) in known:
                    continue
                hand = xd.load_hand(name)
                rig = lift_rig(hand, scene)
                for candidate, plain, rested in islice(pairs(hand, scene), number):
                    verdicts = [simulate_lift(rig, grasp) for grasp in (plain, rested)]
                    distances = [
                        " ".join(f"{1e3 * gap:.1f}" for gap in gaps(hand, scene, grasp)) for grasp in (plain, rested)
                    ]
                    row = [name, thing, candidate, *distances, *(int(v.success) for v in verdicts)]
                    writer.writerow((*row, *(v.failure_reason for v in verdicts)))
                file.flush()


def summarize(path: Path) -> None:
    """Prints gaps and verdicts of each hand, and of all."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for name in (*dict.fromkeys(row["hand"] for row in rows), "all"):
        some = [row for row in rows if name in (row["hand"], "all")]
        before, after = (
            np.array([float(gap) for row in some for gap in row[column].split()])
            for column in ("gaps_mm", "gaps_rested_mm")
        )
        lifts = np.array([(int(row["lifts"]), int(row["lifts_rested"])) for row in some])
        changed = lifts[:, 0] != lifts[:, 1]
        print(
            f"{name:<10} {len(some):>5} pairs  mean gap {before.mean():.1f} -> {after.mean():.1f} mm  lift "
            f"{lifts[:, 0].mean():.3f} -> {lifts[:, 1].mean():.3f}  verdicts changed {changed.sum()} "
            f"({100.0 * changed.mean():.2f} %), to lifted {(changed & (lifts[:, 1] == 1)).sum()}"
        )


if __name__ == "__main__":
    target = Path(sys.argv[1])
    if len(sys.argv) > 2:
        run(target, int(sys.argv[2]), sys.argv[3:] or list(xd.list_hands()))
    summarize(target)
