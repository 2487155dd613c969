"""Splits a mesh into convex parts in a process of its own, within limits of time and memory.

The libraries that split and mend meshes end the process, or do not return, on some broken input. Time is counted on the
processor, so that a busy machine changes no result; a wall limit ends what waits for nothing.
"""

import ctypes
import logging
import os
import resource
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import ObjectFileError
from xdex_drake.mesh_file import Faces
from xdex_drake.scene.distance import Part
from xdex_drake.scene.splitting import TooDetailed, refine, split, split_coarsely

_log = logging.getLogger(__name__)

FINE_CPU_S = 60.0
"""Processor time of the fine split (the longest of the everyday meshes measured took 50 s) [s]."""

FINE_WALL_S = 130.0
"""Time by the clock of the same [s]."""

COARSE_CPU_S = 14.0
"""Processor time of the coarser split, for what is hardly an object and where the fine one was not enough [s]."""

COARSE_WALL_S = 22.0
"""Time by the clock of the same [s]: with what comes before, an unlikely mesh takes about 30 s at most."""

MEMORY_BYTES = 6_000_000_000
COARSELY = "split coarsely"

PR_SET_PDEATHSIG = 1
"""Number of a process's wish to be told of its parent's end (prctl)."""


def split_in_process(vertices: Array, faces: Faces, *, likely: bool) -> tuple[tuple[Part, ...], str]:
    """Splits a mesh, coarsely where the fine way crashes or takes too long.

    Args:
        vertices: Vertices [m], shape (n, 3).
        faces: Outward triangles, shape (m, 3).
        likely: Whether the mesh looks like one of an object, which is worth more time; others are split coarsely.

    Returns:
        The parts, and a sentence where they are the coarser ones, else empty.

    Raises:
        ObjectFileError: No way gives parts; the message does not name the file.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.savez(folder / "mesh.npz", vertices=vertices, faces=faces)
        reason = "the mesh is much folded or broken"
        if likely:
            failure = _run(folder, "fine", FINE_CPU_S, FINE_WALL_S)
            if not failure or (folder / "fine.npz").exists():  # Parts that were to be refined are good enough.
                return _read(folder / "fine.npz"), ""
            reason = f"the fine way {failure}"
        _log.warning("a mesh of %d triangles is split coarsely, as %s", len(faces), reason)
        failure = _run(folder, "coarse", COARSE_CPU_S, COARSE_WALL_S)
        if not failure:
            return _read(folder / "coarse.npz"), f"{COARSELY}, as {reason}"
    raise ObjectFileError(f"cannot be split into convex parts: it {failure}; repair or simplify the mesh")


def _run(folder: Path, way: str, cpu_s: float, wall_s: float) -> str:
    """Runs the child; the reason why it failed, empty where it did not.

    Raises:
        ObjectFileError: The child says what is wrong with the mesh.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-m", "xdex_drake.scene.split_process", str(folder), way, str(cpu_s)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=wall_s, check=False, env=environment, text=True)
    except subprocess.TimeoutExpired:
        return f"took more than {wall_s:g} s"
    if done.returncode == 0:
        return ""
    if (message := folder / "error.txt").exists():
        raise ObjectFileError(message.read_text(encoding="utf-8"))
    if way == "fine" and (message := folder / "detail.txt").exists():
        return message.read_text(encoding="utf-8")
    if -done.returncode in (24, 9):  # SIGXCPU, SIGKILL
        return f"took more than {cpu_s:g} s of processor time"
    _log.info("the splitting process ended with %d: %s", done.returncode, done.stderr[-2000:])
    return "ended its process" if done.returncode < 0 else "failed"


def _read(file: Path) -> tuple[Part, ...]:
    with np.load(file) as arrays:
        return tuple((arrays[f"v{k}"], arrays[f"f{k}"]) for k in range(len(arrays.files) // 2))


def _limit(kind: int, value: int) -> None:
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))


def _end_with_parent() -> None:
    """Has the system end this process when its parent ends, as where a time limit ends that one."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def main() -> None:
    """The child: reads `mesh.npz` of a folder and writes the parts beside it."""
    folder, way, cpu_s = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    _end_with_parent()
    _limit(resource.RLIMIT_CPU, round(cpu_s + 2.0))  # Two seconds for what was imported.
    _limit(resource.RLIMIT_CORE, 0)
    if sys.platform.startswith("linux"):
        _limit(resource.RLIMIT_AS, MEMORY_BYTES)
    with np.load(folder / "mesh.npz") as arrays:
        vertices, faces = arrays["vertices"], arrays["faces"]
    try:
        parts = (split if way == "fine" else split_coarsely)(vertices, faces)
    except ObjectFileError as error:
        (folder / "error.txt").write_text(str(error), encoding="utf-8")
        sys.exit(1)
    except TooDetailed as error:
        (folder / "detail.txt").write_text(str(error), encoding="utf-8")
        sys.exit(1)
    _write(folder / f"{way}.npz", parts)
    if way == "fine":
        try:
            _write(folder / "fine.npz", refine(vertices, faces, parts))
        except ObjectFileError as error:
            _log.info("parts are left as they are: %s", error)


def _write(file: Path, parts: tuple[Part, ...]) -> None:
    """Writes parts, whole or not at all: the process may be ended at any time."""
    arrays = {f"{label}{k}": part[i] for k, part in enumerate(parts) for i, label in enumerate("vf")}
    unfinished = file.with_suffix(".part.npz")
    np.savez(unfinished, **arrays)  # pyright: ignore[reportArgumentType]
    unfinished.replace(file)


if __name__ == "__main__":
    main()
