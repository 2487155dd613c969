"""How often does a squeeze by targets within the joint limits lift where that by torques does?

python studies/lifts/clipped.py FILE.parquet ... lifts grasps of files that the library wrote under its first protocol,
by `q_squeeze` alone where it was cut at a limit, and prints the verdicts beside the stored ones of `tau_squeeze`.
"""

import sys
from collections import Counter
from dataclasses import replace

import numpy as np

from xdex_drake.dataset.files import load_grasps
from xdex_drake.simulation.drake import lift
from xdex_drake.simulation.protocol import LIFT


def main(files: list[str]) -> None:
    """Prints the verdicts of each hand."""
    counts: Counter[tuple[str, str]] = Counter()
    for item in (item for path in files for item in load_grasps(path)):
        grasp, kp = item.grasp, LIFT.plant.kp
        if grasp.lift is None or grasp.q_squeeze is None or grasp.tau_squeeze is None:
            continue
        counts[item.hand.name, "grasps"] += 1
        clipped = kp * (grasp.q_squeeze - grasp.q)
        if np.allclose(clipped, grasp.tau_squeeze, atol=1e-9):
            continue
        verdict = lift(replace(grasp, tau_squeeze=clipped), item.hand, item.scene)
        counts[item.hand.name, "cut"] += 1
        counts[
            item.hand.name, f"{'lifts' if grasp.lift.success else 'fails'}, cut {verdict.failure_reason or 'lifts'}"
        ] += 1
    for name in dict.fromkeys(hand for hand, _ in counts):
        print(name, ", ".join(f"{what}: {n}" for (hand, what), n in counts.items() if hand == name))


if __name__ == "__main__":
    main(sys.argv[1:])
