"""`xdex evaluate`: how good a model's grasps are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from xdex_drake.cli.output import check_writable, keeping_finished_work, one_thread, print_yaml, progress, table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xdex_drake.evaluation.verdicts import Verdict

HEADER = (
    *("stage", "hand", "judged", "lifted", "95 %", "grasps"),
    *("depth [cm]", "moved [cm]", "tips [mm]", "s a draw", "why not"),
)
REASONS = 4
"""Reasons that a line names."""


@dataclass(frozen=True)
class Evaluate:
    """Judges a model: draws for hands on objects, taken to each stage and lifted. Or shows where its grasps get lost.

    Without --ladder a configuration names hands by groups, objects, stages and how many draws are judged; `raw` is
    inverse kinematics alone, `refined` the certified grasp near the draw, `best` one of many draws, chosen before any
    is lifted. A draw that became no grasp is a failure. Stopped runs go on when the same command is given again.
    With --ladder, lifted grasps of a data set are lifted again, put through inverse kinematics, encoded and decoded,
    and drawn anew, each step raw and refined: the step at which they stop lifting is the one to mend.
    Try `xdex evaluate studies/learning/bench.yaml --out bench`, or
    `xdex evaluate --ladder --data pairs --model model --out ladder`.

    Attributes:
        config: A YAML file for the bench; `--print-config` prints what it may say.
        out: Folder of verdicts, grasps and tables.
        ladder: Show where grasps get lost, instead.
        data: Folder of a data set for the ladder, of scenes that the model has not seen.
        model: A checkpoint, or the folder that holds it; in place of the configuration's.
        unseen: Hands of the ladder that the model has not seen, which are counted apart.
        count: Grasps of the ladder.
        seed: Seed of the ladder.
        workers: Number of processes.
        print_config: Print the resolved configuration and do nothing.
    """

    config: tyro.conf.Positional[Path | None] = None
    out: Path = Path("evaluation")
    ladder: tyro.conf.FlagCreatePairsOff[bool] = False
    data: Path | None = None
    model: Path | None = None
    unseen: tuple[str, ...] = ()
    count: int = 40
    seed: int = 0
    workers: int = 2
    print_config: tyro.conf.FlagCreatePairsOff[bool] = False

    def run(self) -> int:
        """Judges, prints a table, writes it beside the verdicts."""
        one_thread()
        from xdex_drake.errors import ConfigError

        if self.workers < 0 or self.count < 1 or self.seed < 0:
            raise ConfigError("--workers and --seed must be 0 or more, --count 1 or more")
        return self._ladder() if self.ladder else self._bench()

    def _bench(self) -> int:
        from dataclasses import replace

        from xdex_drake.errors import ConfigError
        from xdex_drake.evaluation.bench import BenchConfig, finished, missing_cells, run_bench
        from xdex_drake.typed_yaml import read_typed_yaml

        config = BenchConfig() if self.config is None else read_typed_yaml(self.config, BenchConfig)
        config = config if self.model is None else replace(config, model=str(self.model))
        if self.print_config:
            return print_yaml(config)
        if self.config is None:
            raise ConfigError("no configuration file is given; begin with `xdex evaluate --print-config`, or --ladder")
        check_writable(self.out / "bench.json")
        with keeping_finished_work() as interruption, progress(missing_cells(config, self.out), "cells") as bar:

            def tell(_: object) -> None:
                bar.update()

            run_bench(config, self.out, workers=self.workers, on_done=tell)
        verdicts = list(finished(config, self.out))
        _tell(verdicts, self.out)
        if interruption.happened:
            print("interrupted: give the same command again to go on")
        return interruption.status(0 if verdicts else 1)

    def _ladder(self) -> int:
        from xdex_drake.errors import ConfigError
        from xdex_drake.evaluation.ladder import climb, rungs
        from xdex_drake.learning.proposer import default_checkpoint

        if self.data is None:
            raise ConfigError("--ladder needs --data, a data set of scenes that the model has not seen")
        check_writable(self.out / "verdicts.csv")
        model = self.model or default_checkpoint()
        some = rungs(self.data, model, unseen=self.unseen, count=self.count, seed=self.seed)
        verdicts: list[Verdict] = []
        with keeping_finished_work() as interruption, progress(len(some), "hands on scenes") as bar:

            def tell(_: object) -> None:
                bar.update()

            for verdict in climb(some, workers=self.workers, on_done=tell):
                verdicts.append(verdict)
        _tell(verdicts, self.out, by_hand=False)
        return interruption.status(0 if verdicts else 1)


def _tell(verdicts: Sequence[Verdict], out: Path, *, by_hand: bool = True) -> None:
    """Prints the table, and writes it as `table.txt` beside all verdicts, `verdicts.csv`."""
    from dataclasses import replace

    from xdex_drake.evaluation.verdicts import lines, write_verdicts
    from xdex_drake.whole_file import write_text

    out.mkdir(parents=True, exist_ok=True)
    write_verdicts(out / "verdicts.csv", verdicts)
    shown = verdicts if by_hand else [replace(v, hand=v.group) for v in verdicts]
    rows = [
        (
            line.stage,
            line.name,
            line.trials,
            f"{line.lifted:.2f}",
            f"{line.low:.2f} to {line.high:.2f}",
            f"{line.found:.2f}",
            f"{line.penetration_cm:.3f}",
            f"{line.moved_cm:.1f}",
            f"{line.tip_mm:.1f}",
            f"{line.seconds:.2f}",
            ", ".join(f"{name} {count}" for name, count in list(line.reasons.items())[:REASONS]) or "-",
        )
        for line in lines(shown)
    ]
    text = table(rows, HEADER)
    write_text(out / "table.txt", text + "\n")
    print(text)
    print(f"verdicts in {out / 'verdicts.csv'}")
