"""Files of grasps together with the hands and scenes that their rows name."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from xdex_drake.dataset.assets import asset, dataset_of, mesh_path
from xdex_drake.dataset.grasp_file import read_grasps, read_metadata, read_table, write_grasps
from xdex_drake.dataset.rows import rows_of
from xdex_drake.dataset.schema import Row, grasp_from_row, pose_from_list
from xdex_drake.errors import GraspFileError, XdexError
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.hand.generation import read_hand_name
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.hand.yaml_file import hand_digest
from xdex_drake.scene.facts import FixtureFacts, SceneFacts
from xdex_drake.scene.tabletop import Scene
from xdex_drake.typed_yaml import from_plain, to_plain

SCENES = "xdex_scenes"
"""Entry of a file's metadata: table and obstacles of each scene where these are not the usual ones."""

HAND_PATHS = "xdex_hand_paths"
"""Entry of a file's metadata: where the description of each hand lies that the library does not have."""


@dataclass(frozen=True)
class _Surroundings:
    """What is not usual about a scene; see `SceneFacts`."""

    table: float | None = 0.0
    obstacles: tuple[FixtureFacts, ...] = ()
    p_OOcm: tuple[float, ...] | None = None
    I_OcmO: tuple[float, ...] | None = None


@dataclass(frozen=True, eq=False)
class StoredGrasp:
    """A grasp of a file with the hand and the scene that its row names.

    Attributes:
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.
        facts: The scene by what another process needs to build it.
        row: The row as it was read, its mesh by the path at which it was found.
        hand_path: Name or path by which another process loads the hand.
    """

    grasp: Grasp
    hand: Hand
    scene: Scene
    facts: SceneFacts
    row: Row
    hand_path: str


def save_grasps(
    path: str | Path, grasps: Iterable[Grasp], hand: Hand, scene: Scene, *, hand_path: str | Path | None = None
) -> None:
    """Writes grasps by one hand in one scene to a file, which appears whole or not at all.

    Args:
        path: The `.parquet` file; an older one is replaced.
        grasps: The grasps.
        hand: Their hand.
        scene: Their scene.
        hand_path: File of the hand, where the library does not have it.

    Raises:
        GraspFileError: The file cannot be written.
    """
    paths = {} if hand_path is None else {hand.name: str(hand_path)}
    metadata = hand_paths_entry(paths) | surroundings_entry([SceneFacts.of(scene)])
    write_grasps(path, rows_of(grasps, hand, scene), metadata=metadata)


def hand_paths_entry(paths: Mapping[str, str]) -> dict[str, str]:
    """The metadata entry that lets `load_grasps` find hands that the library does not have.

    Args:
        paths: Path of each hand's file by the hand's name.

    Returns:
        The entry, empty where there are none.
    """
    known = list_hands()
    resolved = {
        name: str(Path(path).resolve())
        for name, path in paths.items()
        if name not in known and read_hand_name(str(path)) is None
    }
    return {HAND_PATHS: json.dumps(resolved, sort_keys=True)} if resolved else {}


def surroundings_entry(scenes: Iterable[SceneFacts]) -> dict[str, str]:
    """The metadata entry that says what is not usual about scenes: no table, one of another height, obstacles.

    Args:
        scenes: The scenes of a file.

    Returns:
        The entry, empty where all lie on the usual table with nothing beside.
    """
    unusual = {
        facts.scene_id: {
            "table": facts.table,
            "obstacles": [to_plain(_findable(obstacle)) for obstacle in facts.obstacles],
            "p_OOcm": to_plain(facts.p_OOcm),
            "I_OcmO": to_plain(facts.I_OcmO),
        }
        for facts in scenes
        if facts.table != 0.0 or facts.obstacles or facts.p_OOcm is not None
    }
    return {SCENES: json.dumps(unusual, sort_keys=True)} if unusual else {}


def _findable(obstacle: FixtureFacts) -> FixtureFacts:
    """The obstacle with its file, if it has one, found from any folder."""
    path = Path(obstacle.object_path)
    return replace(obstacle, object_path=str(path.resolve())) if path.is_file() else obstacle


def _surroundings(path: str | Path) -> dict[str, _Surroundings]:
    """What a file says of its unusual scenes, by their identifiers."""
    try:
        kept = json.loads(read_metadata(path).get(SCENES, "{}"))
        return {name: from_plain(values, _Surroundings, str(path), field=name) for name, values in kept.items()}
    except (ValueError, AttributeError, XdexError) as error:
        raise GraspFileError(f"{path}: what it says of its scenes cannot be read: {error}") from None


def hand_paths(path: str | Path) -> dict[str, str]:
    """Paths of the hands of a file of grasps that the library does not have, by name."""
    paths, folder = dict(json.loads(read_metadata(path).get(HAND_PATHS, "{}"))), dataset_of(path)
    if folder is not None:
        names = read_table(path, ("hand", "hand_digest")).group_by(["hand", "hand_digest"]).aggregate([]).to_pylist()
        kept = {row["hand"]: asset(folder, row["hand_digest"]) for row in names}
        paths |= {name: str(file) for name, file in kept.items() if file is not None}
    return paths


def scene_facts(row: Row, file: Path | None = None, dataset: Path | None = None) -> SceneFacts:
    """What a row says about its scene.

    Args:
        row: The row.
        file: The row's file, beside which a mesh is looked for that is not found by its path as it stands.
        dataset: Folder of the data set that the row is of, whose copy of the mesh is taken.

    Returns:
        The facts.
    """
    path = row["object_path"]
    dataset = dataset or (None if file is None else dataset_of(file))
    if dataset is not None:
        path = mesh_path(dataset, path, row["object_digest"])
    elif file is not None and Path(path).suffix and not Path(path).exists() and (file.parent / path).exists():
        path = str(file.parent / path)
    numbers = (row["object_scale"], row["mass_kg"], row["friction"])
    pose = tuple(pose_from_list(row["X_WO"]).GetAsMatrix34().ravel().tolist())
    return SceneFacts(path, row["object_digest"], *numbers, pose, row["scene_id"])


def load_grasps(path: str | Path) -> list[StoredGrasp]:
    """Grasps of a file, each with its hand and scene; equal hands and scenes are shared.

    Args:
        path: A file that the library wrote.

    Returns:
        The grasps in the order of the file.

    Raises:
        GraspFileError: The file is missing or damaged, or names a hand or a mesh that has changed or cannot be found.
    """
    paths, around = hand_paths(path), _surroundings(path)
    hands: dict[str, Hand] = {}
    scenes: dict[SceneFacts, Scene] = {}
    stored = []
    for row in read_grasps(path):
        name = str(row["hand"])
        if name not in hands:
            try:
                hands[name] = load_hand(paths.get(name) or name)
            except XdexError as error:
                raise GraspFileError(f"{path}: hand {name} cannot be found: {error}") from None
            if hand_digest(hands[name]) != row["hand_digest"]:
                raise GraspFileError(f"{path}: hand {name} is not the one it was made with; restore its description")
        key = scene_facts(row, Path(path))
        if key.scene_id in around:
            key = replace(key, **vars(around[key.scene_id]))
        if key not in scenes:
            scenes[key] = key.build()
        found = row | {"object_path": key.object_path}
        stored.append(StoredGrasp(grasp_from_row(row), hands[name], scenes[key], key, found, paths.get(name, name)))
    return stored
