"""Do physical facts bear out the reason that a failed lift names? Read from trajectories, without contacts or forces.

`reasons.py` reads the library's own contacts. This study reads none: it records where each link and the object are at
every step, and afterwards measures, with points sampled on the object's mesh and the hand's shapes from its description
file, how deep they reach into each other and how the object moves. A failed lift is then put into one of five classes,
each by a fact that needs none of the library's thresholds:

- it has no trajectory: the hand's shapes hold a point of the mesh at the start (`pregrasp_in_contact`) or, where they
  do not, reach below the table's top (`table_collision`);
- a link reaches below the table's top until the squeeze is over: `table_collision`;
- no sample of the mesh is inside of a link in the last 25 ms before the rise: `not_grasped`;
- the object falls more than 20 mm behind the wrist, or moves against it by more than 5 mm in the last 50 ms: `slipped`;
  else the hand carries it, and what is missing are fingertips: `too_few_fingertips`.

Run `python studies/lifts/facts.py --out studies/lifts/facts.csv`, some minutes of one core; `--summarize FILE` prints
the table.
"""

import argparse
import csv
from collections import Counter
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from reasons import spoiled

if TYPE_CHECKING:
    from pydrake.systems.framework import Context

    from xdex_drake.arrays import Array
    from xdex_drake.grasp import Grasp
    from xdex_drake.hand.description import Hand
    from xdex_drake.simulation.drake import LiftRig

COLUMNS = ("hand", "object", "grasp", "spoiled_by", "named", "fact", "agree", "deepest_mm", "lowest_mm", "behind_mm")
POINTS = 200_000
"""Samples of the mesh: 0.4 mm apart on a can, where a fingertip that presses with 1 N makes a dent of 1 mm."""


def lowest_point(hand: "Hand", X_WLs: list) -> float:
    """Height of the lowest point of the hand's shapes [m], from their own supports."""
    from xdex_drake.hand.description import Box, Capsule, Sphere

    lowest = np.inf
    for link, X_WL in zip(hand.links, X_WLs, strict=True):
        up_L, height = X_WL.rotation().matrix()[2], X_WL.translation()[2]
        for shape in link.geometry:
            if isinstance(shape, Sphere):
                low = shape.center @ up_L - shape.radius
            elif isinstance(shape, Capsule):
                low = min(shape.p0 @ up_L, shape.p1 @ up_L) - shape.radius
            elif isinstance(shape, Box):
                low = shape.p_LG @ up_L - 0.5 * np.abs(up_L @ shape.R_LG) @ shape.size
            else:
                low = (shape.vertices @ up_L).min()
            lowest = min(lowest, height + low)
    return float(lowest)


def deepest(hand: "Hand", X_WLs: list, points_W: "Array") -> float:
    """Greatest depth of points in the hand's shapes [m], 0 where none is inside."""
    from xdex_drake.contact.penetration import penetration_depth

    R_WLs = np.array([X.rotation().matrix() for X in X_WLs])
    p_WLs = np.array([X.translation() for X in X_WLs])
    return float(penetration_depth(hand, R_WLs, p_WLs, points_W))


def read_fact(rig: "LiftRig", grasp: "Grasp") -> "tuple[str, str, float, float, float]":
    """Named reason, class by facts, depth in the squeeze, lowest point until then, fall behind the wrist [mm]."""
    from pydrake.math import RigidTransform, RotationMatrix
    from pydrake.systems.framework import EventStatus

    from xdex_drake.hand.kinematics import Configuration
    from xdex_drake.scene.distance import sample_surface
    from xdex_drake.simulation.drake import simulate_lift

    scene_plant, protocol, hand = rig.scene_plant, rig.protocol, rig.scene_plant.hand
    assert scene_plant.object_body is not None and scene_plant.scene is not None
    assert grasp.X_WH_pregrasp is not None and grasp.q_pregrasp is not None
    plant, body, model = scene_plant.plant, scene_plant.object_body, scene_plant.scene.object
    times, object_poses, link_poses = [], [], []

    def record(root: "Context") -> EventStatus:
        context = plant.GetMyContextFromRoot(root)
        times.append(root.get_time())
        object_poses.append(plant.EvalBodyPoseInWorld(context, body))
        link_poses.append([plant.EvalBodyPoseInWorld(context, link) for link in scene_plant.links])
        return EventStatus.DidNothing()

    rig.simulator.set_monitor(record)
    verdict = simulate_lift(rig, grasp)
    rig.simulator.clear_monitor()
    if verdict.success:
        return "", "", 0.0, 0.0, 0.0
    named = verdict.failure_reason
    points_O = sample_surface(*model.surface, POINTS, 1)[0]
    if not times:
        k = Configuration.at(hand, grasp.X_WH_pregrasp, grasp.q_pregrasp)
        poses = [
            RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), p) for R, p in zip(k.R_WLs, k.p_WLs, strict=True)
        ]
        depth, low = deepest(hand, poses, (grasp.X_WO @ points_O.T).T), lowest_point(hand, poses)
        fact = "pregrasp_in_contact" if depth > 0.0 else "table_collision" if low < 0.0 else "unknown"
        return named, fact, 1e3 * depth, 1e3 * low, 0.0
    clock = np.array(times)
    squeezed = protocol.close_s + protocol.squeeze_s
    early = np.flatnonzero(clock <= squeezed + 1e-9)
    low = min(lowest_point(hand, link_poses[k]) for k in early[::2])
    near = [k for k in early if clock[k] >= squeezed - 0.025]
    depth = max(deepest(hand, link_poses[k], (object_poses[k] @ points_O.T).T) for k in near)
    center = np.array([X @ model.p_OOcm for X in object_poses])
    wrist = np.array([links[0].translation() for links in link_poses])
    behind = float((wrist[-1] - wrist[early[-1]] - center[-1] + center[early[-1]])[2])
    late = clock >= clock[-1] - 0.05
    drift = np.ptp((center - wrist)[late], axis=0).max()
    if low < 0.0:
        fact = "table_collision"
    elif depth == 0.0:
        fact = "not_grasped"
    elif behind > 0.02 or drift > 0.005:
        fact = "slipped"
    else:
        fact = "too_few_fingertips"
    return named, fact, 1e3 * depth, 1e3 * low, 1e3 * behind


def run(hands: list[str], objects: list[str], count: int, out: Path) -> None:
    """Spoils and lifts until there are `count` failures, evenly over hands and objects."""
    from xdex_drake.grasping.synthesis import certified_grasps
    from xdex_drake.hand.library import load_hand
    from xdex_drake.scene.object import load_object
    from xdex_drake.scene.tabletop import make_scene
    from xdex_drake.simulation.drake import shared_rig

    rng, share = np.random.default_rng(1), -(-count // (len(hands) * len(objects)))
    with out.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for name in hands:
            hand = load_hand(name)
            for thing in objects:
                scene, failed = make_scene(load_object(thing)), 0
                for k, grasp in enumerate(islice(certified_grasps(hand, scene, seed=1), 40)):
                    for what, bad, where, protocol in spoiled(grasp, scene, hand, rng):
                        if failed == share:
                            break
                        named, fact, *numbers = read_fact(shared_rig(hand, where, protocol=protocol), bad)
                        if named:
                            failed += 1
                            row = (name, thing, k, what, named, fact, int(named == fact))
                            writer.writerow((*row, *(f"{number:.3f}" for number in numbers)))
                            file.flush()
                    if failed == share:
                        break


def summarize(path: Path) -> None:
    """Prints how often the named reason is borne out."""
    rows = list(csv.DictReader(path.open()))
    agree = sum(row["agree"] == "1" for row in rows)
    print(f"{agree} of {len(rows)} failed lifts name the reason that physical facts show ({agree / len(rows):.1%}).\n")
    print("| named | by facts | lifts |\n|---|---|---|")
    for (named, fact), n in sorted(Counter((row["named"], row["fact"]) for row in rows).items()):
        print(f"| {named} | {fact} | {n} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hands", nargs="+", default=["allegro", "shadow"])
    parser.add_argument("--objects", nargs="+", default=["can", "box"])
    parser.add_argument("--count", type=int, default=120)
    parser.add_argument("--out", type=Path, default=Path("studies/lifts/facts.csv"))
    parser.add_argument("--summarize", type=Path)
    options = parser.parse_args()
    if not options.summarize:
        run(options.hands, options.objects, options.count, options.out)
    summarize(options.summarize or options.out)
