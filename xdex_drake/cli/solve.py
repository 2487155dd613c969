"""`xdex solve`: a problem file, its costs and constraints before and after."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from xdex_drake.cli.output import check_output_file, facts, one_thread, table

if TYPE_CHECKING:
    from xdex_drake.problems.wrench import WrenchProblem


@dataclass(frozen=True)
class Solve:
    """Solves a problem file and shows its program before and after: every cost, every constraint, by name.

    A problem names a hand, an object, a program, a solver, a seed, and what a good solution reaches.
    Try `xdex solve allegro_can` and `xdex solve allegro_can --solver snopt`; or copy that file from the folder that
    `xdex solve` names and change it. Without a problem, the library's problems are listed.

    Attributes:
        problem: Name of a problem of the library, or the path of a .yaml file.
        seed: Another seed than the file's.
        solver: Another solver than the file's: sequential, snopt, ipopt or nlopt.
        out: Store the grasp in a file.
        html: Write a page that replays its lift.
    """

    problem: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="PROBLEM")]] = ""
    seed: int | None = None
    solver: str | None = None
    out: Path | None = None
    html: Path | None = None

    def run(self) -> int:
        """Solves and prints."""
        one_thread()
        if self.out is not None:
            check_output_file(self.out, ".parquet")
        if self.html is not None:
            check_output_file(self.html, ".html")
        from xdex_drake.data_files import data_folder
        from xdex_drake.errors import ConfigError
        from xdex_drake.problems.names import list_problems, problem_file

        if self.problem:
            problem_file(self.problem)  # a name that is none is told before the solvers are imported
        from xdex_drake.grasping.reasons import in_words
        from xdex_drake.grasping.tally import counted
        from xdex_drake.problems.files import load_any_problem
        from xdex_drake.problems.wrench import WrenchProblem as ContactsAlone
        from xdex_drake.programs.obstacles import sizes
        from xdex_drake.programs.solve import SOLVERS

        if not self.problem:
            print(table([(name, load_any_problem(name).title) for name in list_problems()], ("problem", "title")))
            print(f"\nfiles: {data_folder('problems')}")
            return 0
        problem = load_any_problem(self.problem)
        if self.seed is not None and self.seed < 0:
            raise ConfigError(f"--seed is {self.seed}; give 0 or more")
        if self.solver is not None and self.solver not in SOLVERS:
            raise ConfigError(f"--solver {self.solver!r} is not known; choose one of {', '.join(SOLVERS)}")
        if isinstance(problem, ContactsAlone):
            return self._wrench(problem)
        changed = replace(problem, seed=problem.seed if self.seed is None else self.seed, solver=_solver(self, problem))
        from xdex_drake.problems.solve import solve_problem

        solution = solve_problem(changed)
        result, grasp = solution.result, solution.grasp
        print(
            f"{problem.title}\n\nbefore\n{solution.program.table()}\n\nafter\n{solution.program.table(result.point)}\n"
        )
        lines: list[tuple[str, object]] = [
            ("status", result.status if result.success else f"{result.status} by {in_words(result.worst)}"),
            ("solver", f"{result.solver}, {1e3 * result.seconds:.0f} ms, {_iterations(result.iterations)}"),
            ("starts tried", f"{solution.tried}; failed by {counted(Counter(solution.violated))}"),
        ]
        if grasp is None:
            lines.append(("grasp", f"none: {solution.reason}"))
            if not solution.obstacles:
                lines.append(("sizes", sizes(solution.hand, solution.scene)))
        else:
            assert grasp.certificate is not None and grasp.lift is not None
            proof, lift = grasp.certificate, grasp.lift
            lines += [
                ("friction left", proof.friction_left),
                ("task margin", proof.task_margin),
                ("ball margin", f"{proof.margin_lower:.4f} to {proof.margin_upper:.4f}"),
                ("penetration [mm]", 1e3 * grasp.penetration_parts_m),
                ("lift", f"{lift.lift_height_m:.3f} m" if lift.success else lift.failure_reason),
            ]
        lines.append(_goals(solution.missed))
        if grasp is not None and self.out is not None:
            from xdex_drake.dataset.files import save_grasps

            save_grasps(self.out, [grasp], solution.hand, solution.scene)
            lines.append(("written", str(self.out)))
        print(facts(lines))
        if grasp is not None and self.html is not None:
            from xdex_drake.cli.show import write_replays

            write_replays(self.html, [grasp], solution.hand, solution.scene)
            print(f"replay: {self.html}")
        return 0 if grasp is not None else 1

    def _wrench(self, problem: WrenchProblem) -> int:
        """Solves a problem of contacts alone, and prints."""
        from xdex_drake.errors import ConfigError
        from xdex_drake.problems.wrench import solve_wrench_problem

        for name in ("seed", "solver", "out", "html"):
            if getattr(self, name) is not None:
                raise ConfigError(f"--{name} does not matter to a wrench problem; leave it out")
        result = solve_wrench_problem(problem)
        print(f"{problem.title}\n")
        lines: list[tuple[str, object]] = [
            ("program", f"{problem.solve}, {len(problem.contacts)} contacts"),
            ("status", result.status if not result.reason else f"{result.status}: {result.reason}"),
            ("value", result.value),
            *((f"force {k + 1} [N]", "  ".join(f"{x:.4f}" for x in f)) for k, f in enumerate(result.forces)),
            ("seconds", result.seconds),
            _goals(problem.missed(result)),
        ]
        print(facts(lines))
        return 0 if result.status == "solved" else 1


def _goals(missed: tuple[str, ...]) -> tuple[str, object]:
    return ("reaches its goals", "yes" if not missed else "no: " + "; ".join(missed))


def _solver(command: Solve, problem: object) -> Literal["sequential", "snopt", "ipopt", "nlopt"]:
    return command.solver or problem.solver  # type: ignore[attr-defined,return-value]


def _iterations(count: int) -> str:
    return "iterations not told" if count < 0 else f"{count} iterations"
