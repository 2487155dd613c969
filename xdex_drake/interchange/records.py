"""Grasps as other tools store them: poses of some frame of a hand in the object's frame, joints by name or by order.

Readers and writers of all formats share this value and know no hand; `naming` makes our grasps of it, and back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.errors import GraspFileError

MAX_BYTES = 256_000_000
"""Size of the largest file of another tool that is read, unpacked [bytes]."""

UNIT_TOLERANCE = 1e-3
"""How far a quaternion's norm may be from one, or R R^T from the identity: float32 files, and digits left out."""


@dataclass(frozen=True, eq=False)
class Stage:
    """The hand at one moment of a grasp.

    Attributes:
        X_OG: Pose of the file's gripper frame G in the object frame.
        values: Joint values [rad or m], in the order of the record's `joint_names`, shape (m,).
    """

    X_OG: RigidTransform
    values: Array


@dataclass(frozen=True, eq=False)
class Touching:
    """A contact as files tell it.

    Attributes:
        finger: Name of the finger, empty where the file does not tell.
        p_OC: Point in O [m], shape (3,).
        n_OC: Unit normal in O, into the object, shape (3,).
    """

    finger: str
    p_OC: Array
    n_OC: Array


@dataclass(frozen=True, eq=False)
class GraspRecord:
    """A grasp as a file holds it; what a format does not carry is None or empty.

    Attributes:
        name: Its name in the file.
        grasp: The hand while it touches.
        pregrasp: The open hand before.
        squeeze: Targets of a squeeze by positions; their pose is the wrist's target.
        torques: Torques of the squeeze [N m or N], zero for joints without an actuator, shape (m,).
        joint_names: Names of the joints, in the order of all values.
        frame: The link whose frame is G.
        hand: Name of the hand.
        object: Name of the object, or a path as the file has it.
        scale: Factor from the mesh's unit to metres.
        X_WO: Pose of the object in the world.
        contacts: The contacts.
        scores: Numbers about the grasp, by the format's names.
    """

    name: str
    grasp: Stage
    pregrasp: Stage | None = None
    squeeze: Stage | None = None
    torques: Array | None = None
    joint_names: tuple[str, ...] | None = None
    frame: str = ""
    hand: str = ""
    object: str = ""
    scale: float | None = None
    X_WO: RigidTransform | None = None
    contacts: tuple[Touching, ...] = ()
    scores: Mapping[str, float] = field(default_factory=dict)


def numbers_of(value: Any, where: str, shape: tuple[int | None, ...]) -> Array:
    """Finite numbers of a shape.

    Args:
        value: An array of numbers, or nested lists of them.
        where: File and field, for the message.
        shape: The shape; None for any length.

    Returns:
        The numbers.

    Raises:
        GraspFileError: They are not such numbers.
    """
    try:
        kind = np.asarray(value)
        numbers = kind.astype(np.float64) if kind.dtype.kind in "iuf" else None
    except (ValueError, TypeError, OverflowError):
        numbers = None
    wanted = " x ".join("any" if n is None else str(n) for n in shape) or "one"
    if numbers is None:
        raise GraspFileError(f"{where}: holds no plain numbers; give {wanted} of them")
    if numbers.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, numbers.shape, strict=True)):
        raise GraspFileError(f"{where}: has shape {numbers.shape}; give {wanted} numbers")
    if not np.isfinite(numbers).all():
        raise GraspFileError(f"{where}: holds a number that is not finite; leave that grasp out")
    return numbers


def pose_of(position: Array, wxyz: Array, where: str) -> RigidTransform:
    """A pose of a position [m] and a quaternion; a GraspFileError where its norm is not one."""
    norm = float(np.linalg.norm(wxyz))
    if abs(norm - 1.0) > UNIT_TOLERANCE:
        raise GraspFileError(f"{where}: its quaternion has length {norm:.4g}, not 1; give w, x, y, z of a rotation")
    return RigidTransform(RotationMatrix(Quaternion(wxyz / norm)), position)


def matrix_pose(matrix: Array, where: str) -> RigidTransform:
    """A pose of a 4 x 4 matrix; a GraspFileError where it is none."""
    R = matrix[:3, :3]
    rigid = np.abs(R @ R.T - np.eye(3)).max() <= UNIT_TOLERANCE and np.linalg.det(R) > 0.0
    if not rigid or np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > UNIT_TOLERANCE:
        raise GraspFileError(f"{where}: is no pose, a rotation and a translation over 0 0 0 1; check rows and columns")
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), matrix[:3, 3])


def seven(X: RigidTransform) -> Array:
    """A pose as x, y, z [m], qw, qx, qy, qz with qw >= 0, shape (7,)."""
    wxyz = X.rotation().ToQuaternion().wxyz()
    return np.concatenate([X.translation(), wxyz if wxyz[0] >= 0.0 else -wxyz])


def text_of(path: Path) -> str:
    """The text of a file that is not too large; a GraspFileError otherwise."""
    check_size(path)
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise GraspFileError(f"{path}: cannot be read as text ({error}); give a UTF-8 file") from None


def check_size(path: Path) -> None:
    """Refuses a file that is missing or too large."""
    try:
        size = path.stat().st_size
    except OSError as error:
        raise GraspFileError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    if not path.is_file():
        raise GraspFileError(f"{path}: is no file; give the path of a file of grasps")
    if size > MAX_BYTES:
        raise GraspFileError(f"{path}: has {size / 1e6:.0f} MB, more than {MAX_BYTES / 1e6:.0f}; split it")


def names_of(value: Any, where: str) -> tuple[str, ...]:
    """A list of different names; a GraspFileError where it is none."""
    values = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(values, list) and values and all(isinstance(row, list) for row in values):
        values = values[0]  # Collected sets repeat the names for each grasp.
    if not isinstance(values, Sequence) or isinstance(values, str) or not all(isinstance(v, str) for v in values):
        raise GraspFileError(f"{where}: is no list of names; give the joints' names in their order")
    if len(set(values)) != len(values):
        raise GraspFileError(f"{where}: names a joint twice; each joint has one value")
    return tuple(values)
