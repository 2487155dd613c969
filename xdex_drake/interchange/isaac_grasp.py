"""The format isaac_grasp 1.0: a YAML file of grasps of one object, gripper in object, joints by name.

What Isaac's reader ignores is written beside what it reads: `squeeze_cspace_position` and `squeeze_effort`,
`pregrasp_position` and `pregrasp_orientation` (as GraspDataGen has them), and the object's pose in the world as
`object_position` and `object_orientation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.errors import GraspFileError
from xdex_drake.interchange.records import GraspRecord, Stage, numbers_of, pose_of, text_of
from xdex_drake.typed_yaml import plain_yaml
from xdex_drake.whole_file import write_text

FORMAT, VERSION = "isaac_grasp", 1.0


def read_isaac_grasp(path: str | Path) -> list[GraspRecord]:
    """Reads a file of grasps.

    Args:
        path: The YAML file.

    Returns:
        The grasps in the order of the file.

    Raises:
        GraspFileError: It cannot be read or is of another format.
    """
    path = Path(path)
    content = plain_yaml(text_of(path), str(path), error=GraspFileError, mend="this is no file of grasps")
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise GraspFileError(f"{path}: its first line is not `format: {FORMAT}`; name its format by --format")
    try:
        version = float(content.get("format_version", VERSION))
    except (TypeError, ValueError):
        version = float("nan")
    if version != VERSION:
        raise GraspFileError(f"{path}: format_version is {content['format_version']!r}; version {VERSION} is read")
    grasps = content.get("grasps")
    if not isinstance(grasps, dict) or not grasps:
        raise GraspFileError(f"{path}: grasps is no mapping from names to grasps; it holds nothing to judge")
    return [_record(content, str(name), entry, f"{path}: grasps.{name}") for name, entry in grasps.items()]


def _record(content: dict[str, Any], name: str, entry: Any, where: str) -> GraspRecord:
    if not isinstance(entry, dict):
        raise GraspFileError(f"{where} is no mapping; give position, orientation and joints")
    joints = entry.get("cspace_position")
    if not isinstance(joints, dict) or not joints:
        raise GraspFileError(f"{where} has no cspace_position; without joint values there is no grasp to judge")
    names = tuple(str(joint) for joint in joints)
    X_OG = _pose(entry, "", where)

    def stage(name: str) -> Stage | None:
        if f"{name}_cspace_position" not in entry:
            return None
        X = _pose(entry, f"{name}_", where) if f"{name}_position" in entry else X_OG
        return Stage(X, _values(entry, f"{name}_cspace_position", names, where))

    scale = content.get("object_scale")
    confidence = entry.get("confidence")
    scores = {} if confidence is None else {"confidence": float(_numbers(confidence, f"{where}.confidence", ()))}
    return GraspRecord(
        name=name,
        grasp=Stage(X_OG, _values(entry, "cspace_position", names, where)),
        pregrasp=stage("pregrasp"),
        squeeze=stage("squeeze"),
        torques=_values(entry, "squeeze_effort", names, where) if "squeeze_effort" in entry else None,
        joint_names=names,
        frame=str(content.get("gripper_frame_link") or content.get("gripper_frame") or "").rsplit("/", 1)[-1],
        hand=str(content.get("hand", "")),
        object=str(content.get("object_file") or content.get("object_frame") or ""),
        scale=None if scale is None else float(_numbers(scale, f"{where}: object_scale", ())),
        X_WO=_pose(entry, "object_", where) if "object_position" in entry else None,
        scores=scores,
    )


def _numbers(value: Any, where: str, shape: tuple[int, ...]) -> Array:
    """Numbers, which some writers and YAML 1.1's reading of 1e-05 leave as texts."""
    try:
        value = [float(v) for v in value] if isinstance(value, list) else float(value)
    except (TypeError, ValueError):
        raise GraspFileError(f"{where}: is {value!r:.60}; give numbers") from None
    return numbers_of(value, where, shape)


def _pose(entry: dict[str, Any], stage: str, where: str) -> RigidTransform:
    orientation = entry.get(f"{stage}orientation")
    if not isinstance(orientation, dict) or set(orientation) != {"w", "xyz"}:
        raise GraspFileError(f"{where}.{stage}orientation: give {{w: ..., xyz: [...]}}")
    position = _numbers(entry.get(f"{stage}position"), f"{where}.{stage}position", (3,))
    wxyz = (
        _numbers(orientation["w"], f"{where}.{stage}orientation.w", ()),
        _numbers(orientation["xyz"], f"{where}.{stage}orientation.xyz", (3,)),
    )
    return pose_of(position, np.append(*wxyz), f"{where}.{stage}orientation")


def _values(entry: dict[str, Any], key: str, names: Sequence[str], where: str) -> Array:
    values = entry[key]
    if not isinstance(values, dict) or {str(joint) for joint in values} != set(names):
        raise GraspFileError(f"{where}.{key}: names other joints than cspace_position; give a value for each of them")
    named = {str(joint): value for joint, value in values.items()}
    return _numbers([named[joint] for joint in names], f"{where}.{key}", (len(names),))


def write_isaac_grasp(path: str | Path, records: Sequence[GraspRecord]) -> None:
    """Writes grasps of one object by one hand.

    Args:
        path: The YAML file; it appears whole or not at all.
        records: The grasps, with joint names.

    Raises:
        GraspFileError: They are of several objects or hands, which the format cannot hold.
        ConfigError: The file cannot be written.
    """
    path, first = Path(path), records[0]
    shared = {(r.object, r.hand, r.frame, r.scale) for r in records}
    if len(shared) > 1:
        raise GraspFileError(f"{path}: the format holds grasps of one object by one hand; export them file by file")
    content: dict[str, Any] = {
        "format": FORMAT,
        "format_version": VERSION,
        "object_frame": Path(first.object).stem,
        "gripper_frame": first.frame,
        "hand": first.hand,
        "object_file": first.object,
        "object_scale": first.scale,
    }
    content = {key: value for key, value in content.items() if value not in ("", None)}
    content["grasps"] = {f"grasp_{k}" if not r.name else r.name: _entry(r) for k, r in enumerate(records)}
    dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    write_text(path, yaml.dump(content, Dumper=dumper, sort_keys=False, default_flow_style=None, width=120))


def _entry(record: GraspRecord) -> dict[str, Any]:
    if record.joint_names is None:
        raise GraspFileError(f"grasp {record.name}: its joints have no names, which the format asks for")
    entry: dict[str, Any] = {"confidence": record.scores.get("confidence", 1.0), **_posed(record.grasp.X_OG, "")}
    entry["cspace_position"] = _named(record.joint_names, record.grasp.values)
    for name, stage in (("pregrasp", record.pregrasp), ("squeeze", record.squeeze)):
        if stage is not None:
            entry[f"{name}_cspace_position"] = _named(record.joint_names, stage.values)
            entry |= _posed(stage.X_OG, f"{name}_")
    if record.torques is not None:
        entry["squeeze_effort"] = _named(record.joint_names, record.torques)
    if record.X_WO is not None:
        entry |= _posed(record.X_WO, "object_")
    return entry


def _posed(X: RigidTransform, stage: str) -> dict[str, Any]:
    w, *xyz = X.rotation().ToQuaternion().wxyz().tolist()
    return {f"{stage}position": X.translation().tolist(), f"{stage}orientation": {"w": w, "xyz": xyz}}


def _named(names: Sequence[str], values: Array) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))
