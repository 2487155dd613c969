"""Grasp programs: a `MathematicalProgram` with named costs and constraints, open to a user's own.

The decision variables are X_WH (x, y, z, qw, qx, qy, qz), the actuated joints q, and the contact forces f in W in units
of the object's weight. Costs and constraints are written on the tangent (`constraints.py`); here they become Drake
costs and constraints by the chain rule, with analytic gradients: nothing is differentiated through the plant.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.solvers import EvaluatorBase, MathematicalProgram

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.block import Block
from xdex_drake.programs.costs import Cost, EnergyCost, LeastSquares, UserCost
from xdex_drake.programs.foreign import Binding, ForeignCost, Variables, foreign_terms, split_autodiff
from xdex_drake.programs.point import ContactSet, Point
from xdex_drake.programs.term import Term
from xdex_drake.scene.plant import ScenePlant, build_plant
from xdex_drake.scene.tabletop import Scene


class OutOfTime(RuntimeError):
    """A solver asks for another value after its time."""


class _Evaluator:
    """Turns decision variables into points; the last one is kept, since costs and constraints ask in turn."""

    def __init__(self, start: Point) -> None:
        self._start = start
        self.deadline = math.inf
        self._last: tuple[bytes, Point] | None = None

    def point(self, x: Array) -> Point:
        x = np.ascontiguousarray(x, dtype=float)
        key = x.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        if time.perf_counter() > self.deadline:
            raise OutOfTime
        start, n = self._start, len(self._start.k.q)
        R_WH = RotationMatrix(Quaternion(wxyz=x[3:7] / np.linalg.norm(x[3:7])))
        k = Configuration.at(start.k.hand, RigidTransform(R_WH, x[:3]), x[7 : 7 + n])
        point = Point(k, start.scene, start.contacts, x[7 + n :].reshape(-1, 3))
        self._last = (key, point)
        return point


def tangent_rates(x: Array) -> Array:
    """Matrix that turns rates of the decision variables into the tangent.

    Args:
        x: Decision variables, shape (7 + n + 3 nc,).

    Returns:
        Matrix, shape (6 + n + 3 nc, 7 + n + 3 nc).
    """
    w, a, b, c = x[3:7]
    T = np.zeros((len(x) - 1, len(x)))
    # Angular velocity of a quaternion that need not have unit length: 2 (rate times conjugate) / |quaternion|^2.
    T[:3, 3:7] = 2.0 / (x[3:7] @ x[3:7]) * np.array([[-a, w, -c, b], [-b, c, w, -a], [-c, -b, a, w]])
    T[3:6, :3] = np.eye(3)
    T[6:, 7:] = np.eye(len(x) - 7)
    return T


def variable_rates(x: Array) -> Array:
    """Matrix that turns the tangent into rates of the decision variables; the quaternion keeps its length.

    Args:
        x: Decision variables, shape (7 + n + 3 nc,).

    Returns:
        Matrix, shape (7 + n + 3 nc, 6 + n + 3 nc), of which `tangent_rates` is a left inverse.
    """
    N = np.zeros((len(x), len(x) - 1))
    N[:3, 3:6] = np.eye(3)
    N[3:7, :3] = 0.25 * (x[3:7] @ x[3:7]) * tangent_rates(x)[:3, 3:7].T
    N[7:, 6:] = np.eye(len(x) - 7)
    return N


@dataclass(frozen=True)
class ProgramTerms:
    """All that a program holds, whoever added it.

    Attributes:
        costs: Costs.
        constraints: Constraints.
    """

    costs: tuple[Cost | ForeignCost, ...]
    constraints: tuple[Block, ...]


class GraspProgram:
    """A named nonlinear program over a grasp.

    Public and open: `prog` takes ordinary `AddCost` and `AddConstraint` on `X_WH`, `q` and `f`, which every solver
    and its verdict see; `add_cost` takes a function of the configuration; `plant` is the joint plant for a user's own
    Drake costs. `str(program)` is a table of its costs and constraints.
    """

    def __init__(self, name: str, start: Point, costs: tuple[Cost, ...], constraints: tuple[Block, ...]) -> None:
        """Builds the `MathematicalProgram`.

        Args:
            name: Name of the program.
            start: Initial guess; it also fixes hand, scene and contact set.
            costs: Costs.
            constraints: Constraints.
        """
        self.name = name
        self.start = start
        self.costs: list[Cost] = []
        self.constraints: list[Block] = []
        self.prog = MathematicalProgram()
        self.X_WH: NDArray = self.prog.NewContinuousVariables(7, "X_WH")
        self.q: NDArray = self.prog.NewContinuousVariables(len(start.k.q), "q")
        self.f: NDArray = self.prog.NewContinuousVariables(start.forces.size, "f")
        self.variables = np.concatenate([self.X_WH, self.q, self.f])
        self._evaluator = _Evaluator(start)
        unit = self.prog.AddQuadraticConstraint(
            2.0 * np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]), np.zeros(7), 1.0, 1.0, self.X_WH
        )
        bounds = self.prog.AddBoundingBoxConstraint(self.hand.limits[0], self.hand.limits[1], self.q)
        # What is in the program by us; all else was added by a user.
        self._own: list[EvaluatorBase] = []
        self._keep(unit, "unit quaternion")
        self._keep(bounds, "joint limits")
        for cost in costs:
            self._add_cost(cost)
        for block in constraints:
            self._add_constraint(block)
        self.prog.SetInitialGuess(self.variables, self.values(start))

    @property
    def hand(self) -> Hand:
        """The hand."""
        return self.start.k.hand

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.start.scene

    @property
    def contacts(self) -> ContactSet:
        """The contact set."""
        return self.start.contacts

    @cached_property
    def plant(self) -> ScenePlant:
        """The joint plant of hand, object and table, the hand floating; built when first asked for."""
        return build_plant(self.hand, self.scene)

    def add_cost(self, name: str, function: Callable[[Configuration], float], *, weight: float = 1.0) -> None:
        """Adds a cost of the user's own, seen by every solver.

        Args:
            name: Name in tables and results.
            function: A smooth function of the hand's configuration, from which it may read `X_WH`, `q`, and points of
                links.
            weight: Weight.
        """
        self._add_cost(UserCost(name, weight, function))

    def add(self, cost: Cost | Term) -> None:
        """Adds a cost, such as `spread_cost(0.02)`, or an energy term, seen by every solver.

        Args:
            cost: The cost; a term is taken with its weight, as a search takes it.
        """
        self._add_cost(cost if isinstance(cost, LeastSquares | UserCost | EnergyCost) else EnergyCost(cost))

    def add_constraint(self, block: Block) -> None:
        """Adds a constraint, such as `approach_block((0, 0, -1))`, seen by every solver."""
        self._add_constraint(block)

    def _keep(self, binding: Binding, description: str) -> None:
        binding.evaluator().set_description(description)
        self._own.append(binding.evaluator())

    def terms(self, further: Array | None = None) -> ProgramTerms:
        """Costs and constraints: ours, and those that a user added to `prog`.

        Args:
            further: Values of the decision variables that a user added to `prog`; those of its initial guess where
                None.

        Returns:
            All of them. Those of `prog` have their descriptions as names, their makers' units, and derivatives by
            Drake's AutoDiff.
        """
        rest = self.further_variables()
        more = self.prog.GetInitialGuess(rest) if further is None else further

        def values(point: Point) -> Array:
            return np.concatenate([self.values(point), more])

        def rates(point: Point) -> Array:
            return np.concatenate([variable_rates(self.values(point)), np.zeros((len(more), point.size))])

        names = [part.name for part in (*self.costs, *self.constraints)]
        costs, constraints = foreign_terms(self.prog, self._own, names, Variables(values, rates))
        return ProgramTerms((*self.costs, *costs), (*self.constraints, *constraints))

    def further_variables(self) -> NDArray:
        """Decision variables that a user added to `prog`."""
        return self.prog.decision_variables()[len(self.variables) :]

    def guess(self) -> Point:
        """The initial guess of `prog`: the start, where a user set no other."""
        x, at_start = self.prog.GetInitialGuess(self.variables), self.values(self.start)
        x = np.where(np.isfinite(x), x, at_start)
        return self.start if np.array_equal(x, at_start) else self.point(x)

    def values(self, point: Point) -> Array:
        """Decision variables of a point, shape (7 + n + 3 nc,); of its two quaternions, that nearer to the start's."""
        X_WH = point.k.X_WH
        quaternion = X_WH.rotation().ToQuaternion().wxyz()
        if quaternion @ self.start.k.X_WH.rotation().ToQuaternion().wxyz() < 0.0:
            quaternion = -quaternion
        return np.concatenate([X_WH.translation(), quaternion, point.k.q, point.forces.ravel()])

    def point(self, x: Array) -> Point:
        """The point at values of the decision variables, shape (7 + n + 3 nc,)."""
        return self._evaluator.point(x)

    @contextmanager
    def limited(self, seconds: float) -> Iterator[None]:
        """Raises `OutOfTime` in whoever asks for a new point after so many seconds; not every solver has a limit."""
        self._evaluator.deadline = time.perf_counter() + seconds
        try:
            yield
        finally:
            self._evaluator.deadline = math.inf

    def last_point(self) -> Point:
        """The last point at which a solver asked for values; the start where none did."""
        return self.start if self._evaluator._last is None else self._evaluator._last[1]

    def rates(self, x: Array) -> Array:
        """Matrix that turns rates of the decision variables into the tangent; see `tangent_rates`."""
        return tangent_rates(x)

    def _add_cost(self, cost: Cost) -> None:
        self.costs.append(cost)
        # Drake keeps the function; one that held the program would keep it alive for ever.
        evaluator = self._evaluator

        def function(z: NDArray) -> object:
            x, derivatives = split_autodiff(z)
            value = cost.value(evaluator.point(x))
            if derivatives is None:
                return value
            gradient = cost.gradient(evaluator.point(x)) @ tangent_rates(x)
            return AutoDiffXd(value, gradient @ derivatives)

        self._keep(self.prog.AddCost(function, self.variables), cost.name)

    def _add_constraint(self, block: Block) -> None:
        self.constraints.append(block)
        if len(block.lower) == 0:
            return
        evaluator = self._evaluator

        def function(z: NDArray) -> NDArray:
            x, derivatives = split_autodiff(z)
            g, J = block.at(evaluator.point(x))
            if derivatives is None:
                return g
            rows = J @ tangent_rates(x) @ derivatives
            return np.array([AutoDiffXd(float(v), row) for v, row in zip(g, rows, strict=True)])

        # The quaternion's own bounds are in place already; joint limits too, for a solver that knows bounds.
        if block.name != "limits":
            self._keep(self.prog.AddConstraint(function, block.lower, block.upper, self.variables), block.name)

    def table(self, point: Point | None = None) -> str:
        """A table of costs and constraints, with their values at a point (the initial guess where None)."""
        point, terms = self.start if point is None else point, self.terms()
        lines = [
            f"{self.name}: {self.hand.name} on {self.scene.object.name}, {len(self.contacts.spheres)} contacts, "
            f"{self.prog.num_vars()} variables",
            f"  {'cost':<14}{'weight':>9}{'value':>12}  meaning",
        ]
        for cost in terms.costs:
            lines.append(f"  {cost.name:<14}{cost.weight:>9.3g}{cost.value(point):>12.4g}  {cost.meaning}")
        lines.append(f"  {'constraint':<14}{'rows':>9}  {'violation':>12}  meaning")
        for block in terms.constraints:
            violation = f"{block.violation(point):.3g} {block.unit}"
            lines.append(f"  {block.name:<14}{len(block.lower):>9}  {violation:>12}  {block.meaning}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        """One line."""
        parts = self.terms()
        return (
            f"GraspProgram({self.name!r}, {self.hand.name} on {self.scene.object.name}, "
            f"{self.prog.num_vars()} variables, {len(parts.costs)} costs, {len(parts.constraints)} constraints)"
        )

    def __str__(self) -> str:
        """The table at the initial guess."""
        return self.table()
