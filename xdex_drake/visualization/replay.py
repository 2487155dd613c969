"""Grasps and lifts in Drake's Meshcat: as pages that hold everything they need, and live."""

from __future__ import annotations

import gc
import html
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import (
    Box,
    Meshcat,
    MeshcatAnimation,
    MeshcatCone,
    MeshcatParams,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import contact_frames
from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.description import Hand
from xdex_drake.scene.belonging import check_belonging, check_liftable
from xdex_drake.scene.bodies import OBJECT_COLOR, TABLE_COLOR
from xdex_drake.scene.plant import build_plant
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.drake import lift_rig, simulate_lift
from xdex_drake.simulation.protocol import LIFT, LiftProtocol
from xdex_drake.visualization.forces import FORCE_COLOR, HandForces, add_arrow, place_arrow
from xdex_drake.visualization.views import Blobs, best_direction, best_view, frame_blobs, grasp_blobs

FRAMES_PER_SECOND = 32.0
"""A power of two, whose multiples of the period are exact: no frame is rounded into its neighbour's place."""

PAUSE_FRAMES = 20
"""Frames for which the end of a lift stands still before it starts again."""

FOV_Y = 0.7
"""Vertical field of view of the camera [rad]."""

ASPECT = 1.3
"""Least width of a window divided by its height that keeps this field of view."""

REPLAY_CPU_LIMIT_S = 300.0
"""A recorded lift is never given up where the lift itself was not [s]."""

REPETITIONS = 10_000
"""How often a page plays its lift by itself."""

CONE_COLOR = (0.20, 0.48, 0.95, 1.0)
CONE_HEIGHT = 0.02
"""Height of a friction cone [m]."""

OBJECT_OPACITY = 0.5
"""Opacity of an object whose friction cones are shown."""

GAP = 0.36
"""Distance of grasps that are shown side by side [m]."""

ROWS_ELEVATION = 0.6
"""Elevation from which several rows of grasps are seen [rad]."""

GRID_COLOR = (0.44, 0.46, 0.50)


@dataclass(frozen=True)
class Replay:
    """A recorded lift.

    Attributes:
        html: The page.
        lift: What the recorded simulation showed.
        frames: Number of frames that were recorded.
    """

    html: str
    lift: Lift
    frames: int


def start_meshcat(port: int | None = None, *, live: bool = True) -> Meshcat:
    """Starts Meshcat for this computer only, with a light background and without grid and axes.

    Args:
        port: Port to listen on; a free one from 7000 on where None.
        live: Whether somebody will open its address, which Drake then logs; False where only a page is written.

    Returns:
        The Meshcat; its address is `web_url()`. Its port is freed with the object.

    Raises:
        ConfigError: The port, or every port, is taken.
    """
    log = logging.getLogger("drake")
    level = log.level
    try:
        if not live:
            log.setLevel(max(level, logging.WARNING))
        meshcat = Meshcat(MeshcatParams(host="localhost", port=port, show_stats_plot=False))
    except RuntimeError as error:
        raise ConfigError(f"Meshcat cannot listen on port {port or '7000 to 7999'}: {error}; choose another") from None
    finally:
        log.setLevel(level)
    meshcat.SetProperty("/Background", "top_color", [0.93, 0.95, 0.98])
    meshcat.SetProperty("/Background", "bottom_color", [0.80, 0.83, 0.87])
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)
    return meshcat


def aim(meshcat: Meshcat, X_WC: RigidTransform, p_WT: Array) -> None:
    """Puts the camera at X_WC's position, orbiting about the point of its line of sight nearest to p_WT."""
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=float(np.degrees(FOV_Y)), aspect=1.5, near=0.01, far=20.0))
    p_WC, forward = X_WC.translation(), X_WC.rotation().matrix()[:, 2]
    meshcat.SetCameraPose(p_WC, p_WC + max(float((p_WT - p_WC) @ forward), 0.05) * forward)


def _draw_grid(meshcat: Meshcat, center: Array, half: float = 0.5, step: float = 0.05) -> None:
    """Lines on the table 5 cm apart, against which a rise can be seen."""
    ticks = np.arange(-half, half + 0.5 * step, step)
    starts = np.array([(x, -half, 0.0) for x in ticks] + [(-half, y, 0.0) for y in ticks])
    ends = np.array([(x, half, 0.0) for x in ticks] + [(half, y, 0.0) for y in ticks])
    # Just above the table.
    shift = np.array([center[0], center[1], 3e-4])
    meshcat.SetLineSegments("/drake/grid", (starts + shift).T, (ends + shift).T, 1.0, Rgba(*GRID_COLOR))


def _record(meshcat: Meshcat, grasp: Grasp, hand: Hand, scene: Scene, protocol: LiftProtocol) -> tuple[Lift, int]:
    """Simulates a lift and leaves its recording in Meshcat, published."""
    period = 1.0 / FRAMES_PER_SECOND

    def extend(builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
        MeshcatVisualizer.AddToBuilder(
            builder, scene_graph, meshcat, MeshcatVisualizerParams(publish_period=period, prefix="scene")
        )

    patient = replace(protocol, cpu_limit_s=max(protocol.cpu_limit_s, REPLAY_CPU_LIMIT_S))
    rig = lift_rig(hand, scene, protocol=patient, extend=extend)
    plant, context = rig.scene_plant.plant, rig.simulator.get_context()
    plant_context = plant.GetMyContextFromRoot(context)
    forces = HandForces(meshcat, plant, rig.scene_plant.hand_instance, "/drake/forces")
    frame = -1

    def monitor(root: Context) -> EventStatus:
        nonlocal frame
        now = int(root.get_time() * FRAMES_PER_SECOND + 1e-6)
        if now > frame:
            frame = now
            forces.publish(plant_context, root.get_time())
        return EventStatus.DidNothing()

    _draw_grid(meshcat, grasp.X_WO.translation())
    meshcat.StartRecording(frames_per_second=FRAMES_PER_SECOND)
    rig.simulator.set_monitor(monitor)
    lift = simulate_lift(rig, grasp)
    rig.simulator.clear_monitor()
    # The end, which no periodic event sees: where the lift fails before its first step it is the only frame.
    sound = lift.failure_reason != "simulation_failed"
    if sound:
        rig.scene_plant.diagram.ForcedPublish(context)
    meshcat.StopRecording()
    animation = meshcat.get_mutable_recording()
    last = int(animation.frame(context.get_time()))
    for body in [*rig.scene_plant.links, rig.scene_plant.object_body] if sound else []:
        assert body is not None
        # The path as the visualizer spells it: an absolute one would make a second track of the same body.
        path = f"scene/{plant.GetModelInstanceName(body.model_instance())}/{body.name()}"
        animation.SetTransform(last + PAUSE_FRAMES, path, plant.EvalBodyPoseInWorld(plant_context, body))
    forces.hold(animation, last + PAUSE_FRAMES)
    animation.set_autoplay(True)
    animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    animation.set_repetitions(REPETITIONS)
    meshcat.PublishRecording()
    return lift, last + 1


def record_lift(grasp: Grasp, hand: Hand, scene: Scene, *, protocol: LiftProtocol = LIFT) -> Replay:
    """Simulates a lift and records it as a page, failed ones too.

    Args:
        grasp: A grasp with pre-grasp and squeeze targets.
        hand: Its hand.
        scene: Its scene.
        protocol: The protocol.

    Returns:
        The page with the verdict of the recorded simulation.

    Raises:
        ConfigError: The grasp has no pre-grasp or no squeeze, or Meshcat finds no free port.
    """
    check_belonging(grasp, hand, scene)
    check_liftable(grasp)
    meshcat = start_meshcat(live=False)
    try:
        lift, frames = _record(meshcat, grasp, hand, scene, protocol)
        X_WC = best_view(grasp, hand, scene, fov_y=FOV_Y, aspect=ASPECT, rise_m=protocol.rise_m)
        aim(meshcat, X_WC, grasp.X_WO.translation() + np.array([0.0, 0.0, 0.5 * protocol.rise_m]))
        page = with_card(meshcat.StaticHtml(), *_lift_card(grasp, hand, lift))
    finally:
        # The diagram that drew on Meshcat may be part of a reference cycle; its port is to be free again now.
        del meshcat
        gc.collect()
    return Replay(page, lift, frames)


def replay_lift(grasp: Grasp, hand: Hand, scene: Scene, *, protocol: LiftProtocol = LIFT) -> str:
    """Simulates a lift and records it as a page; see `record_lift`.

    Args:
        grasp: A grasp with pre-grasp and squeeze targets.
        hand: Its hand.
        scene: Its scene.
        protocol: The protocol.

    Returns:
        HTML that needs no other file and no network, about 3 MB.
    """
    return record_lift(grasp, hand, scene, protocol=protocol).html


def draw_grasps(meshcat: Meshcat, grasps: Sequence[Grasp], hands: Sequence[Hand], scenes: Sequence[Scene]) -> None:
    """Draws grasps side by side, with contacts, friction cones and forces of their certificates.

    Args:
        meshcat: Where to draw.
        grasps: The grasps.
        hands: The hand of each.
        scenes: The scene of each.

    Raises:
        ConfigError: There is no grasp, the lengths differ, or what stands in one place does not belong together.
    """
    if not grasps or not len(grasps) == len(hands) == len(scenes):
        raise ConfigError(
            f"there are {len(grasps)} grasps, {len(hands)} hands and {len(scenes)} scenes; give as many of each"
        )
    for grasp, hand, scene in zip(grasps, hands, scenes, strict=True):
        check_belonging(grasp, hand, scene)
    direction = best_direction(grasps[0], hands[0], scenes[0])
    ahead = -np.array([direction[0], direction[1], 0.0]) / np.hypot(direction[0], direction[1])
    # Side by side as the camera sees them; several rows are seen from higher up.
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    columns = min(5, len(grasps)) if len(grasps) <= 5 else min(6, int(np.ceil(np.sqrt(1.6 * len(grasps)))))
    if len(grasps) > columns:
        direction = -ahead + np.array([0.0, 0.0, np.tan(ROWS_ELEVATION)])
    seen: list[Blobs] = []
    for k, (grasp, hand, scene) in enumerate(zip(grasps, hands, scenes, strict=True)):
        row, column = divmod(k, columns)
        in_row = min(columns, len(grasps) - row * columns)
        offset = GAP * ((column - 0.5 * (in_row - 1)) * right + row * ahead)
        _draw_grasp(meshcat, f"grasp_{k}", grasp, hand, scene, offset)
        blobs = grasp_blobs(grasp, hand, scene)
        seen.append(Blobs(blobs.centers_W + offset, blobs.radii))
    everything = Blobs(np.concatenate([b.centers_W for b in seen]), np.concatenate([b.radii for b in seen]))
    low, high = everything.centers_W.min(axis=0), everything.centers_W.max(axis=0)
    center, half = 0.5 * (low + high), float(0.5 * (high - low)[:2].max())
    # One table under all of them.
    size = 2.0 * half + 1.5
    meshcat.SetObject("/drake/table", Box(size, size, 0.1), Rgba(*TABLE_COLOR))
    meshcat.SetTransform("/drake/table", RigidTransform([center[0], center[1], -0.05]))
    _draw_grid(meshcat, center, 0.05 * np.ceil((half + 0.3) / 0.05))
    X_WC = frame_blobs(everything, direction, fov_y=FOV_Y, aspect=ASPECT, margin=1.3 if len(grasps) == 1 else 1.1)
    aim(meshcat, X_WC, center)


def _draw_grasp(meshcat: Meshcat, name: str, grasp: Grasp, hand: Hand, scene: Scene, offset: Array) -> None:
    def extend(builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, MeshcatVisualizerParams(prefix=name))

    scene_plant = build_plant(hand, scene, extend=extend)
    context = scene_plant.diagram.CreateDefaultContext()
    plant_context = scene_plant.plant.GetMyMutableContextFromRoot(context)
    scene_plant.set_wrist(plant_context, grasp.X_WH)
    scene_plant.set_joints(plant_context, grasp.q)
    scene_plant.set_object(plant_context, grasp.X_WO)
    scene_plant.diagram.ForcedPublish(context)
    path = f"/drake/{name}"
    meshcat.Delete(f"{path}/table")
    meshcat.SetTransform(path, RigidTransform(offset))
    if grasp.certificate is not None:
        # The cones open into the object, so it is drawn again to be seen through.
        meshcat.Delete(f"{path}/object")
        color = Rgba(*OBJECT_COLOR[:3], OBJECT_OPACITY)
        meshcat.SetTriangleMesh(f"{path}/glass", scene.object.vertices.T, scene.object.faces.T, color)
        meshcat.SetTransform(f"{path}/glass", grasp.X_WO)
        _draw_certificate(meshcat, f"{path}/certificate", grasp)


def _draw_certificate(meshcat: Meshcat, path: str, grasp: Grasp) -> None:
    """Contact points, friction cones and force arrows, in W."""
    certificate = grasp.certificate
    assert certificate is not None
    contacts = certificate.contacts
    R_WCs = grasp.X_WO.rotation().matrix() @ contact_frames([c.n_OC for c in contacts])
    for k, contact in enumerate(contacts):
        p_WC = grasp.X_WO @ contact.p_OC
        meshcat.SetObject(f"{path}/points/{k}", Sphere(0.003), Rgba(*FORCE_COLOR))
        meshcat.SetTransform(f"{path}/points/{k}", RigidTransform(p_WC))
        f_W = R_WCs[k] @ contact.f_C
        if np.linalg.norm(f_W) > 1e-6:
            add_arrow(meshcat, f"{path}/forces/{k}")
            place_arrow(meshcat, f"{path}/forces/{k}", p_WC, f_W)
        # A Meshcat cone has its apex at its origin and opens along +z: the friction cone, whose axis is the normal.
        cone = MeshcatCone(CONE_HEIGHT, contact.mu * CONE_HEIGHT, contact.mu * CONE_HEIGHT)
        meshcat.SetObject(f"{path}/cones/{k}", cone, Rgba(*CONE_COLOR))
        meshcat.SetTransform(f"{path}/cones/{k}", RigidTransform(RotationMatrix(R_WCs[k]), p_WC))


def grasp_page(grasps: Sequence[Grasp], hands: Sequence[Hand], scenes: Sequence[Scene], *, title: str = "") -> str:
    """A still page of grasps side by side, with the contacts, cones and forces of their certificates.

    Args:
        grasps: The grasps.
        hands: The hand of each.
        scenes: The scene of each.
        title: Title of the page; made from the grasps where empty.

    Returns:
        HTML that needs no other file and no network.

    Raises:
        ConfigError: There is no grasp, the lengths differ, or Meshcat finds no free port.
    """
    meshcat = start_meshcat(live=False)
    try:
        draw_grasps(meshcat, grasps, hands, scenes)
        page = with_card(meshcat.StaticHtml(), *_still_card(grasps, hands, title))
    finally:
        del meshcat
        gc.collect()
    return page


def view_live(
    grasps: Sequence[Grasp],
    hands: Sequence[Hand],
    scenes: Sequence[Scene],
    *,
    replay: bool = False,
    protocol: LiftProtocol = LIFT,
    port: int | None = None,
) -> Meshcat:
    """Starts Meshcat and shows grasps side by side, or the recorded lift of one.

    Args:
        grasps: The grasps.
        hands: The hand of each.
        scenes: The scene of each.
        replay: Whether to simulate and show the lift of the first grasp instead of still grasps.
        protocol: The protocol of the lift.
        port: Port to listen on; a free one from 7000 on where None.

    Returns:
        The Meshcat; open its `web_url()`. It lives as long as this object.

    Raises:
        ConfigError: There is no grasp, the lengths differ, a grasp cannot be lifted, or the port is taken.
    """
    if not replay:
        meshcat = start_meshcat(port)
        draw_grasps(meshcat, grasps, hands, scenes)
        return meshcat
    if not grasps:
        raise ConfigError("there is no grasp to lift; give one")
    grasp, hand, scene = grasps[0], hands[0], scenes[0]
    check_belonging(grasp, hand, scene)
    check_liftable(grasp)
    meshcat = start_meshcat(port)
    _record(meshcat, grasp, hand, scene, protocol)
    X_WC = best_view(grasp, hand, scene, fov_y=FOV_Y, aspect=ASPECT, rise_m=protocol.rise_m)
    aim(meshcat, X_WC, grasp.X_WO.translation() + np.array([0.0, 0.0, 0.5 * protocol.rise_m]))
    return meshcat


def _lift_card(grasp: Grasp, hand: Hand, lift: Lift) -> tuple[str, str, list[tuple[str, str]]]:
    """Title, verdict class and lines of the card of a lift."""
    verdict = "lifted" if lift.success else "not lifted"
    rows = [("object", grasp.object), ("rise", f"{round(100.0 * lift.lift_height_m, 1) + 0.0:.1f} cm")]
    if lift.failure_reason:
        rows.append(("reason", lift.failure_reason.replace("_", " ")))
    rows.append(("fingertips", ", ".join(lift.fingertips) or "none"))
    rows.append(("protocol", lift.protocol))
    if grasp.grasp_id:
        rows.append(("grasp", grasp.grasp_id))
    return f"{hand.display_name}: {verdict}", "good" if lift.success else "bad", rows


def _still_card(grasps: Sequence[Grasp], hands: Sequence[Hand], title: str) -> tuple[str, str, list[tuple[str, str]]]:
    names = dict.fromkeys(hand.display_name for hand in hands)
    objects = dict.fromkeys(grasp.object for grasp in grasps)
    rows = [("object", ", ".join(objects))]
    if len(grasps) == 1 and (certificate := grasps[0].certificate) is not None:
        rows += [
            ("contacts", ", ".join(contact.link for contact in certificate.contacts)),
            ("friction left", f"{100.0 * certificate.friction_left:.0f} %"),
            ("task margin", f"{certificate.task_margin:.2f}"),
            ("ball margin", f"{certificate.margin_lower:.3f}"),
        ]
    elif len(grasps) > 1:
        rows.append(("grasps", str(len(grasps))))
    return title or ", ".join(names), "", rows


def with_card(page: str, title: str, verdict: str, rows: Sequence[tuple[str, str]]) -> str:
    """A static page of Meshcat with a title, and a card in its corner."""
    lines = "".join(f"<dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd>" for name, value in rows)
    card = f"""
<style>
#xdex-card {{ position: fixed; bottom: 12px; left: 12px; max-width: min(22rem, 86vw); box-sizing: border-box;
  padding: 10px 14px; border-radius: 8px;
  background: rgba(255, 255, 255, 0.88); color: #1d2430; font: 14px/1.45 system-ui, sans-serif;
  box-shadow: 0 1px 4px rgba(0, 0, 0, 0.2); border-left: 5px solid #6b7686; }}
#xdex-card.good {{ border-color: #2e9e5b; }}
#xdex-card.bad {{ border-color: #cc3d3d; }}
#xdex-card h1 {{ font-size: 15px; margin: 0 0 4px; }}
#xdex-card dl {{ display: grid; grid-template-columns: auto 1fr; gap: 0 10px; margin: 0; }}
#xdex-card dt {{ color: #5c6675; }}
#xdex-card dd {{ margin: 0; overflow-wrap: anywhere; }}
</style>
<div id="xdex-card" class="{html.escape(verdict)}"><h1>{html.escape(title)}</h1><dl>{lines}</dl></div>
<script>
// Meshcat keeps the vertical field of view: where the window is narrow, see as much from side to side as on a wide one.
(function () {{
  const tangent = Math.tan({0.5 * FOV_Y});
  function fit() {{
    const camera = viewer.camera, aspect = window.innerWidth / window.innerHeight;
    if (!camera || !camera.isPerspectiveCamera) return;
    camera.fov = 2 * Math.atan(tangent * Math.max(1, {ASPECT} / aspect)) * 180 / Math.PI;
    camera.updateProjectionMatrix();
    viewer.set_dirty();
  }}
  window.addEventListener("resize", fit);
  [100, 500, 1500, 4000].forEach(wait => setTimeout(fit, wait));
}})();
</script>
"""
    head, body, tail = page.rpartition("</body>")
    if not body:
        raise RuntimeError("Meshcat's page has no </body>")
    head = head.replace("<title>Drake MeshCat</title>", f"<title>{html.escape(title)}</title>", 1)
    head = head.replace("<head>", '<head>\n  <meta name="viewport" content="width=device-width, initial-scale=1">', 1)
    return head + card + body + tail
