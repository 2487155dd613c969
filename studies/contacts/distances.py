"""How far contacts of certified grasps lie from the hand's shapes and from the object's mesh as its file has it.

    python studies/contacts/distances.py run HANDS_FOLDER MESH_FOLDER OUT.csv [--meshes 12] [--count 2]
    python studies/contacts/distances.py summarize OUT.csv

HANDS_FOLDER holds makers' URDF files, one folder a hand, which are imported as they are. For each of these and each
mesh, the first COUNT grasps that a search finds certified. A row a contact: its distance from the shapes of its link,
from the triangles of the mesh file, unrepaired and unsplit, and, of the whole grasp, the depth of the deepest of
20,000 points of these triangles in the hand. A cell that stands in the file is not run again.

`distances.csv` (nine meshes, and a tenth with two hands) was made before searches drew
contacts to the center of mass: contacts touch shape and mesh, 95 % within 0.02 mm; 8 % of the grasps are more than
0.5 mm deep by these points, up to 0.93 mm, all of them with Inspire, Shadow and SVH: `finish` looks at 4,096 points.
"""

import argparse
import csv
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

COLUMNS = ("hand", "object", "trial", "link", "to_shape_mm", "to_mesh_mm", "depth_mm")
POINTS = 20_000


def rows_of_cell(file: Path, mesh: Path, count: int) -> list[dict[str, Any]]:
    """Rows of one hand and mesh, one a contact; the depth is the whole hand's."""
    from xdex_drake.contact.penetration import penetration_depth
    from xdex_drake.grasping.synthesis import certified_grasps
    from xdex_drake.hand.kinematics import Configuration
    from xdex_drake.hand.library import load_hand
    from xdex_drake.scene.object import load_object
    from xdex_drake.scene.tabletop import make_scene

    hand, scene = load_hand(file), make_scene(load_object(mesh))
    raw = trimesh.load(mesh, force="mesh", process=False)
    triangles = np.asarray(raw.triangles) * scene.object.scale
    surface = scene.object.scale * np.asarray(trimesh.sample.sample_surface(raw, POINTS, seed=0)[0])
    found, rows = certified_grasps(hand, scene, seed=0, time_limit_s=60.0), []
    for trial, grasp in enumerate(itertools.islice(found, count)):
        assert grasp.certificate is not None
        k = Configuration.at(hand, grasp.X_WH, grasp.q)
        depth = penetration_depth(hand, k.R_WLs, k.p_WLs, (scene.X_WO @ surface.T).T)
        for contact in grasp.certificate.contacts:
            link = hand.link_index[contact.link]
            p_LC = (scene.X_WO @ contact.p_OC - k.p_WLs[link]) @ k.R_WLs[link]
            shape = min(float(geometry.signed_distance(p_LC)) for geometry in hand.links[link].geometry)
            near = trimesh.triangles.closest_point(triangles, np.tile(contact.p_OC, (len(triangles), 1)))
            gap = float(np.linalg.norm(near - contact.p_OC, axis=1).min())
            numbers = {"to_shape_mm": 1e3 * abs(shape), "to_mesh_mm": 1e3 * gap, "depth_mm": 1e3 * depth}
            row = {"hand": file.parent.name, "object": mesh.stem, "trial": trial, "link": contact.link}
            rows.append(row | {name: f"{value:.4f}" for name, value in numbers.items()})
    return rows or [{"hand": file.parent.name, "object": mesh.stem, "trial": -1}]


def run(hands: list[Path], meshes: list[Path], out: Path, count: int) -> None:
    """Appends the cells that are missing, mesh by mesh."""
    from tqdm import tqdm

    done = set()
    if out.exists():
        done = {(row["hand"], row["object"]) for row in csv.DictReader(out.open(encoding="utf-8"))}
    else:
        out.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
    for mesh, file in tqdm([(m, h) for m in meshes for h in hands if (h.parent.name, m.stem) not in done], unit="cell"):
        rows = rows_of_cell(file, mesh, count)
        with out.open("a", newline="", encoding="utf-8") as stream:
            csv.DictWriter(stream, COLUMNS, restval="", lineterminator="\n").writerows(rows)


def summarize(out: Path) -> None:
    """Prints the distances of contacts and the depths of grasps, by hand and over all."""
    rows = [row for row in csv.DictReader(out.open(encoding="utf-8")) if int(row["trial"]) >= 0]
    hands = sorted({row["hand"] for row in rows})
    for hand in (*hands, "all"):
        here = [row for row in rows if hand in (row["hand"], "all")]
        depths = {(row["hand"], row["object"], row["trial"]): float(row["depth_mm"]) for row in here}
        depth = np.array(list(depths.values()))
        print(f"{hand:11s} {len(depth)} grasps, {len(here)} contacts", end="")
        for name in ("to_shape_mm", "to_mesh_mm"):
            p50, p95, most = np.quantile([float(row[name]) for row in here], (0.5, 0.95, 1.0))
            print(f"; {name[:-3].replace('_', ' ')} p50 {p50:.3f}, p95 {p95:.3f}, most {most:.3f} mm", end="")
        print(f"; depth p95 {np.quantile(depth, 0.95):.2f}, most {depth.max():.2f} mm", end="")
        print(f", at most 0.5 mm {np.mean(depth <= 0.5):.1%}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "summarize"))
    parser.add_argument("paths", nargs="+", type=Path, help="HANDS_FOLDER MESH_FOLDER OUT.csv, or OUT.csv")
    parser.add_argument("--meshes", type=int, default=12, help="how many, in the order of their names")
    parser.add_argument("--count", type=int, default=2)
    options = parser.parse_args()
    if options.what == "run":
        hands_folder, mesh_folder, target = options.paths
        files = sorted(hands_folder.glob("*/*_right.urdf"))
        run(files, sorted(mesh_folder.glob("*.obj"))[: options.meshes], target, options.count)
    else:
        summarize(options.paths[0])
