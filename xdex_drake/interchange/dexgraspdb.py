"""dexgraspdb/v3 of EquiDexFlow: a JSON file of an object's grasps, with one contact for each of four fingers.

The format carries the grasp alone. The object's pose and `metadata`, where hand, link and joint names are written, are
read by us and not by its own loader.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from scipy.spatial import ConvexHull, QhullError

from xdex_drake.arrays import Array
from xdex_drake.errors import GraspFileError
from xdex_drake.interchange.npz_file import read_json
from xdex_drake.interchange.records import (
    GraspRecord,
    Stage,
    Touching,
    matrix_pose,
    names_of,
    numbers_of,
    pose_of,
)
from xdex_drake.whole_file import write_text

FINGERS = ("thumb", "index", "middle", "ring")
"""Fingers in the order of `contact_finger_ids`."""

JOINTS = 16
"""Number of joints that the format's loader takes."""

MM = 1000.0


def read_dexgraspdb(path: str | Path) -> list[GraspRecord]:
    """Reads a file of grasps.

    Args:
        path: The JSON file.

    Returns:
        The grasps in the order of the file.

    Raises:
        GraspFileError: It cannot be read or is of another format.
    """
    path = Path(path)
    content = read_json(path)
    grasps = content.get("grasps")
    if not isinstance(grasps, list) or not grasps or not isinstance(grasps[0], dict):
        raise GraspFileError(f"{path}: holds no list of grasps with hand_dof_values; name its format by --format")
    return [_record(content, k, entry, f"{path}: grasps[{k}]") for k, entry in enumerate(grasps)]


def _record(content: dict[str, Any], k: int, entry: Any, where: str) -> GraspRecord:
    if not isinstance(entry, dict) or "hand_dof_values" not in entry:
        raise GraspFileError(f"{where}: has no hand_dof_values; without joint values there is no grasp to judge")
    if "wrist_pose_object" not in entry:
        raise GraspFileError(f"{where}: has no wrist_pose_object, and no pose is no grasp; leave it out")
    matrix = numbers_of(entry["wrist_pose_object"], f"{where}.wrist_pose_object", (4, 4))
    values = numbers_of(entry["hand_dof_values"], f"{where}.hand_dof_values", (None,))
    told = entry["metadata"] if isinstance(entry.get("metadata"), dict) else {}
    names = names_of(told["joint_names"], f"{where}.metadata.joint_names") if "joint_names" in told else None
    if names is not None and len(names) != len(values):
        raise GraspFileError(f"{where}: {len(values)} joint values for {len(names)} names")
    scores = {name: entry[name] for name in ("epsilon_quality", "volume_quality", "confidence") if name in entry}
    return GraspRecord(
        name=str(told.get("name", k)),
        grasp=Stage(matrix_pose(matrix, f"{where}.wrist_pose_object"), values),
        joint_names=names,
        frame=str(told.get("frame", "")),
        hand=str(told.get("hand", "")),
        object=str(entry.get("object_name", content.get("object_name", ""))),
        X_WO=_object_pose(entry, where),
        contacts=_contacts(entry, where),
        scores={name: float(numbers_of(value, f"{where}.{name}", ())) for name, value in scores.items()},
    )


def _object_pose(entry: dict[str, Any], where: str) -> RigidTransform | None:
    if not {"object_position_mm", "object_orientation"} <= set(entry):
        return None
    position = numbers_of(entry["object_position_mm"], f"{where}.object_position_mm", (3,)) / MM
    wxyz = numbers_of(entry["object_orientation"], f"{where}.object_orientation", (4,))
    return pose_of(position, wxyz, f"{where}.object_orientation")


def _contacts(entry: dict[str, Any], where: str) -> tuple[Touching, ...]:
    if "contact_points_mm" not in entry or "contact_normals" not in entry:
        return ()
    points = numbers_of(entry["contact_points_mm"], f"{where}.contact_points_mm", (None, 3)) / MM
    normals = numbers_of(entry["contact_normals"], f"{where}.contact_normals", (len(points), 3))
    ids = entry.get("contact_finger_ids")
    fingers = [""] * len(points)
    if isinstance(ids, list) and len(ids) == len(points) and all(i in range(len(FINGERS)) for i in ids):
        fingers = [FINGERS[int(i)] for i in ids]
    return tuple(Touching(finger, p, n) for finger, p, n in zip(fingers, points, normals, strict=True))


def fits(record: GraspRecord) -> bool:
    """Whether the format can hold a grasp: 16 joints, and one contact of each of four fingers."""
    fingers = sorted(contact.finger for contact in record.contacts)
    return len(record.grasp.values) == JOINTS and fingers == sorted(FINGERS)


def write_dexgraspdb(path: str | Path, records: Sequence[GraspRecord]) -> None:
    """Writes grasps of one object.

    Args:
        path: The JSON file; it appears whole or not at all.
        records: The grasps, each of which `fits`, with joint names and the object's pose.

    Raises:
        GraspFileError: They are of several objects, or one does not fit.
        ConfigError: The file cannot be written.
    """
    path, objects = Path(path), {r.object for r in records}
    if len(objects) > 1:
        raise GraspFileError(f"{path}: the format holds grasps of one object; export them file by file")
    for record in records:
        if not fits(record):
            raise GraspFileError(
                f"grasp {record.name}: has {len(record.grasp.values)} joints and {len(record.contacts)} contacts; the "
                f"format takes {JOINTS} joints and one contact of each of {', '.join(FINGERS)}"
            )
    content = {"object_name": objects.pop(), "n_grasps": len(records), "grasps": [_entry(r) for r in records]}
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def _entry(record: GraspRecord) -> dict[str, Any]:
    contacts = sorted(record.contacts, key=lambda contact: FINGERS.index(contact.finger))
    X_WO = RigidTransform() if record.X_WO is None else record.X_WO
    return {
        "object_name": record.object,
        "contact_points_mm": [(MM * contact.p_OC).tolist() for contact in contacts],
        "contact_normals": [contact.n_OC.tolist() for contact in contacts],
        "hand_dof_values": record.grasp.values.tolist(),
        **{key: record.scores.get(key, 0.0) for key in ("epsilon_quality", "volume_quality")},
        "wrist_pose_object": record.grasp.X_OG.GetAsMatrix4().tolist(),
        "contact_finger_ids": list(range(len(contacts))),
        "object_position_mm": (MM * X_WO.translation()).tolist(),
        "object_orientation": X_WO.rotation().ToQuaternion().wxyz().tolist(),
        "confidence": record.scores.get("confidence", 1.0),
        "metadata": {
            "name": record.name,
            "hand": record.hand,
            "frame": record.frame,
            "joint_names": list(record.joint_names or ()),
        },
    }


def polytope_volume(wrenches: Array) -> float:
    """Volume of the hull of wrenches and zero: the format's `volume_quality`.

    Args:
        wrenches: Wrenches of unit normal forces along the edges of the friction pyramids, shape (m, 6).

    Returns:
        The volume, in the wrenches' units; 0 where they span less than six dimensions.
    """
    try:
        return float(ConvexHull(np.vstack([wrenches, np.zeros(6)])).volume)
    except QhullError:
        return 0.0
