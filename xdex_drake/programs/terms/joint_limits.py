"""Joints stay within their limits: E_j of Eq. (1), and as a constraint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.programs.block import Block
from xdex_drake.programs.point import Point
from xdex_drake.programs.term import Pull, View


def joint_limits(q: Any, limits: Any) -> tuple[Any, Any]:
    """Sum of limit violations: E_j of Eq. (1).

    E_j = sum_i max(0, q_i - upper_i) + max(0, lower_i - q_i)

    Args:
        q: Joint values [rad or m], shape (..., n).
        limits: Rows (lower, upper), shape (2, n).

    Returns:
        Value [rad or m], shape (...), and gradient with respect to `q`, shape (..., n).
    """
    above, below = (q - limits[1]).clip(min=0.0), (limits[0] - q).clip(min=0.0)
    return (above + below).sum(-1), 1.0 * (above > 0.0) - 1.0 * (below > 0.0)


@dataclass(frozen=True)
class JointLimits:
    """E_j of Eq. (1); see `joint_limits`."""

    weight: float = 1.0
    name: str = "j"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value [rad or m] and gradient."""
        value, gradient = joint_limits(view.q, view.limits)
        return value, Pull(q=gradient)


def limit_block(limits: Array) -> Block:
    """Joint limits: lower <= q <= upper.

    Args:
        limits: Rows (lower, upper) [rad or m], shape (2, n).

    Returns:
        The block.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        J = np.zeros((len(point.k.q), point.size))
        J[:, 6 : 6 + len(point.k.q)] = np.eye(len(point.k.q))
        return point.k.q, J

    return Block("limits", evaluate, limits[0], limits[1], "rad", "joint values")
