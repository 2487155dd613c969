"""Keypoints of a hand meet their targets: the first sum of Eq. (2), and of Eq. (6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.programs.arrays import like
from xdex_drake.programs.costs import LeastSquares
from xdex_drake.programs.inverse_kinematics import PointTargets
from xdex_drake.programs.point import Point
from xdex_drake.programs.term import Pull, View

KEYPOINT_SCALE = 0.01
"""Distance at which a keypoint's cost is one half of its weight [m]."""


def keypoints(p_WPs: Any, targets_W: Any, weights: Any) -> tuple[Any, Any]:
    """Squared distances of keypoints from their targets: the first sum of Eq. (2), and of Eq. (6).

    E = sum_i w_i |p_i - target_i|^2

    Args:
        p_WPs: Keypoints [m], shape (..., m, 3).
        targets_W: Their targets [m], shape (..., m, 3).
        weights: Weight of each, shape (m,).

    Returns:
        Value [m^2], shape (...), and gradient with respect to `p_WPs`, shape (..., m, 3).
    """
    error = p_WPs - targets_W
    weighted = weights[..., None] * error
    return (weighted * error).sum((-1, -2)), 2.0 * weighted


@dataclass(frozen=True)
class Tips:
    """Tips of the fingers meet given points; see `keypoints`.

    Attributes:
        targets_W: Target of each finger's tip, in the order of `hand.fingers` [m].
        weight: Weight [1/m^2].
        name: Name.
    """

    targets_W: tuple[tuple[float, float, float], ...]
    weight: float = 1e4
    name: str = "tips"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value [m^2] and gradient."""
        tips = view.tips_W
        value, gradient = keypoints(tips, like(tips, self.targets_W), like(tips, np.ones(len(self.targets_W))))
        return value, Pull(tips_W=gradient)


def keypoint_cost(targets: PointTargets, weight: float = 1.0) -> LeastSquares:
    """Squared distances of keypoints from their targets, in units of `KEYPOINT_SCALE`.

    Args:
        targets: Points and targets, a batch of one.
        weight: Weight.

    Returns:
        The cost.
    """
    scale = np.sqrt(targets.weights) / KEYPOINT_SCALE

    def evaluate(point: Point) -> tuple[Array, Array]:
        p_WPs = point.k.points(targets.links, targets.p_LPs)
        J = point.k.jacobian(targets.links, p_WPs) * scale[:, None, None]
        padded = np.zeros((J.shape[0] * 3, point.size))
        padded[:, : J.shape[2]] = J.reshape(-1, J.shape[2])
        return ((p_WPs - targets.p_WPs[0]) * scale[:, None]).ravel(), padded

    return LeastSquares("keypoints", weight, evaluate, "distance of fingertips and wrist from the source's, in cm")
