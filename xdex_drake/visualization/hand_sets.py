"""What a set of hands looks like: distributions as one figure, and pictures of hands as a contact sheet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Hand
from xdex_drake.scene.plant import build_plant
from xdex_drake.visualization.dress import dress
from xdex_drake.visualization.pictures import (
    FOV_Y,
    Image,
    add_renderer,
    color_image,
    contact_sheet,
    require_rendering,
)
from xdex_drake.visualization.views import frame_blobs, hand_blobs

if TYPE_CHECKING:
    from xdex_drake.jobs.hands import HandRow

VIEW = (0.80, 0.55, 0.30)
"""Direction in H from a hand toward the camera."""

ROBOT_COLOR, HUMAN_COLOR = (76, 128, 189), (222, 140, 72)
_INK, _GRID = (40, 46, 56), (226, 230, 236)
_PANEL = (520, 380)


# ---- pictures


def hand_picture(
    hand: Hand, *, q: Array | None = None, size: tuple[int, int] = (240, 240), direction: Sequence[float] = VIEW
) -> Image:
    """Renders a hand alone.

    Args:
        hand: The hand.
        q: Joint values [rad or m], shape (n,); at rest where None.
        size: Width and height [pixels].
        direction: Direction in H toward the camera, not along z.

    Returns:
        Red, green and blue, shape (height, width, 3).

    Raises:
        MissingExtra: This machine cannot render.
    """
    require_rendering()

    def add(builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
        add_renderer(scene_graph, shadows=False)
        dress(plant, scene_graph, hand)

    q = hand.q_rest if q is None else q
    scene_plant = build_plant(hand, extend=add)
    context = scene_plant.diagram.CreateDefaultContext()
    plant_context = scene_plant.plant.GetMyMutableContextFromRoot(context)
    scene_plant.set_wrist(plant_context, RigidTransform())
    scene_plant.set_joints(plant_context, q)
    toward = np.array(direction, dtype=float)
    blobs = hand_blobs(hand, RigidTransform(), q)
    width, height = size
    X_WC = frame_blobs(blobs, toward / np.linalg.norm(toward), fov_y=FOV_Y, aspect=width / height, margin=1.06)
    return color_image(scene_plant.scene_graph, scene_plant.scene_graph.GetMyContextFromRoot(context), X_WC, size)


def hands_sheet(hands: Sequence[Hand], *, columns: int = 8, size: tuple[int, int] = (240, 240)) -> Image:
    """Pictures of hands at rest side by side, with their names.

    Args:
        hands: The hands; at least one.
        columns: Number of pictures in a row.
        size: Width and height of each [pixels].

    Returns:
        One picture.

    Raises:
        ConfigError: There is no hand.
        MissingExtra: This machine cannot render.
    """
    return contact_sheet([hand_picture(hand, size=size) for hand in hands], [hand.name for hand in hands], columns)


# ---- distributions


def statistics_figure(rows: Sequence[HandRow]) -> Image:
    """Distributions of a set of hands: sizes, links, actuated joints, and how many trees there are (paper, Fig. 5).

    Args:
        rows: A row for each hand; at least one.

    Returns:
        A figure of four panels, human hands and robot hands in two colors.

    Raises:
        ConfigError: There is no row.
    """
    if not rows:
        raise ConfigError("there is no hand to count; give a folder with some")
    human = np.array([row.base == "human" for row in rows])
    panels = [
        _histogram(1000.0 * np.array([row.size_m for row in rows]), human, "size, wrist to fingertip [mm]", step=10.0),
        _histogram(np.array([row.links for row in rows], dtype=float), human, "links", step=1.0),
        _histogram(np.array([row.actuated for row in rows], dtype=float), human, "actuated joints", step=1.0),
        _growth([row.topology for row in rows]),
    ]
    width, height = _PANEL
    paper = PillowImage.new("RGB", (2 * width, 2 * height + 44), "white")
    for k, panel in enumerate(panels):
        paper.paste(panel, ((k % 2) * width, 44 + (k // 2) * height))
    draw = ImageDraw.Draw(paper)
    text = f"{len(rows)} hands, {len({row.topology for row in rows})} topologies"
    draw.text((20, 14), text, fill=_INK, font=_font(20))
    x = 2 * width - 330
    for name, color, count in (("robot", ROBOT_COLOR, (~human).sum()), ("human", HUMAN_COLOR, human.sum())):
        draw.rectangle((x, 18, x + 14, 32), fill=color)
        draw.text((x + 22, 16), f"{name} ({count})", fill=_INK, font=_font(16))
        x += 150
    return np.asarray(paper)


def _font(size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=size)


class _Axes:
    """A panel with axes, in the coordinates of its data."""

    def __init__(self, x: tuple[float, float], top: float, title: str, y_title: str) -> None:
        width, height = _PANEL
        self.image = PillowImage.new("RGB", _PANEL, "white")
        self.draw = ImageDraw.Draw(self.image)
        self._x, self._top = x, top
        self._left, self._right, self._high, self._low = 62, width - 20, 34, height - 56
        step = _tick_step(top)
        for value in np.arange(0.0, top + 1e-9, step):
            y = self.y(value)
            self.draw.line((self._left, y, self._right, y), fill=_GRID)
            self.draw.text((self._left - 8, y), f"{value:g}", fill=_INK, font=_font(13), anchor="rm")
        step = _tick_step(x[1] - x[0])
        for value in np.arange(np.ceil(x[0] / step) * step, x[1] + 1e-9, step):
            self.draw.text((self.x(value), self._low + 8), f"{value:g}", fill=_INK, font=_font(13), anchor="mt")
        self.draw.line((self._left, self._low, self._right, self._low), fill=_INK)
        self.draw.text((0.5 * (self._left + self._right), height - 12), title, fill=_INK, font=_font(15), anchor="mb")
        self.draw.text((self._left, 12), y_title, fill=_INK, font=_font(13), anchor="lt")

    def x(self, value: float) -> float:
        share = (value - self._x[0]) / (self._x[1] - self._x[0])
        return self._left + share * (self._right - self._left)

    def y(self, value: float) -> float:
        return self._low - value / self._top * (self._low - self._high)


def _tick_step(span: float) -> float:
    """A round step that divides a span into about six."""
    raw = max(span, 1e-9) / 6.0
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= raw) * power
    return float(max(step, 1.0))


def _histogram(values: Array, human: NDArray[np.bool_], title: str, *, step: float) -> PillowImage.Image:
    """Stacked bars: robot hands below, human hands on top."""
    # Bars of counts are centered on whole numbers.
    low = np.floor(values.min() / step) * step - (0.5 * step if step == 1.0 else 0.0)
    edges = low + step * np.arange(int(np.ceil((values.max() - low) / step + 1e-9)) + 1)
    robots, people = (np.histogram(values[mask], edges)[0] for mask in (~human, human))
    axes = _Axes((float(edges[0]), float(edges[-1])), 1.05 * float((robots + people).max()), title, "hands")
    for k, (a, b) in enumerate(zip(robots, people, strict=True)):
        x0, x1 = axes.x(edges[k]) + 1, axes.x(edges[k + 1]) - 1
        for bottom, top, color in ((0, a, ROBOT_COLOR), (a, a + b, HUMAN_COLOR)):
            if top > bottom:
                axes.draw.rectangle((x0, axes.y(top), max(x1, x0), axes.y(bottom)), fill=color)
    return axes.image


def _growth(topologies: Sequence[str]) -> PillowImage.Image:
    """Number of different trees among the first hands."""
    seen: set[str] = set()
    counts = []
    for tree in topologies:
        seen.add(tree)
        counts.append(len(seen))
    axes = _Axes((0.0, float(len(counts))), 1.05 * counts[-1], "hands", "different topologies")
    points = [(axes.x(0.0), axes.y(0.0)), *((axes.x(k + 1.0), axes.y(float(n))) for k, n in enumerate(counts))]
    axes.draw.line(points, fill=ROBOT_COLOR, width=3, joint="curve")
    return axes.image
