"""Broken and hostile meshes on import: for each a clear error or a stated repair, within a bounded time.

    python studies/objects/hostile.py --out studies/objects/hostile.csv

The meshes are made from a fixed seed; each goes through `xdex object import` in a process of its own with an empty
cache. Rows of a table that exists are kept, so that a run can be taken up again.
"""

import argparse
import csv
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import manifold3d
import numpy as np
import trimesh
from numpy.typing import ArrayLike

COLUMNS: tuple[str, ...] = ("case", "result", "seconds", "cpu_seconds", "message")
RNG_SEED = 0


def _ball(subdivisions: int = 3, radius: float = 0.04) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)


def _trimesh(vertices: ArrayLike, faces: ArrayLike) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, process=False)


def _solid(solid: manifold3d.Manifold, scale: float = 1.0) -> trimesh.Trimesh:
    mesh = solid.to_mesh()
    return _trimesh(np.array(mesh.vert_properties)[:, :3] * scale, np.array(mesh.tri_verts))


def _soup(count: int) -> trimesh.Trimesh:
    rng = np.random.default_rng(RNG_SEED)
    corners = rng.uniform(-0.05, 0.05, (count, 1, 3)) + rng.normal(scale=0.02, size=(count, 3, 3))
    return _trimesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def _spiky() -> trimesh.Trimesh:
    ball = _ball(5)
    ball.vertices *= 1.0 + np.random.default_rng(RNG_SEED).uniform(0.0, 0.8, (len(ball.vertices), 1))
    return ball


def _shuffled() -> trimesh.Trimesh:
    ball = _spiky()
    return _trimesh(np.random.default_rng(RNG_SEED).permutation(ball.vertices), ball.faces)


def _comb() -> trimesh.Trimesh:
    teeth = [manifold3d.Manifold.cube((5e-4, 0.018, 0.05)).translate((1e-3 * k, 1e-3, 0.0)) for k in range(118)]
    spine = manifold3d.Manifold.cube((0.12, 0.02, 0.01))
    return _solid(spine + manifold3d.Manifold.batch_boolean(teeth, manifold3d.OpType.Add))


def _sponge(depth: int) -> trimesh.Trimesh:
    holes = []

    def drill(x: float, y: float, size: float, level: int) -> None:
        third = size / 3.0
        holes.append(manifold3d.Manifold.cube((third, third, 3.0)).translate((x + third, y + third, -1.0)))
        for i, j in np.ndindex(3, 3) if level > 1 else ():
            if (i, j) != (1, 1):
                drill(x + i * third, y + j * third, third, level - 1)

    drill(0.0, 0.0, 1.0, depth)
    drills, cube = manifold3d.Manifold.compose(holes), manifold3d.Manifold.cube((1.0, 1.0, 1.0))
    cube = cube - drills - drills.rotate((90.0, 0.0, 0.0)).translate((0.0, 1.0, 0.0))
    return _solid(cube - drills.rotate((0.0, 90.0, 0.0)).translate((0.0, 0.0, 1.0)), 0.1)


def _balls(count: int) -> trimesh.Trimesh:
    rng = np.random.default_rng(RNG_SEED)
    return _joined(*(_ball(2, 0.003).apply_translation(p) for p in rng.uniform(-0.05, 0.05, (count, 3))))


def _strip(half_turns: int) -> trimesh.Trimesh:
    around, across = 60, 5
    a, y = (
        np.repeat(np.linspace(0, 2 * np.pi, around, endpoint=False), across),
        np.tile(np.linspace(-0.02, 0.02, across), around),
    )
    r = 0.05 + y * np.cos(0.5 * half_turns * a)
    faces = []
    for i, j in np.ndindex(around, across - 1):
        k = i * across + j
        n, m = k + across, k + across + 1
        if i == around - 1:
            n, m = (across - 1 - j, across - 2 - j) if half_turns % 2 else (j, j + 1)
        faces += [[k, n, k + 1], [n, m, k + 1]]
    return _trimesh(np.column_stack((r * np.cos(a), r * np.sin(a), y * np.sin(0.5 * half_turns * a))), faces)


def _noisy(count: int) -> trimesh.Trimesh:
    torus = trimesh.creation.torus(0.05, 0.015, major_sections=count, minor_sections=count // 2)
    torus.vertices += np.random.default_rng(RNG_SEED).normal(scale=2e-4, size=torus.vertices.shape)
    return torus


def _holed(share: float) -> trimesh.Trimesh:
    ball = _ball(4)
    return _trimesh(ball.vertices, ball.faces[np.random.default_rng(RNG_SEED).random(len(ball.faces)) > share])


def _flipped() -> trimesh.Trimesh:
    ball = _ball(3)
    faces = ball.faces.copy()
    some = np.random.default_rng(RNG_SEED).random(len(faces)) < 0.5
    faces[some] = faces[some][:, ::-1]
    return _trimesh(ball.vertices, faces)


def _changed(change: Callable[[trimesh.Trimesh], object]) -> trimesh.Trimesh:
    ball = _ball(3)
    change(ball)
    return ball


def _joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return _trimesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def _square() -> trimesh.Trimesh:
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(0.0, 0.1, 12), np.linspace(0.0, 0.1, 12)))
    k = (np.arange(11)[:, None] * 12 + np.arange(11)).ravel()
    faces = np.concatenate([np.column_stack((k, k + 1, k + 12)), np.column_stack((k + 1, k + 13, k + 12))])
    return _trimesh(np.column_stack((x, y, 0.0 * x)), faces)


MESHES: dict[str, Callable[[], trimesh.Trimesh]] = {
    "soup of 1500 triangles": lambda: _soup(1500),
    "soup of 12 triangles": lambda: _soup(12),
    "spikes": _spiky,
    "ball with shuffled vertices": _shuffled,
    "comb of 118 teeth": _comb,
    "sponge with 400 channels": lambda: _sponge(3),
    "800 separate balls": lambda: _balls(800),
    "Moebius strip": lambda: _strip(1),
    "open ring": lambda: _strip(2),
    "open half sphere": lambda: _ball(4, 0.05).slice_plane([0, 0, 0], [0, 0, -1]),
    "2 million noisy triangles": lambda: _noisy(1400),
    "a tenth of the triangles lost": lambda: _holed(0.1),
    "half of the triangles lost": lambda: _holed(0.5),
    "half of the triangles flipped": _flipped,
    "inside out": lambda: _changed(lambda ball: ball.invert()),
    "in millimetres": lambda: _changed(lambda ball: ball.apply_scale(1000.0)),
    "kilometres large": lambda: _changed(lambda ball: ball.apply_scale(1e5)),
    "micrometres small": lambda: _changed(lambda ball: ball.apply_scale(1e-6)),
    "a kilometre from its origin": lambda: _changed(lambda ball: ball.apply_translation([1e3, 0.0, 0.0])),
    "squashed to 1 nm": lambda: _changed(lambda ball: ball.apply_scale([1.0, 1.0, 1e-8])),
    "flat square": _square,
    "needle": lambda: trimesh.creation.cylinder(radius=1e-5, height=0.2, sections=12),
    "each triangle twice": lambda: _trimesh(_ball().vertices, np.concatenate([_ball().faces, _ball().faces])),
    "two boxes through each other": lambda: _joined(
        trimesh.creation.box((0.04, 0.05, 0.06)),
        trimesh.creation.box((0.04, 0.05, 0.06)).apply_translation((0.01, 0.01, 0.01)),
    ),
    "ball with a scrap beside it": lambda: _joined(_ball(4), _trimesh(0.002 * np.eye(3) + 0.1, [[0, 1, 2]])),
}

FILES: dict[str, tuple[str, bytes]] = {
    "empty file": ("empty.obj", b""),
    "text": ("text.ply", b"this is no mesh\n"),
    "noise": ("noise.stl", np.random.default_rng(RNG_SEED).bytes(50_000)),
    "index out of range": ("range.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
    "not a number": ("nan.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n"),
    "points alone": ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
    "one triangle": ("one.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    "promises 4e9 triangles": ("long.stl", b" " * 80 + (4_000_000_000).to_bytes(4, "little") + b" " * 100),
}


def trial(case: str) -> dict[str, str]:
    """Imports the mesh of a case; what the command said, and its time."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if case in FILES:
            path = folder / FILES[case][0]
            path.write_bytes(FILES[case][1])
        else:
            path = folder / "mesh.ply"
            MESHES[case]().export(path)
        command = [sys.executable, "-m", "xdex_drake", "object", "import", str(path), "--out", name + "/out"]
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        environment = {**os.environ, "XDEX_CACHE": name + "/cache"}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, timeout=300)
        seconds, after = time.monotonic() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
        index = folder / "out" / "index.csv"
        row = next(csv.DictReader(index.open(encoding="utf-8")), None) if index.exists() else None
        said = " ".join((row["repairs"] if row else done.stderr).replace(f"{name}/", "").split())
        clear = done.returncode == 0 or (done.returncode == 2 and "Traceback" not in done.stderr)
        result = ("imported" if done.returncode == 0 else "refused") if clear else f"FAILED {done.returncode}"
        parts = f"{row['parts']} parts, bulge {row['bulge_p99_mm']} mm; " if row and result == "imported" else ""
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return {
            "case": case,
            "result": result,
            "seconds": f"{seconds:.1f}",
            "cpu_seconds": f"{used:.1f}",
            "message": parts + said,
        }


def main() -> None:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("hostile.csv"))
    parser.add_argument("--minutes", type=float, default=1e6, help="begin no further case after this time")
    parser.add_argument("--only", default="", help="cases whose name holds this text")
    arguments = parser.parse_args()
    out, deadline = arguments.out, time.monotonic() + 60.0 * arguments.minutes
    done = {row["case"] for row in csv.DictReader(out.open(encoding="utf-8"))} if out.exists() else set()
    for case in [*MESHES, *FILES]:
        if case in done or arguments.only not in case or time.monotonic() > deadline:
            continue
        row, fresh = trial(case), not out.exists()
        with out.open("a", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(COLUMNS), lineterminator="\n")
            if fresh:
                writer.writeheader()
            writer.writerow(row)


if __name__ == "__main__":
    main()
