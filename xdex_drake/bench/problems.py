"""All problems by every solver, compared by performance profiles (Dolan and More 2002).

Each start of a problem is one instance. A solver has solved it where every constraint holds by the library's own
residuals, whatever it says itself. The profile of a solver at tau is the share of instances that it solved within tau
times the time of the fastest; at 1 it is how often it is the fastest, and far to the right how often it solves at all.
"""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.bench.svg import picture_of
from xdex_drake.bench.watch import Tick, Watch
from xdex_drake.problems.files import load_any_problem, problem_scene
from xdex_drake.problems.solve import problem_programs
from xdex_drake.problems.wrench import WrenchProblem, solve_wrench_problem
from xdex_drake.programs.point import Point
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.solve import SOLVERS, solve

COLORS = {"sequential": "#4878a8", "snopt": "#c03030", "ipopt": "#3a8a4a", "nlopt": "#b07820"}


def fresh(program: GraspProgram) -> GraspProgram:
    """The same program from a start of which nothing is computed yet, so that no solver pays for another."""
    start = program.start
    again = Point(start.k, start.scene, start.contacts, start.forces)
    return GraspProgram(program.name, again, tuple(program.costs), tuple(program.constraints))


def bench_problems(
    watch: Watch,
    names: Sequence[str],
    *,
    starts: int,
    time_limit_s: float,
    tick: Tick,
    solvers: Sequence[str] = SOLVERS,
) -> None:
    """Runs problems with solvers.

    Args:
        watch: Where times go, one stage a solver; its `runs` are rows of problem, start, solver, what the problem says
            about its status, whether it was solved, the worst constraint, seconds, sum of costs.
        names: Names or paths of the problems. Wrench problems are solved by their own solver.
        starts: Candidates of each search that are solved for, best first.
        time_limit_s: Time after which Drake's solvers are stopped [s].
        tick: Called after each problem.
        solvers: The solvers.
    """
    for name in names:
        problem = load_any_problem(name)
        if isinstance(problem, WrenchProblem):
            result = watch.time("wrench problems", lambda p=problem: solve_wrench_problem(p))
            watch.count("wrench problems that reach their goals", int(not problem.missed(result)))
            tick()
            continue
        hand, scene = problem_scene(problem)
        feasible = problem.reaches.status == "solved"
        for start, program in enumerate(itertools.islice(problem_programs(problem, hand, scene), starts)):
            fresh(program).table()  # distances and grids of the object are prepared once
            for solver in solvers:
                again = fresh(program)
                stage = f"{solver}, {'feasible' if feasible else 'infeasible'}"
                found = watch.time(
                    stage, lambda p=again, s=solver: solve(p, solver=s, time_limit_s=time_limit_s, improvement=1e-3)
                )
                watch.runs.append(
                    {
                        "problem": problem.name,
                        "start": start,
                        "solver": solver,
                        "feasible": feasible,
                        "solved": found.success,
                        "worst": found.worst,
                        "seconds": round(found.seconds, 5),
                        "cost": round(sum(found.costs.values()), 5),
                    }
                )
        tick()
    for solver, row in summary(watch.runs).items():
        watch.facts.update({f"{solver}: {label}": value for label, value in row.items()})


def summary(runs: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Shares by solver, over instances of problems that have a solution.

    Args:
        runs: Rows of `bench_problems`.

    Returns:
        For each solver: the shares solved, solved fastest, and within 4 times the fastest; the median time of a solve;
        and the median of its cost relative to the least cost that any solver reached.
    """
    solvers = list(dict.fromkeys(run["solver"] for run in runs))
    ratios = profile_ratios(runs)
    least: dict[tuple[str, int], float] = {}
    for run in runs:
        if run["feasible"] and run["solved"]:
            key = (run["problem"], run["start"])
            least[key] = min(least.get(key, np.inf), run["cost"])
    rows = {}
    for solver in solvers:
        mine = [run for run in runs if run["solver"] == solver and run["feasible"] and run["solved"]]
        costs = [run["cost"] / max(least[run["problem"], run["start"]], 1e-9) for run in mine]
        ratio = ratios.get(solver, np.zeros(0))
        rows[solver] = {
            "solved": round(float(np.mean(np.isfinite(ratio))), 3) if len(ratio) else 0.0,
            "fastest": round(float(np.mean(ratio <= 1.0)), 3) if len(ratio) else 0.0,
            "within 4 times the fastest": round(float(np.mean(ratio <= 4.0)), 3) if len(ratio) else 0.0,
            "median of solved [ms]": round(1e3 * statistics.median(run["seconds"] for run in mine), 1) if mine else 0.0,
            "cost, relative to the least": round(statistics.median(costs), 3) if costs else 0.0,
        }
    return rows


def profile_ratios(runs: Sequence[dict[str, Any]]) -> dict[str, Array]:
    """Time of each solver on each instance, relative to the fastest that solved it; infinite where it did not.

    Args:
        runs: Rows of `bench_problems`; problems without a solution are left out.

    Returns:
        Ratios by solver, sorted, each of shape (number of instances,).
    """
    times: dict[tuple[str, int], dict[str, float]] = {}
    for run in runs:
        if run["feasible"]:
            row = times.setdefault((run["problem"], run["start"]), {})
            row[run["solver"]] = run["seconds"] if run["solved"] else np.inf
    solvers = list(dict.fromkeys(run["solver"] for run in runs))
    table = np.array([[row.get(solver, np.inf) for solver in solvers] for row in times.values()])
    if not table.size:
        return {}
    best = table.min(axis=1, keepdims=True)
    ratios = np.where(np.isfinite(table), table / np.where(np.isfinite(best), best, 1.0), np.inf)
    return {solver: np.sort(ratios[:, k]) for k, solver in enumerate(solvers)}


def profile_picture(title: str, runs: Sequence[dict[str, Any]]) -> str:
    """Performance profiles as steps over a logarithmic axis, as SVG.

    Args:
        title: Title of the picture.
        runs: Rows of `bench_problems`.

    Returns:
        The text of an SVG file.
    """
    ratios = profile_ratios(runs)
    finite = [r for row in ratios.values() for r in row[np.isfinite(row)]]
    last = max(2.0 ** np.ceil(np.log2(max(finite, default=2.0) * 1.05)), 2.0)
    left, top, width, height = 60, 44, 560, 300

    def at(tau: float, share: float) -> str:
        return f"{left + width * np.log2(tau) / np.log2(last):.1f},{top + height * (1.0 - share):.1f}"

    lines = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = top + height * (1.0 - share)
        lines.append(f'<line class="faint" x1="{left}" y1="{y:.1f}" x2="{left + width}" y2="{y:.1f}"/>')
        lines.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{100 * share:.0f} %</text>')
    powers = int(np.log2(last))
    for power in range(0, powers + 1, 1 + powers // 12):
        x = left + width * power / np.log2(last)
        lines.append(f'<text x="{x:.1f}" y="{top + height + 18}" text-anchor="middle">{2**power}×</text>')
    lines.append(
        f'<text class="soft" x="{left + width / 2}" y="{top + height + 42}" text-anchor="middle">'
        "time, as a multiple of the fastest solver's</text>"
    )
    for row, (solver, values) in enumerate(ratios.items()):
        color = COLORS.get(solver, "#444")
        share, path = 0.0, [at(1.0, 0.0)]
        for k, tau in enumerate(values[np.isfinite(values)]):
            path.append(at(tau, share))
            share = (k + 1) / len(values)
            path.append(at(tau, share))
        path.append(at(last, share))
        lines.append(f'<polyline points="{" ".join(path)}" fill="none" stroke="{color}" stroke-width="2"/>')
        y = top + 16 + 20 * row
        x = left + width + 16
        lines.append(f'<rect x="{x}" y="{y - 10}" width="14" height="10" fill="{color}"/>')
        lines.append(f'<text x="{x + 20}" y="{y}">{escape(solver)}, {100 * share:.0f} % in all</text>')
    return picture_of(title, left + width + 190, top + height + 58, lines)
