"""Costs of the grasp programs, each with its gradient with respect to the tangent of a point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.point import Point
from xdex_drake.programs.point_view import PointView
from xdex_drake.programs.term import Term, evaluate_term

CURVATURE = 1e-2
"""Curvature of costs that do not know theirs, in all directions of the tangent: steps stay bounded."""


@dataclass(frozen=True)
class LeastSquares:
    """A cost 1/2 weight |r(point)|^2.

    Attributes:
        name: Name in tables and results.
        weight: Weight.
        evaluate: Gives r, shape (m,), and its Jacobian with respect to the point's tangent, shape (m, size).
        meaning: One line for tables.
    """

    name: str
    weight: float
    evaluate: Callable[[Point], tuple[Array, Array]]
    meaning: str

    def at(self, point: Point) -> tuple[Array, Array]:
        """What `evaluate` gives, computed once for a point."""
        if self.evaluate not in point.memo:
            point.memo[self.evaluate] = self.evaluate(point)
        return point.memo[self.evaluate]

    def value(self, point: Point) -> float:
        """The cost at a point."""
        r, _ = self.at(point)
        return 0.5 * self.weight * float(r @ r)

    def gradient(self, point: Point) -> Array:
        """Gradient with respect to the tangent, shape (size,)."""
        r, J = self.at(point)
        return self.weight * (r @ J)

    def curvature(self, point: Point) -> Array:
        """Gauss-Newton's approximation of the Hessian, shape (size, size)."""
        _, J = self.at(point)
        return self.weight * J.T @ J


@dataclass(frozen=True)
class UserCost:
    """A cost weight * function(k) that a user wrote as a function of the hand's configuration alone.

    Its gradient is taken by central differences over the 6 + n tangent directions, at the cost of as many forward
    kinematics.

    Attributes:
        name: Name in tables and results.
        weight: Weight.
        function: The value at a configuration.
        meaning: One line for tables.
    """

    name: str
    weight: float
    function: Callable[[Configuration], float]
    meaning: str = "user's own"

    def value(self, point: Point) -> float:
        """The cost at a point."""
        return self.weight * float(self.function(point.k))

    def gradient(self, point: Point) -> Array:
        """Gradient with respect to the tangent, shape (size,)."""
        n, h = 6 + len(point.k.q), 1e-5
        gradient = np.zeros(point.size)
        for k in range(n):
            step = np.zeros(n)
            step[k] = h
            gradient[k] = (self.function(point.k.moved(step)) - self.function(point.k.moved(-step))) / (2.0 * h)
        return self.weight * gradient

    def curvature(self, point: Point) -> Array:
        """A bounded step's Hessian, shape (size, size)."""
        return CURVATURE * np.eye(point.size)


@dataclass(frozen=True)
class EnergyCost:
    """A cost that an energy term gives, weight included: the same term that a search may take.

    Attributes:
        term: The term.
        meaning: One line for tables.
    """

    term: Term
    meaning: str = "energy term"

    @property
    def name(self) -> str:
        """Name in tables and results."""
        return self.term.name

    @property
    def weight(self) -> float:
        """Weight."""
        return self.term.weight

    def at(self, point: Point) -> tuple[float, Array]:
        """The term's value and its gradient with respect to the tangent, shape (size,), computed once for a point."""
        key = f"term {self.name}"
        if key not in point.memo or point.memo[key][0] is not self.term:
            point.memo[key] = (self.term, energy_at(self.term, point))
        return point.memo[key][1]

    def value(self, point: Point) -> float:
        """The cost at a point."""
        return self.weight * self.at(point)[0]

    def gradient(self, point: Point) -> Array:
        """Gradient with respect to the tangent, shape (size,)."""
        return self.weight * self.at(point)[1]

    def curvature(self, point: Point) -> Array:
        """A bounded step's Hessian, shape (size, size)."""
        return CURVATURE * np.eye(point.size)


Cost = LeastSquares | UserCost | EnergyCost


def energy_at(term: Term, point: Point) -> tuple[float, Array]:
    """A term at a point of a program.

    Args:
        term: The term.
        point: The point.

    Returns:
        Value, without the weight, and its gradient with respect to the tangent, shape (size,).
    """
    view = PointView.of(point)
    value, gradients = evaluate_term(term, view)
    gradient = np.zeros(point.size)
    gradient[: point.moving] = view.pull_back(gradients)
    return float(value), gradient


def squared(term: Term, weight: float, *, unit: float = 1.0, meaning: str = "energy term, squared") -> LeastSquares:
    """A cost 1/2 weight (value / unit)^2 of a term's value, of which the sequential solver knows the curvature.

    Args:
        term: The term; its own weight is left out.
        weight: Weight.
        unit: Value at which the cost is half the weight.
        meaning: One line for tables.

    Returns:
        The cost.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        value, gradient = energy_at(term, point)
        return np.array([value / unit]), gradient[None] / unit

    return LeastSquares(term.name, weight, evaluate, meaning)
