"""`xdex predict`: grasps from the model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import tyro

from xdex_drake.cli.output import check_output_file, keeping_finished_work, one_thread, progress, table, tell_repairs


@dataclass(frozen=True)
class Predict:
    """Grasps from the model, for hands it has seen or not: drawn as link poses, turned into joints, polished, proved.

    `--stage refined` looks for a certified grasp within 2 cm of each draw, from several starts. `raw` takes the joints
    that inverse kinematics finds, and has no certificate. `best` keeps for each hand the one of its refined grasps that
    is foretold to hold best, and lifts that one alone. Equal draws for several hands give corresponding grasps.
    Without --model, the small model of the library is used.
    Try `xdex predict --hand shadow ability --object mug --count 20`.

    Attributes:
        hand: The hands: library names, generated ones such as g0-0137, or paths of .yaml, .urdf, .xml or .sdf files.
        object: A library name, a generated shape such as s0-0042, or the path of a mesh.
        count: Draws for each hand.
        stage: How far to take each draw.
        seed: Seed of the draws.
        model: A checkpoint, or the folder that holds it.
        out: The file of grasps.
        scale: Factor from the mesh file's unit to metres; guessed by the size where not given.
        mass: Mass of the object [kg].
        friction: Coefficient of friction.
        scene_seed: Choice of the pose at which the object rests on the table.
        keep_failed: Store certified grasps that did not lift, too, flagged by `success`.
        no_lift: Leave the lifts out; then every certified grasp is stored.
        workers: Number of processes that work; one that crashes costs the draws it works on.
    """

    hand: tuple[str, ...]
    object: str
    count: int = 20
    stage: Literal["raw", "refined", "best"] = "refined"
    seed: int = 0
    model: Path | None = None
    out: Path = Path("grasps_predicted.parquet")
    scale: float | None = None
    mass: float = 0.1
    friction: float = 0.6
    scene_seed: int = 0
    keep_failed: tyro.conf.FlagCreatePairsOff[bool] = False
    no_lift: tyro.conf.FlagCreatePairsOff[bool] = False
    workers: int = 2

    def run(self) -> int:
        """Predicts, lifts, writes, prints a line a hand."""
        one_thread()
        from xdex_drake.errors import ConfigError

        if not self.hand or min(self.count, self.workers) < 1 or min(self.seed, self.scene_seed) < 0:
            raise ConfigError("--hand needs a hand, --count and --workers 1 or more, --seed and --scene-seed 0 or more")
        check_output_file(self.out, ".parquet")
        from xdex_drake.hand.library import load_hand
        from xdex_drake.scene.object import load_object

        hands = {name: load_hand(name) for name in self.hand}
        shape = load_object(self.object, scale=self.scale, mass=self.mass, friction=self.friction)
        tell_repairs(shape)
        from xdex_drake.dataset.files import hand_paths_entry
        from xdex_drake.dataset.grasp_file import write_grasps
        from xdex_drake.dataset.rows import rows_of
        from xdex_drake.grasp import Grasp
        from xdex_drake.grasping.tally import Tally
        from xdex_drake.jobs.grasps import propose_batches
        from xdex_drake.jobs.workbench import rig_of
        from xdex_drake.learning.proposer import ModelProposer, best_grasp, default_checkpoint, load_model
        from xdex_drake.scene.facts import SceneFacts
        from xdex_drake.scene.tabletop import make_scene
        from xdex_drake.simulation.drake import simulate_lift

        checkpoint = self.model or default_checkpoint()
        load_model(str(checkpoint))  # a file that cannot be used is told before any work
        scene = make_scene(shape, seed=self.scene_seed)
        facts = SceneFacts.of(scene)
        rows, tallies = [], {name: Tally() for name in self.hand}
        certified: dict[str, list[Grasp]] = {name: [] for name in self.hand}
        batches = propose_batches(
            ModelProposer(str(checkpoint), stage="raw" if self.stage == "raw" else "refined"),
            self.hand,
            facts,
            count=self.count,
            seed=self.seed,
            lift=not self.no_lift and self.stage != "best",
            workers=self.workers,
        )
        with keeping_finished_work() as interruption, progress(self.count * len(hands), "predict") as bar:
            for unit, batch in batches:
                tallies[unit.hand].merge(batch.tally)
                bar.update(unit.count)
                if self.stage == "best":
                    certified[unit.hand] += batch.grasps
                    continue
                kept = [g for g in batch.grasps if g.lift is None or g.lift.success or self.keep_failed]
                rows += rows_of(kept, hands[unit.hand], scene)
            for name, found in certified.items():
                best = best_grasp(found)
                if best is not None:
                    if not self.no_lift:
                        lift = simulate_lift(rig_of(name, facts), best)
                        tallies[name].add_lift(lift)
                        best = replace(best, lift=lift)
                    rows += rows_of([best], hands[name], scene)
        if rows:
            files = {hand.name: name for name, hand in hands.items() if Path(name).suffix}
            write_grasps(self.out, rows, metadata=hand_paths_entry(files))
        lines = [(hands[name].name, *t.row(), t.seconds / max(1, t.tried)) for name, t in tallies.items()]
        print(table(lines, ("hand", "drawn", "certified", "lifted", "rejected by", "failed by", "s a draw")))
        print(f"{len(rows)} written to {self.out}" if rows else "nothing written")
        return interruption.status(0 if rows else 1)
