"""What the pictures of benchmarks share: a panel of its own that follows the reader's light or dark pages."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

FONT = 12
"""Size of the text [px]."""

_STYLE = """<style>
.panel { fill: #ffffff; stroke: #d0d7de; } text { fill: #1f2328; } .faint { stroke: #d8dee4; } .soft { fill: #59636e; }
.bar { fill: #4878a8; } .tail { stroke: #59636e; } .target { stroke: #c03030; stroke-width: 2; }
@media (prefers-color-scheme: dark) {
.panel { fill: #161b22; stroke: #30363d; } text { fill: #e6edf3; } .faint { stroke: #30363d; } .soft { fill: #9198a1; }
.bar { fill: #5b93c9; } .tail { stroke: #9198a1; } .target { stroke: #f0625d; }
}
</style>"""


def picture_of(title: str, width: float, height: float, lines: Sequence[str]) -> str:
    """An SVG file with a panel and a title.

    Text stands on the panel, not on the page, so that it can be read on any page.

    Args:
        title: Title of the picture.
        width: Width [px].
        height: Height [px].
        lines: Elements of the picture.

    Returns:
        The text of the file.
    """
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" font-family="sans-serif" font-size="{FONT}">'
    )
    panel = f'<rect class="panel" x="0.5" y="0.5" width="{width - 1:.0f}" height="{height - 1:.0f}" rx="6"/>'
    title_line = f'<text x="14" y="22" font-size="{FONT + 2}">{escape(title)}</text>'
    return "\n".join([head, _STYLE, panel, title_line, *lines, "</svg>"]) + "\n"


def room_for(texts: Sequence[str]) -> float:
    """Width that the longest of some texts may take, in any usual font [px]."""
    return 0.58 * FONT * max(map(len, texts), default=0)


def duration(ms: float) -> str:
    """A time with two or three figures in the unit that suits it.

    Args:
        ms: The time [ms].

    Returns:
        Such as 94 us, 1.72 ms or 2.4 s.
    """
    if ms == 0.0:
        return "0 ms"
    value, unit = (1e3 * ms, "µs") if ms < 0.1 else (ms, "ms") if ms < 999.5 else (1e-3 * ms, "s")
    return f"{value:.0f} {unit}" if value >= 99.5 else f"{value:.3g} {unit}"
