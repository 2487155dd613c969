"""A page to browse hands: one Meshcat scene with a slider for every joint, which works offline.

Meshcat draws the links; where they are at the sliders' values is computed in the page, from the same tree of joints.
"""

from __future__ import annotations

import gc
import html
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.checks import hand_size
from xdex_drake.hand.description import Hand
from xdex_drake.visualization.dress import detail_for
from xdex_drake.visualization.page import FOV_Y, Trimmings, script_data, write_page
from xdex_drake.visualization.stage import draw_hand, draw_touch, link_labels, start_meshcat, touch_switch

MOST_HANDS = 100
"""A page of more hands than this grows too large for a browser."""

_PATH = "/drake/hands"


def browser_page(
    hands: Sequence[Hand],
    *,
    title: str = "Hands",
    extend: Callable[[Meshcat, str, Hand], None] | None = None,
    switches: Mapping[str, Sequence[str]] | None = None,
    more: str = "",
) -> str:
    """A page that shows one hand at a time, chosen from a list, with sliders for its actuated joints.

    Args:
        hands: The hands; at least one.
        title: Title of the page.
        extend: Draws more of a hand; it gets Meshcat, the hand's path, below which `PATH/k` moves with link k, and the
            hand.
        switches: More paths that a checkbox shows and hides, by its label; see `page.Trimmings`.
        more: HTML that follows.

    Returns:
        HTML that needs no other file and no network.

    Raises:
        ConfigError: There is no hand, there are more than `MOST_HANDS`, or Meshcat finds no free port.
    """
    if not 1 <= len(hands) <= MOST_HANDS:
        raise ConfigError(f"a page shows 1 to {MOST_HANDS} hands, not {len(hands)}; choose some of them")
    drawn = [(f"{_PATH}/{k}", hand, [str(n) for n in range(len(hand.links))]) for k, hand in enumerate(hands)]
    controls = _CONTROLS.replace("@TITLE@", html.escape(title)).replace("@PATH@", _PATH)
    controls = controls.replace("@HANDS@", script_data([_facts(hand) for hand in hands]))
    meshcat = start_meshcat(live=False)
    try:
        for path, hand, names in drawn:
            # Poses of links are left to the page, whose commands may come before Meshcat's own.
            draw_hand(meshcat, path, hand, names, detail_for(len(hands)))
            draw_touch(meshcat, path, hand, names)
            if extend is not None:
                extend(meshcat, path, hand)
        _aim(meshcat, max(hand_size(hand) for hand in hands))
        page = write_page(
            meshcat,
            Trimmings(
                title,
                names={path: label for each in drawn for path, label in link_labels(*each).items()},
                switches=touch_switch(drawn) | dict(switches or {}),
                more=controls + more,
                card=False,
            ),
        )
    finally:
        # Its port is to be free again now.
        del meshcat
        gc.collect()
    return page


def _aim(meshcat: Meshcat, size: float) -> None:
    """Looks at the palm and the thumb of a hand of some size [m], which appears right of the controls."""
    toward = np.array([0.80, 0.53, 0.28])
    right = np.cross([0.0, 0.0, 1.0], toward)
    target = np.array([0.0, 0.0, 0.5 * size]) - 0.22 * size * right
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=float(np.degrees(FOV_Y)), aspect=1.5, near=0.01, far=20.0))
    meshcat.SetCameraPose(target + 2.3 * size * toward, target)


def _facts(hand: Hand) -> dict[str, Any]:
    """What the page needs to move a hand: lengths in m, angles in rad, rotations row by row."""

    def row(values: Array) -> list[float]:
        return [float(f"{v:.7g}") for v in np.asarray(values).ravel()]

    return {
        "name": hand.name,
        "title": hand.display_name,
        "about": [
            ["base", hand.sources.get("base", "")],
            ["operations", hand.sources.get("variation", "")],
            ["links", str(len(hand.links))],
            ["joints", f"{len(hand.joint_names)} actuated of {len(hand.joints)}"],
            ["size", f"{100.0 * hand_size(hand):.1f} cm"],
        ],
        "R": row(hand.R_HB),
        "p": row(hand.p_HB),
        "joints": [
            {
                "slides": joint.kind == "prismatic",
                "parent": int(hand.parents[k + 1]),
                "R": row(joint.R_PJ),
                "p": row(joint.p_PJ),
                "axis": row(joint.axis),
                "master": int(np.argmax(np.abs(C))),
                "multiplier": float(C[np.argmax(np.abs(C))]),
                "offset": float(hand.coupling_offset[k]),
            }
            for k, (joint, C) in enumerate(zip(hand.joints, hand.coupling_matrix, strict=True))
        ],
        "names": list(hand.joint_names),
        "slides": [joint.kind == "prismatic" for joint in hand.joints if joint.coupling is None],
        "low": row(hand.limits[0]),
        "high": row(hand.limits[1]),
        "rest": row(hand.q_rest),
    }


_CONTROLS = """
<style>
#xdex-hands { position: fixed; top: 12px; left: 12px; bottom: 12px; width: min(19rem, 60vw); box-sizing: border-box;
  display: flex; flex-direction: column; padding: 12px 14px; border-radius: 8px; background: rgba(255, 255, 255, 0.9);
  color: #1d2430; font: 13px/1.4 system-ui, sans-serif; box-shadow: 0 1px 4px rgba(0, 0, 0, 0.2); }
#xdex-hands h1 { font-size: 15px; margin: 0 0 8px; }
#xdex-hands .row { display: flex; gap: 6px; margin-bottom: 8px; }
#xdex-hands select { flex: 1; min-width: 0; }
#xdex-hands select, #xdex-hands button { font: inherit; padding: 3px 8px; border: 1px solid #b9c1cc; border-radius: 5px;
  background: #fff; color: inherit; }
#xdex-hands dl { display: grid; grid-template-columns: auto 1fr; gap: 0 10px; margin: 0 0 8px; max-height: 11rem;
  overflow-y: auto; flex-shrink: 0; }
#xdex-hands dt { color: #5c6675; }
#xdex-hands dd { margin: 0; overflow-wrap: anywhere; }
#xdex-joints { overflow-y: auto; min-height: 3rem; }
#xdex-joints label { display: grid; grid-template-columns: 1fr auto; margin-bottom: 4px; }
#xdex-joints input { grid-column: 1 / 3; width: 100%; margin: 0; }
#xdex-joints span { overflow-wrap: anywhere; }
#xdex-hands .switches { margin-bottom: 8px; }
#xdex-hands .switches label { display: inline-block; margin-right: 12px; }
@media (max-width: 720px) { #xdex-hands { top: auto; right: 12px; width: auto; height: 44vh; }
  #xdex-hands dl { display: none; } }
#xdex-joints output { color: #5c6675; }
</style>
<div id="xdex-hands">
  <h1>@TITLE@</h1>
  <div class="row"><button id="xdex-before" title="hand before">&#9664;</button>
    <select id="xdex-hand" aria-label="hand"></select><button id="xdex-after" title="next hand">&#9654;</button></div>
  <dl id="xdex-about"></dl>
  <div class="row"><button id="xdex-rest">Rest</button><button id="xdex-straight">Straight</button>
    <button id="xdex-move">Move</button></div>
  <div id="xdex-joints"></div>
</div>
<script>
(function () {
  "use strict";
  const hands = @HANDS@;
  const at = id => document.getElementById(id);
  let shown = 0, q = [], moving = null;

  function times(A, B) {  // 3 x 3, row by row
    const C = new Array(9);
    for (let i = 0; i < 3; ++i) for (let j = 0; j < 3; ++j)
      C[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
    return C;
  }
  function applied(A, v) {
    return [0, 1, 2].map(i => A[3 * i] * v[0] + A[3 * i + 1] * v[1] + A[3 * i + 2] * v[2]);
  }
  function turn(a, t) {  // about a unit axis
    const c = Math.cos(t), s = Math.sin(t), d = 1 - c, [x, y, z] = a;
    return [c + d * x * x, d * x * y - s * z, d * x * z + s * y,
            d * y * x + s * z, c + d * y * y, d * y * z - s * x,
            d * z * x - s * y, d * z * y + s * x, c + d * z * z];
  }
  function poses(hand, q) {
    const links = [{R: hand.R, p: hand.p}];
    for (const joint of hand.joints) {
      const value = joint.multiplier * q[joint.master] + joint.offset, parent = links[joint.parent];
      const step = applied(parent.R, joint.p), J = times(parent.R, joint.R);
      const slide = joint.slides ? applied(J, joint.axis).map(v => v * value) : [0, 0, 0];
      links.push({R: joint.slides ? J : times(J, turn(joint.axis, value)),
                  p: [0, 1, 2].map(i => parent.p[i] + step[i] + slide[i])});
    }
    return links;
  }
  function draw() {
    poses(hands[shown], q).forEach(({R, p}, k) => viewer.handle_command({
      type: "set_transform", path: "@PATH@/" + shown + "/" + k,
      matrix: [R[0], R[3], R[6], 0, R[1], R[4], R[7], 0, R[2], R[5], R[8], 0, p[0], p[1], p[2], 1]}));
    viewer.set_dirty();
  }
  function text(value, slides) {
    return slides ? (1000 * value).toFixed(1) + " mm" : (180 / Math.PI * value).toFixed(0) + "\\u00b0";
  }
  function set(values) {
    q = values;
    at("xdex-joints").querySelectorAll("label").forEach((label, k) => {
      label.querySelector("input").value = q[k];
      label.querySelector("output").textContent = text(q[k], hands[shown].slides[k]);
    });
    draw();
  }
  function stop() { clearInterval(moving); moving = null; at("xdex-move").textContent = "Move"; }
  function show(index) {
    stop();
    shown = (index + hands.length) % hands.length;
    hands.forEach((_, k) => viewer.handle_command(
      {type: "set_property", path: "@PATH@/" + k, property: "visible", value: k === shown}));
    const hand = hands[shown];
    at("xdex-hand").value = shown;
    at("xdex-about").replaceChildren(...hand.about.filter(([, value]) => value).flatMap(([name, value]) => {
      const dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = name; dd.textContent = value;
      return [dt, dd];
    }));
    at("xdex-joints").replaceChildren(...hand.names.map((name, k) => {
      const label = document.createElement("label"), span = document.createElement("span");
      const output = document.createElement("output"), input = document.createElement("input");
      span.textContent = name;
      Object.assign(input, {type: "range", min: hand.low[k], max: hand.high[k], step: "any"});
      input.addEventListener("input", () => {
        stop();
        q[k] = Number(input.value);
        output.textContent = text(q[k], hand.slides[k]);
        draw();
      });
      label.append(span, output, input);
      return label;
    }));
    set(hand.rest.slice());
  }
  at("xdex-hand").append(...hands.map((hand, k) => new Option(hand.name, k)));
  at("xdex-hand").addEventListener("change", event => show(Number(event.target.value)));
  at("xdex-before").addEventListener("click", () => show(shown - 1));
  at("xdex-after").addEventListener("click", () => show(shown + 1));
  at("xdex-rest").addEventListener("click", () => { stop(); set(hands[shown].rest.slice()); });
  at("xdex-straight").addEventListener("click", () => {
    stop();
    const hand = hands[shown];
    set(hand.low.map((low, k) => Math.min(Math.max(0, low), hand.high[k])));
  });
  at("xdex-move").addEventListener("click", () => {
    if (moving !== null) return stop();
    at("xdex-move").textContent = "Stop";
    const begin = performance.now();
    // One joint after the other, through its range and back to rest.
    moving = setInterval(() => {
      const hand = hands[shown], t = (performance.now() - begin) / 1500;
      const joint = Math.floor(t) % hand.names.length, phase = 2 * Math.PI * (t % 1);
      const values = hand.rest.slice(), rest = hand.rest[joint], wave = Math.sin(phase);
      values[joint] = rest + (wave > 0 ? hand.high[joint] - rest : rest - hand.low[joint]) * wave;
      set(values);
    }, 40);
  });
  // The switches of the page stand among the controls.
  const card = at("xdex-card");
  if (card) {
    at("xdex-hands").insertBefore(card.querySelector(".switches"), at("xdex-joints"));
    card.remove();
  }
  // Where the controls are below, the hand is seen above them.
  function place() {
    const w = window.innerWidth, h = window.innerHeight;
    if (w > 720) viewer.camera.clearViewOffset();
    else viewer.camera.setViewOffset(w, h, 0.1 * w, 0.2 * h, w, h);
    viewer.set_dirty();
  }
  window.addEventListener("resize", place);
  [120, 520, 1520].forEach(wait => setTimeout(place, wait));
  show(0);
})();
</script>
"""
