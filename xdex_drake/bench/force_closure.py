"""Times of a synthesis, stage by stage: search, polish, certificate, lift."""

from __future__ import annotations

from xdex_drake.bench.watch import Tick, Watch
from xdex_drake.grasping.finish import finish_grasp
from xdex_drake.hand.description import Hand
from xdex_drake.programs.force_closure import program_of_candidate
from xdex_drake.programs.search import SearchSettings, search
from xdex_drake.programs.solve import solve
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene
from xdex_drake.simulation.lift import lift_rig, simulate_lift

CANDIDATES = 64
"""Candidates that the search leaves, out of more starts."""


def bench_force_closure(watch: Watch, hand: Hand, object_name: str, *, repeats: int, seed: int, tick: Tick) -> None:
    """The candidates of one search, each polished, certified and lifted.

    Args:
        watch: Where times go; facts count what was tried, certified and lifted.
        hand: The hand.
        object_name: Name of a shape, or path of a mesh.
        repeats: Number of candidates, at most `CANDIDATES`.
        seed: Seed of the search.
        tick: Called after each candidate.
    """
    model = watch.time("object (cached where it was used before)", lambda: load_object(object_name))
    scene = watch.time("scene", lambda: make_scene(model))
    watch.time("distance grid (cached likewise)", lambda: model.grid)
    rig = watch.time("lift rig", lambda: lift_rig(hand, scene))
    starts = round(CANDIDATES / SearchSettings().survivors)
    found = watch.time(
        f"search, a start of {starts}", lambda: search(hand, scene, count=starts, seed=seed), share=starts
    )
    for row in range(min(repeats, CANDIDATES)):
        program = program_of_candidate(hand, scene, found, row)
        result = watch.time("polish", lambda program=program: solve(program))
        watch.count("tried")
        if result.success:
            outcome = watch.time("certificate and pre-grasp", lambda r=result: finish_grasp(hand, r.point))
            if outcome.grasp is not None:
                watch.count("certified")
                verdict = watch.time("lift", lambda grasp=outcome.grasp: simulate_lift(rig, grasp))
                watch.count("lifted", int(verdict.success))
        tick()
