"""`xdex grasp`, `retarget` and `lift`: grasps are made, carried over and validated."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from xdex_drake.cli.output import (
    check_output_file,
    facts,
    keeping_finished_work,
    one_thread,
    progress,
    table,
    tell_repairs,
    waiting,
)

if TYPE_CHECKING:
    from xdex_drake.dataset.files import StoredGrasp
    from xdex_drake.grasp import Grasp, Lift
    from xdex_drake.hand.description import Hand


@dataclass(frozen=True)
class GraspCommand:
    """Grasps of one object by one hand: searched for, optimised, certified and lifted.

    Every candidate is polished by a mathematical program, proved by a convex program, and lifted in simulation; the
    file holds those that passed. The same seed gives the same grasps whatever the number of workers.
    Try `xdex grasp --hand allegro --object mug --count 10 --html mug.html`.

    Attributes:
        hand: A library name, a generated hand such as g0-0137, or the path of a .yaml, .urdf, .xml or .sdf file.
        object: A library name, a generated shape such as s0-0042, or the path of a mesh.
        count: How many grasps that lift are wanted.
        seed: Seed of the search; another seed gives other grasps.
        out: The file of grasps.
        scale: Factor from the mesh file's unit to metres; guessed by the size where not given.
        mass: Mass of the object [kg].
        density: Density [kg/m^3] of the material, that of the walls of a cup; instead of the mass.
        friction: Coefficient of friction.
        scene_seed: Choice of the pose at which the object rests on the table; 0 is the most probable one.
        pose: Number of that pose, as `xdex object show` lists them; instead of --scene-seed.
        upright: Take the pose at which z of the object's file points up; instead of --scene-seed.
        obstacle: Something that is fixed beside the object, as OBJECT@x,y,z or OBJECT@x,y,z,yaw in metres and degrees,
            such as 0.02x0.3x0.2@0.12,0,0 for a wall; may be given more than once.
        table_height: Height of the table's top [m].
        no_table: The object floats, and a hand may come from anywhere; a grasp is then judged by protocol release:
            the object is kept in place until it is squeezed, let go, and held for two seconds.
        contacts: Greatest number of fingers that touch.
        grasp_type: any, pinch (thumb and one finger), tripod (thumb and two) or power (with the palm).
        approach: Direction in which the palm comes, within 20 degrees, such as 0 0 -1 for from above.
        region: Part of the object on which contacts lie, in its file's frame: bounds in metres such as z=0.06: or
            x=-0.02:0.02,z=0:0.1, or the path of a closed mesh.
        time_limit: Seconds after which what was found is all there is.
        keep_failed: Store certified grasps that did not lift, too, flagged by `success`.
        html: Also write a page that replays the first grasps.
        workers: Number of processes that work; one that crashes costs the batch it works on.
    """

    hand: str
    object: str
    count: int = 10
    seed: int = 0
    out: Path = Path("grasps.parquet")
    scale: float | None = None
    mass: float = 0.1
    density: float | None = None
    friction: float = 0.6
    scene_seed: int = 0
    pose: int | None = None
    upright: tyro.conf.FlagCreatePairsOff[bool] = False
    obstacle: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    table_height: float = 0.0
    no_table: tyro.conf.FlagCreatePairsOff[bool] = False
    contacts: int = 4
    grasp_type: Literal["any", "pinch", "tripod", "power"] = "any"
    approach: tuple[float, float, float] | None = None
    region: str | None = None
    time_limit: float = 120.0
    keep_failed: tyro.conf.FlagCreatePairsOff[bool] = False
    html: Path | None = None
    workers: int = 2

    def run(self) -> int:
        """Makes the grasps, writes them, prints the closing table."""
        one_thread()
        from xdex_drake.errors import ConfigError

        for name in ("count", "workers"):
            if getattr(self, name) < 1:
                raise ConfigError(f"--{name} is {getattr(self, name)}; give 1 or more")
        if (self.pose is not None) + self.upright + (self.scene_seed > 0) > 1:
            raise ConfigError("--pose, --upright and --scene-seed each choose how the object lies; give one of them")
        if self.no_table and self.table_height != 0.0:
            raise ConfigError("--no-table and --table-height contradict each other; give one of them")
        if self.seed < 0 or self.scene_seed < 0:
            raise ConfigError("--seed and --scene-seed must be 0 or more")
        if not self.time_limit > 0.0:
            raise ConfigError(f"--time-limit is {self.time_limit:g}; give a number of seconds greater than zero")
        check_output_file(self.out, ".parquet")
        if self.html is not None:
            check_output_file(self.html, ".html")
        begin = time.perf_counter()
        # Names first: what is wrong with them is told before the search and its torch are imported.
        from xdex_drake.hand.library import load_hand
        from xdex_drake.scene.object import check_object_name
        from xdex_drake.scene.region import read_region

        check_object_name(self.object)
        region = None if self.region is None else read_region(self.region)
        hand = load_hand(self.hand)
        from xdex_drake.jobs.preparation import SceneRequest, prepare_in_time

        wanted = SceneRequest(
            self.hand,
            self.object,
            scale=self.scale,
            mass=self.mass,
            density=self.density,
            friction=self.friction,
            seed=self.scene_seed,
            pose=self.pose,
            upright=self.upright,
            table=None if self.no_table else self.table_height,
            obstacles=self.obstacle,
            contacts=self.contacts,
            grasp_type=self.grasp_type,
        )
        with waiting(f"preparing {Path(self.object).name}") as tell:
            ready = prepare_in_time(wanted, timeout_s=self.time_limit - (time.perf_counter() - begin), on_wait=tell)
        if ready is None:
            print(
                f"no grasp: preparing {self.object} took more than --time-limit {self.time_limit:g} s; give it more "
                "time, or a simpler mesh"
            )
            return 1
        if ready.scene is not None:
            tell_repairs(ready.scene.object)
        if ready.obstacle or ready.scene is None:
            print(f"{hand.name} cannot hold {Path(self.object).stem}: {ready.obstacle}")
            return 1
        scene = ready.scene
        model = scene.object
        from xdex_drake.dataset.files import save_grasps
        from xdex_drake.grasping.tally import Tally, counted
        from xdex_drake.jobs.grasps import GraspRequest, synthesize_batches
        from xdex_drake.programs.obstacles import sizes
        from xdex_drake.programs.search import SearchSettings, places_in
        from xdex_drake.programs.search.settings import check_approach
        from xdex_drake.programs.terms import FIRM
        from xdex_drake.scene.facts import SceneFacts

        search = SearchSettings(
            terms=FIRM,
            contacts=self.contacts,
            grasp_type=self.grasp_type,
            approach=self.approach,
            region=region,
        )
        if scene.table is not None:
            check_approach(self.approach)
        if region is not None:
            places_in(scene, region)
        preparation = time.perf_counter() - begin
        request = GraspRequest(self.hand, SceneFacts.of(scene), self.seed, search=search)
        tally, batches_done = Tally(), 0
        kept: list[Grasp] = []
        lifted = 0
        # One or two grasps are the work of one batch.
        workers = 1 if self.count <= 2 else self.workers
        with keeping_finished_work() as interruption, progress(self.count, f"{hand.name} {model.name}") as bar:
            batches = synthesize_batches(
                request,
                count=self.count,
                workers=workers,
                time_limit_s=max(0.0, self.time_limit - preparation),
                tally=tally,
            )
            for batch in batches:
                for grasp in batch.grasps:
                    success = grasp.lift is not None and grasp.lift.success
                    if lifted < self.count and (success or self.keep_failed):
                        kept.append(grasp)
                    if success and lifted < self.count:
                        lifted += 1
                        bar.update()
                bar.set_postfix(tried=tally.tried, certified=tally.certified)
                batches_done += 1
                if batches_done == 1 and not tally.certified:
                    told = f"none of the first {tally.tried} candidates is a grasp; {_why(tally.rejected)}"
                    bar.write(f"{told}; going on for up to {self.time_limit:g} s", file=sys.stderr)
        if kept:
            save_grasps(self.out, kept, hand, scene, hand_path=self.hand if Path(self.hand).suffix else None)
        print(
            facts(
                [
                    ("hand", hand.name),
                    ("object", model.name),
                    ("tried", tally.tried),
                    ("certified", tally.certified),
                    ("lifted", tally.lifted),
                    ("lifted of certified", tally.rate),
                    ("seconds", f"{tally.seconds:.1f}"),
                    ("preparation seconds", f"{preparation:.1f}"),
                    ("rejected by", counted(tally.rejected)),
                    ("failed by", counted(tally.failed)),
                    *([("lost batches", len(tally.lost))] if tally.lost else []),
                    *([("most likely to hold", _most_likely(kept))] if kept else []),
                    ("written", f"{len(kept)} to {self.out}" if kept else "nothing"),
                ]
            )
        )
        if tally.tried and not tally.certified:
            print(f"no grasp: {_why(tally.rejected)}\n{sizes(hand, scene)}")
        if kept and self.html is not None:
            from xdex_drake.cli.show import write_replays

            write_replays(self.html, kept[:3], hand, scene)
            print(f"replays: {self.html}")
        return interruption.status(0 if lifted else 1)


def _most_likely(grasps: Sequence[Grasp]) -> str:
    """The row of the grasp that is most likely to hold, with its probability."""
    import numpy as np

    from xdex_drake.grasping.scores import hold_probability

    hold = hold_probability(grasps)
    best = int(np.argmax(hold))
    return f"row {best}, P(hold) {hold[best]:.2f}; median {np.median(hold):.2f}"


def _why(rejected: Mapping[str, int]) -> str:
    """What candidates were rejected for most often, in words."""
    from xdex_drake.grasping.reasons import in_words

    most = max(rejected, key=lambda reason: rejected[reason], default="")
    return f"most often, {in_words(most)}" if most else "nothing was tried"


@dataclass(frozen=True)
class Retarget:
    """The same grasps by other hands: fingertips and wrist are matched by the names of the fingers.

    Every result is optimised, certified and lifted like any grasp; it names its source in `source_grasp_id`.
    Try `xdex retarget grasps.parquet --to shadow ability --out pairs.parquet`.

    Attributes:
        file: A file of grasps.
        to: The hands to carry them to.
        out: The file of retargeted grasps.
        keep_failed: Store certified grasps that did not lift, too, flagged by `success`.
        workers: Number of processes that work; one that crashes costs the grasp it works on.
    """

    file: tyro.conf.Positional[Path]
    to: tuple[str, ...]
    out: Path = Path("grasps_retargeted.parquet")
    keep_failed: tyro.conf.FlagCreatePairsOff[bool] = False
    workers: int = 2

    def run(self) -> int:
        """Retargets, writes, prints a line a hand."""
        one_thread()
        check_output_file(self.out, ".parquet")
        from xdex_drake.errors import ConfigError
        from xdex_drake.hand.library import load_hand

        if not self.to:
            raise ConfigError("--to names no hand; give at least one")
        targets = {target: load_hand(target) for target in self.to}
        from xdex_drake.dataset.files import hand_paths_entry, surroundings_entry
        from xdex_drake.dataset.grasp_file import write_grasps
        from xdex_drake.dataset.rows import rows_of
        from xdex_drake.grasping.tally import Tally
        from xdex_drake.jobs.stored import retarget_all, retarget_units

        stored = _grasps_of(self.file)
        for line in _other_sides({item.hand.name: item.hand for item in stored}.values(), targets):
            print(line, file=sys.stderr)
        units = retarget_units(stored, self.to)
        rows = []
        tallies = {target: Tally() for target in self.to}
        begin = time.perf_counter()
        with keeping_finished_work() as interruption, progress(len(units), "retarget") as bar:
            for unit, outcome in retarget_all(units, workers=max(1, self.workers)):
                tallies[unit.target].add(outcome)
                bar.update()
                grasp = outcome.grasp
                if grasp is None or grasp.lift is None:
                    continue
                tallies[unit.target].seconds += grasp.seconds
                if grasp.lift.success or self.keep_failed:
                    item = stored[unit.index]
                    points = {item.grasp.grasp_id: item.row["object_point_O"]}
                    rows += rows_of([grasp], targets[unit.target], item.scene, source_points=points)
        if rows:
            files = {hand.name: target for target, hand in targets.items() if Path(target).suffix}
            around = surroundings_entry(item.facts for item in stored)
            write_grasps(self.out, rows, metadata=hand_paths_entry(files) | around)
        lines = [(target, *t.row(), t.seconds / max(1, t.certified)) for target, t in tallies.items()]
        print(table(lines, ("hand", "tried", "certified", "lifted", "rejected by", "failed by", "s a grasp")))
        print(f"{len(rows)} of {len(units)} written to {self.out}" if rows else "nothing written")
        print(f"{time.perf_counter() - begin:.1f} s")
        return interruption.status(0 if any(t.lifted for t in tallies.values()) else 1)


def _other_sides(sources: Collection[Hand], targets: Mapping[str, Hand]) -> list[str]:
    """What is to be said of hands that take over grasps of the other side's hands."""
    told = []
    for target, hand in targets.items():
        names = sorted(source.name for source in sources if source.side != hand.side)
        if names:
            other = {"right": "left", "left": "right"}[hand.side]
            told.append(
                f"{target} is a {hand.side} hand and {names[0]} a {other} one: fingers are matched by name, and the "
                f"thumb comes from the other side; `xdex hand mirror {target} --out FILE.yaml` makes a {other} one"
            )
    return told


@dataclass(frozen=True)
class LiftCommand:
    """Lifts stored grasps again, each from its pre-grasp, and stores the new verdicts.

    Try `xdex lift grasps.parquet`; with the same library and protocol every verdict repeats. With `--robust 5` a lift
    succeeds where it does under five errors of the wrist's pose (up to 5 mm and 5 degrees), with 0.75 times the
    friction, and with twice the mass. With `--protocol hold` the lifted object is held for two seconds and
    pushed by its weight from six sides. `--simulator mujoco` plays the same protocol in MuJoCo, a second judge;
    `--simulator drake --simulator mujoco` asks both and stores the verdicts of the first.

    Attributes:
        file: A file of grasps with pre-grasp and squeeze.
        simulator: Drake where not given; mujoco needs `pip install 'xdex_drake[mujoco]'`. May be given twice.
        protocol: Name of the protocol: lift-0.2/2tips, hold, frogger-lift, bench-lift or lift-0.5-like; without weight
            bench-fc, push-6-weak, grav-6-all, grav-6-any or shake-6-like; release for objects that float. Where not
            given the first, and for those that float the last.
        robust: Number of errors of pose under which each lift is repeated; 0 for one lift as it is.
        out: The file with the new verdicts.
        workers: Number of processes that work; one that crashes costs the lift it works on, which counts as failed.
    """

    file: tyro.conf.Positional[Path]
    simulator: tyro.conf.UseAppendAction[tuple[Literal["drake", "mujoco"], ...]] = ()
    protocol: str = ""
    robust: int = 0
    out: Path = Path("grasps_lifted.parquet")
    workers: int = 2

    def run(self) -> int:
        """Lifts, writes, prints a line a hand and object."""
        one_thread()
        check_output_file(self.out, ".parquet")
        from xdex_drake.dataset.files import hand_paths, hand_paths_entry, surroundings_entry
        from xdex_drake.dataset.grasp_file import write_grasps
        from xdex_drake.dataset.schema import lift_columns
        from xdex_drake.errors import ConfigError
        from xdex_drake.jobs.stored import lift_all, lift_units
        from xdex_drake.simulation.mujoco import mujoco_module
        from xdex_drake.simulation.protocol import LIFT, LiftProtocol, find_protocol

        protocol = find_protocol(self.protocol) if self.protocol else LIFT
        if self.robust < 0:
            raise ConfigError(f"--robust is {self.robust}; give 0 or more")
        if self.robust and not isinstance(protocol, LiftProtocol):
            raise ConfigError(f"--robust repeats lifts, and {protocol.name} is none; leave one of them out")
        stored = _grasps_of(self.file)
        unready = [item.grasp.grasp_id for item in stored if item.grasp.tau_squeeze is None]
        if unready:
            raise ConfigError(f"{self.file}: grasp {unready[0]} has no squeeze; make it with `xdex grasp`")
        simulators = tuple(dict.fromkeys(self.simulator)) or ("drake",)
        if "mujoco" in simulators:
            mujoco_module()
        units = lift_units(stored, protocol=self.protocol, robust=self.robust, simulators=simulators)
        verdicts: dict[str, dict[int, Lift]] = {simulator: {} for simulator in simulators}
        with keeping_finished_work() as interruption, progress(len(units), "lift") as bar:
            for unit, verdict in lift_all(units, workers=max(1, self.workers)):
                verdicts[unit.simulator][unit.index] = verdict
                bar.update()
        first = verdicts[simulators[0]]
        rows = [stored[k].row | lift_columns(first[k]) for k in sorted(first)]
        if rows:
            around = surroundings_entry(item.facts for item in stored)
            write_grasps(self.out, rows, metadata=hand_paths_entry(hand_paths(self.file)) | around)
        lines = [line for simulator in simulators for line in _lift_lines(stored, simulator, verdicts[simulator])]
        header = ("hand", "object", "simulator", "grasps", "lifted", "held", "as before", "failed by", "dropped by")
        if protocol.hold is None:  # Nothing is held then but what is lifted.
            lines, header = [(*line[:5], *line[6:8]) for line in lines], (*header[:5], *header[6:8])
        print(table(lines, header))
        if len(simulators) > 1:
            both = [k for k in sorted(first) if all(k in one for one in verdicts.values())]
            same = sum(len({one[k].passed for one in verdicts.values()}) == 1 for k in both)
            print(f"{' and '.join(simulators)} agree on {same} of {len(both)}")
        print(f"{len(rows)} written to {self.out}" if rows else "nothing written")
        return interruption.status(0 if any(lift.success for lift in first.values()) else 1)


def _lift_lines(stored: Sequence[StoredGrasp], simulator: str, verdicts: Mapping[int, Lift]) -> list[tuple]:
    """A line for each hand and object: grasps, lifted and held ones, verdicts as before, failure reasons."""
    from xdex_drake.grasping.tally import Tally, counted

    tallies: dict[tuple[str, str], Tally] = {}
    same: Counter[tuple[str, str]] = Counter()
    for k in sorted(verdicts):
        row = stored[k].row
        key = (row["hand"], row["object"])
        tallies.setdefault(key, Tally()).add_lift(verdicts[k])
        same[key] += verdicts[k].success == row["success"]
    return [
        (*key, simulator, t.simulated, t.lifted, t.held, same[key], counted(t.failed), counted(t.dropped))
        for key, t in tallies.items()
    ]


def _grasps_of(file: Path) -> list[StoredGrasp]:
    """The grasps of a file, at least one."""
    from xdex_drake.dataset.files import load_grasps
    from xdex_drake.errors import ConfigError

    stored = load_grasps(file)
    if not stored:
        raise ConfigError(f"{file}: holds no grasps; make some with `xdex grasp`")
    return stored
