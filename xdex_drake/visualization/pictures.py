"""Still pictures of grasps, without a window: Drake's VTK renderer."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    QueryObject,
    RenderCameraCore,
    RenderEngineVtkParams,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from xdex_drake.errors import ConfigError, MissingExtra
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.scene.belonging import check_belonging
from xdex_drake.scene.camera import survives
from xdex_drake.scene.plant import ScenePlant, build_plant
from xdex_drake.scene.tabletop import Scene
from xdex_drake.visualization.dress import dress
from xdex_drake.visualization.views import best_view

Image = NDArray[np.uint8]

RENDERER = "pictures"
FOV_Y = 0.6
"""Vertical field of view of the camera [rad]."""

CLEAR_COLOR = (0.96, 0.97, 0.98)
"""Background color."""

_PROBE = "from xdex_drake.visualization.pictures import _probe; _probe()"


@dataclass(frozen=True)
class Studio:
    """A hand and a scene that pictures are taken of, any number of them.

    Attributes:
        scene_plant: Hand, object and table with a renderer.
        context: Context of `scene_plant.diagram`.
    """

    scene_plant: ScenePlant
    context: Context


def _lights() -> list[LightParameter]:
    """A key light over the camera's left shoulder, whose shadows show what touches what, and fill lights without."""

    def fill(position: tuple[float, float, float], intensity: float) -> LightParameter:
        # Point lights cast no shadows.
        return LightParameter(type="point", frame="camera", position=np.array(position), intensity=intensity)

    key = LightParameter(
        type="directional",
        color=Rgba(1.0, 0.98, 0.95),
        frame="camera",
        direction=np.array([0.45, 0.75, 0.6]),
        intensity=0.75,
    )
    return [key, fill((1.5, -0.8, -0.5), 0.45), fill((-0.3, -0.3, 0.0), 0.55)]


def _backend() -> str:
    # EGL needs no display. Where VTK has one kind of window only, its default is taken.
    return "EGL" if sys.platform.startswith("linux") else ""


def add_renderer(scene_graph: SceneGraph, *, shadows: bool = True) -> None:
    """Adds the renderer `RENDERER`, with lights, to a scene graph whose diagram is not built yet.

    Args:
        scene_graph: The scene graph; it grows by the renderer.
        shadows: Whether what is in front casts shadows; they show what touches what, but are too coarse for a picture
            of one thing alone.
    """
    parameters = RenderEngineVtkParams(
        default_clear_color=np.array(CLEAR_COLOR),
        lights=_lights(),
        cast_shadows=shadows,
        shadow_map_size=2048,
        backend=_backend(),
    )
    scene_graph.AddRenderer(RENDERER, MakeRenderEngineVtk(parameters))


def color_image(
    scene_graph: SceneGraph, context: Context, X_WC: RigidTransform, size: tuple[int, int], *, samples: int = 2
) -> Image:
    """Renders what a camera sees in a scene graph that has the renderer `RENDERER`.

    Args:
        scene_graph: The scene graph.
        context: Its own context.
        X_WC: Pose of the camera, z forward and y down.
        size: Width and height [pixels].
        samples: Samples of a pixel along each edge; more than one make edges smooth.

    Returns:
        Red, green and blue, shape (height, width, 3).
    """
    width, height = size
    query = cast(QueryObject, scene_graph.get_query_output_port().Eval(context))
    camera = _camera(samples * width, samples * height)
    image = query.RenderColorImage(camera, scene_graph.world_frame_id(), X_WC)
    summed = image.data[:, :, :3].reshape(height, samples, width, samples, 3).astype(np.uint32).sum(axis=(1, 3))
    return ((summed + samples**2 // 2) // samples**2).astype(np.uint8)


def _probe() -> None:
    """Renders an empty picture; run in a process of its own, since graphics libraries crash rather than raise."""
    scene_graph = SceneGraph()
    add_renderer(scene_graph)
    color_image(scene_graph, scene_graph.CreateDefaultContext(), RigidTransform(), (32, 24), samples=1)


@cache
def can_render() -> bool:
    """Whether this machine can render pictures; tried once, in another process, since failing may end the process."""
    return survives(_PROBE)


def require_rendering() -> None:
    """Refuses to go on where this machine cannot render.

    Raises:
        MissingExtra: It cannot; the message says what to install.
    """
    if not can_render():
        raise MissingExtra(
            "pictures cannot be rendered on this machine; install its OpenGL library (Debian and Ubuntu: "
            "`apt install libegl1 libgl1-mesa-dri`), or go on without pictures"
        )


def _camera(width: int, height: int) -> ColorRenderCamera:
    info = CameraInfo(width=width, height=height, fov_y=FOV_Y)
    return ColorRenderCamera(RenderCameraCore(RENDERER, info, ClippingRange(0.01, 10.0), RigidTransform()), False)


def make_studio(
    hand: Hand,
    scene: Scene,
    *,
    extend: Callable[[DiagramBuilder, MultibodyPlant, SceneGraph], None] | None = None,
) -> Studio:
    """Prepares to take pictures of grasps of one hand in one scene.

    Args:
        hand: The hand.
        scene: The scene.
        extend: Called before the diagram is built, to add geometry of your own.

    Returns:
        The studio.

    Raises:
        MissingExtra: This machine cannot render.
    """
    require_rendering()

    def add(builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
        add_renderer(scene_graph)
        dress(plant, scene_graph, hand)
        if extend is not None:
            extend(builder, plant, scene_graph)

    scene_plant = build_plant(hand, scene, extend=add)
    return Studio(scene_plant, scene_plant.diagram.CreateDefaultContext())


def take_picture(
    studio: Studio, grasp: Grasp, *, size: tuple[int, int] = (480, 360), X_WC: RigidTransform | None = None
) -> Image:
    """Takes a picture of a grasp.

    Args:
        studio: The studio of its hand and scene.
        grasp: The grasp.
        size: Width and height [pixels].
        X_WC: Pose of the camera, z forward and y down; one that frames the grasp where None.

    Returns:
        Red, green and blue, shape (height, width, 3).
    """
    scene_plant = studio.scene_plant
    assert scene_plant.scene is not None
    width, height = size
    if X_WC is None:
        X_WC = best_view(grasp, scene_plant.hand, scene_plant.scene, fov_y=FOV_Y, aspect=width / height)
    plant_context = scene_plant.plant.GetMyMutableContextFromRoot(studio.context)
    scene_plant.set_wrist(plant_context, grasp.X_WH)
    scene_plant.set_joints(plant_context, grasp.q)
    scene_plant.set_object(plant_context, grasp.X_WO)
    scene_graph = scene_plant.scene_graph
    return color_image(scene_graph, scene_graph.GetMyContextFromRoot(studio.context), X_WC, size)


def render_grasp(
    grasp: Grasp,
    hand: Hand,
    scene: Scene,
    *,
    size: tuple[int, int] = (480, 360),
    X_WC: RigidTransform | None = None,
) -> Image:
    """Renders one grasp; for many of one hand and scene, `make_studio` and `take_picture` are faster.

    Args:
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.
        size: Width and height [pixels].
        X_WC: Pose of the camera, z forward and y down; one that frames the grasp where None.

    Returns:
        Red, green and blue, shape (height, width, 3).

    Raises:
        ConfigError: Grasp, hand and scene do not belong together.
        MissingExtra: This machine cannot render.
    """
    check_belonging(grasp, hand, scene)
    return take_picture(make_studio(hand, scene), grasp, size=size, X_WC=X_WC)


def contact_sheet(images: Sequence[Image], labels: Sequence[str], columns: int = 4) -> Image:
    """Puts pictures side by side with a label under each.

    Args:
        images: Pictures of one size, each (height, width, 3); at least one.
        labels: A label for each.
        columns: Number of pictures in a row.

    Returns:
        One picture, shape (rows * (height + room for a label), columns * width, 3).

    Raises:
        ConfigError: There is no picture, sizes or numbers differ, or `columns` is below one.
    """
    if not images or len(labels) != len(images) or columns < 1 or len({image.shape for image in images}) != 1:
        raise ConfigError(
            f"a contact sheet needs pictures of one size, a label for each and one column or more; got {len(images)} "
            f"pictures of sizes {sorted({image.shape for image in images})}, {len(labels)} labels, {columns} columns"
        )
    height, width = images[0].shape[:2]
    columns = min(columns, len(images))
    rows, room = -(-len(images) // columns), max(16, height // 14)
    font = ImageFont.load_default(size=0.62 * room)
    paper = PillowImage.new("RGB", (columns * width, rows * (height + room)), "white")
    draw = ImageDraw.Draw(paper)
    for k, (image, label) in enumerate(zip(images, labels, strict=True)):
        x, y = (k % columns) * width, (k // columns) * (height + room)
        paper.paste(PillowImage.fromarray(image), (x, y))
        draw.text((x + width // 2, y + height + room // 2), label, fill=(40, 46, 56), font=font, anchor="mm")
    return np.asarray(paper)
