"""Links stay apart from each other: E_s of Eq. (1), and as a constraint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.programs.block import MM, Block
from xdex_drake.programs.point import CLOSE, Point
from xdex_drake.programs.term import Pull, View


def self_collision(between: Any, reach: Any) -> tuple[Any, Any]:
    """Sum of overlaps between pairs of spheres of different links: E_s of Eq. (1).

    E_s = sum over pairs of max(0, reach - |between|)

    Args:
        between: Differences between the centers of the two spheres [m], shape (..., m, 3).
        reach: Sum of the two radii of each pair [m], shape (m,).

    Returns:
        Value [m], shape (...), and its gradient with respect to `between`, shape (..., m, 3).
    """
    distance = ((between * between).sum(-1) + 1e-18) ** 0.5
    overlap = (reach - distance).clip(min=0.0)
    return overlap.sum(-1), -((overlap > 0.0) / distance)[..., None] * between


@dataclass(frozen=True)
class SelfCollision:
    """E_s of Eq. (1); see `self_collision`."""

    weight: float = 50.0
    name: str = "s"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value [m] and gradient."""
        value, gradient = self_collision(view.between_W, view.reach)
        return value, Pull(between_W=gradient)


def self_block(pairs: NDArray[np.int64], clearance: float) -> Block:
    """Spheres of different links stay apart: |c_i - c_j| - r_i - r_j >= clearance.

    Args:
        pairs: Indices among `hand.spheres`, shape (m, 2).
        clearance: Least gap [m].

    Returns:
        The block.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        hand = point.k.hand
        a, b = pairs[:, 0], pairs[:, 1]
        between = point.centers_W[a] - point.centers_W[b]
        distance = np.sqrt(np.einsum("ka,ka->k", between, between) + 1e-18)
        g = MM * (distance - hand.spheres[a, 3] - hand.spheres[b, 3])
        J = np.zeros((len(pairs), point.size))
        close = np.flatnonzero(g < MM * CLOSE)
        if len(close):
            direction = MM * between[close] / distance[close, None]
            rows = point.pull_back_spheres(
                np.concatenate([a[close], b[close]]), np.concatenate([direction, -direction])
            )
            J[close, : point.moving] = rows[: len(close)] + rows[len(close) :]
        return g, J

    low = np.full(len(pairs), MM * clearance)
    return Block("self", evaluate, low, np.full(len(pairs), np.inf), "mm", "gap between spheres of two links")
