"""`xdex judge`: grasps of any origin are certified and simulated as they are given."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from xdex_drake.cli.output import check_output_file, counts, keeping_finished_work, one_thread, progress, table

if TYPE_CHECKING:
    from xdex_drake.evaluation.judge import Judgement, JudgeUnit
    from xdex_drake.interchange.naming import HandRecord
    from xdex_drake.scene.object import ObjectModel

SHOWN = 20
"""Grasps that have a line of their own in the table."""


@dataclass(frozen=True)
class Judge:
    """Grasps of another tool, or stored ones, judged as they are: certified, measured, and simulated by protocols.

    FILE is isaac_grasp YAML, a dictionary of DexGraspBench, BODex, Dexonomy or HUGS (.npy, .npz), dexgraspdb JSON, an
    .npz archive of joint arrays, or Parquet of this library. Pickled .npy files are read by a reader that knows arrays
    and containers alone, and refuses any other without running it.

    Joints are matched by name, and the poses are of the link that the file names. Where a file names neither, say so:
    `--joint-order actuated`, or names in their order; `--frame palm`, or `--frame wrist` for the wrist frame of this
    library, or a pose in a link, `--frame palm 0 0 -0.034`. What a file lacks, a pre-grasp or a squeeze, is made by one
    rule for all. An object whose pose the file does not tell lies at its most probable pose at which the hand is above
    the table.

    Try `xdex judge grasps.yaml --hand allegro --object mug`, or
    `xdex judge grasp.npy --hand shadow --object mesh.obj --protocol bench-fc --simulator drake --simulator mujoco`.

    Attributes:
        file: The file of grasps.
        hand: A library name, a generated hand such as g0-0137, or the path of a hand's file; as the file names it where
            not given.
        object: A library name or the path of a mesh, for all grasps; as the file names it where not given, beside it.
        format: The format; told by the file's suffix and content where not given.
        frame: The link whose poses the file has, or `wrist`; then x y z [m], or x y z qw qx qy qz, of a frame in it.
        joint_order: Names of the joints in the order of the values, or `actuated`, or `all`.
        scale: Factor from the mesh file's unit to metres; the file's, or guessed, where not given.
        mass: Mass of the object [kg].
        friction: Coefficient of friction.
        kp: Gain of the joints that the file's squeeze is for [N m/rad]; 5 for DexGraspBench's, else 1.
        protocol: Names of protocols (see `xdex lift --help`), repeatable; lift-0.2/2tips where not given.
        simulator: Drake where not given; mujoco needs `pip install 'xdex_drake[mujoco]'`. Repeatable.
        out: The table as Parquet, a row a grasp.
        grasps: Also write the grasps as a file of this library, for `xdex view` and `xdex lift`.
        workers: Number of processes that work; 0 for this one alone.
    """

    file: tyro.conf.Positional[Path]
    hand: str | None = None
    object: str | None = None
    format: Literal["isaac_grasp", "dexgraspbench", "dexgraspdb", "arrays", "parquet"] | None = None
    frame: tuple[str, ...] = ()
    joint_order: tuple[str, ...] = ()
    scale: float | None = None
    mass: float = 0.1
    friction: float = 0.6
    kp: float | None = None
    protocol: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    simulator: tyro.conf.UseAppendAction[tuple[Literal["drake", "mujoco"], ...]] = ()
    out: Path = Path("judged.parquet")
    grasps: Path | None = None
    workers: int = 2

    def run(self) -> int:
        """Judges, writes, prints."""
        one_thread()
        for path in (self.out, self.grasps):
            if path is not None:
                check_output_file(path, ".parquet")
        from xdex_drake.dataset.grasp_file import write_grasps
        from xdex_drake.dataset.rows import rows_of
        from xdex_drake.evaluation.judge import judge_all, row_of, write_judgements
        from xdex_drake.jobs.workbench import hand_of, scene_of
        from xdex_drake.simulation.mujoco import mujoco_module
        from xdex_drake.simulation.protocol import find_protocol

        protocols = tuple(dict.fromkeys(self.protocol)) or ("lift-0.2/2tips",)
        for name in protocols:
            find_protocol(name)
        simulators = tuple(dict.fromkeys(self.simulator)) or ("drake",)
        if "mujoco" in simulators:
            mujoco_module()
        stored = self.format == "parquet" or (self.format is None and self.file.suffix.lower() == ".parquet")
        units = self._stored_units() if stored else self._units()
        units = [replace(unit, protocols=protocols, simulators=simulators) for unit in units]
        begin, rows, grasp_rows, found = time.perf_counter(), [], [], []
        with keeping_finished_work() as interruption, progress(len(units), "judge") as bar:
            for unit, judgement, grasp in judge_all(units, workers=max(0, self.workers)):
                found.append(judgement)
                rows.append({"hand": unit.grasp.hand, "object": unit.grasp.object, **row_of(judgement)})
                if self.grasps is not None:
                    grasp_rows += rows_of([grasp], hand_of(unit.hand), scene_of(unit.scene))
                bar.update()
        _tell(found, units)
        if rows:
            write_judgements(self.out, rows)
            print(f"{len(rows)} judged in {time.perf_counter() - begin:.1f} s: {self.out}")
        if self.grasps is not None and grasp_rows:
            write_grasps(self.grasps, grasp_rows)
            print(f"grasps: {self.grasps}")
        return interruption.status(0 if any(one.certified for one in found) else 1)

    def _stored_units(self) -> list[JudgeUnit]:
        """Grasps of this library's own files."""
        from xdex_drake.dataset.files import load_grasps
        from xdex_drake.errors import ConfigError
        from xdex_drake.evaluation.judge import JudgeUnit

        told = ("object", "frame", "joint_order", "scale", "kp")
        if given := [name for name in told if getattr(self, name) not in (None, ())]:
            raise ConfigError(
                f"--{given[0].replace('_', '-')}: files of this library tell that themselves; leave it out"
            )
        stored = load_grasps(self.file)
        if not stored:
            raise ConfigError(f"{self.file}: holds no grasps")
        strange = {item.hand.name for item in stored if self.hand not in (None, item.hand.name, item.hand_path)}
        if strange:
            raise ConfigError(
                f"{self.file}: holds grasps by {sorted(strange)[0]}, not by {self.hand}; leave --hand out"
            )
        return [
            JudgeUnit(k, replace(item.grasp, lift=None), item.facts, item.hand_path, 0.0, (), ())
            for k, item in enumerate(stored)
        ]

    def _units(self) -> list[JudgeUnit]:
        """Grasps of another tool's file, all checked before any is judged."""
        from xdex_drake.errors import GraspFileError
        from xdex_drake.evaluation.judge import JudgeUnit, placed, scene_for
        from xdex_drake.hand.library import load_hand
        from xdex_drake.interchange.formats import FORMATS, format_of
        from xdex_drake.interchange.naming import convention_of, parse_frame, parse_order, resolve
        from xdex_drake.interchange.records import check_size
        from xdex_drake.scene.facts import SceneFacts

        check_size(self.file)
        name = self.format or format_of(self.file)
        form = FORMATS[name]
        records = form.read(self.file)
        hand_name = self.hand or next((record.hand for record in records if record.hand), "")
        if not hand_name:
            raise GraspFileError(f"{self.file}: names no hand; give it by --hand")
        hand = load_hand(hand_name)
        frame = parse_frame(self.frame, hand) if self.frame else None
        order = parse_order(self.joint_order, hand) if self.joint_order else None
        known = convention_of(name, hand)
        resolved = [
            resolve(record, hand, str(self.file), frame=frame, joint_order=order, convention=known)
            for record in records
        ]
        models = self._objects(resolved)
        units = []
        for k, (record, model) in enumerate(zip(resolved, models, strict=True)):
            scene, _ = scene_for(record, hand, model)
            grasp = placed(record, hand, scene, self.kp or form.kp)
            off = record.grasp.off_coupling
            units.append(JudgeUnit(k, grasp, SceneFacts.of(scene), hand_name, off, (), ()))
        return units

    def _objects(self, records: Sequence[HandRecord]) -> list[ObjectModel]:
        """The object of each grasp, equal ones shared."""
        from xdex_drake.scene.object import load_object

        models: dict[tuple[str, float | None], ObjectModel] = {}
        found = []
        for item in records:
            path = self.object or _object_of(item, self.file)
            key = (path, self.scale or item.record.scale)
            if key not in models:
                models[key] = load_object(path, scale=key[1], mass=self.mass, friction=self.friction)
            found.append(models[key])
        return found


def _object_of(item: HandRecord, file: Path) -> str:
    """The object that a file names: one of the library, or a mesh in the file's own folder or below."""
    from xdex_drake.errors import GraspFileError
    from xdex_drake.scene.generator import is_shape_name
    from xdex_drake.scene.procedural import list_objects

    name = item.record.object
    if name in list_objects() or is_shape_name(name):
        return name
    folder = file.resolve().parent
    path = (folder / name).resolve() if name else folder
    if not (path.is_file() and path.is_relative_to(folder)):
        told = f"its object {name!r} is neither of the library nor a mesh beside it" if name else "it names no object"
        raise GraspFileError(f"{file}: {told}; give the mesh by --object")
    return str(path)


def _tell(found: Sequence[Judgement], units: Sequence[JudgeUnit]) -> None:
    """Prints what was found: a line a grasp where they are few, then one for each judge."""
    if not found:
        return
    names = [verdict.protocol for verdict in found[0].verdicts]
    if len(found) <= SHOWN:
        rows = [
            (
                one.name[-28:],
                one.certified,
                one.task_margin,
                one.ball_margin,
                1e3 * one.penetration_m,
                *(verdict.passed for verdict in one.verdicts),
                (one.reason or next((v.failure_reason for v in one.verdicts if not v.passed), ""))[:48],
            )
            for one in found
        ]
        print(table(rows, ("grasp", "certified", "task margin", "ball margin", "depth [mm]", *names, "reason")) + "\n")
    total = len(found)
    reasons = Counter(one.reason.split(":")[0] for one in found if one.reason)
    lines = [("certificate", sum(one.certified for one in found), total, counts(reasons))]
    for k, name in enumerate(names):
        failed = Counter(one.verdicts[k].failure_reason or "dropped" for one in found if not one.verdicts[k].passed)
        lines.append((name, sum(one.verdicts[k].passed for one in found), total, counts(failed)))
    print(table(lines, ("judge", "passed", "of", "failed by")))
    if made := Counter(what for one in found for what in one.made):
        print("made by rule, for the file has none: " + ", ".join(f"{what} {n}" for what, n in made.items()))
