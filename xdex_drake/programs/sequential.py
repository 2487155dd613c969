"""A sequential convex solver for grasp programs.

Each iteration linearises the constraints about the point, adds one elastic slack for each block of inequalities, and
solves a small convex QP with DAQP inside a trust region. Equalities are kept by a stiff quadratic penalty, which lets a
step trade a tenth of a micrometre for feasibility of the subproblem; what is left is judged afterwards, by the
program's own residuals.
"""

from __future__ import annotations

import daqp
import numpy as np

from xdex_drake.hand.description import Array
from xdex_drake.programs.constraints import TOLERANCES, Block
from xdex_drake.programs.point import Point
from xdex_drake.programs.program import GraspProgram, LeastSquares

EQUALITY = 1e3
"""Penalty on squared violation of equalities."""

LOOSE = 20.0
"""The same for equalities in millimetres during the first half of the iterations.

A finger that slides along a curved surface leaves it by the square of its step. A stiff penalty from the start would
allow tiny steps only.
"""

SLACK = 30.0
"""Linear penalty on the slack of each inequality block."""

SAFE = 0.25
"""Fraction of the tolerances within which a point counts as feasible to the solver."""

FAR_ROWS = 15.0
"""Inequality rows slacker than this are left out of a subproblem [mm]."""


def _stiffness(block: Block, loose: bool) -> float:
    return LOOSE if loose and block.unit == "mm" else EQUALITY


def _merit(program: GraspProgram, point: Point, loose: bool) -> tuple[float, float]:
    """The merit, and the part of it that stands for violated constraints."""
    cost = sum(cost.value(point) for cost in program.costs)
    penalty = 0.0
    for block in program.constraints:
        g, _, low, high = block.rows(point)
        miss = np.maximum(low - g, g - high).clip(min=0.0)
        equal = low == high
        penalty += 0.5 * _stiffness(block, loose) * float((miss[equal] ** 2).sum())
        penalty += SLACK * float(miss[~equal].max(initial=0.0))
    return cost + penalty, penalty


def _holds(program: GraspProgram, point: Point) -> bool:
    return all(block.violation(point) <= SAFE * TOLERANCES[block.unit] for block in program.constraints)


def step(program: GraspProgram, point: Point, trust: float, *, loose: bool = False) -> tuple[Array, float]:
    """Solves one convex subproblem.

    Args:
        program: The program.
        point: The point to linearise about.
        trust: Trust region: radians for wrist and joints; a tenth of it in metres for translation.
        loose: Whether equalities in millimetres are penalised by `LOOSE` only.

    Returns:
        Step along the tangent, shape (point.size,), and by how much the merit falls if the linearisation is true; zeros
        where the subproblem could not be solved.
    """
    size = point.size
    n = len(point.k.q)
    P = 1e-4 * np.eye(size)
    c = np.zeros(size)
    for cost in program.costs:
        if isinstance(cost, LeastSquares):
            r, J = cost.evaluate(point)
            P += cost.weight * J.T @ J
            c += cost.weight * (J.T @ r)
        else:
            c += cost.gradient(point)
            P += 1e-2 * np.eye(size)
    rows, lows, highs, owner = [], [], [], []
    blocks, violation = 0, 0.0
    for block in program.constraints:
        if block.name == "limits":
            continue
        g, J, low, high = block.rows(point)
        equal = low == high
        if equal.any():
            r, J_e = (g - low)[equal], J[equal]
            stiff = _stiffness(block, loose)
            P += stiff * J_e.T @ J_e
            c += stiff * (J_e.T @ r)
        near = ~equal & ((g - low < FAR_ROWS) | (high - g < FAR_ROWS))
        if near.any():
            rows.append(J[near])
            lows.append((low - g)[near])
            highs.append((high - g)[near])
            owner.append(np.full(int(near.sum()), blocks))
            violation += float(np.maximum(low - g, g - high)[near].max(initial=0.0))
            blocks += 1
    bound = np.concatenate([np.full(3, trust), np.full(3, 0.1 * trust), np.full(n, trust), np.full(size - 6 - n, 10.0)])
    # Joint limits hold exactly, as bounds of the step.
    low_q, high_q = point.k.hand.limits - point.k.q
    step_low, step_high = -bound, bound.copy()
    step_low[6 : 6 + n] = np.minimum(np.maximum(step_low[6 : 6 + n], low_q), 0.0)
    step_high[6 : 6 + n] = np.maximum(np.minimum(step_high[6 : 6 + n], high_q), 0.0)
    H = np.zeros((size + blocks, size + blocks))
    H[:size, :size] = P
    H[size:, size:] = 1e-3 * np.eye(blocks)
    f = np.concatenate([c, np.full(blocks, SLACK)])
    upper = np.concatenate([step_high, np.full(blocks, 1e6)])
    lower = np.concatenate([step_low, np.zeros(blocks)])
    if blocks:
        A = np.concatenate(rows)
        low, high, own = np.concatenate(lows), np.concatenate(highs), np.concatenate(owner)
        S = np.zeros((len(A), blocks))
        S[np.arange(len(A)), own] = 1.0
        # low <= A x + s  and  A x - s <= high, as rows of one-sided bounds.
        has_low, has_high = np.isfinite(low), np.isfinite(high)
        A_all = np.concatenate([np.hstack([A, S])[has_low], np.hstack([A, -S])[has_high]])
        low_all = np.concatenate([low[has_low], np.full(int(has_high.sum()), -1e30)])
        high_all = np.concatenate([np.full(int(has_low.sum()), 1e30), high[has_high]])
    else:
        A_all, low_all, high_all = np.zeros((0, size)), np.zeros(0), np.zeros(0)
    x, value, flag, _ = daqp.solve(
        np.ascontiguousarray(H),
        f,
        np.ascontiguousarray(A_all),
        np.concatenate([upper, high_all]),
        np.concatenate([lower, low_all]),
        np.zeros(len(upper) + len(high_all), dtype=np.int32),
    )
    if flag <= 0:
        return np.zeros(size), 0.0
    return np.asarray(x[:size]), SLACK * violation - value


def solve_sequential(
    program: GraspProgram, *, iterations: int = 20, trust: float = 0.2, improvement: float = 1e-3
) -> tuple[Point, int]:
    """Iterates convex subproblems from the program's initial guess.

    Args:
        program: The program.
        iterations: Greatest number of subproblems.
        trust: First trust region [rad].
        improvement: At a point where all constraints hold with room to spare, the solver stops once a step lowers the
            costs by less than this. Infinity stops at the first such point, where costs serve as a preference only.

    Returns:
        The last point that lowered the merit, and the number of subproblems solved.
    """
    point, count, reach = program.start, 0, trust
    for loose in (True, False):
        merit, penalty = _merit(program, point, loose)
        for _ in range(iterations // 2):
            move, promised = step(program, point, reach, loose=loose)
            count += 1
            # Nothing to gain, or constraints that another hundred steps like this one would not mend.
            if promised < max(1e-3, 1e-2 * penalty):
                break
            trial = point.moved(move)
            trial_merit, trial_penalty = _merit(program, trial, loose)
            gain = merit - trial_merit
            if gain < 0.25 * promised:
                reach *= 0.25
            elif gain > 0.75 * promised:
                reach = min(2.0 * reach, 0.4)
            if gain > 0.01 * promised:
                point, merit, penalty = trial, trial_merit, trial_penalty
                if gain < improvement and _holds(program, point):
                    return point, count
            if reach < 1e-4:
                break
        # The stiff penalty sees the curvature that the loose one let pass.
        reach = min(max(reach, 0.003), 0.03)
    return point, count
