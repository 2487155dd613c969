"""Draws hands, objects and a table in Meshcat, by paths of our own, and plays recorded lifts."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
from pydrake.geometry import Box, Meshcat, MeshcatAnimation, MeshcatParams, Rgba
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.looks import FINE, Detail, hand_surfaces
from xdex_drake.hand.plant import drake_shape
from xdex_drake.scene.bodies import FIXTURE_COLOR, visual_mesh
from xdex_drake.scene.materials import object_color
from xdex_drake.scene.object import ObjectModel
from xdex_drake.scene.tabletop import Scene
from xdex_drake.visualization.dress import meshes_by_color
from xdex_drake.visualization.film import Film
from xdex_drake.visualization.forces import play_pushes
from xdex_drake.visualization.page import FOV_Y, light

PAUSE_FRAMES = 20
"""Frames for which the end of a lift stands still before it starts again."""

REPETITIONS = 10_000
"""How often a page plays its lift by itself."""

TABLE_COLOR, GRID_COLOR = (0.86, 0.87, 0.89), (0.62, 0.64, 0.68)
TOUCH_COLOR = (0.95, 0.45, 0.10, 0.45)
"""Color of collision geometry, where it is shown."""


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
    light(meshcat)
    return meshcat


def aim(meshcat: Meshcat, X_WC: RigidTransform, p_WT: Array) -> None:
    """Puts the camera at X_WC's position, orbiting about the point of its line of sight nearest to p_WT."""
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=float(np.degrees(FOV_Y)), aspect=1.5, near=0.01, far=20.0))
    p_WC, forward = X_WC.translation(), X_WC.rotation().matrix()[:, 2]
    meshcat.SetCameraPose(p_WC, p_WC + max(float((p_WT - p_WC) @ forward), 0.05) * forward)


def draw_hand(meshcat: Meshcat, path: str, hand: Hand, names: Sequence[str], detail: Detail = FINE) -> None:
    """Draws each link of a hand as it looks, in its own frame, below `PATH/NAME/look`.

    Args:
        meshcat: Where to draw.
        path: Path of the hand.
        hand: The hand.
        names: Name of each link in the path.
        detail: How finely.
    """
    for name, surfaces in zip(names, hand_surfaces(hand, detail), strict=True):
        for n, (color, mesh) in enumerate(meshes_by_color(surfaces)):
            meshcat.SetObject(f"{path}/{name}/look/{n}", mesh, Rgba(*color))


def draw_touch(meshcat: Meshcat, path: str, hand: Hand, names: Sequence[str]) -> None:
    """Draws what touches of each link of a hand, below `PATH/NAME/touch`, to be shown by a switch (`touch_switch`).

    Args:
        meshcat: Where to draw.
        path: Path of the hand.
        hand: The hand.
        names: Name of each link in the path.
    """
    for link, name in zip(hand.links, names, strict=True):
        for n, primitive in enumerate(link.geometry):
            shape, X_LG = drake_shape(primitive, f"{link.name}_{n}")
            meshcat.SetObject(f"{path}/{name}/touch/{n}", shape, Rgba(*TOUCH_COLOR))
            meshcat.SetTransform(f"{path}/{name}/touch/{n}", X_LG)
        if link.geometry:
            meshcat.SetProperty(f"{path}/{name}/touch", "visible", False)


def touch_switch(hands: Sequence[tuple[str, Hand, Sequence[str]]]) -> dict[str, list[str]]:
    """The switch that shows what touches: its label and the paths of `draw_touch` (path, hand, names of links)."""
    paths = [
        f"{path}/{name}/touch"
        for path, hand, names in hands
        for link, name in zip(hand.links, names, strict=True)
        if link.geometry
    ]
    return {"-collision shapes": paths}


def link_labels(path: str, hand: Hand, names: Sequence[str]) -> dict[str, str]:
    """What to call each link of a hand, by its path."""
    finger_of = {link: finger.name for finger in hand.fingers for link in finger.links}
    labels = {}
    for link, name in zip(hand.links, names, strict=True):
        finger = finger_of.get(link.name, "palm")
        labels[f"{path}/{name}"] = link.name if finger == link.name else f"{link.name} ({finger})"
    return labels


def draw_object(meshcat: Meshcat, path: str, object: ObjectModel, opacity: float = 1.0) -> None:
    """Draws an object in its frame O."""
    meshcat.SetObject(path, visual_mesh(object), Rgba(*object_color(object.name), opacity))


def draw_obstacles(meshcat: Meshcat, path: str, scene: Scene) -> None:
    """Draws what is fixed beside the object of a scene."""
    for k, fixture in enumerate(scene.obstacles):
        meshcat.SetObject(f"{path}/obstacle_{k}", visual_mesh(fixture.object), Rgba(*FIXTURE_COLOR))
        meshcat.SetTransform(f"{path}/obstacle_{k}", fixture.X_WF)


def draw_table(meshcat: Meshcat, scenes: Sequence[Scene], center: Array, half: float = 0.5, step: float = 0.05) -> None:
    """The table of some scenes, where they have one, about a point, with lines 5 cm apart to see a rise by.

    It lies half a millimeter low, so that the bottom of an object is seen apart from it.
    """
    tops = [scene.table for scene in scenes if scene.table is not None]
    if not tops:
        return
    top, size = min(tops), 2.0 * half + 1.0
    meshcat.SetObject("/drake/table", Box(size, size, 0.1), Rgba(*TABLE_COLOR))
    meshcat.SetTransform("/drake/table", RigidTransform([center[0], center[1], top - 0.0505]))
    half = step * float(np.ceil(half / step))
    ticks = np.arange(-half, half + 0.5 * step, step)
    starts = np.array([(x, -half, 0.0) for x in ticks] + [(-half, y, 0.0) for y in ticks])
    ends = np.array([(x, half, 0.0) for x in ticks] + [(half, y, 0.0) for y in ticks])
    shift = np.array([center[0], center[1], top - 2e-4])
    meshcat.SetLineSegments("/drake/grid", (starts + shift).T, (ends + shift).T, 1.0, Rgba(*GRID_COLOR))


def play_films(
    meshcat: Meshcat,
    paths: Sequence[str],
    films: Sequence[Film],
    offsets: Array,
    *,
    frames_per_second: float,
    detail: Detail = FINE,
) -> None:
    """Draws recorded lifts and plays them together, again and again.

    Args:
        meshcat: Where to draw.
        paths: Path of each: links are drawn at `PATH/HAND/LINK`, the object at `PATH/object`, arrows at `PATH/forces`.
        films: The lifts.
        offsets: Where each is moved to [m], shape (n, 3).
        frames_per_second: Frames a second.
        detail: How finely hands are drawn.
    """
    animation = MeshcatAnimation(frames_per_second)
    last = max(len(film.frames) for film in films) - 1 + PAUSE_FRAMES
    for path, film, offset in zip(paths, films, offsets, strict=True):
        names = [link.name for link in film.hand.links]
        at = f"{path}/{film.hand.name}"
        draw_hand(meshcat, at, film.hand, names, detail)
        draw_object(meshcat, f"{path}/object", film.scene.object)
        draw_obstacles(meshcat, path, film.scene)
        meshcat.SetTransform(path, RigidTransform(offset))
        moments = [*enumerate(film.frames), (last, film.frames[-1])]
        for moment, frame in moments:
            for name, X_WL in zip(names, frame.X_WLs, strict=True):
                animation.SetTransform(moment, f"{at}/{name}", X_WL)
            animation.SetTransform(moment, f"{path}/object", frame.X_WO)
        pushes = {moment: frame.pushes for moment, frame in moments}
        play_pushes(meshcat, animation, f"{path}/forces", pushes)
    animation.set_autoplay(True)
    animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    animation.set_repetitions(REPETITIONS)
    meshcat.SetAnimation(animation)
