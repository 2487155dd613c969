"""Hands and meshes that travel with a data set: copied into its folder, and found there by digest.

`assets/DIGEST/NAME` is the file of the hand or the mesh of that digest, and beside it lie the licence files that lay
beside the original. Rows name a mesh by that path, relative to the data set's folder. What the library has by name, its
own hands and shapes and generated ones, is not copied.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from xdex_drake.dataset.folder import read_manifest
from xdex_drake.dataset.schema import ObjectFacts, Row
from xdex_drake.errors import DatasetError, XdexError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.generation import read_hand_name
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.hand.yaml_file import hand_digest, hand_text
from xdex_drake.scene.mesh import body_of_path
from xdex_drake.scene.object import ObjectModel, load_object
from xdex_drake.whole_file import whole_file

ASSETS = "assets"

_DIGEST = re.compile(r"[0-9a-f]{64}")
_LICENCE = re.compile(r"(licen[cs]e|copying|notice)([._-].*)?", re.IGNORECASE)


def keep_hand(folder: str | Path, hand: Hand, file: Path | None = None) -> None:
    """Copies a hand into a data set, with the licence files beside its file; not one that the library has by name.

    Args:
        folder: Folder of the data set.
        hand: The hand.
        file: Its file, None where there is none.

    Raises:
        DatasetError: It cannot be written.
    """
    if hand.name in list_hands() or read_hand_name(hand.name) is not None:
        return
    digest = hand_digest(hand)
    _keep_licences(folder, digest, file)
    _keep(folder, digest, f"{hand.name}.yaml", lambda path: path.write_text(hand_text(hand), "utf-8"))


def keep_mesh(folder: str | Path, obj: ObjectModel) -> None:
    """Copies an object's mesh file into a data set, with the licence files beside it; not a shape of the library.

    Args:
        folder: Folder of the data set.
        obj: The object.

    Raises:
        DatasetError: It cannot be read or written, or is of a format that spreads over several files.
    """
    if obj.path is None:
        return
    file, _ = body_of_path(obj.path)
    if file.suffix.lower() == ".gltf":
        raise DatasetError(f"{file}: may refer to other files, and so cannot be copied; convert it to .glb")
    _keep_licences(folder, obj.digest, file)
    _keep(folder, obj.digest, file.name, lambda path: shutil.copyfile(file, path))


def copy_assets(source: str | Path, target: str | Path) -> None:
    """Copies the hands and meshes of a data set, or of its compact table, into another folder of the same data.

    Args:
        source: The folder that has them.
        target: The folder that gets those that it lacks.

    Raises:
        DatasetError: They cannot be read or written.
    """
    for path in sorted((Path(source) / ASSETS).glob("*/[!.]*"), key=lambda path: not is_licence(path)):
        _keep(target, path.parent.name, path.name, lambda copy, path=path: shutil.copyfile(path, copy))


def is_licence(path: Path) -> bool:
    """Whether a file is called as licences are."""
    return _LICENCE.fullmatch(path.name) is not None and path.is_file()


def _keep_licences(folder: str | Path, digest: str, file: Path | None) -> None:
    for path in () if file is None else sorted(file.parent.iterdir()):
        if is_licence(path):
            _keep(folder, digest, path.name, lambda copy, path=path: shutil.copyfile(path, copy))


def _keep(folder: str | Path, digest: str, name: str, write: Callable[[Path], object]) -> None:
    path = Path(folder) / ASSETS / digest / name
    if path.exists():
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as unfinished:
            write(unfinished)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be written: {error.strerror}") from error


def asset(folder: str | Path, digest: str) -> Path | None:
    """The file of a digest in a data set.

    Args:
        folder: Folder of the data set.
        digest: Digest of a hand or a mesh.

    Returns:
        Its path; None where the data set has none.

    Raises:
        DatasetError: Several files could be meant, or the file lies outside the folder.
    """
    home = Path(folder) / ASSETS / digest
    if not _DIGEST.fullmatch(digest) or not home.is_dir():
        return None
    files = [path for path in sorted(home.glob("[!.]*")) if not is_licence(path)]
    if len(files) > 1:
        raise DatasetError(f"{home}: holds several files, {files[0].name} and {files[1].name}; remove the wrong one")
    if files and not files[0].resolve().is_relative_to(Path(folder).resolve()):
        raise DatasetError(f"{files[0]}: leads out of the data set's folder; put the file itself there")
    return files[0] if files else None


def mesh_path(folder: str | Path, path: str, digest: str) -> str:
    """Where an object of a data set is found.

    Args:
        folder: Folder of the data set.
        path: The object's path, as rows have it.
        digest: Digest of its mesh.

    Returns:
        Path of the copy in the folder, with the number of the body where `path` has one; `path` where there is no copy.
    """
    kept = asset(folder, digest)
    if kept is None:
        return path
    _, body = body_of_path(Path(path))
    return str(kept) if body is None else f"{kept}#{body}"


def with_kept_mesh(folder: str | Path, rows: Iterable[Row]) -> list[Row]:
    """Rows that name the copy of their mesh, relative to the data set's folder; the same rows where there is none."""
    homes: dict[tuple[str, str], str] = {}
    named = []
    for row in rows:
        key = row["object_path"], row["object_digest"]
        if key not in homes:
            is_kept = asset(folder, row["object_digest"]) is not None
            homes[key] = Path(mesh_path(folder, *key)).relative_to(folder).as_posix() if is_kept else key[0]
        named.append(row if homes[key] == key[0] else row | {"object_path": homes[key]})
    return named


def dataset_of(file: str | Path) -> Path | None:
    """Folder of the data set that a file of grasps is a shard of; None where it is none."""
    folder = Path(file).parent.parent
    return folder if Path(file).parent.name == "shards" and (folder / "manifest.json").is_file() else None


def hand_finder(folder: str | Path) -> Callable[[str], Hand]:
    """Finds the hands of a data set by name: copies in its folder first, then the library.

    Args:
        folder: Folder of the data set.

    Returns:
        A function from name to hand. It raises `DatasetError` where the hand is not found, or not the one of the data.
    """
    digests: Mapping[str, str] = read_manifest(folder).digests

    def find(name: str) -> Hand:
        digest = digests.get(f"hand/{name}")
        kept = None if digest is None else asset(folder, digest)
        try:
            hand = load_hand(kept or name)
        except XdexError as error:
            raise DatasetError(f"{folder}: hand {name} cannot be found: {error}") from None
        if digest is not None and hand_digest(hand) != digest:
            raise DatasetError(f"{folder}: hand {name} is not the one of the data; restore its file")
        return hand

    return find


def object_finder(folder: str | Path) -> Callable[[ObjectFacts], ObjectModel]:
    """Finds the objects of a data set: copies in its folder first, then by their paths.

    Args:
        folder: Folder of the data set.

    Returns:
        A function from what a row says about its object to the object; see `object_of_facts`.
    """

    def find(facts: ObjectFacts) -> ObjectModel:
        return object_of_facts(replace(facts, path=mesh_path(folder, facts.path, facts.digest)))

    return find


def object_of_facts(facts: ObjectFacts) -> ObjectModel:
    """The object that a row names.

    Args:
        facts: What the row says about its object.

    Returns:
        The object.

    Raises:
        DatasetError: What is found under its name is another mesh.
        XdexError: Nothing is found, or it cannot be used.
    """
    found = load_object(facts.path, scale=facts.scale, mass=facts.mass, friction=facts.friction)
    if found.digest != facts.digest:
        raise DatasetError(f"object {facts.name}: {facts.path} is not the mesh of the grasps; restore that file")
    return found
