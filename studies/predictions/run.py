"""What the shipped model's draws become: refined, certified, lifted; nothing is chosen.

python studies/predictions/run.py studies/predictions/results.csv [--count 16] [--objects can,bottle,mug]
"""

import argparse
import csv
from pathlib import Path

from xdex_drake.grasping.tally import Tally
from xdex_drake.jobs.grasps import propose_batches
from xdex_drake.learning.proposer import ModelProposer, default_checkpoint
from xdex_drake.scene.facts import SceneFacts
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene

HANDS = ("allegro", "ability", "shadow", "inspire", "schunk_svh")
COLUMNS = ("hand", "object", "drawn", "certified", "lifted", "rejected", "failed", "seconds_a_draw")


def main() -> None:
    """Predicts, lifts, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=16)
    parser.add_argument("--objects", default="can,bottle,mug")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    rows = []
    for thing in args.objects.split(","):
        facts = SceneFacts.of(make_scene(load_object(thing)))
        tallies = {hand: Tally() for hand in HANDS}
        proposer = ModelProposer(str(default_checkpoint()))
        for unit, batch in propose_batches(proposer, HANDS, facts, count=args.count, workers=args.workers):
            tallies[unit.hand].merge(batch.tally)
        rows += [(hand, thing, *t.row(), f"{t.seconds / max(1, t.tried):.3f}") for hand, t in tallies.items()]
    with args.out.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(rows)


if __name__ == "__main__":
    main()
