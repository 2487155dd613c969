"""Dictionaries of DexGraspBench, BODex, Dexonomy and HUGS: rows x, y, z, qw, qx, qy, qz, then joint values.

Theirs are pickled `.npy` files, read through `plain_pickle`. Ours is the same dictionary with the keys of HUGS's
contract, as a `.npz` archive with the names in a JSON file beside it. Added there: `frame`, the link whose pose the
rows begin with, `hand`, and `squeeze_torque`, which position targets within the joint limits cannot always command.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.errors import GraspFileError
from xdex_drake.interchange.npz_file import read_npz, write_npz
from xdex_drake.interchange.plain_pickle import read_plain_npy
from xdex_drake.interchange.records import GraspRecord, Stage, names_of, numbers_of, pose_of, seven

CONTRACT = "1.0"
"""Version of HUGS's contract whose keys are written."""

STAGES = ("pregrasp", "grasp", "squeeze")

RAW = "robot_pose"
"""BODex's own key, shape (1, N, rows, 7 + n): three rows of `STAGES`, or a motion that ends with these and a lift."""


def read_dexgraspbench(path: str | Path) -> list[GraspRecord]:
    """Reads a dictionary of one grasp, or of several stacked.

    Args:
        path: A `.npy` file that holds a pickled dictionary, or a `.npz` archive with the same keys.

    Returns:
        The grasps in the order of the file.

    Raises:
        GraspFileError: It cannot be read, holds anything but arrays, containers and texts, or is no such dictionary.
    """
    path = Path(path)
    content = read_npz(path) if path.suffix.lower() == ".npz" else read_plain_npy(path)
    if isinstance(content, dict):
        content = {str(key): value for key, value in content.items()}
    if not isinstance(content, dict) or not {"grasp_qpos", RAW} & set(content):
        raise GraspFileError(f"{path}: holds no dictionary with grasp_qpos or {RAW}; name its format by --format")
    rows = _raw_stages(content, str(path)) if "grasp_qpos" not in content else _stages(content, str(path))
    count, width = rows["grasp"].shape
    names = names_of(content["joint_names"], f"{path}: joint_names") if _has(content, "joint_names") else None
    if names is not None and len(names) != width - 7:
        raise GraspFileError(f"{path}: joint_names has {len(names)} names, grasp_qpos {width - 7} joint values")
    poses = _each(content, "obj_pose", count, 7, str(path))
    scales = _scales(content, count, str(path))
    torques = _each(content, "squeeze_torque", count, width - 7, str(path))
    objects, hand = _texts(content, count), str(_text(content.get("hand", content.get("hand_name", ""))))
    success = _each(content, "succ_flag", count, 1, str(path)) if _has(content, "succ_flag") else None
    labels = content.get("names") if isinstance(content.get("names"), list) else None
    records = []
    for k in range(count):
        where = f"{path}: grasp {k}"
        X_WO = None if poses is None else pose_of(poses[k, :3], poses[k, 3:], f"{where}, obj_pose")
        X_OW = RigidTransform() if X_WO is None else X_WO.inverse()
        stages = {
            name: Stage(X_OW @ pose_of(q[k, :3], q[k, 3:7], f"{where}, {name}_qpos"), q[k, 7:])
            for name, q in rows.items()
        }
        records.append(
            GraspRecord(
                name=str(labels[k]) if labels is not None and len(labels) == count else f"{path.stem}-{k}",
                grasp=stages["grasp"],
                pregrasp=stages.get("pregrasp"),
                squeeze=stages.get("squeeze"),
                torques=None if torques is None else torques[k],
                joint_names=names,
                frame=str(_text(content.get("frame", ""))),
                hand=hand,
                object=objects[k],
                scale=None if scales is None else float(scales[k]),
                X_WO=X_WO,
                scores={} if success is None else {"succ_flag": float(success[k, 0])},
            )
        )
    return records


def _has(content: Mapping[str, Any], key: str) -> bool:
    return content.get(key) is not None


def _text(value: Any) -> Any:
    """What a scalar array or a list of one holds."""
    while isinstance(value, np.ndarray | list | tuple) and np.size(np.asarray(value, dtype=object)) == 1:
        value = value.item() if isinstance(value, np.ndarray) else value[0]
    return value if isinstance(value, str) else ""


def _texts(content: Mapping[str, Any], count: int) -> list[str]:
    """The object of each grasp, empty where the file does not tell."""
    value = content.get("obj_path", content.get("object_name", ""))
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list) and len(value) == count and all(isinstance(item, str) for item in value):
        return value
    return [_text(value)] * count


def _stages(content: Mapping[str, Any], where: str) -> dict[str, Array]:
    """Rows of each stage there is, shape (count, 7 + n)."""
    rows: dict[str, Array] = {}
    count = None
    for name in ("grasp", "pregrasp", "squeeze"):
        if not _has(content, f"{name}_qpos"):
            continue
        key = f"{where}: {name}_qpos"
        q = np.asarray(content[f"{name}_qpos"])
        if q.ndim == 3:  # Dexonomy's pre-grasps of one grasp come outermost first.
            q = q[:, -1]
        elif name == "pregrasp" and q.ndim == 2 and count == 1 and len(q) > 1:
            q = q[-1:]
        q = numbers_of(q[None] if q.ndim == 1 else q, key, (count, None))
        if q.shape[1] < 8 or (rows and q.shape[1] != rows["grasp"].shape[1]):
            raise GraspFileError(f"{key}: has rows of {q.shape[1]} numbers; give 7 of the wrist and one a joint")
        rows[name], count = q, len(q)
    return rows


def _raw_stages(content: Mapping[str, Any], where: str) -> dict[str, Array]:
    q = numbers_of(content[RAW], f"{where}: {RAW}", (None, None, None, None))
    q = q.reshape(-1, *q.shape[2:])
    if q.shape[1] < 3 or q.shape[2] < 8:
        raise GraspFileError(f"{where}: {RAW} has shape {q.shape}; give pre-grasp, grasp and squeeze of 7 + n numbers")
    first = 0 if q.shape[1] == 3 else q.shape[1] - 4
    return {name: q[:, first + k] for k, name in enumerate(STAGES)}


def _each(content: Mapping[str, Any], key: str, count: int, width: int, where: str) -> Array | None:
    """Numbers of each grasp, one row for all where the file has one alone; None where it has none."""
    if not _has(content, key):
        return None
    value = np.asarray(content[key])
    if value.dtype.kind == "b":
        value = value.astype(float)
    rows = numbers_of(value.reshape(-1, width), f"{where}: {key}", (None, width)) if value.size % width == 0 else None
    if rows is None:
        raise GraspFileError(f"{where}: {key} has shape {value.shape}; give {width} numbers a grasp")
    if len(rows) not in (1, count):
        raise GraspFileError(f"{where}: {key} has {len(rows)} rows for {count} grasps")
    return np.broadcast_to(rows, (count, rows.shape[1]))


def _scales(content: Mapping[str, Any], count: int, where: str) -> Array | None:
    """Scale of each grasp's mesh, the scene's scale included; it must be the same along all axes."""
    if not _has(content, "obj_scale"):
        return None
    scale = np.asarray(content["obj_scale"], dtype=float)
    scale = scale.reshape(count, -1) if scale.size in (count, 3 * count) else scale.reshape(1, -1)
    scale = numbers_of(scale, f"{where}: obj_scale", (None, None))
    if np.ptp(scale, axis=1).max() > 1e-6 * np.abs(scale).max():
        raise GraspFileError(f"{where}: obj_scale differs along the axes; scale the mesh, and give it by --object")
    if _has(content, "scene_scale"):
        scale = scale * numbers_of(np.ravel(content["scene_scale"])[:, None], f"{where}: scene_scale", (None, 1))
    return np.broadcast_to(scale[:, 0], (count,))


def write_dexgraspbench(path: str | Path, records: Sequence[GraspRecord]) -> None:
    """Writes grasps by one hand as `.npz`, with names in a JSON file beside it.

    Args:
        path: The `.npz` file.
        records: The grasps, all with pre-grasp and squeeze, joint names and the object's pose.

    Raises:
        GraspFileError: They are by several hands, or lack one of these.
        ConfigError: A file cannot be written.
    """
    path, first = Path(path), records[0]
    if len({(r.hand, r.frame, r.joint_names) for r in records}) > 1:
        raise GraspFileError(f"{path}: the format holds grasps by one hand; export them file by file")
    for r in records:
        if r.pregrasp is None or r.squeeze is None or r.X_WO is None or r.joint_names is None:
            raise GraspFileError(f"grasp {r.name}: it has no pre-grasp, squeeze or pose of the object; the format asks")
    arrays: dict[str, Any] = {f"{name}_qpos": np.array([_row(r, getattr(r, name)) for r in records]) for name in STAGES}
    arrays["obj_pose"] = np.array([seven(_pose(r)) for r in records])
    arrays["obj_scale"] = np.array([1.0 if r.scale is None else r.scale for r in records])
    if all(r.torques is not None for r in records):
        arrays["squeeze_torque"] = np.array([r.torques for r in records])
    if all("confidence" in r.scores for r in records):
        arrays["succ_flag"] = np.array([r.scores["confidence"] > 0.5 for r in records])
    beside = {
        "bench_contract_version": CONTRACT,
        "joint_names": list(first.joint_names or ()),
        "obj_path": [r.object for r in records],
        "names": [r.name for r in records],
        "hand": first.hand,
        "frame": first.frame,
    }
    write_npz(path, arrays, beside)


def _pose(record: GraspRecord) -> RigidTransform:
    return RigidTransform() if record.X_WO is None else record.X_WO


def _row(record: GraspRecord, stage: Stage) -> Array:
    return np.concatenate([seven(_pose(record) @ stage.X_OG), stage.values])
