"""The passive squeeze: forces that constant targets hold, and that hold the object when it is pushed.

A hand that holds constant targets does not choose new forces when something pushes its object: the forces change by the
law of `contact.stiffness`. So the squeeze is chosen for all pushes at once, by a convex program in the forces f0 that
press while nothing pushes. With gravity F, pushes w_k, slips g_k of the contacts and friction cones K it is

    maximise worth s - 1/2 |f0|^2  subject to
        G f0 + F = 0,  f0 in K,  C_s f0 in the range of [J, -G'],       at rest
        f0 + s df_k - W g_k in K,  |g_ki| <= slip,                      at every push
        |tau| <= effort,  |tau - K_p dq_k| <= effort,  tau = A f0,      within the hand's means
        K_q(f0) >= eps_q I,  K_x(f0) >= eps_x I,                        stable

so that a hand presses more where that makes it hold more: the greatest s first and then the least forces that keep .95
of it take twice as long, and give forces that are foretold to hold as well.

*What targets can command.* Targets u and the object's motion x give f0 = C_s^-1 (J dq - G' x), whatever u: a hand whose
joints control four of nine force components cannot choose the other five; they are as the contacts' compliance has it.

*Slips.* With slip = 0 nothing slides, and s is the elastic margin. That is too strict for hands with few joints, whose
contacts are stiff where no joint gives way: a push of a tenth of the weight leaves the cone there, the contact slides a
micrometre, and the forces have moved to others, which hold. So contacts may slide up to `slip`, in any direction, as in
limit analysis: by Melan's theorem a structure that can hold a load by some redistribution of its forces finds one, if
its friction is associated, which Coulomb's is only nearly where fingers are soft. -W g is what slips change,
W = C_s^-1 - C_s^-1 E H^-1 E' C_s^-1 with E = [J, -G']. In soft directions slips of this size change nothing.

*Stops.* A joint that presses on a stop with `preload` more than the forces ask for does not give way until a push takes
that away; it is left out of the stiffness, and pushes may take no more.

The geometric stiffness in df_k and W is that of the last round's forces, and so is the point where K_x is linearised;
its derivative is exact. K_q is linear in f0.

Sources: Hanafusa and Asada (1977), Cutkosky and Kao (1989), Howard and Kumar (1996), as in `contact.stiffness`; Bicchi,
On the problem of decomposing grasp and manipulation forces in multiple whole-limb manipulation, Robotics and Autonomous
Systems 13, 1994, for the forces that joints command; Prattichizzo and Trinkle (2016), section 38.4.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import cone_violation
from xdex_drake.contact.conic import STOPPED, cone_rows, conic, diagonal, solve_conic, torque_scaling
from xdex_drake.contact.grasp_map import Effort, GraspMap
from xdex_drake.contact.stiffness import GraspStiffness, response

STIFF = 100.0
"""Unit of stiffnesses in the program [N/m]."""


@dataclass(frozen=True)
class SqueezeSettings:
    """Demands on a passive squeeze.

    Attributes:
        friction: Share of the friction that forces may use, at rest and when pushed.
        least: Least normal force at each contact while nothing pushes [N].
        greatest: Greatest normal force at each contact while nothing pushes [N].
        slip: Distance that each contact may slide under each push [m].
        enough: Margin beyond which more force is not wanted.
        worth: What a unit of margin is worth in forces, as half of their square [N^2].
        joint_stiffness: Least eigenvalue of K_q, as a share of K_p.
        object_stiffness: Least eigenvalue of K_x, rotations divided by the object's length [N/m].
        preload: Torque with which joints at a stop press on it beyond what the forces ask for [N m].
        rounds: Times that the geometric stiffness is taken anew; more than one changes little of what is foretold.
    """

    friction: float = 0.8
    least: float = 0.5
    greatest: float = 10.0
    slip: float = 1e-3
    enough: float = 3.0
    worth: float = 100.0
    joint_stiffness: float = 0.25
    object_stiffness: float = 30.0
    preload: float = 0.2
    rounds: int = 1


@dataclass(frozen=True)
class Loads:
    """What a grasp has to do.

    Attributes:
        map: Grasp matrix, friction and length.
        effort: The hand's efforts.
        gravity: Wrench that is always there, torque first, shape (6,).
        pushes: Wrenches w_k, shape (k, 6), for example `push_wrenches(mass)`.
        at_stop: Which actuated joints press on an upper (1) or lower (-1) stop and are left out of the stiffness,
            shape (n,).
    """

    map: GraspMap
    effort: Effort
    gravity: Array
    pushes: Array
    at_stop: NDArray[np.int64]


@dataclass(frozen=True)
class PassiveSqueeze:
    """A squeeze by constant targets.

    Attributes:
        status: "solved", "infeasible" or "failed".
        f: Forces in contact frames while nothing pushes [N], shape (3 nc,).
        torques: Torques of all actuated joints that apply them [N m or N], shape (n,).
        margin: Multiple of the pushes that is held by some slips; see the docstring of this module.
        slips: Such slips of the contacts along their tangents at each push [m], shape (k, nc, 2).
        elastic_margin: Greatest multiple of the pushes under which nothing slides at all, with all of the friction.
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
    """How forces and the torques of the joints of a stiffness answer, at the geometric stiffness of some forces.

    Attributes:
        pushes: Change of forces by each push [N], shape (3 nc, k).
        slips: Change of forces by a unit of each slip along a tangent, -W [N/m], shape (3 nc, 2 nc).
        torques: Change of torques by each push [N m], shape (m, k).
        torques_of_slips: Change of torques by a unit of each slip, shape (m, 2 nc).
    """

    pushes: Array
    slips: Array
    torques: Array
    torques_of_slips: Array


def linear_law(stiffness: GraspStiffness, f: Array, pushes: Array) -> Law:
    """The linear law at forces f.

    Args:
        stiffness: The grasp's stiffness.
        f: Forces whose geometric stiffness is taken, shape (3 nc,).
        pushes: Wrenches, torque first, shape (k, 6).

    Returns:
        The law.
    """
    m, nc = len(stiffness.kp), len(f) // 3
    pushed = response(stiffness, f, pushes)
    springs = np.concatenate([stiffness.J, -stiffness.G.T], axis=1) / stiffness.compliance[:, None]
    tangents = (3 * np.arange(nc)[:, None] + np.arange(2)).ravel()
    z = np.linalg.solve(stiffness.hessian(f), springs[tangents].T)
    slips = springs @ z
    slips[tangents, np.arange(2 * nc)] -= 1.0 / stiffness.compliance[tangents]
    kp = stiffness.kp[:, None]
    return Law(pushed.df, slips, -kp * pushed.dq, -kp * z[:m])


@dataclass(frozen=True)
class Reach:
    """Forces that balance gravity and that targets can command: at + basis y.

    Attributes:
        at: The least of them [N], shape (3 nc,).
        basis: Orthonormal directions, shape (3 nc, d).
        residual: Norm of what no such forces balance, torques divided by length, divided by gravity's.
        rows: Rows that are zero for such changes of forces, shape (r, 3 nc).
    """

    at: Array
    basis: Array
    residual: float
    rows: Array


def reachable_forces(stiffness: GraspStiffness, gravity: Array, length: float) -> Reach:
    """The forces that balance gravity and that targets can command; see the docstring of this module.

    Args:
        stiffness: The grasp's stiffness.
        gravity: Wrench that is always there, torque first, shape (6,).
        length: Length that divides torques [m].

    Returns:
        The forces.
    """
    scaling = torque_scaling(length)
    F = scaling * gravity
    root = np.sqrt(stiffness.compliance / stiffness.compliance.mean())[:, None]
    moves = np.concatenate([stiffness.J / length, stiffness.G.T * scaling], axis=1) / root
    U, sigma, _ = np.linalg.svd(moves)
    rank = int(np.count_nonzero(sigma > 1e-6 * sigma[0]))
    rows = np.concatenate([scaling[:, None] * stiffness.G, U[:, rank:].T * root.T])
    right = np.concatenate([-F, np.zeros(len(rows) - 6)])
    U, sigma, Vt = np.linalg.svd(rows)
    rank = int(np.count_nonzero(sigma > 1e-6 * sigma[0]))
    at = Vt[:rank].T @ ((U[:, :rank].T @ right) / sigma[:rank])
    residual = float(np.linalg.norm(rows @ at - right) / np.linalg.norm(F))
    return Reach(at, Vt[rank:].T, residual, rows)


def elastic_margin(f: Array, df: Array, mus: Array, cap: float = 100.0) -> float:
    """Greatest s with f + s df in the friction cones for every column of df, in closed form.

    Args:
        f: Forces in the cones, shape (3 nc,).
        df: Changes of the forces, shape (3 nc, k).
        mus: Coefficients of friction, shape (nc,).
        cap: Greatest margin that is reported.

    Returns:
        The margin, 0 where f is not in the cones.
    """
    F, D = f.reshape(-1, 3), df.T.reshape(-1, len(mus), 3)
    if float(cone_violation(F, mus).max()) > 1e-6 * float(np.abs(F).max()):
        return 0.0
    # At the border |t + s d|^2 = mu^2 (n + s e)^2: a s^2 + 2 b s + c = 0 with c <= 0.
    a = (D[..., :2] ** 2).sum(-1) - mus**2 * D[..., 2] ** 2
    b = (F[:, :2] * D[..., :2]).sum(-1) - mus**2 * F[:, 2] * D[..., 2]
    c = np.minimum((F[:, :2] ** 2).sum(-1) - mus**2 * F[:, 2] ** 2, 0.0)
    inside = b * b - a * c
    ahead = b + np.sqrt(np.maximum(inside, 0.0))
    first = np.where((inside >= 0.0) & (ahead > 1e-300), -c / np.maximum(ahead, 1e-300), cap)
    return float(min(cap, first.min(initial=cap)))


def passive_squeeze(
    stiffness: GraspStiffness, loads: Loads, start: Array, settings: SqueezeSettings | None = None
) -> PassiveSqueeze:
    """The squeeze that holds the greatest multiple of some pushes with constant targets, for the forces that it takes.

    Args:
        stiffness: The grasp's stiffness.
        loads: What the grasp has to do.
        start: Forces that the first round's geometric stiffness is taken from [N], shape (3 nc,).
        settings: Demands; the defaults where None.

    Returns:
        The squeeze, or the reason why there is none.
    """
    begin, settings = time.perf_counter(), settings or SqueezeSettings()
    f, nc, k = np.asarray(start, dtype=float), loads.map.contacts, len(loads.pushes)
    reach = reachable_forces(stiffness, loads.gravity, loads.map.length)
    if reach.residual > 1e-6:
        return _nothing("infeasible", "no forces that the joints command balance gravity", f, loads, begin)
    d, margin, slips = reach.basis.shape[1], 0.0, np.zeros((k, nc, 2))
    for _ in range(settings.rounds):
        law = linear_law(stiffness, f, loads.pushes)
        status, x, margin = _round(_Round(stiffness, loads, reach, law, f, settings))
        if status != "solved":
            reason = STOPPED if status == "failed" else "no forces within friction, efforts and stiffness hold gravity"
            return _nothing(status, reason, f, loads, begin)
        f = reach.at + reach.basis @ x[:d]
        if settings.slip > 0.0:
            slips = settings.slip * x[d + 1 :].reshape(k, nc, 2)
    return replace(assessed(stiffness, loads, f, margin, slips, settings), seconds=time.perf_counter() - begin)


@dataclass(frozen=True)
class _Round:
    """What one round's program is made of; its variables are x = (y, s, slips in units of `settings.slip`)."""

    stiffness: GraspStiffness
    loads: Loads
    reach: Reach
    law: Law
    f: Array
    settings: SqueezeSettings

    @property
    def d(self) -> int:
        """Number of variables y; that of s is the same."""
        return self.reach.basis.shape[1]

    @property
    def size(self) -> int:
        """Number of variables."""
        slips = 2 * self.loads.map.contacts * len(self.loads.pushes) if self.settings.slip > 0.0 else 0
        return self.d + 1 + slips

    def at_push(self, j: int, rest: Array, push: Array, slips: Array) -> Array:
        """Rows of what is `rest` y + `push` s + `slips` g_j, shape (r, size)."""
        M = np.zeros((len(rest), self.size))
        M[:, : self.d], M[:, self.d] = rest, push
        if self.settings.slip > 0.0:
            width = slips.shape[1]
            M[:, self.d + 1 + width * j : self.d + 1 + width * (j + 1)] = self.settings.slip * slips
        return M


def _round(program: _Round) -> tuple[str, Array, float]:
    """Status, variables x, and the margin."""
    d = program.d
    P, q = np.full(program.size, 1e-4), np.zeros(program.size)
    P[:d], P[d], q[d] = 1.0, 0.0, -program.settings.worth
    cones, stable = _cone_rows(program), _stability_rows(program)
    joints = np.zeros(0, dtype=np.int64)
    while True:  # efforts seldom bind: their rows are added where they are violated
        status, x = _solve(P, q, _linear_rows(program, joints), cones, stable)
        if status != "solved":
            return status, x, 0.0
        beyond = np.setdiff1d(_over_effort(program, x), joints)
        if not len(beyond):
            return "solved", x, max(0.0, float(x[d]))
        joints = np.concatenate([joints, beyond])


def _linear_rows(program: _Round, joints: NDArray[np.int64]) -> tuple[Array, Array]:
    """Rows M and right-hand sides b of M x <= b: s from 0 to enough, normal forces, stops, efforts of some joints."""
    reach, settings, loads, d = program.reach, program.settings, program.loads, program.d
    normal, pressing = reach.basis[2::3], reach.at[2::3]
    M = np.zeros((2 + 2 * len(normal), program.size))
    M[0, d], M[1, d] = -1.0, 1.0
    M[2 : 2 + len(normal), :d], M[2 + len(normal) :, :d] = -normal, normal
    b = np.concatenate([[0.0, settings.enough], pressing - settings.least, settings.greatest - pressing])
    rows, right = [M], [b]
    held = np.flatnonzero(loads.at_stop)
    if len(held):
        toward = loads.at_stop[held, None] * loads.effort.A[held] / settings.preload
        for j in range(len(loads.pushes)):
            rows.append(
                program.at_push(
                    j, np.zeros((len(held), d)), toward @ program.law.pushes[:, j], toward @ program.law.slips
                )
            )
            right.append(np.ones(len(held)))
    if len(joints):
        for M, at in _torque_rows(program, joints):
            rows += [M, -M]
            right += [loads.effort.limits[joints] - at, loads.effort.limits[joints] + at]
    return np.concatenate(rows), np.concatenate(right)


def _torque_rows(program: _Round, joints: NDArray[np.int64]) -> list[tuple[Array, Array]]:
    """Torques M x + at that some actuated joints are driven with, at rest and at each push."""
    loads, law, reach = program.loads, program.law, program.reach
    n, nc = len(loads.effort.A), loads.map.contacts
    pushed, slid = np.zeros((n, len(loads.pushes))), np.zeros((n, 2 * nc))
    pushed[program.stiffness.joints], slid[program.stiffness.joints] = law.torques, law.torques_of_slips
    A = loads.effort.A[joints]
    rest, at = A @ reach.basis, A @ reach.at + program.settings.preload * loads.at_stop[joints]
    still = program.at_push(0, rest, np.zeros(len(joints)), np.zeros((len(joints), 2 * nc)))
    pushes = [program.at_push(j, rest, pushed[joints, j], slid[joints]) for j in range(len(loads.pushes))]
    return [(M, at) for M in [still, *pushes]]


def _over_effort(program: _Round, x: Array) -> NDArray[np.int64]:
    """Actuated joints that a solution drives beyond their efforts."""
    joints = np.flatnonzero(np.isfinite(program.loads.effort.limits))
    limits = program.loads.effort.limits[joints] * (1.0 + 1e-6) + 1e-9
    over = [np.abs(M @ x + at) > limits for M, at in _torque_rows(program, joints)]
    return joints[np.any(over, axis=0)]


def _cone_rows(program: _Round) -> tuple[Array, Array]:
    """Rows M and right-hand sides b with b - M x in second-order cones of three: forces at rest, at pushes, slips."""
    reach, settings, nc = program.reach, program.settings, program.loads.map.contacts
    shared = settings.friction * program.loads.map.mus
    at = cone_rows(shared, reach.at)
    no_slips = np.zeros((3 * nc, 2 * nc))
    forces = [program.at_push(0, reach.basis, np.zeros(3 * nc), no_slips)]
    k = len(program.loads.pushes)
    forces += [program.at_push(j, reach.basis, program.law.pushes[:, j], program.law.slips) for j in range(k)]
    rows, right = [-cone_rows(shared, M) for M in forces], [at] * (k + 1)
    if settings.slip > 0.0:
        M = np.zeros((3 * nc * k, program.size))
        sliding = (3 * np.arange(nc * k)[:, None] + np.array([1, 2])).ravel()
        M[sliding, program.d + 1 + np.arange(len(sliding))] = -1.0
        rows.append(M)
        right.append(np.tile([1.0, 0.0, 0.0], nc * k))
    return np.concatenate(rows), np.concatenate(right)


def _stability_rows(program: _Round) -> tuple[Array, Array, tuple[int, ...]]:
    """Rows, right-hand sides and sizes of K_q(f0) >= eps and K_x(f0) >= eps, block by block, divided by their units."""
    stiffness, reach, f, settings = program.stiffness, program.reach, program.f, program.settings
    blocks, rows, right = joint_blocks(stiffness), [], []
    unit = float(stiffness.kp.max(initial=1.0))
    K_q, slopes = stiffness.joint_stiffness(reach.at) / unit, np.tensordot(reach.basis.T, stiffness.slopes, 1) / unit
    for block in blocks:
        rows.append(-_triangle(slopes[:, block[:, None], block]).T)
        right.append(_triangle(K_q[np.ix_(block, block)] - settings.joint_stiffness * np.eye(len(block))))
    H, m = stiffness.hessian(f), len(stiffness.kp)
    # d K_x / d f = down' (d H / d f) down: how joints follow the object does not matter to first order.
    down = np.concatenate([-np.linalg.solve(H[:m, :m], H[:m, m:]), np.eye(6)]) * torque_scaling(
        program.loads.map.length
    )
    slopes = down.T @ stiffness.geometric @ down / STIFF
    K_x = down.T @ H @ down / STIFF + np.tensordot(reach.at - f, slopes, 1)
    rows.append(-_triangle(np.tensordot(reach.basis.T, slopes, 1)).T)
    right.append(_triangle(K_x - settings.object_stiffness / STIFF * np.eye(6)))
    M = np.concatenate(rows)
    padded = np.concatenate([M, np.zeros((len(M), program.size - program.d))], axis=1)
    return padded, np.concatenate(right), (*(len(block) for block in blocks), 6)


def joint_blocks(stiffness: GraspStiffness) -> list[NDArray[np.int64]]:
    """Joints that K_q couples, those of one finger, as indices into `stiffness.joints`."""
    joined = (np.abs(stiffness.slopes).max(axis=0, initial=0.0) > 1e-12) | np.eye(len(stiffness.kp), dtype=bool)
    while not np.array_equal(joined, further := joined @ joined):
        joined = further
    first = joined.argmax(axis=1)
    return [np.flatnonzero(first == joint) for joint in np.unique(first)]


def _triangle(M: Array) -> Array:
    """Upper triangles of symmetric matrices, column by column, off-diagonals times sqrt 2, as Clarabel has them."""
    columns, rows, factors = _lower(M.shape[-1])
    M = 0.5 * (M + np.swapaxes(M, -1, -2))
    return M[..., rows, columns] * factors


@lru_cache(maxsize=32)
def _lower(size: int) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Rows and columns of a lower triangle, row by row, and the factors of `_triangle`."""
    rows, columns = np.tril_indices(size)
    return rows, columns, np.where(rows == columns, 1.0, np.sqrt(2.0))


def _solve(
    P: Array,
    q: Array,
    linear: tuple[Array, Array],
    cones: tuple[Array, Array],
    stable: tuple[Array, Array, tuple[int, ...]],
) -> tuple[str, Array]:
    """Status and solution of a program with diagonal cost."""
    rows = _sparse(np.concatenate([linear[0], cones[0], stable[0]]))
    right = np.concatenate([linear[1], cones[1], stable[1]])
    members = _members(len(linear[1]), len(cones[1]) // 3, stable[2])
    status, x, _ = solve_conic(diagonal(P), q, rows, right, list(members), 1e-7)
    return status, np.array(x)


def _sparse(M: Array) -> csc_matrix:
    """A matrix without its zeros; `csc_matrix(M)` takes four times as long."""
    columns, rows = np.nonzero(M.T)
    starts = np.searchsorted(columns, np.arange(M.shape[1] + 1))
    return csc_matrix((M[rows, columns], rows, starts), shape=M.shape)


@lru_cache(maxsize=64)
def _members(linear: int, second: int, sizes: tuple[int, ...]) -> tuple[Any, ...]:
    return (
        conic.NonnegativeConeT(linear),
        *(conic.SecondOrderConeT(3) for _ in range(second)),
        *(conic.PSDTriangleConeT(size) for size in sizes),
    )


def assessed(
    stiffness: GraspStiffness, loads: Loads, f: Array, margin: float, slips: Array, settings: SqueezeSettings
) -> PassiveSqueeze:
    """What given forces are worth as a squeeze.

    Args:
        stiffness: The grasp's stiffness.
        loads: What the grasp has to do.
        f: Forces while nothing pushes [N], shape (3 nc,).
        margin: Multiple of the pushes that the slips are for.
        slips: Slips at each push [m], shape (k, nc, 2).
        settings: Demands, for the preload.

    Returns:
        The squeeze, as solved in no time.
    """
    scaling = torque_scaling(loads.map.length)
    K_x = scaling[:, None] * stiffness.object_stiffness(f) * scaling
    torques = loads.effort.A @ f + settings.preload * loads.at_stop
    return PassiveSqueeze(
        status="solved",
        f=f,
        torques=np.clip(torques, -loads.effort.limits, loads.effort.limits),
        margin=margin,
        slips=slips,
        elastic_margin=elastic_margin(f, response(stiffness, f, loads.pushes).df, loads.map.mus),
        joint_eigenvalue=float(np.linalg.eigvalsh(stiffness.joint_stiffness(f)).min(initial=np.inf)),
        object_eigenvalue=float(np.linalg.eigvalsh(0.5 * (K_x + K_x.T)).min()),
        reason="",
        seconds=0.0,
    )


def _nothing(status: str, reason: str, f: Array, loads: Loads, begin: float) -> PassiveSqueeze:
    nan, n = float("nan"), len(loads.effort.A)
    slips, seconds = np.zeros((0, len(f) // 3, 2)), time.perf_counter() - begin
    return PassiveSqueeze(status, np.full(len(f), nan), np.full(n, nan), 0.0, slips, 0.0, nan, nan, reason, seconds)


@dataclass(frozen=True)
class SqueezeResiduals:
    """What remains unproved of a passive squeeze; see `check_squeeze`.

    Attributes:
        balance: Norm of the unbalanced wrench at rest, torque divided by length, divided by gravity's.
        reach: Norm of the forces beyond what targets command, divided by the forces'.
        cone: Greatest violation of a friction cone at rest and at `margin` times each push, divided by the weight.
        slip: By how much the longest slip exceeds the one that is allowed [m].
        effort: By how much a torque exceeds its limit [N m or N].
        stability: By how much an eigenvalue falls short of what was stored, as a share.
    """

    balance: float
    reach: float
    cone: float
    slip: float
    effort: float
    stability: float

    def passes(self, tolerance: float = 1e-6) -> bool:
        """Whether all is proved but the cones at pushes, which three rounds bring to a hundredth of the weight."""
        values = (self.balance, self.reach, self.slip, self.effort, self.stability)
        return all(value <= tolerance for value in values)


def check_squeeze(
    squeeze: PassiveSqueeze, stiffness: GraspStiffness, loads: Loads, settings: SqueezeSettings
) -> SqueezeResiduals:
    """Check a passive squeeze again, in plain NumPy, without a solver.

    Args:
        squeeze: The squeeze.
        stiffness: The grasp's stiffness.
        loads: What the grasp has to do.
        settings: The demands that it was made for.

    Returns:
        Residuals.
    """
    f, gravity, nc = squeeze.f, loads.gravity, loads.map.contacts
    law, scaling = linear_law(stiffness, f, loads.pushes), loads.map.scaling
    weight = float(np.linalg.norm(scaling * gravity))
    reach = reachable_forces(stiffness, gravity, loads.map.length)
    slips = squeeze.slips.reshape(len(loads.pushes), 2 * nc)
    pushed = f[:, None] + squeeze.margin * law.pushes + law.slips @ slips.T
    forces = np.concatenate([f[None], pushed.T]).reshape(-1, nc, 3)
    scale = np.linalg.norm(f)
    again = assessed(stiffness, loads, f, squeeze.margin, squeeze.slips, settings)
    short = [
        (stored - now) / max(abs(stored), 1e-9)
        for stored, now in (
            (squeeze.joint_eigenvalue, again.joint_eigenvalue),
            (squeeze.object_eigenvalue, again.object_eigenvalue),
            (squeeze.elastic_margin, again.elastic_margin),
        )
    ]
    return SqueezeResiduals(
        balance=float(np.linalg.norm(scaling * (stiffness.G @ f + gravity))) / weight,
        reach=float(np.linalg.norm(reach.rows[6:] @ f) / scale),
        cone=float(cone_violation(forces, loads.map.mus).max()) / weight,
        slip=max(0.0, float(np.sqrt((squeeze.slips**2).sum(axis=-1)).max(initial=0.0)) - settings.slip),
        effort=max(0.0, float((np.abs(squeeze.torques) - loads.effort.limits).max())),
        stability=max(0.0, *short),
    )
