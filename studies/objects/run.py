"""Every mesh and every generated shape on trial: import, fit of the convex parts, error of the grid, poses of rest.

    python studies/objects/run.py meshes MESH_FOLDER --out studies/objects/import.csv
    python studies/objects/run.py shapes --count 200 --out studies/objects/shapes.csv
    python studies/objects/run.py summarize studies/objects/import.csv

Each mesh goes through the import of `xdex object import`, each shape through `load_object` by its name. A row is
written as soon as it is known; what a table already holds is passed over, so that a run can be taken up again.
"""

import argparse
import csv
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np

import xdex_drake as xd
from xdex_drake.errors import XdexError
from xdex_drake.jobs.meshes import import_meshes
from xdex_drake.scene.generator import family_name, shape_name
from xdex_drake.scene.tabletop import drop, same_pose, stable_poses

DROPS = 4
MEASURES = ("grid_mean_mm", "grid_p99_mm", "poses", "drops", "at_rest", "known", "measure_seconds")
COLUMNS = {
    "meshes": (*("name", "closed", "parts", "seconds", "bulge_p99_mm", "gap_p99_mm"), *MEASURES, "repairs"),
    "shapes": (*("name", "kind", "parts", "seconds", "bulge_p99_mm", "watertight"), *MEASURES, "height_m", "repairs"),
}


def measure(model: xd.ObjectModel) -> dict[str, object]:
    """Error of the grid near the surface and inside, poses of rest, and how random drops agree with them."""
    begin = time.process_time()
    noise = np.random.default_rng(0).normal(0.0, 0.008, (2000, 3))
    points = model.surface_samples(2000, 0)[0] + noise
    error = 1e3 * np.abs(model.grid.interpolate(points)[0] - model.exact.query(points).distance)
    poses = stable_poses(model)
    rests = drop(model, count=DROPS, seed=0)
    known = sum(any(same_pose(model, pose.X_WO.rotation(), X.rotation()) for pose in poses) for X in rests)
    figures = (f"{error.mean():.3f}", f"{np.percentile(error, 99):.3f}", len(poses), DROPS, len(rests), known)
    return dict(zip(MEASURES, (*figures, f"{time.process_time() - begin:.1f}"), strict=True))


def imported(mesh: Path) -> dict[str, object]:
    """One row: what the import tells of a mesh, then the measures of what it wrote."""
    with tempfile.TemporaryDirectory() as name:
        (done,) = import_meshes([mesh], Path(name))
    row = asdict(done.row)
    if done.model is None:
        return {"name": row["name"], "repairs": f"REFUSED: {row['repairs']}"}
    return {column: row[column] for column in COLUMNS["meshes"] if column in row} | measure(done.model)


def generated(name: str) -> dict[str, object]:
    """One row of a generated shape."""
    model = xd.load_object(name)
    report = model.report
    return {
        "name": name,
        "kind": family_name(name),
        "parts": report.parts,
        "seconds": f"{report.seconds:.2f}",
        "bulge_p99_mm": f"{1e3 * report.bulge_p99_m:.3f}",
        "watertight": report.watertight,
        "height_m": f"{np.ptp(model.vertices[:, 2]):.4f}",
        "repairs": "; ".join(report.repairs),
    } | measure(model)


def run(kind: str, names: list[str], out: Path, minutes: float) -> None:
    """Appends the rows that a table lacks, until the time is over."""
    deadline = time.monotonic() + 60.0 * minutes
    done = {row["name"] for row in csv.DictReader(out.open(encoding="utf-8"))} if out.exists() else set()
    for name in names:
        if Path(name).stem in done or time.monotonic() > deadline:
            continue
        try:
            row = imported(Path(name)) if kind == "meshes" else generated(name)
        except XdexError as error:
            row = {"name": Path(name).stem, "repairs": f"REFUSED: {error}"}
        fresh = not out.exists()
        with out.open("a", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, COLUMNS[kind], lineterminator="\n")
            if fresh:
                writer.writeheader()
            writer.writerow(row)


def summarize(table: Path) -> None:
    """Prints what the rows of a table have in common."""
    rows = list(csv.DictReader(table.open(encoding="utf-8")))
    good = [row for row in rows if not row["repairs"].startswith("REFUSED")]
    print(f"{len(rows)} rows, {len(rows) - len(good)} refused")
    for column in ("parts", "seconds", "bulge_p99_mm", "grid_mean_mm", "grid_p99_mm", "poses", "measure_seconds"):
        x = np.array([float(row[column]) for row in good])
        print(f"{column:16s} median {np.median(x):.3g}, p90 {np.quantile(x, 0.9):.3g}, largest {x.max():.3g}")
    bulging = [f"{row['name']} {float(row['bulge_p99_mm']):.2f}" for row in good if float(row["bulge_p99_mm"]) > 1.0]
    print(f"bulge p99 above 1 mm: {', '.join(bulging) or 'none'}")
    drops, rest, known = (sum(int(row[column]) for row in good) for column in ("drops", "at_rest", "known"))
    print(f"drops from random orientations: {drops}, at rest {rest}, in a pose that the hull method gave {known}")
    print(f"without a pose of rest: {', '.join(row['name'] for row in good if int(row['poses']) == 0) or 'none'}")


def main() -> None:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("meshes", "shapes", "summarize"))
    parser.add_argument("path", type=Path, nargs="?", help="folder of meshes, or the table to summarize")
    parser.add_argument("--count", type=int, default=200, help="number of generated shapes")
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--minutes", type=float, default=1e6, help="begin no further object after this time")
    arguments = parser.parse_args()
    if arguments.what == "summarize":
        summarize(arguments.path)
    elif arguments.what == "meshes":
        files = [str(file) for file in sorted(arguments.path.glob("*.obj"))]
        run("meshes", files, arguments.out or Path("import.csv"), arguments.minutes)
    else:
        names = [shape_name(0, k) for k in range(arguments.count)]
        run("shapes", names, arguments.out or Path("shapes.csv"), arguments.minutes)


if __name__ == "__main__":
    main()
