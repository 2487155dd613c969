"""Problem instances of the wrench programs: contacts are given, and what they resist is asked for."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import contact_frames, grasp_matrix
from xdex_drake.contact.grasp_map import Effort, GraspMap
from xdex_drake.contact.margins import ball_margin, task_margin
from xdex_drake.contact.pyramids import epsilon_linearized, min_weight
from xdex_drake.contact.wrench import GRAVITY, balance, gravity_wrench, push_wrenches
from xdex_drake.errors import ProblemFileError
from xdex_drake.typed_yaml import NOT_IN_FILE

WrenchProgram = Literal["balance", "task_margin", "ball_margin", "epsilon", "min_weight"]


@dataclass(frozen=True)
class ContactSpec:
    """A contact.

    Attributes:
        p: Where it is, from the center of mass, in W [m].
        n: Direction that it pushes in, into the object, of any length.
    """

    p: tuple[float, float, float]
    n: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Refuses what is no contact.

        Raises:
            ProblemFileError: Three numbers are missing, or the normal is zero.
        """
        for name, value in (("p", self.p), ("n", self.n)):
            if len(value) != 3:
                raise ProblemFileError(f"{name} is {list(value)}; give three numbers")
        if not any(self.n):
            raise ProblemFileError("n is zero; give a direction into the object")


@dataclass(frozen=True)
class WrenchReaches:
    """What a wrench program reaches.

    Attributes:
        status: "solved", or "infeasible" where the contacts cannot hold the object.
        least: Least value; None where any will do.
        most: Greatest value; None where any will do.
    """

    status: Literal["solved", "infeasible"] = "solved"
    least: float | None = None
    most: float | None = None


@dataclass(frozen=True)
class WrenchResult:
    """What became of a wrench problem.

    Attributes:
        status: "solved" or "infeasible".
        value: The value: of `balance` the greatest normal force in units of the weight, of the others the margin or
            quality; NaN where infeasible.
        forces: Forces in W [N], shape (n, 3); empty where the program gives none.
        reason: Why it is infeasible, in words; empty where it is solved.
        seconds: Wall time.
    """

    status: str
    value: float
    forces: Array
    reason: str
    seconds: float


@dataclass(frozen=True)
class WrenchProblem:
    """A problem instance of the wrench programs (`xdex_drake.contact`).

    Attributes:
        title: One line that says what it is for.
        contacts: The contacts.
        solve: Which program: `balance`, `task_margin` (six pushes of the object's weight), `ball_margin`, and with
            pyramids for cones `epsilon` (Ferrari and Canny 1992) and `min_weight` (FRoGGeR).
        program: "wrench".
        mass: Mass of the object [kg].
        friction: Coefficient of friction.
        length: Length that divides torques [m].
        most_force: Greatest normal force of a contact [N], for `balance` and `task_margin`; none where left out.
        reaches: What the program reaches.
        path: The file it was read from.
    """

    title: str
    contacts: tuple[ContactSpec, ...]
    solve: WrenchProgram
    program: Literal["wrench"] = "wrench"
    mass: float = 0.1
    friction: float = 0.6
    length: float = 0.05
    most_force: float | None = None
    reaches: WrenchReaches = field(default_factory=WrenchReaches)
    path: Path = field(default=Path(), compare=False, metadata=NOT_IN_FILE)

    def __post_init__(self) -> None:
        """Refuses numbers that are out of range.

        Raises:
            ProblemFileError: One is.
        """
        if not self.contacts:
            raise ProblemFileError("contacts is empty; give one contact at least")
        for name in ("mass", "length"):
            if not getattr(self, name) > 0.0:
                raise ProblemFileError(f"{name} is {getattr(self, name)}; give a number greater than zero")
        if self.friction < 0.0:
            raise ProblemFileError(f"friction is {self.friction}; give 0 or more")
        if self.most_force is not None and self.solve not in ("balance", "task_margin"):
            raise ProblemFileError(f"most_force does not matter to {self.solve}; leave it out")

    @property
    def name(self) -> str:
        """Name of the file, without its type."""
        return self.path.stem

    def missed(self, result: WrenchResult) -> tuple[str, ...]:
        """What a result does not reach, one sentence for each miss."""
        goal, misses = self.reaches, []
        if result.status != goal.status:
            misses.append(f"status is {result.status}, not {goal.status}")
        if goal.least is not None and not result.value >= goal.least:
            misses.append(f"{self.solve} is {result.value:.5g}, below {goal.least:.5g}")
        if goal.most is not None and not result.value <= goal.most:
            misses.append(f"{self.solve} is {result.value:.5g}, above {goal.most:.5g}")
        return tuple(misses)


def solve_wrench_problem(problem: WrenchProblem) -> WrenchResult:
    """Solves a wrench problem.

    Args:
        problem: The problem.

    Returns:
        The result; contacts that cannot hold the object are a result with a reason, not an error.
    """
    p_WCs = np.array([contact.p for contact in problem.contacts])
    n_WCs = np.array([contact.n for contact in problem.contacts])
    n_WCs = n_WCs / np.linalg.norm(n_WCs, axis=1, keepdims=True)
    R_WCs = contact_frames(n_WCs)
    grasp_map = GraspMap(grasp_matrix(p_WCs, R_WCs, np.zeros(3)), problem.friction, problem.length)
    n, gravity, most = len(p_WCs), gravity_wrench(problem.mass), problem.most_force
    effort = None if most is None else Effort.of_normal_forces(n, most)
    start, none = time.perf_counter(), np.zeros((0, 3))
    if problem.solve == "balance":
        found = balance(grasp_map, gravity, effort=effort)
        if found.status != "solved":
            return _infeasible(found.reason, start)
        f = found.f.reshape(n, 3)
        greatest = float(f[:, 2].max()) / (problem.mass * GRAVITY)
        forces = np.einsum("kab,kb->ka", R_WCs, f)
        return WrenchResult("solved", greatest, forces, "", time.perf_counter() - start)
    if problem.solve == "task_margin":
        margin = task_margin(grasp_map, gravity, push_wrenches(problem.mass), effort=effort)
        if margin.status != "solved":
            return _infeasible(margin.reason, start)
        return WrenchResult("solved", margin.margin, none, "", time.perf_counter() - start)
    value = _QUALITIES[problem.solve](grasp_map)
    if not math.isfinite(value) or value < 0.0:
        return _infeasible("the contacts do not close by force: some push is resisted by none of them", start)
    return WrenchResult("solved", float(value), none, "", time.perf_counter() - start)


_QUALITIES: dict[str, Callable[[GraspMap], float]] = {
    "ball_margin": lambda grasp_map: ball_margin(grasp_map).lower,
    "epsilon": epsilon_linearized,
    "min_weight": min_weight,
}


def _infeasible(reason: str, start: float) -> WrenchResult:
    return WrenchResult("infeasible", math.nan, np.zeros((0, 3)), reason, time.perf_counter() - start)
