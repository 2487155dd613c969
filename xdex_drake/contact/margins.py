"""Margins of a grasp: how much more than gravity it resists."""

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import cone_edges
from xdex_drake.contact.conic import (
    CLARABEL,
    STOPPED,
    cone_rows,
    diagonal,
    effort_rows,
    full_matrix,
    norm,
    program_cones,
    resolve_conic,
    solve_conic,
)
from xdex_drake.contact.grasp_map import Effort, GraspMap, effort_limits
from xdex_drake.contact.hull import GrowingHull
from xdex_drake.errors import ConfigError

ROUNDING = 1e-9
"""Ball margin below which a wrench set does not hold 0 in its interior."""


@dataclass(frozen=True)
class TaskMargin:
    """How much of the stated disturbances a grasp resists beside gravity.

    Attributes:
        status: "solved", "infeasible" (gravity itself is not held) or "failed".
        margin: Greatest s such that s times each disturbance is held, 0 unless solved, at most the cap.
        margins: The same for each disturbance by itself, shape (k,).
        forces: Forces that hold gravity and margins[k] times disturbance k [N], shape (k, 3 n).
        residual: Greatest norm of an unbalanced wrench, torque divided by length, divided by that of gravity.
        reason: Why there is no margin; empty where solved.
        solver: Name and version of the solver.
        seconds: Wall time, with building.
    """

    status: str
    margin: float
    margins: Array
    forces: Array
    residual: float
    reason: str
    solver: str
    seconds: float


@dataclass(frozen=True)
class BallMargin:
    """Bracket of the largest ball of wrenches that a unit sum of normal forces resists.

    Attributes:
        lower: Certified lower bound: the ball of this radius lies within the hull of wrenches of known forces.
        upper: Certified upper bound: the support of the wrench set in `direction`.
        direction: Unit wrench direction, torque first, shape (6,).
        witness_forces: Forces in contact frames that attain +lower, then -lower, along axis 0, then axis 1, ...; in
            units of the sum of normal forces, shape (12, 3 n).
        iterations: Number of hull refinements.
        seconds: Wall time.
    """

    lower: float
    upper: float
    direction: Array
    witness_forces: Array
    iterations: int
    seconds: float


def task_margin(
    grasp_map: GraspMap,
    F_gravity: ArrayLike,
    disturbances: ArrayLike,
    *,
    effort: Effort | None = None,
    cap: float = 100.0,
) -> TaskMargin:
    """The greatest multiple of each of some disturbances that a grasp resists beside gravity.

    For each k: maximise s  subject to  G f + F_gravity + s d_k = 0,  f in the friction cones,  |A f| <= limits,
    0 <= s <= cap. The margin is the least over k. Without effort limits it is often unbounded: hence the cap.

    Args:
        grasp_map: The contacts.
        F_gravity: Wrench that is always there, torque first [N m, N], shape (6,).
        disturbances: Wrenches d_k, shape (k, 6), for example `push_wrenches(mass)`.
        effort: What limits forces beside friction; nothing where None.
        cap: Greatest margin that is reported.

    Returns:
        The margin, 0 with a reason where gravity itself is not held.

    Raises:
        ConfigError: Shapes do not match or a number is out of range.
    """
    start = time.perf_counter()
    n, mus = grasp_map.contacts, grasp_map.mus
    A, limits = effort_limits(effort, n)
    D = np.atleast_2d(np.asarray(disturbances, dtype=float))
    if D.shape[1:] != (6,) or len(D) == 0:
        raise ConfigError(f"disturbances: shape {D.shape} is not (k, 6) with k >= 1")
    if n == 0:
        return _no_margin("infeasible", "there is no contact", len(D), n, start)
    F_n, D_n, holding = grasp_map.scaling * np.asarray(F_gravity, dtype=float), grasp_map.scaling * D, grasp_map.holding
    scale = max(norm(F_n), float(np.sqrt((D_n * D_n).sum(axis=1)).max()), 1e-9)
    if not holding.balanceable(F_n):
        return _no_margin("infeasible", "gravity is not held", len(D), n, start)
    # Variables (z, s): f = at + null z + s along_k. Only the column of s differs between disturbances.
    null, at, along = holding.null, holding.of(F_n / scale), holding.inverse @ (D_n.T / scale)
    m = null.shape[1]
    columns = np.concatenate([null, along], axis=1)
    efforts, bound = effort_rows(A, limits / scale, columns, at)
    pushing = slice(2, None, 3) if mus.min() == 0.0 else slice(0)  # else the cones say that contacts push
    rows = np.concatenate([efforts, -columns[pushing], np.zeros((2, m + len(D))), -cone_rows(mus, columns)])
    right = np.concatenate([bound, at[pushing], [0.0, cap], cone_rows(mus, at)])
    split = len(rows) - 3 * n - 2
    rows[split, m:], rows[split + 1, m:] = -1.0, 1.0
    # A whisper of least forces: without it the internal forces of the optimum are unbounded where efforts are.
    P, q = diagonal(np.append(np.full(m, 1e-7), 0.0)), np.append(np.zeros(m), -1.0)
    cones = list(program_cones(split + 2, n))
    solver: Any = None
    margins, forces = np.zeros(len(D)), np.zeros((len(D), 3 * n))
    for j, d in enumerate(D_n):
        if not holding.balanceable(d):  # not at all: forces for gravity alone
            keep = np.r_[:split, split + 2 : len(rows)]
            M = full_matrix(rows[keep, :m])
            hold = list(program_cones(split, n))
            status, x, _ = solve_conic(diagonal(np.ones(m)), np.zeros(m), M, right[keep], hold)
            x = np.append(x, 0.0)
        else:
            M = full_matrix(np.concatenate([rows[:, :m], rows[:, m + j : m + j + 1]], axis=1))
            status, x, solver = resolve_conic(solver, P, q, M, right, cones)
        if status != "solved":
            return _no_margin(status, "gravity is not held" if status == "infeasible" else STOPPED, len(D), n, start)
        margins[j] = max(0.0, float(x[-1]))
        forces[j] = scale * (at + margins[j] * along[:, j] + null @ x[:-1])
    unbalanced = forces @ grasp_map.scaled.T + F_n + margins[:, None] * D_n
    worst = float(np.sqrt((unbalanced * unbalanced).sum(axis=1)).max()) / (norm(F_n) or 1.0)
    seconds = time.perf_counter() - start
    return TaskMargin("solved", float(margins.min()), margins, forces, worst, "", CLARABEL, seconds)


def _no_margin(status: str, reason: str, k: int, n: int, start: float) -> TaskMargin:
    seconds = time.perf_counter() - start
    return TaskMargin(status, 0.0, np.zeros(k), np.zeros((k, 3 * n)), 0.0, reason, CLARABEL, seconds)


def support(grasp_map: GraspMap, directions: ArrayLike) -> tuple[Array, Array]:
    """Support function of W = {G f : f in the exact cones, sum f_n <= 1}, with forces that attain it.

    h(u) = max(0, max_i(mu_i |g_i,t| + g_i,n)), g = G^T u, torques divided by the length: the best forces press one
    contact only, along its friction cone's edge. Closed form, hence no solver.

    Args:
        grasp_map: The contacts.
        directions: Wrench directions u, shape (m, 6).

    Returns:
        h(u), shape (m,), and forces of contact i* with f_n = 1 (not 0 where h = 0), shape (m, 3 n).
    """
    n, mus, u = grasp_map.contacts, grasp_map.mus, np.asarray(directions, dtype=float)
    g = (u @ grasp_map.scaled).reshape(len(u), n, 3)
    tangent = np.sqrt(g[..., 0] ** 2 + g[..., 1] ** 2)
    values = mus * tangent + g[..., 2]
    best, row = values.argmax(axis=1), np.arange(len(u))
    f = np.zeros((len(u), n, 3))
    length = np.maximum(tangent[row, best], 1e-300)
    f[row, best, :2] = (mus[best] / length)[:, None] * g[row, best, :2]
    f[row, best, 2] = 1.0
    return np.maximum(0.0, values[row, best]), f.reshape(len(u), 3 * n)


def ball_margin(grasp_map: GraspMap, *, tol: float = 1e-3, max_iterations: int = 120) -> BallMargin:
    """Bracket of the radius of the largest ball around 0 in W = {G f : f in the exact cones, sum f_n <= 1}.

    A quality of the Ferrari-Canny family (1992, the sum of normal forces bounded) with exact cones. The hull of
    wrenches of known forces is an inner approximation, whose nearest facet bounds the radius from below; the support
    function at its normal bounds it from above; the forces of the support refine the hull until the bounds meet. Two
    hard-finger contacts resist no torque about the line between them: their margin is 0, found at once.

    Args:
        grasp_map: The contacts.
        tol: Width of the bracket to stop at, relative to unit force.
        max_iterations: Refinements after which the bracket is returned as it is, true but wider (1e-2 has been seen on
            symmetric grasps of many contacts whose margin is near 1, where nearly all directions are alike).

    Returns:
        The bracket with its witnesses. `lower` is 0 where 0 is not inside W.
    """
    start = time.perf_counter()
    n, mus, G = grasp_map.contacts, grasp_map.mus, grasp_map.scaled
    U, sigma, _ = np.linalg.svd(G, full_matrices=True)
    if n < 3 or sigma[-1] < 1e-9 * max(sigma[0], 1.0):
        # A direction that no force has a share in. (Fewer than three contacts never span all wrenches.)
        return BallMargin(0.0, 0.0, U[:, -1].copy(), np.zeros((12, 3 * n)), 0, time.perf_counter() - start)
    # Seeds: three edges of each cone, and support points along the principal axes of G.
    f_seed = np.zeros((3 * n, n, 3))
    f_seed[np.arange(3 * n), np.repeat(np.arange(n), 3)] = np.swapaxes(cone_edges(mus, 3), -1, -2).reshape(3 * n, 3)
    seeds = np.vstack([f_seed.reshape(3 * n, 3 * n), support(grasp_map, np.vstack([U.T, -U.T]))[1]])
    lower, upper, direction, iterations = 0.0, math.inf, U[:, -1].copy(), 0
    try:
        hull = GrowingHull(seeds @ G.T)
    except ValueError:  # no friction and few contacts: the wrenches lie in a plane that may not hold 0
        values, _ = support(grasp_map, np.vstack([U.T, -U.T]))
        direction = np.vstack([U.T, -U.T])[int(values.argmin())]
        return BallMargin(0.0, float(values.min()), direction, np.zeros((12, 3 * n)), 0, time.perf_counter() - start)
    columns, forces = np.ascontiguousarray(G.reshape(6, n, 3).transpose(1, 0, 2)), [*seeds[hull.start]]
    for iterations in range(1, max_iterations + 1):  # noqa: B007
        nearest = hull.nearest()
        u = hull.planes[nearest, :6]
        lower = float(hull.offsets[nearest])
        # The support as in `support`, for one direction.
        g = u @ columns  # (n, 3)
        tangent = np.hypot(g[:, 0], g[:, 1])
        values = mus * tangent + g[:, 2]
        best = int(values.argmax())
        if values[best] < upper:
            upper, direction = max(0.0, float(values[best])), u.copy()
        if upper - max(lower, 0.0) <= tol:
            break
        slope = mus[best] / max(float(tangent[best]), 1e-300)
        edge = np.array([slope * g[best, 0], slope * g[best, 1], 1.0])
        if not hull.add(columns[best] @ edge):
            break
        f = np.zeros(3 * n)
        f[3 * best : 3 * best + 3] = edge
        forces.append(f)
    # A margin of a few roundings is none: no forces could attain it.
    lower = min(lower, upper) if lower > ROUNDING else 0.0
    witness = _witness(G, np.array(forces), lower, hull)
    return BallMargin(lower, upper, direction, witness, iterations, time.perf_counter() - start)


_AXES: Any = np.kron(np.eye(6), [[1.0], [-1.0]])


def _witness(G: Array, forces: Array, lower: float, hull: GrowingHull) -> Array:
    """Forces that attain +-lower along each axis, as convex combinations of `forces`, shape (12, 3 n)."""
    result = np.zeros((12, forces.shape[1]))
    if lower <= 0.0:
        return result
    wrenches = forces @ G.T
    # The facet that the ray along an axis leaves through: its vertices' weights are nonnegative. A flat face is split
    # into several facets, of which one holds the ray.
    reach = hull.reach(_AXES)
    rows, facets = np.nonzero(reach <= reach.min(axis=1, keepdims=True) * (1.0 + 1e-9))
    vertices = hull.vertices[facets]
    try:
        matrices = np.swapaxes(wrenches[vertices], 1, 2)
        weights = np.linalg.solve(matrices, lower * _AXES[rows, :, None])[..., 0]
    except np.linalg.LinAlgError:
        weights = np.full((len(rows), 6), -1.0)
    for row, axis in enumerate(_AXES):
        tried = slice(*np.searchsorted(rows, [row, row + 1]))
        best = int(weights[tried].min(axis=1).argmax()) + tried.start
        if weights[best].min() >= -1e-12:
            result[row] = weights[best] @ forces[vertices[best]]
        else:  # a sliver: any nonnegative combination does
            stacked = np.vstack([np.c_[wrenches.T, np.zeros(6)], np.ones(len(forces) + 1)])
            result[row] = nnls(stacked, np.append(lower * axis, 1.0))[0][:-1] @ forces
    return result
