"""Contact settings on real hands: what a lift shows at other time steps and stiffnesses.

For each hand, certified grasps of a can and a box are lifted with the library's settings, with half the time step, and
with other contact stiffnesses. A row a lift: verdict, normal force measured over promised, motion in the hand while
held.

Run `python studies/lifts/run.py --hands allegro --out studies/lifts/results.csv`; rows are appended. The table of
`docs/contact_settings.md` is `python studies/lifts/run.py --summarize studies/lifts/results.csv`.
"""

import argparse
import csv
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pydrake.systems.framework import Context

    from xdex_drake.grasp import Grasp, Lift
    from xdex_drake.simulation.drake import LiftRig

SETTINGS = {
    "ours": {},
    "half step": {"time_step": 0.0025},
    "stiffness 1e4": {"point_stiffness": 1e4},
    "stiffness 1e6": {"point_stiffness": 1e6},
}
COLUMNS = ("hand", "object", "grasp", "setting", "success", "reason", "rise_m", "force_ratio", "creep_mm", "seconds")


def lift_with_gauges(rig: "LiftRig", grasp: "Grasp") -> "tuple[Lift, float, float, float]":
    """Verdict, sum of normal forces measured over promised, motion in the hand while held [mm], CPU [s]."""
    from pydrake.systems.framework import EventStatus

    from xdex_drake.simulation.drake import simulate_lift

    scene_plant, protocol = rig.scene_plant, rig.protocol
    plant = scene_plant.plant
    begin = protocol.close_s + protocol.squeeze_s + protocol.rise_s
    seen = []

    def monitor(root: "Context") -> EventStatus:
        if root.get_time() >= begin:
            context = plant.GetMyContextFromRoot(root)
            wrist = plant.EvalBodyPoseInWorld(context, scene_plant.links[0])
            seen.append(wrist.inverse() @ plant.EvalBodyPoseInWorld(context, scene_plant.object_body).translation())
        return EventStatus.DidNothing()

    rig.simulator.set_monitor(monitor)
    start = time.process_time()
    lift = simulate_lift(rig, grasp)
    seconds = time.process_time() - start
    rig.simulator.clear_monitor()
    if not lift.success:
        return lift, float("nan"), float("nan"), seconds
    context = plant.GetMyContextFromRoot(rig.simulator.get_context())
    results = plant.get_contact_results_output_port().Eval(context)
    infos = [results.point_pair_contact_info(k) for k in range(results.num_point_pair_contacts())]
    links, body = {link.index() for link in scene_plant.links}, scene_plant.object_body.index()
    normal = sum(
        abs(info.contact_force() @ info.point_pair().nhat_BA_W)
        for info in infos
        if body in (info.bodyA_index(), info.bodyB_index()) and {info.bodyA_index(), info.bodyB_index()} & links
    )
    promised = sum(contact.f_C[2] for contact in grasp.certificate.contacts)
    return lift, normal / promised, 1e3 * float(np.linalg.norm(seen[-1] - seen[0])), seconds


def run(hands: list[str], objects: list[str], count: int, out: Path) -> None:
    """Lifts at every setting and appends a row for each."""
    from xdex_drake.grasping.synthesis import certified_grasps
    from xdex_drake.hand.library import load_hand
    from xdex_drake.scene.object import load_object
    from xdex_drake.scene.tabletop import make_scene
    from xdex_drake.simulation.drake import lift_rig
    from xdex_drake.simulation.protocol import LIFT

    new = not out.exists()
    with out.open("a", newline="") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(COLUMNS)
        for name in hands:
            hand = load_hand(name)
            for thing in objects:
                scene = make_scene(load_object(thing))
                grasps = []
                for grasp in certified_grasps(hand, scene, seed=0, time_limit_s=60.0):
                    grasps.append(grasp)
                    if len(grasps) == count:
                        break
                for setting, change in SETTINGS.items():
                    rig = lift_rig(hand, scene, protocol=replace(LIFT, plant=replace(LIFT.plant, **change)))
                    for k, grasp in enumerate(grasps if setting in ("ours", "half step") else grasps[:10]):
                        lift, ratio, creep, seconds = lift_with_gauges(rig, grasp)
                        row = (name, thing, k, setting, int(lift.success), lift.failure_reason)
                        writer.writerow(
                            (*row, f"{lift.lift_height_m:.5f}", f"{ratio:.4f}", f"{creep:.4f}", f"{seconds:.3f}")
                        )
                    file.flush()


def summarize(path: Path) -> None:
    """Prints the table of the docs."""
    rows = list(csv.DictReader(path.open()))
    groups = defaultdict(list)
    verdict = {}
    for row in rows:
        groups[row["hand"], row["setting"]].append(row)
        verdict[row["hand"], row["object"], row["grasp"], row["setting"]] = row["success"]
    header = "hand | setting | lifts | success | verdict as ours | force measured / promised | motion [mm] | CPU [s]"
    print(f"| {header} |")
    print("|---|---|---|---|---|---|---|---|")
    for (hand, setting), members in groups.items():
        pairs = [(r["success"], verdict.get((hand, r["object"], r["grasp"], "ours"))) for r in members]
        good = [r for r in members if r["success"] == "1"]
        ratio = np.array([float(r["force_ratio"]) for r in good] or [np.nan])
        creep = np.array([float(r["creep_mm"]) for r in good] or [np.nan])
        print(
            f"| {hand} | {setting} | {len(members)} | {len(good) / len(members):.0%} "
            f"| {np.mean([a == b for a, b in pairs]):.1%} "
            f"| {np.median(ratio):.2f} ({np.percentile(ratio, 10):.2f} to {np.percentile(ratio, 90):.2f}) "
            f"| {np.median(creep):.2f} (p90 {np.percentile(creep, 90):.2f}) "
            f"| {np.mean([float(r['seconds']) for r in members]):.2f} |"
        )
    half = [k for k in verdict if k[3] == "half step"]
    changed = sum(verdict[k] != verdict[*k[:3], "ours"] for k in half)
    print(f"\nHalving the time step changes {changed} of {len(half)} verdicts ({changed / len(half):.1%}).")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hands", nargs="+", default=["allegro", "shadow", "ability", "inspire", "schunk_svh"])
    parser.add_argument("--objects", nargs="+", default=["can", "box"])
    parser.add_argument("--count", type=int, default=32)
    parser.add_argument("--out", type=Path, default=Path("studies/lifts/results.csv"))
    parser.add_argument("--summarize", type=Path)
    options = parser.parse_args()
    if options.summarize:
        summarize(options.summarize)
    else:
        run(options.hands, options.objects, options.count, options.out)
