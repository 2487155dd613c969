"""Solves a grasp program with a solver of choice and judges the result by our own residuals."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.solvers import IpoptSolver, NloptSolver, SnoptSolver, SolverInterface, SolverOptions

from xdex_drake.errors import ConfigError
from xdex_drake.programs.constraints import TOLERANCES
from xdex_drake.programs.point import Point
from xdex_drake.programs.program import GraspProgram, OutOfTime, ProgramTerms
from xdex_drake.programs.sequential import solve_sequential

SOLVERS = ("sequential", "snopt", "ipopt", "nlopt")


@dataclass(frozen=True)
class ProgramResult:
    """Result of a solve.

    Attributes:
        status: "solved", or "infeasible" where a constraint is left violated.
        point: The final point.
        costs: Value of each cost by name.
        violations: Greatest violation of each constraint by name, in the block's unit.
        worst: Name of the constraint that is violated most, relative to its tolerance; empty where all hold.
        iterations: Iterations of the solver, -1 where it does not say.
        seconds: Wall time.
        solver: Name of the solver.
    """

    status: str
    point: Point
    costs: dict[str, float]
    violations: dict[str, float]
    worst: str
    iterations: int
    seconds: float
    solver: str

    @property
    def success(self) -> bool:
        """Whether every constraint holds."""
        return self.status == "solved"

    def __str__(self) -> str:
        """A short table."""
        lines = [f"{self.status} by {self.solver} in {1e3 * self.seconds:.0f} ms, {self.iterations} iterations"]
        lines += [f"  cost {name:<14}{value:>12.4g}" for name, value in self.costs.items()]
        lines += [f"  violation {name:<14}{value:>12.3g}" for name, value in self.violations.items()]
        return "\n".join(lines)


def _drake_solver(name: str, time_limit_s: float) -> tuple[SolverInterface, SolverOptions]:
    options = SolverOptions()
    if name == "snopt":
        solver = SnoptSolver()
        options.SetOption(solver.solver_id(), "Major iterations limit", 100)
        options.SetOption(solver.solver_id(), "Major feasibility tolerance", 1e-4)
        options.SetOption(solver.solver_id(), "Major optimality tolerance", 1e-3)
        # Exact distances have kinks, at which long steps and exact line searches are lost.
        options.SetOption(solver.solver_id(), "Linesearch tolerance", 0.5)
        options.SetOption(solver.solver_id(), "Major step limit", 0.3)
        return solver, options
    if name == "ipopt":
        solver = IpoptSolver()
        options.SetOption(solver.solver_id(), "max_iter", 100)
        options.SetOption(solver.solver_id(), "tol", 1e-3)
        options.SetOption(solver.solver_id(), "max_cpu_time", time_limit_s)
        return solver, options
    solver = NloptSolver()
    options.SetOption(solver.solver_id(), "algorithm", "LD_SLSQP")
    options.SetOption(solver.solver_id(), "max_eval", 200)
    options.SetOption(solver.solver_id(), NloptSolver.MaxTimeName(), time_limit_s)
    return solver, options


def _solve_with_drake(program: GraspProgram, name: str, time_limit_s: float) -> tuple[Point, ProgramTerms]:
    """The point that a solver of Drake returns, or the last one it tried where it ran out of time or lost its way.

    With it the terms at what the solver says of variables that a user added.
    """
    solver, options = _drake_solver(name, time_limit_s)
    try:
        with program.limited(1.1 * time_limit_s):
            result = solver.Solve(program.prog, program.prog.initial_guess(), options)
    except RuntimeError as error:
        # Drake wraps what is raised within SNOPT's callbacks.
        if not isinstance(error, OutOfTime) and OutOfTime.__name__ not in str(error):
            raise
        return program.last_point(), program.terms()
    x = result.GetSolution(program.variables)
    terms = program.terms(result.GetSolution(program.further_variables()))
    # NLopt's SLSQP returns NaN for some infeasible programs.
    return (program.point(x) if np.isfinite(x).all() else program.start), terms


def judge(program: GraspProgram, point: Point, terms: ProgramTerms | None = None) -> tuple[dict[str, float], str]:
    """Violations of all constraints at a point, and the name of the worst that exceeds its tolerance.

    Args:
        program: The program.
        point: The point.
        terms: What counts; `program.terms()` where None, those of `program.prog` among them.

    Returns:
        Violation by name, in the block's unit, and the name of the worst; empty where all hold.
    """
    constraints = (terms or program.terms()).constraints
    violations = {block.name: block.violation(point) for block in constraints}
    # A value that is no number holds nothing.
    relative = {
        block.name: np.nan_to_num(violations[block.name] / TOLERANCES[block.unit], nan=np.inf) for block in constraints
    }
    worst = max(relative, key=lambda name: relative[name], default="")
    return violations, worst if worst and relative[worst] > 1.0 else ""


def solve(
    program: GraspProgram,
    *,
    solver: str = "sequential",
    iterations: int = 20,
    improvement: float = 1e-3,
    time_limit_s: float = 10.0,
) -> ProgramResult:
    """Solves a grasp program from its initial guess, with all that a user added to `program.prog`.

    Args:
        program: The program.
        solver: "sequential" (ours, the default), or Drake's "snopt", "ipopt" or "nlopt".
        iterations: Greatest number of subproblems of the sequential solver.
        improvement: Where the sequential solver stops at a feasible point; see `solve_sequential`.
        time_limit_s: Time after which Drake's solvers are stopped [s]; iterations bound the sequential one.

    Returns:
        The result; a failed solve is a result with the constraint that failed, not an exception.

    Raises:
        ConfigError: The solver is not known, or it is the sequential one and cannot take what was added to
            `program.prog`: further variables, or functions that Drake's AutoDiff cannot differentiate.
    """
    if solver not in SOLVERS:
        raise ConfigError(f"solver {solver!r} is not known; choose one of {', '.join(SOLVERS)}")
    start = time.perf_counter()
    count, terms = -1, program.terms()
    if solver == "sequential":
        point, count = solve_sequential(program, iterations=iterations, improvement=improvement)
    else:
        point, terms = _solve_with_drake(program, solver, time_limit_s)
    seconds = time.perf_counter() - start
    violations, worst = judge(program, point, terms)
    costs = {cost.name: cost.value(point) for cost in terms.costs}
    return ProgramResult("infeasible" if worst else "solved", point, costs, violations, worst, count, seconds, solver)


def most_violated(results: Sequence[ProgramResult]) -> dict[str, int]:
    """How often each constraint was the one that could not be met, over many solves."""
    counts: dict[str, int] = {}
    for result in results:
        if result.worst:
            counts[result.worst] = counts.get(result.worst, 0) + 1
    return dict(sorted(counts.items(), key=lambda item: -item[1]))
