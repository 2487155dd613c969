"""What the convex programs share: validation, scaling, constraint matrices of Clarabel, statuses."""

import math
from functools import lru_cache
from typing import Any

import clarabel
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csc_matrix

from xdex_drake.contact.cones import cone_violation
from xdex_drake.errors import ConfigError

Array = NDArray[np.float64]

conic: Any = clarabel  # the extension module has no types

CLARABEL = f"clarabel {conic.__version__}"
"""Name and version of the solver, as in results."""

TOLERANCE = 1e-6
"""A residual, divided by the external wrench, above this is not called a solution."""


def check_grasp(G: ArrayLike, mu: ArrayLike, length: float, safety: float = 1.0) -> tuple[Array, Array, int]:
    """Validated G, friction coefficients per contact times `safety`, number of contacts."""
    G = np.asarray(G, dtype=float)
    if G.ndim != 2 or G.shape[0] != 6 or G.shape[1] % 3 != 0:
        raise ConfigError(f"G: shape {G.shape} is not (6, 3 n); build it with contact.grasp_matrix")
    n = G.shape[1] // 3
    mus = np.asarray(mu, dtype=float)
    if mus.ndim > 1 or (mus.ndim == 1 and mus.shape != (n,)) or not np.all((mus >= 0.0) & np.isfinite(mus)):
        raise ConfigError(f"mu: {mu} must be one coefficient or {n}, finite and not negative")
    if not (length > 0.0 and math.isfinite(length)):
        raise ConfigError(f"length: {length} must be positive; use a size of the object in meters")
    if not np.all(np.isfinite(G)):
        raise ConfigError("G: not finite; check the contact points and normals")
    return G, np.full(n, safety) * mus, n


def check_effort(A: ArrayLike | None, effort: ArrayLike | None, n: int) -> tuple[Array, Array]:
    """Validated (A, effort) without the rows of unlimited joints; (0, 3 n) and (0,) where there are no limits."""
    if A is None or effort is None:
        if A is not None or effort is not None:
            raise ConfigError("A and effort: give both or neither")
        return np.zeros((0, 3 * n)), np.zeros(0)
    A, e = np.asarray(A, dtype=float), np.asarray(effort, dtype=float)
    if A.ndim != 2 or A.shape[1] != 3 * n or e.shape != (A.shape[0],) or not np.all(e >= 0.0):
        raise ConfigError(f"A, effort: shapes {A.shape}, {e.shape} are not (n_act, {3 * n}), (n_act,) with effort >= 0")
    limited = np.isfinite(e) & (np.abs(A).max(axis=1, initial=0.0) > 1e-12)
    return A[limited], e[limited]


@lru_cache(maxsize=64)
def pattern(n: int, effort_rows: int, extra: bool) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
    """Structural nonzeros of the transposed constraint matrix, column by column, and its CSC indices.

    Rows: 6 equalities, 2 effort_rows, n normal bounds, (2 bounds of s), n cones of 3. Columns: f, then s where `extra`.
    """
    columns, m = 3 * n + extra, 6 + 2 * effort_rows + n + 2 * extra + 3 * n
    mask = np.zeros((columns, m), dtype=bool)
    mask[:, : 6 + 2 * effort_rows] = True
    bounds = 6 + 2 * effort_rows
    cones = bounds + n + 2 * extra
    for i in range(n):
        mask[3 * i + 2, bounds + i] = True
        mask[3 * i + 2, cones + 3 * i] = True
        mask[3 * i, cones + 3 * i + 1] = True
        mask[3 * i + 1, cones + 3 * i + 2] = True
    if extra:
        mask[-1, 6:] = False
        mask[-1, bounds + n : bounds + n + 2] = True
    indptr = np.concatenate([[0], np.cumsum(mask.sum(axis=1))]).astype(np.int64)
    return mask, np.nonzero(mask)[1].astype(np.int64), indptr


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
def program_cones(n: int, effort_rows: int, extra: bool) -> tuple[Any, ...]:
    """Cones of the rows of `pattern`."""
    linear = conic.NonnegativeConeT(2 * effort_rows + n + 2 * extra)
    return (conic.ZeroConeT(6), linear, *(conic.SecondOrderConeT(3) for _ in range(n)))


def diagonal(values: Array) -> csc_matrix:
    """Diagonal matrix in the sparse form that Clarabel takes."""
    k = len(values)
    return csc_matrix((values, np.arange(k), np.arange(k + 1)), shape=(k, k))


def constraint_rows(G: Array, mus: Array, A: Array, effort: Array, scale: float) -> tuple[Array, Array]:
    """Dense transposed constraint matrix of f / scale, (3 n, m), and its right-hand side with zero equalities.

    Constraint order of `_pattern` without the extra variable. Efforts are divided by their limits.
    """
    n, k = len(mus), len(effort)
    M = np.zeros((3 * n, 6 + 2 * k + 4 * n))
    M[:, :6] = G.T
    b = np.zeros(6 + 2 * k + 4 * n)
    if k:
        # A row with a limit of 0 keeps its own scale: A f <= 0 and >= 0.
        unit = np.where(effort > 0.0, effort / scale, 1.0)
        M[:, 6 : 6 + k] = (A / unit[:, None]).T
        M[:, 6 + k : 6 + 2 * k] = -M[:, 6 : 6 + k]
        b[6 : 6 + k] = b[6 + k : 6 + 2 * k] = np.where(effort > 0.0, 1.0, 0.0)
    bounds, cones, i = 6 + 2 * k, 6 + 2 * k + n, np.arange(n)
    M[3 * i + 2, bounds + i] = -1.0
    M[3 * i + 2, cones + 3 * i] = -mus
    M[3 * i, cones + 3 * i + 1] = -1.0
    M[3 * i + 1, cones + 3 * i + 2] = -1.0
    return M, b


def torque_scaling(length: float) -> Array:
    """Factors that divide the torques of a wrench by `length`."""
    return np.array([1.0 / length] * 3 + [1.0] * 3)


def polish(G: Array, f: Array, F: Array, mus: Array) -> Array:
    """Least change of f to G f + F = 0 (the solver leaves about 1e-9), kept only where the cones still hold."""
    # The residual is about 1e-9: a slightly regularised solve (G may have rank five) leaves nothing of it.
    exact = f - G.T @ np.linalg.solve(G @ G.T + 1e-9 * np.eye(6), G @ f + F)
    allowed = 1e-9 * np.linalg.norm(F) + cone_violation(f.reshape(-1, 3), mus).max(initial=0.0)
    return exact if cone_violation(exact.reshape(-1, 3), mus).max(initial=0.0) <= allowed else f


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
    solution = conic.DefaultSolver(P, q, rows, right, cones, solver_settings(tolerance)).solve()
    if solver_status(solution) == "failed":
        solution = conic.DefaultSolver(P, q, rows, right, cones, solver_settings(1e-8, True)).solve()
    return solver_status(solution), np.asarray(solution.x), solution.iterations


def in_span(G: Array, F: Array) -> bool:
    """Whether any forces at all, within cones or not, balance a wrench, to 1e-6 of it.

    Two contacts span five dimensions only, and nearly infeasible equalities can leave the solver undecided.
    """
    f = np.linalg.lstsq(G, -F, rcond=1e-9)[0]
    return bool(np.linalg.norm(G @ f + F) <= TOLERANCE * np.linalg.norm(F))


def solver_status(solution: Any) -> str:
    """`solved`, `infeasible` or `failed`; the caller judges a solution by its residuals."""
    name = str(solution.status)
    if name in ("Solved", "AlmostSolved"):
        return "solved"
    return "infeasible" if name in INFEASIBLE else "failed"
