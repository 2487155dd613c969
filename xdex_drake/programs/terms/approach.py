"""A wish: the palm comes along a given direction; in the search, and in the program that polishes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.programs.arrays import like
from xdex_drake.programs.costs import LeastSquares, squared
from xdex_drake.programs.term import Pull, View


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
    least: float = 0.9
    weight: float = 10.0
    name: str = "approach"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value and gradient."""
        wanted = like(view.palm_W, self.direction_W)
        value, gradient = approach(view.palm_W, wanted / (wanted * wanted).sum() ** 0.5, self.least)
        return value, Pull(palm_W=gradient)


def approach_cost(direction_W: tuple[float, ...] | Array, *, least: float = 0.9, weight: float = 50.0) -> LeastSquares:
    """A cost that keeps the palm's approach within a cone: 1/2 w max(0, least - a . d)^2.

    Args:
        direction_W: Direction in W that the palm shall come along, of any length, shape (3,); (0, 0, -1) is from
            above.
        least: Cosine that is enough.
        weight: Weight.

    Returns:
        The cost; `program.add(approach_cost((0, 0, -1)))`.
    """
    x, y, z = np.asarray(direction_W, dtype=float)
    return squared(Approach((x, y, z), least), weight, meaning="palm's direction short of the one asked for")
