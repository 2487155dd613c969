"""`xdex predict`: grasps from the model."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from xdex_drake.cli.output import check_output_file, counts, keeping_finished_work, one_thread, progress, table


@dataclass(frozen=True)
class Predict:
    """Grasps from the model, for hands it has seen or not: drawn as link poses, turned into joints, polished, proved.

    Equal draws for several hands give corresponding grasps. Without --model, the small model of the library is used.
    Try `xdex predict --hand shadow ability --object mug --count 20`.

    Attributes:
        hand: The hands: library names, generated ones such as g0-0137, or paths of .yaml, .urdf, .xml or .sdf files.
        object: A library name, a generated shape such as s0-0042, or the path of a mesh.
        count: Draws for each hand.
        seed: Seed of the draws.
        model: A checkpoint, or the folder that holds it.
        out: The file of grasps.
        scale: Factor from the mesh file's unit to metres.
        mass: Mass of the object [kg].
        friction: Coefficient of friction.
        scene_seed: Choice of the pose at which the object rests on the table.
        keep_failed: Store certified grasps that did not lift, too, flagged by `success`.
        no_lift: Leave the lifts out; then every certified grasp is stored.
    """

    hand: tuple[str, ...]
    object: str
    count: int = 20
    seed: int = 0
    model: Path | None = None
    out: Path = Path("grasps_predicted.parquet")
    scale: float = 1.0
    mass: float = 0.1
    friction: float = 0.6
    scene_seed: int = 0
    keep_failed: tyro.conf.FlagCreatePairsOff[bool] = False
    no_lift: tyro.conf.FlagCreatePairsOff[bool] = False

    def run(self) -> int:
        """Predicts, lifts, writes, prints a line a hand."""
        one_thread()
        from xdex_drake.errors import ConfigError

        if not self.hand or self.count < 1 or self.seed < 0 or self.scene_seed < 0:
            raise ConfigError("--hand needs a hand, --count 1 or more, --seed and --scene-seed 0 or more")
        check_output_file(self.out, ".parquet")
        from xdex_drake.dataset.files import hand_paths_entry, rows_of
        from xdex_drake.dataset.grasp_file import write_grasps
        from xdex_drake.hand.library import load_hand
        from xdex_drake.learning.checkpoint import load_checkpoint
        from xdex_drake.learning.proposer import default_checkpoint, propose
        from xdex_drake.scene.object import load_object
        from xdex_drake.scene.tabletop import make_scene
        from xdex_drake.simulation.lift import lift_rig, simulate_lift

        hands = {name: load_hand(name) for name in self.hand}
        model = load_checkpoint(self.model or default_checkpoint())
        shape = load_object(self.object, scale=self.scale, mass=self.mass, friction=self.friction)
        scene = make_scene(shape, seed=self.scene_seed)
        rows, lines = [], []
        with keeping_finished_work() as interruption, progress(self.count * len(hands), "predict") as bar:
            for hand in hands.values():
                rig = None if self.no_lift else lift_rig(hand, scene)
                rejected: dict[str, int] = {}
                failed: dict[str, int] = {}
                certified = lifted = 0
                begin, lifting = time.perf_counter(), 0.0
                try:
                    proposals = propose(model, hand, scene, count=self.count, seed=self.seed)
                    for number, outcome in enumerate(proposals):
                        bar.update()
                        if outcome.grasp is None:
                            rejected[outcome.reason] = rejected.get(outcome.reason, 0) + 1
                            continue
                        certified += 1
                        name = outcome.grasp.grasp_id or f"{hand.name}-{scene.scene_id}-model-{self.seed}-{number}"
                        grasp = replace(outcome.grasp, grasp_id=name)
                        if rig is not None:
                            lift = simulate_lift(rig, grasp)
                            lifting += lift.seconds
                            grasp = replace(grasp, lift=lift)
                            lifted += lift.success
                            if not lift.success:
                                failed[lift.failure_reason] = failed.get(lift.failure_reason, 0) + 1
                        if rig is None or self.keep_failed or (grasp.lift is not None and grasp.lift.success):
                            rows += rows_of([grasp], hand, scene)
                finally:
                    each = (time.perf_counter() - begin - lifting) / self.count
                    lines.append((hand.name, self.count, certified, lifted, each, counts(rejected), counts(failed)))
        if rows:
            files = {hand.name: name for name, hand in hands.items() if Path(name).suffix}
            write_grasps(self.out, rows, metadata=hand_paths_entry(files))
        print(table(lines, ("hand", "drawn", "certified", "lifted", "s a draw", "rejected by", "failed by")))
        print(f"{len(rows)} written to {self.out}" if rows else "nothing written")
        return interruption.status(0 if rows else 1)
