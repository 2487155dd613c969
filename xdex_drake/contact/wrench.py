"""Convex wrench programs of a grasp: what forces hold a wrench, and with how much margin.

All programs take the grasp matrix G (6, 3 n) of `contact.cones.grasp_matrix`: torque first, about the center of mass,
forces f stacked in contact frames whose z axes point into the object. Torques are divided by `length` (lambda, a size
of the object) wherever a norm of a wrench is taken. Friction cones are exact second-order cones unless a name says
`linearized`. A program without a solution is a result with a reason, never an exception.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
    check_effort,
    check_grasp,
    cone_rows,
    diagonal,
    effort_rows,
    full_matrix,
    holding_forces,
    norm,
    program_cones,
    solve_conic,
    torque_scaling,
    upper_matrix,
)
from xdex_drake.errors import ConfigError

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


def gravity_wrench(mass: float, gravity: float = GRAVITY) -> Array:
    """Wrench of gravity on an object about its center of mass, in W, torque first [N m, N], shape (6,)."""
    return np.array([0.0, 0.0, 0.0, 0.0, 0.0, -mass * gravity])


def push_wrenches(mass: float, gravity: float = GRAVITY) -> Array:
    """Six pushes at the center of mass, each as strong as the weight, along +x, -x, +y, -y, +z, -z of W.

    Args:
        mass: Mass [kg].
        gravity: Acceleration of gravity [m/s^2].

    Returns:
        Wrenches, torque first [N m, N], shape (6, 6).
    """
    pushes = np.zeros((6, 6))
    pushes[np.arange(6), 3 + np.arange(6) // 2] = np.tile([1.0, -1.0], 3) * mass * gravity
    return pushes


def balance(
    G: ArrayLike,
    mu: ArrayLike,
    F_ext: ArrayLike,
    *,
    A: ArrayLike | None = None,
    effort: ArrayLike | None = None,
    length: float,
    min_normal: float = 0.0,
    safety: float = 1.0,
    weight: ArrayLike = 1.0,
) -> Balance:
    """The least contact forces that hold an external wrench, within friction and the hand's efforts.

    minimise 1/2 sum_i weight_i |f_i|^2  subject to  G f + F_ext = 0,  |f_i,t| <= safety mu_i f_i,n,
    f_i,n >= min_normal,  |A f| <= effort

    A second-order cone program, solved natively by Clarabel.

    Args:
        G: Grasp matrix, shape (6, 3 n).
        mu: Coefficient of friction, one or n.
        F_ext: External wrench about the center of mass, torque first [N m, N], shape (6,); gravity is
            `gravity_wrench(mass)`.
        A: Map of contact forces to actuated joint torques, `contact.effort_map`, shape (n_act, 3 n).
        effort: Limits of |A f| [N m or N], shape (n_act,); infinite entries are no limits.
        length: Length that divides torques [m].
        min_normal: Least normal force at each contact [N].
        safety: Factor on friction, below 1 to stay away from slipping.
        weight: Weight of each contact's squared force, one or n, positive.

    Returns:
        The forces, or the reason why there are none.

    Raises:
        ConfigError: Shapes do not match or a number is out of range.
    """
    start = time.perf_counter()
    G, mus, n = check_grasp(G, mu, length, safety)
    A, e = check_effort(A, effort, n)
    F = np.asarray(F_ext, dtype=float)
    if n == 0:
        return _no_forces("infeasible", "there is no contact", 0, safety, min_normal, start, n)
    scaling = torque_scaling(length)
    G_n, F_n = scaling[:, None] * G, scaling * F
    holding = holding_forces(G_n)
    if not holding.balanceable(F_n):
        reason = "no forces of these contacts balance the wrench, whatever the friction"
        return _no_forces("infeasible", reason, 0, safety, min_normal, start, n)
    weights = np.full(n, 1.0) * np.asarray(weight, dtype=float)
    # Efforts seldom bind, and cost half of the time: least forces without them that respect them are the answer.
    status, f, iterations = _least_forces(holding, mus, F_n, A[:0], e[:0], min_normal, weights)
    limit = "friction cones"
    if status == "solved" and np.any(np.abs(A @ f) > e):
        status, f, more = _least_forces(holding, mus, F_n, A, e, min_normal, weights)
        limit, iterations = "effort limits", iterations + more
    if status != "solved":
        reason = STOPPED if status == "failed" else f"the {limit} allow no forces that balance the wrench"
        return _no_forces(status, reason, iterations, safety, min_normal, start, n)
    residual = norm(G_n @ f + F_n) / (norm(F_n) or 1.0)
    if residual > TOLERANCE:
        reason = f"the solver left a residual of {residual:.1e}"
        return _no_forces("failed", reason, iterations, safety, min_normal, start, n)
    seconds = time.perf_counter() - start
    return Balance("solved", f, residual, "", safety, min_normal, CLARABEL, iterations, seconds)


def _least_forces(
    holding: HoldingForces, mus: Array, F: Array, A: Array, effort: Array, min_normal: float, weights: Array
) -> tuple[str, Array, int]:
    """Status, forces and iterations of the program of `balance`, on validated and scaled values."""
    n, null = len(mus), holding.null
    scale = max(norm(F), min_normal, 1e-9)
    f = holding.of(F / scale)
    rows, right = [-cone_rows(mus, null)], [cone_rows(mus, f)]
    if min_normal > 0.0 or mus.min() == 0.0:  # else the cones say that contacts push
        rows.insert(0, -null[2::3])
        right.insert(0, f[2::3] - min_normal / scale)
    if len(effort):
        more, bound = effort_rows(A, effort / scale, null, f)
        rows.insert(0, more)
        right.insert(0, bound)
    M, b = (np.concatenate(rows), np.concatenate(right)) if len(rows) > 1 else (rows[0], right[0])
    if (weights == weights[0]).all():  # the basis is orthonormal, and the least forces orthogonal to it
        P, q = diagonal(np.ones(null.shape[1])), np.zeros(null.shape[1])
    else:
        W = np.repeat(weights / weights.max(), 3)
        P, q = upper_matrix(null.T @ (W[:, None] * null)), null.T @ (W * f)
    status, x, iterations = solve_conic(P, q, full_matrix(M), b, list(program_cones(len(M) - 3 * n, n)))
    return status, scale * (f + null @ x), iterations


def _no_forces(
    status: str, reason: str, iterations: int, safety: float, min_normal: float, start: float, n: int
) -> Balance:
    f, seconds = np.full(3 * n, np.nan), time.perf_counter() - start
    return Balance(status, f, math.nan, reason, safety, min_normal, CLARABEL, iterations, seconds)


def balance_program(
    G: ArrayLike,
    mu: ArrayLike,
    F_ext: ArrayLike,
    *,
    A: ArrayLike | None = None,
    effort: ArrayLike | None = None,
    length: float,
    min_normal: float = 0.0,
    safety: float = 1.0,
) -> MathematicalProgram:
    """`balance` as a `MathematicalProgram` to read, to change and to solve with Drake's `ClarabelSolver`.

    Args:
        G: Grasp matrix, shape (6, 3 n).
        mu: Coefficient of friction, one or n.
        F_ext: External wrench, torque first, shape (6,).
        A: Map of contact forces to actuated joint torques, shape (n_act, 3 n).
        effort: Limits of |A f|, shape (n_act,).
        length: Length that divides torques [m].
        min_normal: Least normal force at each contact [N].
        safety: Factor on friction.

    Returns:
        The program; its decision variables are f, shape (3 n,).

    Raises:
        ConfigError: Shapes do not match or a number is out of range.
    """
    G, mus, n = check_grasp(G, mu, length, safety)
    A, e = check_effort(A, effort, n)
    scaling = torque_scaling(length)
    program: Any = MathematicalProgram()  # its type stubs refuse NumPy's arrays
    f = program.NewContinuousVariables(3 * n, "f")
    F = np.asarray(F_ext, dtype=float)
    cost = program.AddQuadraticCost(np.eye(3 * n), np.zeros(3 * n), f, is_convex=True)
    cost.evaluator().set_description("least_forces")
    row = program.AddLinearEqualityConstraint(scaling[:, None] * G, -scaling * F, f)
    row.evaluator().set_description("wrench_balance")
    for i, mu_i in enumerate(mus):
        # Lorentz cone: z = (mu f_n, f_t1, f_t2), z_0 >= |(z_1, z_2)|.
        cone = np.array([[0.0, 0.0, mu_i], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        row = program.AddLorentzConeConstraint(cone, np.zeros(3), f[3 * i : 3 * i + 3])
        row.evaluator().set_description(f"friction_{i}")
        row = program.AddBoundingBoxConstraint(min_normal, np.inf, f[3 * i + 2])
        row.evaluator().set_description(f"normal_{i}")
    if len(e):
        program.AddLinearConstraint(A, -e, e, f).evaluator().set_description("effort")
    return program


def balance_linearized(
    G: ArrayLike,
    mu: ArrayLike,
    F_ext: ArrayLike,
    *,
    A: ArrayLike | None = None,
    effort: ArrayLike | None = None,
    length: float,
    min_normal: float = 0.0,
    safety: float = 1.0,
    edges: int = 8,
    solver: str = "daqp",
) -> Balance:
    """`balance` with pyramids inscribed in the friction cones: a quadratic program, solved through qpsolvers.

    The pyramids are subsets of the cones, so its forces are valid for the exact program, and it can fail where that
    succeeds.

    Args:
        G: Grasp matrix, shape (6, 3 n).
        mu: Coefficient of friction, one or n.
        F_ext: External wrench, torque first, shape (6,).
        A: Map of contact forces to actuated joint torques, shape (n_act, 3 n).
        effort: Limits of |A f|, shape (n_act,).
        length: Length that divides torques [m].
        min_normal: Least normal force at each contact [N].
        safety: Factor on friction.
        edges: Number of sides of a pyramid, at least 3.
        solver: Name of an installed solver of qpsolvers.

    Returns:
        The forces, or the reason why there are none.

    Raises:
        ConfigError: Shapes do not match, a number is out of range, or the solver is not installed.
    """
    import qpsolvers  # imports every solver that is installed, and nothing else needs it

    start = time.perf_counter()
    G, mus, n = check_grasp(G, mu, length, safety)
    A, e = check_effort(A, effort, n)
    if solver not in qpsolvers.available_solvers:
        raise ConfigError(f"solver: '{solver}' is not installed; qpsolvers knows {qpsolvers.available_solvers}")
    if edges < 3:
        raise ConfigError(f"edges: a pyramid of {edges} edges has no interior; give at least 3")
    name = f"qpsolvers {qpsolvers.__version__} {solver}"
    nothing = replace(
        _no_forces(
            "infeasible",
            "no forces within the pyramids and effort limits balance the wrench",
            0,
            safety,
            min_normal,
            start,
            n,
        ),
        solver=name,
    )
    if n == 0:
        return nothing
    G_n, F_n = torque_scaling(length)[:, None] * G, torque_scaling(length) * np.asarray(F_ext, dtype=float)
    scale = max(norm(F_n), min_normal, 1e-9)
    holding = holding_forces(G_n)
    if not holding.balanceable(F_n):
        return replace(nothing, seconds=time.perf_counter() - start)
    null, at = holding.null, holding.of(F_n / scale)
    angle = 2.0 * np.pi * (np.arange(edges) + 0.5) / edges
    side = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    pyramids = np.zeros((n, edges, n, 3))
    i = np.arange(n)
    pyramids[i, :, i, :2] = side
    pyramids[i, :, i, 2] = -mus[:, None] * math.cos(math.pi / edges)
    pyramids = pyramids.reshape(n * edges, 3 * n)
    limits, bound = effort_rows(A, e / scale, null, at)
    rows = np.concatenate([pyramids @ null, limits, -null[2::3]])
    right = np.concatenate([-pyramids @ at, bound, at[2::3] - min_normal / scale])
    problem = qpsolvers.Problem(np.eye(null.shape[1]), np.zeros(null.shape[1]), rows, right)
    solution = qpsolvers.solve_problem(problem, solver=solver)
    if not solution.found or solution.x is None:
        return replace(nothing, seconds=time.perf_counter() - start)
    f = scale * (at + null @ solution.x)
    residual = norm(G_n @ f + F_n) / (norm(F_n) or 1.0)
    if residual > TOLERANCE:
        return replace(nothing, status="failed", reason=f"the solver left a residual of {residual:.1e}")
    return Balance("solved", f, residual, "", safety, min_normal, name, 0, time.perf_counter() - start)


def squeeze_forces(
    G: ArrayLike,
    mu: ArrayLike,
    F_ext: ArrayLike,
    *,
    A: ArrayLike | None = None,
    effort: ArrayLike | None = None,
    length: float,
    min_normal: float = 1.0,
    safety: float = 0.55,
    safety_steps: Sequence[float] = (0.7, 0.85, 1.0),
    min_normal_steps: Sequence[float] = (0.5, 0.25, 0.0),
) -> Balance:
    """Forces to squeeze with: `balance` away from slipping, with a least normal force at each contact.

    Where there are none, friction is used more fully (`safety_steps`), and then the least normal force is lowered (to
    `min_normal_steps` times itself). The result says what was used.

    Args:
        G: Grasp matrix, shape (6, 3 n).
        mu: Coefficient of friction, one or n.
        F_ext: External wrench, torque first, shape (6,).
        A: Map of contact forces to actuated joint torques, shape (n_act, 3 n).
        effort: Limits of |A f|, shape (n_act,).
        length: Length that divides torques [m].
        min_normal: Least normal force to try first [N].
        safety: Factor on friction to try first.
        safety_steps: Factors to try next, rising.
        min_normal_steps: Factors on `min_normal` to try at last, falling.

    Returns:
        The first solution, with the `safety` and `min_normal` it was computed with, or the last failure.

    Raises:
        ConfigError: Shapes do not match or a number is out of range.
    """
    start = time.perf_counter()
    last = safety_steps[-1] if len(safety_steps) else safety
    trials = [(safety, min_normal), *((s, min_normal) for s in safety_steps)]
    trials += [(last, factor * min_normal) for factor in min_normal_steps]
    result = None
    for s, normal in trials:
        result = balance(G, mu, F_ext, A=A, effort=effort, length=length, min_normal=normal, safety=s)
        if result.solved:
            break
    assert result is not None
    return replace(result, seconds=time.perf_counter() - start)
