"""Files of grasps of other tools, by the name of their format."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from xdex_drake.errors import GraspFileError
from xdex_drake.interchange.dexgraspbench import read_dexgraspbench, write_dexgraspbench
from xdex_drake.interchange.dexgraspdb import read_dexgraspdb, write_dexgraspdb
from xdex_drake.interchange.isaac_grasp import read_isaac_grasp, write_isaac_grasp
from xdex_drake.interchange.joint_arrays import read_joint_arrays, write_joint_arrays
from xdex_drake.interchange.npz_file import read_npz
from xdex_drake.interchange.records import GraspRecord


@dataclass(frozen=True)
class Format:
    """A file format.

    Attributes:
        suffixes: What its files end in; the first is written.
        read: Reads a file.
        write: Writes a file.
        all_joints: Whether coupled joints are listed, too.
        kp: Gain of the joints that its squeeze by positions is for [N m/rad].
    """

    suffixes: tuple[str, ...]
    read: Callable[[Path], list[GraspRecord]]
    write: Callable[[Path, Sequence[GraspRecord]], None]
    all_joints: bool = False
    kp: float = 1.0


FORMATS = {
    "isaac_grasp": Format((".yaml", ".yml"), read_isaac_grasp, write_isaac_grasp),
    "dexgraspbench": Format((".npz", ".npy"), read_dexgraspbench, write_dexgraspbench, all_joints=True, kp=5.0),
    "dexgraspdb": Format((".json",), read_dexgraspdb, write_dexgraspdb),
    "arrays": Format((".npz",), read_joint_arrays, write_joint_arrays),
}
"""The formats by their names."""


def format_of(path: Path) -> str:
    """Name of a file's format, by its suffix, and by what a `.npz` archive holds; a GraspFileError where none fits."""
    suffix = path.suffix.lower()
    names = [name for name, format in FORMATS.items() if suffix in format.suffixes]
    if not names:
        known = ", ".join(sorted({end for format in FORMATS.values() for end in format.suffixes}))
        raise GraspFileError(f"{path}: no format has files that end in {suffix or 'nothing'}; known are {known}")
    if suffix == ".npz":
        return "dexgraspbench" if {"grasp_qpos", "robot_pose"} & set(read_npz(path)) else "arrays"
    return names[0]
