"""`xdex view` and `xdex export`: stored grasps are shown and handed to other tools."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TextIO

import tyro

from xdex_drake.cli.output import check_output_file, table
from xdex_drake.whole_file import write_text

if TYPE_CHECKING:
    from xdex_drake.grasp import Grasp
    from xdex_drake.hand.description import Hand
    from xdex_drake.scene.tabletop import Scene

MOST_SHOWN = 20
"""Grasps that `xdex view --all` shows."""


@dataclass(frozen=True)
class View:
    """Stored grasps in Meshcat: one that is lifted, or several side by side with their contacts, cones and forces.

    Without --html, Meshcat shows them live until Enter is pressed; with it, one page is written that needs no network.
    Try `xdex view grasps.parquet`, then `xdex view grasps.parquet --all --html all.html`.

    Attributes:
        file: A file of grasps.
        row: Which grasp, counted from 0; its lift is simulated and played.
        all: Show all grasps instead (the first 20), as they stand.
        html: Write a page instead of showing them live.
    """

    file: tyro.conf.Positional[Path]
    row: int = 0
    all: tyro.conf.FlagCreatePairsOff[bool] = False
    html: Path | None = None

    def run(self) -> int:
        """Shows the grasps, or writes the page."""
        if self.html is not None:
            check_output_file(self.html, ".html")
        from xdex_drake.dataset.files import load_grasps
        from xdex_drake.errors import ConfigError

        stored = load_grasps(self.file)
        if not stored:
            raise ConfigError(f"{self.file}: holds no grasps; make some with `xdex grasp`")
        if not 0 <= self.row < len(stored):
            raise ConfigError(f"--row {self.row}: {self.file} holds {len(stored)} grasps, counted from 0")
        chosen = stored[:MOST_SHOWN] if self.all else stored[self.row : self.row + 1]
        grasps, hands, scenes = zip(*((item.grasp, item.hand, item.scene) for item in chosen), strict=True)
        rows = [
            (grasp.grasp_id, hand.name, scene.object.name, _verdict(grasp))
            for grasp, hand, scene in zip(grasps, hands, scenes, strict=True)
        ]
        print(table(rows, ("grasp", "hand", "object", "lift")), flush=True)
        from xdex_drake.visualization.replay import grasp_page, replay_lift, view_live

        if self.html is None:
            meshcat = view_live(grasps, hands, scenes, replay=not self.all)
            return wait_for_enter(meshcat.web_url())
        page = grasp_page(grasps, hands, scenes) if self.all else replay_lift(grasps[0], hands[0], scenes[0])
        write_text(self.html, page)
        print(f"written to {self.html}")
        return 0


def _verdict(grasp: Grasp) -> str:
    if grasp.lift is None:
        return "not lifted yet"
    return "lifted" if grasp.lift.success else grasp.lift.failure_reason


@dataclass(frozen=True)
class Export:
    """Stored grasps for other tools.

    `json` holds every column, as plain numbers and names, with the unit and the meaning of each. `mujoco` is a folder
    with a scene for each grasp: hand, object and table, ready for `python -m mujoco.viewer --mjcf=GRASP.xml`, with the
    key frames pregrasp, grasp and squeeze.
    Try `xdex export grasps.parquet --out grasps.json`, then
    `xdex export grasps.parquet --format mujoco --out scenes`.

    Attributes:
        file: A file of grasps.
        format: The format.
        out: The file or folder to write; grasps.json or grasps_mujoco in this folder where not given.
    """

    file: tyro.conf.Positional[Path]
    format: Literal["json", "mujoco"] = "json"
    out: Path | None = None

    def run(self) -> int:
        """Writes the file or the folder."""
        return {"json": self._write_json, "mujoco": self._write_scenes}[self.format]()

    def _write_json(self) -> int:
        out = self.out or Path("grasps.json")
        check_output_file(out, ".json")
        from xdex_drake.dataset.grasp_file import read_grasps
        from xdex_drake.dataset.schema import SCHEMA

        rows = read_grasps(self.file)
        columns = {
            column.name: {key.decode(): value.decode() for key, value in (column.metadata or {}).items()}
            for column in SCHEMA
        }
        conventions = {key.decode(): value.decode() for key, value in (SCHEMA.metadata or {}).items()}
        content = {"conventions": conventions, "columns": columns, "grasps": rows}
        write_text(out, json.dumps(_without_nan(content), indent=1, allow_nan=False) + "\n")
        print(f"{len(rows)} grasps: {out}")
        return 0

    def _write_scenes(self) -> int:
        from xdex_drake.dataset.files import load_grasps
        from xdex_drake.errors import ConfigError
        from xdex_drake.simulation.scenes import export_scenes

        stored = load_grasps(self.file)
        if not stored:
            raise ConfigError(f"{self.file}: holds no grasps; make some with `xdex grasp`")
        out = self.out or Path("grasps_mujoco")
        files = export_scenes([(item.grasp, item.hand, item.scene) for item in stored], out)
        print(f"{len(files)} scenes: {out}; try `python -m mujoco.viewer --mjcf={files[0]}`")
        return 0


def _without_nan(value: object) -> object:
    """The same with None for numbers that JSON does not have."""
    if isinstance(value, float):
        return value if value - value == 0.0 else None
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    return value


def write_replays(path: Path, grasps: Sequence[Grasp], hand: Hand, scene: Scene) -> None:
    """Writes pages that replay lifts: one for one grasp, or numbered ones beside it."""
    from xdex_drake.visualization.replay import replay_lift

    for k, grasp in enumerate(grasps):
        target = path if k == 0 else path.with_name(f"{path.stem}-{k}{path.suffix}")
        write_text(target, replay_lift(grasp, hand, scene))


def wait_for_enter(url: str, stream: TextIO = sys.stdin) -> int:
    """Keeps a live Meshcat open until Enter is pressed."""
    print(f"Meshcat shows it at {url}; press Enter to end")
    stream.readline()
    return 0
