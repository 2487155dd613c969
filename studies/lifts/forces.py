"""How much more force than friction needs does a real hand need, and how fast does what it holds creep?

Least forces: those of the certificate's contacts with the least sum of normal forces that carry the object at the peak
of the rise, m (g + a) with a = 6 rise / duration^2 of the smooth ramp. Forces of factor k are the least ones for
friction mu / k, so that each contact presses k times as hard as its tangential force needs. The joints' squeeze targets
apply them through the Jacobian's transpose, and the hand lifts. `certificate` is the squeeze that the library chose.
Creep is the slope of the object's motion in the hand over the last 1.5 s of a hold that is 2 s longer.

Run `python studies/lifts/forces.py --out studies/lifts/forces.csv`; `--summarize FILE` prints the tables.
"""

import argparse
import csv
from collections import defaultdict
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pydrake.systems.framework import Context

    from xdex_drake.arrays import Array
    from xdex_drake.grasp import Grasp
    from xdex_drake.hand.description import Hand
    from xdex_drake.scene.tabletop import Scene
    from xdex_drake.simulation.drake import LiftRig

FACTORS = (0.7, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5)
COLUMNS = ("hand", "object", "grasp", "squeeze", "normal_n", "limited", "success", "reason", "creep_mm_s")
GRAVITY = 9.81


def least_forces(grasp: "Grasp", scene: "Scene", factor: float, load: float) -> "Array | None":
    """Contact forces in C [N], shape (k, 3), of the least sum of normal forces; None if there are none.

    Args:
        grasp: The grasp with its certificate's contacts.
        scene: The scene.
        factor: Factor of the normal forces over what friction needs.
        load: Upward force that the contacts shall apply [N].
    """
    import cvxpy as cp

    from xdex_drake.contact.held_object import HeldObject

    assert grasp.certificate is not None
    contacts = grasp.certificate.contacts
    p_OCs, n_OCs = np.array([c.p_OC for c in contacts]), np.array([c.n_OC for c in contacts])
    G = HeldObject.of(scene).grasp_map(p_OCs, n_OCs).G
    f = cp.Variable((len(contacts), 3))
    scale = np.array([1e2, 1e2, 1e2, 1.0, 1.0, 1.0])  # torques in N cm
    constraints: list = [(scale[:, None] * G) @ cp.vec(f, order="C") == np.array([0.0, 0.0, 0.0, 0.0, 0.0, load])]
    mu = scene.object.friction / factor
    constraints += [cp.SOC(mu * f[k, 2], f[k, :2]) for k in range(len(contacts))]
    cp.Problem(cp.Minimize(cp.sum(f[:, 2])), constraints).solve(solver="CLARABEL")
    return None if f.value is None else np.asarray(f.value)


def held(rig: "LiftRig", grasp: "Grasp") -> tuple[bool, str, float]:
    """Success, failure reason, creep while held [mm/s]; the rig holds 2 s longer than a lift."""
    from pydrake.systems.framework import EventStatus

    from xdex_drake.simulation.drake import simulate_lift

    scene_plant, protocol, seen = rig.scene_plant, rig.protocol, []
    body, scene = scene_plant.object_body, scene_plant.scene
    assert body is not None and scene is not None

    def monitor(root: "Context") -> EventStatus:
        if root.get_time() >= protocol.duration_s - 1.5:
            context = scene_plant.plant.GetMyContextFromRoot(root)
            X_HO = scene_plant.plant.EvalBodyPoseInWorld(context, scene_plant.links[0]).inverse() @ (
                scene_plant.plant.EvalBodyPoseInWorld(context, body)
            )
            seen.append((root.get_time(), *(X_HO @ scene.object.p_OOcm)))
        return EventStatus.DidNothing()

    rig.simulator.set_monitor(monitor)
    lift = simulate_lift(rig, grasp)
    rig.simulator.clear_monitor()
    if not lift.success:
        return False, lift.failure_reason, float("nan")
    track = np.array(seen)
    slope = np.polyfit(track[:, 0], track[:, 1:], 1)[0]
    return True, "", 1e3 * float(np.linalg.norm(slope))


def run(hands: list[str], objects: list[str], count: int, out: Path) -> None:
    """Lifts every grasp with every squeeze."""
    from xdex_drake.grasping.synthesis import certified_grasps
    from xdex_drake.hand.library import load_hand
    from xdex_drake.scene.object import load_object
    from xdex_drake.scene.tabletop import make_scene
    from xdex_drake.simulation.drake import lift_rig
    from xdex_drake.simulation.protocol import LIFT

    protocol = replace(LIFT, hold_s=LIFT.hold_s + 2.0)
    acceleration = 6.0 * protocol.rise_m / protocol.rise_s**2
    with out.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for name in hands:
            hand = load_hand(name)
            for thing in objects:
                scene = make_scene(load_object(thing))
                rig = lift_rig(hand, scene, protocol=protocol)
                load = scene.object.mass * (GRAVITY + acceleration)
                for k, grasp in enumerate(islice(certified_grasps(hand, scene, seed=0, time_limit_s=60.0), count)):
                    assert grasp.certificate is not None
                    normal = sum(c.f_C[2] for c in grasp.certificate.contacts)
                    success, reason, creep = held(rig, grasp)
                    writer.writerow(
                        (name, thing, k, "certificate", f"{normal:.3f}", 0, int(success), reason, f"{creep:.4f}")
                    )
                    for factor in FACTORS:
                        forces = least_forces(grasp, scene, factor, load)
                        if forces is None:
                            continue
                        squeezed, limited = squeeze(hand, scene, grasp, forces, protocol.plant.kp)
                        success, reason, creep = held(rig, squeezed)
                        row = (name, thing, k, factor, f"{forces[:, 2].sum():.3f}", int(limited), int(success), reason)
                        writer.writerow((*row, f"{creep:.4f}"))
                    file.flush()


def squeeze(hand: "Hand", scene: "Scene", grasp: "Grasp", forces: "Array", kp: float) -> "tuple[Grasp, bool]":
    """The grasp with squeeze targets for other forces, and whether a joint's effort limits them."""
    from xdex_drake.grasping.squeeze import contact_torques, squeezed
    from xdex_drake.hand.kinematics import Configuration

    certificate = grasp.certificate
    assert certificate is not None
    contacts = tuple(replace(c, f_C=f) for c, f in zip(certificate.contacts, forces, strict=True))
    promise = replace(certificate, contacts=contacts)
    other = replace(grasp, certificate=promise)
    torques = contact_torques(hand, Configuration.at(hand, grasp.X_WH, grasp.q), scene, promise)
    limited = bool(np.any(np.abs(torques) > hand.effort))
    return squeezed(hand, other, torques, kp), limited


def summarize(path: Path) -> None:
    """Prints, for each hand and squeeze, how many lifts hold, and the creep."""
    groups = defaultdict(list)
    for row in csv.DictReader(path.open()):
        groups[row["hand"], row["squeeze"]].append(row)
    print("| hand | squeeze | sum of normal forces [N] | lifts | hold | creep [mm/s] |\n|---|---|---|---|---|---|")
    for (hand, squeeze_), rows in groups.items():
        creep = np.array([float(row["creep_mm_s"]) for row in rows if row["success"] == "1"] or [np.nan])
        normal = np.median([float(row["normal_n"]) for row in rows])
        good = sum(row["success"] == "1" for row in rows)
        spread = f"{np.median(creep):.3f} (p90 {np.percentile(creep, 90):.3f})"
        print(f"| {hand} | {squeeze_} | {normal:.2f} | {len(rows)} | {good / len(rows):.0%} | {spread} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hands", nargs="+", default=["allegro", "inspire"])
    parser.add_argument("--objects", nargs="+", default=["can", "box"])
    parser.add_argument("--count", type=int, default=8)
    parser.add_argument("--out", type=Path, default=Path("studies/lifts/forces.csv"))
    parser.add_argument("--summarize", type=Path)
    options = parser.parse_args()
    if not options.summarize:
        run(options.hands, options.objects, options.count, options.out)
    summarize(options.summarize or options.out)
