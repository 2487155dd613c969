"""Newton's method within joint limits on smooth absolute values of points, for a batch of frames.

The second derivative of the objective is at hand: smooth L1 has a simple one, and that of a point of a tree of joints
costs one more product than its Jacobian. Where a person's hand is out of reach, residuals are large and Gauss-Newton,
which leaves them out, creeps. Far from the solution they are left out all the same, and lengths above beta count by the
quadratic that bounds them from above: that matrix is never indefinite.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.retargeting.chains import Chains, Placed
from xdex_drake.retargeting.objectives import Objective, Targets

ARM = 0.03
"""Length that turns an angle into a distance, for damping [m]."""

TURN = 0.6
"""Greatest turn of a joint in one step [rad]."""

CLOSE = 0.6
"""After a step shorter than this the full second derivative is used [rad]."""

LAST = 0.06
"""Newton's steps shrink quadratically: after one shorter than this the next is not worth its while [rad]."""

NEAR, FAR = 0.05, 0.01
"""Damping to start with, as a share of the stiffness that one point of all weight gives a joint `ARM` away."""

STILL = 1e-5
"""A frame is done where a step shorter than this gains nothing [rad]."""

SETS = 6
"""Active sets that are tried a step; one or two are enough but for few."""

FLOOR = 1e-12
"""A cost that is as good as none."""


@dataclass(frozen=True)
class Problem:
    """An objective on a hand, and how to go down.

    Attributes:
        chains: The hand's points.
        objective: The objective.
        smoothing: Weight of squared joint increments from the frame before, added to the objective [1/rad^2].
        iterations: Greatest number of steps.
        tolerance: A frame is done where a step lowers its cost by less than this fraction.
    """

    chains: Chains
    objective: Objective
    smoothing: float
    iterations: int
    tolerance: float


@dataclass(frozen=True)
class _Seen:
    """Postures with their residuals r [m], shape (B, K, 3), and costs, shape (B,)."""

    placed: Placed
    r: Array
    cost: Array

    def rows(self, chosen: NDArray[np.bool_]) -> _Seen:
        return _Seen(self.placed.rows(chosen), self.r[chosen], self.cost[chosen])

    def replaced(self, other: _Seen, chosen: NDArray[np.bool_]) -> _Seen:
        """Those of another where chosen."""
        a, b = self.placed, other.placed
        rows = chosen[:, None, None]
        R = np.where(rows[..., None], b.R_HLs, a.R_HLs)
        placed = Placed(R, np.where(rows, b.p_HLs, a.p_HLs), np.where(rows, b.points, a.points))
        return _Seen(placed, np.where(rows, other.r, self.r), np.where(chosen, other.cost, self.cost))


@dataclass(frozen=True)
class Found:
    """What a descent found.

    Attributes:
        q: Postures [rad or m], shape (B, n).
        r: Residuals [m], shape (B, K, 3).
        cost: Costs, shape (B,).
        placed: The hand's points there, where all frames took the same number of steps, as one frame does.
    """

    q: Array
    r: Array
    cost: Array
    placed: Placed | None = None

    def put(self, frames: NDArray[np.int64], q: Array, seen: _Seen) -> None:
        """Writes down frames that are done."""
        self.q[frames], self.r[frames], self.cost[frames] = q, seen.r, seen.cost


def look(problem: Problem, q: Array, q_before: Array, targets: Targets, *, placed: Placed | None = None) -> _Seen:
    """Residuals and costs at postures.

    Args:
        problem: The problem.
        q: Joint values [rad or m], shape (B, n).
        q_before: Those of the frame before, shape (B, n).
        targets: The targets.
        placed: The hand's points at q, where they are known.

    Returns:
        What was seen.
    """
    placed = problem.chains.place(q) if placed is None else placed
    combine = problem.objective.combine
    r = (placed.points if combine is None else combine @ placed.points) - targets.vectors
    beta = problem.objective.beta
    if problem.objective.by_coordinate:
        size = np.abs(r)
        each = np.where(size < beta, size * size / (2.0 * beta), size - 0.5 * beta).sum(axis=-1) / 3.0
    else:
        size = np.sqrt((r * r).sum(axis=-1))
        each = np.where(size < beta, size * size / (2.0 * beta), size - 0.5 * beta)
    cost = (targets.weights * each).sum(axis=-1)
    if problem.smoothing:
        cost = cost + problem.smoothing * ((q - q_before) ** 2).sum(axis=-1)
    return _Seen(placed, r, cost)


def slopes(
    problem: Problem, q: Array, q_before: Array, targets: Targets, seen: _Seen, exact: Array
) -> tuple[Array, Array]:
    """Gradient and second derivative of the cost with respect to the actuated joints.

    Args:
        problem: The problem.
        q: Joint values, shape (B, n).
        q_before: Those of the frame before, shape (B, n).
        targets: The targets.
        seen: What `look` saw there.
        exact: 1 where the full second derivative is asked for, 0 where its positive bound is, shape (B,).

    Returns:
        Gradient, shape (B, n), and matrix, shape (B, n, n).
    """
    chains, objective = problem.chains, problem.objective
    J, axes = chains.derivatives(seen.placed)
    B, _, joints, _ = J.shape
    combine = objective.combine
    Jv = J if combine is None else (combine @ J.reshape(B, len(combine[0]), -1)).reshape(B, -1, joints, 3)
    r, beta, w = seen.r, objective.beta, targets.weights[..., None]
    if objective.by_coordinate:
        size, w = np.abs(r), w / 3.0
    else:
        size = np.sqrt((r * r).sum(axis=-1, keepdims=True))
    scale = w / np.maximum(size, beta)
    far = (size > beta) * exact[:, None, None]
    root = np.sqrt(scale)
    # By coordinate, |x| has no curvature; the length of a vector has one in all directions but its own.
    root_now = root * (1.0 - far) if objective.by_coordinate else root
    rows = (Jv * root_now[:, :, None, :]).transpose(0, 2, 1, 3).reshape(B, joints, -1)
    H = rows @ np.swapaxes(rows, -1, -2)
    if not objective.by_coordinate and far.any():
        along = (Jv @ (r * (root * far / np.maximum(size, beta)))[..., None])[..., 0]
        H = H - np.swapaxes(along, -1, -2) @ along
    forces = scale * r
    on_points = forces if combine is None else combine.T @ forces
    g = (J @ on_points[..., None]).sum(axis=1)[..., 0]
    if exact.any():
        H = H + exact[:, None, None] * chains.curvature(J, axes, on_points)
    g, H = g @ chains.C, chains.C.T @ H @ chains.C
    if problem.smoothing:
        g = g + 2.0 * problem.smoothing * (q - q_before)
        H = H + 2.0 * problem.smoothing * np.eye(H.shape[-1])
    return g, H


def bounded_step(H: Array, g: Array, least: Array, most: Array) -> Array:
    """The least of g.s + s.H s / 2 within bounds, by a primal-dual active set (Hintermueller, Ito and Kunisch 2003).

    Joints that would leave their bounds are put there, and let go where the slope leads back inside.

    Args:
        H: Positive definite matrices, shape (B, n, n).
        g: Gradients, shape (B, n).
        least: Lower bounds of the step, not above zero, shape (B, n).
        most: Upper bounds of the step, not below zero, shape (B, n).

    Returns:
        Steps within the bounds, shape (B, n).
    """
    n = g.shape[1]
    below, above = (least >= 0.0) & (g > 0.0), (most <= 0.0) & (g < 0.0)
    step = g
    for _ in range(SETS):
        pinned = below | above
        if pinned.any():
            at = np.where(below, least, np.where(above, most, 0.0))
            A = H * (~pinned[:, :, None] & ~pinned[:, None, :])
            A.reshape(-1, n * n)[:, :: n + 1] += pinned
            b = np.where(pinned, at, -g - (H @ at[..., None])[..., 0])
            step = np.linalg.solve(A, b[..., None])[..., 0]
            slope = g + (H @ step[..., None])[..., 0]
            was_below, was_above = below, above
            below = (below & (slope > 0.0)) | (~pinned & (step < least))
            above = (above & (slope < 0.0)) | (~pinned & (step > most))
            if (below == was_below).all() and (above == was_above).all():
                break
        else:
            step = np.linalg.solve(H, -g[..., None])[..., 0]
            below, above = step < least, step > most
            if not (below.any() or above.any()):
                break
    return np.minimum(np.maximum(step, least), most)


def descend(problem: Problem, q: Array, targets: Targets, *, near: bool, placed: Placed | None = None) -> Found:
    """Goes down from postures within the joint limits.

    Args:
        problem: The problem.
        q: Starts within the limits [rad or m], shape (B, n); smoothing counts increments from here.
        targets: The targets, B frames.
        near: Whether the starts are near the solutions, as those of a stream are.
        placed: The hand's points at the starts, where they are known.

    Returns:
        Postures with residuals and costs.
    """
    low, high = problem.chains.hand.limits
    q, q_before, n = q.copy(), q.copy(), q.shape[1]
    seen = look(problem, q, q_before, targets, placed=placed)
    unit = (targets.weights.sum(axis=1) * ARM * ARM / problem.objective.beta)[:, None]
    damping, exact = np.full(len(q), NEAR if near else FAR), np.full(len(q), 1.0 if near else 0.0)
    found = Found(q.copy(), np.zeros_like(seen.r), np.zeros(len(q)))
    frames = np.arange(len(q))
    for _ in range(problem.iterations):
        g, H = slopes(problem, q, q_before, targets, seen, exact)
        H.reshape(-1, n * n)[:, :: n + 1] += damping[:, None] * unit
        step = bounded_step(H, g, np.maximum(low - q, -TURN), np.minimum(high - q, TURN))
        # The sum may pass a limit by a rounding error.
        trial = np.minimum(np.maximum(q + step, low), high)
        there = look(problem, trial, q_before, targets)
        gain = seen.cost - there.cost
        better, length = gain > 0.0, np.abs(step).max(axis=1)
        done = better & (length < LAST) & (exact > 0.0)
        # A refused step asks for a shorter one and a matrix that is surely positive.
        exact = np.where(better & (length < CLOSE), 1.0, 0.0)
        damping = np.where(better, np.maximum(damping * 0.1, 1e-7), damping * 10.0 + 1e-3)
        done |= (better & (length < CLOSE) & (gain <= problem.tolerance * there.cost)) | (there.cost < FLOOR)
        done |= ~better & (length < STILL)
        if better.all():
            q, seen = trial, there
        elif better.any():
            q = np.where(better[:, None], trial, q)
            seen = seen.replaced(there, better)
        if done.all():
            break
        if done.any():
            found.put(frames[done], q[done], seen.rows(done))
            go = ~done
            frames, q, q_before, seen, targets = frames[go], q[go], q_before[go], seen.rows(go), targets.rows(go)
            damping, exact, unit = damping[go], exact[go], unit[go]
    found.put(frames, q, seen)
    return replace(found, placed=seen.placed) if len(frames) == len(found.q) else found
