"""A live page to play with: a hand, an object, a grasp at the press of a button, and sliders that it follows.

Three parts, so that nothing stalls: the browser shows Meshcat and the controls; a small server takes what is pressed
and tells what is going on, at once; this process draws, and leaves what takes longer to a process of its own.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar, TypeVar, get_args
from urllib.parse import urlsplit

import numpy as np
from pydrake.geometry import MeshcatAnimation
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.dataset.files import save_grasps
from xdex_drake.errors import ConfigError, XdexError
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.hand.looks import COARSE
from xdex_drake.programs.grasp_types import GraspType
from xdex_drake.scene.object import list_objects
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LIFT
from xdex_drake.visualization.film import FRAMES_PER_SECOND, Film
from xdex_drake.visualization.page import ASPECT, FOV_Y, script_data
from xdex_drake.visualization.replay import draw_certified
from xdex_drake.visualization.stage import aim, draw_hand, draw_object, draw_table, play_films, start_meshcat
from xdex_drake.visualization.studio_work import APPROACHES, Set, carry, film, find, lay_out, shaped_hand
from xdex_drake.visualization.views import Blobs, best_view, frame_blobs, hand_blobs, object_points

GENERATED = tuple(f"g0-{k:04d}" for k in range(8))
"""Generated hands that the page offers."""

VIEW = np.array([0.75, -0.85, 0.45])
"""Direction from what is shown toward the camera."""

MOST_BODY = 10_000
"""Longest message that the server reads [bytes]."""

Value = TypeVar("Value")


@dataclass(frozen=True)
class Choice:
    """What is chosen on the page.

    Attributes:
        hand: Name or path of the hand.
        object: Name or path of the object.
        pose: Number of the object's pose at rest.
        approach: One of `APPROACHES`.
        grasp_type: Type of grasp.
        object_size: Factor on the object's size.
        friction: Coefficient of friction.
        hand_size: Factor on the hand's size.
        finger_length: Factor on the lengths of its fingers.
    """

    hand: str = "allegro"
    object: str = "can"
    pose: int = 0
    approach: str = "any"
    grasp_type: GraspType = "any"
    object_size: float = 1.0
    friction: float = 0.6
    hand_size: float = 1.0
    finger_length: float = 1.0


SLIDERS = {
    "object_size": (0.7, 1.3, "object size"),
    "friction": (0.2, 1.0, "friction"),
    "hand_size": (0.8, 1.3, "hand size"),
    "finger_length": (0.85, 1.2, "finger length"),
}
"""Least and greatest value, and label, of each slider."""


@dataclass
class Telling:
    """What the page is told; written by the studio, read by the server.

    Attributes:
        said: What is going on, in words.
        busy: Whether something is being worked at.
        facts: Names and values of the grasp that is shown.
        choice: What is chosen.
        poses: How many ways the object has to rest on the table.
        done: How many presses have been dealt with.
    """

    said: str = "starting"
    busy: bool = True
    facts: list[tuple[str, str]] = field(default_factory=list)
    choice: Choice = field(default_factory=Choice)
    poses: int = 1
    done: int = 0


class Studio:
    """Deals with what is pressed, one press after the other; of sliders, the latest counts.

    Meshcat wants to be called by the thread that made it: `run` is to be called by the thread that made the studio.
    """

    def __init__(self, choice: Choice, folder: Path, *, meshcat_port: int | None = None) -> None:
        """Starts Meshcat and the working process.

        Args:
            choice: What to begin with.
            folder: Where hands and grasps are saved.
            meshcat_port: Port of Meshcat; a free one from 7000 on where None.

        Raises:
            ConfigError: Meshcat finds no free port.
        """
        self.presses: queue.Queue[dict[str, Any]] = queue.Queue()
        self.telling = Telling(choice=choice)
        self.meshcat = start_meshcat(meshcat_port, live=False)
        self._choice, self._folder = choice, folder
        # A fresh interpreter: the server's threads are not to be forked.
        self._pool = ProcessPoolExecutor(
            1, mp_context=multiprocessing.get_context("spawn"), initializer=_prepare_worker
        )
        self._place: Set | None = None
        self._hand: Hand | None = None
        self._scene: Scene | None = None
        self._grasp: Grasp | None = None
        self._batch = 0
        self._saved = 0

    def run(self) -> None:
        """Shows what was chosen and deals with presses until one says to stop."""
        try:
            self._deal({"press": "start"})
            while True:
                press = self.presses.get()
                if press.get("press") == "stop":
                    return
                # Of several movements of one slider the last counts.
                while press["press"] == "set" and not self.presses.empty():
                    following = self.presses.queue[0]
                    if following.get("press") != "set" or following.get("name") != press.get("name"):
                        break
                    self.telling.done += 1
                    press = self.presses.get()
                self._deal(press)
        finally:
            self._pool.shutdown(wait=False, cancel_futures=True)

    def _deal(self, press: dict[str, Any]) -> None:
        self.telling.busy = True
        try:
            said = self._ACTIONS[press["press"]](self, press)
        except XdexError as error:
            said = str(error)
        except Exception as error:
            # A page that goes on is of more use than one that ends; what happened is told.
            said = f"this went wrong: {type(error).__name__}: {error}"
        self.telling.said, self.telling.choice = said, self._choice
        self.telling.facts = _facts(self._grasp, self._hand)
        self.telling.done += 1
        self.telling.busy = not self.presses.empty()

    def _work(self, what: str, work: Callable[..., Value], *arguments: object) -> Value:
        """Has the working process do something, told on the page meanwhile."""
        self.telling.said = what
        future: Future[Value] = self._pool.submit(work, *arguments)
        return future.result()

    # ---- what can be pressed

    def _start(self, press: dict[str, Any]) -> str:
        self._lay_out()
        return "press grasp"

    def _set(self, press: dict[str, Any]) -> str:
        """A choice or a slider: the scene is laid out anew, and a grasp that was there follows."""
        before, place = self._choice, self._place
        self._choice = changed(before, press["name"], press["value"])
        if self._choice == before:
            return self.telling.said
        grasp = self._grasp
        if press["name"] in ("approach", "grasp_type"):
            self._batch = 0
            return self._grasp_anew() if grasp is not None else "press grasp"
        try:
            self._lay_out()
        except XdexError:
            self._choice = before
            raise
        if grasp is None:
            return "press grasp"
        assert place is not None and self._place is not None
        if press["name"] in ("hand", "hand_size", "finger_length"):
            return self._follow(grasp, place, self._place.hand)
        self._batch = 0
        return self._grasp_anew()

    def _grasp_now(self, press: dict[str, Any]) -> str:
        self._batch = 0
        return self._grasp_anew()

    def _next(self, press: dict[str, Any]) -> str:
        self._batch += 1
        return self._grasp_anew()

    def _carry(self, press: dict[str, Any]) -> str:
        if self._grasp is None or self._place is None:
            return "there is no grasp to carry; press grasp"
        grasp, place = self._grasp, self._place
        self._choice = replace(changed(self._choice, "hand", press["value"]), hand_size=1.0, finger_length=1.0)
        self._lay_out()
        assert self._place is not None
        return self._follow(grasp, place, self._place.hand)

    def _lift(self, press: dict[str, Any]) -> str:
        if self._grasp is None or self._place is None or self._hand is None or self._scene is None:
            return "there is no grasp to lift; press grasp"
        lift, frames = self._work("lifting", film, self._grasp, self._place)
        self._grasp = replace(self._grasp, lift=lift)
        self._clear()
        recorded = Film(self._grasp, self._hand, self._scene, lift, frames)
        play_films(
            self.meshcat,
            ["/drake/scene"],
            [recorded],
            np.zeros((1, 3)),
            frames_per_second=FRAMES_PER_SECOND,
            detail=COARSE,
        )
        # All of it stays in the picture, to the top.
        X_WC = best_view(
            self._grasp, self._hand, self._scene, fov_y=FOV_Y, aspect=ASPECT, rise_m=LIFT.rise_m, direction=VIEW
        )
        aim(self.meshcat, X_WC, self._scene.X_WO.translation() + np.array([0.0, 0.0, 0.5 * LIFT.rise_m]))
        self._reveal()
        return "lifted" if lift.success else f"not lifted: {lift.failure_reason.replace('_', ' ')}"

    def _save(self, press: dict[str, Any]) -> str:
        if self._grasp is None or self._place is None or self._hand is None or self._scene is None:
            return "there is no grasp to save; press grasp"
        self._folder.mkdir(parents=True, exist_ok=True)
        while (file := self._folder / f"grasp-{self._saved}.parquet").exists():
            self._saved += 1
        path = self._place.hand if Path(self._place.hand).suffix else None
        save_grasps(file, [self._grasp], self._hand, self._scene, hand_path=path)
        return f"saved to {file}"

    _ACTIONS: ClassVar[dict[str, Callable[[Studio, dict[str, Any]], str]]] = {
        "start": _start,
        "set": _set,
        "grasp": _grasp_now,
        "next": _next,
        "carry": _carry,
        "lift": _lift,
        "save": _save,
    }

    # ---- what they share

    def _lay_out(self) -> None:
        """Hand and scene of the choice, drawn without a grasp."""
        c = self._choice
        hand = self._work("shaping the hand", shaped_hand, c.hand, c.hand_size, c.finger_length, self._folder / "hands")
        place = self._work("preparing the object", lay_out, hand, c.object, c.pose, c.object_size, c.friction)
        self._hand, self._scene = load_hand(hand), place.scene.build()
        self._place, self._grasp = place, None
        self._choice = replace(c, pose=min(c.pose, place.poses - 1))
        self.telling.poses = place.poses
        self._draw()

    def _grasp_anew(self) -> str:
        assert self._place is not None
        c = self._choice
        found = self._work("searching, polishing, certifying", find, self._place, c.grasp_type, c.approach, self._batch)
        return self._show(found.grasp, found.said)

    def _follow(self, grasp: Grasp, place: Set, target: str) -> str:
        found = self._work("carrying the grasp over", carry, grasp, place, target)
        return self._show(found.grasp, found.said)

    def _show(self, grasp: Grasp | None, said: str) -> str:
        self._grasp = grasp
        self._draw()
        return said

    def _clear(self) -> None:
        self.meshcat.SetAnimation(MeshcatAnimation(FRAMES_PER_SECOND))
        self.meshcat.Delete("/drake/scene")
        # Seen once it is whole: a browser takes its parts one by one.
        self.meshcat.SetProperty("/drake/scene", "visible", False)

    def _reveal(self) -> None:
        self.meshcat.SetProperty("/drake/scene", "visible", True)

    def _draw(self) -> None:
        """The grasp with its forces; without one, the hand at rest above the object."""
        assert self._hand is not None and self._scene is not None
        hand, scene = self._hand, self._scene
        self._clear()
        draw_table(self.meshcat, [scene], scene.X_WO.translation())
        if self._grasp is not None:
            draw_certified(self.meshcat, "/drake/scene", self._grasp, hand, scene, COARSE)
            blobs = hand_blobs(hand, self._grasp.X_WH, self._grasp.q)
        else:
            X_WH = _above(scene)
            names = [link.name for link in hand.links]
            draw_hand(self.meshcat, f"/drake/scene/{hand.name}", hand, names, COARSE)
            R_WLs, p_WLs = forward_kinematics(hand, X_WH, hand.q_rest[None])
            for name, R, p in zip(names, R_WLs[0], p_WLs[0], strict=True):
                X_WL = RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), p)
                self.meshcat.SetTransform(f"/drake/scene/{hand.name}/{name}", X_WL)
            draw_object(self.meshcat, "/drake/scene/object", scene.object)
            self.meshcat.SetTransform("/drake/scene/object", scene.X_WO)
            blobs = hand_blobs(hand, X_WH, hand.q_rest)
        points, _, _ = object_points(scene)
        seen = Blobs(
            np.concatenate([blobs.centers_W, points]), np.concatenate([blobs.radii, np.full(len(points), 0.01)])
        )
        X_WC = frame_blobs(seen, VIEW, fov_y=FOV_Y, aspect=ASPECT, margin=1.35)
        aim(self.meshcat, X_WC, seen.centers_W.mean(axis=0))
        self._reveal()


def _above(scene: Scene) -> RigidTransform:
    """A wrist pose above an object, fingers down."""
    points, _, _ = object_points(scene)
    x, y, _ = points.mean(axis=0)
    R = RotationMatrix(np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]))
    return RigidTransform(R, [x - 0.05, y, float(points[:, 2].max()) + 0.24])


def _prepare_worker() -> None:
    """The working process leaves Ctrl-C to the one that it works for, and uses one thread."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update({name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")})


def changed(choice: Choice, name: str, value: object) -> Choice:
    """A choice with one of its values changed.

    Args:
        choice: The choice.
        name: Name of the value.
        value: The value, as the page sends it.

    Returns:
        The changed choice.

    Raises:
        ConfigError: There is no such value, or it is out of its range.
    """
    if name in SLIDERS:
        low, high, label = SLIDERS[name]
        try:
            number = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            number = float("nan")
        if not low <= number <= high:
            raise ConfigError(f"{label} is {value!r:.40}; give a number from {low:g} to {high:g}")
        return replace(choice, **{name: round(number, 3)})
    if name == "pose":
        if not (isinstance(value, int | str) and str(value).isdigit() and int(value) < 1000):
            raise ConfigError(f"pose is {value!r:.40}; give the number of a pose")
        return replace(choice, pose=int(value))
    offered = options(choice).get(name)
    if offered is None:
        raise ConfigError(f"there is nothing to choose by the name {name!r:.40}")
    if value not in offered:
        raise ConfigError(f"{name} is {value!r:.40}; choose one of {', '.join(offered)}")
    # Another hand has its own shape, another object its own poses.
    fresh: dict[str, Any] = {"hand": {"hand_size": 1.0, "finger_length": 1.0}, "object": {"pose": 0}}.get(name, {})
    return replace(choice, **{name: value, **fresh})


def options(choice: Choice) -> dict[str, list[str]]:
    """What can be chosen from, by the name of what is chosen; what is chosen now is always offered."""
    return {
        "hand": list(dict.fromkeys([*list_hands(), *GENERATED, choice.hand])),
        "object": list(dict.fromkeys([*list_objects(), choice.object])),
        "approach": list(APPROACHES),
        "grasp_type": list(get_args(GraspType)),
    }


def _facts(grasp: Grasp | None, hand: Hand | None) -> list[tuple[str, str]]:
    facts = [] if hand is None else [("hand", hand.display_name)]
    if grasp is None:
        return facts
    if (certificate := grasp.certificate) is not None:
        facts += [
            ("contacts", ", ".join(dict.fromkeys(contact.link for contact in certificate.contacts))),
            ("friction left", f"{100.0 * certificate.friction_left:.0f} %"),
            ("task margin", f"{certificate.task_margin:.2f}"),
        ]
    if grasp.lift is not None:
        facts.append(("lift", "lifted" if grasp.lift.success else grasp.lift.failure_reason.replace("_", " ")))
    return facts


# ---- the server


def serve(studio: Studio, port: int = 0) -> ThreadingHTTPServer:
    """Starts the studio's server in threads of its own, for this computer only.

    Args:
        studio: The studio.
        port: Port; a free one where 0.

    Returns:
        The server; its port is `server_address[1]`. End it by `shutdown()`.

    Raises:
        ConfigError: The port is taken.
    """
    page = _page(studio)

    class Handler(BaseHTTPRequestHandler):
        def _answer(self, status: int, kind: str, body: bytes) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

        def _ours(self) -> bool:
            """Whether the request comes from this page: no other site is to press buttons here."""
            host = self.headers.get("Host", "")
            origin = self.headers.get("Origin")
            local = urlsplit(f"//{host}").hostname in ("localhost", "127.0.0.1")
            return local and (origin is None or urlsplit(origin).netloc == host)

        def do_GET(self) -> None:
            if not self._ours():
                self._answer(403, "text/plain", b"for this computer only")
            elif self.path == "/":
                self._answer(200, "text/html; charset=utf-8", page)
            elif self.path == "/state":
                self._answer(200, "application/json", _state(studio.telling))
            elif self.path == "/favicon.ico":
                self._answer(204, "image/x-icon", b"")
            else:
                self._answer(404, "text/plain", b"there is nothing here")

        def do_POST(self) -> None:
            size = self.headers.get("Content-Length", "")
            if not self._ours() or self.path != "/press" or not size.isdigit() or int(size) > MOST_BODY:
                self._answer(403, "text/plain", b"this is not understood")
                return
            try:
                press = json.loads(self.rfile.read(int(size)))
            except ValueError:
                press = None
            if not isinstance(press, dict) or press.get("press") not in (
                "set",
                "grasp",
                "next",
                "carry",
                "lift",
                "save",
            ):
                self._answer(400, "text/plain", b"this is not understood")
                return
            studio.telling.busy = True
            studio.presses.put(press)
            self._answer(200, "application/json", _state(studio.telling))

        def log_message(self, format: str, *args: object) -> None:
            """Says nothing."""

    try:
        server = ThreadingHTTPServer(("localhost", port), Handler)
    except OSError as error:
        raise ConfigError(f"port {port} cannot be listened on ({error.strerror}); choose another by --port") from None
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


def _state(telling: Telling) -> bytes:
    c = telling.choice
    return json.dumps(
        {
            "said": telling.said,
            "busy": telling.busy,
            "facts": telling.facts,
            "choice": {name: getattr(c, name) for name in c.__dataclass_fields__},
            "poses": telling.poses,
            "done": telling.done,
        }
    ).encode()


def _page(studio: Studio) -> bytes:
    data = {
        "options": options(studio.telling.choice),
        "labels": {"hand": "hand", "object": "object", "approach": "approach", "grasp_type": "grasp type"},
        "sliders": {name: list(values) for name, values in SLIDERS.items()},
        "carry": options(studio.telling.choice)["hand"],
        "meshcat": studio.meshcat.web_url(),
    }
    return _PAGE.replace("@DATA@", script_data(data)).encode()


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>xdex studio</title>
<style>
* { box-sizing: border-box; }
body { margin: 0; height: 100vh; display: grid; grid-template-columns: 20rem 1fr; overflow: hidden;
  font: 14px/1.4 system-ui, sans-serif; color: #1d2430; background: #f6f7f9; }
#side { padding: 14px 16px; overflow-y: auto; border-right: 1px solid #dfe4ea; background: #fff; }
h1 { font-size: 17px; margin: 0 0 10px; }
#scene { position: relative; overflow: hidden; }
/* The bar of Meshcat's own controls lies above the edge. */
iframe { position: absolute; left: 0; top: -24px; width: 100%; height: calc(100% + 24px); border: 0; }
label { display: grid; grid-template-columns: 6.2rem 1fr; align-items: center; gap: 8px; margin-bottom: 6px; }
label.slider { grid-template-columns: 6.2rem 1fr 2.6rem; }
select, button { font: inherit; color: inherit; padding: 4px 8px; border: 1px solid #b9c1cc; border-radius: 6px;
  background: #fff; min-width: 0; }
input { min-width: 0; width: 100%; }
.row { display: flex; gap: 6px; margin: 10px 0; flex-wrap: wrap; }
.row button { flex: 1; }
button.main { background: #2460a8; border-color: #2460a8; color: #fff; }
button:disabled { opacity: 0.5; }
#said { min-height: 2.8em; padding: 8px 10px; margin: 10px 0; border-radius: 6px; background: #eef2f7;
  overflow-wrap: anywhere; }
#said.busy::before { content: ""; display: inline-block; width: 10px; height: 10px; margin-right: 8px;
  border: 2px solid #2460a8; border-right-color: transparent; border-radius: 50%;
  animation: turn 0.8s linear infinite; }
@keyframes turn { to { transform: rotate(360deg); } }
dl { display: grid; grid-template-columns: auto 1fr; gap: 1px 10px; margin: 0; }
dt { color: #5c6675; }
dd { margin: 0; overflow-wrap: anywhere; }
@media (max-width: 720px) { body { grid-template-columns: 1fr; grid-template-rows: 42vh 1fr; }
  #side { grid-row: 2; border-right: 0; border-top: 1px solid #dfe4ea; } #scene { grid-row: 1; } }
</style>
</head>
<body>
<div id="side">
  <h1>xdex studio</h1>
  <div id="choices"></div>
  <div class="row"><button type="button" class="main" data-press="grasp">grasp</button>
    <button type="button" data-press="next">next</button><button type="button" data-press="lift">lift</button>
    <button type="button" data-press="save">save</button></div>
  <label>carry to <select id="carry" aria-label="carry to"></select></label>
  <div id="said" role="status"></div>
  <dl id="facts"></dl>
  <div id="sliders" style="margin-top: 12px"></div>
</div>
<div id="scene"><iframe title="scene"></iframe></div>
<script>
(function () {
  "use strict";
  const data = @DATA@, at = id => document.getElementById(id);
  const make = (tag, more) => Object.assign(document.createElement(tag), more || {});
  const controls = {};
  document.querySelector("iframe").src = data.meshcat;

  async function send(press) {
    const answer = await fetch("/press", {method: "POST", body: JSON.stringify(press)});
    if (answer.ok) show(await answer.json());
  }
  function choose(name, label, values) {
    const box = make("label", {textContent: label}), select = make("select");
    select.append(...values.map(value => new Option(value, value)));
    select.addEventListener("change", () => send({press: "set", name: name, value: select.value}));
    select.dataset.name = name;
    box.append(select);
    at("choices").append(box);
    controls[name] = select;
  }
  for (const name of ["hand", "object"]) choose(name, data.labels[name], data.options[name]);
  choose("pose", "pose at rest", ["0"]);
  for (const name of ["approach", "grasp_type"]) choose(name, data.labels[name], data.options[name]);
  for (const [name, [low, high, label]] of Object.entries(data.sliders)) {
    const box = make("label", {textContent: label, className: "slider"}), output = make("output");
    const input = make("input", {type: "range", min: low, max: high, step: 0.01});
    input.dataset.name = name;
    input.addEventListener("input", () => { output.textContent = Number(input.value).toFixed(2); });
    input.addEventListener("change", () => send({press: "set", name: name, value: Number(input.value)}));
    box.append(input, output);
    at("sliders").append(box);
    controls[name] = input;
  }
  document.querySelectorAll("[data-press]").forEach(button =>
    button.addEventListener("click", () => send({press: button.dataset.press})));
  at("carry").append(new Option("choose a hand", ""), ...data.carry.map(hand => new Option(hand, hand)));
  at("carry").addEventListener("change", () => {
    if (at("carry").value) send({press: "carry", value: at("carry").value});
    at("carry").value = "";
  });

  function show(state) {
    at("said").textContent = state.said;
    at("said").classList.toggle("busy", state.busy);
    at("facts").replaceChildren(...state.facts.flatMap(([name, value]) =>
      [make("dt", {textContent: name}), make("dd", {textContent: value})]));
    document.body.dataset.done = state.done;
    document.body.dataset.busy = state.busy;
    const poses = controls.pose;
    if (poses.length !== state.poses)
      poses.replaceChildren(...Array.from({length: state.poses}, (_, k) => new Option(k, k)));
    if (state.busy) return;
    for (const [name, value] of Object.entries(state.choice)) {
      if (document.activeElement === controls[name] && controls[name].type === "range") continue;
      controls[name].value = value;
      if (controls[name].type === "range") controls[name].nextSibling.textContent = Number(value).toFixed(2);
    }
  }
  async function watch() {
    try {
      show(await (await fetch("/state")).json());
      setTimeout(watch, 250);
    } catch (error) {
      at("said").textContent = "the studio has ended; start it again by xdex studio";
      at("said").classList.remove("busy");
    }
  }
  watch();
})();
</script>
</body>
</html>
"""
