"""`xdex view` and `xdex export`: stored grasps are shown and handed to other tools."""

from __future__ import annotations

import json
import os
import secrets
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TextIO

import tyro

from xdex_drake.cli.output import check_output_file, table

if TYPE_CHECKING:
    from xdex_drake.grasp import Grasp
    from xdex_drake.hand.description import Hand
    from xdex_drake.scene.tabletop import Scene


@dataclass(frozen=True)
class View:
    """A stored grasp in Meshcat: its lift is simulated, recorded, and played in the browser.

    Try `xdex view grasps.parquet`, then `xdex view grasps.parquet --row 3 --html third.html`.

    Attributes:
        file: A file of grasps.
        row: Which grasp, counted from 0.
        html: The page; it is opened by any browser and needs no network.
    """

    file: tyro.conf.Positional[Path]
    row: int = 0
    html: Path = Path("grasp.html")

    def run(self) -> int:
        """Writes the page."""
        check_output_file(self.html, ".html")
        from xdex_drake.dataset.files import load_grasps
        from xdex_drake.errors import ConfigError

        stored = load_grasps(self.file)
        if not 0 <= self.row < len(stored):
            raise ConfigError(f"--row {self.row}: {self.file} holds {len(stored)} grasps, counted from 0")
        chosen = stored[self.row]
        write_replays(self.html, [chosen.grasp], chosen.hand, chosen.scene)
        lift = chosen.grasp.lift
        verdict = "not lifted yet" if lift is None else "lifted" if lift.success else lift.failure_reason
        row = (chosen.grasp.grasp_id, chosen.hand.name, chosen.scene.object.name, verdict, str(self.html))
        print(table([row], ("grasp", "hand", "object", "lift", "page")))
        return 0


@dataclass(frozen=True)
class Export:
    """Stored grasps for other tools.

    `json` holds every column, as plain numbers and names, with the unit and the meaning of each.
    Try `xdex export grasps.parquet --out grasps.json`.

    Attributes:
        file: A file of grasps.
        format: The format.
        out: The file to write.
    """

    file: tyro.conf.Positional[Path]
    format: Literal["json"] = "json"
    out: Path = Path("grasps.json")

    def run(self) -> int:
        """Writes the file."""
        check_output_file(self.out, ".json")
        from xdex_drake.dataset.schema import SCHEMA
        from xdex_drake.dataset.store import read_grasps

        rows = read_grasps(self.file)
        columns = {
            column.name: {key.decode(): value.decode() for key, value in (column.metadata or {}).items()}
            for column in SCHEMA
        }
        conventions = {key.decode(): value.decode() for key, value in (SCHEMA.metadata or {}).items()}
        content = {"conventions": conventions, "columns": columns, "grasps": rows}
        write_text(self.out, json.dumps(_without_nan(content), indent=1, allow_nan=False) + "\n")
        print(f"{len(rows)} grasps: {self.out}")
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


def write_text(path: Path, text: str) -> None:
    """Writes a file that appears whole or not at all.

    Raises:
        ConfigError: It cannot be written.
    """
    from xdex_drake.errors import ConfigError

    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise ConfigError(f"{path}: cannot be written: {error.strerror}; choose another path") from None


def wait_for_enter(url: str, stream: TextIO = sys.stdin) -> int:
    """Keeps a live Meshcat open until Enter is pressed."""
    print(f"Meshcat shows it at {url}; press Enter to end")
    stream.readline()
    return 0
