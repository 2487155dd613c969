"""Two judges: the same grasps lifted in Drake and in MuJoCo, and what MuJoCo's settings do to its verdicts.

Grasps are chosen by their certificate alone. `make` searches for them, a file for each hand and mesh; `judge` lifts all
of them, and each once more spoiled, in both simulators; `summarize` prints the tables of README.md:

    python studies/judges/run.py make GRASPS --meshes ../shared/objects
    python studies/judges/run.py judge GRASPS --out studies/judges/results.csv
    python studies/judges/run.py summarize studies/judges/results.csv

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

import numpy as np

from xdex_drake.dataset.files import load_grasps, save_grasps
from xdex_drake.errors import XdexError
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.grasping.synthesis import (
    SynthesisSettings,
    Tally,
    batch_seed,
    candidates_of_batch,
    settings_of_batch,
)
from xdex_drake.hand.description import Hand
from xdex_drake.hand.library import load_hand
from xdex_drake.interchange.mjcf import MJCF, MjcfSettings
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import Scene, make_scene
from xdex_drake.simulation import lift as drake
from xdex_drake.simulation import mujoco
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
"""MuJoCo's own contacts, which are Euler's with pyramids besides (see `bare`)."""


def bare(rig: mujoco.MujocoRig) -> None:
    """Gives a rig MuJoCo's own integrator and friction cone."""
    rig.model.opt.integrator, rig.model.opt.cone = 0, 0


def leave(rig: mujoco.MujocoRig) -> None:
    """Leaves a rig as it is exported."""


SETTINGS: dict[str, tuple[MjcfSettings, Callable[[mujoco.MujocoRig], None]]] = {
    "mujoco": (MJCF, leave),
    "mujoco, half step": (replace(MJCF, time_step=0.5 * MJCF.time_step), leave),
    "mujoco, no armature": (replace(MJCF, armature=0.0, slide_armature=0.0), leave),
    "mujoco, own contacts": (SOFT, bare),
    "mujoco, own contacts, no armature": (replace(SOFT, armature=0.0, slide_armature=0.0), bare),
}

HALVED = ("drake, half step", "mujoco, half step")
OTHERS = tuple(name for name in SETTINGS if name not in ("mujoco", *HALVED))


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
        yield Case(replace(grasp, q_squeeze=grasp.q + share * (grasp.q_squeeze - grasp.q)), hand, scene, LIFT, way)
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
    context = rig.bench.plant.GetMyContextFromRoot(rig.simulator.get_context())
    results = rig.bench.plant.get_contact_results_output_port().Eval(context)
    links, body = {link.index() for link in rig.bench.links}, rig.bench.object_body.index()
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
    done = {tuple(row.values())[:3] for row in csv.DictReader(out.open())} if out.exists() else set()
    with out.open("a", newline="") as file:
        writer = csv.writer(file)
        if not done:
            writer.writerow(COLUMNS)
        for path in sorted(folder.glob("*.parquet"), key=lambda path: path.stat().st_mtime):
            for item in load_grasps(path)[:count]:
                key = (item.hand.name, item.scene.object.name, item.grasp.grasp_id)
                if key in done:
                    continue
                number = int(hashlib.sha256(item.grasp.grasp_id.encode()).hexdigest()[:8], 16)
                promised = sum(contact.f_C[2] for contact in item.grasp.certificate.contacts)
                for case in cases(item.grasp, item.hand, item.scene, number):
                    for row in judged(case, promised):
                        writer.writerow((*key, case.spoiled, *row))
                done.add(key)
                file.flush()


def judged(case: Case, promised: float) -> Iterator[tuple]:
    """What each judge says of a case; half the steps are asked where Drake and MuJoCo do not agree."""
    verdicts = {}
    names = ["drake", "mujoco", *(() if case.spoiled else OTHERS)]
    while names:
        name = names.pop(0)
        begin = time.process_time()
        lift, depth, force = play(case, name)
        numbers = (lift.lift_height_m, 1e3 * depth, force / promised, time.process_time() - begin)
        yield (name, int(lift.success), lift.failure_reason, *(f"{value:.4f}" for value in numbers))
        verdicts[name] = lift.success
        if name == "mujoco" and verdicts["drake"] != verdicts["mujoco"]:
            names += HALVED


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
    lifts: dict[tuple[str, ...], dict[str, dict[str, str]]] = {}
    for row in csv.DictReader(path.open()):
        lifts.setdefault((row["hand"], row["object"], row["grasp"], row["spoiled"]), {})[row["simulator"]] = row
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
        rows = [(judges[judge], both[key][0]) for key, judges in lifts.items() if not key[3]]
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
    """Runs one of the three steps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("make", "judge", "summarize"))
    parser.add_argument("path", type=Path)
    parser.add_argument("--meshes", type=Path, help="folder with index.json; shapes of the library where not given")
    parser.add_argument("--hands", nargs="+", default=HANDS)
    parser.add_argument("--objects", type=int, default=24, help="how many, in the order of the index")
    parser.add_argument("--count", type=int, default=4, help="grasps of each hand and object")
    parser.add_argument("--out", type=Path, default=Path("studies/judges/results.csv"))
    options = parser.parse_args()
    if options.step == "make":
        objects = list(SHAPES)
        if options.meshes is not None:
            index = json.loads((options.meshes / "index.json").read_text())["objects"]
            objects = [str(options.meshes / entry["file"]) for entry in index]
        make(options.path, options.hands, objects[: options.objects], options.count)
    elif options.step == "judge":
        judge(options.path, options.out, options.count)
    else:
        summarize(options.path)


if __name__ == "__main__":
    main()
