"""Grasps and lifts in Drake's Meshcat: as pages that hold everything they need, and live."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import contact_frames
from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.looks import FINE, Detail
from xdex_drake.scene.belonging import check_belonging, check_liftable
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LIFT, LiftProtocol, usual_protocol
from xdex_drake.visualization.dress import detail_for
from xdex_drake.visualization.film import FRAMES_PER_SECOND, Film, film_lift
from xdex_drake.visualization.forces import FORCE_COLOR, add_arrow, force_legend, place_arrow
from xdex_drake.visualization.page import ASPECT, FOV_Y, Legend, Trimmings, write_page
from xdex_drake.visualization.stage import (
    aim,
    draw_hand,
    draw_object,
    draw_obstacles,
    draw_table,
    draw_touch,
    link_labels,
    play_films,
    start_meshcat,
    touch_switch,
)
from xdex_drake.visualization.views import Blobs, best_direction, best_view, frame_blobs, grasp_blobs

CONE_COLOR = (0.20, 0.48, 0.95)
CONE_OPACITY = 0.55
CONE_HEIGHT = 0.02
"""Height of a friction cone [m]."""

OBJECT_OPACITY = 0.5
"""Opacity of an object whose friction cones are shown."""

GAP = 0.36
"""Distance of grasps that are shown side by side [m]."""

ROWS_ELEVATION = 0.6
"""Elevation from which several rows of grasps are seen [rad]."""


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


def record_lift(grasp: Grasp, hand: Hand, scene: Scene, *, protocol: LiftProtocol | None = None) -> Replay:
    """Simulates a lift and records it as a page, failed ones too.

    Args:
        grasp: A grasp with pre-grasp and squeeze targets.
        hand: Its hand.
        scene: Its scene.
        protocol: The protocol; that of `usual_protocol` where None.

    Returns:
        The page with the verdict of the recorded simulation.

    Raises:
        ConfigError: The grasp has no pre-grasp or no squeeze, or Meshcat finds no free port.
    """
    protocol = protocol or usual_protocol(scene)
    film = film_lift(grasp, hand, scene, protocol=protocol)
    return Replay(films_page([film], rise_m=protocol.rise_m), film.lift, len(film.frames))


def films_page(films: Sequence[Film], *, title: str = "", rise_m: float = LIFT.rise_m) -> str:
    """A page that plays recorded lifts side by side.

    Args:
        films: The lifts; at least one.
        title: Title of the page; made from the lifts where empty.
        rise_m: Height by which they rise, which stays in the picture [m].

    Returns:
        HTML that needs no other file and no network.

    Raises:
        ConfigError: There is no lift, or Meshcat finds no free port.
    """
    if not films:
        raise ConfigError("there is no lift to show; give one")
    meshcat = start_meshcat(live=False)
    try:
        paths = _show_films(meshcat, films, rise_m)
        hands = [
            (f"{path}/{f.hand.name}", f.hand, [k.name for k in f.hand.links])
            for path, f in zip(paths, films, strict=True)
        ]
        for each in hands:
            draw_touch(meshcat, *each)
        made_title, verdict, rows = _lift_card(films[0]) if len(films) == 1 else _lifts_card(films)
        page = write_page(
            meshcat,
            Trimmings(
                title or made_title,
                verdict,
                rows,
                legend=[force_legend(max(film.most_force for film in films))],
                names=_names(hands) | {f"{path}/object": f.grasp.object for path, f in zip(paths, films, strict=True)},
                switches=touch_switch(hands) | {"forces": [f"{path}/forces" for path in paths]},
            ),
        )
    finally:
        # Its port is to be free again now.
        del meshcat
        gc.collect()
    return page


def _names(hands: Sequence[tuple[str, Hand, Sequence[str]]]) -> dict[str, str]:
    return {path: label for hand in hands for path, label in link_labels(*hand).items()}


def _show_films(meshcat: Meshcat, films: Sequence[Film], rise_m: float) -> list[str]:
    """Draws and plays lifts side by side; returns their paths."""
    paths = ["/drake/scene"] if len(films) == 1 else [f"/drake/scene_{k}" for k in range(len(films))]
    grasps, hands, scenes = [f.grasp for f in films], [f.hand for f in films], [f.scene for f in films]
    if len(films) == 1:
        offsets = np.zeros((1, 3))
        X_WC = best_view(grasps[0], hands[0], scenes[0], fov_y=FOV_Y, aspect=ASPECT, rise_m=rise_m)
        center, half = grasps[0].X_WO.translation(), 0.5
    else:
        offsets, direction = _side_by_side(grasps, hands, scenes)
        everything = _all_blobs(grasps, hands, scenes, offsets, rise_m)
        X_WC = frame_blobs(everything, direction, fov_y=FOV_Y, aspect=ASPECT, margin=1.1)
        center, half = _middle(everything)
    draw_table(meshcat, scenes, center, half)
    play_films(meshcat, paths, films, offsets, frames_per_second=FRAMES_PER_SECOND, detail=detail_for(len(films)))
    aim(meshcat, X_WC, np.array([center[0], center[1], center[2] + 0.5 * rise_m]))
    return paths


def replay_lift(grasp: Grasp, hand: Hand, scene: Scene, *, protocol: LiftProtocol | None = None) -> str:
    """Simulates a lift and records it as a page; see `record_lift`.

    Args:
        grasp: A grasp with pre-grasp and squeeze targets.
        hand: Its hand.
        scene: Its scene.
        protocol: The protocol; that of `usual_protocol` where None.

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
    offsets, direction = _side_by_side(grasps, hands, scenes)
    for k, (grasp, hand, scene, offset) in enumerate(zip(grasps, hands, scenes, offsets, strict=True)):
        path = f"/drake/grasp_{k}"
        draw_certified(meshcat, path, grasp, hand, scene, detail_for(len(grasps)))
        meshcat.SetTransform(path, RigidTransform(offset))
    everything = _all_blobs(grasps, hands, scenes, offsets, 0.0)
    center, half = _middle(everything)
    draw_table(meshcat, scenes, center, half)
    X_WC = frame_blobs(everything, direction, fov_y=FOV_Y, aspect=ASPECT, margin=1.3 if len(grasps) == 1 else 1.1)
    aim(meshcat, X_WC, center)


def _side_by_side(grasps: Sequence[Grasp], hands: Sequence[Hand], scenes: Sequence[Scene]) -> tuple[Array, Array]:
    """Where to move each grasp [m], shape (n, 3), and the direction from which they are seen, shape (3,)."""
    direction = best_direction(grasps[0], hands[0], scenes[0])
    ahead = -np.array([direction[0], direction[1], 0.0]) / np.hypot(direction[0], direction[1])
    # Side by side as the camera sees them; several rows are seen from higher up.
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    columns = min(5, len(grasps)) if len(grasps) <= 5 else min(6, int(np.ceil(np.sqrt(1.6 * len(grasps)))))
    if len(grasps) > columns:
        direction = -ahead + np.array([0.0, 0.0, np.tan(ROWS_ELEVATION)])
    offsets = []
    for k in range(len(grasps)):
        row, column = divmod(k, columns)
        in_row = min(columns, len(grasps) - row * columns)
        offsets.append(GAP * ((column - 0.5 * (in_row - 1)) * right + row * ahead))
    return np.array(offsets), direction


def _all_blobs(
    grasps: Sequence[Grasp], hands: Sequence[Hand], scenes: Sequence[Scene], offsets: Array, rise_m: float
) -> Blobs:
    blobs = [grasp_blobs(g, hand, scene, rise_m=rise_m) for g, hand, scene in zip(grasps, hands, scenes, strict=True)]
    centers = [b.centers_W + offset for b, offset in zip(blobs, offsets, strict=True)]
    return Blobs(np.concatenate(centers), np.concatenate([b.radii for b in blobs]))


def _middle(blobs: Blobs) -> tuple[Array, float]:
    """Middle of everything, and half of the table under it [m]."""
    low, high = blobs.centers_W.min(axis=0), blobs.centers_W.max(axis=0)
    return 0.5 * (low + high), float(0.5 * (high - low)[:2].max()) + 0.3


def draw_certified(meshcat: Meshcat, path: str, grasp: Grasp, hand: Hand, scene: Scene, detail: Detail = FINE) -> None:
    """Draws a grasp with contacts, friction cones and forces of its certificate.

    Args:
        meshcat: Where to draw.
        path: Path of hand, object and certificate.
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.
        detail: How finely the hand is drawn.
    """
    names = [link.name for link in hand.links]
    draw_hand(meshcat, f"{path}/{hand.name}", hand, names, detail)
    R_WLs, p_WLs = forward_kinematics(hand, grasp.X_WH, grasp.q[None])
    for name, R, p in zip(names, R_WLs[0], p_WLs[0], strict=True):
        X_WL = RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), p)
        meshcat.SetTransform(f"{path}/{hand.name}/{name}", X_WL)
    # The cones open into the object, so it is to be seen through.
    draw_object(meshcat, f"{path}/object", scene.object, 1.0 if grasp.certificate is None else OBJECT_OPACITY)
    meshcat.SetTransform(f"{path}/object", grasp.X_WO)
    draw_obstacles(meshcat, path, scene)
    if grasp.certificate is not None:
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
        meshcat.SetObject(f"{path}/cones/{k}", cone, Rgba(*CONE_COLOR, CONE_OPACITY))
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
        drawn = [
            (f"/drake/grasp_{k}/{hand.name}", hand, [link.name for link in hand.links]) for k, hand in enumerate(hands)
        ]
        for each in drawn:
            draw_touch(meshcat, *each)
        certified = [k for k, grasp in enumerate(grasps) if grasp.certificate is not None]
        page = write_page(
            meshcat,
            Trimmings(
                *_still_card(grasps, hands, title),
                legend=_certificate_legend(grasps) if certified else (),
                names=_names(drawn) | {f"/drake/grasp_{k}/object": grasp.object for k, grasp in enumerate(grasps)},
                switches=touch_switch(drawn)
                | ({"forces and cones": [f"/drake/grasp_{k}/certificate" for k in certified]} if certified else {}),
            ),
        )
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
    protocol: LiftProtocol | None = None,
    port: int | None = None,
) -> Meshcat:
    """Starts Meshcat and shows grasps side by side, or the recorded lift of one.

    Args:
        grasps: The grasps.
        hands: The hand of each.
        scenes: The scene of each.
        replay: Whether to simulate and show the lift of the first grasp instead of still grasps.
        protocol: The protocol of the lift; that of `usual_protocol` where None.
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
    protocol = protocol or usual_protocol(scene)
    film = film_lift(grasp, hand, scene, protocol=protocol)
    meshcat = start_meshcat(port)
    _show_films(meshcat, [film], protocol.rise_m)
    return meshcat


def _lift_card(film: Film) -> tuple[str, str, list[tuple[str, str]]]:
    """Title, verdict class and lines of the card of a lift."""
    grasp, lift = film.grasp, film.lift
    verdict = "lifted" if lift.success else "not lifted"
    rows = [("object", grasp.object), ("rise", f"{round(100.0 * lift.lift_height_m, 1) + 0.0:.1f} cm")]
    if lift.failure_reason:
        rows.append(("reason", lift.failure_reason.replace("_", " ")))
    rows.append(("fingertips", ", ".join(lift.fingertips) or "none"))
    rows.append(("protocol", lift.protocol))
    if grasp.grasp_id:
        rows.append(("grasp", grasp.grasp_id))
    return f"{film.hand.display_name}: {verdict}", "good" if lift.success else "bad", rows


def _lifts_card(films: Sequence[Film]) -> tuple[str, str, list[tuple[str, str]]]:
    lifted = sum(film.lift.success for film in films)
    objects = dict.fromkeys(film.grasp.object for film in films)
    title = f"{', '.join(objects)}: {lifted} of {len(films)} lifted"
    rows = [
        (f.hand.name, "lifted" if f.lift.success else f.lift.failure_reason.replace("_", " ") or "not lifted")
        for f in films
    ]
    return title, "good" if lifted == len(films) else "", rows


def _certificate_legend(grasps: Sequence[Grasp]) -> list[Legend]:
    contacts = [c for grasp in grasps if grasp.certificate is not None for c in grasp.certificate.contacts]
    most = max((float(np.linalg.norm(c.f_C)) for c in contacts), default=0.0)
    friction = sorted({round(c.mu, 3) for c in contacts})
    text = f"friction cone, coefficient {friction[0]:g}" if len(friction) == 1 else "friction cone"
    return [force_legend(most), Legend("cone", CONE_COLOR, text), Legend("ball", FORCE_COLOR, "contact")]


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
