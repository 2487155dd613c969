"""Lifted of attempted retargetings: the plain way alone, and with jittered starts where it fails.

Sources are lifted grasps of generated human hands that train, on generated shapes outside the test families and on
development meshes (`studies/splits`); a scene gives three. Targets are drawn by seed, as many of each group: hands of
the library, generated robot hands, generated human hands. Nothing is selected: what cannot be done counts as failed.
Seconds are processor time of one core.

Run `python studies/retargeting/run.py --out studies/retargeting/results.csv --meshes REFERENCE/objects/meshes`; rows
are appended as they come. `--summarize FILE` prints the table.
"""

import argparse
import csv
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from xdex_drake.hand.generation import HUMAN_EVERY, hand_name

if TYPE_CHECKING:
    from xdex_drake.grasp import Grasp
    from xdex_drake.hand.description import Hand
    from xdex_drake.scene.tabletop import Scene

SPLITS = Path(__file__).parents[1] / "splits" / "held_out.yaml"
LIBRARY = ("ability", "allegro", "inspire", "schunk_svh", "shadow")
COLUMNS = (
    *("scene", "source", "target", "group", "plain", "plain_s", "retried", "retried_s", "lift_s"),
    *("penetration_mm", "tips_cm", "tips_optimum_cm"),
)


def groups(rng: np.random.Generator, count: int) -> list[tuple[str, str]]:
    """Targets drawn for one source hand, as (group, name)."""
    kept = set(yaml.safe_load(SPLITS.read_text())["test_hands"])
    generated = [k for k in range(1000) if hand_name(0, k) not in kept]
    pools = {
        "library": list(LIBRARY),
        "robot": [hand_name(0, k) for k in generated if k % HUMAN_EVERY],
        "human": [hand_name(0, k) for k in generated if k % HUMAN_EVERY == 0],
    }
    return [(group, str(name)) for group, pool in pools.items() for name in rng.choice(pool, count, replace=False)]


def scenes(shapes: int, meshes: int, folder: Path | None, seed: int) -> "Iterator[Scene]":
    """Scenes of generated shapes outside the test families, and of development meshes."""
    from xdex_drake.scene.generator import family_name, shape_name
    from xdex_drake.scene.object import load_object
    from xdex_drake.scene.tabletop import resting_scene

    splits = yaml.safe_load(SPLITS.read_text())
    names = (shape_name(seed, k) for k in range(1000, 2000))
    for name in [name for name in names if family_name(name) not in splits["test_families"]][:shapes]:
        yield resting_scene(load_object(name), index=0, seed=seed)
    for name in splits["development_meshes"][: meshes if folder is not None else 0]:
        assert folder is not None
        yield resting_scene(load_object(str(folder / f"{name}.obj")), index=0, seed=seed)


def tips_cm(grasp: "Grasp", hand: "Hand", source: "Grasp", source_hand: "Hand") -> float:
    """Mean distance of corresponding fingertips and wrist [cm]."""
    from xdex_drake.hand.kinematics import forward_kinematics

    def points(g: "Grasp", h: "Hand") -> dict[str, Any]:
        R, p = forward_kinematics(h, g.X_WH, g.q)
        tips = {f.name: p[i] + R[i] @ f.p_LTip for f in h.fingers for i in (h.link_index[f.tip_link],)}
        return tips | {"wrist": g.X_WH.translation()}

    one, other = points(grasp, hand), points(source, source_hand)
    return float(100.0 * np.mean([np.linalg.norm(one[k] - other[k]) for k in one.keys() & other.keys()]))


def attempt(source: "Grasp", source_hand: "Hand", target: "Hand", scene: "Scene") -> dict[str, Any]:
    """One retargeting, plainly and, where that fails, with jittered starts; the results lifted."""
    from xdex_drake.grasping.retarget import retarget
    from xdex_drake.programs.retargeting import RETRY, warm_start
    from xdex_drake.simulation.drake import lift

    begin = time.process_time()
    plain = retarget(source, source_hand, target, scene, retry=replace(RETRY, starts=0))
    between = time.process_time()
    outcome = plain
    if plain.grasp is None:
        outcome = retarget(source, source_hand, target, scene)
    end = time.process_time()
    row: dict[str, Any] = {"plain_s": round(between - begin, 4), "retried_s": round(end - between, 4)}
    verdict = str(outcome.reason and outcome.reason.name)
    if outcome.grasp is not None:
        done = lift(outcome.grasp, target, scene)
        verdict = "lifted" if done.success else f"lift: {done.failure_reason}"
        X_WH, q = warm_start(source, source_hand, target)
        row |= {
            "lift_s": round(time.process_time() - end, 4),
            "penetration_mm": round(1e3 * outcome.grasp.penetration_parts_m, 4),
            "tips_cm": round(tips_cm(outcome.grasp, target, source, source_hand), 4),
            "tips_optimum_cm": round(tips_cm(replace(outcome.grasp, X_WH=X_WH, q=q), target, source, source_hand), 4),
        }
    row["plain"] = verdict if plain.grasp is not None else str(plain.reason and plain.reason.name)
    return row | {"retried": verdict}


def measure(options: argparse.Namespace) -> None:
    """Appends the rows."""
    from xdex_drake.grasping.synthesis import synthesize
    from xdex_drake.hand.library import load_hand

    is_new = not options.out.exists()
    with options.out.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="", lineterminator="\n")
        if is_new:
            writer.writeheader()
        for number, scene in enumerate(scenes(options.shapes, len_meshes(options), options.meshes, options.seed)):
            rng = np.random.default_rng([options.seed, number])
            human = next(name for group, name in groups(rng, 1) if group == "human")
            hand = load_hand(human)
            found = synthesize(hand, scene, count=options.sources, seed=options.seed, time_limit_s=60.0)
            sources = [grasp for grasp in found if grasp.lift is not None and grasp.lift.success]
            for group, name in groups(rng, options.targets):
                for k, source in enumerate(sources):
                    row = attempt(source, hand, load_hand(name), scene)
                    row |= {"scene": scene.scene_id, "source": f"{human}/{k}", "target": name, "group": group}
                    writer.writerow(row)
                    file.flush()


def len_meshes(options: argparse.Namespace) -> int:
    """How many development meshes are used."""
    return 12 if options.mesh_count is None else options.mesh_count


def summarize(path: Path) -> None:
    """Prints rates, times, distances, and what is lost, group by group."""
    rows: dict[str, list[dict[str, str]]] = defaultdict(list)
    with path.open() as file:
        for row in csv.DictReader(file):
            rows[row["group"]].append(row)
    print("group    attempts  plain  retried  s a plain one  s more a retry  deepest mm  excess cm p50, p90")
    for group, some in rows.items():
        n = len(some)
        rates = [sum(row[way] == "lifted" for row in some) / n for way in ("plain", "retried")]
        # A retry repeats the plain way first.
        again = [float(row["retried_s"]) - float(row["plain_s"]) for row in some if float(row["retried_s"]) > 1e-3]
        plain = np.mean([float(row["plain_s"]) for row in some])
        deep = max((float(row["penetration_mm"]) for row in some if row["penetration_mm"]), default=np.nan)
        excess = [float(row["tips_cm"]) - float(row["tips_optimum_cm"]) for row in some if row["tips_cm"]]
        quantiles = np.percentile(excess, [50, 90]) if excess else [np.nan, np.nan]
        more = np.mean(again) if again else 0.0
        print(
            f"{group:<8} {n:8d}  {rates[0]:.3f}  {rates[1]:.3f}    {plain:13.3f}  {more:14.3f}  {deep:10.2f}  "
            f"{quantiles[0]:.2f}, {quantiles[1]:.2f}"
        )
        for way in ("plain", "retried"):
            lost = Counter(row[way] for row in some if row[way] != "lifted")
            print(f"  lost {way}: " + ", ".join(f"{name} {count}" for name, count in lost.most_common()))


def main() -> None:
    """Runs the study or prints its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results.csv"))
    parser.add_argument("--meshes", type=Path, default=None, help="folder of the reference meshes")
    parser.add_argument("--shapes", type=int, default=12)
    parser.add_argument("--mesh-count", type=int, default=None)
    parser.add_argument("--sources", type=int, default=3)
    parser.add_argument("--targets", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--summarize", type=Path, default=None)
    options = parser.parse_args()
    if options.summarize is not None:
        summarize(options.summarize)
    else:
        measure(options)


if __name__ == "__main__":
    main()
