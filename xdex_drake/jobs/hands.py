"""Folders of generated hands: one YAML file a hand, and an index with what each one is.

A folder is filled by any number of processes and can be interrupted and gone on with; its bytes depend on seed and
count alone. While it is being filled, rows are kept in a journal; `index.json` appears when all hands are there.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path

from xdex_drake.errors import ConfigError
from xdex_drake.hand.checks import check_hand, check_in_drake, hand_size
from xdex_drake.hand.description import Hand
from xdex_drake.hand.generation import GENERATOR, generate_hand, hand_name, topology
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.yaml_file import read_hand, write_hand
from xdex_drake.jobs.processes import run_units
from xdex_drake.whole_file import whole_file

INDEX = "index.json"
_JOURNAL = "index.partial.jsonl"
_CHUNK = 10
"""Hands that a worker makes before it reports."""


@dataclass(frozen=True)
class HandRow:
    """What is counted about a hand.

    Attributes:
        name: Its name.
        base: The hand that it varies, `human` for a human one; the hand's own name where it varies none.
        operations: The operations that made it, as text.
        links: Number of links, hubs included.
        joints: Number of joints.
        actuated: Number of actuated joints.
        fingers: Names of its fingers.
        size_m: Distance from the wrist to the farthest fingertip of the straight hand [m].
        mass_kg: Mass [kg].
        topology: Its tree, as `hand.generation.topology` writes it.
        rejected: Why earlier draws of the same name were refused.
    """

    name: str
    base: str
    operations: str
    links: int
    joints: int
    actuated: int
    fingers: tuple[str, ...]
    size_m: float
    mass_kg: float
    topology: str
    rejected: tuple[str, ...] = ()


def hand_row(hand: Hand, rejected: Iterable[str] = ()) -> HandRow:
    """What is counted about a hand; see `HandRow`."""
    return HandRow(
        name=hand.name,
        base=hand.sources.get("base", hand.name).partition("(")[0],
        operations=hand.sources.get("variation", ""),
        links=len(hand.links),
        joints=len(hand.joints),
        actuated=len(hand.joint_names),
        fingers=tuple(finger.name for finger in hand.fingers),
        size_m=round(hand_size(hand), 5),
        mass_kg=round(sum(link.mass for link in hand.links), 5),
        topology=topology(hand),
        rejected=tuple(rejected),
    )


def generate_hands(
    count: int, seed: int, out: str | Path, *, workers: int = 1, on_done: Callable[[int], None] | None = None
) -> list[HandRow]:
    """Generates the first hands of a seed into a folder, or goes on with it.

    Args:
        count: Number of hands.
        seed: Seed of the set.
        out: The folder; made where it does not exist. Files appear whole or not at all.
        workers: Number of processes; 0 works in this one.
        on_done: Called with the number of hands that are done, at the start and whenever some are added.

    Returns:
        A row for each hand, in order.

    Raises:
        ConfigError: A number is out of range, the folder holds another set, or it cannot be written.
        RuntimeError: A hand could not be made: the process that made it crashed.
    """
    if count < 1 or seed < 0:
        raise ConfigError(f"count={count} must be 1 or more and seed={seed} 0 or more")
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be made ({error.strerror}); choose another folder") from None
    rows = _known_rows(folder, seed)
    wanted = [hand_name(seed, index) for index in range(count)]
    missing = [index for index, name in enumerate(wanted) if name not in rows]
    units = [tuple(missing[k : k + _CHUNK]) for k in range(0, len(missing), _CHUNK)]
    tell = on_done or _ignore
    tell(count - len(missing))
    failures = []
    if units:
        _append(folder / _JOURNAL, [{"generator": GENERATOR, "seed": seed}])
    for result in run_units(units, partial(_make, seed, str(folder)), workers=workers):
        if result.value is None:
            failures.append(f"hands {result.unit[0]} to {result.unit[-1]}: {result.failure}")
            continue
        _append(folder / _JOURNAL, [asdict(row) for row in result.value])
        rows.update({row.name: row for row in result.value})
        tell(sum(name in rows for name in wanted))
    if failures:
        raise RuntimeError("; ".join(failures))
    ordered = [rows[name] for name in sorted(rows, key=lambda name: int(name.rpartition("-")[2]))]
    content = {"generator": GENERATOR, "seed": seed, "hands": [asdict(row) for row in ordered]}
    _write(folder / INDEX, json.dumps(content, indent=1) + "\n")
    (folder / _JOURNAL).unlink(missing_ok=True)
    return [rows[name] for name in wanted]


def _make(seed: int, folder: str, indices: tuple[int, ...]) -> list[HandRow]:
    """Writes some hands; runs in a worker."""
    rows = []
    for index in indices:
        made = generate_hand(seed, index)
        path = Path(folder) / f"{made.hand.name}.yaml"
        with whole_file(path) as unfinished:
            write_hand(made.hand, unfinished)
        rows.append(hand_row(made.hand, made.rejected))
    return rows


def _ignore(done: int) -> None:
    """Does nothing with a count."""


def _write(path: Path, text: str) -> None:
    try:
        with whole_file(path) as unfinished:
            unfinished.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); choose another folder") from None


def _append(path: Path, lines: Iterable[dict[str, object]]) -> None:
    try:
        with path.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(line) + "\n" for line in lines)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); choose another folder") from None


def _known_rows(folder: Path, seed: int) -> dict[str, HandRow]:
    """Rows of hands that are there already, from the index and from the journal of a run that was interrupted."""
    rows: dict[str, HandRow] = {}
    for path in (folder / INDEX, folder / _JOURNAL):
        if not path.exists():
            continue
        for entry in _entries(path):
            if "generator" in entry:
                if (entry["generator"], entry.get("seed")) != (GENERATOR, seed):
                    raise ConfigError(
                        f"{path}: holds hands of seed {entry.get('seed')} and generator {entry['generator']}, not of "
                        f"seed {seed} and generator {GENERATOR}; choose another folder"
                    )
                continue
            row = _row(entry, path)
            if (folder / f"{row.name}.yaml").exists():
                rows[row.name] = row
    return rows


def _entries(path: Path) -> list[dict[str, object]]:
    try:
        text = path.read_text(encoding="utf-8")
        if path.name == INDEX:
            content = json.loads(text)
            return [{key: content[key] for key in ("generator", "seed")}, *content["hands"]]
        # The last line may have been cut off where a run was killed.
        return [json.loads(line) for line in text.splitlines() if line.endswith("}")]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: is no index of hands ({error}); remove it and generate again") from None


def _row(entry: dict[str, object], path: Path) -> HandRow:
    names = {field.name for field in fields(HandRow)}
    if not isinstance(entry, dict) or set(entry) != names:
        raise ConfigError(f"{path}: a row lacks or exceeds the fields {', '.join(sorted(names))}; generate again")
    values = {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}
    return HandRow(**values)  # type: ignore[arg-type]


def read_hand_rows(folder: str | Path) -> list[HandRow]:
    """Rows of a folder of hands: its index, or, where it has none, its files one by one.

    Args:
        folder: A folder of `.yaml` files.

    Returns:
        A row for each hand, in the order of the index or of file names.

    Raises:
        ConfigError: There is no hand in the folder, or its index cannot be read.
        HandFileError: A file cannot be used.
    """
    folder = Path(folder)
    index = folder / INDEX
    if index.exists():
        return [_row(entry, index) for entry in _entries(index) if "generator" not in entry]
    rows = [hand_row(read_hand(path)) for path in hand_files(folder)]
    return rows


def hand_files(folder: str | Path) -> list[Path]:
    """Hand files of a folder in the order of their names.

    Raises:
        ConfigError: There is none.
    """
    paths = sorted(path for path in Path(folder).glob("*.yaml") if not path.name.startswith("."))
    if not paths:
        raise ConfigError(
            f"{folder}: there is no hand file; give a folder of .yaml files, as `xdex hand generate` writes"
        )
    return paths


def check_hands(
    hands: Iterable[str], *, seconds: float = 1.0, workers: int = 1, on_done: Callable[[int], None] | None = None
) -> dict[str, tuple[str, ...]]:
    """Checks hands, and lets each rest in Drake, in processes of their own.

    Args:
        hands: Names or paths.
        seconds: Time that each is simulated, in the steps of 5 ms of a lift [s].
        workers: Number of processes; 0 works in this one.
        on_done: Called with the number of hands that are done.

    Returns:
        The reasons of those that are no good, by name or path as given: empty where all are sound.
    """
    names = list(hands)
    units = [tuple(names[k : k + _CHUNK]) for k in range(0, len(names), _CHUNK)]
    reasons: dict[str, tuple[str, ...]] = {}
    done = 0
    for result in run_units(units, partial(_check, seconds), workers=workers):
        done += len(result.unit)
        found = result.value if result.value is not None else dict.fromkeys(result.unit, (str(result.failure),))
        reasons.update({name: said for name, said in found.items() if said})
        if on_done is not None:
            on_done(done)
    return {name: reasons[name] for name in names if name in reasons}


def _check(seconds: float, names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    found = {}
    for name in names:
        hand = load_hand(name)
        found[name] = check_hand(hand) or check_in_drake(hand, seconds=seconds)
    return found
