"""A page that shows an imported hand with all that was decided about it, to be checked by a person."""

from __future__ import annotations

import html
import json

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.importing.interpret import Imported
from xdex_drake.visualization.hand_browser import browser_page

AXIS_LENGTH = 0.06
PAD_LENGTH = 0.02
SPHERE_COLOR = Rgba(0.16, 0.47, 0.84, 0.35)
TIP_COLOR = Rgba(0.85, 0.10, 0.10, 1.0)
PAD_COLOR = Rgba(0.10, 0.10, 0.10, 1.0)


def import_page(imported: Imported) -> str:
    """A page with the hand, a slider for every joint, and what the importer decided.

    Fingers are colored by their names. Switches show the wrist frame H (x red out of the palm, y green, z blue along
    the fingers), the fingertips with the direction of their pads, the collision spheres, and the shapes.

    Args:
        imported: The hand and the decisions.

    Returns:
        HTML that needs no other file and no network.

    Raises:
        ConfigError: Meshcat finds no free port.
    """
    paths: dict[str, list[str]] = {"frame": [], "tips": [], "spheres": [], "shapes": []}

    def extend(meshcat: Meshcat, path: str, hand: Hand) -> None:
        _draw_frame(meshcat, f"{path}/wrist_frame")
        paths["frame"].append(f"{path}/wrist_frame")
        for k, link in enumerate(hand.links):
            for n, row in enumerate(link.spheres):
                meshcat.SetObject(f"{path}/{k}/spheres/{n}", Sphere(row[3]), SPHERE_COLOR)
                meshcat.SetTransform(f"{path}/{k}/spheres/{n}", RigidTransform(row[:3]))
            if len(link.spheres):
                meshcat.SetProperty(f"{path}/{k}/spheres", "visible", False)
                paths["spheres"].append(f"{path}/{k}/spheres")
            paths["shapes"] += [f"{path}/{k}/{n}" for n in range(len(link.geometry))]
        for finger in hand.fingers:
            mark = f"{path}/{hand.link_index[finger.tip_link]}/tip_{finger.name}"
            meshcat.SetObject(f"{mark}/point", Sphere(2.5e-3), TIP_COLOR)
            meshcat.SetTransform(f"{mark}/point", RigidTransform(finger.p_LTip))
            _draw_rod(meshcat, f"{mark}/pad", finger.p_LTip, finger.n_LPad, PAD_LENGTH, 8e-4, PAD_COLOR)
            paths["tips"].append(mark)

    page = browser_page([imported.hand], title=f"Import of {imported.hand.name}", extend=extend)
    head, body, tail = page.rpartition("</body>")
    return head + _panel(imported, paths) + body + tail


def _draw_frame(meshcat: Meshcat, path: str) -> None:
    for k, color in enumerate((Rgba(0.85, 0.1, 0.1, 1.0), Rgba(0.1, 0.6, 0.1, 1.0), Rgba(0.1, 0.2, 0.85, 1.0))):
        _draw_rod(meshcat, f"{path}/{'xyz'[k]}", np.zeros(3), np.eye(3)[k], AXIS_LENGTH, 1.2e-3, color)


def _draw_rod(
    meshcat: Meshcat, path: str, start: Array, direction: Array, length: float, radius: float, color: Rgba
) -> None:
    meshcat.SetObject(path, Cylinder(radius, length), color)
    R = RotationMatrix.MakeFromOneVector(direction, 2)
    meshcat.SetTransform(path, RigidTransform(R, start + 0.5 * length * np.asarray(direction)))


def _panel(imported: Imported, paths: dict[str, list[str]]) -> str:
    order = {"warning": 0, "mended": 1, "decided": 2}
    decisions = sorted(imported.decisions, key=lambda d: order.get(d.severity, 3))
    items = "".join(
        f'<li class="{html.escape(d.severity)}"><b>{html.escape(d.severity)}</b> {html.escape(d.subject)}: '
        f"{html.escape(d.text)}</li>"
        for d in decisions
    )
    names = {"frame": "wrist frame H", "tips": "tips and pads", "spheres": "collision spheres", "shapes": "shapes"}
    switches = "".join(
        f'<label><input type="checkbox" data-group="{group}"{"" if group == "spheres" else " checked"}> {name}</label>'
        for group, name in names.items()
    )
    data = json.dumps(paths, separators=(",", ":")).replace("</", "<\\/").replace("<!--", "<\\u0021--")
    return _PANEL.replace("@SWITCHES@", switches).replace("@ITEMS@", items).replace("@PATHS@", data)


_PANEL = """
<style>
#xdex-import { position: fixed; top: 12px; right: 12px; max-height: calc(100vh - 24px); width: min(22rem, 40vw);
  box-sizing: border-box; overflow-y: auto; padding: 12px 14px; border-radius: 8px;
  background: rgba(255, 255, 255, 0.9);
  color: #1d2430; font: 13px/1.4 system-ui, sans-serif; box-shadow: 0 1px 4px rgba(0, 0, 0, 0.2); }
#xdex-import h2 { font-size: 14px; margin: 0 0 6px; }
#xdex-import label { display: inline-block; margin-right: 10px; }
#xdex-import ul { list-style: none; margin: 8px 0 0; padding: 0; }
#xdex-import li { margin-bottom: 6px; overflow-wrap: anywhere; }
#xdex-import li.warning b { color: #b3261e; }
#xdex-import li.mended b { color: #8a5a00; }
#xdex-import li.decided b { color: #2f6b3a; }
</style>
<div id="xdex-import">
  <h2>What was decided</h2>
  <div>@SWITCHES@</div>
  <ul>@ITEMS@</ul>
</div>
<script>
(function () {
  "use strict";
  const paths = @PATHS@;
  document.querySelectorAll("#xdex-import input").forEach(box => box.addEventListener("change", () => {
    for (const path of paths[box.dataset.group])
      viewer.handle_command({type: "set_property", path: path, property: "visible", value: box.checked});
    viewer.set_dirty();
  }));
})();
</script>
"""
