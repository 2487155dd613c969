"""`xdex hand generate`, `stats`, `check` and `browse`: many hands at once."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import tyro

from xdex_drake.cli.output import (
    check_output_file,
    check_writable,
    counts,
    facts,
    keeping_finished_work,
    one_thread,
    progress,
    table,
)
from xdex_drake.whole_file import whole_file

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xdex_drake.jobs.hands import HandRow

Item = TypeVar("Item")

PICTURES = {".png": "PNG", ".jpg": "JPEG"}

HandNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar="HAND...")]


@dataclass(frozen=True)
class HandGenerate:
    """Generates hands: every fifth a human one, the others variations of the five robot hands of the library.

    Robot hands are scaled, lose or gain links and fingers, or have links merged; each hand is checked before it is
    kept. Hand 137 of seed 0 is named g0-0137, and the name alone works wherever a HAND is asked for, without any file.
    Ctrl-C keeps what is done, and the same command goes on from there. Try
    `xdex hand generate --count 20 --out hands20`, then `xdex hand browse hands20`.

    Attributes:
        count: Number of hands; a larger set begins with the same hands as a smaller one.
        seed: Seed of the set; the same seed gives the same files.
        out: Folder for one .yaml file a hand, and index.json: what each is made of.
        workers: Number of processes.
    """

    count: int = 1000
    seed: int = 0
    out: Path = Path("generated_hands")
    workers: int = 2

    def run(self) -> int:
        """Writes the folder, prints what is in it."""
        check_writable(self.out / "index.json")
        one_thread()
        from xdex_drake.jobs.hands import generate_hands

        rows: list[HandRow] = []
        with keeping_finished_work() as interruption, progress(self.count, "hands") as bar:

            def tell(done: int) -> None:
                bar.n = done
                bar.refresh()

            rows = generate_hands(self.count, self.seed, self.out, workers=self.workers, on_done=tell)
        if interruption.happened:
            print("interrupted: give the same command again to go on")
            return interruption.status(1)
        _print_statistics(rows)
        print(f"\n{len(rows)} hands: {self.out}")
        return 0


@dataclass(frozen=True)
class HandStats:
    """Counts the hands of a folder by size, links, joints and topology, and draws figures of them.

    A topology is the tree of links without their sizes. Try
    `xdex hand stats generated_hands --out statistics.png --sheet hands.jpg`.

    Attributes:
        folder: A folder of .yaml files, as `xdex hand generate` writes.
        out: Write the distributions as a figure, .png or .jpg.
        sheet: Write pictures of hands at rest side by side, .png or .jpg.
        pictures: Number of hands on that sheet, drawn at random, always the same ones.
    """

    folder: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FOLDER")]]
    out: Path | None = None
    sheet: Path | None = None
    pictures: int = 48

    def run(self) -> int:
        """Prints tables, writes figures."""
        for path in (self.out, self.sheet):
            if path is not None:
                check_output_file(path, path.suffix.lower() if path.suffix.lower() in PICTURES else ".png")
        from xdex_drake.jobs.hands import read_hand_rows

        rows = read_hand_rows(self.folder)
        _print_statistics(rows)
        if self.out is not None:
            from xdex_drake.visualization.hand_sets import statistics_figure

            _write_picture(self.out, statistics_figure(rows))
            print(f"\ndistributions: {self.out}")
        if self.sheet is not None:
            from xdex_drake.hand.library import load_hand
            from xdex_drake.visualization.hand_sets import hands_sheet

            chosen = _spread(rows, max(1, self.pictures))
            hands = [load_hand(self.folder / f"{row.name}.yaml") for row in chosen]
            _write_picture(self.sheet, hands_sheet(hands))
            print(f"{len(hands)} pictures: {self.sheet}")
        return 0


@dataclass(frozen=True)
class HandCheck:
    """Checks whether hands are sound: inertias, limits, no overlaps at rest, fingers that oppose each other and close.

    Each is also held at rest in Drake and must not move. Every generated hand passes these checks; a hand of your own
    may grasp well and still fail one, as a gripper of four links does. What is wrong is printed, and the exit status is
    1 then. Try `xdex hand check allegro my_hand.yaml`, or give a folder of hands.

    Attributes:
        hands: Names of hands, paths of hand files, or folders of .yaml files.
        seconds: Time that each hand is simulated at rest [s]; 0 to build it only.
        workers: Number of processes.
    """

    hands: tyro.conf.Positional[HandNames]
    seconds: float = 1.0
    workers: int = 1

    def run(self) -> int:
        """Prints what is wrong; exit status 1 where something is."""
        one_thread()
        from xdex_drake.jobs.hands import check_hands

        names = _named(self.hands)
        with progress(len(names), "hands") as bar:

            def tell(done: int) -> None:
                bar.n = done
                bar.refresh()

            # One hand is checked here: a process of its own would take longer to start.
            workers = 0 if len(names) == 1 else self.workers
            reasons = check_hands(names, seconds=self.seconds, workers=workers, on_done=tell)
        if reasons:
            print(table([(name, said) for name, all_said in reasons.items() for said in all_said], ("hand", "reason")))
        print(f"{len(names) - len(reasons)} of {len(names)} hands are sound")
        return 1 if reasons else 0


@dataclass(frozen=True)
class HandBrowse:
    """Writes a page that shows hands one at a time, with a slider for every joint.

    Open it in a browser; it works offline. Try `xdex hand browse allegro g0-0000 g0-0001`, or give a folder of hands.

    Attributes:
        hands: Names of hands, paths of hand files, or folders of .yaml files.
        html: The page to write.
        most: Greatest number of hands on the page; of more, so many are drawn at random.
    """

    hands: tyro.conf.Positional[HandNames]
    html: Path = Path("hands.html")
    most: int = 48

    def run(self) -> int:
        """Writes the page."""
        check_output_file(self.html, ".html")
        from xdex_drake.cli.show import write_text
        from xdex_drake.hand.library import load_hand
        from xdex_drake.visualization.hand_browser import browser_page

        names = _spread(_named(self.hands), max(1, self.most))
        hands = [load_hand(name) for name in names]
        write_text(self.html, browser_page(hands, title=f"{len(hands)} hands" if len(hands) > 1 else hands[0].name))
        print(f"{len(hands)} hands: {self.html}")
        return 0


def _named(hands: Sequence[str]) -> list[str]:
    """Names and paths, folders as the files in them."""
    from xdex_drake.errors import ConfigError
    from xdex_drake.jobs.hands import hand_files

    names = []
    for hand in hands:
        names += [str(path) for path in hand_files(hand)] if Path(hand).is_dir() else [hand]
    if not names:
        raise ConfigError("no hand is given; give names, paths or folders")
    return names


def _spread(items: Sequence[Item], most: int) -> list[Item]:
    """Some of the items, in their order: drawn, since every fifth of a set is of one kind."""
    import random

    if len(items) <= most:
        return list(items)
    return [items[k] for k in sorted(random.Random(0).sample(range(len(items)), most))]


def _print_statistics(rows: Sequence[HandRow]) -> None:
    bases = Counter(row.base for row in rows)
    rejected = Counter(reason for row in rows for reason in row.rejected)
    print(
        facts(
            [
                ("hands", f"{len(rows)} ({', '.join(f'{count} {base}' for base, count in sorted(bases.items()))})"),
                ("topologies", len({row.topology for row in rows})),
                ("draws refused", counts(rejected)),
            ]
        )
    )
    columns = {
        "links": [row.links for row in rows],
        "joints": [row.joints for row in rows],
        "actuated joints": [row.actuated for row in rows],
        "fingers": [len(row.fingers) for row in rows],
        "size [mm]": [round(1000.0 * row.size_m) for row in rows],
        "mass [g]": [round(1000.0 * row.mass_kg) for row in rows],
    }
    lines = []
    for name, values in columns.items():
        ordered = sorted(values)
        lines.append((name, ordered[0], ordered[len(ordered) // 2], ordered[-1]))
    print("\n" + table(lines, ("", "least", "median", "greatest")))


def _write_picture(path: Path, image: object) -> None:
    """Writes a picture that appears whole or not at all."""
    import numpy as np
    from PIL import Image

    from xdex_drake.errors import ConfigError

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as unfinished:
            Image.fromarray(np.asarray(image)).save(unfinished, format=PICTURES[path.suffix.lower()], quality=88)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}; choose another path") from None
