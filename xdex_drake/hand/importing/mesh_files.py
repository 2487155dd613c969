"""The mesh files that a robot file refers to: which may be read, and how they become triangles.

A robot file may read meshes within the hand's folder alone. That is the nearest folder at or above the file, at most
four levels up, that holds a `package.xml` (a ROS package); without one, the folder above where the file lies in a
folder for robot files (`urdf`, `robots`, `mjcf`, ...); else the file's own folder. Links of the file system are
followed before that is decided.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Array
from xdex_drake.hand.importing.model import TriangleMesh
from xdex_drake.hand.importing.xml_file import read_xml
from xdex_drake.mesh_file import MESH_SUFFIXES, read_triangles

MAX_BYTES = 200_000_000
MAX_TRIANGLES = 1_000_000
MAX_FILES = 1_000
PACKAGE_LEVELS = 4
ROBOT_FILE_FOLDERS = ("urdf", "urdfs", "robot", "robots", "mjcf", "mjcfs", "xml", "xmls", "sdf", "model", "models")


class MissingMesh(Exception):
    """A mesh that is not there or cannot be read; the hand may do without it. The message says why."""


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

    def __init__(self, path: Path) -> None:
        self.path = path
        self.folder = path.resolve().parent
        self.root = hand_folder(path)
        self._read: dict[Path, tuple[Array, np.ndarray] | str] = {}
        self._bytes = self._triangles = 0

    def locate(self, name: str, *, folder: Path | None = None) -> Path:
        """The file that a name in the robot file means.

        Args:
            name: Relative or absolute path, `file://` or `package://` or `model://` address.
            folder: Folder that relative names start from; the robot file's own where None.

        Returns:
            An existing file within the hand's folder.

        Raises:
            HandFileError: The name leads out of the hand's folder or to another machine.
            MissingMesh: There is no such file.
        """
        name = name.strip()
        scheme, found, rest = name.partition("://")
        if not found:
            # A Windows path is as good as a missing file here; its backslashes may still stand for a folder's slash.
            candidates = [(folder or self.folder) / name.replace("\\", "/")]
        elif scheme == "file":
            candidates = [Path(rest)]
        elif scheme in ("package", "model"):
            package, _, below = rest.partition("/")
            candidates = [base / below for base in self._packages(package)]
        else:
            raise HandFileError(f"{self.path}: refers to {name[:200]!r}; save that file beside and name it by its path")
        try:
            candidates = [candidate.resolve() for candidate in candidates]
            for candidate in candidates:
                if not candidate.is_relative_to(self.root):
                    raise HandFileError(
                        f"{self.path}: refers to {name[:200]!r}, which is outside the hand's folder {self.root}; move "
                        "the file there, or mark the folder that holds both by an empty file package.xml"
                    )
            for candidate in candidates:
                if candidate.is_file():
                    return candidate
        except (OSError, ValueError, RuntimeError):  # A null character, a name too long, a link to itself.
            raise MissingMesh(f"{name[:200]!r} is not the name of a file") from None
        raise MissingMesh(f"{name[:200]!r} does not exist")

    def _packages(self, name: str) -> list[Path]:
        """Folders that a package of this name may be, the likeliest first, all within the hand's folder."""
        named = [
            folder
            for folder in (self.folder, *self.folder.parents)
            if folder.name == name and folder.is_relative_to(self.root)
        ]
        return [*named, self.root / name, self.folder / name, self.root, self.folder]

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
        return TriangleMesh(vertices * scale, np.ascontiguousarray(faces), str(file.relative_to(self.root)))

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
