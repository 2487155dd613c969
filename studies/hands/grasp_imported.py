"""Grasps by hands as their files have them, with no step in between; one line of CSV a hand and object.

    python studies/hands/grasp_imported.py OUT.csv OBJECT[,OBJECT...] HAND_FILE...

`imported.csv`: the right hands' vendor files with can,box,ball; then, with can alone, allegro_left_hand.urdf of the
package example-robot-data 6.0.0 and `xdex hand mirror shadow --out shadow_left.yaml`. One process, as `xdex grasp
--count 2 --workers 1 --seed 0 --time-limit 120` works; a line that exists is passed over.
"""

import argparse
import csv
from pathlib import Path

from xdex_drake.errors import XdexError
from xdex_drake.grasping.tally import Tally
from xdex_drake.jobs.grasps import GraspRequest, synthesize_batches
from xdex_drake.scene.facts import SceneFacts
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene

COLUMNS = ("hand", "object", "tried", "certified", "lifted", "seconds", "says")


def row(hand: str, thing: str, count: int) -> dict[str, object]:
    """What became of one hand and object."""
    tally, says = Tally(), ""
    try:
        request = GraspRequest(hand, SceneFacts.of(make_scene(load_object(thing))))
        for _ in synthesize_batches(request, count=count, workers=1, tally=tally):
            pass
    except XdexError as error:
        says = str(error)
    numbers = (tally.tried, tally.certified, tally.lifted, f"{tally.seconds:.1f}", says)
    return dict(zip(COLUMNS, (Path(hand).stem, thing, *numbers), strict=True))


def main() -> None:
    """Runs what is missing and appends it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("objects")
    parser.add_argument("hands", nargs="+")
    parser.add_argument("--count", type=int, default=2, help="lifted grasps wanted")
    args = parser.parse_args()
    done = set()
    if args.out.exists():
        done = {(line["hand"], line["object"]) for line in csv.DictReader(args.out.open(encoding="utf-8"))}
    for hand in args.hands:
        for thing in args.objects.split(","):
            if (Path(hand).stem, thing) in done:
                continue
            fresh = not args.out.exists()
            made = row(hand, thing, args.count)
            with args.out.open("a", newline="", encoding="utf-8") as stream:
                writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
                if fresh:
                    writer.writeheader()
                writer.writerow(made)


if __name__ == "__main__":
    main()
