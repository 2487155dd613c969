"""A constraint of a grasp program: a named block of rows with its Jacobian, in comparable units.

Distances are in millimetres, wrenches and forces in units of the object's weight, so that one tolerance suits all rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.programs.point import Point

MM = 1e3
"""Millimetres in a metre: the unit of distance rows."""

TOLERANCES = {"mm": 0.2, "m g": 2e-2, "rad": 1e-3, "-": 2e-2, "own": 2e-4}
"""Greatest violation that counts as satisfied, by the unit of a block; forces are balanced exactly afterwards. What
users add to a program themselves is in their `own` unit, and held as closely as metres are."""


@dataclass(frozen=True)
class Block:
    """Rows lower <= g(point) <= upper.

    Attributes:
        name: Name in tables and results.
        evaluate: Gives g, shape (m,), and its Jacobian with respect to the point's tangent, shape (m, size).
        lower: Lower bounds, shape (m,).
        upper: Upper bounds, shape (m,).
        unit: Unit of the rows, for tables.
        meaning: One line for tables.
        inner: Rows g >= 0 that imply this block and that a linearisation sees better, for the sequential solver; None
            where `evaluate` serves.
        whole: Greatest violation of all rows there could be, where the block holds only those that matter near the
            start: a solver that goes far must not pass through what it left out. None where it holds all.
    """

    name: str
    evaluate: Callable[[Point], tuple[Array, Array]]
    lower: Array
    upper: Array
    unit: str
    meaning: str
    inner: Callable[[Point], tuple[Array, Array]] | None = None
    whole: Callable[[Point], float] | None = None

    def at(self, point: Point) -> tuple[Array, Array]:
        """What `evaluate` gives, computed once for a point: solvers ask for values first and for derivatives later."""
        if self.evaluate not in point.memo:
            point.memo[self.evaluate] = self.evaluate(point)
        return point.memo[self.evaluate]

    def rows(self, point: Point) -> tuple[Array, Array, Array, Array]:
        """What the sequential solver linearises: g, its Jacobian, lower and upper bounds."""
        if self.inner is None:
            return (*self.at(point), self.lower, self.upper)
        if self.inner not in point.memo:
            point.memo[self.inner] = self.inner(point)
        g, J = point.memo[self.inner]
        return g, J, np.zeros(len(g)), np.full(len(g), np.inf)

    def violation(self, point: Point) -> float:
        """Greatest violation of a row at a point, in the block's unit; of the whole block, where it is part of one."""
        if self.whole is not None:
            return self.whole(point)
        g, _ = self.at(point)
        return float(np.max(np.maximum(self.lower - g, g - self.upper), initial=0.0))


def without_forces(point: Point, J: Array) -> Array:
    """A Jacobian whose rows do not depend on the forces: appends zero columns for them."""
    return np.concatenate([J, np.zeros((*J.shape[:-1], point.forces.size))], axis=-1)
