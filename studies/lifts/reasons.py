"""Does a failed lift name the true reason? A second, independent reading of 200 failed lifts.

Certified grasps are spoiled: less friction, more mass, a shifted wrist, fingers that do not squeeze or stay open. Each
lift is recorded at every step: how high object and hand are, which links press on what and how hard. From this record
alone, without the verdict and the few looks that the library takes, a rule written here tells what went wrong:

- the hand's surface holds a point of the object's mesh at the start: `pregrasp_in_contact`;
- a link presses on the table while the hand closes or squeezes: `table_collision`;
- in the last 25 ms before the rise no link presses on the object: `not_grasped`;
- the object ends less than 0.2 m above its start: `slipped`;
- fewer than two fingers press on it in the last step: `too_few_fingertips`.

Run `python studies/lifts/reasons.py --out studies/lifts/reasons.csv`, three minutes of one core; `--summarize FILE`
prints the table.
"""

import argparse
import csv
from collections import Counter
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pydrake.systems.framework import Context

    from xdex_drake.grasp import Grasp
    from xdex_drake.hand.description import Hand
    from xdex_drake.scene.tabletop import Scene
    from xdex_drake.simulation.drake import LiftRig
    from xdex_drake.simulation.protocol import LiftProtocol

COLUMNS = ("hand", "object", "grasp", "spoiled_by", "named", "read", "agree", "rise_m", "peak_m")
LAST_S = 0.025


def read_reason(rig: "LiftRig", grasp: "Grasp") -> tuple[str, str, float, float]:
    """The reason that the library names, the reason by the record, final and greatest rise of the object [m]."""
    from pydrake.systems.framework import EventStatus

    from xdex_drake.contact.penetration import penetration_depth
    from xdex_drake.hand.kinematics import Configuration
    from xdex_drake.scene.distance import sample_surface
    from xdex_drake.simulation.drake import simulate_lift

    scene_plant, protocol, hand = rig.scene_plant, rig.protocol, rig.scene_plant.hand
    plant, model = scene_plant.plant, scene_plant.scene.object
    link_of = {int(body.index()): k for k, body in enumerate(scene_plant.links)}
    thing, world = int(scene_plant.object_body.index()), int(plant.world_body().index())
    times, heights, on_object, on_table = [], [], [], []

    def record(root: "Context") -> EventStatus:
        context = plant.GetMyContextFromRoot(root)
        X_WO = plant.EvalBodyPoseInWorld(context, scene_plant.object_body)
        results = plant.get_contact_results_output_port().Eval(context)
        touched, table = set(), set()
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            pair = {int(info.bodyA_index()), int(info.bodyB_index())}
            if np.linalg.norm(info.contact_force()) > 1e-6:
                links = {link_of[b] for b in pair if b in link_of}
                touched |= links if thing in pair else set()
                table |= links if world in pair else set()
        times.append(root.get_time())
        heights.append(float((X_WO @ model.p_OOcm)[2]))
        on_object.append(touched)
        on_table.append(table)
        return EventStatus.DidNothing()

    rig.simulator.set_monitor(record)
    verdict = simulate_lift(rig, grasp)
    rig.simulator.clear_monitor()
    if verdict.success:
        return "", "", verdict.lift_height_m, verdict.lift_height_m

    k = Configuration.at(hand, grasp.X_WH_pregrasp, grasp.q_pregrasp)
    points = sample_surface(*model.surface, 20_000, 1)[0]
    if penetration_depth(hand, k.R_WLs, k.p_WLs, (grasp.X_WO @ points.T).T) > 0.0:
        return verdict.failure_reason, "pregrasp_in_contact", 0.0, 0.0
    squeezed = protocol.close_s + protocol.squeeze_s
    if not times:  # The lift was not begun, and the object is clear: the hand must stand in the table.
        lowest = (k.points(hand.sphere_links, hand.spheres[:, :3])[:, 2] - hand.spheres[:, 3]).min()
        return verdict.failure_reason, "table_collision" if lowest < 2e-3 else "unknown", 0.0, 0.0
    clock, rise = np.array(times), np.array(heights) - heights[0]
    before = clock <= squeezed + 1e-9
    if any(table for table, early in zip(on_table, before, strict=True) if early):
        reason = "table_collision"
    elif not any(on_object[i] for i in np.flatnonzero(before & (clock >= squeezed - LAST_S))):
        reason = "not_grasped"
    elif rise[-1] < 0.2:
        reason = "slipped"
    else:
        tips = [finger for finger in hand.fingers if hand.link_index[finger.tip_link] in on_object[-1]]
        reason = "too_few_fingertips" if len(tips) < 2 else "unknown"
    return verdict.failure_reason, reason, float(rise[-1]), float(rise.max())


def spoiled(
    grasp: "Grasp", scene: "Scene", hand: "Hand", rng: np.random.Generator
) -> "Iterator[tuple[str, Grasp, Scene, LiftProtocol]]":
    """The grasp, spoiled in several ways."""
    from pydrake.math import RigidTransform

    from xdex_drake.simulation.protocol import LIFT, with_physics

    model = scene.object
    slip = float(rng.uniform(0.1, 0.4))
    slippery = replace(LIFT, plant=replace(LIFT.plant, friction=slip * LIFT.plant.friction))
    yield "friction", grasp, with_physics(scene, mass=model.mass, friction=slip * model.friction), slippery
    heavy = with_physics(scene, mass=float(rng.uniform(3.0, 15.0)) * model.mass, friction=model.friction)
    yield "mass", grasp, heavy, LIFT
    for size in (0.03, 0.08):
        shift = RigidTransform(rng.normal(size=3) * size / np.sqrt(3.0))
        moved = replace(grasp, X_WH=shift @ grasp.X_WH, X_WH_pregrasp=shift @ grasp.X_WH_pregrasp)
        yield f"shift {1e3 * size:.0f} mm", moved, scene, LIFT
    yield "no squeeze", replace(grasp, tau_squeeze=np.full_like(grasp.q, -0.05 * LIFT.plant.kp)), scene, LIFT
    low = RigidTransform([0.0, 0.0, -float(rng.uniform(0.01, 0.06))])
    yield "low", replace(grasp, X_WH=low @ grasp.X_WH), scene, LIFT
    keep = hand.fingers[int(rng.integers(len(hand.fingers)))]
    own = np.array([name in {j.name for j in _finger_joints(hand, keep.links)} for name in hand.joint_names])
    q, tau = np.where(own, grasp.q, grasp.q_pregrasp), np.where(own, grasp.tau_squeeze, 0.0)
    yield "one finger", replace(grasp, q=q, tau_squeeze=tau), scene, LIFT


def _finger_joints(hand: "Hand", links: tuple[str, ...]) -> list:
    return [joint for joint in hand.joints if joint.child in links]


def run(hands: list[str], objects: list[str], count: int, out: Path) -> None:
    """Spoils and lifts until there are `count` failures, evenly over hands and objects."""
    from xdex_drake.grasping.synthesis import certified_grasps
    from xdex_drake.hand.library import load_hand
    from xdex_drake.scene.object import load_object
    from xdex_drake.scene.tabletop import make_scene
    from xdex_drake.simulation.drake import shared_rig

    rng, share, rows = np.random.default_rng(0), -(-count // (len(hands) * len(objects))), []
    for name in hands:
        hand = load_hand(name)
        for thing in objects:
            scene, failed = make_scene(load_object(thing)), 0
            for k, grasp in enumerate(islice(certified_grasps(hand, scene, seed=0), 40)):
                for what, bad, where, protocol in spoiled(grasp, scene, hand, rng):
                    if failed == share:
                        break
                    named, read, rise, peak = read_reason(shared_rig(hand, where, protocol=protocol), bad)
                    if named:
                        failed += 1
                        rows.append(
                            (name, thing, k, what, named, read, int(named == read), f"{rise:.4f}", f"{peak:.4f}")
                        )
                if failed == share:
                    break
    with out.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(rows)


def summarize(path: Path) -> None:
    """Prints how often the named reason is the one that was read."""
    rows = list(csv.DictReader(path.open()))
    agree = sum(row["agree"] == "1" for row in rows)
    print(f"{agree} of {len(rows)} failed lifts name the reason that the record shows ({agree / len(rows):.1%}).\n")
    print("| named | read | lifts | spoiled by |\n|---|---|---|---|")
    for (named, read), n in sorted(Counter((r["named"], r["read"]) for r in rows).items()):
        by = Counter(r["spoiled_by"] for r in rows if (r["named"], r["read"]) == (named, read))
        print(f"| {named} | {read} | {n} | {', '.join(f'{what} {k}' for what, k in by.most_common())} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hands", nargs="+", default=["allegro", "shadow"])
    parser.add_argument("--objects", nargs="+", default=["can", "box"])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("studies/lifts/reasons.csv"))
    parser.add_argument("--summarize", type=Path)
    options = parser.parse_args()
    if not options.summarize:
        run(options.hands, options.objects, options.count, options.out)
    summarize(options.summarize or options.out)
