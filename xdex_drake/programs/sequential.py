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
from xdex_drake.programs.constraints import Block
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

FAR_ROWS = 15.0
"""Inequality rows slacker than this are left out of a subproblem [mm]."""


def _stiffness(block: Block, loose: bool) -> float:
    return LOOSE if loose and block.unit == "mm" else EQUALITY


def _merit(program: GraspProgram, point: Point, loose: bool) -> float:
    total = sum(cost.value(point) for cost in program.costs)
    for block in program.constraints:
        g, _, low, high = block.rows(point)
        miss = np.maximum(low - g, g - high).clip(min=0.0)
        equal = low == high
        total += 0.5 * _stiffness(block, loose) * float((miss[equal] ** 2).sum())
        total += SLACK * float(miss[~equal].max(initial=0.0))
    return total


def step(program: GraspProgram, point: Point, trust: float, *, loose: bool = False) -> Array:
    """Solves one convex subproblem.

    Args:
        program: The program.
        point: The point to linearise about.
        trust: Trust region: radians for wrist and joints; a tenth of it in metres for translation.
        loose: Whether equalities in millimetres are penalised by `LOOSE` only.

    Returns:
        Step along the tangent, shape (point.size,); zero where the subproblem could not be solved.
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
    blocks = 0
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
    x, _, flag, _ = daqp.solve(
        np.ascontiguousarray(H),
        f,
        np.ascontiguousarray(A_all),
        np.concatenate([upper, high_all]),
        np.concatenate([lower, low_all]),
        np.zeros(len(upper) + len(high_all), dtype=np.int32),
    )
    return np.asarray(x[:size]) if flag > 0 else np.zeros(size)


def solve_sequential(program: GraspProgram, *, iterations: int = 20, trust: float = 0.2) -> tuple[Point, int]:
    """Iterates convex subproblems from the program's initial guess.

    Args:
        program: The program.
        iterations: Greatest number of subproblems.
        trust: First trust region [rad].

    Returns:
        The last point that lowered the merit, and the number of subproblems solved.
    """
    point, count = program.start, 0
    for loose in (True, False):
        merit, reach = _merit(program, point, loose), trust if loose else 0.5 * trust
        for _ in range(iterations // 2):
            move = step(program, point, reach, loose=loose)
            count += 1
            if not move.any():
                break
            trial = point.moved(move)
            trial_merit = _merit(program, trial, loose)
            if trial_merit >= merit:
                reach *= 0.3
                if reach < 1e-3:
                    break
                continue
            gain, point, merit = merit - trial_merit, trial, trial_merit
            reach = min(1.5 * reach, 0.4)
            if gain < 1e-3 * max(1.0, merit):
                break
    return point, count
