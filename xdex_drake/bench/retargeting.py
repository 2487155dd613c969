"""Times of retargeting, Eq. (2): by keypoints alone, and under contact, clearance and force closure."""

from __future__ import annotations

import itertools

from xdex_drake.bench.watch import Tick, Watch
from xdex_drake.grasping.synthesis import certified_grasps
from xdex_drake.hand.description import Hand
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.retargeting import IMPROVEMENT, refined_start, retargeting_program, warm_start
from xdex_drake.programs.solve import ProgramResult, solve
from xdex_drake.scene.tabletop import Scene


def _solved(program: GraspProgram) -> ProgramResult:
    return solve(program, improvement=IMPROVEMENT)


def bench_retargeting(
    watch: Watch, source: Hand, targets: tuple[Hand, ...], scene: Scene, *, repeats: int, seed: int, tick: Tick
) -> None:
    """Certified grasps of one hand, retargeted to others.

    Args:
        watch: Where times go, for each target: by keypoints alone, the descent that starts deep ones, and the program,
            built and solved from the warm start. Facts count programs and those solved.
        source: The source hand.
        targets: The other hands.
        scene: The scene.
        repeats: Number of source grasps.
        seed: Seed of the source grasps.
        tick: Called after each retargeting.
    """
    found = certified_grasps(source, scene, seed=seed, time_limit_s=120.0)
    for grasp in itertools.islice(found, repeats):
        for target in targets:
            name = target.name
            warm = watch.time(
                f"{name}: keypoints alone", lambda g=grasp, t=target: warm_start(g, source, t), target_ms=5.0
            )
            result = watch.time(
                f"{name}: program from there",
                lambda g=grasp, t=target, s=warm: _solved(retargeting_program(g, source, t, scene, start=s)),
                target_ms=50.0,
            )
            watch.count(f"{name}: programs")
            if not result.success:
                start = watch.time(
                    f"{name}: descent where that fails", lambda g=grasp, t=target: refined_start(g, source, t, scene)
                )
                result = watch.time(
                    f"{name}: program after it",
                    lambda g=grasp, t=target, s=start: _solved(retargeting_program(g, source, t, scene, start=s)),
                )
            watch.count(f"{name}: solved", int(result.success))
            tick()
