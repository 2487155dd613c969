"""The palm comes along a given direction: as an energy, and as a constraint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from xdex_drake.arrays import Array, cross
from xdex_drake.errors import ConfigError
from xdex_drake.programs.arrays import like
from xdex_drake.programs.block import Block
from xdex_drake.programs.grasp_types import approach_axis
from xdex_drake.programs.point import Point
from xdex_drake.programs.term import Pull, View

APPROACH_COSINE = 0.94
"""Cosine of the cone's half angle where none is given: 20 degrees."""


def approach(a_Ws: Any, direction_W: Any, least: float) -> tuple[Any, Any]:
    """How far the palm's direction falls short of a wanted one.

    E = max(0, least - a . d)

    Args:
        a_Ws: Unit vector along which the palm approaches, shape (..., 3).
        direction_W: Unit vector along which it shall, shape (3,).
        least: Cosine that is enough.

    Returns:
        Value, shape (...), and gradient with respect to `a_Ws`, shape (..., 3).
    """
    short = (least - (a_Ws * direction_W).sum(-1)).clip(min=0.0)
    return short, -(1.0 * (short > 0.0))[..., None] * direction_W


@dataclass(frozen=True)
class Approach:
    """The palm's direction, where one is asked for; see `approach`.

    Attributes:
        direction_W: Direction in W that the palm shall come along, of any length; (0, 0, -1) is from above.
        least: Cosine that is enough.
        weight: Weight.
        name: Name.
    """

    direction_W: tuple[float, float, float]
    least: float = APPROACH_COSINE
    weight: float = 10.0
    name: str = "approach"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value and gradient."""
        wanted = like(view.palm_W, self.direction_W)
        value, gradient = approach(view.palm_W, wanted / (wanted * wanted).sum() ** 0.5, self.least)
        return value, Pull(palm_W=gradient)


def approach_block(direction_W: tuple[float, ...] | Array, *, least: float = APPROACH_COSINE) -> Block:
    """The palm comes from within a cone: (a . d - least) / sqrt(1 - least^2) >= 0, radians from the cone's surface.

    Args:
        direction_W: Direction in W that the palm shall come along, of any length, shape (3,); (0, 0, -1) is from
            above. The palm's is `approach_axis`: from the roots of the fingers to where the hand at rest holds things.
        least: Cosine of the cone's half angle, between -1 and 1.

    Returns:
        The block; `program.add_constraint(approach_block((0, 0, -1)))`.

    Raises:
        ConfigError: The direction is zero, or there is no such cone.
    """
    wanted = checked_direction(direction_W)
    if not -1.0 < least < 1.0:
        raise ConfigError(f"the cosine of the cone around approach is {least:g}; give a number between -1 and 1")
    scale = 1.0 / np.sqrt(1.0 - least * least)

    def evaluate(point: Point) -> tuple[Array, Array]:
        palm = point.k.X_WH.rotation().matrix() @ approach_axis(point.k.hand)[1]
        J = np.zeros((1, point.size))
        J[0, :3] = scale * cross(palm, wanted)
        return np.array([scale * (palm @ wanted - least)]), J

    return Block(
        "palm direction", evaluate, np.zeros(1), np.full(1, np.inf), "rad", "palm within a cone about the approach"
    )


def checked_direction(direction_W: tuple[float, ...] | Array) -> Array:
    """A direction as a unit vector.

    Args:
        direction_W: The direction, of any length, shape (3,).

    Returns:
        The unit vector.

    Raises:
        ConfigError: It is not three numbers, one of which is not zero.
    """
    wanted = np.asarray(direction_W, dtype=float)
    length = float(np.linalg.norm(wanted)) if wanted.shape == (3,) else 0.0
    if not 0.0 < length < np.inf:
        raise ConfigError(f"approach is {list(direction_W)}; give three numbers, such as (0, 0, -1) from above")
    return wanted / length
