"""Costs and constraints that a user added to the `MathematicalProgram` itself, as costs and blocks of ours.

Drake evaluates them, and differentiates them by its own AutoDiff; here their derivatives with respect to the decision
variables become ones with respect to a point's tangent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import InitializeAutoDiff
from pydrake.solvers import EvaluatorBase, LinearCost, MathematicalProgram, QuadraticCost

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.programs.block import MM, Block
from xdex_drake.programs.costs import CURVATURE
from xdex_drake.programs.point import Point

OWN_UNIT = "own"
"""Unit of rows whose unit is their maker's."""


class Binding(Protocol):
    """Drake's binding of a cost or constraint to its variables."""

    def evaluator(self) -> Any:
        """The cost or constraint."""
        ...

    def variables(self) -> NDArray:
        """Its variables."""
        ...


@dataclass(frozen=True)
class Variables:
    """How the decision variables of a program follow from a point.

    Attributes:
        values: All decision variables of the program at a point, shape (n_variables,).
        rates: Their rates from those of the tangent, shape (n_variables, size).
    """

    values: Callable[[Point], Array]
    rates: Callable[[Point], Array]


@dataclass(frozen=True)
class ForeignCost:
    """A cost that was added to the `MathematicalProgram`.

    Attributes:
        name: Name in tables and results.
        binding: Drake's cost with its variables.
        indices: Where those variables lie among all of the program.
        variables: How they follow from a point.
        weight: 1; Drake's costs have their weights inside.
        meaning: One line for tables.
    """

    name: str
    binding: Binding
    indices: NDArray[np.int64]
    variables: Variables
    weight: float = 1.0
    meaning: str = "added to prog"

    def value(self, point: Point) -> float:
        """The cost at a point."""
        return float(self.binding.evaluator().Eval(self.variables.values(point)[self.indices])[0])

    def gradient(self, point: Point) -> Array:
        """Gradient with respect to the tangent, shape (size,)."""
        _, J = differentiated(self.binding, self.name, self.variables.values(point)[self.indices])
        return J[0] @ self.variables.rates(point)[self.indices]

    def curvature(self, point: Point) -> Array:
        """A convex model's Hessian with respect to the tangent, shape (size, size); exact for convex quadratic costs.

        What turns the wrist curves a quaternion, too; that part is left out.
        """
        evaluator = self.binding.evaluator()
        if isinstance(evaluator, QuadraticCost):
            values, vectors = np.linalg.eigh(evaluator.Q())
            root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T @ self.variables.rates(point)[self.indices]
            return root.T @ root
        return (0.0 if isinstance(evaluator, LinearCost) else CURVATURE) * np.eye(point.size)


def differentiated(binding: Binding, name: str, x: Array) -> tuple[Array, Array]:
    """Values of a binding and their derivatives by Drake's AutoDiff.

    Args:
        binding: A cost or constraint with its variables.
        name: Its name, for the error.
        x: Values of its variables, shape (k,).

    Returns:
        Values, shape (m,), and Jacobian, shape (m, k).

    Raises:
        ConfigError: It has no derivatives, as Python functions that turn their arguments into floats.
    """
    try:
        values, J = split_autodiff(np.asarray(binding.evaluator().Eval(InitializeAutoDiff(x).ravel())).ravel())
    except (TypeError, RuntimeError) as error:
        raise ConfigError(
            f"{name!r} of program.prog cannot be differentiated ({_first_line(error)}); write it for AutoDiffXd, "
            "or add a function of the configuration by program.add_cost"
        ) from None
    # What depends on none of its variables has derivatives of no length.
    return values, J if J is not None and J.shape[1] else np.zeros((len(values), len(x)))


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def foreign_block(name: str, binding: Binding, indices: NDArray[np.int64], variables: Variables) -> Block:
    """A constraint that was added to the `MathematicalProgram`, as a block.

    Args:
        name: Name in tables and results.
        binding: Drake's constraint with its variables.
        indices: Where those variables lie among all of the program.
        variables: How they follow from a point.

    Returns:
        The block, in the units of its maker.
    """
    evaluator = binding.evaluator()
    lower, upper = np.array(evaluator.lower_bound()), np.array(evaluator.upper_bound())
    low, high = np.isfinite(lower), np.isfinite(upper)

    def evaluate(point: Point) -> tuple[Array, Array]:
        g, J = differentiated(binding, name, variables.values(point)[indices])
        return g, J @ variables.rates(point)[indices]

    def inner(point: Point) -> tuple[Array, Array]:
        # In thousandths of their unit, as millimetres are, so that they weigh as much as the program's own rows.
        g, J = evaluate(point)
        return MM * np.concatenate([(g - lower)[low], (upper - g)[high]]), MM * np.concatenate([J[low], -J[high]])

    def violation(point: Point) -> float:
        g = np.asarray(evaluator.Eval(variables.values(point)[indices])).ravel()
        return float(np.max(np.maximum(lower - g, g - upper), initial=0.0))

    return Block(name, evaluate, lower, upper, OWN_UNIT, "added to prog", inner=inner, whole=violation)


def _named(bindings: Iterable[Binding], taken: set[str]) -> list[tuple[str, Binding]]:
    """Bindings with names of their own: their descriptions, or their kind and first variables, none of them taken."""
    found = []
    for binding in bindings:
        evaluator = binding.evaluator()
        variables = [variable.get_name() for variable in binding.variables()]
        several = ", ..." if len(variables) > 3 else ""
        base = evaluator.get_description() or f"{type(evaluator).__name__} on {', '.join(variables[:3])}{several}"
        name = next(n for k in count(1) if (n := base if k == 1 else f"{base} ({k})") not in taken)
        taken.add(name)
        found.append((name, binding))
    return found


def foreign_terms(
    prog: MathematicalProgram, own: Sequence[EvaluatorBase], taken: Iterable[str], variables: Variables
) -> tuple[tuple[ForeignCost, ...], tuple[Block, ...]]:
    """What others added to a `MathematicalProgram`.

    Args:
        prog: The program.
        own: Evaluators of the costs and constraints that are known already.
        taken: Names that are given away already.
        variables: How the decision variables follow from a point.

    Returns:
        Costs and constraints, in Drake's order.
    """
    known, names = {id(evaluator) for evaluator in own}, set(taken)
    costs = _named((b for b in prog.GetAllCosts() if id(b.evaluator()) not in known), names)
    constraints = _named((b for b in prog.GetAllConstraints() if id(b.evaluator()) not in known), names)

    def indices(binding: Binding) -> NDArray[np.int64]:
        return np.array(prog.FindDecisionVariableIndices(binding.variables()), dtype=np.int64)

    return (
        tuple(ForeignCost(name, binding, indices(binding), variables) for name, binding in costs),
        tuple(foreign_block(name, binding, indices(binding), variables) for name, binding in constraints),
    )


def split_autodiff(z: NDArray) -> tuple[Array, Array | None]:
    """Values and derivatives of an array of floats, which have none, or of AutoDiffXd; shapes (n,) and (n, k)."""
    if z.dtype != object:
        return np.asarray(z, dtype=float), None
    values = np.array([v.value() for v in z])
    width = max(len(v.derivatives()) for v in z)
    derivatives = np.zeros((len(z), width))
    for row, v in zip(derivatives, z, strict=True):
        d = v.derivatives()
        if len(d):
            row[:] = d
    return values, derivatives
