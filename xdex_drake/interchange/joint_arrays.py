"""Archives of plain arrays, for tools that have no format of their own.

`joint_names`, `q` (n, m) and `X_OG` (n, 4, 4) or (n, 7) with w, x, y, z are asked for; `q_pregrasp`, `X_OG_pregrasp`,
`q_squeeze`, `tau_squeeze`, `X_WO`, `frame`, `hand`, `object`, `scale` and `names` may be there.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.errors import GraspFileError
from xdex_drake.interchange.npz_file import read_npz, write_npz
from xdex_drake.interchange.records import GraspRecord, Stage, matrix_pose, names_of, numbers_of, pose_of


def read_joint_arrays(path: str | Path) -> list[GraspRecord]:
    """Reads an archive.

    Args:
        path: The `.npz` file.

    Returns:
        The grasps in the order of the rows.

    Raises:
        GraspFileError: It cannot be read, or lacks an array.
    """
    path = Path(path)
    content = read_npz(path)
    if missing := sorted({"q", "X_OG"} - set(content)):
        raise GraspFileError(f"{path}: has no array {missing[0]!r}; give q (n, m) and X_OG (n, 4, 4) or (n, 7)")
    q = numbers_of(content["q"], f"{path}: q", (None, None))
    count, width = q.shape
    names = names_of(content["joint_names"], f"{path}: joint_names") if "joint_names" in content else None
    if names is not None and len(names) != width:
        raise GraspFileError(f"{path}: {len(names)} joint_names for rows of {width} joint values")
    X_OGs = _poses(content["X_OG"], count, f"{path}: X_OG")

    def stage(name: str) -> list[Stage] | None:
        if f"q_{name}" not in content:
            return None
        values = numbers_of(content[f"q_{name}"], f"{path}: q_{name}", (count, width))
        key = f"X_OG_{name}"
        poses = _poses(content[key], count, f"{path}: {key}") if key in content else X_OGs
        return [Stage(X, row) for X, row in zip(poses, values, strict=True)]

    pregrasps, squeezes = stage("pregrasp"), stage("squeeze")
    X_WOs = _poses(content["X_WO"], count, f"{path}: X_WO") if "X_WO" in content else None
    torques = (
        numbers_of(content["tau_squeeze"], f"{path}: tau_squeeze", (count, width)) if "tau_squeeze" in content else None
    )
    scales = numbers_of(np.ravel(content["scale"]), f"{path}: scale", (None,)) if "scale" in content else None
    texts = {key: _column(content, key, count, path) for key in ("frame", "hand", "object", "names")}
    return [
        GraspRecord(
            name=texts["names"][k] or f"{path.stem}-{k}",
            grasp=Stage(X_OGs[k], q[k]),
            pregrasp=None if pregrasps is None else pregrasps[k],
            squeeze=None if squeezes is None else squeezes[k],
            torques=None if torques is None else torques[k],
            joint_names=names,
            frame=texts["frame"][k],
            hand=texts["hand"][k],
            object=texts["object"][k],
            scale=None if scales is None else float(scales[k % len(scales)]),
            X_WO=None if X_WOs is None else X_WOs[k],
        )
        for k in range(count)
    ]


def _column(content: dict[str, Any], key: str, count: int, path: Path) -> list[str]:
    """Texts, one a grasp or one for all; empty where there are none."""
    values = np.ravel(np.asarray(content.get(key, ""))).tolist()
    if len(values) not in (1, count) or not all(isinstance(value, str) for value in values):
        raise GraspFileError(f"{path}: {key} holds no text for each grasp, or for all; give one or {count}")
    return values if len(values) == count else values * count


def _poses(value: Any, count: int, where: str) -> list[RigidTransform]:
    if np.ndim(value) == 3:
        return [matrix_pose(X, f"{where}[{k}]") for k, X in enumerate(numbers_of(value, where, (count, 4, 4)))]
    rows = numbers_of(value, where, (count, 7))
    return [pose_of(row[:3], row[3:], f"{where}[{k}]") for k, row in enumerate(rows)]


def write_joint_arrays(path: str | Path, records: Sequence[GraspRecord]) -> None:
    """Writes grasps by one hand; what one of them lacks is left out for all.

    Args:
        path: The `.npz` file.
        records: The grasps, with joint names.

    Raises:
        GraspFileError: They are by several hands, or their joints have no names.
        ConfigError: A file cannot be written.
    """
    path, first = Path(path), records[0]
    if len({(r.hand, r.frame, r.joint_names) for r in records}) > 1 or first.joint_names is None:
        raise GraspFileError(f"{path}: the format holds grasps by one hand, its joints by name; export file by file")
    matrices = lambda poses: np.array([X.GetAsMatrix4() for X in poses])  # noqa: E731
    arrays: dict[str, Array] = {
        "q": np.array([r.grasp.values for r in records]),
        "X_OG": matrices([r.grasp.X_OG for r in records]),
    }
    for name in ("pregrasp", "squeeze"):
        stages = [stage for r in records if (stage := getattr(r, name)) is not None]
        if len(stages) == len(records):
            arrays |= {f"q_{name}": np.array([s.values for s in stages])}
            arrays |= {f"X_OG_{name}": matrices([s.X_OG for s in stages])}
    torques = [r.torques for r in records if r.torques is not None]
    if len(torques) == len(records):
        arrays["tau_squeeze"] = np.array(torques)
    X_WOs = [r.X_WO for r in records if r.X_WO is not None]
    if len(X_WOs) == len(records):
        arrays["X_WO"] = matrices(X_WOs)
    if all(r.scale is not None for r in records):
        arrays["scale"] = np.array([r.scale for r in records], dtype=float)
    beside = {
        "joint_names": list(first.joint_names),
        "frame": first.frame,
        "hand": first.hand,
        "object": [r.object for r in records],
        "names": [r.name for r in records],
    }
    write_npz(path, arrays, beside)
