"""Generates a paired data set: source grasps of each hand on each scene, carried to the other hands, all lifted.

The unit of work is one source hand on one scene. A unit depends on the configuration and its own name only, so the rows
are the same for any number of workers, and a run that was killed goes on with the units that are missing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from xdex_drake.dataset.folder import Manifest, completed_units, open_dataset, write_failure, write_shard
from xdex_drake.dataset.rows import rows_of, timeless
from xdex_drake.dataset.schema import Row
from xdex_drake.errors import ConfigError
from xdex_drake.grasping.retarget import retarget
from xdex_drake.grasping.synthesis import SynthesisSettings, candidates_of_batch, lift_all
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.yaml_file import hand_digest
from xdex_drake.jobs.processes import UnitResult, run_units
from xdex_drake.jobs.workbench import hand_of
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene
from xdex_drake.simulation.lift import shared_rig


@dataclass(frozen=True)
class DatasetConfig:
    """What a data set is to hold.

    Attributes:
        hands: Library names or files of the hands that receive grasps.
        source_hands: Those of them that grasps are synthesised for; all where empty.
        objects: Library names or mesh files.
        scenes_per_object: Stable poses of each object.
        candidates: Candidates of the search of one unit (a source hand on a scene).
        sources_per_unit: Greatest number of lifted source grasps of a unit that are carried to the other hands.
        keep_failed: Whether certified grasps whose lift failed are stored too, flagged as such.
        mass: Mass of every object [kg].
        seed: Seed.
    """

    hands: tuple[str, ...] = ("allegro", "shadow", "ability")
    source_hands: tuple[str, ...] = ()
    objects: tuple[str, ...] = ("box", "can", "ball")
    scenes_per_object: int = 1
    candidates: int = 48
    sources_per_unit: int = 16
    keep_failed: bool = True
    mass: float = 0.1
    seed: int = 0


@dataclass(frozen=True)
class PairUnit:
    """A unit of work: one source hand on one scene.

    Attributes:
        name: Name, also of its shard.
        hand: Index of the source hand among `config.hands`.
        object: Index of the object among `config.objects`.
        scene: Number of the stable pose.
    """

    name: str
    hand: int
    object: int
    scene: int


def plan(config: DatasetConfig) -> tuple[PairUnit, ...]:
    """The units of a data set, in order.

    Args:
        config: The configuration.

    Returns:
        The units.

    Raises:
        ConfigError: A number is not positive, a list is empty, or a source hand is not among the hands.
    """
    if not config.hands or not config.objects:
        raise ConfigError("hands, objects: name at least one of each")
    for name in ("scenes_per_object", "candidates", "sources_per_unit"):
        if getattr(config, name) < 1:
            raise ConfigError(f"{name}: {getattr(config, name)} must be at least 1")
    unknown = sorted(set(config.source_hands) - set(config.hands))
    if unknown:
        raise ConfigError(f"source_hands: {', '.join(unknown)} must be among hands: add them there")
    sources = config.source_hands or config.hands
    return tuple(
        PairUnit(f"{Path(obj).stem}-{scene}-{Path(hand).stem}", config.hands.index(hand), o, scene)
        for o, obj in enumerate(config.objects)
        for scene in range(config.scenes_per_object)
        for hand in sources
    )


def run_unit(unit: PairUnit, config: DatasetConfig) -> list[Row]:
    """The rows of one unit.

    Args:
        unit: The unit.
        config: The configuration.

    Returns:
        Rows of source grasps, then of the grasps retargeted from them.
    """
    source = hand_of(config.hands[unit.hand])
    targets = [hand_of(name) for name in config.hands if name != config.hands[unit.hand]]
    model = load_object(config.objects[unit.object], mass=config.mass)
    scene = make_scene(model, seed=config.seed + unit.scene)
    settings = replace(SynthesisSettings(), batch=config.candidates)
    seed = int(np.random.SeedSequence([config.seed, unit.hand, unit.object, unit.scene]).generate_state(1)[0])
    tally = Tally()
    grasps = [
        replace(grasp, grasp_id=f"{unit.name}-{k}")
        for k, grasp in enumerate(candidates_of_batch(source, scene, seed=seed, settings=settings, tally=tally))
    ]
    lifted = list(lift_all(shared_rig(source, scene), iter(grasps), tally))
    sources = [g for g in lifted if g.lift is not None and g.lift.success][: config.sources_per_unit]
    result = list(lifted)
    for target in targets:
        carried = [retarget(grasp, source, target, scene).grasp for grasp in sources]
        result += lift_all(shared_rig(target, scene), (g for g in carried if g is not None), tally)
    kept = [g for g in result if config.keep_failed or (g.lift is not None and g.lift.success)]
    rows: list[Row] = []
    points: dict[str, Sequence[float]] = {}
    for hand in (source, *targets):
        made = rows_of([timeless(g) for g in kept if g.hand == hand.name], hand, scene, source_points=points)
        points |= {row["grasp_id"]: row["object_point_O"] for row in made}
        rows += made
    return rows


def versions() -> dict[str, str]:
    """Versions of the libraries that rows depend on."""
    return {name: metadata.version(name) for name in ("clarabel", "coacd", "daqp", "drake", "numpy", "torch")}


def manifest(config: DatasetConfig) -> Manifest:
    """The manifest of a data set; loads every hand and object, and so fails early where one cannot be used."""
    digests = {f"hand/{load_hand(name).name}": hand_digest(load_hand(name)) for name in config.hands}
    for path in config.objects:
        obj = load_object(path, mass=config.mass)
        digests[f"object/{obj.name}"] = obj.digest
    plain: dict[str, Any] = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(config).items()}
    return Manifest(
        config=plain,
        seed=config.seed,
        units=tuple(unit.name for unit in plan(config)),
        versions=versions(),
        digests=digests,
    )


def generate(
    config: DatasetConfig,
    folder: str | Path,
    *,
    workers: int = 2,
    timeout_s: float = 900.0,
    on_done: Callable[[UnitResult[PairUnit, list[Row]]], None] | None = None,
) -> tuple[int, int]:
    """Generates a data set, or goes on with one that was interrupted.

    Args:
        config: What it is to hold.
        folder: Its folder.
        workers: Number of processes; 0 works in this one.
        timeout_s: Longest wall time of a unit [s].
        on_done: Called with each unit's result after its shard is written, for progress.

    Returns:
        Number of units done by this call, and of units that failed.

    Raises:
        ConfigError: The configuration cannot be used.
        DatasetError: The folder holds another data set or cannot be written.
    """
    units = plan(config)
    open_dataset(folder, manifest(config))
    done = completed_units(folder)
    counts = [0, 0]

    def save(result: UnitResult[PairUnit, list[Row]]) -> None:
        if result.value is None:
            write_failure(folder, result.unit.name, str(result.failure))
            counts[1] += 1
        else:
            write_shard(folder, result.unit.name, result.value)
            counts[0] += 1
        if on_done is not None:
            on_done(result)

    missing = [unit for unit in units if unit.name not in done]
    for _ in run_units(missing, partial(run_unit, config=config), workers=workers, on_done=save, timeout_s=timeout_s):
        pass
    return counts[0], counts[1]
