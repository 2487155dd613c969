"""A sequential convex solver for grasp programs.

Each iteration linearises the constraints about the point, adds one elastic slack for each block of inequalities, and
solves a small convex QP with DAQP inside a trust region. Equalities are kept by a stiff quadratic penalty, which lets a
step trade a tenth of a micrometre for feasibility of the subproblem; what is left is judged afterwards, by the
program's own residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.programs.constraints import TOLERANCES, Block
from xdex_drake.programs.foreign import OWN_UNIT
from xdex_drake.programs.point import Point
from xdex_drake.programs.program import GraspProgram, ProgramTerms

EQUALITY = 1e3
"""Penalty on squared violation of equalities."""

LOOSE = 20.0
"""The same for equalities in millimetres during the first half of the iterations.

A finger that slides along a curved surface leaves it by the square of its step. A stiff penalty from the start would
allow tiny steps only.
"""

SLACK = 30.0
"""Linear penalty on the slack of each inequality block."""

SAFE = {"m g": 0.9}
"""Fraction of a unit's tolerance within which a point counts as feasible to the solver; 0.25 where none is named.

Forces need no more room to spare: they are balanced exactly afterwards, where the hand is not moved any more.
"""

HOPELESS = 8.0
"""Penalty after the first half of the iterations above which the second is not begun where any feasible point will do.

Of 228 candidates of a search (Allegro; can, mug, box) 65 end so, and the second half mends one of them: leaving it out
saves a sixth of all iterations for a 136th of the successes.
"""

SLACK_CURVATURE = 1e-2
"""Quadratic penalty on slacks. With a tenth of it, one subproblem in a hundred took DAQP thousands of iterations."""

FAR_ROWS = 15.0
"""Inequality rows slacker than this are left out of a subproblem [mm]."""


@dataclass(frozen=True)
class _Rows:
    """What stays the same for the rows of all constraints of a program, joint limits apart, block after block.

    Attributes:
        blocks: The blocks that have rows.
        starts: First row of each.
        owner: Block of each row, shape (m,).
        low: Lower bounds, shape (m,).
        high: Upper bounds, shape (m,).
        equal: Which rows are equalities, shape (m,).
        stiff: Penalty on squared violation of each, 0 for inequalities, shape (m,).
        loose: The same during the first half of the iterations, shape (m,).
        far: Slack from which on a row is left out of a subproblem, shape (m,).
    """

    blocks: tuple[Block, ...]
    starts: NDArray[np.int64]
    owner: NDArray[np.int64]
    low: Array
    high: Array
    equal: NDArray[np.bool_]
    stiff: Array
    loose: Array
    far: Array


def _rows(terms: ProgramTerms, start: Point) -> _Rows:
    """The rows of a program."""
    seen = [(block, block.rows(start)) for block in terms.constraints if block.name != "limits"]
    seen = [(block, rows) for block, rows in seen if len(rows[0])]
    if not seen:
        return _Rows((), *(np.zeros(0, dtype=kind) for kind in (int, int, float, float, bool, float, float, float)))
    blocks = tuple(block for block, _ in seen)
    counts = [len(rows[0]) for _, rows in seen]
    owner = np.repeat(np.arange(len(blocks)), counts)
    low, high = (np.concatenate([rows[k] for _, rows in seen]) for k in (2, 3))
    equal = low == high
    stiff = EQUALITY * equal
    units = np.array([block.unit for block in blocks])[owner]
    loose = np.where(units == "mm", LOOSE * equal, stiff)
    # How far a step goes is known of millimetres alone.
    far = np.where(units == OWN_UNIT, np.inf, FAR_ROWS)
    return _Rows(blocks, np.concatenate([[0], np.cumsum(counts[:-1])]), owner, low, high, equal, stiff, loose, far)


def _merit(terms: ProgramTerms, rows: _Rows, point: Point, loose: bool) -> tuple[float, float]:
    """The merit, and the part of it that stands for violated constraints."""
    cost = sum(cost.value(point) for cost in terms.costs)
    if not rows.blocks:
        return cost, 0.0
    g = np.concatenate([block.rows(point)[0] for block in rows.blocks])
    miss = np.maximum(np.maximum(rows.low - g, g - rows.high), 0.0)
    penalty = 0.5 * float((rows.loose if loose else rows.stiff) @ (miss * miss))
    penalty += SLACK * float(np.maximum.reduceat(np.where(rows.equal, 0.0, miss), rows.starts).sum())
    return cost + penalty, penalty


def _length(move: Array, n: int) -> float:
    """The smallest trust region that holds a step."""
    scaled = np.abs(move[: 6 + n])
    scaled[3:6] *= 10.0
    return float(scaled.max())


def _holds(terms: ProgramTerms, point: Point) -> bool:
    return all(
        block.violation(point) <= SAFE.get(block.unit, 0.25) * TOLERANCES[block.unit] for block in terms.constraints
    )


def _step(terms: ProgramTerms, rows: _Rows, point: Point, trust: float, *, loose: bool) -> tuple[Array, float]:
    """Solves one convex subproblem.

    Args:
        terms: The program's costs and constraints.
        rows: Its rows.
        point: The point to linearise about.
        trust: Trust region: radians for wrist and joints; a tenth of it in metres for translation.
        loose: Whether equalities in millimetres are penalised by `LOOSE` only.

    Returns:
        Step along the tangent, shape (point.size,), and by how much the merit falls if the linearisation is true; zeros
        where the subproblem could not be solved.
    """
    size, n, slacks = point.size, len(point.k.q), len(rows.blocks)
    whole = size + slacks
    H, f = np.zeros((whole, whole)), np.zeros(whole)
    H.flat[: size * whole : whole + 1] = 1e-4
    H.flat[size * (whole + 1) :: whole + 1] = SLACK_CURVATURE
    f[size:] = SLACK
    P, c = H[:size, :size], f[:size]
    for cost in terms.costs:
        c += cost.gradient(point)
        P += cost.curvature(point)
    bound = np.full(whole, trust)
    bound[3:6], bound[6 + n : size], bound[size:] = 0.1 * trust, 10.0, 1e6
    lower, upper = -bound, bound
    # Joint limits hold exactly, as bounds of the step.
    lower[6 : 6 + n] = np.minimum(np.maximum(lower[6 : 6 + n], point.k.hand.limits[0] - point.k.q), 0.0)
    upper[6 : 6 + n] = np.maximum(np.minimum(upper[6 : 6 + n], point.k.hand.limits[1] - point.k.q), 0.0)
    lower[size:] = 0.0
    A, violation = np.zeros((0, whole)), 0.0
    if rows.blocks:
        values = [block.rows(point) for block in rows.blocks]
        g, J = np.concatenate([v[0] for v in values]), np.concatenate([v[1] for v in values])
        short, spare = rows.low - g, rows.high - g
        stiff = (rows.loose if loose else rows.stiff)[rows.equal]
        J_e, r = J[rows.equal], -short[rows.equal]
        P += (J_e * stiff[:, None]).T @ J_e
        c += (stiff * r) @ J_e
        # low <= J x + s  and  J x - s <= high, as rows of one-sided bounds.
        below = np.flatnonzero(~rows.equal & (short > -rows.far))
        above = np.flatnonzero(~rows.equal & (spare < rows.far))
        A = np.zeros((len(below) + len(above), whole))
        np.concatenate([J[below], J[above]], out=A[:, :size])
        A[np.arange(len(below)), size + rows.owner[below]] = 1.0
        A[np.arange(len(below), len(A)), size + rows.owner[above]] = -1.0
        lower = np.concatenate([lower, short[below], np.full(len(above), -1e30)])
        upper = np.concatenate([upper, np.full(len(below), 1e30), spare[above]])
        miss = np.where(rows.equal, 0.0, np.maximum(np.maximum(short, -spare), 0.0))
        violation = float(np.maximum.reduceat(miss, rows.starts).sum())
    x, value, flag, _ = daqp.solve(H, f, A, upper, lower, np.zeros(len(upper), dtype=np.int32))
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
            costs by less than this. Infinity stops at the first such point, where costs serve as a preference only,
            and gives up where the first half of the iterations left more than `HOPELESS`: there are other candidates.

    Returns:
        The last point that lowered the merit, and the number of subproblems solved.

    Raises:
        ConfigError: A user added variables to `program.prog`, or costs or constraints without derivatives.
    """
    further = program.further_variables()
    if len(further):
        raise ConfigError(
            f"the sequential solver moves X_WH, q and f alone, and program.prog has {further[0].get_name()!r} beside "
            "them; choose solver='snopt', 'ipopt' or 'nlopt'"
        )
    point, count, reach, terms = program.guess(), 0, trust, program.terms()
    rows = _rows(terms, point)
    for loose in (True, False):
        merit, penalty = _merit(terms, rows, point, loose)
        for _ in range(iterations // 2):
            move, promised = _step(terms, rows, point, reach, loose=loose)
            count += 1
            # Nothing to gain, or constraints that another hundred steps like this one would not mend.
            if promised < max(1e-3, 1e-2 * penalty):
                break
            trial = point.moved(move)
            trial_merit, trial_penalty = _merit(terms, rows, trial, loose)
            gain = merit - trial_merit
            if gain < 0.25 * promised:
                # A trust region that the step did not fill must shrink to the step first.
                reach = 0.25 * min(reach, _length(move, len(point.k.q)))
            elif gain > 0.75 * promised:
                reach = min(2.0 * reach, 0.4)
            if gain > 0.01 * promised:
                point, merit, penalty = trial, trial_merit, trial_penalty
                if gain < improvement and _holds(terms, point):
                    return point, count
            if reach < 1e-4:
                break
        if penalty > HOPELESS and improvement == np.inf:
            break
        # The stiff penalty sees the curvature that the loose one let pass.
        reach = min(max(reach, 0.003), 0.03)
    return point, count
