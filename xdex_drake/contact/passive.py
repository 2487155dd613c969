"""The passive squeeze: forces that constant targets hold, and that hold the object when it is pushed.

A hand that holds constant targets does not choose new forces when something pushes its object: the forces change by the
law of `contact.stiffness`. So the squeeze is chosen for all pushes at once, by a convex program in the forces f0 that
press while nothing pushes:

    maximise s  subject to, for gravity F, pushes w_k and slips g_k of the contacts,
        G f0 + F = 0,   f0 in K,                                   balance
        C_s f0 in the range of [J, -G'],                           what targets can command
        f0 + s df_k - W g_k in K,   |g_ki| <= slip,                every push
        |tau| <= effort,   |tau - K_p dq_k| <= effort,             tau = A f0
        K_q(f0) >= eps_q I,   K_x(f0) >= eps_x I,                  stability

and then the least forces with a given part of that s. K are friction cones with a share of the friction.

*What targets can command.* Targets u and the object's motion x give f0 = C_s^-1 (J dq - G' x), whatever u: a hand whose
joints control four of nine force components cannot choose the other five; they are as the contacts' compliance has it.

*Slips.* With slip = 0 nothing slides, and s is the elastic margin. That is too strict for hands with few joints, whose
contacts are stiff in directions that no joint gives way in: there a push of a tenth of the weight is over the cone after
a micrometre, slides a micrometre more, and the forces have moved to the other contacts, where the grasp holds. So
contacts may slide up to `slip` in any direction, as in limit analysis (Melan's theorem: a structure that can hold a load
by some redistribution of its forces finds one): W g is the change of forces by slips,
W = C_s^-1 - C_s^-1 E H^-1 E' C_s^-1, E = [J, -G']. In soft directions slips of this size change nothing, and the law
of no sliding stands.

The geometric stiffness in df_k, W and K_x is that of the last round's forces; d K_x / d f is exact. K_q is linear in f0.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csc_matrix

from xdex_drake.contact.cones import cone_violation
from xdex_drake.contact.conic import STOPPED, cone_rows, conic, solve_conic, torque_scaling
from xdex_drake.contact.stiffness import GraspStiffness, response

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SqueezeSettings:
    """Demands on a passive squeeze.

    Attributes:
        friction: Share of the friction that forces may use, at rest and when pushed.
        least: Least normal force at each contact while nothing pushes [N].
        greatest: Greatest normal force at each contact while nothing pushes [N].
        slip: Distance that each contact may slide under each push [m].
        enough: Margin beyond which more force is not wanted: least forces reach this margin, or the greatest there is.
        part: Part of the greatest margin that least forces keep where it is below `enough`.
        joint_stiffness: Least eigenvalue of K_q, as a share of K_p.
        object_stiffness: Least eigenvalue of K_x, rotations divided by the object's length [N/m].
        rounds: Times that the geometric stiffness is taken anew.
        preload: Torque with which joints at a stop press on it beyond what the forces ask for [N m]: as long as a push
            takes away less, they do not give way at all.
    """

    friction: float = 0.9
    least: float = 0.5
    greatest: float = 6.0
    slip: float = 0.0
    enough: float = 1.5
    part: float = 0.95
    joint_stiffness: float = 0.1
    object_stiffness: float = 10.0
    rounds: int = 2
    preload: float = 0.1


@dataclass(frozen=True)
class PassiveSqueeze:
    """A squeeze by constant targets.

    Attributes:
        status: "solved", "infeasible" or "failed".
        f: Forces in contact frames while nothing pushes [N], shape (3 nc,).
        torques: Torques of all actuated joints that apply them [N m], shape (n,).
        margin: Greatest multiple of the pushes that is held with slips; see `SqueezeSettings.slip`.
        slips: Slips of the contacts along their tangents at each push, at `margin` [m], shape (k, nc, 2).
        elastic_margin: Greatest multiple of the pushes under which nothing slides at all.
        joint_eigenvalue: Least eigenvalue of K_q [N m/rad].
        object_eigenvalue: Least eigenvalue of K_x, rotations divided by the object's length [N/m].
        reason: Why there is none; empty where solved.
        seconds: Wall time.
    """

    status: str
    f: Array
    torques: Array
    margin: float
    slips: Array
    elastic_margin: float
    joint_eigenvalue: float
    object_eigenvalue: float
    reason: str
    seconds: float


@dataclass(frozen=True)
class Law:
    """How forces and joint torques answer to pushes and slips, at the geometric stiffness of some forces.

    Attributes:
        pushes: Change of forces by each push, shape (3 nc, k).
        slips: W, change of forces by a unit of each slip along a tangent, negative, shape (3 nc, 2 nc).
        torques_by_pushes: Change of the joints' torques by each push, shape (m, k).
        torques_by_slips: Change of the joints' torques by each slip, shape (m, 2 nc).
    """

    pushes: Array
    slips: Array
    torques_by_pushes: Array
    torques_by_slips: Array


def linear_law(stiffness: GraspStiffness, f: Array, wrenches: Array) -> Law:
    """The linear law at forces f; wrenches of shape (k, 6), torque first."""
    m, nc = len(stiffness.kp), len(f) // 3
    pushed = response(stiffness, f, wrenches)
    E = np.concatenate([stiffness.J, -stiffness.G.T], axis=1)
    springs = E / stiffness.compliance[:, None]
    tangents = (3 * np.arange(nc)[:, None] + np.arange(2)).ravel()
    z = np.linalg.solve(stiffness.hessian(f), springs[tangents].T)
    W = springs @ z
    W[tangents, np.arange(2 * nc)] -= 1.0 / stiffness.compliance[tangents]
    kp = stiffness.kp[:, None]
    return Law(pushed.df, W, -kp * pushed.dq, -kp * z[:m])


@dataclass(frozen=True)
class Reach:
    """Forces that balance gravity and that targets can command: at + basis y.

    Attributes:
        at: The least of them [N], shape (3 nc,).
        basis: Orthonormal directions, shape (3 nc, d).
        residual: Norm of what no such forces balance, torques divided by length, divided by gravity's.
    """

    at: Array
    basis: Array
    residual: float


def reachable_forces(stiffness: GraspStiffness, F_gravity: Array, length: float) -> Reach:
    """The forces with balance that targets can command; see the docstring of this module."""
    scaling = torque_scaling(length)
    G, F = scaling[:, None] * stiffness.G, scaling * F_gravity
    C = stiffness.compliance / stiffness.compliance.mean()
    moved = np.concatenate([stiffness.J / length, stiffness.G.T * (1.0 / scaling)], axis=1) / np.sqrt(C)[:, None]
    U, sigma, _ = np.linalg.svd(moved)
    rank = int(np.count_nonzero(sigma > 1e-6 * sigma[0]))
    rows = np.concatenate([G, U[:, rank:].T * np.sqrt(C)])
    right = np.concatenate([-F, np.zeros(len(rows) - 6)])
    U, sigma, Vt = np.linalg.svd(rows)
    rank = int(np.count_nonzero(sigma > 1e-6 * sigma[0]))
    at = Vt[:rank].T @ ((U[:, :rank].T @ right) / sigma[:rank])
    return Reach(at, Vt[rank:].T, float(np.linalg.norm(rows @ at - right) / np.linalg.norm(F)))


def elastic_margin(f: Array, df: Array, mus: Array, cap: float = 100.0) -> float:
    """Greatest s with f + s df in the friction cones for every column of df, at most `cap`; in closed form.

    Args:
        f: Forces in the cones, shape (3 nc,).
        df: Changes of the forces, shape (3 nc, k).
        mus: Coefficients of friction, shape (nc,).
        cap: Greatest margin that is reported.

    Returns:
        The margin, 0 where f is not in the cones.
    """
    F, D, mu = f.reshape(-1, 3), df.T.reshape(-1, len(mus), 3), mus
    if float(cone_violation(F, mu).max()) > 1e-9 * float(np.abs(F).max()):
        return 0.0
    # |t + s d|^2 = mu^2 (n + s e)^2 at the border; n + s e stays positive up to the first root.
    a = (D[..., :2] ** 2).sum(-1) - mu**2 * D[..., 2] ** 2
    b = (F[:, :2] * D[..., :2]).sum(-1) - mu**2 * F[:, 2] * D[..., 2]
    c = np.minimum((F[:, :2] ** 2).sum(-1) - mu**2 * F[:, 2] ** 2, 0.0)
    inside = b * b - a * c
    ahead = b + np.sqrt(np.maximum(inside, 0.0))
    # The first positive root, as c <= 0; none where the cone is never left.
    first = np.where((inside >= 0.0) & (ahead > 1e-300), -c / np.maximum(ahead, 1e-300), cap)
    return float(min(cap, first.min(initial=cap)))


def passive_squeeze(
    stiffness: GraspStiffness,
    mu: ArrayLike,
    F_gravity: ArrayLike,
    wrenches: ArrayLike,
    start: ArrayLike,
    *,
    A: Array,
    effort: Array,
    length: float,
    at_stop: NDArray[np.int64] | None = None,
    settings: SqueezeSettings = SqueezeSettings(),
) -> PassiveSqueeze:
    """The squeeze that holds the greatest multiple of some pushes with constant targets, and the least forces for it.

    Args:
        stiffness: The grasp's stiffness.
        mu: Coefficient of friction, one or nc.
        F_gravity: Wrench that is always there, torque first, shape (6,).
        wrenches: Pushes, shape (k, 6), for example `push_wrenches(mass)`.
        start: Forces that the first round's geometric stiffness is taken from [N], shape (3 nc,).
        A: Map of contact forces to actuated joint torques, `contact.effort_map`, shape (n, 3 nc).
        effort: Limits of the torques [N m or N], shape (n,).
        length: Length that divides torques [m].
        at_stop: Which joints are at an upper (1) or lower (-1) stop and left out of `stiffness`; none where None.
        settings: Demands.

    Returns:
        The squeeze, or the reason why there is none.
    """
    begin = time.perf_counter()
    f = np.asarray(start, dtype=float)
    nc = len(f) // 3
    mus = np.full(nc, 1.0) * np.asarray(mu, dtype=float)
    F, D = np.asarray(F_gravity, dtype=float), np.atleast_2d(np.asarray(wrenches, dtype=float))
    reach = reachable_forces(stiffness, F, length)
    if reach.residual > 1e-6:
        return _nothing("infeasible", "no forces that the joints command balance gravity", f, len(A), begin)
    side = np.zeros(len(A)) if at_stop is None else np.asarray(at_stop, dtype=float)
    margin, slips, law = 0.0, np.zeros((len(D), nc, 2)), None
    for _ in range(settings.rounds):
        law = linear_law(stiffness, f, D)
        status, x, margin = _round(stiffness, reach, law, f, mus, A, side, effort, length, settings)
        if status != "solved":
            reason = STOPPED if status == "failed" else "no forces within friction and stiffness hold gravity"
            return _nothing(status, reason, f, len(A), begin)
        d = reach.basis.shape[1]
        f = reach.at + reach.basis @ x[:d]
        slips = x[d + 1 :].reshape(len(D), nc, 2) if settings.slip > 0.0 else slips
    squeeze = assess(stiffness, f, mus, D, A=A, length=length, margin=margin, slips=slips, begin=begin)
    torques = np.clip(squeeze.torques + settings.preload * side, -effort, effort)
    return replace(squeeze, torques=torques, seconds=time.perf_counter() - begin)


def _round(
    stiffness: GraspStiffness,
    reach: Reach,
    law: Law,
    f: Array,
    mus: Array,
    A: Array,
    side: Array,
    effort: Array,
    length: float,
    settings: SqueezeSettings,
) -> tuple[str, Array, float]:
    """One round: status, variables (y, s, slips) with slips in metres, and the margin that least forces keep."""
    nc, k = len(mus), law.pushes.shape[1]
    d = reach.basis.shape[1]
    slides = 2 * nc * k if settings.slip > 0.0 else 0
    size = d + 1 + slides
    shared = settings.friction * mus
    # Rows (matrix, right-hand side) of what is at least zero, then of what is in second-order cones, then in PSD cones.
    least = [np.zeros((1, size)), np.zeros((2 * nc, size))]
    least[0][0, d] = -1.0
    normal = reach.basis[2::3]
    least[1][:nc, :d], least[1][nc:, :d] = -normal, normal
    right = [np.zeros(1), np.concatenate([reach.at[2::3] - settings.least, settings.greatest - reach.at[2::3]])]
    cones = [_padded(-cone_rows(shared, reach.basis), size)]
    bounds = [cone_rows(shared, reach.at)]
    held = np.flatnonzero(side)
    for j in range(k):
        M = np.zeros((3 * nc, size))
        M[:, :d], M[:, d] = reach.basis, law.pushes[:, j]
        if slides:
            M[:, d + 1 + 2 * nc * j : d + 1 + 2 * nc * (j + 1)] = settings.slip * law.slips
        cones.append(-cone_rows(shared, M))
        bounds.append(bounds[0])
        if len(held):
            M[:, :d] = 0.0
            least.append(side[held, None] * (A[held] @ M) / settings.preload)
            right.append(np.ones(len(held)))
    if slides:
        M = np.zeros((3 * nc * k, size))
        rows = 3 * np.arange(nc * k)[:, None] + np.array([1, 2])
        M[rows.ravel(), d + 1 + np.arange(slides)] = -1.0
        cones.append(M)
        bounds.append(np.tile([1.0, 0.0, 0.0], nc * k))
    stable, at, sizes = _stability_rows(stiffness, reach, f, length, settings)
    linear = sum(len(block) for block in right)
    rows_all = np.concatenate([*least, *cones, _padded(stable, size)])
    right_all = np.concatenate([*right, *bounds, at])
    members = _cones(linear, (len(rows_all) - linear - len(at)) // 3, sizes)
    P = np.zeros(size)
    P[:d], P[d + 1 :] = 1e-7, 1e-7
    q = np.zeros(size)
    q[d] = -1.0
    # Greatest margin, but not beyond what is enough.
    top, bound = np.zeros((1, size)), np.array([settings.enough])
    top[0, d] = 1.0
    status, x = _solve(P, q, np.concatenate([top, rows_all]), np.concatenate([bound, right_all]), linear + 1, members)
    if status != "solved":
        return status, x, 0.0
    margin = min(settings.enough, settings.part * max(0.0, float(x[d])))
    if x[d] > settings.enough - 1e-4:
        margin = settings.enough - 1e-4
    P[:d], P[d + 1 :], q[d] = 1.0, 1e-4, 0.0
    right_all[0] = -margin
    status, better = _solve(P, q, rows_all, right_all, linear, members)
    x = better if status == "solved" else x
    x[d + 1 :] *= settings.slip
    return "solved", x, margin


def _padded(rows: Array, size: int) -> Array:
    """Rows with zeros for the variables that they do not speak of."""
    return np.concatenate([rows, np.zeros((len(rows), size - rows.shape[1]))], axis=1)


def _solve(P: Array, q: Array, rows: Array, right: Array, linear: int, members: tuple[Any, ...]) -> tuple[str, Array]:
    """Solves with diagonal cost P; `linear` counts the rows of the first cone."""
    cost = csc_matrix((P, (np.arange(len(P)), np.arange(len(P)))), shape=(len(P), len(P)))
    cones = [conic.NonnegativeConeT(linear), *members[1:]]
    status, x, _ = solve_conic(cost, q, csc_matrix(rows), right, cones, 1e-7)
    return status, np.array(x)


@lru_cache(maxsize=64)
def _cones(linear: int, second: int, sizes: tuple[int, ...]) -> tuple[Any, ...]:
    return (
        conic.NonnegativeConeT(linear),
        *(conic.SecondOrderConeT(3) for _ in range(second)),
        *(conic.PSDTriangleConeT(size) for size in sizes),
    )


def _stability_rows(
    stiffness: GraspStiffness, reach: Reach, f: Array, length: float, settings: SqueezeSettings
) -> tuple[Array, Array, tuple[int, ...]]:
    """Rows, right-hand side and sizes of K_q(f0) >= eps and K_x(f0) >= eps, block by block, divided by their scale."""
    rows, right, sizes = [], [], []
    K, scale = stiffness.joint_stiffness(reach.at), float(stiffness.kp.max(initial=1.0))
    slopes = np.tensordot(reach.basis.T, stiffness.slopes, 1)
    for block in _blocks(stiffness.slopes):
        inside = np.ix_(block, block)
        K_block = K[inside] / scale - settings.joint_stiffness * np.eye(len(block))
        rows.append(-_svec(slopes[:, *inside] / scale).T)
        right.append(_svec(K_block))
        sizes.append(len(block))
    H, m = stiffness.hessian(f), len(stiffness.kp)
    down = np.concatenate([-np.linalg.solve(H[:m, :m], H[:m, m:]), np.eye(6)]) * np.array(
        [1.0 / length] * 3 + [1.0] * 3
    )
    K_x = down.T @ H @ down
    slope = down.T @ stiffness.geometric @ down
    K_x = K_x + np.tensordot(reach.at - f, slope, 1)
    slope = np.tensordot(reach.basis.T, slope, 1)
    scale = 100.0
    rows.append(-_svec(slope / scale).T)
    right.append(_svec((K_x - settings.object_stiffness * np.eye(6)) / scale))
    sizes.append(6)
    return np.concatenate(rows), np.concatenate(right), tuple(sizes)


def _blocks(slopes: Array) -> list[NDArray[np.int64]]:
    """Joints that share a block of d(J' f)/dq: those of one finger."""
    from scipy.sparse.csgraph import connected_components

    joined = np.abs(slopes).max(axis=0) > 1e-12
    _, labels = connected_components(joined, directed=False)
    return [np.flatnonzero(labels == label) for label in range(labels.max(initial=-1) + 1)]


def _svec(M: Array) -> Array:
    """Upper triangles, column after column, of symmetric matrices, off-diagonals times sqrt 2, shape (..., n(n+1)/2)."""
    columns, rows = np.tril_indices(M.shape[-1])
    M = 0.5 * (M + np.swapaxes(M, -1, -2))
    return M[..., rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0))


def assess(
    stiffness: GraspStiffness,
    f: Array,
    mus: Array,
    wrenches: Array,
    *,
    A: Array,
    length: float,
    margin: float,
    slips: Array,
    begin: float,
) -> PassiveSqueeze:
    """What forces are worth."""
    law = linear_law(stiffness, f, wrenches)
    scaling = 1.0 / np.array([length] * 3 + [1.0] * 3)
    K_x = scaling[:, None] * stiffness.object_stiffness(f) * scaling
    return PassiveSqueeze(
        "solved",
        f,
        A @ f,
        margin,
        slips,
        elastic_margin(f, law.pushes, mus),
        float(np.linalg.eigvalsh(stiffness.joint_stiffness(f)).min(initial=np.inf)),
        float(np.linalg.eigvalsh(0.5 * (K_x + K_x.T)).min()),
        "",
        time.perf_counter() - begin,
    )


def _nothing(status: str, reason: str, f: Array, n: int, begin: float) -> PassiveSqueeze:
    nan = float("nan")
    return PassiveSqueeze(
        status,
        np.full(len(f), nan),
        np.full(n, nan),
        0.0,
        np.zeros((0, len(f) // 3, 2)),
        0.0,
        nan,
        nan,
        reason,
        time.perf_counter() - begin,
    )
