"""Friction cones taken as pyramids: linear and quadratic programs, to compare with the exact cones.

The pyramids are inscribed, hence subsets of the cones: their forces are valid for the exact programs, and they can fail
where those succeed.
"""

import math
import time

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_matrix
from scipy.spatial import ConvexHull, QhullError

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import cone_edges
from xdex_drake.contact.conic import TOLERANCE, conic, conic_solution, effort_rows, norm, solver_status
from xdex_drake.contact.grasp_map import Effort, GraspMap, effort_limits
from xdex_drake.contact.wrench import UNBALANCEABLE, Balance
from xdex_drake.errors import ConfigError


def balance_linearized(
    grasp_map: GraspMap,
    F_ext: ArrayLike,
    *,
    effort: Effort | None = None,
    safety: float = 1.0,
    min_normal: float = 0.0,
    edges: int = 8,
    solver: str = "daqp",
) -> Balance:
    """`balance` with pyramids for cones: a quadratic program, solved through qpsolvers.

    Args:
        grasp_map: The contacts.
        F_ext: External wrench, torque first, shape (6,).
        effort: What limits forces beside friction; nothing where None.
        safety: Factor on friction.
        min_normal: Least normal force at each contact [N].
        edges: Number of sides of a pyramid, at least 3.
        solver: Name of an installed solver of qpsolvers.

    Returns:
        The forces, or the reason why there are none.

    Raises:
        ConfigError: The map of efforts is not one of these contacts, a pyramid has no interior, or the solver is not
            installed.
    """
    import qpsolvers  # imports every solver that is installed, and nothing else needs it

    start = time.perf_counter()
    n = grasp_map.contacts
    A, limits = effort_limits(effort, n)
    if solver not in qpsolvers.available_solvers:
        raise ConfigError(f"solver: '{solver}' is not installed; qpsolvers knows {qpsolvers.available_solvers}")
    name = f"qpsolvers {qpsolvers.__version__} {solver}"

    def outcome(status: str, reason: str, f: Array | None = None, residual: float = math.nan) -> Balance:
        f = np.full(3 * n, np.nan) if f is None else f
        return Balance(status, f, residual, reason, safety, min_normal, name, 0, time.perf_counter() - start)

    sides = _sides(safety * grasp_map.mus, edges)
    if n == 0:
        return outcome("infeasible", "there is no contact")
    F, holding = grasp_map.scaling * np.asarray(F_ext, dtype=float), grasp_map.holding
    if not holding.balanceable(F):
        return outcome("infeasible", UNBALANCEABLE)
    scale = max(norm(F), min_normal, 1e-9)
    null, at = holding.null, holding.of(F / scale)
    efforts, bound = effort_rows(A, limits / scale, null, at)
    rows = np.concatenate([sides @ null, efforts, -null[2::3]])
    right = np.concatenate([-sides @ at, bound, at[2::3] - min_normal / scale])
    problem = qpsolvers.Problem(np.eye(null.shape[1]), np.zeros(null.shape[1]), rows, right)
    solution = qpsolvers.solve_problem(problem, solver=solver)
    if not solution.found or solution.x is None:
        return outcome("infeasible", "no forces within the pyramids and effort limits balance the wrench")
    f = scale * (at + null @ solution.x)
    residual = norm(grasp_map.scaled @ f + F) / (norm(F) or 1.0)
    if residual > TOLERANCE:
        return outcome("failed", f"the solver left a residual of {residual:.1e}")
    return outcome("solved", "", f, residual)


def _sides(mus: Array, edges: int) -> Array:
    """Rows a with a . f <= 0 for forces in the pyramids, shape (n * edges, 3 n)."""
    if edges < 3:
        raise ConfigError(f"edges: a pyramid of {edges} edges has no interior; give at least 3")
    angle, i, n = 2.0 * np.pi * (np.arange(edges) + 0.5) / edges, np.arange(len(mus)), len(mus)
    sides = np.zeros((n, edges, n, 3))
    sides[i, :, i, :2] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    sides[i, :, i, 2] = -mus[:, None] * math.cos(math.pi / edges)
    return sides.reshape(n * edges, 3 * n)


def primitive_wrenches(grasp_map: GraspMap, edges: int) -> Array:
    """Wrenches of the edges of all pyramids, unit normal force, torques divided by the length, shape (n * edges, 6)."""
    n = grasp_map.contacts
    columns = grasp_map.scaled.reshape(6, n, 3)
    return np.einsum("aij,ijk->ika", columns, cone_edges(grasp_map.mus, edges)).reshape(n * edges, 6)


def epsilon_linearized(grasp_map: GraspMap, *, edges: int = 8) -> float:
    """The Ferrari-Canny quality (1992): radius of the largest ball in the hull of primitive wrenches.

    Args:
        grasp_map: The contacts.
        edges: Number of edges of a pyramid.

    Returns:
        The quality; 0 where the origin is not inside. It is at most the exact `ball_margin`.

    Raises:
        ConfigError: A pyramid has no interior.
    """
    wrenches = primitive_wrenches(grasp_map, edges)
    if len(wrenches) < 7 or np.linalg.matrix_rank(wrenches, tol=1e-9) < 6:
        return 0.0
    try:
        hull = ConvexHull(np.vstack([wrenches, np.zeros(6)]))
    except QhullError:
        return 0.0
    nearest = int(hull.equations[:, 6].argmax())
    radius = float(-hull.equations[nearest, 6])
    return 0.0 if radius <= 1e-12 or hull.simplices[nearest].max() == len(wrenches) else radius


def min_weight(grasp_map: GraspMap, *, edges: int = 4) -> float:
    """FRoGGeR's quality: the largest least weight of a convex combination of primitive wrenches that gives zero.

    maximise l  subject to  sum_j alpha_j w_j = 0,  sum_j alpha_j = 1,  alpha_j >= l

    (Li et al., FRoGGeR, 2023.) A linear program; positive exactly where the grasp closes by force, given that the
    primitive wrenches span. Between it and `epsilon_linearized` there are two-sided bounds.

    Args:
        grasp_map: The contacts.
        edges: Number of edges of a pyramid.

    Returns:
        l, at most 1 / (n edges); negative where no nonnegative combination gives zero, -inf where none at all does.

    Raises:
        ConfigError: A pyramid has no interior.
    """
    wrenches = primitive_wrenches(grasp_map, edges)
    m = len(wrenches)
    if m == 0:
        return -math.inf
    rows = np.zeros((7 + m, m + 1))
    rows[:6, :m] = wrenches.T
    rows[6, :m] = 1.0
    rows[7:, :m], rows[7:, m] = -np.eye(m), 1.0
    right = np.zeros(7 + m)
    right[6] = 1.0
    cones = [conic.ZeroConeT(7), conic.NonnegativeConeT(m)]
    q = np.append(np.zeros(m), -1.0)
    solution = conic_solution(csc_matrix((m + 1, m + 1)), q, csc_matrix(rows), right, cones)
    return float(np.asarray(solution.x)[-1]) if solver_status(solution) == "solved" else -math.inf
