"""Runs problem instances: solve, certify, lift, and judge by what a good solution reaches."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.errors import ProblemFileError
from xdex_drake.grasp import Grasp
from xdex_drake.grasping.finish import finish_grasp
from xdex_drake.grasping.reasons import Reason, Rejection
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.problems.files import Problem, force_closure_programs, load_problem, problem_scene
from xdex_drake.programs.link_pose_ik import link_pose_ik_program
from xdex_drake.programs.obstacles import Obstacle, find_obstacles
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.retargeting import refined_start, retargeting_program
from xdex_drake.programs.solve import ProgramResult, most_violated, solve
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.lift import lift


@dataclass(frozen=True, eq=False)
class Solution:
    """What became of a problem.

    Attributes:
        problem: The problem.
        hand: Its hand.
        scene: Its scene.
        program: The program that was solved, or the one that came nearest.
        result: Its result.
        grasp: The grasp, certified and lifted; None where the program was not solved or its solution not certified.
        reason: Why there is no grasp; empty where there is one.
        tried: Number of starts that were tried.
        violated: How often each constraint was the worst one, over the starts that failed.
        obstacles: What keeps the hand from the object whatever the start.
        missed: What the problem says a good solution reaches and this one does not.
    """

    problem: Problem
    hand: Hand
    scene: Scene
    program: GraspProgram
    result: ProgramResult
    grasp: Grasp | None
    reason: str
    tried: int
    violated: dict[str, int]
    obstacles: tuple[Obstacle, ...]
    missed: tuple[str, ...]


def solve_problem(problem: Problem | str | Path) -> Solution:
    """Solves a problem: its starts in turn, best first, until one reaches the problem's goals.

    Where an obstacle is proven before, only the first start is tried, to show what it leaves violated.

    Args:
        problem: The problem, its name, or the path of its file.

    Returns:
        The solution that misses the fewest goals; where none was certified, that of the start whose worst violation
        was least.

    Raises:
        XdexError: The problem, its hand or its object cannot be used, or its source problem has no solution.
    """
    problem = problem if isinstance(problem, Problem) else load_problem(problem)
    hand, scene = problem_scene(problem)
    obstacles = find_obstacles(
        hand, scene, contacts=problem.contacts, grasp_type=problem.grasp_type, settings=problem.polish
    )
    programs = problem_programs(problem, hand, scene)
    if obstacles:
        programs = itertools.islice(programs, 1)
    attempts: list[tuple[GraspProgram, ProgramResult]] = []
    best: tuple[int, GraspProgram, ProgramResult, Grasp] | None = None
    rejected: Rejection | None = None
    for program in programs:
        result = solve(program, solver=problem.solver)
        attempts.append((program, result))
        if not result.success:
            continue
        outcome = finish_grasp(hand, result.point)
        rejected = outcome.reason
        if outcome.grasp is None:
            continue
        grasp = replace(outcome.grasp, grasp_id=problem.name, lift=lift(outcome.grasp, hand, scene))
        misses = len(problem.reaches.missed(result, grasp, obstacles))
        if best is None or misses < best[0]:
            best = misses, program, result, grasp
        if misses == 0:
            break
    if best is not None:
        _, program, result, grasp = best
    else:
        program, result = min(attempts, key=lambda attempt: _badness(attempt[1]))
        grasp = None
    violated = most_violated([result for _, result in attempts])
    missed = problem.reaches.missed(result, grasp, obstacles)
    why = "" if grasp is not None else _reason(obstacles, rejected or Rejection(Reason.CONSTRAINT, result.worst))
    return Solution(problem, hand, scene, program, result, grasp, why, len(attempts), violated, obstacles, missed)


def _reason(obstacles: tuple[Obstacle, ...], rejected: Rejection) -> str:
    """Why there is no grasp: what is proven, else what the best start was rejected for."""
    return obstacles[0].message if obstacles else rejected.in_words()


def problem_programs(problem: Problem, hand: Hand, scene: Scene) -> Iterator[GraspProgram]:
    """The programs of a problem, one for each of its starts.

    Those of a search come best first. Retargeting has two starts: by keypoints alone, and after a short descent from
    there. Link poses are drawn anew for each start, as a model draws them.

    Args:
        problem: The problem.
        hand: Its hand.
        scene: Its scene.

    Returns:
        The programs.

    Raises:
        XdexError: Its source problem has no solution.
    """
    if problem.program == "force_closure":
        return force_closure_programs(problem, hand, scene)
    return _programs_from_source(problem, hand, scene)


def _badness(result: ProgramResult) -> float:
    return max(result.violations.values(), default=0.0) if result.worst else 0.0


def _programs_from_source(problem: Problem, hand: Hand, scene: Scene) -> Iterator[GraspProgram]:
    """The programs of a problem that starts from the solution of another."""
    assert problem.source is not None
    beside = problem.path.parent / problem.source
    source = solve_problem(load_problem(beside if beside.suffix else problem.source))
    if source.grasp is None:
        raise ProblemFileError(
            f"{problem.path}: source {problem.source} has no solution ({source.reason}); mend it first"
        )
    if problem.program == "retargeting":
        yield retargeting_program(source.grasp, source.hand, hand, scene, settings=problem.polish)
        start = refined_start(source.grasp, source.hand, hand, scene)
        yield retargeting_program(source.grasp, source.hand, hand, scene, start=start, settings=problem.polish)
        return
    if source.hand.name != hand.name:
        raise ProblemFileError(f"{problem.path}: source {problem.source} has another hand; link poses need the same")
    R_WLs, p_WLs = forward_kinematics(hand, source.grasp.X_WH, source.grasp.q)
    R_HLs, _ = forward_kinematics(hand, RigidTransform(), np.zeros(len(hand.joint_names)))
    R, rng = R_WLs @ np.swapaxes(R_HLs, 1, 2), np.random.default_rng(problem.seed)
    for _ in range(problem.starts):
        noise = problem.jitter * rng.standard_normal(p_WLs.shape)
        yield link_pose_ik_program(hand, scene, R, p_WLs + noise, settings=problem.polish)
