"""A wish: contacts keep a distance from each other; in the search, and in the program that polishes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.programs.costs import LeastSquares
from xdex_drake.programs.point import Point
from xdex_drake.programs.term import Pull, View


def finger_spread(p_WPs: Any, least: float, weights: Any) -> tuple[Any, Any]:
    """How far points, such as contacts or fingertips, are nearer to each other than wanted.

    E = sum over pairs of w_i w_j max(0, least - |p_i - p_j|)

    Args:
        p_WPs: Points [m], shape (..., m, 3).
        least: Distance that is enough [m].
        weights: 1 for points that count and 0 for others, shape (..., m).

    Returns:
        Value [m], shape (...), and gradient with respect to `p_WPs`, shape (..., m, 3).
    """
    between = p_WPs[..., :, None, :] - p_WPs[..., None, :, :]
    distance = ((between * between).sum(-1) + 1e-18) ** 0.5
    apart = (between * between).sum(-1) > 0.0  # no point counts against itself
    pairs = weights[..., :, None] * weights[..., None, :] * apart
    short = (least - distance).clip(min=0.0)
    pull = (pairs * (short > 0.0) / distance)[..., None] * between
    return 0.5 * (pairs * short).sum((-1, -2)), -pull.sum(-2)


@dataclass(frozen=True)
class Spread:
    """Distance between contacts, where one is asked for; see `finger_spread`.

    Attributes:
        least: Distance of contact points that is enough [m].
        weight: Weight.
        name: Name.
    """

    least: float
    weight: float = 100.0
    name: str = "spread"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value [m] and gradient."""
        value, gradient = finger_spread(view.contacts_W, self.least, view.touching)
        return value, Pull(contacts_W=gradient)


def spread_cost(least: float, *, weight: float = 50.0) -> LeastSquares:
    """A cost that keeps contacts apart: 1/2 w (sum over pairs of max(0, least - distance) / 1 cm)^2.

    It takes the centers of the contacts' spheres, whose derivatives are exact where those of surface points jump.

    Args:
        least: Distance of the centers of contact spheres that is enough [m].
        weight: Weight.

    Returns:
        The cost.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        points = point.contact_centers_W
        value, gradient = finger_spread(points, least, np.ones(len(points)))
        J = np.zeros((1, point.size))
        J[0, : point.moving] = np.einsum("ka,kab->b", gradient, point.contact_jacobian) / 0.01
        return np.array([value / 0.01]), J

    return LeastSquares("spread", weight, evaluate, "contacts nearer to each other than asked for, in cm")
