"""The mesh files that a robot file refers to: which may be read, and how they become triangles.

A robot file may read meshes within the hand's folder alone. That is the nearest folder at or above the file, at most
six levels up, that holds a `package.xml` (a ROS package); without one, the folder above where the file lies in a
folder for robot files (`urdf`, `robots`, `mjcf`, ...); else the file's own folder. Links of the file system are
followed before that is decided. Beyond it, `package://NAME/...` may read a folder of that name above the file, a
package of that name beside the hand's folder (known by its `package.xml`), one that `ROS_PACKAGE_PATH` leads to, and
whatever folder a person allows (`Allowed`). An absolute path that leads elsewhere, as of the computer that wrote the
file, is looked for by its end within the hand's folder.
"""

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import numpy as np
import trimesh

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.importing.decisions import Decision, join
from xdex_drake.hand.importing.model import FileLink, TriangleMesh
from xdex_drake.hand.importing.xml_file import read_xml
from xdex_drake.mesh_file import MESH_SUFFIXES, read_triangles

MAX_BYTES = 200_000_000
MAX_TRIANGLES = 1_000_000
MAX_FILES = 1_000
PACKAGE_LEVELS = 6
MAX_PACKAGES = 500
"""A folder is searched for packages among this many of its entries at most."""

LONGEST_PART = 2.0
"""No part of a hand is longer [m]: a longer mesh was drawn in millimetres."""

LFS_POINTER = b"version https://git-lfs.github.com/spec/"
ROBOT_FILE_FOLDERS = ("urdf", "urdfs", "robot", "robots", "mjcf", "mjcfs", "xml", "xmls", "sdf", "model", "models")


class MissingMesh(Exception):
    """A mesh that is not there or cannot be read; the hand may do without it. The message says why."""


@dataclass(frozen=True)
class Allowed:
    """What a person lets a robot file read besides the hand's own folder.

    Attributes:
        root: A folder.
        packages: Folders of ROS packages by name.
    """

    root: Path | None = None
    packages: dict[str, Path] = field(default_factory=dict)


def hand_folder(path: Path) -> Path:
    """The folder within which a robot file may read, see the module's text.

    Args:
        path: The robot file.

    Returns:
        The folder, with links resolved.
    """
    folder = path.resolve().parent
    for candidate in (folder, *folder.parents[:PACKAGE_LEVELS]):
        if (candidate / "package.xml").is_file() and candidate != candidate.parent:
            return candidate
    if folder.name.lower() in ROBOT_FILE_FOLDERS and len(folder.parts) > 2:
        return folder.parent
    return folder


class MeshFiles:
    """Reads the meshes of one robot file, each file once, within limits for all of them together.

    Attributes:
        path: The robot file, for messages.
        root: Folder within which files may be read.
    """

    def __init__(self, path: Path, allowed: Allowed | None = None) -> None:
        self.path = path
        self.folder = path.resolve().parent
        self.root = hand_folder(path)
        self.allowed = allowed or Allowed()
        given = [self.allowed.root, *self.allowed.packages.values()]
        self._open = [self.root, *(folder.resolve() for folder in given if folder is not None)]
        self._read: dict[Path, tuple[Array, np.ndarray] | str] = {}
        self._bytes = self._triangles = 0
        self._by_end: dict[str, Path] = {}
        self._long: dict[str, float] = {}
        self._packages: dict[str, list[Path]] = {}

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """What was taken otherwise than it stands, one sentence for each kind."""
        told = []
        if self._by_end:
            name, file = next(iter(self._by_end.items()))
            text = f"{_meshes(len(self._by_end))} named by an absolute path of another place, as {name[:120]!r}; taken "
            told.append(Decision("warning", "file", text + f"by the end of that path, as {self._shown(file)}."))
        if self._long:
            name = max(self._long, key=lambda name: self._long[name])
            text = (
                f"{_meshes(len(self._long))} longer than any part of a hand, as {name} with {self._long[name]:.3g} m; "
            )
            text += 'taken as drawn in millimetres. Give the mesh scale="0.001 0.001 0.001".'
            told.append(Decision("mended", "file", text))
        return tuple(told)

    def locate(self, name: str, *, folder: Path | None = None) -> Path:
        """The file that a name in the robot file means.

        Args:
            name: Relative or absolute path, `file://` or `package://` or `model://` address.
            folder: Folder that relative names start from; the robot file's own where None.

        Returns:
            An existing file within the folders that may be read.

        Raises:
            HandFileError: The name leads out of these folders or to another machine.
            MissingMesh: There is no such file.
        """
        name = name.strip()
        scheme, found, rest = name.partition("://")
        path = (rest if found else name).replace("\\", "/")
        if found and scheme not in ("file", "package", "model"):
            raise HandFileError(f"{self.path}: refers to {name[:200]!r}; save that file beside and name it by its path")
        elsewhere = False
        if scheme in ("package", "model") and found:
            package, _, below = path.partition("/")
            candidates = [base / below for base in self._folders_of(package)]
        else:
            elsewhere = bool(found) or path.startswith("/") or path[1:3] == ":/"
            candidates = [Path(path)] if path.startswith("/") else [(folder or self.folder) / path]
        try:
            candidates = [candidate.resolve() for candidate in candidates]
            outside = [candidate for candidate in candidates if not self._may_read(candidate)]
            if outside and elsewhere and (file := self._found_by_end(path)) is not None:
                self._by_end[name] = file
                return file
            if outside:
                raise HandFileError(
                    f"{self.path}: refers to {name[:200]!r}, which is outside the hand's folder {self.root}; move the "
                    "file there, or allow a folder that holds both, as by --root .. (root= in Python)"
                )
            for candidate in candidates:
                if candidate.is_file():
                    return candidate
            if elsewhere and (file := self._found_by_end(path)) is not None:
                self._by_end[name] = file
                return file
        except (OSError, ValueError, RuntimeError):  # A null character, a name too long, a link to itself.
            raise MissingMesh(f"{name[:200]!r} is not the name of a file") from None
        if found and scheme == "package":
            package = rest.partition("/")[0]
            raise MissingMesh(
                f"{name[:200]!r} does not exist: say where that package is by --package {package}=FOLDER (packages= in "
                "Python), or set ROS_PACKAGE_PATH"
            )
        if elsewhere:
            raise MissingMesh(
                f"{name[:200]!r} does not exist here, nor does the end of that path in the hand's folder; copy it there"
            )
        raise MissingMesh(f"{name[:200]!r} does not exist")

    def _may_read(self, file: Path) -> bool:
        return any(file.is_relative_to(folder) for folder in self._open)

    def _found_by_end(self, path: str) -> Path | None:
        """The file of the hand's folder whose path has the longest end in common with an absolute one."""
        parts = [part for part in PurePosixPath(path).parts if part not in ("/", "..")]
        for start in range(1, len(parts)):
            for base in (self.root, self.folder):
                file = base.joinpath(*parts[start:]).resolve()
                if file.is_relative_to(self.root) and file.is_file():
                    return file
        return None

    def _folders_of(self, name: str) -> list[Path]:
        """Folders that a package of this name may be, the likeliest first; those beyond the hand's may now be read."""
        if name not in self._packages:
            levels = (self.folder, *self.folder.parents[:PACKAGE_LEVELS])
            above = [folder for folder in levels if folder.name == name and len(folder.parts) > 2]
            given = [self.allowed.packages[name].resolve()] if name in self.allowed.packages else []
            within = [self.root / name, self.folder / name, self.root, self.folder]
            found = [] if given or above else _packages_named(name, self.root)
            self._open += [*above, *found]
            self._packages[name] = [*given, *above, *found, *within]
        return self._packages[name]

    def read(self, name: str, scale: Sequence[float] | Array, *, folder: Path | None = None) -> TriangleMesh:
        """Reads a mesh.

        Args:
            name: As in `locate`.
            scale: Factors along x, y and z, shape (3,); an odd number of negative ones mirrors the mesh.
            folder: As in `locate`.

        Returns:
            The mesh in its own frame, scaled, all parts of the file joined.

        Raises:
            HandFileError: As in `locate`; or the meshes exceed a limit.
            MissingMesh: The file does not exist or holds no readable triangles.
        """
        file = self.locate(name, folder=folder)
        if file not in self._read:
            self._read[file] = self._load(file)
        loaded = self._read[file]
        if isinstance(loaded, str):
            raise MissingMesh(loaded)
        vertices, faces = loaded
        scale = np.asarray(scale, dtype=np.float64)
        if (scale == 0.0).any():
            raise MissingMesh(f"{name[:200]!r} has a scale of zero")
        if np.prod(scale) < 0.0:
            faces = faces[:, ::-1]
        vertices = vertices * scale
        longest = float(np.ptp(vertices, axis=0).max())
        if longest > LONGEST_PART:
            self._long[file.name] = longest
            vertices = 1e-3 * vertices
        return TriangleMesh(vertices, np.ascontiguousarray(faces), self._shown(file))

    def _shown(self, file: Path) -> str:
        folder = next((folder for folder in self._open if file.is_relative_to(folder)), file.parent)
        return str(file.relative_to(folder))

    def _load(self, file: Path) -> tuple[Array, np.ndarray] | str:
        """The triangles of a file in metres, or why there are none."""
        if len(self._read) >= MAX_FILES:
            raise HandFileError(f"{self.path}: refers to more than {MAX_FILES} mesh files; give the hand alone")
        if file.suffix.lower() not in MESH_SUFFIXES:
            return f"{file.name!r} is of an unknown type; convert it to one of {', '.join(MESH_SUFFIXES)}"
        self._bytes += file.stat().st_size
        if self._bytes > MAX_BYTES:
            raise HandFileError(
                f"{self.path}: its meshes have more than {MAX_BYTES} bytes (at {file.name!r}); simplify them first"
            )
        if is_lfs_pointer(file):
            return f"{file.name!r} is a Git LFS pointer, not the mesh itself: fetch it by `git lfs pull`"
        unit = 1.0
        try:
            if file.suffix.lower() == ".dae":
                unit = _collada_unit(file)
            vertices, faces = read_triangles(file, HandFileError, max_bytes=MAX_BYTES)
        except HandFileError as error:
            return f"{file.name!r} cannot be read: {str(error).removeprefix(f'{file}: ').partition(';')[0]}"
        self._triangles += len(faces)
        if self._triangles > MAX_TRIANGLES:
            raise HandFileError(
                f"{self.path}: its meshes have more than {MAX_TRIANGLES} triangles (at {file.name!r}); simplify them"
            )
        if len(faces) == 0:
            return f"{file.name!r} holds no triangles"
        if faces.min() < 0 or faces.max() >= len(vertices):
            return f"{file.name!r} has a triangle of vertices that do not exist"
        used, index = np.unique(faces, return_inverse=True)
        vertices = vertices[used] * unit
        if not np.isfinite(vertices).all():
            return f"{file.name!r} has a coordinate that is not a finite number"
        return vertices, index.reshape(-1, 3).astype(np.int64)


def notes_of_lost(links: Iterable[FileLink]) -> list[str]:
    """One sentence for each cause for which meshes are missing, with the links that it befalls.

    Args:
        links: The links, with what they have lost.

    Returns:
        The sentences.
    """
    causes: dict[str, list[str]] = {}
    for link in links:
        for cause in link.lost:
            causes.setdefault(cause, []).append(link.name)
    return [f"{join(names)}: the mesh {cause}" for cause, names in causes.items()]


def is_lfs_pointer(file: Path) -> bool:
    """Whether a file is what Git leaves in the place of a large one that was not fetched."""
    with file.open("rb") as stream:
        return stream.read(len(LFS_POINTER)) == LFS_POINTER


def _meshes(count: int) -> str:
    return "a mesh is" if count == 1 else f"{count} meshes are"


def _packages_named(name: str, root: Path) -> list[Path]:
    """Packages of a name beside the hand's folder, where that is a package itself, and on `ROS_PACKAGE_PATH`."""
    if not name or name in (".", "..") or "/" in name:
        return []
    places = [root.parent] if (root / "package.xml").is_file() and len(root.parts) > 2 else []
    for place in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if place and Path(place).is_dir():
            places += [Path(place).resolve()]
    return [package for place in places for package in _packages_at(place) if _package_name(package) == name]


def _packages_at(place: Path) -> Iterator[Path]:
    """A folder and those in it, links followed, that hold a `package.xml`."""
    try:
        inside = [entry for entry, _ in zip(sorted(place.iterdir()), range(MAX_PACKAGES), strict=False)]
    except OSError:
        return
    for folder in (place, *inside):
        if (folder / "package.xml").is_file():
            yield folder.resolve()


def _package_name(folder: Path) -> str:
    try:
        root = read_xml(folder / "package.xml", "a package.xml", max_bytes=1_000_000)
    except HandFileError:
        return folder.name
    return (root.findtext("name") or folder.name).strip()


def _collada_unit(file: Path) -> float:
    """Metres in a COLLADA file's unit. Reading it here also keeps entities away from the mesh reader."""
    root = read_xml(file, "a COLLADA mesh", max_bytes=MAX_BYTES, max_elements=1_000_000)
    for asset in root:
        for entry in asset:
            if asset.tag.endswith("asset") and entry.tag.endswith("unit"):
                try:
                    unit = float(entry.get("meter", "1"))
                except ValueError:
                    return 1.0
                return unit if 1e-6 < unit < 1e3 else 1.0
    return 1.0


def placed(mesh: TriangleMesh, R_LG: Array, p_LG: Array) -> TriangleMesh:
    """A mesh in a link's frame, from the mesh in its own frame G and the pose X_LG.

    Args:
        mesh: The mesh, in G.
        R_LG: Rotation, shape (3, 3).
        p_LG: Position [m], shape (3,).

    Returns:
        The mesh, in L.
    """
    return mesh.moved(R_LG, p_LG)


def ellipsoid(radii: Array) -> TriangleMesh:
    """An ellipsoid about the origin as 320 triangles.

    Args:
        radii: Half axes along x, y and z [m], shape (3,).

    Returns:
        The surface.
    """
    ball = trimesh.creation.icosphere(subdivisions=2)
    return TriangleMesh(
        np.asarray(ball.vertices) * np.asarray(radii), np.asarray(ball.faces, dtype=np.int64), "ellipsoid"
    )
