"""Balance: the least contact forces that hold a wrench.

Wrench programs take a `GraspMap`: torque first, about the center of mass, forces f stacked in contact frames whose z
axes point into the object. Torques are divided by its `length` (lambda, a size of the object) wherever a norm of a
wrench is taken. Friction cones are exact second-order cones; those that `contact.pyramids` solves are not. A program
without a solution is a result with a reason, never an exception.
"""

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import MathematicalProgram

from xdex_drake.arrays import Array
from xdex_drake.contact.conic import (
    CLARABEL,
    STOPPED,
    TOLERANCE,
    HoldingForces,
    cone_rows,
    diagonal,
    effort_rows,
    full_matrix,
    norm,
    program_cones,
    solve_conic,
)
from xdex_drake.contact.grasp_map import Effort, GraspMap, effort_limits

GRAVITY = 9.81
"""Standard acceleration of gravity of the library [m/s^2], as in Drake's `UniformGravityFieldElement`."""


@dataclass(frozen=True)
class Balance:
    """Contact forces that hold a wrench, or the reason why there are none.

    Attributes:
        status: "solved", "infeasible" or "failed" (the solver stopped early).
        f: Forces in contact frames [N], shape (3 n,); NaN unless solved.
        residual: Norm of G f + F_ext, torque divided by the length, divided by that of F_ext; NaN unless solved.
        reason: Why there is no solution; empty where solved.
        safety: Factor on friction that the forces were computed with.
        min_normal: Least normal force that was asked for [N].
        solver: Name and version of the solver.
        iterations: Iterations of the solver.
        seconds: Wall time, with building.
    """

    status: str
    f: Array
    residual: float
    reason: str
    safety: float
    min_normal: float
    solver: str
    iterations: int
    seconds: float

    @property
    def solved(self) -> bool:
        """Whether there are forces."""
        return self.status == "solved"


def gravity_wrench(mass: float) -> Array:
    """Wrench of gravity on a mass [kg] about its center, in W, torque first [N m, N], shape (6,)."""
    return np.array([0.0, 0.0, 0.0, 0.0, 0.0, -mass * GRAVITY])


def push_wrenches(mass: float) -> Array:
    """Six pushes at the center of mass, each as strong as the weight, along +x, -x, +y, -y, +z, -z of W.

    Args:
        mass: Mass [kg].

    Returns:
        Wrenches, torque first [N m, N], shape (6, 6).
    """
    pushes = np.zeros((6, 6))
    pushes[np.arange(6), 3 + np.arange(6) // 2] = np.tile([1.0, -1.0], 3) * mass * GRAVITY
    return pushes


def balance(
    grasp_map: GraspMap,
    F_ext: ArrayLike,
    *,
    effort: Effort | None = None,
    safety: float = 1.0,
    min_normal: float = 0.0,
) -> Balance:
    """The least contact forces that hold an external wrench, within friction and the hand's efforts.

    minimise 1/2 |f|^2  subject to  G f + F_ext = 0,  |f_i,t| <= safety mu_i f_i,n,  f_i,n >= min_normal,
    |A f| <= limits

    A second-order cone program, solved natively by Clarabel.

    Args:
        grasp_map: The contacts.
        F_ext: External wrench about the center of mass, torque first [N m, N], shape (6,); gravity is
            `gravity_wrench(mass)`.
        effort: What limits forces beside friction; nothing where None.
        safety: Factor on friction, below 1 to stay away from slipping.
        min_normal: Least normal force at each contact [N].

    Returns:
        The forces, or the reason why there are none.

    Raises:
        ConfigError: The map of efforts is not one of these contacts.
    """
    start = time.perf_counter()
    n, mus = grasp_map.contacts, safety * grasp_map.mus
    A, limits = effort_limits(effort, n)

    def nothing(status: str, reason: str, iterations: int = 0) -> Balance:
        seconds = time.perf_counter() - start
        return Balance(
            status, np.full(3 * n, np.nan), math.nan, reason, safety, min_normal, CLARABEL, iterations, seconds
        )

    if n == 0:
        return nothing("infeasible", "there is no contact")
    F = grasp_map.scaling * np.asarray(F_ext, dtype=float)
    holding = grasp_map.holding
    if not holding.balanceable(F):
        return nothing("infeasible", UNBALANCEABLE)
    # Efforts seldom bind, and cost half of the time: least forces without them that respect them are the answer.
    status, f, iterations = _least_forces(holding, mus, F, A[:0], limits[:0], min_normal)
    limit = "friction cones"
    if status == "solved" and np.any(np.abs(A @ f) > limits):
        status, f, more = _least_forces(holding, mus, F, A, limits, min_normal)
        limit, iterations = "effort limits", iterations + more
    if status != "solved":
        reason = STOPPED if status == "failed" else f"the {limit} allow no forces that balance the wrench"
        return nothing(status, reason, iterations)
    residual = norm(grasp_map.scaled @ f + F) / (norm(F) or 1.0)
    if residual > TOLERANCE:
        return nothing("failed", f"the solver left a residual of {residual:.1e}", iterations)
    seconds = time.perf_counter() - start
    return Balance("solved", f, residual, "", safety, min_normal, CLARABEL, iterations, seconds)


UNBALANCEABLE = "no forces of these contacts balance the wrench, whatever the friction"


def _least_forces(
    holding: HoldingForces, mus: Array, F: Array, A: Array, limits: Array, min_normal: float
) -> tuple[str, Array, int]:
    """Status, forces and iterations of the program of `balance`, on validated and scaled values."""
    n, null = len(mus), holding.null
    scale = max(norm(F), min_normal, 1e-9)
    f = holding.of(F / scale)
    rows, right = [-cone_rows(mus, null)], [cone_rows(mus, f)]
    if min_normal > 0.0 or mus.min() == 0.0:  # else the cones say that contacts push
        rows.insert(0, -null[2::3])
        right.insert(0, f[2::3] - min_normal / scale)
    if len(limits):
        more, bound = effort_rows(A, limits / scale, null, f)
        rows.insert(0, more)
        right.insert(0, bound)
    M, b = (np.concatenate(rows), np.concatenate(right)) if len(rows) > 1 else (rows[0], right[0])
    # The basis is orthonormal, and the least forces orthogonal to it.
    P, q = diagonal(np.ones(null.shape[1])), np.zeros(null.shape[1])
    status, x, iterations = solve_conic(P, q, full_matrix(M), b, list(program_cones(len(M) - 3 * n, n)))
    return status, scale * (f + null @ x), iterations


def balance_program(
    grasp_map: GraspMap,
    F_ext: ArrayLike,
    *,
    effort: Effort | None = None,
    safety: float = 1.0,
    min_normal: float = 0.0,
) -> MathematicalProgram:
    """`balance` as a `MathematicalProgram` to read, to change and to solve with Drake's `ClarabelSolver`.

    Args:
        grasp_map: The contacts.
        F_ext: External wrench, torque first, shape (6,).
        effort: What limits forces beside friction; nothing where None.
        safety: Factor on friction.
        min_normal: Least normal force at each contact [N].

    Returns:
        The program; its decision variables are f, shape (3 n,).

    Raises:
        ConfigError: The map of efforts is not one of these contacts.
    """
    n = grasp_map.contacts
    A, limits = effort_limits(effort, n)
    program: Any = MathematicalProgram()  # its type stubs refuse NumPy's arrays
    f = program.NewContinuousVariables(3 * n, "f")
    F = grasp_map.scaling * np.asarray(F_ext, dtype=float)
    cost = program.AddQuadraticCost(np.eye(3 * n), np.zeros(3 * n), f, is_convex=True)
    cost.evaluator().set_description("least_forces")
    row = program.AddLinearEqualityConstraint(grasp_map.scaled, -F, f)
    row.evaluator().set_description("wrench_balance")
    for i, mu_i in enumerate(safety * grasp_map.mus):
        # Lorentz cone: z = (mu f_n, f_t1, f_t2), z_0 >= |(z_1, z_2)|.
        cone = np.array([[0.0, 0.0, mu_i], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        row = program.AddLorentzConeConstraint(cone, np.zeros(3), f[3 * i : 3 * i + 3])
        row.evaluator().set_description(f"friction_{i}")
        row = program.AddBoundingBoxConstraint(min_normal, np.inf, f[3 * i + 2])
        row.evaluator().set_description(f"normal_{i}")
    if len(limits):
        program.AddLinearConstraint(A, -limits, limits, f).evaluator().set_description("effort")
    return program
