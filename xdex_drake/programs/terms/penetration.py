"""Spheres stay out of object and table: E_sdf of Eq. (1), and as constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.programs.block import MM, Block, without_forces
from xdex_drake.programs.point import CLOSE, Point
from xdex_drake.programs.term import Pull, View


def penetration(distances: Any, radii: Any) -> tuple[Any, Any]:
    """Sum of sphere penetrations: E_sdf of Eq. (1), with the hinge that the paper's print leaves out.

    E_sdf = sum_i max(0, r_i - SDF(c_i))

    Args:
        distances: Signed distance of each sphere's center, negative inside [m], shape (..., n).
        radii: Sphere radii [m], shape (n,).

    Returns:
        Value [m], shape (...), and gradient with respect to `distances`, shape (..., n); 0 where a sphere just touches.
    """
    depth = (radii - distances).clip(min=0.0)
    return depth.sum(-1), -1.0 * (depth > 0.0)


@dataclass(frozen=True)
class Penetration:
    """E_sdf of Eq. (1), of object and table; see `penetration`.

    Attributes:
        weight: Weight.
        clearance: Gap that spheres keep [m].
        name: Name.
    """

    weight: float = 100.0
    clearance: float = 0.001
    name: str = "sdf"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value [m] and gradient."""
        keep_off = view.radii + self.clearance
        in_object, on_distances = penetration(view.distances, keep_off)
        in_table, on_heights = penetration(view.heights, keep_off)
        return in_object + in_table, Pull(distances=on_distances, heights=on_heights)


def object_block(spheres: NDArray[np.int64], clearance: Array) -> Block:
    """Other spheres stay out of the object: SDF(c_i) - r_i >= clearance_i.

    Args:
        spheres: Indices among `hand.spheres`, shape (m,).
        clearance: Least gap of each [m], shape (m,).

    Returns:
        The block.
    """
    far = 2.0 * MM * 0.05

    def evaluate(point: Point) -> tuple[Array, Array]:
        near, gaps, gradient = point.object_distances
        position = np.full(len(point.k.hand.spheres), -1)
        position[near] = np.arange(len(near))
        rows = position[spheres]
        known = np.flatnonzero(rows >= 0)
        g = np.full(len(spheres), far)
        J = np.zeros((len(spheres), point.size))
        g[known] = MM * gaps[rows[known]]
        # Rows that are far from active need no derivative.
        close = known[g[known] < MM * CLOSE]
        chosen = spheres[close]
        J[close, : point.moving] = MM * point.pull_back_spheres(chosen, gradient[rows[close]])
        return g, J

    return Block(
        "object", evaluate, MM * clearance, np.full(len(spheres), np.inf), "mm", "gap between sphere and object"
    )


def table_block(spheres: NDArray[np.int64], clearance: float) -> Block:
    """Spheres stay above the table: z(c_i) - r_i >= clearance.

    Args:
        spheres: Indices among `hand.spheres`, shape (m,).
        clearance: Least gap [m].

    Returns:
        The block.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        up = np.tile([0.0, 0.0, MM], (len(spheres), 1))
        return MM * point.heights[spheres], without_forces(point, point.pull_back_spheres(spheres, up))

    low = np.full(len(spheres), MM * clearance)
    return Block("table", evaluate, low, np.full(len(spheres), np.inf), "mm", "gap between sphere and table")
