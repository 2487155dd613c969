"""`xdex export`: stored grasps are handed to other tools."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from xdex_drake.cli.output import check_output_file, check_writable
from xdex_drake.whole_file import write_text

if TYPE_CHECKING:
    from xdex_drake.dataset.files import StoredGrasp

OUTPUT = {
    "json": "grasps.json",
    "isaac_grasp": "grasps.yaml",
    "dexgraspbench": "grasps.npz",
    "dexgraspdb": "grasps.json",
    "arrays": "grasps.npz",
    "mujoco": "grasps_mujoco",
    "urdf": "grasps_urdf",
}
"""Where each format is written unless told otherwise; what ends in no suffix is a folder."""


@dataclass(frozen=True)
class Export:
    """Stored grasps for other tools, or for a robot.

    json: every column in plain numbers and names, and for each grasp its execution, waypoints from the approach to the
    lift with times, base-link poses, joint positions, torques and gains.

    isaac_grasp: YAML 1.0 of Isaac and GraspGen; squeeze and object pose are extra keys that they pass over.

    dexgraspbench: arrays with the keys of DexGraspBench and HUGS, as .npz with names in a .json beside.

    dexgraspdb: JSON v3 of EquiDexFlow; grasps with one contact of each of four fingers, by hands of 16 joints.

    arrays: .npz of joint values and poses, with names in a .json beside.

    mujoco: a folder with a scene a grasp, ready for `python -m mujoco.viewer --mjcf=GRASP.xml`, with the key frames
    pregrasp, grasp and squeeze, and execution.json.

    urdf: a folder with hand and objects as URDF, and execution.json.

    Files of poses are of the hand's base link, which is named there; `xdex judge` reads these four formats again.
    Try `xdex export grasps.parquet --out grasps.json`, then
    `xdex export grasps.parquet --format mujoco --out scenes`.

    Attributes:
        file: A file of grasps.
        format: The format.
        out: The file or folder to write; grasps.SUFFIX or grasps_FORMAT in this folder where not given.
    """

    file: tyro.conf.Positional[Path]
    format: Literal["json", "isaac_grasp", "dexgraspbench", "dexgraspdb", "arrays", "mujoco", "urdf"] = "json"
    out: Path | None = None

    def run(self) -> int:
        """Writes the file or the folder."""
        out = self.out or Path(OUTPUT[self.format])
        suffix = Path(OUTPUT[self.format]).suffix
        if suffix:
            check_output_file(out, suffix)
        else:
            check_writable(out / "x")
        from xdex_drake.dataset.files import load_grasps
        from xdex_drake.errors import ConfigError

        stored = load_grasps(self.file)
        if not stored:
            raise ConfigError(f"{self.file}: holds no grasps; make some with `xdex grasp`")
        if self.format == "json":
            _write_json(out, stored)
        elif self.format == "mujoco":
            _write_scenes(out, stored)
        elif self.format == "urdf":
            _write_urdf(out, stored)
        else:
            _write_records(out, self.format, stored)
        return 0


def _write_json(out: Path, stored: Sequence[StoredGrasp]) -> None:
    from xdex_drake.dataset.schema import SCHEMA

    columns = {
        column.name: {key.decode(): value.decode() for key, value in (column.metadata or {}).items()}
        for column in SCHEMA
    }
    conventions = {key.decode(): value.decode() for key, value in (SCHEMA.metadata or {}).items()}
    rows = [item.row for item in stored]
    content = {"conventions": conventions, "columns": columns, "grasps": rows, "execution": _packages(stored)}
    write_text(out, json.dumps(_without_nan(content), indent=1, allow_nan=False) + "\n")
    print(f"{len(stored)} grasps: {out}")


def _packages(stored: Sequence[StoredGrasp]) -> list[dict[str, Any] | None]:
    """How each grasp is played; None where it has no pre-grasp or squeeze."""
    from xdex_drake.grasping.execution import execution_package

    ready = [item.grasp.tau_squeeze is not None and item.grasp.q_pregrasp is not None for item in stored]
    return [
        execution_package(item.grasp, item.hand, item.scene) if playable else None
        for item, playable in zip(stored, ready, strict=True)
    ]


def _write_scenes(out: Path, stored: Sequence[StoredGrasp]) -> None:
    from xdex_drake.simulation.scenes import export_scenes

    files = export_scenes([(item.grasp, item.hand, item.scene) for item in stored], out)
    _write_execution(out, stored)
    print(f"{len(files)} scenes: {out}; try `python -m mujoco.viewer --mjcf={files[0]}`")


def _write_urdf(out: Path, stored: Sequence[StoredGrasp]) -> None:
    from xdex_drake.interchange.objects import export_object
    from xdex_drake.interchange.parts import file_name
    from xdex_drake.interchange.urdf import export_urdf

    hands = {item.hand.name: item.hand for item in stored}
    objects = {item.scene.object.digest: item.scene.object for item in stored}
    files = [export_urdf(hand, out / file_name(name)) for name, hand in hands.items()]
    files += [export_object(thing, out / file_name(thing.name)) for thing in objects.values()]
    _write_execution(out, stored)
    print(f"{len(stored)} grasps: {out / 'execution.json'}, with {', '.join(str(file) for file in files)}")


def _write_execution(out: Path, stored: Sequence[StoredGrasp]) -> None:
    text = json.dumps(_without_nan({"grasps": _packages(stored)}), indent=1, allow_nan=False)
    write_text(out / "execution.json", text + "\n")


def _write_records(out: Path, format: str, stored: Sequence[StoredGrasp]) -> None:
    from xdex_drake.errors import ConfigError
    from xdex_drake.interchange.dexgraspdb import fits
    from xdex_drake.interchange.formats import FORMATS
    from xdex_drake.interchange.naming import record_of

    form = FORMATS[format]
    records = [record_of(item.grasp, item.hand, item.scene, all_joints=form.all_joints) for item in stored]
    kept = [record for record in records if format != "dexgraspdb" or fits(record)]
    if not kept:
        raise ConfigError(
            f"{out}: none of {len(records)} grasps has 16 joints and one contact of each of thumb, index, middle and "
            "ring; choose another --format"
        )
    form.write(out, kept)
    rest = len(records) - len(kept)
    told = f"; {rest} left out, which do not touch by four fingers once each" if rest else ""
    print(f"{len(kept)} grasps: {out}{told}")


def _without_nan(value: object) -> object:
    """The same with None for numbers that JSON does not have."""
    if isinstance(value, float):
        return value if value - value == 0.0 else None
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    return value
