"""Imports a hand from a file of any known format, or from a Drake plant."""

import dataclasses
import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from xdex_drake.cache import cache_folder, write_cache_file
from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.importing.drake_plant import model_from_plant
from xdex_drake.hand.importing.interpret import Imported, interpret
from xdex_drake.hand.importing.mesh_files import Allowed, is_lfs_pointer
from xdex_drake.hand.importing.mjcf import read_mjcf
from xdex_drake.hand.importing.model import FileModel
from xdex_drake.hand.importing.sdformat import read_sdf
from xdex_drake.hand.importing.urdf import read_urdf
from xdex_drake.hand.importing.xml_file import read_xml
from xdex_drake.hand.surface import write_surfaces
from xdex_drake.hand.yaml_file import hand_text, read_hand, surfaces_file

SUFFIXES = (".urdf", ".xml", ".mjcf", ".sdf")
RECIPE = 6  # Raise whenever the way from a file to its hand changes: it is part of the cache's key.
WHAT = "a URDF, MJCF or SDFormat file of one hand"
READERS: dict[str, Callable[[Path, Allowed], FileModel]] = {
    "robot": read_urdf,
    "mujoco": read_mjcf,
    "mujocoinclude": read_mjcf,
    "sdf": read_sdf,
}
"""The reader for each root element."""

GENERAL_NAMES = ("robot", "model", "hand", "scene", "urdf", "mjcf", "main", "gripper")


def read_model(path: str | Path, allowed: Allowed | None = None) -> FileModel:
    """Reads a robot file by the reader that its root element asks for.

    Args:
        path: File of one of the types `SUFFIXES`.
        allowed: What may be read besides the hand's folder.

    Returns:
        The robot as the file has it.

    Raises:
        HandFileError: The file cannot be used; the message names file, element and remedy.
    """
    path = Path(path)
    suffixes = [suffix.lower() for suffix in path.suffixes]
    if ".xacro" in suffixes:
        raise HandFileError(f"{path}: is a xacro file; expand it first: `xacro {path.name} > hand.urdf`")
    if not suffixes or suffixes[-1] not in SUFFIXES:
        raise HandFileError(f"{path}: is of an unknown type; give {WHAT} ({', '.join(SUFFIXES)})")
    if path.is_file() and is_lfs_pointer(path):
        raise HandFileError(f"{path}: is a Git LFS pointer, not the file itself; fetch it by `git lfs pull`")
    root = read_xml(path, WHAT).tag
    if root not in READERS:
        raise HandFileError(f"{path}: its root element is <{root[:40]}>; give {WHAT}")
    return READERS[root](path, allowed or Allowed())


def import_hand(
    path: str | Path,
    *,
    name: str | None = None,
    side: str | None = None,
    palm: str | None = None,
    root: str | Path | None = None,
    packages: Mapping[str, str | Path] | None = None,
) -> Imported:
    """Imports a hand from a URDF, MJCF or SDFormat file, without annotation.

    Args:
        path: The file.
        name: Name of the hand; made from the file's name where None.
        side: "right" or "left", where the file cannot tell; of a robot with two hands, the one to take.
        palm: Name of the link that the fingers grow from, where it is not to be found by itself.
        root: A folder in which meshes and included files may lie, besides the hand's own.
        packages: Folders of ROS packages by name, for `package://NAME/...`.

    Returns:
        The hand and all that was decided on the way.

    Raises:
        HandFileError: The file cannot be used; the message names file, element and remedy.
    """
    folders = {key: Path(folder) for key, folder in (packages or {}).items()}
    for folder in [*([Path(root)] if root is not None else []), *folders.values()]:
        if not folder.is_dir():
            raise HandFileError(f"{folder}: is no folder; give one in which the meshes of {path} lie")
    model = read_model(path, Allowed(None if root is None else Path(root), folders))
    return interpret(model, name=name or hand_name(model), side=side, palm=palm)


def hand_from_plant(
    plant: MultibodyPlant,
    model_instance: ModelInstanceIndex,
    *,
    scene_graph: SceneGraph | None = None,
    name: str | None = None,
    side: str | None = None,
    palm: str | None = None,
) -> Imported:
    """Imports a hand that is already in a Drake plant.

    Args:
        plant: The plant, finalized or not; couplings can be read from a finalized one only.
        model_instance: The hand's model instance.
        scene_graph: The plant's scene graph; needed where the plant is finalized, for the geometry.
        name: Name of the hand; that of the model instance where None.
        side: As in `import_hand`.
        palm: As in `import_hand`.

    Returns:
        The hand and all that was decided on the way.

    Raises:
        HandFileError: The model instance is no hand; the message names instance, part and remedy.
    """
    model = model_from_plant(plant, model_instance, scene_graph=scene_graph)
    return interpret(model, name=name or _identifier(model.name), side=side, palm=palm)


def load_imported_hand(path: str | Path) -> Hand:
    """Imports a hand, or takes it from the cache where the same file with the same meshes was imported before.

    Args:
        path: The file.

    Returns:
        The hand.

    Raises:
        HandFileError: As in `import_hand`.
    """
    model = read_model(path)
    name = hand_name(model)
    file = cache_folder() / f"hand-{RECIPE}-{model_digest(model, name)[:32]}.yaml"
    try:
        if file.is_file():
            return read_hand(file)
    except HandFileError:
        file.unlink(missing_ok=True)  # Damaged: import again.
    hand = interpret(model, name=name).hand
    surfaces = {link.name: link.surfaces for link in hand.links if link.surfaces}
    if surfaces:
        write_cache_file(surfaces_file(file), lambda path: write_surfaces(surfaces, path))
    write_cache_file(file, lambda path: path.write_text(hand_text(hand), encoding="utf-8"))
    # What comes from the file is the same to the last bit in the first run and in later ones.
    return read_hand(file) if file.is_file() else hand


def hand_name(model: FileModel) -> str:
    """A name for the hand in a file: the file's own, or the robot's where that says nothing."""
    stem = Path(model.source).stem
    return _identifier(model.name if stem.lower() in GENERAL_NAMES and model.name else stem)


def _identifier(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:60] or "hand"


def model_digest(model: FileModel, *more: str) -> str:
    """SHA-256 of all that a file says, its meshes included, but not of where it lies.

    Args:
        model: The robot as its file has it.
        more: What else counts.

    Returns:
        64 hexadecimal digits.
    """
    sha = hashlib.sha256()
    for piece in _pieces([list(more), dataclasses.replace(model, source=Path(model.source).name)]):
        sha.update(len(piece).to_bytes(8, "little"))
        sha.update(piece)
    return sha.hexdigest()


def _pieces(value: Any) -> Iterator[bytes]:
    if isinstance(value, np.ndarray):
        yield f"{value.shape}{value.dtype.str}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, list | tuple):
        yield f"[{len(value)}".encode()
        for item in value:
            yield from _pieces(item)
    elif dataclasses.is_dataclass(value):
        yield type(value).__name__.encode()
        for entry in dataclasses.fields(value):
            yield from _pieces(getattr(value, entry.name))
    else:
        yield repr(value).encode()
