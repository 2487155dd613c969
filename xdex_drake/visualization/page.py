"""A static page of Meshcat as a page of ours: folded small, with player, legend, switches and names on hover."""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pydrake.geometry import Meshcat

FOV_Y = 0.7
"""Vertical field of view of the camera [rad]."""

ASPECT = 1.3
"""Least width of a window divided by its height that keeps this field of view."""

LIGHTS = (
    ("AmbientLight", 1.25),
    ("FillLight", 0.9),
    ("SpotLight", 18.0),
    ("PointLightNegativeX", 6.0),
    ("PointLightPositiveX", 6.0),
)
"""Meshcat's lights and their intensities: its own leave a black stripe between two lights on whatever is round."""

_SCRIPT = re.compile(r"<script(?: type=\"text/javascript\")?>(.*?)</script>", re.S)
_COMMAND = re.compile(
    r'fetch\("data:application/octet-binary;base64,([A-Za-z0-9+/=]*)"\)\s*\.then\(res => res\.arrayBuffer\(\)\)\s*'
    r"\.then\(buffer => viewer\.handle_command_bytearray\(new Uint8Array\(buffer\)\)\);"
)


@dataclass(frozen=True)
class Legend:
    """A line of a page's legend.

    Attributes:
        kind: What stands before it: "arrow", "cone" or "ball".
        color: Red, green, blue.
        text: What it says.
    """

    kind: str
    color: Sequence[float]
    text: str


@dataclass(frozen=True)
class Trimmings:
    """What a page has besides its scene.

    Attributes:
        title: Title; also the first line of the card.
        verdict: "good", "bad" or empty: the color of the card's edge.
        rows: Names and values on the card.
        legend: Lines of the legend.
        names: What to show where the pointer is over something, by path in Meshcat.
        switches: Paths that a checkbox shows and hides, by its label; a label that starts with "-" begins hidden.
        more: HTML that follows; its scripts run after the scene is there.
        card: Whether the card is drawn.
    """

    title: str
    verdict: str = ""
    rows: Sequence[tuple[str, str]] = ()
    legend: Sequence[Legend] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    switches: Mapping[str, Sequence[str]] = field(default_factory=dict)
    more: str = ""
    card: bool = True


def light(meshcat: Meshcat) -> None:
    """Gives Meshcat a light background, even light, and neither grid nor axes."""
    meshcat.SetProperty("/Background/<object>", "top_color", [0.93, 0.95, 0.98])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.80, 0.83, 0.87])
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)
    for name, intensity in LIGHTS:
        meshcat.SetProperty(f"/Lights/{name}/<object>", "intensity", intensity)


def write_page(meshcat: Meshcat, trimmings: Trimmings) -> str:
    """The page of what Meshcat shows.

    Args:
        meshcat: The scene.
        trimmings: What the page has besides.

    Returns:
        HTML that needs no other file and no network.
    """
    page = meshcat.StaticHtml()
    head, body, tail = page.rpartition("</body>")
    if not body:
        raise RuntimeError("Meshcat's page has no </body>")
    title = html.escape(trimmings.title)
    head = head.replace("<title>Drake MeshCat</title>", f"<title>{title}</title>", 1)
    head = head.replace("<head>", '<head>\n  <meta name="viewport" content="width=device-width, initial-scale=1">', 1)
    return fold(head + _chrome(trimmings) + body + tail)


def script_data(value: object) -> str:
    """A value as JavaScript within a page: what could end the script early is written another way."""
    return json.dumps(value, separators=(",", ":")).replace("</", "<\\/").replace("<!--", "<\\u0021--")


def fold(page: str) -> str:
    """Packs a page's scripts and Meshcat's commands, which the page unpacks when it is opened.

    Args:
        page: A static page of Meshcat.

    Returns:
        The page, about a third as large.
    """
    parts: list[tuple[int, bytes]] = []
    for match in _SCRIPT.finditer(page):
        text = match.group(1)
        parts.append((0, _COMMAND.sub("", text).encode()))
        parts += [(1, base64.b64decode(found)) for found in _COMMAND.findall(text)]
    packed = b"".join(bytes([kind]) + len(data).to_bytes(4, "little") + data for kind, data in parts)
    text = base64.b64encode(gzip.compress(packed, 9, mtime=0)).decode("ascii")
    head, body, tail = _SCRIPT.sub("", page).rpartition("</body>")
    return head + _UNFOLD.replace("@PACKED@", text) + body + tail


def unfold(page: str) -> list[tuple[str, bytes]]:
    """What a folded page holds, in order.

    Args:
        page: A page of `fold`.

    Returns:
        Pairs of "script" or "command" and its bytes.
    """
    found = re.search(r'"xdex-packed" hidden>([A-Za-z0-9+/=]+)<', page)
    if found is None:
        raise ValueError("the page is not folded")
    data, parts = gzip.decompress(base64.b64decode(found.group(1))), []
    while data:
        size = int.from_bytes(data[1:5], "little")
        parts.append(("command" if data[0] else "script", data[5 : 5 + size]))
        data = data[5 + size :]
    return parts


def _chrome(t: Trimmings) -> str:
    rows = "".join(f"<dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd>" for name, value in t.rows)
    legend = "".join(
        f'<li><i class="{line.kind}" style="--c:rgb({",".join(str(round(255 * c)) for c in line.color[:3])})"></i>'
        f"{html.escape(line.text)}</li>"
        for line in t.legend
    )
    switches = "".join(
        f'<label><input type="checkbox" data-switch="{k}"{"" if name.startswith("-") else " checked"}> '
        f"{html.escape(name.lstrip('-'))}</label>"
        for k, name in enumerate(t.switches)
    )
    card = f"<details open><summary><h1>{html.escape(t.title)}</h1></summary>" if t.card else "<details open>"
    card += f"<dl>{rows}</dl>" if rows else ""
    card += f"<ul>{legend}</ul>" if legend else ""
    card += f'<div class="switches">{switches}</div>' if switches else ""
    card = f'<div id="xdex-card" class="{html.escape(t.verdict)}">{card}</details></div>' if t.card or switches else ""
    data = script_data(
        {
            "names": dict(t.names),
            "switches": [list(paths) for paths in t.switches.values()],
            "fov": FOV_Y,
            "aspect": ASPECT,
        }
    )
    return f"<style>{_CSS}</style>{card}{_PLAYER}<script>{_JS.replace('@DATA@', data)}</script>{t.more}"


_CSS = """
.dg.main, .dg.ac { display: none !important; }
#xdex-card, #xdex-player, #xdex-name { font: 14px/1.45 system-ui, sans-serif; color: #1d2430; }
#xdex-card { position: fixed; top: 12px; left: 12px; max-width: min(20rem, 86vw); box-sizing: border-box;
  padding: 10px 14px; border-radius: 8px; background: rgba(255, 255, 255, 0.88);
  box-shadow: 0 1px 4px rgba(0, 0, 0, 0.2); border-left: 5px solid #6b7686; }
#xdex-card.good { border-color: #2e9e5b; }
#xdex-card.bad { border-color: #cc3d3d; }
#xdex-card summary { cursor: pointer; }
#xdex-card h1 { display: inline; font-size: 15px; margin: 0 0 4px; }
#xdex-card dl { display: grid; grid-template-columns: auto 1fr; gap: 0 10px; margin: 6px 0 0; }
#xdex-card dt { color: #5c6675; }
#xdex-card dd { margin: 0; overflow-wrap: anywhere; }
#xdex-card ul { list-style: none; margin: 6px 0 0; padding: 6px 0 0; border-top: 1px solid #d9dee5; }
#xdex-card li { display: flex; gap: 8px; align-items: center; font-size: 13px; }
#xdex-card li i { flex: none; width: 22px; height: 12px; background: var(--c); }
#xdex-card li i.arrow { clip-path: polygon(0 38%, 55% 38%, 55% 0, 100% 50%, 55% 100%, 55% 62%, 0 62%); }
#xdex-card li i.cone { clip-path: polygon(0 50%, 100% 0, 100% 100%); }
#xdex-card li i.ball { width: 10px; height: 10px; margin: 0 6px; border-radius: 50%; }
#xdex-card .switches { margin-top: 6px; font-size: 13px; }
#xdex-card .switches label { display: inline-block; margin-right: 12px; }
#xdex-player { position: fixed; bottom: 12px; left: 50%; transform: translateX(-50%); width: min(36rem, 94vw);
  box-sizing: border-box; display: none; gap: 8px; align-items: center; padding: 6px 12px; border-radius: 999px;
  background: rgba(255, 255, 255, 0.9); box-shadow: 0 1px 4px rgba(0, 0, 0, 0.2); }
#xdex-player button, #xdex-player select { font: inherit; color: inherit; border: 1px solid #b9c1cc; background: #fff;
  border-radius: 6px; padding: 2px 8px; min-width: 2.4em; }
#xdex-player input { flex: 1; min-width: 0; }
#xdex-player output { font-variant-numeric: tabular-nums; min-width: 5.5em; text-align: right; }
#xdex-name { position: fixed; display: none; pointer-events: none; padding: 2px 8px; border-radius: 6px;
  background: rgba(20, 26, 34, 0.85); color: #fff; font-size: 13px; z-index: 5; }
@media (max-width: 560px) { #xdex-card { font-size: 12.5px; max-width: 60vw; } #xdex-card li { font-size: 12px; } }
"""

_PLAYER = """
<div id="xdex-player"><button type="button" id="xdex-play" aria-label="play or pause">&#10074;&#10074;</button>
<input type="range" id="xdex-time" min="0" max="1" step="0.001" value="0" aria-label="time">
<output id="xdex-clock"></output>
<select id="xdex-speed" aria-label="speed"><option value="0.1">0.1 x</option><option value="0.25">0.25 x</option>
<option value="0.5">0.5 x</option><option value="1" selected>1 x</option><option value="2">2 x</option></select></div>
<div id="xdex-name"></div>
"""

_JS = """
(function () {
  "use strict";
  const data = @DATA@, at = id => document.getElementById(id);

  // Meshcat keeps the vertical field of view: a narrow window is to see as much from side to side as a wide one.
  const tangent = Math.tan(0.5 * data.fov);
  function fit() {
    const camera = viewer.camera, aspect = window.innerWidth / window.innerHeight;
    if (!camera || !camera.isPerspectiveCamera) return;
    camera.fov = 2 * Math.atan(tangent * Math.max(1, data.aspect / aspect)) * 180 / Math.PI;
    camera.updateProjectionMatrix();
    viewer.set_dirty();
  }
  window.addEventListener("resize", fit);
  [100, 500, 1500, 4000].forEach(wait => setTimeout(fit, wait));

  document.querySelectorAll("#xdex-card [data-switch]").forEach(box => {
    const turn = () => {
      for (const path of data.switches[box.dataset.switch])
        viewer.handle_command({type: "set_property", path: path, property: "visible", value: box.checked});
      viewer.set_dirty();
    };
    box.addEventListener("change", turn);
    setTimeout(turn, 300);
  });

  // The player, where there is something to play.
  const animator = viewer.animator;
  let scrubbing = false;
  function now() { return animator.actions.reduce((most, action) => Math.max(most, action.time), 0); }
  function show() {
    at("xdex-play").innerHTML = animator.playing ? "&#10074;&#10074;" : "&#9654;";
    at("xdex-clock").textContent = now().toFixed(2) + " s";
    if (!scrubbing) at("xdex-time").value = now();
  }
  function begin() {
    if (!animator.actions.length) return;
    at("xdex-player").style.display = "flex";
    at("xdex-time").max = animator.duration;
    setInterval(show, 60);
  }
  at("xdex-play").addEventListener("click", () => { animator.playing ? animator.pause() : animator.play(); show(); });
  at("xdex-time").addEventListener("input", event => {
    scrubbing = true;
    if (animator.playing) animator.pause();
    animator.seek(Number(event.target.value));
    show();
  });
  at("xdex-time").addEventListener("change", () => { scrubbing = false; });
  at("xdex-speed").addEventListener("change", event => { animator.mixer.timeScale = Number(event.target.value); });
  setTimeout(begin, 300);

  // Names of what the pointer is over.
  const THREE = MeshCat.THREE, ray = new THREE.Raycaster(), tip = at("xdex-name"), pane = at("meshcat-pane");
  let last = 0;
  function named(object) {
    const path = [];
    for (let node = object; node && node !== viewer.scene; node = node.parent) path.unshift(node.name);
    for (let n = path.length; n > 0; --n) {
      const name = data.names["/" + path.slice(0, n).join("/")];
      if (name) return name;
    }
    return "";
  }
  function seen(object) { for (let n = object; n; n = n.parent) if (!n.visible) return false; return true; }
  pane.addEventListener("pointermove", event => {
    if (event.buttons || !Object.keys(data.names).length || performance.now() - last < 60) {
      if (event.buttons) tip.style.display = "none";
      return;
    }
    last = performance.now();
    const x = 2 * event.clientX / window.innerWidth - 1, y = 1 - 2 * event.clientY / window.innerHeight;
    ray.setFromCamera({x, y}, viewer.camera);
    const hit = ray.intersectObjects(viewer.scene.children, true).find(h => h.object.isMesh && seen(h.object));
    const name = hit ? named(hit.object) : "";
    tip.textContent = name;
    tip.style.display = name ? "block" : "none";
    tip.style.left = Math.min(event.clientX + 14, window.innerWidth - 160) + "px";
    tip.style.top = event.clientY + 14 + "px";
  });
})();
"""

_UNFOLD = """
<div id="xdex-packed" hidden>@PACKED@</div>
<script>
(async function () {
  "use strict";
  const text = document.getElementById("xdex-packed").textContent;
  const stream = new Blob([Uint8Array.from(atob(text), c => c.charCodeAt(0))]).stream();
  const bytes = new Uint8Array(await new Response(stream.pipeThrough(new DecompressionStream("gzip"))).arrayBuffer());
  const view = new DataView(bytes.buffer), decoder = new TextDecoder();
  for (let k = 0; k < bytes.length;) {
    const size = view.getUint32(k + 1, true), part = bytes.slice(k + 5, k + 5 + size);
    if (bytes[k]) viewer.handle_command_bytearray(part);
    else {
      const script = document.createElement("script");
      script.textContent = decoder.decode(part);
      document.body.append(script);
    }
    k += 5 + size;
  }
})().catch(error => {
  console.error(error);
  document.body.insertAdjacentText("afterbegin", "This page needs a browser of 2023 or later with WebGL.");
});
</script>
"""
