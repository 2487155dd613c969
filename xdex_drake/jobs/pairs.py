"""Generates a paired data set: source grasps of a hand on a scene, carried to other hands, all lifted.

The unit of work is one source hand on one scene, its grasps, and the hands drawn for them: every grasp of the unit goes
to each of these, so that a hand and its rig are made once for many grasps. A unit depends on the configuration and its
own number only, so the rows are the same for any number of workers, and a run that was killed goes on with the units
that are missing.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import numpy as np

from xdex_drake.dataset.assets import copy_assets, keep_hand, keep_mesh, with_kept_mesh
from xdex_drake.dataset.folder import (
    Manifest,
    Rejected,
    completed_units,
    open_dataset,
    rejected_entry,
    write_failure,
    write_shard,
)
from xdex_drake.dataset.lock import locked
from xdex_drake.dataset.rows import rows_of, timeless
from xdex_drake.dataset.schema import Row
from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Grasp
from xdex_drake.grasping.retarget import retarget
from xdex_drake.grasping.synthesis import (
    SynthesisSettings,
    batch_seed,
    candidates_of_batch,
    lift_all,
    named,
    settings_of_batch,
)
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.description import Hand
from xdex_drake.hand.generation import GENERATOR, read_hand_name
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.yaml_file import hand_digest
from xdex_drake.jobs.compaction import compact_dataset, compact_shard, table_units
from xdex_drake.jobs.population import expand_names
from xdex_drake.jobs.processes import UnitResult, run_units
from xdex_drake.jobs.ray import run_units_on_ray
from xdex_drake.jobs.workbench import hand_of, use_one_thread
from xdex_drake.scene.generator import FAMILIES, RECIPE, family_name, is_shape_name
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import Scene, resting_scene
from xdex_drake.simulation.drake import LiftRig, shared_rig, simulate_lift
from xdex_drake.simulation.protocol import HOLD

COMMIT = "xdex_commit"
"""Entry of a shard's metadata: version and commit of the library that made its rows."""


@dataclass(frozen=True)
class DatasetConfig:
    """What a data set is to hold.

    Hands and objects are names, files, or ranges of generated ones: `g0-0000..g0-0999` stands for a thousand,
    `g0-0000..g0-0995/5` for every fifth of them (the human ones), and `-g0-0137` takes one away.

    Attributes:
        hands: The population: hands that receive grasps.
        source_hands: Hands that grasps are synthesised for; those of `hands` where empty.
        objects: Objects.
        without_families: Families of generated shapes that are left out of `objects`.
        scale: Least and greatest factor on the objects' size; one is drawn for each object.
        scenes_per_object: Scenes of each object: all its poses at rest take turns.
        units_per_scene: Source hands drawn for each scene; 0 takes all.
        targets: Hands drawn for the grasps of a unit; 0 takes all.
        candidates: Candidates of a search.
        searches: Greatest number of searches of a hand in a unit.
        sources_per_unit: Lifted source grasps at which a unit stops searching.
        mode: `paired` carries source grasps to the other hands; `unpaired` searches for every drawn hand by itself, in
            the same scenes.
        hold_every: One lift in so many goes on with the pushes of the protocol `hold`; 0 for none.
        keep_failed: Whether certified grasps whose lift failed are stored too, flagged as such.
        mass: Mass of every object [kg].
        seed: Seed.
    """

    hands: tuple[str, ...] = ("allegro", "shadow", "ability")
    source_hands: tuple[str, ...] = ()
    objects: tuple[str, ...] = ("box", "can", "ball")
    without_families: tuple[str, ...] = ()
    scale: tuple[float, ...] = (1.0, 1.0)
    scenes_per_object: int = 1
    units_per_scene: int = 0
    targets: int = 0
    candidates: int = 48
    searches: int = 1
    sources_per_unit: int = 16
    mode: Literal["paired", "unpaired"] = "paired"
    hold_every: int = 10
    keep_failed: bool = True
    mass: float = 0.1
    seed: int = 0


@dataclass(frozen=True)
class PairUnit:
    """A unit of work: one source hand on one scene, and the hands that its grasps go to.

    Attributes:
        name: Name, also of its shard.
        source: Name or path of the source hand.
        targets: Names or paths of the other hands.
        object: Name or path of the object.
        scale: Factor on its size.
        scene: Number of the scene among the object's.
        seed: Seed of its searches.
    """

    name: str
    source: str
    targets: tuple[str, ...]
    object: str
    scale: float
    scene: int
    seed: int


@dataclass(frozen=True)
class UnitRows:
    """What came of a unit.

    Attributes:
        rows: Rows of its grasps, sources before those that came from them.
        rejected: Retargetings that found nothing.
    """

    rows: tuple[Row, ...]
    rejected: tuple[Rejected, ...]


def plan(config: DatasetConfig) -> tuple[PairUnit, ...]:
    """The units of a data set, in order: a first source hand on every scene, then a second one, and so on.

    Args:
        config: The configuration.

    Returns:
        The units.

    Raises:
        ConfigError: A number is out of range, a list is empty or cannot be expanded, or a family is not known.
    """
    for name in ("scenes_per_object", "candidates", "searches", "sources_per_unit"):
        if getattr(config, name) < 1:
            raise ConfigError(f"{name}: {getattr(config, name)} must be at least 1")
    for name in ("units_per_scene", "targets", "hold_every"):
        if getattr(config, name) < 0:
            raise ConfigError(f"{name}: {getattr(config, name)} must be 0 or more")
    if len(config.scale) != 2 or not 0.0 < config.scale[0] <= config.scale[1]:
        raise ConfigError(f"scale: {list(config.scale)} must be two factors above zero, the smaller one first")
    hands, sources, objects = population(config)
    # One stream of random numbers for each choice, so that a change of one number leaves the other choices alone.
    scales = np.random.default_rng([config.seed, 1]).uniform(*config.scale, size=len(objects)).round(2)
    rounds = min(config.units_per_scene or len(sources), len(sources))
    units: list[list[PairUnit]] = [[] for _ in range(rounds)]
    for o, obj in enumerate(objects):
        for scene in range(config.scenes_per_object):
            rng = np.random.default_rng([config.seed, 2, o, scene])
            for turn, s in enumerate(_drawn(len(sources), rounds, rng)):
                others = [hand for hand in hands if hand != sources[s]]
                targets = tuple(others[k] for k in _drawn(len(others), config.targets or len(others), rng))
                name = f"{Path(obj).stem}-{scene}-{Path(sources[s]).stem}"
                seed = int(np.random.SeedSequence([config.seed, 3, o, scene, s]).generate_state(1)[0])
                units[turn].append(PairUnit(name, sources[s], targets, obj, float(scales[o]), scene, seed))
    return tuple(unit for turn in units for unit in turn)


def _drawn(size: int, count: int, rng: np.random.Generator) -> list[int]:
    """Some of the numbers below `size`, in the order in which they are drawn; all of them as they stand."""
    return list(range(size)) if count >= size else rng.choice(size, count, replace=False).tolist()


def population(config: DatasetConfig) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Hands, source hands and objects of a configuration, by name or path.

    Args:
        config: The configuration.

    Returns:
        The names, in order.

    Raises:
        ConfigError: A list is empty or cannot be expanded, or a family is not known.
    """
    unknown = sorted(set(config.without_families) - FAMILIES.keys())
    if unknown:
        raise ConfigError(f"without_families: {unknown[0]!r} is no family; there are {', '.join(FAMILIES)}")
    hands = expand_names(config.hands, "hands")
    sources = expand_names(config.source_hands, "source_hands") or hands
    objects = tuple(
        name
        for name in expand_names(config.objects, "objects")
        if not (is_shape_name(name) and family_name(name) in config.without_families)
    )
    if not hands or not objects:
        raise ConfigError("hands, objects: name at least one of each")
    return hands, sources, objects


@lru_cache(maxsize=2)
def scene_of_unit(obj: str, scale: float, index: int, mass: float, seed: int) -> Scene:
    """The scene of a unit; the last ones are kept.

    Args:
        obj: Name or path of the object.
        scale: Factor on its size.
        index: Number of the scene among the object's.
        mass: Mass [kg].
        seed: Seed.

    Returns:
        The scene.
    """
    model = load_object(obj, mass=mass)
    if scale != 1.0:
        model = load_object(obj, scale=round(model.scale * scale, 9), mass=mass)
    return resting_scene(model, index=index, seed=seed)


def run_unit(unit: PairUnit, config: DatasetConfig) -> UnitRows:
    """What comes of one unit; the same in every process.

    Args:
        unit: The unit.
        config: The configuration.

    Returns:
        Rows of source grasps, then of the grasps carried over from them, hand by hand; and what found nothing.
    """
    use_one_thread()
    scene = scene_of_unit(unit.object, unit.scale, unit.scene, config.mass, config.seed)
    if config.mode == "unpaired":
        found = [(hand_of(name), searched(hand_of(name), scene, unit.seed, config)) for name in unit.targets]
        return UnitRows(tuple(row for hand, grasps in found for row in _rows(grasps, hand, scene, config)), ())
    source = hand_of(unit.source)
    grasps = searched(source, scene, unit.seed, config)
    rows = _rows(grasps, source, scene, config)
    points: dict[str, Sequence[float]] = {row["grasp_id"]: row["object_point_O"] for row in rows}
    sources = [grasp for grasp in grasps if grasp.lift is not None and grasp.lift.success]
    rejected: list[Rejected] = []
    for k, name in enumerate(unit.targets):
        target = hand_of(name)
        carried = list(carry_over(sources, source, target, scene, config.hold_every, k * len(sources)))
        rejected += [attempt for attempt in carried if isinstance(attempt, Rejected)]
        lifted = [attempt for attempt in carried if isinstance(attempt, Grasp)]
        rows += _rows(lifted, target, scene, config, points)
    return UnitRows(tuple(rows), tuple(rejected))


def searched(hand: Hand, scene: Scene, seed: int, config: DatasetConfig) -> list[Grasp]:
    """Certified grasps of a hand with their lifts, until enough have lifted.

    Args:
        hand: The hand.
        scene: The scene.
        seed: Seed of the searches.
        config: The configuration.

    Returns:
        The grasps, each with an identifier of its own.
    """
    tally, rig, grasps = Tally(), shared_rig(hand, scene), []
    for batch in range(config.searches):
        settings = settings_of_batch(replace(SynthesisSettings(), batch=config.candidates), batch)
        found = candidates_of_batch(hand, scene, seed=batch_seed(seed, batch), settings=settings, tally=tally)
        for grasp in lift_all(rig, (named(grasp, scene, seed, batch) for grasp in found), tally):
            grasps.append(grasp)
            if tally.lifted >= config.sources_per_unit:
                return grasps
    return grasps


def carry_over(
    grasps: Sequence[Grasp], source: Hand, target: Hand, scene: Scene, hold_every: int, before: int
) -> Iterator[Grasp | Rejected]:
    """Retargets grasps and lifts the results.

    Args:
        grasps: The source grasps.
        source: Their hand.
        target: The other hand.
        scene: Their scene.
        hold_every: One attempt in so many is pushed after its lift; 0 for none.
        before: Attempts of the unit before these.

    Yields:
        Each grasp with its lift, or why there is none.
    """
    rig: LiftRig | None = None
    for number, grasp in enumerate(grasps, start=before + 1):
        outcome = retarget(grasp, source, target, scene)
        if outcome.grasp is None:
            assert outcome.reason is not None
            yield Rejected(target.name, grasp.grasp_id, outcome.reason.name)
            continue
        rig = rig or shared_rig(target, scene)
        is_pushed = hold_every > 0 and number % hold_every == 0
        # The protocols share their plant, and so the rig.
        lift = simulate_lift(replace(rig, protocol=HOLD) if is_pushed else rig, outcome.grasp)
        yield replace(outcome.grasp, lift=lift)


def _rows(
    grasps: Sequence[Grasp],
    hand: Hand,
    scene: Scene,
    config: DatasetConfig,
    points: Mapping[str, Sequence[float]] | None = None,
) -> list[Row]:
    """Rows of the grasps that are kept."""
    kept = [timeless(g) for g in grasps if config.keep_failed or (g.lift is not None and g.lift.success)]
    return rows_of(kept, hand, scene, source_points=points)


def versions() -> dict[str, str]:
    """Versions of the libraries, and of the rules from name to hand and shape, that rows depend on."""
    libraries = {name: metadata.version(name) for name in ("clarabel", "coacd", "daqp", "drake", "numpy", "torch")}
    return libraries | {"generated_hands": str(GENERATOR), "generated_shapes": str(RECIPE)}


@lru_cache(maxsize=1)
def code_version() -> str:
    """Version of this library, and where it runs from a repository the commit, with a mark where files were changed."""
    version = metadata.version("xdex_drake")
    here = Path(__file__).resolve().parents[2]
    if not (here / ".git").exists():
        return version
    words = ["git", "-C", str(here), "describe", "--always", "--abbrev=12", "--dirty", "--exclude=*"]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=20.0, check=True)
    except (OSError, subprocess.SubprocessError):
        return version
    return f"{version}+{done.stdout.strip()}"


def manifest(config: DatasetConfig) -> Manifest:
    """The manifest of a data set; loads every hand and object of a file or the library, and so fails early.

    Args:
        config: The configuration.

    Returns:
        The manifest.

    Raises:
        XdexError: The configuration, a hand or an object cannot be used.
    """
    hands, sources, objects = population(config)
    digests = {}
    for name in dict.fromkeys((*hands, *sources)):
        if read_hand_name(name) is None:
            hand = load_hand(name)
            digests[f"hand/{hand.name}"] = hand_digest(hand)
    units = plan(config)
    scales = {unit.object: unit.scale for unit in units}
    for path in objects:
        if not is_shape_name(path):
            obj = scene_of_unit(path, scales[path], 0, config.mass, config.seed).object
            digests[f"object/{obj.name}"] = obj.digest
    plain: dict[str, Any] = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(config).items()}
    return Manifest(
        config=plain,
        seed=config.seed,
        units=tuple(unit.name for unit in units),
        versions=versions(),
        digests=digests,
    )


def keep_assets(config: DatasetConfig, folder: str | Path) -> None:
    """Copies the hands and meshes that came from files into a data set's folder, so that it can be sent as it is.

    Args:
        config: The configuration.
        folder: Folder of the data set.

    Raises:
        XdexError: A hand or an object cannot be used, or a copy cannot be written.
    """
    hands, sources, _ = population(config)
    for name in dict.fromkeys((*hands, *sources)):
        if read_hand_name(name) is None:
            keep_hand(folder, load_hand(name), Path(name) if Path(name).is_file() else None)
    for path, scale in {unit.object: unit.scale for unit in plan(config)}.items():
        if not is_shape_name(path):
            keep_mesh(folder, scene_of_unit(path, scale, 0, config.mass, config.seed).object)


def generate(
    config: DatasetConfig,
    folder: str | Path,
    *,
    workers: int = 2,
    shard: tuple[int, int] | None = None,
    table: str | Path | None = None,
    timeout_s: float = 3600.0,
    ray: str | None = None,
    on_done: Callable[[UnitResult[PairUnit, UnitRows]], None] | None = None,
) -> tuple[int, int]:
    """Generates a data set, or goes on with one that was interrupted.

    Args:
        config: What it is to hold.
        folder: Its folder.
        workers: Number of processes; 0 works in this one.
        shard: Which part of the units to make, (i, n) for every n-th from the i-th on, i from 1; all where None. Parts
            may run at once, on one folder or on several whose shards are then put together.
        table: Folder of a compact table: units that it holds are not made again, and those that are made are appended.
        timeout_s: Longest wall time of a unit [s]; not on a Ray cluster.
        ray: Address of a Ray cluster that works instead of processes here; see `run_units_on_ray`.
        on_done: Called with each unit's result after its shard is written, for progress.

    Returns:
        Number of units done by this call, and of units that failed.

    Raises:
        ConfigError: The configuration cannot be used.
        DatasetError: The folder holds another data set, another run is at work on it, or it cannot be written.
        GraspFileError: A shard cannot be written; those before it are whole.
    """
    units = part_of(plan(config), shard)
    planned = manifest(config)
    open_dataset(folder, planned)
    keep_assets(config, folder)
    if table is not None:
        open_dataset(table, planned)
        copy_assets(folder, table)
    counts = [0, 0]

    def save(result: UnitResult[PairUnit, UnitRows]) -> None:
        if result.value is None:
            write_failure(folder, result.unit.name, str(result.failure))
            counts[1] += 1
        else:
            entries = rejected_entry(result.value.rejected) | {COMMIT: code_version()}
            write_shard(folder, result.unit.name, with_kept_mesh(folder, result.value.rows), metadata=entries)
            if table is not None:
                compact_shard(folder, result.unit.name, table)
            counts[0] += 1
        if on_done is not None:
            on_done(result)

    with ExitStack() as locks:
        locks.enter_context(locked(folder, shard))
        if table is not None:
            locks.enter_context(locked(table))
            compact_dataset(folder, table)
        done = completed_units(folder) | (set() if table is None else table_units(table))
        missing = [unit for unit in units if unit.name not in done]
        work = partial(run_unit, config=config)
        if ray is None:
            results = run_units(missing, work, workers=workers, on_done=save, timeout_s=timeout_s)
        else:
            results = run_units_on_ray(missing, work, address=ray, on_done=save)
        for _ in results:
            pass
    return counts[0], counts[1]


def part_of(units: Sequence[PairUnit], shard: tuple[int, int] | None) -> tuple[PairUnit, ...]:
    """The units of a part.

    Args:
        units: All units.
        shard: Which part, (i, n) with i from 1 to n; all where None.

    Returns:
        Every n-th unit from the i-th on.

    Raises:
        ConfigError: There is no such part.
    """
    if shard is None:
        return tuple(units)
    number, count = shard
    if not 1 <= number <= count:
        raise ConfigError(f"shard {number}/{count}: give a number from 1 to {max(count, 1)} and how many there are")
    return tuple(units[number - 1 :: count])
