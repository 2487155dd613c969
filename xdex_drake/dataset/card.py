"""The card of a data set, in Markdown: counts, rates, reasons and distributions, all from its shards."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from xdex_drake.dataset.assets import ASSETS, asset, is_licence
from xdex_drake.dataset.folder import Manifest, Rejected, iter_rejected, iter_shards, read_manifest
from xdex_drake.hand.generation import HUMAN_EVERY, read_hand_name
from xdex_drake.scene.generator import family_name, is_shape_name

COLUMNS = (
    *("hand", "object", "scene_id", "source_grasp_id", "protocol", "success", "failure_reason", "holds", "hold_reason"),
    *(
        "task_margin",
        "margin_lower",
        "foretold_motion",
        "penetration_mesh_cm",
        "lift_height_m",
        "contacts",
        "fingertips",
    ),
)
NUMBERS: dict[str, Callable[[Mapping[str, Any]], float | None]] = {
    "contacts": lambda row: None if row["contacts"] is None else len(row["contacts"]),
    "task margin": lambda row: row["task_margin"],
    "ball margin": lambda row: row["margin_lower"],
    "foretold motion": lambda row: row["foretold_motion"],
    "penetration [mm]": lambda row: None if row["penetration_mesh_cm"] is None else 10.0 * row["penetration_mesh_cm"],
    "rise [m]": lambda row: row["lift_height_m"],
    "fingertips at the end": lambda row: None if row["fingertips"] is None else len(row["fingertips"]),
}
"""What is known of a lifted grasp, as numbers."""


HEADING = """\
---
configs:
- config_name: default
  data_files: shards/*.parquet
tags: [robotics, grasping, dexterous-manipulation]
---
"""
"""What Hugging Face's `datasets` reads of a card."""

READING = """\
One row a grasp; the unit and the meaning of every column stand in the files. In the folder of the data set:

```python
pyarrow.parquet.read_table("shards")
duckdb.sql("SELECT hand, count(*), avg(success::int) FROM 'shards/*.parquet' GROUP BY hand")
datasets.load_dataset("parquet", data_files="shards/*.parquet")  # of Hugging Face
xdex_drake.dataset.files.load_grasps("shards/UNIT.parquet")  # with hands and scenes, ready to be lifted or shown
```"""

NOT_STATED = "not stated; ask where it comes from before you pass it on"


@dataclass
class Counts:
    """What became of the attempts of a group.

    Attributes:
        attempts: Grasps that were certified, and attempts that found none.
        certified: Grasps.
        lifted: Grasps that lifted.
        pushed: Grasps that lifted and were pushed.
        held: Those of them that stayed in the hand.
    """

    attempts: int = 0
    certified: int = 0
    lifted: int = 0
    pushed: int = 0
    held: int = 0

    def add(self, row: Mapping[str, Any]) -> None:
        """Counts a grasp."""
        self.attempts += 1
        self.certified += 1
        self.lifted += row["success"] is True
        self.pushed += row["success"] is True and row["holds"] is not None
        self.held += row["success"] is True and row["holds"] is True


@dataclass
class CardFacts:
    """What a card tells.

    Attributes:
        sources: Counts of grasps that come from no other; attempts of their searches are not stored.
        by_hand: Counts of retargetings by kind of hand.
        by_object: The same by kind of object.
        reasons: What was lost by stage and reason.
        scenes: Identifiers of the scenes.
        hands: Names of the hands.
        numbers: Numbers of `NUMBERS` of grasps that lifted.
    """

    sources: Counts = field(default_factory=Counts)
    by_hand: dict[str, Counts] = field(default_factory=dict)
    by_object: dict[str, Counts] = field(default_factory=dict)
    reasons: Counter[tuple[str, str]] = field(default_factory=Counter)
    scenes: set[str] = field(default_factory=set)
    hands: set[str] = field(default_factory=set)
    numbers: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in NUMBERS})


def hand_kind(name: str) -> str:
    """What a card groups a hand by: generated human or robot hands, or its name."""
    generated = read_hand_name(name)
    if generated is None:
        return name
    return "generated human hands" if generated[1] % HUMAN_EVERY == 0 else "generated robot hands"


def object_kind(name: str) -> str:
    """What a card groups an object by: a generated shape's family, or its name."""
    return f"generated: {family_name(name)}" if is_shape_name(name) else name


def card_facts(folder: str | Path) -> CardFacts:
    """Counts everything that a card tells, shard by shard.

    Args:
        folder: Folder of the data set.

    Returns:
        The counts.

    Raises:
        DatasetError: The folder is no data set.
        GraspFileError: A shard is damaged.
    """
    found, object_of = CardFacts(), {}
    for unit, table in iter_shards(folder, COLUMNS):
        for row in table.to_pylist():
            object_of[unit] = row["object"]
            _count_row(found, row)
    for unit, rejected in iter_rejected(folder):
        for attempt in rejected:
            _count_rejected(found, attempt, object_of.get(unit, ""))
    return found


def _count_row(found: CardFacts, row: Mapping[str, Any]) -> None:
    found.scenes.add(row["scene_id"])
    found.hands.add(row["hand"])
    if row["source_grasp_id"]:
        found.by_hand.setdefault(hand_kind(row["hand"]), Counts()).add(row)
        found.by_object.setdefault(object_kind(row["object"]), Counts()).add(row)
    else:
        found.sources.add(row)
    if row["success"] is False:
        found.reasons["lift", row["failure_reason"]] += 1
    elif row["success"] and row["holds"] is False:
        found.reasons["hold", row["hold_reason"].split(":")[0]] += 1
    if row["success"]:
        for name, number in NUMBERS.items():
            value = number(row)
            if value is not None:
                found.numbers[name].append(value)


def _count_rejected(found: CardFacts, attempt: Rejected, obj: str) -> None:
    found.hands.add(attempt.hand)
    found.reasons["certificate and before", attempt.reason] += 1
    found.by_hand.setdefault(hand_kind(attempt.hand), Counts()).attempts += 1
    found.by_object.setdefault(object_kind(obj), Counts()).attempts += 1


def card(folder: str | Path, pictures: Sequence[tuple[str, str]] = ()) -> str:
    """The card of a data set.

    Args:
        folder: Folder of the data set.
        pictures: Pictures to show: the path of each relative to the card, and what it shows.

    Returns:
        Markdown with the heading by which Hugging Face's `datasets` finds the shards; the same shards give the same
        text.

    Raises:
        DatasetError: The folder is no data set.
        GraspFileError: A shard is damaged.
    """
    manifest, found = read_manifest(folder), card_facts(folder)
    total = Counts(*(sum(getattr(c, entry.name) for c in found.by_hand.values()) for entry in fields(Counts)))
    lines = [HEADING, "# Data set of dexterous grasps", "", *_overview(manifest, found, total), ""]
    for path, caption in pictures:
        lines += [f"![{caption}]({path})", "", f"*{caption}.*", ""]
    lines += ["## How to read it", "", READING, ""]
    lines += ["## Retargetings", "", *_rates("hand", {**dict(sorted(found.by_hand.items())), "all": total}), ""]
    lines += [*_rates("object", dict(sorted(found.by_object.items()))), ""]
    reasons = sorted(found.reasons.items(), key=lambda item: (item[0][0], -item[1], item[0][1]))
    lines += ["## What was lost", "", *_table(("stage", "reason", "count"), [(*key, n) for key, n in reasons]), ""]
    lines += ["## Grasps that lifted", "", *_distributions(found.numbers), ""]
    lines += ["## Licences", "", *_table(("what", "licence"), licences(folder)), ""]
    lines += ["## Configuration", "", "```yaml", *(f"{k}: {_short(v)}" for k, v in manifest.config.items()), "```", ""]
    return "\n".join(lines)


def licences(folder: str | Path) -> list[tuple[str, str]]:
    """The licence of each hand and mesh of a data set, as far as files state it.

    Args:
        folder: Folder of the data set.

    Returns:
        What and under which licence, those of the library first.
    """
    lines = [("hands and shapes of the library, and generated ones", "MIT, as the library")]
    for home in sorted(path for path in (Path(folder) / ASSETS).glob("*") if path.is_dir()):
        stated = [path.name for path in sorted(home.iterdir()) if is_licence(path)]
        file = asset(folder, home.name)
        if file is not None:
            said = ", ".join(f"[{name}]({ASSETS}/{home.name}/{name})" for name in stated)
            lines.append((file.name, said or NOT_STATED))
    return lines[:1] + sorted(lines[1:])


def _overview(manifest: Manifest, found: CardFacts, total: Counts) -> list[str]:
    rows = [
        ("units planned", len(manifest.units)),
        ("scenes", len(found.scenes)),
        ("hands", len(found.hands)),
        ("source grasps that lifted", found.sources.lifted),
        ("retargetings attempted", total.attempts),
        ("retargetings that lifted", total.lifted),
        ("seed", manifest.seed),
        ("schema version", manifest.schema_version),
        ("libraries", ", ".join(f"{name} {version}" for name, version in sorted(manifest.versions.items()))),
    ]
    return _table(("what", "value"), rows)


def _rates(title: str, groups: Mapping[str, Counts]) -> list[str]:
    header = (title, "attempted", "certified", "lifted", "lifted of attempted", "lifted of certified", "held of pushed")
    rows = []
    for name, c in groups.items():
        shares = _rate(c.lifted, c.attempts), _rate(c.lifted, c.certified), _rate(c.held, c.pushed)
        rows.append((name, c.attempts, c.certified, c.lifted, *shares))
    return _table(header, rows)


def _rate(part: int, whole: int) -> str:
    return f"{part / whole:.3f}" if whole else "-"


def _distributions(numbers: Mapping[str, Sequence[float]]) -> list[str]:
    shares = (5, 25, 50, 75, 95)
    rows = [
        (name, *(f"{value:.3g}" for value in np.percentile(values, shares)), len(values))
        for name, values in numbers.items()
        if values
    ]
    return _table(("number", *(f"{share} %" for share in shares), "grasps"), rows)


def _table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    return lines + ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in rows]


def _short(value: Any) -> str:
    """A value of the configuration on one line; long lists by their ends."""
    if isinstance(value, list) and len(value) > 12:
        return f"[{', '.join(map(str, value[:8]))}, ... {len(value)} entries]"
    return f"[{', '.join(map(str, value))}]" if isinstance(value, list) else str(value)
