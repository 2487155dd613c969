"""What the convex programs share: scaling, constraint matrices of Clarabel, statuses."""

import math
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from xdex_drake.arrays import Array

conic: Any = clarabel  # the extension module has no types

CLARABEL = f"clarabel {conic.__version__}"
"""Name and version of the solver, as in results."""

TOLERANCE = 1e-6
"""A residual, divided by the external wrench, above this is not called a solution."""


@dataclass(frozen=True)
class HoldingForces:
    """All forces that balance a wrench, whatever the cones say: f = particular(F) + null z with any z.

    With them as variables the balance holds to rounding whatever a solver's tolerance is, there are 3 n - 6 unknowns
    instead of 3 n, and no equality is left.

    Attributes:
        null: Orthonormal basis of the forces that cancel, shape (3 n, m); one column of zeros where m would be 0.
        inverse: Least forces of a unit of each wrench component, -G^+, shape (3 n, 6).
        beyond: Orthonormal basis of the wrenches that no forces balance, shape (6, 6 - rank).
    """

    null: Array
    inverse: Array
    beyond: Array

    def of(self, F: Array) -> Array:
        """The least forces that balance a wrench, shape (3 n,)."""
        return self.inverse @ F

    def balanceable(self, F: Array) -> bool:
        """Whether any forces at all balance a wrench, to 1e-6 of it: two contacts span five dimensions only."""
        off = self.beyond.T @ F
        return not off.size or bool(off @ off <= TOLERANCE**2 * (F @ F))


def holding_forces(G: Array) -> HoldingForces:
    """Splits forces by a singular value decomposition of G, whose torques are divided by a length already."""
    U, sigma, Vt = np.linalg.svd(G)
    rank = int(np.count_nonzero(sigma > 1e-9 * max(sigma[0], 1.0)))
    null = Vt[rank:].T if rank < len(Vt) else np.zeros((len(Vt), 1))
    return HoldingForces(null, -(Vt[:rank].T / sigma[:rank]) @ U[:, :rank].T, U[:, rank:])


@lru_cache(maxsize=64)
def _cone_order(n: int) -> NDArray[np.int64]:
    """Components (normal, tangent, tangent) of each contact among stacked forces (tangent, tangent, normal)."""
    return (3 * np.arange(n)[:, None] + np.array([2, 0, 1])).ravel()


def cone_rows(mus: Array, M: Array) -> Array:
    """Rows (mu f_n, f_t1, f_t2) of each contact for f = M x: what second-order cones bound; shape (3 n, ...)."""
    rows = M[_cone_order(len(mus))]
    rows[::3] *= mus[:, None] if M.ndim == 2 else mus
    return rows


@lru_cache(maxsize=256)
def _full_pattern(rows: int, columns: int) -> csc_matrix:
    """A matrix without structural zeros to copy and fill: the checks of scipy cost more than the rest of building."""
    return csc_matrix(np.ones((rows, columns)))


def full_matrix(M: Array) -> csc_matrix:
    """A dense matrix in the sparse form that Clarabel takes."""
    matrix = copy(_full_pattern(*M.shape))
    matrix.data = M.ravel(order="F")
    return matrix


@lru_cache(maxsize=64)
def _diagonal_pattern(k: int) -> csc_matrix:
    return csc_matrix(np.eye(k))


def diagonal(values: Array) -> csc_matrix:
    """Diagonal matrix in the sparse form that Clarabel takes."""
    matrix = copy(_diagonal_pattern(len(values)))
    matrix.data = values
    return matrix


@lru_cache(maxsize=8)
def solver_settings(tolerance: float = 1e-9, equilibrate: bool = False) -> Any:
    """Settings of Clarabel: quiet, one thread, tight, no presolve (the programs are small and scaled already)."""
    settings = conic.DefaultSettings()
    settings.verbose = False
    settings.presolve_enable = False
    settings.equilibrate_enable = equilibrate
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    settings.max_iter = 100
    return settings


@lru_cache(maxsize=64)
def program_cones(linear: int, n: int) -> tuple[Any, ...]:
    """Cones of rows: first linear inequalities, then n friction cones of three rows each."""
    bounds = (conic.NonnegativeConeT(linear),) if linear else ()
    return (*bounds, *(conic.SecondOrderConeT(3) for _ in range(n)))


def effort_rows(A: Array, effort: Array, M: Array, f: Array) -> tuple[Array, Array]:
    """Rows and right-hand side of |A (f + M x)| <= effort, each divided by its limit."""
    # A row with a limit of 0 keeps its own scale: A f <= 0 and >= 0.
    limited = effort > 0.0
    unit = np.where(limited, effort, 1.0)
    rows, at = (A @ M) / unit[:, None], (A @ f) / unit
    return np.concatenate([rows, -rows]), np.concatenate([limited - at, limited + at])


def norm(v: Array) -> float:
    """Euclidean length of a vector; `np.linalg.norm` takes longer than what it computes."""
    return math.sqrt(float(v @ v))


def torque_scaling(length: float) -> Array:
    """Factors that divide the torques of a wrench by `length`."""
    return np.array([1.0 / length] * 3 + [1.0] * 3)


INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")
STOPPED = "the solver stopped before it could decide"


def solve_conic(
    P: csc_matrix, q: Array, rows: csc_matrix, right: Array, cones: list[Any], tolerance: float = 1e-9
) -> tuple[str, Array, int]:
    """Minimise 1/2 x P x + q x subject to right - rows x in the cones, by Clarabel.

    The rows are scaled by meaning already, and without equilibration the solver takes half the time; where it gives up,
    it tries again with equilibration and its own tolerances.

    Args:
        P: Upper triangle of the cost, shape (k, k).
        q: Linear cost, shape (k,).
        rows: Constraint matrix, shape (m, k).
        right: Right-hand side, shape (m,).
        cones: Clarabel's cones of the rows, in order.
        tolerance: Tolerance on gap and feasibility.

    Returns:
        Status ("solved", "infeasible" or "failed"), x, iterations.
    """
    solution = conic_solution(P, q, rows, right, cones, tolerance)
    return solver_status(solution), np.asarray(solution.x), solution.iterations


def conic_solution(
    P: csc_matrix, q: Array, rows: csc_matrix, right: Array, cones: list[Any], tolerance: float = 1e-9
) -> Any:
    """What Clarabel says to the program of `solve_conic`, with the multipliers `z` of the rows."""
    solution = conic.DefaultSolver(P, q, rows, right, cones, solver_settings(tolerance)).solve()
    if solver_status(solution) == "failed":
        solution = conic.DefaultSolver(P, q, rows, right, cones, solver_settings(1e-8, True)).solve()
    return solution


def resolve_conic(
    solver: Any, P: csc_matrix, q: Array, rows: csc_matrix, right: Array, cones: list[Any]
) -> tuple[str, Array, Any]:
    """`solve_conic` for programs that differ in the values of `rows` only: later ones reuse the first one's solver.

    Args:
        solver: What the last call returned; None at first.
        P: Upper triangle of the cost, shape (k, k).
        q: Linear cost, shape (k,).
        rows: Constraint matrix, shape (m, k).
        right: Right-hand side, shape (m,).
        cones: Clarabel's cones of the rows, in order.

    Returns:
        Status, x, and the solver for the next program.
    """
    if solver is None:
        solver = conic.DefaultSolver(P, q, rows, right, cones, solver_settings())
    else:
        solver.update(A=rows.data)
    solution = solver.solve()
    status = solver_status(solution)
    if status == "failed":
        status, x, _ = solve_conic(P, q, rows, right, cones)
        return status, x, solver
    return status, np.asarray(solution.x), solver


def solver_status(solution: Any) -> str:
    """`solved`, `infeasible` or `failed`; the caller judges a solution by its residuals."""
    name = str(solution.status)
    if name in ("Solved", "AlmostSolved"):
        return "solved"
    return "infeasible" if name in INFEASIBLE else "failed"
