"""What a model's draws become, stage by stage; nothing is chosen. Times are of the processor, lifts left out.

`one start` polishes each draw as it is, and after a descent; `refined` adds eight jittered starts, some with other
fingers, all in one batch; `raw` is inverse kinematics and the squeeze rule.

The shipped results: python studies/predictions/run.py studies/predictions/results.csv --count 8 --objects can,bottle
"""

import argparse
import csv
import os
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from xdex_drake.grasping.finish import finish
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.library import load_hand
from xdex_drake.learning.proposer import ModelProposer, default_checkpoint
from xdex_drake.programs.retargeting import RETRY
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene
from xdex_drake.simulation.drake import shared_rig, simulate_lift
from xdex_drake.simulation.protocol import LIFT

HANDS = ("allegro", "ability", "shadow", "inspire", "schunk_svh")
COLUMNS = ("stage", "hand", "object", "drawn", "certified", "lifted", "rejected", "failed", "processor_seconds_a_draw")


def main() -> None:
    """Predicts, lifts, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=16)
    parser.add_argument("--objects", default="can,bottle,mug")
    parser.add_argument("--hands", default=",".join(HANDS))
    parser.add_argument("--stages", default="one start,refined,raw")
    parser.add_argument("--model", default=str(default_checkpoint()))
    args = parser.parse_args()
    stages = {
        "one start": ModelProposer(args.model, retry=replace(RETRY, starts=0)),
        "refined": ModelProposer(args.model),
        "raw": ModelProposer(args.model, stage="raw"),
    }
    with args.out.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for thing in args.objects.split(","):
            scene = make_scene(load_object(thing))
            for name in args.hands.split(","):
                hand = load_hand(name)
                rig = shared_rig(hand, scene, protocol=LIFT)
                for stage in args.stages.split(","):
                    tally, seconds, begin = Tally(), 0.0, time.process_time()
                    for candidate in stages[stage](hand, scene, args.count, 0):
                        outcome = finish(candidate)
                        seconds += time.process_time() - begin
                        if outcome.grasp is not None:
                            outcome = replace(
                                outcome, grasp=replace(outcome.grasp, lift=simulate_lift(rig, outcome.grasp))
                            )
                        tally.add(outcome)
                        begin = time.process_time()
                    row = tally.row() if stage != "raw" else (tally.tried, "-", *tally.row()[2:])
                    writer.writerow((stage, name, thing, *row, f"{seconds / args.count:.3f}"))
                    stream.flush()


if __name__ == "__main__":
    main()
