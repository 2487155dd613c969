"""Writes the pages of the site that come from the code itself: tutorials with their outputs, commands, public names.

All of them go to `docs/generated`, which holds nothing else. Tutorials are executed once: notebook and written files of
each are kept in `build/docs/tutorials` until its text changes.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import inspect
import io
import os
import re
import shutil
import textwrap
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jupytext
import nbformat

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
GENERATED = DOCS / "generated"
EXECUTED = ROOT / "build" / "docs" / "tutorials"
PICTURES = {".png", ".jpg", ".svg"}
LIVE = """<iframe class="live" src="{folder}/{page}" title="{page}" loading="lazy"></iframe>
<p class="live"><a href="{folder}/{page}">{page}</a>, a page of its own that needs no network</p>"""
LIVE_STILL = """<figure class="live"><img src="{folder}/{still}" alt="{page.stem}"/><figcaption>
<button type="button" onclick="const live = document.createElement('iframe'); live.className = 'live';
live.src = '{folder}/{page}'; live.title = '{page}'; this.closest('figure').querySelector('img').replaceWith(live);
this.remove()">&#9654; play it here</button>
<a href="{folder}/{page}">{page}</a>, a page of its own that needs no network</figcaption></figure>"""
ROOMS = {
    "hand": "Hands",
    "scene": "Objects and scenes",
    "programs": "Programs",
    "problems": "Problem files",
    "contact": "Contacts and certificates",
    "grasping": "Making grasps",
    "retargeting": "Following a person's hand",
    "simulation": "Lifts",
    "dataset": "Files of grasps",
    "interchange": "Other tools",
    "visualization": "Looking at things",
    "learning": "The model",
    "jobs": "Many of them",
    "evaluation": "Metrics",
}
EXTENSION_POINTS = {
    "An energy term": ("programs.term", ("Term", "View", "Pull")),
    "Costs and constraints": ("programs.costs", ("LeastSquares", "EnergyCost", "UserCost")),
    "A block of constraints": ("programs.block", ("Block",)),
    "A proposer of grasps": ("grasping.proposers", ("Proposer", "Candidate", "Search", "Retarget")),
    "Settings of the search": ("programs.search.settings", ("SearchSettings",)),
    "A simulator": ("simulation.verdict", ("Player",)),
    "A model": ("learning.protocol", ("Model", "HandBatch", "Batch", "Drawn")),
    "Metrics": (
        "evaluation.metrics",
        ("position_difference", "vector_difference", "joint_entropy"),
    ),
}


def write_all() -> None:
    """Writes every generated page anew."""
    shutil.rmtree(GENERATED, ignore_errors=True)
    for folder in ("tutorials", "api"):
        (GENERATED / folder).mkdir(parents=True)
    write_tutorials()
    write_commands()
    write_names()


# ---- tutorials


def write_tutorials() -> None:
    """Notebooks with outputs, the page that lists them, and the gallery's cards of pages that they wrote."""
    paths = sorted((ROOT / "tutorials").glob("*.py"))
    with ThreadPoolExecutor(2) as pool:  # each waits for a process of its own
        notebooks = list(pool.map(executed, paths))
    rows, cards = [], []
    for path, notebook in zip(paths, notebooks, strict=True):
        for cell in notebook.cells:
            if cell.cell_type == "code":
                cell.outputs = [output for output in cell.outputs if not said_only(output)]
                cell.outputs += shown(path.stem, cell.metadata.get("wrote", []))
        if not any(file.suffix in PICTURES for file in (EXECUTED / path.stem / "files").iterdir()):
            raise RuntimeError(f"{path.name} wrote no picture; let it write one, on a machine that can render")
        notebook.metadata["language_info"] = {"name": "python", "pygments_lexer": "python"}
        nbformat.write(notebook, GENERATED / "tutorials" / f"{path.stem}.ipynb")
        title, words = opening(notebook)
        rows.append(f"| [{title}]({path.stem}.ipynb) | {words} |")
        cards += [card(path.stem, title, page) for page in sorted((EXECUTED / path.stem / "files").glob("*.html"))]
    toctree = "\n".join(["```{toctree}", ":hidden:", "", *(path.stem for path in paths), "```"])
    lines = [
        "# Tutorials",
        "",
        "Scripts that run top to bottom, with what they print and draw. In a checkout, run one as",
        "`python tutorials/01_a_first_grasp.py`, or open it as a notebook with jupytext.",
        "",
        "| | |",
        "|---|---|",
        *rows,
        "",
        toctree,
        "",
    ]
    (GENERATED / "tutorials" / "index.md").write_text("\n".join(lines), encoding="utf-8")
    gallery = ["::::{grid} 1 2 2 3", ":gutter: 3", "", *cards, "::::", ""]
    (GENERATED / "gallery_cards.md").write_text("\n".join(gallery), encoding="utf-8")


def executed(path: Path) -> Any:
    """A tutorial as a notebook with its outputs.

    Args:
        path: The tutorial, a script with percent cells.

    Returns:
        The notebook; `wrote` in the metadata of a cell names the files that it wrote.
    """
    from nbclient import NotebookClient  # of the extra `docs`; the rest of this file serves tests without it

    text = path.read_text(encoding="utf-8")
    folder, files = EXECUTED / path.stem, EXECUTED / path.stem / "files"
    kept, digest = folder / "notebook.ipynb", hashlib.sha256(text.encode()).hexdigest()
    if kept.exists():
        notebook = nbformat.read(kept, as_version=4)
        if notebook.metadata.get("digest") == digest:
            return notebook
    shutil.rmtree(folder, ignore_errors=True)
    files.mkdir(parents=True)
    notebook = jupytext.reads(text, fmt="py:percent")
    notebook.metadata = nbformat.from_dict({"digest": digest, "kernelspec": {"name": "python3", "display_name": ""}})
    paths = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1", "PYTHONPATH": paths}
    client = NotebookClient(
        notebook,
        timeout=600,
        startup_timeout=300,
        extra_arguments=["--IPKernelApp.log_level=ERROR"],
        resources={"metadata": {"path": str(files)}},
    )
    with client.setup_kernel(env=environment):
        for k, cell in enumerate(notebook.cells):
            before = set(files.iterdir())
            client.execute_cell(cell, k)
            if cell.cell_type == "code":
                cell.outputs = tidy(cell.outputs)
                cell.metadata["wrote"] = sorted(file.name for file in set(files.iterdir()) - before)
    nbformat.write(notebook, kept)
    return notebook


def tidy(outputs: list[Any]) -> list[Any]:
    """Outputs with what is printed in one piece; progress bars, which go to the error stream, are left out."""
    printed = "".join(output.text for output in outputs if output.output_type == "stream" and output.name == "stdout")
    others = [output for output in outputs if output.output_type != "stream"]
    return [*([nbformat.v4.new_output("stream", name="stdout", text=printed)] if printed else []), *others]


def said_only(output: Any) -> bool:
    """Whether an output is the plain value of a cell's last line, such as the number of letters that were written."""
    return output.output_type == "execute_result" and set(output.data) == {"text/plain"}


def shown(tutorial: str, names: list[str]) -> list[Any]:
    """What the site shows of the files that a cell wrote: pictures, and live pages, which start when asked to."""
    outputs, folder = [], f"../../live/{tutorial}"
    pages = [Path(name) for name in names if name.endswith(".html")]
    pictures = [Path(name) for name in names if Path(name).suffix in PICTURES]
    stills = {picture.stem: picture.name for picture in pictures}
    for page in pages:
        still = stills.get(page.stem)
        outputs.append(
            LIVE_STILL.format(folder=folder, still=still, page=page) if still else LIVE.format(folder=folder, page=page)
        )
    for picture in pictures:
        if picture.stem not in {page.stem for page in pages}:
            # As a link to the file: SVG text would lose its own styles inside of the page.
            outputs.append(f'<img class="picture" src="{folder}/{picture.name}" alt="{picture.stem}"/>')
    return [nbformat.v4.new_output("display_data", {"text/html": html}) for html in outputs]


def opening(notebook: Any) -> tuple[str, str]:
    """Title of a tutorial, and its first sentences."""
    lines = next(cell.source for cell in notebook.cells if cell.cell_type == "markdown").splitlines()
    words = " ".join(line for line in lines[1:] if line).strip()
    return lines[0].removeprefix("# "), ". ".join(words.split(". ")[:1]).rstrip(".") + "."


def card(tutorial: str, title: str, page: Path) -> str:
    """A card of the gallery for a live page, with the picture of the same name where the tutorial wrote one."""
    picture = page.with_suffix(".png")
    top = f":img-top: ../build/docs/tutorials/{tutorial}/files/{picture.name}\n" if picture.exists() else ""
    return (
        f":::{{grid-item-card}} {page.stem.replace('_', ' ').capitalize()}\n"
        f"{top}:link: live/{tutorial}/{page.name}\n:link-type: url\n\nfrom *{title}*\n:::\n"
    )


def copy_live_pages(html: Path) -> None:
    """Copies what the tutorials wrote into the built site, under `live/TUTORIAL/FILE`."""
    for folder in sorted(EXECUTED.iterdir()):
        target = html / "live" / folder.name
        target.mkdir(parents=True, exist_ok=True)
        for file in sorted((folder / "files").iterdir()):
            if file.suffix == ".html" or file.suffix in PICTURES:
                shutil.copyfile(file, target / file.name)


# ---- commands


def write_commands() -> None:
    """One page of all commands: the overview, and what `--help` says of each."""
    from xdex_drake.cli.app import COMMANDS, FOOTER

    lines = ["# Commands", "", *FOOTER.splitlines(), "", "| command | does |", "|---|---|"]
    lines += [f"| [`xdex {name}`](#xdex-{slug(name)}) | {entry.summary} |" for name, entry in COMMANDS.items()]
    for name in COMMANDS:
        lines += ["", f"(xdex-{slug(name)})=", f"## xdex {name}", "", "```text", help_of(name), "```"]
    (GENERATED / "commands.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def slug(name: str) -> str:
    """Name of a command in an address."""
    return name.replace(" ", "-")


def help_of(name: str) -> str:
    """What `xdex NAME --help` prints, 88 columns wide."""
    from xdex_drake.cli import app

    said, before = io.StringIO(), os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "88"
    try:
        with contextlib.redirect_stdout(said):
            app.run([*name.split(), "--help"])
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before
    lines = [line.rstrip() for line in said.getvalue().strip().splitlines()]
    return "\n".join(line if line.startswith(" ") else textwrap.fill(line, 88) for line in lines)


# ---- public names


def write_names() -> None:
    """A page for each public name, and one for the protocols that extensions answer."""
    api = GENERATED / "api"
    rooms: dict[str, list[tuple[str, str]]] = {}
    for name, module in public_names():
        parts = module.split(".")
        rooms.setdefault(ROOMS.get(parts[1], "Values and errors"), []).append((name, module))
    order = ["Values and errors", *ROOMS.values()]
    lines = [
        "# Public names",
        "",
        "Each is at hand as `xdex_drake.NAME`, imported when it is first used; `import xdex_drake as xd`.",
        "",
    ]
    for room in sorted(rooms, key=order.index):
        lines += [f"## {room}", "", "| name | |", "|---|---|"]
        for name, module in sorted(rooms[room], key=lambda entry: entry[0].lower()):
            value = getattr(importlib.import_module("xdex_drake"), name)
            lines.append(f"| [{name}]({name}.md) | {first_line(value)} |")
            (api / f"{name}.md").write_text(page_of_name(name, module, value), encoding="utf-8")
        lines.append("")
    lines += ["[Extension points](extension_points.md) are not at hand by the short name.", ""]
    hidden = [name for name, _ in public_names()]
    lines += ["```{toctree}", ":hidden:", "", *hidden, "extension_points", "```", ""]
    (api / "index.md").write_text("\n".join(lines), encoding="utf-8")
    (api / "extension_points.md").write_text(extension_points(), encoding="utf-8")


def public_names() -> list[tuple[str, str]]:
    """Public names with the modules that define them."""
    import xdex_drake

    return [(name, xdex_drake._MODULE_OF[name]) for name in xdex_drake.__all__ if name != "__version__"]


def first_line(value: object) -> str:
    """First paragraph of a docstring, in one line that a table can hold."""
    paragraph = " ".join((inspect.getdoc(value) or "").split("\n\n")[0].split())
    return paragraph.replace("|", "\\|").replace("*", "\\*")


def directive(value: object) -> str:
    """Which directive of autodoc documents a value."""
    if inspect.isclass(value):
        return "autoexception" if issubclass(value, BaseException) else "autoclass"
    return "autofunction" if inspect.isroutine(value) else "autodata"


def page_of_name(name: str, module: str, value: object) -> str:
    """The page of one public name."""
    kind = directive(value)
    members = "   :members:\n" if kind == "autoclass" else "   :no-value:\n" if kind == "autodata" else ""
    return (
        f"# {name}\n\n```{{eval-rst}}\n.. currentmodule:: xdex_drake\n\n.. {kind}:: {name}\n{members}```\n\n"
        f"Defined in `{module.replace('.', '/')}.py`.\n"
    )


def extension_points() -> str:
    """The page of classes that one writes or answers to extend the library."""
    lines = [
        "# Extension points",
        "",
        "What one writes or answers to extend the library; [how-tos](../../howto/index.md) show them at work.",
        "",
    ]
    for title, (module, names) in EXTENSION_POINTS.items():
        lines += [f"## {title}", "", "```{eval-rst}", f".. currentmodule:: xdex_drake.{module}", ""]
        for name in names:
            value = getattr(importlib.import_module(f"xdex_drake.{module}"), name)
            lines += [f".. {directive(value)}:: {name}", *(["   :members:"] if inspect.isclass(value) else []), ""]
        lines += ["```", ""]
    return "\n".join(lines)


def embedded(html: Path) -> Iterator[tuple[Path, str]]:
    """Addresses inside of the site that its pages embed or link without Sphinx's knowledge.

    Args:
        html: Folder of the built site.

    Yields:
        The page, and the address relative to it.
    """
    for page in sorted(html.rglob("*.html")):
        if "live" not in page.relative_to(html).parts:
            for address in re.findall(r'(?:src|href)="([^"#?:]*live/[^"#?]*)"', page.read_text(encoding="utf-8")):
                yield page, address
