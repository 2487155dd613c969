"""A report page: what was tried, what was certified, what was lifted, each grasp with its picture and its replay."""

from __future__ import annotations

import base64
import html
import io
import logging
import math
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path

import numpy as np
from PIL import Image as PillowImage

from xdex_drake.errors import ConfigError, XdexError
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.grasping.tally import Tally, counted
from xdex_drake.hand.description import Hand
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LIFT, LiftProtocol
from xdex_drake.visualization.pictures import Image, can_render, render_grasp
from xdex_drake.visualization.replay import record_lift
from xdex_drake.whole_file import write_text

_log = logging.getLogger(__name__)

JPEG_QUALITY = 85

FACTS = 3
"""Facts that a card shows; the others are folded."""


@dataclass(frozen=True)
class ReportRow:
    """A line of the table of a section.

    Attributes:
        hand: Name of the hand.
        object: Name of the object.
        tally: What became of the candidates, and how long it took.
    """

    hand: str
    object: str
    tally: Tally


@dataclass(frozen=True, eq=False)
class ReportGrasp:
    """A grasp to show.

    Attributes:
        grasp: The grasp.
        hand_name: Name of its hand to show a person.
        picture: Picture of it, shape (height, width, 3); None where there is none.
        replay: Page of its lift (`replay_lift`); empty where there is none.
        note: A few words to go with it, such as the method that made it.
    """

    grasp: Grasp
    hand_name: str = ""
    picture: Image | None = field(default=None, repr=False)
    replay: str = field(default="", repr=False)
    note: str = ""


@dataclass(frozen=True, eq=False)
class ReportSection:
    """A part of a report.

    Attributes:
        title: Heading.
        text: One paragraph, plain text.
        rows: Lines of its table.
        grasps: Grasps to show.
    """

    title: str
    text: str = ""
    rows: Sequence[ReportRow] = ()
    grasps: Sequence[ReportGrasp] = ()


def show_grasp(
    grasp: Grasp,
    hand: Hand,
    scene: Scene,
    *,
    protocol: LiftProtocol = LIFT,
    size: tuple[int, int] = (480, 360),
    replay: bool = True,
    note: str = "",
) -> ReportGrasp:
    """Takes a grasp's picture and records its lift, as far as this machine and this grasp allow.

    Args:
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.
        protocol: Lift protocol.
        size: Width and height of the picture [pixels].
        replay: Whether to record the lift.
        note: A few words to go with it.

    Returns:
        The grasp with picture and replay; where one cannot be made, it is left out and the reason is logged.
    """
    picture, page = None, ""
    if can_render():
        picture = render_grasp(grasp, hand, scene, size=size)
    else:
        _log.warning("pictures cannot be rendered on this machine; the report goes without")
    if replay and grasp.tau_squeeze is not None and grasp.q_pregrasp is not None:
        try:
            page = record_lift(grasp, hand, scene, protocol=protocol).html
        except XdexError as error:
            _log.warning("no replay of %s: %s", grasp.grasp_id or grasp.hand, error)
    return ReportGrasp(grasp, hand.display_name, picture, page, note)


def encode_jpeg(picture: Image) -> bytes:
    """A picture as a JPEG file.

    Args:
        picture: Red, green and blue, shape (height, width, 3).

    Returns:
        The file's content.
    """
    buffer = io.BytesIO()
    PillowImage.fromarray(np.asarray(picture, dtype=np.uint8)).save(buffer, "JPEG", quality=JPEG_QUALITY, optimize=True)
    return buffer.getvalue()


def write_report(
    folder: str | Path,
    sections: Sequence[ReportSection],
    *,
    title: str = "Grasps",
    intro: str = "",
    protocol: LiftProtocol = LIFT,
    seed: int | None = None,
    command: str = "",
) -> Path:
    """Writes `index.html`, with its pictures inside, and `replays/*.html`, to which it links.

    Args:
        folder: Folder to write into; made where it does not exist. Files of an earlier report are written over.
        sections: What to show.
        title: Title of the page.
        intro: What is shown, one paragraph of plain text.
        protocol: The lift protocol that was used.
        seed: Seed that was used.
        command: Command that made this.

    Returns:
        Path of `index.html`. Each file appears whole, the index last.

    Raises:
        ConfigError: The folder cannot be written.
    """
    folder = Path(folder)
    links = _replay_names(sections)
    try:
        (folder / "replays").mkdir(parents=True, exist_ok=True)
        for section in sections:
            for shown in section.grasps:
                if shown.replay:
                    write_text(folder / links[id(shown)], shown.replay)
        index = folder / "index.html"
        write_text(index, _page(sections, links, title, intro, protocol, seed, command))
    except OSError as error:
        raise ConfigError(f"{folder}: the report cannot be written: {error.strerror}; choose another folder") from None
    return index


def _replay_names(sections: Sequence[ReportSection]) -> dict[int, str]:
    """A relative path for each replay, made of letters, digits and dashes, no two alike on any file system."""
    names: dict[int, str] = {}
    taken: set[str] = set()
    for section in sections:
        for shown in section.grasps:
            grasp = shown.grasp
            text = grasp.grasp_id or f"{grasp.hand}-{grasp.object}"
            stem = re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-")[:80] or "grasp"
            name, k = stem, 2
            while name.lower() in taken:
                name, k = f"{stem}-{k}", k + 1
            taken.add(name.lower())
            names[id(shown)] = f"replays/{name}.html"
    return names


def _e(value: object) -> str:
    return html.escape(str(value), quote=True)


def _number(value: float, format: str, unit: str = "") -> str:
    return f"{value:{format}}{unit}" if math.isfinite(value) else "–"


def _seconds(value: float) -> str:
    return _number(value, ".1f" if value < 100.0 else ".0f", " s")


def _why(tally: Tally) -> list[str]:
    """Why candidates and lifts failed, as far as some did."""
    kinds = (("rejected candidates", tally.rejected), ("failed lifts", tally.failed))
    return [f"{what}: {_e(counted(reasons).replace('_', ' '))}" for what, reasons in kinds if reasons]


def _table(rows: Sequence[ReportRow]) -> str:
    def line(cells: Sequence[str], tag: str, kind: str = "") -> str:
        shown = "".join(f"<{tag}{' class=n' if k > 1 else ''}>{cell}</{tag}>" for k, cell in enumerate(cells))
        return f"<tr{kind}>{shown}</tr>"

    def counts_of(tally: Tally) -> list[str]:
        return [str(tally.tried), str(tally.certified), str(tally.lifted), _e(_seconds(tally.seconds))]

    body = [line([_e(r.hand), _e(r.object), *counts_of(r.tally)], "td") for r in rows]
    whole = Tally()
    for row in rows:
        whole.merge(row.tally)
    total = line(["all", "", *counts_of(whole)], "td", " class=total") if len(rows) > 1 else ""
    reasons = "".join(
        f"<li><b>{_e(r.hand)}, {_e(r.object)}:</b> {'; '.join(why)}</li>" for r in rows if (why := _why(r.tally))
    )
    head = line(["hand", "object", "tried", "certified", "lifted", "time"], "th")
    details = (
        f"<details><summary>Why candidates and lifts failed</summary><ul>{reasons}</ul></details>" if reasons else ""
    )
    return (
        f'<div class="scroll"><table><thead>{head}</thead><tbody>{"".join(body)}{total}</tbody></table></div>{details}'
    )


def _verdict(lift: Lift | None) -> tuple[str, str]:
    """Class and words of a badge."""
    if lift is None:
        return "", "not lifted yet"
    if lift.success:
        return "good", "lifted"
    return "bad", lift.failure_reason.replace("_", " ") or "failed"


def _figures(grasp: Grasp) -> list[tuple[str, str]]:
    """Name and value of what is known of a grasp in numbers, what matters most first."""
    first: list[tuple[str, str]] = []
    figures: list[tuple[str, str]] = []
    if grasp.lift is not None:
        first.append(("rise", _number(round(100.0 * grasp.lift.lift_height_m, 1) + 0.0, ".1f", " cm")))
        first.append(("fingertips", ", ".join(grasp.lift.fingertips) or "none"))
    if (certificate := grasp.certificate) is not None:
        first.append(("friction left", _number(100.0 * certificate.friction_left, ".0f", " %")))
        figures += [
            ("contacts", str(len(certificate.contacts))),
            ("residual", _number(certificate.wrench_residual, ".1e")),
            ("task margin", _number(certificate.task_margin, ".2f")),
            (
                "ball margin",
                f"{_number(certificate.margin_lower, '.4f')} to {_number(certificate.margin_upper, '.4f')}",
            ),
        ]
    if math.isfinite(grasp.penetration_parts_m):
        parts, mesh = 1e3 * grasp.penetration_parts_m, 1e3 * grasp.penetration_mesh_m
        figures.append(("penetration", f"{_number(parts, '.2f')} mm, mesh {_number(mesh, '.2f')} mm"))
    if grasp.source_grasp_id:
        figures.append(("retargeted from", grasp.source_grasp_id))
    if grasp.seconds > 0.0:
        figures.append(("found in", _seconds(grasp.seconds)))
    if grasp.grasp_id:
        figures.append(("grasp", grasp.grasp_id))
    return first + figures


def _picture(shown: ReportGrasp, link: str, caption: str = "") -> str:
    """A grasp's picture, which opens its replay where there is one."""
    name = f"{shown.hand_name or shown.grasp.hand}, {shown.grasp.object}"
    if shown.picture is not None:
        height, width = shown.picture.shape[:2]
        data = base64.b64encode(encode_jpeg(shown.picture)).decode("ascii")
        figure = f'<img src="data:image/jpeg;base64,{data}" width="{width}" height="{height}" alt="{_e(name)}">'
    else:
        figure = '<div class="blank">no picture</div>'
    if shown.replay:
        label = f"Replay the lift of {name}"
        figure = f'<a class="play" href="{_e(link)}" aria-label="{_e(label)}">{figure}<span>&#9654; replay</span></a>'
    return f"<figure>{figure}<figcaption>{_e(caption)}</figcaption></figure>" if caption else figure


def _card(shown: ReportGrasp, links: Mapping[int, str], source: ReportGrasp | None) -> str:
    """A grasp; beside it the one that it comes from, where that is shown somewhere on the page."""
    grasp = shown.grasp
    kind, words = _verdict(grasp.lift)
    name = f"{shown.hand_name or grasp.hand}, {grasp.object}"
    figure = _picture(shown, links[id(shown)])
    if source is not None:
        pair = ((source, source.hand_name or source.grasp.hand), (shown, shown.hand_name or grasp.hand))
        figure = f'<div class="two">{"".join(_picture(each, links[id(each)], hand) for each, hand in pair)}</div>'
    figures = [f"<dt>{_e(key)}</dt><dd>{_e(value)}</dd>" for key, value in _figures(grasp)]
    rest = "".join(figures[FACTS:])
    more = f"<details><summary>more</summary><dl>{rest}</dl></details>" if rest else ""
    note = f'<p class="note">{_e(shown.note)}</p>' if shown.note else ""
    classes = f"{kind} pair" if source is not None else kind
    return (
        f'<article class="{classes.strip()}">{figure}<div class="body"><h3>{_e(name)} '
        f'<span class="badge">{_e(words)}</span></h3>{note}<dl>{"".join(figures[:FACTS])}</dl>{more}</div></article>'
    )


def _section(section: ReportSection, links: Mapping[int, str], by_id: Mapping[str, ReportGrasp]) -> str:
    text = f"<p>{_e(section.text)}</p>" if section.text else ""
    table = _table(section.rows) if section.rows else ""
    cards = ""
    for shown in section.grasps:
        source = by_id.get(shown.grasp.source_grasp_id)
        cards += _card(shown, links, None if source is shown else source)
    grid = f'<div class="grid">{cards}</div>' if cards else ""
    return f"<section><h2>{_e(section.title)}</h2>{text}{table}{grid}</section>"


def _protocol_text(protocol: LiftProtocol) -> str:
    p, plant = protocol, protocol.plant
    return (
        f"Lifts follow protocol {p.name}: the hand closes from its pre-grasp in {p.close_s:g} s, squeezes for "
        f"{p.squeeze_s:g} s, rises {p.rise_m:g} m in {p.rise_s:g} s and holds for {p.hold_s:g} s. A lift succeeds "
        f"where the object's center of mass has risen at least {p.success_m:g} m and at least {p.fingertips} "
        f"fingertips touch it at the end. Simulated by Drake in steps of {1e3 * plant.time_step:g} ms with friction "
        f"{plant.friction:g}, point contact of {plant.point_stiffness:,.0f} N/m, and joints driven with "
        f"{plant.kp:g} N m/rad and {plant.kd:g} N m s/rad within their effort limits."
    )


def _protocol_numbers(protocol: LiftProtocol) -> str:
    values = asdict(protocol)
    plant = values.pop("plant")
    items = [*values.items(), *((f"plant.{name}", value) for name, value in plant.items())]
    return "".join(f"<dt>{_e(name)}</dt><dd>{_e(value)}</dd>" for name, value in items)


def versions() -> dict[str, str]:
    """Versions of what made a result: the library, Drake, NumPy, torch, Python, and the platform."""

    def version(package: str) -> str:
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            return "unknown"

    packages = {package: version(package) for package in ("xdex_drake", "drake", "numpy", "torch")}
    return {**packages, "python": platform.python_version(), "platform": f"{platform.system()} {platform.machine()}"}


def _page(
    sections: Sequence[ReportSection],
    links: Mapping[int, str],
    title: str,
    intro: str,
    protocol: LiftProtocol,
    seed: int | None,
    command: str,
) -> str:
    facts = versions()
    if seed is not None:
        facts = {"seed": str(seed), **facts}
    if command:
        facts = {"command": command, **facts}
    made = "".join(f"<dt>{_e(name)}</dt><dd>{_e(value)}</dd>" for name, value in facts.items())
    replays = any(shown.replay for section in sections for shown in section.grasps)
    hint = " A picture opens the recorded simulation; drag to turn it." if replays else ""
    lead = f"<p>{_e(intro)}{hint}</p>" if intro or hint else ""
    by_id = {g.grasp.grasp_id: g for section in sections for g in section.grasps if g.grasp.grasp_id}
    body = "".join(_section(section, links, by_id) for section in sections)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{_e(title)}</title>
<style>{_CSS}</style>
</head>
<body>
<main>
<header><h1>{_e(title)}</h1>{lead}<p>{_e(_protocol_text(protocol))}</p></header>
{body}
<footer>
<details><summary>Terms</summary><dl>
<dt>certified</dt><dd>a convex program found contact forces within the friction cones and the hand's efforts that hold
the object's weight; they are stored, and checked again without a solver</dd>
<dt>residual</dt><dd>unbalanced wrench of these forces, torque divided by the object's length, divided by its
weight</dd>
<dt>task margin</dt><dd>greatest multiple of pushes by the object's weight along six directions that is resisted within
the efforts</dd>
<dt>ball margin</dt><dd>certified bounds of the radius of the greatest ball of wrenches that forces whose normal parts
add up to 1 resist</dd>
<dt>penetration</dt><dd>depth of the deepest point of the object in the hand</dd>
</dl></details>
<details><summary>All numbers of the protocol</summary><dl>{_protocol_numbers(protocol)}</dl></details>
<details open><summary>Made with</summary><dl>{made}</dl></details>
</footer>
</main>
</body>
</html>
"""


_CSS = """
:root { --ink: #1c2430; --soft: #5b6675; --line: #dfe4ea; --page: #f6f7f9; --card: #ffffff; --good: #23834a;
  --bad: #b93636; --link: #2460a8; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6eaf0; --soft: #9aa5b4; --line: #313a46; --page: #14181d; --card: #1d232b; --good: #4fbf7c;
    --bad: #ef7f7f; --link: #82b4f0; }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink); font: 16px/1.55 system-ui, -apple-system, "Segoe UI",
  Roboto, "DejaVu Sans", sans-serif; }
main { max-width: 1180px; margin: 0 auto; padding: 24px 20px 60px; }
header p, section > p { max-width: 75ch; color: var(--soft); }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 8px 0 12px; }
h2 { font-size: 1.3rem; margin: 36px 0 8px; padding-top: 14px; border-top: 1px solid var(--line); }
h3 { font-size: 0.98rem; margin: 0 0 6px; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; min-width: min(640px, 100%); font-variant-numeric: tabular-nums; }
th, td { padding: 6px 14px; border-bottom: 1px solid var(--line); text-align: left; white-space: nowrap; }
th { color: var(--soft); font-weight: 600; font-size: 0.85rem; }
th.n, td.n { text-align: right; }
@media (max-width: 560px) { th, td { padding: 5px 7px; } table { font-size: 0.9rem; } }
tr.total td { font-weight: 600; border-bottom: none; }
.grid { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(270px, 100%), 1fr)); gap: 18px;
  margin-top: 18px; }
article { background: var(--card); border: 1px solid var(--line); border-radius: 10px; overflow: hidden; min-width: 0; }
article img { display: block; width: 100%; height: auto; }
article.pair { grid-column: span 2; }
@media (max-width: 620px) { article.pair { grid-column: auto; } }
.two { display: grid; grid-template-columns: 1fr 1fr; gap: 2px; }
figure { margin: 0; }
figcaption { padding: 3px 10px; font-size: 0.8rem; color: var(--soft); text-align: center; }
.blank { aspect-ratio: 4 / 3; display: grid; place-items: center; color: var(--soft); background: var(--page); }
.play { display: block; position: relative; color: inherit; }
.play span { position: absolute; right: 10px; bottom: 10px; padding: 2px 10px; border-radius: 999px; font-size: 0.8rem;
  background: rgba(20, 26, 34, 0.75); color: #fff; }
.play:hover span, .play:focus-visible span { background: var(--link); }
.body { padding: 12px 14px 14px; }
.badge { display: inline-block; padding: 0 9px; border-radius: 999px; border: 1px solid currentColor;
  color: var(--soft); font-size: 0.78rem; font-weight: 600; white-space: nowrap; }
.good .badge { color: var(--good); }
.bad .badge { color: var(--bad); }
dl { display: grid; grid-template-columns: auto 1fr; gap: 1px 12px; margin: 0; font-size: 0.86rem; }
dt { color: var(--soft); }
dd { margin: 0; overflow-wrap: anywhere; }
.note { margin: 0 0 6px; font-size: 0.86rem; }
details { margin: 12px 0; }
.body details { margin: 6px 0 0; font-size: 0.86rem; }
summary { cursor: pointer; color: var(--link); }
details ul { margin: 8px 0; padding-left: 20px; font-size: 0.9rem; }
details dl { margin: 8px 0 0; }
footer { margin-top: 40px; border-top: 1px solid var(--line); }
"""
