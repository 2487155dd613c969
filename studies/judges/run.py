"""Two judges: the same grasps lifted in Drake and in MuJoCo, and what MuJoCo's settings do to its verdicts.

Grasps are chosen by their certificate alone. `make` searches for them, a file for each hand and mesh; `judge` lifts all
of them, and each once more spoiled, in both simulators; `sweep` changes MuJoCo's settings one at a time, on shapes of
the library; `summarize` prints the tables of README.md:

    python studies/judges/run.py make GRASPS --meshes ../shared/objects
    python studies/judges/run.py judge GRASPS --out studies/judges/results.csv
    python studies/judges/run.py sweep GRASPS
    python studies/judges/run.py summarize studies/judges/results.csv
    python studies/judges/run.py quarrels GRASPS --out studies/judges/results.csv

What is there already is not made again.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Convex as DrakeConvex

from xdex_drake.dataset.files import load_grasps, save_grasps
from xdex_drake.errors import XdexError
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.grasping.synthesis import (
    SynthesisSettings,
    batch_seed,
    candidates_of_batch,
    settings_of_batch,
)
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.description import Convex, Finger, Hand
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.plant import contact_shape
from xdex_drake.interchange.mjcf import MJCF, MjcfSettings, hand_mjcf
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import Scene, make_scene
from xdex_drake.simulation import drake, mujoco
from xdex_drake.simulation.protocol import LIFT, LiftProtocol, with_physics
from xdex_drake.simulation.robust import RobustSettings, displaced

HANDS = ("allegro", "shadow", "ability", "inspire", "schunk_svh")
SHAPES = ("can", "box", "mug", "bottle", "jar", "hexagon")
BATCHES = 3
"""Searches of 32 candidates each; a hand and an object that gave too few grasps by then have fewer."""

COLUMNS = (
    "hand",
    "object",
    "grasp",
    "spoiled",
    "simulator",
    "success",
    "reason",
    "rise_m",
    "depth_mm",
    "force",
    "cpu_s",
)
SOFT = MjcfSettings(time_constant=0.02, impedance=(0.9, 0.95, 0.001), impratio=1.0)
"""MuJoCo's own contacts, whose cones are pyramids besides."""


def pyramids(rig: mujoco.MujocoRig) -> None:
    """Gives a rig MuJoCo's own friction cones."""
    rig.model.opt.cone = 0


def euler(rig: mujoco.MujocoRig) -> None:
    """Gives a rig MuJoCo's own integrator."""
    rig.model.opt.integrator = 0


def leave(rig: mujoco.MujocoRig) -> None:
    """Leaves a rig as it is exported."""


SETTINGS: dict[str, tuple[MjcfSettings, Callable[[mujoco.MujocoRig], None]]] = {
    "mujoco": (MJCF, leave),
    "mujoco, half step": (replace(MJCF, time_step=0.5 * MJCF.time_step), leave),
    "mujoco, no armature": (replace(MJCF, armature=0.0, slide_armature=0.0), leave),
    "mujoco, own contacts": (SOFT, pyramids),
    "mujoco, own contacts, no armature": (replace(SOFT, armature=0.0, slide_armature=0.0), pyramids),
}

SWEEP: tuple[tuple[str, MjcfSettings, Callable[[mujoco.MujocoRig], None]], ...] = (
    ("nothing", MJCF, leave),
    *((f"armature {one:g} kg m2", replace(MJCF, armature=one), leave) for one in (0.0, 1e-4, 2e-3)),
    *(
        (
            f"step {1e3 * one:g} ms, time constant {2e3 * one:g} ms",
            replace(MJCF, time_step=one, time_constant=2 * one),
            leave,
        )
        for one in (0.0005, 0.001, 0.004)
    ),
    *((f"time constant {1e3 * one:g} ms", replace(MJCF, time_constant=one), leave) for one in (0.01, 0.02)),
    ("impedance 0.9 to 0.95", replace(MJCF, impedance=(0.9, 0.95, 0.001)), leave),
    *((f"impratio {one:g}", replace(MJCF, impratio=one), leave) for one in (1.0, 100.0)),
    ("pyramids for cones", MJCF, pyramids),
    ("Euler's integrator", MJCF, euler),
    ("Euler's integrator, no armature", replace(MJCF, armature=0.0, slide_armature=0.0), euler),
    ("time constant, impedance and impratio as MuJoCo's own", SOFT, leave),
    ("the same, and no armature", replace(SOFT, armature=0.0, slide_armature=0.0), leave),
    ("cones as MuJoCo's own, too", SOFT, pyramids),
    ("the same, and no armature", replace(SOFT, armature=0.0, slide_armature=0.0), pyramids),
)

FACTORS = (0.7, 0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15, 1.2, 1.3, 1.5)
"""Factors of friction at which quarrels are played again."""

HALVED = ("drake, half step", "mujoco, half step")
SIMULATORS = ("drake", "drake, half step", *SETTINGS)
OTHERS = ("mujoco, no armature", "mujoco, own contacts", "mujoco, own contacts, no armature")


def make(folder: Path, hands: list[str], objects: list[str], count: int) -> None:
    """Searches for certified grasps and writes a file for each hand and object."""
    folder.mkdir(parents=True, exist_ok=True)
    for thing in objects:
        for name in hands:
            file = folder / f"{name}-{Path(thing).stem}.parquet"
            if file.exists() or file.with_suffix(".none").exists():
                continue
            begin, grasps, hand = time.process_time(), [], load_hand(name)
            try:
                scene = make_scene(load_object(thing))
                grasps = list(islice(certified(hand, scene), count))
            except XdexError as error:
                print(f"{name} {thing}: {error}", flush=True)
            if grasps:
                save_grasps(file, grasps, hand, scene)
            else:
                file.with_suffix(".none").touch()
            print(f"{name} {Path(thing).stem}: {len(grasps)} in {time.process_time() - begin:.1f} s", flush=True)


def certified(hand: Hand, scene: Scene) -> Iterator[Grasp]:
    """Certified grasps of `BATCHES` small searches."""
    for batch in range(BATCHES):
        settings = settings_of_batch(replace(SynthesisSettings(), batch=32), batch)
        seed = batch_seed(0, batch)
        for k, grasp in enumerate(candidates_of_batch(hand, scene, seed=seed, settings=settings, tally=Tally())):
            yield replace(grasp, grasp_id=f"{hand.name}-{scene.object.name}-{batch}-{k}")


@dataclass(frozen=True)
class Case:
    """A lift that both judges see."""

    grasp: Grasp
    hand: Hand
    scene: Scene
    protocol: LiftProtocol
    spoiled: str


def cases(grasp: Grasp, hand: Hand, scene: Scene, number: int) -> Iterator[Case]:
    """The grasp as it is, and spoiled in one of four ways."""
    yield Case(grasp, hand, scene, LIFT, "")
    rng, model = np.random.default_rng([17, number]), scene.object
    way = ("pose", "squeeze", "friction", "mass")[number % 4]
    if way == "pose":
        errors = RobustSettings(position_m=0.02, angle_rad=np.deg2rad(20.0))
        yield Case(displaced(grasp, scene, rng, errors), hand, scene, LIFT, way)
    elif way == "squeeze":
        share = rng.uniform(0.1, 0.7)
        yield Case(replace(grasp, tau_squeeze=share * grasp.tau_squeeze), hand, scene, LIFT, way)
    elif way == "friction":
        share = rng.uniform(0.2, 0.7)
        slippery = replace(LIFT, plant=replace(LIFT.plant, friction=share * LIFT.plant.friction))
        changed = with_physics(scene, mass=model.mass, friction=share * model.friction)
        yield Case(grasp, hand, changed, slippery, way)
    else:
        yield Case(
            grasp,
            hand,
            with_physics(scene, mass=rng.uniform(2.0, 8.0) * model.mass, friction=model.friction),
            LIFT,
            way,
        )


def in_drake(case: Case, step: float) -> tuple[Lift, float, float]:
    """Verdict, deepest contact of hand and object [m], sum of their normal forces [N] in Drake."""
    protocol = replace(case.protocol, plant=replace(case.protocol.plant, time_step=step))
    rig = drake.shared_rig(case.hand, case.scene, protocol=protocol)
    verdict = drake.simulate_lift(rig, case.grasp)
    context = rig.scene_plant.plant.GetMyContextFromRoot(rig.simulator.get_context())
    results = rig.scene_plant.plant.get_contact_results_output_port().Eval(context)
    links, body = {link.index() for link in rig.scene_plant.links}, rig.scene_plant.object_body.index()
    depth, force = 0.0, 0.0
    for k in range(results.num_point_pair_contacts()):
        info = results.point_pair_contact_info(k)
        pair = {info.bodyA_index(), info.bodyB_index()}
        if body in pair and pair & links:
            depth = max(depth, info.point_pair().depth)
            force += abs(info.contact_force() @ info.point_pair().nhat_BA_W)
    return verdict, depth, force


@lru_cache(maxsize=2 * len(SETTINGS))
def mujoco_rig(hand: Hand, scene: Scene, protocol: LiftProtocol, setting: str) -> mujoco.MujocoRig:
    """A rig of one of the settings; hands and scenes are told apart by identity."""
    settings, change = SETTINGS[setting]
    rig = mujoco.mujoco_rig(hand, scene, protocol=protocol, settings=settings)
    change(rig)
    return rig


def in_mujoco(case: Case, setting: str) -> tuple[Lift, float, float]:
    """The same in MuJoCo."""
    rig = mujoco_rig(case.hand, case.scene, case.protocol, setting)
    verdict = mujoco.simulate_lift(rig, case.grasp)
    depth, force, one = 0.0, 0.0, np.zeros(6)
    for k in range(rig.data.ncon):
        bodies = {int(rig.model.geom_bodyid[geom]) for geom in rig.data.contact[k].geom}
        if rig.object_body in bodies and bodies & set(rig.link_of):
            mujoco.mujoco_module().mj_contactForce(rig.model, rig.data, k, one)
            depth, force = max(depth, -float(rig.data.contact[k].dist)), force + one[0]
    return verdict, depth, force


def play(case: Case, judge: str) -> tuple[Lift, float, float]:
    """The verdict of any judge."""
    if judge.startswith("drake"):
        return in_drake(case, LIFT.plant.time_step * (0.5 if judge.endswith("half step") else 1.0))
    return in_mujoco(case, judge)


def judge(folder: Path, out: Path, count: int) -> None:
    """Lifts grasps by all judges and appends a row for each lift; objects in the order in which they were made."""
    known: dict[tuple[str, ...], bool] = {}
    if out.exists():
        for row in csv.DictReader(out.open()):
            known[tuple(row[name] for name in COLUMNS[:5])] = row["success"] == "1"
    with out.open("a", newline="") as file:
        writer = csv.writer(file)
        if not known:
            writer.writerow(COLUMNS)
        for path in sorted(folder.glob("*.parquet"), key=lambda path: path.stat().st_mtime):
            for item in load_grasps(path)[:count]:
                for case in cases(item.grasp, item.hand, item.scene, number_of(item.grasp)):
                    key = (item.hand.name, item.scene.object.name, item.grasp.grasp_id, case.spoiled)
                    for row in judged(case, {name: known[*key, name] for name in SIMULATORS if (*key, name) in known}):
                        writer.writerow((*key, *row))
                    file.flush()


def judged(case: Case, verdicts: dict[str, bool]) -> Iterator[tuple]:
    """What each judge says of a case, whose verdict is not known yet; half the steps are asked in case of a quarrel."""
    promised = sum(contact.f_C[2] for contact in case.grasp.certificate.contacts)
    names = ["drake", "mujoco", *(() if case.spoiled else OTHERS)]
    while names:
        name = names.pop(0)
        if name not in verdicts:
            begin = time.process_time()
            lift, depth, force = play(case, name)
            numbers = (lift.lift_height_m, 1e3 * depth, force / promised, time.process_time() - begin)
            yield (name, int(lift.success), lift.failure_reason, *(f"{value:.4f}" for value in numbers))
            verdicts[name] = lift.success
        if name == "mujoco" and verdicts["drake"] != verdicts["mujoco"]:
            names += HALVED


def quarrels(folder: Path, results: Path) -> None:
    """Prints, for each case in which Drake and MuJoCo do not agree, what would make them agree."""
    probes = "Drake, contacts of 1e6 N/m | MuJoCo, fingers with Drake's facets"
    friction = "Drake lifts from friction x | MuJoCo from x"
    print(f"| hand | object | grasp | spoiled | Drake | MuJoCo | {probes} | {friction} |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for key, judges in lifts_of(results).items():
        if judges["drake"]["success"] == judges["mujoco"]["success"]:
            continue
        items = load_grasps(folder / f"{key[0]}-{key[1]}.parquet")
        item = next(item for item in items if item.grasp.grasp_id == key[2])
        case = next(c for c in cases(item.grasp, item.hand, item.scene, number_of(item.grasp)) if c.spoiled == key[3])
        stiff = replace(case.protocol, plant=replace(case.protocol.plant, point_stiffness=1e6))
        others = [replace(case, protocol=stiff), replace(case, hand=faceted(case.hand))]
        told = [judges[name]["reason"] or "lifted" for name in ("drake", "mujoco")]
        told += [
            play(probe, name)[0].failure_reason or "lifted"
            for probe, name in zip(others, ("drake", "mujoco"), strict=True)
        ]
        told += [least_friction(case, name) for name in ("drake", "mujoco")]
        print(f"| {' | '.join((*key, *told))} |", flush=True)


def faceted(hand: Hand) -> Hand:
    """The hand with the shapes that Drake has in contact, as convex parts."""
    links = []
    for link in hand.links:
        shapes = []
        for k, shape in enumerate(link.geometry):
            touching, X_LG = contact_shape(shape, f"{link.name}_{k}")
            if isinstance(touching, DrakeConvex):
                hull = touching.GetConvexHull()
                points = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
                shapes.append(Convex((X_LG @ points.T).T))
            else:
                shapes.append(shape)
        links.append(replace(link, geometry=tuple(shapes)))
    return replace(hand, links=tuple(links))


def least_friction(case: Case, judge: str) -> str:
    """The least of some factors of all friction from which on a judge lifts."""
    won = []
    for factor in FACTORS:
        model = case.scene.object
        plant = replace(case.protocol.plant, friction=factor * case.protocol.plant.friction)
        scene = with_physics(case.scene, mass=model.mass, friction=factor * model.friction)
        won.append(play(replace(case, scene=scene, protocol=replace(case.protocol, plant=plant)), judge)[0].success)
    failed = [k for k, one in enumerate(won) if not one]
    if not failed:
        return f"under {FACTORS[0]:g}"
    return f"over {FACTORS[-1]:g}" if failed[-1] == len(FACTORS) - 1 else f"{FACTORS[failed[-1] + 1]:g}"


def number_of(grasp: Grasp) -> int:
    """A number that says how a grasp is spoiled."""
    return int(hashlib.sha256(grasp.grasp_id.encode()).hexdigest()[:8], 16)


def lifts_of(path: Path) -> dict[tuple[str, ...], dict[str, dict[str, str]]]:
    """Rows of a file of results by grasp and by judge."""
    lifts: dict[tuple[str, ...], dict[str, dict[str, str]]] = {}
    for row in csv.DictReader(path.open()):
        lifts.setdefault((row["hand"], row["object"], row["grasp"], row["spoiled"]), {})[row["simulator"]] = row
    return {key: judges for key, judges in lifts.items() if {"drake", "mujoco"} <= set(judges)}


def masses(hands: list[str]) -> None:
    """Prints what a contact at each hand's fingertips feels, at the rest posture, without and with armature [g]."""
    print("| hand | fingertip | felt along the pad's normal, with armature | taken by MuJoCo, with armature |")
    print("|---|---|---|---|")
    for name in hands:
        hand, rows = load_hand(name), []
        for armature in (0.0, MJCF.armature):
            model = mujoco.load_model(hand_mjcf(hand, settings=replace(MJCF, armature=armature)))
            rows.append(np.array([felt(model, hand, finger) for finger in hand.fingers]))
        (tip, bare_felt, bare_taken), (_, felt_, taken) = (1e3 * one.T for one in rows)
        cells = [tip, bare_felt, felt_, bare_taken, taken]
        a, b, c, d, e = (f"{cell.min():.0f} to {cell.max():.0f}" for cell in cells)
        print(f"| {name} | {a} | {b}, {c} | {d}, {e} |")


def felt(model: Any, hand: Hand, finger: Finger) -> tuple[float, float, float]:
    """Mass of a fingertip's link; 1 / (n^T J M^-1 J^T n) at its pad; what MuJoCo takes for it in contacts [kg]."""
    module = mujoco.mujoco_module()
    data = module.MjData(model)
    for joint, value in zip(hand.joints, hand.q_full(hand.q_rest), strict=True):
        data.joint(joint.name).qpos[0] = value
    module.mj_forward(model, data)
    body, J = data.body(finger.tip_link), np.zeros((3, model.nv))
    module.mj_jac(model, data, J, None, data.site(f"{finger.name}_tip").xpos, body.id)
    row, solved = (body.xmat.reshape(3, 3) @ finger.n_LPad @ J)[None], np.zeros((1, model.nv))
    module.mj_solveM(model, data, solved, row)
    return model.body_mass[body.id], 1.0 / float(row[0] @ solved[0]), 1.0 / model.body_invweight0[body.id, 0]


def sweep(folder: Path, shapes: list[str], count: int) -> None:
    """Prints what each of MuJoCo's settings does, one at a time: lifts, depth of contacts, motion in the hand."""
    paths = [path for path in sorted(folder.glob("*.parquet")) if path.stem.split("-")[-1] in shapes]
    items = [item for path in paths for item in load_grasps(path)[:count]]
    print(f"\n{len(items)} grasps of {', '.join(shapes)}\n")
    print("| changed | lifts | deepest contact [mm] | motion in the hand in 0.3 s [mm] | couplings off by [mrad] |")
    print("|---|---|---|---|---|")
    for name, settings, change in SWEEP:
        rows = [held(item.grasp, item.hand, item.scene, settings, change) for item in items]
        lifted = np.array([row[0] for row in rows], dtype=bool)
        depth, motion, apart = np.array([row[1:] for row in rows])[lifted].T * 1e3
        print(
            f"| {name} | {lifted.mean():.0%} | {np.median(depth):.3f} (p90 {np.percentile(depth, 90):.3f}) "
            f"| {np.median(motion):.2f} (p90 {np.percentile(motion, 90):.2f}) | {apart.max():.2f} |",
            flush=True,
        )


def held(
    grasp: Grasp, hand: Hand, scene: Scene, settings: MjcfSettings, change: Callable[[mujoco.MujocoRig], None]
) -> tuple[bool, float, float, float]:
    """Whether a grasp lifts; at the end deepest contact [m], motion in the hand [m], error of couplings [rad]."""
    rig = mujoco.mujoco_rig(hand, scene, settings=settings)
    change(rig)
    verdict = mujoco.simulate_lift(rig, grasp)
    if not verdict.success:
        return False, np.nan, np.nan, np.nan
    ends = []
    rig.start(grasp)
    for t in (LIFT.duration_s - LIFT.hold_s, LIFT.duration_s):
        rig.advance_to(t)
        wrist = rig.data.body(mujoco.MOUNT)
        ends.append(wrist.xmat.reshape(3, 3).T @ (rig.X_WO() @ scene.object.p_OOcm - wrist.xpos))
    geoms = rig.model.geom_bodyid[np.asarray(rig.data.contact.geom)]
    depth = -np.min(np.asarray(rig.data.contact.dist)[(geoms == rig.object_body).any(axis=1)], initial=0.0)
    q_full = rig.data.qpos[rig.joint_addresses]
    q = q_full[[joint.coupling is None for joint in hand.joints]]
    return True, depth, float(np.linalg.norm(ends[1] - ends[0])), float(np.abs(q_full - hand.q_full(q)).max())


def kappa(pairs: list[tuple[bool, bool]]) -> float:
    """Cohen's kappa of two judges."""
    a, b = np.array(pairs, dtype=float).reshape(-1, 2).T
    chance = a.mean() * b.mean() + (1.0 - a.mean()) * (1.0 - b.mean())
    return float((np.mean(a == b) - chance) / (1.0 - chance)) if chance < 1.0 else float("nan")


def rates(pairs: list[tuple[bool, bool]]) -> str:
    """Both judges' lifts, what the second keeps of the first's, agreement and kappa, as cells of a table."""
    a, b = np.array(pairs, dtype=bool).reshape(-1, 2).T
    kept = b[a].mean() if a.any() else float("nan")
    return f"{len(a)} | {a.mean():.1%} | {b.mean():.1%} | {kept:.1%} | {np.mean(a == b):.1%} | {kappa(pairs):.2f}"


def summarize(path: Path) -> None:
    """Prints the tables of README.md."""
    lifts = lifts_of(path)
    both = {
        key: (judges["drake"]["success"] == "1", judges["mujoco"]["success"] == "1") for key, judges in lifts.items()
    }
    sound = {key: pair for key, pair in both.items() if not key[3]}
    header = "lifts | Drake lifts | MuJoCo lifts | of Drake's lifts, MuJoCo lifts | agreement | kappa |"
    print(f"| grasps | {header}\n|---|---|---|---|---|---|---|")
    for hand in dict.fromkeys(key[0] for key in sound):
        print(f"| {hand} | {rates([pair for key, pair in sound.items() if key[0] == hand])} |")
    print(f"| all | {rates(list(sound.values()))} |")
    spoiled = {key: pair for key, pair in both.items() if key[3]}
    for way in dict.fromkeys(key[3] for key in spoiled):
        print(f"| spoiled by {way} | {rates([pair for key, pair in spoiled.items() if key[3] == way])} |")
    failed = [pair for pair in both.values() if not pair[0]]
    lifted = [pair for pair in both.values() if pair[0]]
    even = [lifted[k] for k in np.random.default_rng(0).permutation(len(lifted))[: len(failed)]]
    print(f"| balanced: all that fail in Drake, as many that do not | {rates(failed + even)} |")

    print(
        "\n| judge | lifts | of Drake's lifts | verdict as Drake | deepest contact [mm] | force / promised | CPU [s] |"
    )
    print("|---|---|---|---|---|---|---|")
    for judge in ("drake", "mujoco", *OTHERS):
        rows = [(judges[judge], both[key][0]) for key, judges in lifts.items() if judge in judges and not key[3]]
        won, ours = np.array([row["success"] == "1" for row, _ in rows]), np.array([one for _, one in rows])
        held = [row for row, _ in rows if row["success"] == "1"]
        depth, force = (np.array([float(row[name]) for row in held]) for name in ("depth_mm", "force"))
        if not held:
            depth = force = np.full(1, np.nan)
        cpu = np.mean([float(row["cpu_s"]) for row, _ in rows])
        print(
            f"| {judge} | {won.mean():.1%} | {won[ours].mean():.1%} | {np.mean(won == ours):.1%} "
            f"| {np.median(depth):.2f} (p90 {np.percentile(depth, 90):.2f}) "
            f"| {np.median(force):.2f} ({np.percentile(force, 10):.2f} to {np.percentile(force, 90):.2f}) | {cpu:.2f} |"
        )
    print("\n| hand | object | grasp | spoiled | Drake | at half its step | MuJoCo | at half its step |")
    print("|---|---|---|---|---|---|---|---|")
    for key, judges in lifts.items():
        if both[key][0] != both[key][1]:
            names = ("drake", "drake, half step", "mujoco", "mujoco, half step")
            told = " | ".join(judges[name]["reason"] or "lifted" for name in names)
            print(f"| {key[0]} | {key[1]} | {key[2].removeprefix(f'{key[0]}-{key[1]}-')} | {key[3]} | {told} |")


def main() -> None:
    """Runs one of the steps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("make", "judge", "sweep", "summarize", "quarrels"))
    parser.add_argument("path", type=Path)
    parser.add_argument("--meshes", type=Path, help="folder with index.json; shapes of the library where not given")
    parser.add_argument("--only", nargs="+", help="names of meshes of the index, instead of its first ones")
    parser.add_argument("--hands", nargs="+", default=HANDS)
    parser.add_argument("--objects", type=int, default=24, help="how many, in the order of the index")
    parser.add_argument("--count", type=int, default=4, help="grasps of each hand and object")
    parser.add_argument("--out", type=Path, default=Path("studies/judges/results.csv"))
    options = parser.parse_args()
    if options.step == "make":
        objects = list(SHAPES)
        if options.meshes is not None:
            index = json.loads((options.meshes / "index.json").read_text())["objects"]
            chosen = [entry for entry in index if options.only is None or entry["name"] in options.only]
            objects = [str(options.meshes / entry["file"]) for entry in chosen]
        make(options.path, options.hands, objects[: options.objects], options.count)
    elif options.step == "judge":
        judge(options.path, options.out, options.count)
    elif options.step == "sweep":
        masses(options.hands)
        sweep(options.path, list(SHAPES[:4]), options.count)
    elif options.step == "quarrels":
        quarrels(options.path, options.out)
    else:
        summarize(options.path)


if __name__ == "__main__":
    main()
