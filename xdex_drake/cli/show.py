"""`xdex view`: stored grasps are shown."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

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
            (grasp.grasp_id, hand.name, scene.object.name, *probabilities, _verdict(grasp))
            for grasp, hand, scene, probabilities in zip(grasps, hands, scenes, score_cells(grasps), strict=True)
        ]
        print(table(rows, ("grasp", "hand", "object", "P(lift)", "P(hold)", "lift")), flush=True)
        from xdex_drake.visualization.replay import grasp_page, replay_lift, view_live

        if self.html is None:
            meshcat = view_live(grasps, hands, scenes, replay=not self.all)
            return wait_for_enter(meshcat.web_url())
        page = grasp_page(grasps, hands, scenes) if self.all else replay_lift(grasps[0], hands[0], scenes[0])
        write_text(self.html, page)
        print(f"written to {self.html}")
        return 0


def score_cells(grasps: Sequence[Grasp]) -> list[tuple[str, str]]:
    """P(lift) and P(hold) of each grasp, as foretold by what is stored with it, for a table."""
    from xdex_drake.grasping.scores import hold_probability, lift_probability

    both = zip(lift_probability(grasps), hold_probability(grasps), strict=True)
    return [("-", "-") if lift != lift else (f"{lift:.3f}", f"{hold:.2f}") for lift, hold in both]


def _verdict(grasp: Grasp) -> str:
    if grasp.lift is None:
        return "not lifted yet"
    return "lifted" if grasp.lift.success else grasp.lift.failure_reason


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
