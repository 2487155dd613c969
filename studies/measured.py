"""Prints the table of figures from the results that lie beside the studies; a test holds docs/measured.md to it.

    python studies/measured.py            # the table
    python studies/measured.py --write    # into docs/measured.md, between its two marks

Every row names the file that it comes from, and the command that made the file.
"""

import csv
import json
import statistics
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

STUDIES = Path(__file__).resolve().parent
PAGE = STUDIES.parent / "docs" / "measured.md"
BEGIN, END = "<!-- measured: python studies/measured.py --write -->\n", "<!-- end of measured -->"
NAMES = {"allegro": "Allegro", "shadow": "Shadow", "ability": "Ability", "inspire": "Inspire", "schunk_svh": "SVH"}
HOLDS = "python studies/holds/survival.py run MESHES studies/holds/survival.csv --mujoco"
ROWS: list[tuple[str, str, str, Callable[[Path], str]]] = []


def row(what: str, file: str, command: str) -> Callable[[Callable[[Path], str]], Callable[[Path], str]]:
    """Registers the figure of a row, which is made from a file that a command made."""

    def register(figure: Callable[[Path], str]) -> Callable[[Path], str]:
        ROWS.append((what, file, command, figure))
        return figure

    return register


def read(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file."""
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def by_hand(rows: list[dict[str, str]], good: str, of: str) -> str:
    """Counts for each hand."""
    parts = []
    for hand, name in NAMES.items():
        here = [row for row in rows if row["hand"] == hand and row[of] == "1"]
        if here:
            parts.append(f"{name} {sum(row[good] == '1' for row in here)} of {len(here)}")
    return ", ".join(parts)


def survivors(path: Path) -> list[dict[str, str]]:
    """Certified grasps of the study of holds."""
    return [{**row, "certified": "1"} for row in read(path) if int(row["trial"]) >= 0]


@row(
    "certified grasps that lift (`lift-0.2/2tips`), first four of each hand and mesh, nothing selected",
    "holds/survival.csv",
    HOLDS,
)
def lifted(path: Path) -> str:
    """Lifted of certified."""
    rows = survivors(path)
    meshes = len({row["object"] for row in rows})
    return f"{by_hand(rows, 'lifted', 'certified')}; {meshes} scanned or modelled meshes"


@row("of these: held for two seconds more, then six pushes of the weight (`hold`)", "holds/survival.csv", HOLDS)
def held(path: Path) -> str:
    """Held of lifted, in both simulators."""
    rows = survivors(path)
    same = sum(row["lifted"] == row["mujoco_lifted"] for row in rows)
    whole = [row for row in rows if row["lifted"] == "1"]
    share = sum(row["held"] == "1" for row in whole) / len(whole)
    other = [row for row in rows if row["mujoco_lifted"] == "1"]
    judged = sum(row["mujoco_held"] == "1" for row in other) / len(other)
    return (
        f"{by_hand(rows, 'held', 'lifted')}; {share:.0%} in Drake, {judged:.0%} in MuJoCo, which agree on "
        f"{same} of {len(rows)} lifts"
    )


@row("likewise, of those that are foretold to hold, as a search asks", "holds/survival.csv", HOLDS)
def foretold(path: Path) -> str:
    """Held of lifted among those foretold to hold."""
    rows = [line for line in survivors(path) if line["foretold"] not in ("", "nan") and float(line["foretold"]) <= 0.0]
    other = [line for line in rows if line["mujoco_lifted"] == "1"]
    judged = sum(line["mujoco_held"] == "1" for line in other)
    return f"{by_hand(rows, 'held', 'lifted')}; in MuJoCo {judged} of {len(other)}"


@row("the same meshes: hands and meshes of which 40 s of search gave fewer than four", "holds/survival.csv", HOLDS)
def missing(path: Path) -> str:
    """Cells that are not full."""
    cells: dict[tuple[str, str], int] = {}
    for line in read(path):
        key = (line["hand"], line["object"])
        cells[key] = cells.get(key, 0) + (int(line["trial"]) >= 0)
    return f"{sum(n < 4 for n in cells.values())} of {len(cells)}; none at all in {sum(n == 0 for n in cells.values())}"


def stage(content: dict[str, Any], name: str) -> float:
    """Median time of a stage of a benchmark [ms]."""
    return next(entry["median_ms"] for entry in content["stages"] if entry["name"].startswith(name))


@row(
    "a grasp of a can by Allegro, one core: polish, certificate with squeeze and pre-grasp, lift",
    "bench/force_closure.json",
    "xdex bench force_closure --out studies/bench/force_closure.json",
)
def synthesis(path: Path) -> str:
    """Times of synthesis."""
    content = json.loads(path.read_text(encoding="utf-8"))
    names = ("polish", "certificate and pre-grasp", "lift")
    times = ", ".join(f"{stage(content, name):.0f}" for name in ("polish", "certificate")) + " and "
    last = next(entry for entry in content["stages"] if entry["name"] == names[2])["median_ms"]
    facts = content["facts"]
    return f"{times}{last:.0f} ms; {facts['certified']} of {facts['tried']} certified, {facts['lifted']} lifted"


@row(
    "wrench programs, four contacts: balance, task margin, ball margin, check without a solver",
    "bench/wrench.json",
    "xdex bench wrench --out studies/bench/wrench.json",
)
def wrench(path: Path) -> str:
    """Times of wrench programs."""
    content = json.loads(path.read_text(encoding="utf-8"))
    names = ("balance, 4 contacts", "task margin, six pushes, 4", "ball margin to 1e-3, 4", "check without a solver, 4")
    exact = {entry["name"]: entry["median_ms"] for entry in content["stages"]}
    worst = content["facts"]["worst residual"]
    return ", ".join(f"{exact[name]:.2g}" for name in names) + f" ms; worst residual {worst:.0e} of m g"


@row(
    "link-pose inverse kinematics, batches of 128, five hands",
    "bench/ik.json",
    "xdex bench ik --out studies/bench/ik.json",
)
def kinematics(path: Path) -> str:
    """Times of inverse kinematics."""
    content = json.loads(path.read_text(encoding="utf-8"))
    times = [entry["median_ms"] for entry in content["stages"]]
    right = min(value for name, value in content["facts"].items() if name.endswith("within 1 mm"))
    return f"{min(times):.2g} to {max(times):.2g} ms a pose, fingertips within 1 mm in {right:.0%}"


@row(
    "a thousand generated hands, each checked and simulated, two cores",
    "hands/thousand.json",
    "python studies/hands/thousand.py studies/hands/thousand.json",
)
def thousand(path: Path) -> str:
    """Generation."""
    made = json.loads(path.read_text(encoding="utf-8"))
    return f"{made['wall_s']:.0f} s, {made['largest_process_mb']} MB a process; {made['topologies']} topologies"


@row(
    "meshes imported with no hand work",
    "objects/import.csv",
    "python studies/objects/run.py meshes MESHES --out studies/objects/import.csv",
)
def meshes(path: Path) -> str:
    """Import of meshes."""
    rows = [line for line in read(path) if not line["repairs"].startswith("REFUSED")]
    seconds = [float(line["seconds"]) for line in rows]
    bulges = [float(line["bulge_p99_mm"]) for line in rows]
    return (
        f"{len(rows)}; convex parts in {statistics.median(seconds):.0f} s of processor time (median, at most "
        f"{max(seconds):.0f} s), once; bulge p99 at most 1 mm on {sum(b <= 1.0 for b in bulges)}, at most "
        f"{max(bulges):.2f} mm"
    )


@row(
    "draws of the small model that ships, refined: lifted of drawn (can, bottle)",
    "predictions/results.csv",
    "python studies/predictions/run.py studies/predictions/results.csv --count 8 --objects can,bottle",
)
def predictions(path: Path) -> str:
    """Predictions."""
    rows, parts = read(path), []
    for hand, name in NAMES.items():
        here = [line for line in rows if line["hand"] == hand and line["stage"] == "refined"]
        parts.append(
            f"{name} {sum(int(line['lifted']) for line in here)} of {sum(int(line['drawn']) for line in here)}"
        )
    return ", ".join(parts) + "; it has seen neither Inspire nor SVH"


def table() -> str:
    """The figures as a table in Markdown, and one of the commands; rows whose file is not there yet are left out."""
    rows = [row for row in ROWS if (STUDIES / row[1]).exists()]
    lines = ["| what | figure | from `studies/` |", "|---|---|---|"]
    lines += [f"| {what} | {figure(STUDIES / file)} | `{file}` |" for what, file, _, figure in rows]
    lines += ["", "| file | made by |", "|---|---|"]
    lines += [f"| `{file}` | `{command}` |" for file, command in dict(row[1:3] for row in rows).items()]
    return "\n".join(lines) + "\n"


def written(page: str) -> str:
    """A page with the table in its place."""
    head, rest = page.split(BEGIN)
    return head + BEGIN + "\n" + table() + "\n" + END + rest.split(END)[1]


if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(table(), end="")
