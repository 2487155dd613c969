"""A page that shows an imported hand with all that was decided about it, to be checked by a person."""

from __future__ import annotations

import html

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.importing.interpret import Imported
from xdex_drake.hand.yaml_file import hand_text
from xdex_drake.visualization.hand_browser import browser_page
from xdex_drake.visualization.page import script_data

AXIS_LENGTH = 0.09
PAD_LENGTH = 0.02
SPHERE_COLOR = Rgba(0.16, 0.47, 0.84, 0.35)
TIP_COLOR = Rgba(0.85, 0.10, 0.10, 1.0)
PAD_COLOR = Rgba(0.10, 0.10, 0.10, 1.0)


def import_page(imported: Imported) -> str:
    """A page with the hand, a slider for every joint, and what the importer decided.

    Switches show the wrist frame H (x red out of the palm, y green, z blue along the fingers), the fingertips with the
    direction of their pads, the collision spheres, and the collision shapes. A button saves the description.

    Args:
        imported: The hand and the decisions.

    Returns:
        HTML that needs no other file and no network.

    Raises:
        ConfigError: Meshcat finds no free port.
    """
    frame, tips, spheres = "wrist frame H", "tips and pads", "-collision spheres"
    paths: dict[str, list[str]] = {frame: [], tips: [], spheres: []}

    def extend(meshcat: Meshcat, path: str, hand: Hand) -> None:
        _draw_frame(meshcat, f"{path}/wrist_frame")
        paths[frame].append(f"{path}/wrist_frame")
        for k, link in enumerate(hand.links):
            for n, row in enumerate(link.spheres):
                meshcat.SetObject(f"{path}/{k}/spheres/{n}", Sphere(row[3]), SPHERE_COLOR)
                meshcat.SetTransform(f"{path}/{k}/spheres/{n}", RigidTransform(row[:3]))
            if len(link.spheres):
                meshcat.SetProperty(f"{path}/{k}/spheres", "visible", False)
                paths[spheres].append(f"{path}/{k}/spheres")
        for finger in hand.fingers:
            mark = f"{path}/{hand.link_index[finger.tip_link]}/tip_{finger.name}"
            meshcat.SetObject(f"{mark}/point", Sphere(2.5e-3), TIP_COLOR)
            meshcat.SetTransform(f"{mark}/point", RigidTransform(finger.p_LTip))
            _draw_rod(meshcat, f"{mark}/pad", finger.p_LTip, finger.n_LPad, PAD_LENGTH, 8e-4, PAD_COLOR)
            paths[tips].append(mark)

    return browser_page(
        [imported.hand], title=f"Import of {imported.hand.name}", extend=extend, switches=paths, more=_panel(imported)
    )


def _draw_frame(meshcat: Meshcat, path: str) -> None:
    for k, color in enumerate((Rgba(0.85, 0.1, 0.1, 1.0), Rgba(0.1, 0.6, 0.1, 1.0), Rgba(0.1, 0.2, 0.85, 1.0))):
        axis = np.eye(3)[k]
        _draw_rod(meshcat, f"{path}/{'xyz'[k]}", np.zeros(3), axis, AXIS_LENGTH, 1.5e-3, color)
        # A cone of Meshcat has its apex at its origin and opens along +z.
        meshcat.SetObject(f"{path}/{'xyz'[k]}_head", MeshcatCone(0.012, 0.004, 0.004), color)
        X_HC = RigidTransform(RotationMatrix.MakeFromOneVector(-axis, 2), (AXIS_LENGTH + 0.012) * axis)
        meshcat.SetTransform(f"{path}/{'xyz'[k]}_head", X_HC)
    # Seen through the palm, in which it begins.
    for name in ("x", "x_head", "y", "y_head", "z", "z_head"):
        meshcat.SetProperty(f"{path}/{name}/<object>", "material.depthTest", False)
        meshcat.SetProperty(f"{path}/{name}/<object>", "material.transparent", True)


def _draw_rod(
    meshcat: Meshcat, path: str, start: Array, direction: Array, length: float, radius: float, color: Rgba
) -> None:
    meshcat.SetObject(path, Cylinder(radius, length), color)
    R = RotationMatrix.MakeFromOneVector(direction, 2)
    meshcat.SetTransform(path, RigidTransform(R, start + 0.5 * length * np.asarray(direction)))


def _panel(imported: Imported) -> str:
    order = {"warning": 0, "mended": 1, "decided": 2}
    decisions = sorted(imported.decisions, key=lambda d: order.get(d.severity, 3))
    items = "".join(
        f'<li class="{html.escape(d.severity)}"><b>{html.escape(d.severity)}</b> {html.escape(d.subject)}: '
        f"{html.escape(d.text)}</li>"
        for d in decisions
    )
    data = script_data({"file": f"{imported.hand.name}.yaml", "text": hand_text(imported.hand)})
    return _PANEL.replace("@ITEMS@", items).replace("@DATA@", data)


_PANEL = """
<style>
#xdex-import { position: fixed; top: 12px; right: 12px; max-height: calc(100vh - 24px); width: min(22rem, 40vw);
  box-sizing: border-box; overflow-y: auto; padding: 12px 14px; border-radius: 8px;
  background: rgba(255, 255, 255, 0.9);
  color: #1d2430; font: 13px/1.4 system-ui, sans-serif; box-shadow: 0 1px 4px rgba(0, 0, 0, 0.2); }
#xdex-import h2 { display: inline; font-size: 14px; margin: 0 0 6px; }
#xdex-import summary { cursor: pointer; }
#xdex-import p { margin: 8px 0 0; }
#xdex-import button { font: inherit; padding: 3px 8px; border: 1px solid #b9c1cc; border-radius: 5px; background: #fff;
  color: inherit; }
#xdex-import .axes b { padding: 0 4px; }
#xdex-import ul { list-style: none; margin: 8px 0 0; padding: 0; }
#xdex-import li { margin-bottom: 6px; overflow-wrap: anywhere; }
#xdex-import li.warning b { color: #b3261e; }
#xdex-import li.mended b { color: #8a5a00; }
#xdex-import li.decided b { color: #2f6b3a; }
@media (max-width: 720px) { #xdex-import { left: 12px; width: auto; max-height: 46vh; } }
</style>
<div id="xdex-import">
  <details open><summary><h2>What was decided</h2></summary>
  <p class="axes">Wrist frame H: <b style="color:#d91a1a">x</b>out of the palm, <b style="color:#1a991a">y</b>to the
  thumb's side of a right hand, <b style="color:#1a33d9">z</b>toward the fingers.</p>
  <p><button type="button" id="xdex-yaml">Download the description</button></p>
  <ul>@ITEMS@</ul></details>
</div>
<script>
(function () {
  "use strict";
  const data = @DATA@;
  document.getElementById("xdex-yaml").addEventListener("click", () => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([data.text], {type: "application/yaml"}));
    link.download = data.file;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1500);
  });
  if (window.innerWidth < 720) document.querySelector("#xdex-import details").open = false;
})();
</script>
"""
