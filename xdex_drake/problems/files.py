"""Problem instances: YAML files that name hand, object, program, solver, seed, and what a good solution reaches.

Tutorials, tests, benchmarks and `xdex solve` use the same files. They ship with the library, in `problems/`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import yaml

from xdex_drake.errors import ConfigError, ProblemFileError
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.hand.library import load_hand
from xdex_drake.problems.names import list_problems, problem_file
from xdex_drake.problems.wrench import WrenchProblem
from xdex_drake.programs.force_closure import PolishSettings, program_of_candidate
from xdex_drake.programs.grasp_types import GraspType
from xdex_drake.programs.obstacles import Obstacle
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.search import EnergyWeights, SearchSettings, search
from xdex_drake.programs.solve import ProgramResult
from xdex_drake.scene.object import DEFAULT_FRICTION, DEFAULT_MASS, load_object
from xdex_drake.scene.tabletop import Scene, make_scene
from xdex_drake.typed_yaml import NOT_IN_FILE, read_typed_yaml

__all__ = [
    "ObjectSpec",
    "Problem",
    "Reaches",
    "force_closure_programs",
    "list_problems",
    "load_any_problem",
    "load_problem",
    "problem_scene",
]


@dataclass(frozen=True)
class ObjectSpec:
    """The object of a problem.

    Attributes:
        name: Library name, or path of a mesh, relative to the problem file.
        scale: Factor from the mesh file's unit to metres; guessed by the size where it is left out.
        mass: Mass [kg].
        friction: Coefficient of friction.
    """

    name: str
    scale: float | None = None
    mass: float = DEFAULT_MASS
    friction: float = DEFAULT_FRICTION


@dataclass(frozen=True)
class Reaches:
    """What a good solution of a problem reaches.

    Attributes:
        status: "solved", or "infeasible" for a problem that has no solution.
        worst: Constraints of which one is left violated, where the problem has no solution; any where empty.
        obstacle: What keeps the hand from the object, by name: opening, table or friction; any or none where empty.
        costs: Greatest value of costs, by name.
        certified: Whether the solution is certified and fit to be lifted.
        task_margin: Least task margin of its certificate.
        ball_margin: Least certified ball margin of its certificate.
        lifted: Whether it lifts.
    """

    status: Literal["solved", "infeasible"] = "solved"
    worst: tuple[str, ...] = ()
    obstacle: str = ""
    costs: dict[str, float] = field(default_factory=dict)
    certified: bool = False
    task_margin: float | None = None
    ball_margin: float | None = None
    lifted: bool = False

    def missed(
        self, result: ProgramResult, grasp: Grasp | None, obstacles: tuple[Obstacle, ...] = ()
    ) -> tuple[str, ...]:
        """What a solution does not reach.

        Args:
            result: Result of the program.
            grasp: The finished grasp, None where there is none.
            obstacles: What keeps the hand from the object.

        Returns:
            One sentence for each miss; none where all is reached.
        """
        misses = []
        if result.status != self.status:
            misses.append(f"status is {result.status}, not {self.status}")
        if self.worst and result.worst not in self.worst:
            misses.append(f"the worst constraint is {result.worst or 'none'}, not {' or '.join(self.worst)}")
        found = [obstacle.name for obstacle in obstacles]
        if self.obstacle and self.obstacle not in found:
            misses.append(f"the obstacle is {', '.join(found) or 'none'}, not {self.obstacle}")
        for name, most in self.costs.items():
            value = result.costs.get(name, float("nan"))
            if not value <= most:
                misses.append(f"cost {name} is {value:.4g}, above {most:.4g}")
        certificate = None if grasp is None else grasp.certificate
        if self.certified and certificate is None:
            misses.append("there is no certificate")
        for label, least, name in (
            ("task margin", self.task_margin, "task_margin"),
            ("ball margin", self.ball_margin, "margin_lower"),
        ):
            value = float("nan") if certificate is None else float(getattr(certificate, name))
            if least is not None and not value >= least:
                misses.append(f"{label} is {value:.4g}, below {least:.4g}")
        if self.lifted and (grasp is None or grasp.lift is None or not grasp.lift.success):
            misses.append("it does not lift")
        return tuple(misses)


@dataclass(frozen=True)
class Problem:
    """A problem instance.

    Attributes:
        title: One line that says what it is for.
        hand: Library name, or path of a hand file, relative to the problem file.
        object: The object.
        program: Which program.
        source: Name or path of the problem whose solution gives the keypoints of `retargeting`, or the link poses of
            `link_pose_ik`; for these two only.
        jitter: Standard deviation of noise on the link poses of `link_pose_ik`, as a model's predictions have [m].
        scene_seed: Choice of the object's stable pose.
        solver: Solver of the program.
        seed: Seed of the search.
        starts: Candidates of the search, or draws of noisy link poses; they are polished in turn, those of a search
            best first, until one reaches the goals.
        contacts: Greatest number of fingers that touch.
        grasp_type: Type of grasp: any, pinch, tripod or power.
        approach: Direction that the palm comes along, in W, within 20 degrees; [0, 0, -1] is from above; any where it
            is left out.
        spread: Distance that contact points shall keep from each other [m].
        weights: Weights of the search's energy, Eq. (1).
        polish: Weights of the program's costs and numbers of its constraints.
        reaches: What a good solution reaches.
        path: The file it was read from.
    """

    title: str
    hand: str
    object: ObjectSpec
    program: Literal["force_closure", "retargeting", "link_pose_ik"] = "force_closure"
    source: str | None = None
    jitter: float = 0.005
    scene_seed: int = 0
    solver: Literal["sequential", "snopt", "ipopt", "nlopt"] = "sequential"
    seed: int = 0
    starts: int = 16
    contacts: int = 4
    grasp_type: GraspType = "any"
    approach: tuple[float, float, float] | None = None
    spread: float = 0.0
    weights: EnergyWeights = field(default_factory=EnergyWeights)
    polish: PolishSettings = field(default_factory=PolishSettings)
    reaches: Reaches = field(default_factory=Reaches)
    path: Path = field(default=Path(), compare=False, metadata=NOT_IN_FILE)

    def __post_init__(self) -> None:
        """Refuses numbers that are out of range.

        Raises:
            ProblemFileError: One is, or a source is missing or superfluous.
        """
        for name in ("starts", "contacts"):
            if getattr(self, name) < 1:
                raise ProblemFileError(f"{name} is {getattr(self, name)}; give 1 or more")
        for name in ("seed", "scene_seed"):
            if getattr(self, name) < 0:
                raise ProblemFileError(f"{name} is {getattr(self, name)}; give 0 or more")
        if (self.program == "force_closure") != (self.source is None):
            need = "needs a source; name its problem" if self.source is None else "takes no source; leave it out"
            raise ProblemFileError(f"program {self.program} {need}")
        try:
            SearchSettings(approach=self.approach)
        except ConfigError as error:
            raise ProblemFileError(str(error)) from None
        if not 0.0 <= self.spread < 0.5:
            raise ProblemFileError(f"spread is {self.spread} m; give a distance between 0 and 0.5")
        if self.jitter < 0.0:
            raise ProblemFileError(f"jitter is {self.jitter}; give 0 or more")

    @property
    def name(self) -> str:
        """Name of the file, without its type."""
        return self.path.stem


def load_problem(name_or_path: str | Path) -> Problem:
    """Loads a problem of a hand and an object; for those of contacts alone see `load_any_problem`.

    Args:
        name_or_path: Name of a problem of the library (`list_problems`), or a path to a `.yaml` file.

    Returns:
        The problem.

    Raises:
        ProblemFileError: There is no such problem, its file cannot be used, or it is a wrench problem.
    """
    problem = load_any_problem(name_or_path)
    if isinstance(problem, WrenchProblem):
        raise ProblemFileError(f"{problem.path}: program is wrench; give a problem that has a hand and an object")
    return problem


def load_any_problem(name_or_path: str | Path) -> Problem | WrenchProblem:
    """Loads a problem of any kind.

    Args:
        name_or_path: Name of a problem of the library (`list_problems`), or a path to a `.yaml` file.

    Returns:
        The problem.

    Raises:
        ProblemFileError: There is no such problem, or its file cannot be used; the message names file and field.
    """
    path = problem_file(name_or_path)
    kind = WrenchProblem if _program(path) == "wrench" else Problem
    return replace(read_typed_yaml(path, kind, error=ProblemFileError), path=path)


def _program(path: Path) -> object:
    """What a file says its program is; a file that cannot be read says nothing, and its error is told later."""
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return None
    return values.get("program") if isinstance(values, dict) else None


def problem_scene(problem: Problem) -> tuple[Hand, Scene]:
    """Hand and scene of a problem.

    Args:
        problem: The problem.

    Returns:
        The hand, and its object at its stable pose.

    Raises:
        XdexError: The hand or the object cannot be used.
    """
    spec = problem.object
    model = load_object(_beside(problem, spec.name), scale=spec.scale, mass=spec.mass, friction=spec.friction)
    return load_hand(_beside(problem, problem.hand)), make_scene(model, seed=problem.scene_seed)


def _beside(problem: Problem, name: str) -> str:
    """A path relative to the problem's file; a library name as it is."""
    beside = problem.path.parent / name
    return str(beside) if Path(name).suffix and not Path(name).is_absolute() else name


def force_closure_programs(problem: Problem, hand: Hand, scene: Scene) -> Iterator[GraspProgram]:
    """The programs of a force-closure problem, one a candidate of its search, best first.

    Args:
        problem: The problem.
        hand: Its hand.
        scene: Its scene.

    Yields:
        The programs.
    """
    settings = SearchSettings(
        weights=problem.weights,
        contacts=problem.contacts,
        grasp_type=problem.grasp_type,
        approach=problem.approach,
        spread=problem.spread,
    )
    found = search(hand, scene, count=problem.starts, seed=problem.seed, settings=settings)
    for row in range(len(found.energy)):
        yield program_of_candidate(hand, scene, found, row, settings=problem.polish, asked=settings)
