"""Certified and lifted grasps over a folder of meshes: how many, how fast, how deep, and which objects defeat a hand.

    python studies/force_closure/run.py MESH_FOLDER OUT.csv [--hand allegro] [--protocol lift-0.2/2tips] [--count 20]

For each mesh, at its most probable pose, searches until COUNT grasps are certified or the processor time is used up,
and lifts each, with no selection. One row a certified grasp, and one without numbers for each grasp that is missing.
A file that exists is gone on with: objects that stand in it are not run again.
"""

import argparse
import csv
import itertools
import os
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

COLUMNS = (
    "object", "hand", "protocol", "trial", "certified", "lifted", "reason", "task_margin", "margin_lower",
    "residual", "penetration_parts_mm", "penetration_mesh_mm", "octant", "height_mm", "tried", "rejected",
    "certify_s", "lift_s", "prepare_s",
)  # fmt: skip


def rows_of_object(mesh: str, hand_name: str, protocol_name: str, count: int, budget_s: float) -> list[dict[str, Any]]:
    """All rows of one object; times are processor seconds, `certify_s` of a row is that since the row before."""
    import numpy as np

    from xdex_drake.contact.certificate import check_certificate
    from xdex_drake.grasp import Grasp
    from xdex_drake.grasping.synthesis import SynthesisSettings, batch_seed, candidates_of_batch, settings_of_batch
    from xdex_drake.grasping.tally import Tally
    from xdex_drake.hand.library import load_hand
    from xdex_drake.programs.grasp_types import approach_axis
    from xdex_drake.scene.object import load_object
    from xdex_drake.scene.tabletop import make_scene
    from xdex_drake.simulation.drake import lift_rig, simulate_lift
    from xdex_drake.simulation.protocol import find_protocol, protocol_scene

    start = time.process_time()
    hand, protocol = load_hand(hand_name), find_protocol(protocol_name).grip
    scene = protocol_scene(make_scene(load_object(mesh)), protocol)
    _ = scene.object.grid, scene.object.exact
    rig = lift_rig(hand, scene, protocol=protocol)
    prepare = time.process_time() - start
    height = 1e3 * float((scene.X_WO @ scene.object.vertices.T)[2].max())
    axis = approach_axis(hand)[1]
    common = {"object": Path(mesh).stem, "hand": hand.name, "protocol": protocol.name, "height_mm": f"{height:.1f}"}
    common |= {"prepare_s": f"{prepare:.2f}"}
    tally, rows, lifting = Tally(), [], 0.0
    begin = before = time.process_time()

    def found() -> Iterator[Grasp]:
        # Batch after batch until the processor time, that of lifts left out, is used up.
        for batch in itertools.count():
            settings = settings_of_batch(SynthesisSettings(), batch)
            yield from candidates_of_batch(hand, scene, seed=batch_seed(0, batch), settings=settings, tally=tally)
            if time.process_time() - begin - lifting > budget_s:
                return

    for trial, grasp in enumerate(itertools.islice(found(), count)):
        certify_s = time.process_time() - before
        start = time.process_time()
        verdict = simulate_lift(rig, grasp)
        lift_s = time.process_time() - start
        lifting += lift_s
        certificate = grasp.certificate
        assert certificate is not None
        toward = grasp.X_WH.rotation().matrix() @ axis
        rows.append(
            common
            | {
                "trial": trial, "certified": 1, "lifted": int(verdict.success), "reason": verdict.failure_reason,
                "task_margin": f"{certificate.task_margin:.3f}", "margin_lower": f"{certificate.margin_lower:.4f}",
                "residual": f"{check_certificate(certificate).wrench:.1e}",
                "penetration_parts_mm": f"{1e3 * grasp.penetration_parts_m:.3f}",
                "penetration_mesh_mm": f"{1e3 * grasp.penetration_mesh_m:.3f}",
                "octant": int((toward > 0.0) @ np.array([4, 2, 1])), "tried": tally.tried, "rejected": "",
                "certify_s": f"{certify_s:.3f}", "lift_s": f"{lift_s:.3f}",
            }
        )  # fmt: skip
        before = time.process_time()
    why = "; ".join(f"{name} {n}" for name, n in sorted(tally.rejected.items(), key=lambda item: -item[1])[:4])
    for trial in range(len(rows), count):
        rows.append(common | {"trial": trial, "certified": 0, "lifted": 0, "tried": tally.tried, "rejected": why})
    return rows


def main() -> None:
    """Runs what is missing and appends it, an object at a time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", type=Path, help="folder of .obj files")
    parser.add_argument("out", type=Path, help="table of rows, .csv")
    parser.add_argument("--hand", default="allegro")
    parser.add_argument("--protocol", default="lift-0.2/2tips")
    parser.add_argument("--count", type=int, default=20, help="grasps wanted of each object")
    parser.add_argument("--budget", type=float, default=60.0, help="processor seconds of search and polish an object")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()

    from tqdm import tqdm

    from xdex_drake.jobs.processes import run_units

    done: set[str] = set()
    if args.out.exists():
        with args.out.open(encoding="utf-8") as file:
            done = {row["object"] for row in csv.DictReader(file)}
    else:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
    meshes = [str(path) for path in sorted(args.meshes.glob("*.obj")) if path.stem not in done]
    work = partial(
        rows_of_object, hand_name=args.hand, protocol_name=args.protocol, count=args.count, budget_s=args.budget
    )
    with tqdm(total=len(meshes), unit="object") as bar:
        for result in run_units(meshes, work, workers=args.workers, timeout_s=1800.0):
            bar.update()
            if result.value is None:
                tqdm.write(f"{Path(result.unit).stem}: {result.failure}")
                continue
            with args.out.open("a", encoding="utf-8", newline="") as file:
                csv.DictWriter(file, COLUMNS, restval="").writerows(result.value)
                file.flush()
                os.fsync(file.fileno())


if __name__ == "__main__":
    main()
