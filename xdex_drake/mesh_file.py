"""Reads the triangles of a mesh file as they stand; a file that cannot be read is one error in one line."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.resolvers import Resolver

from xdex_drake.arrays import Array
from xdex_drake.errors import XdexError

Faces = NDArray[np.int64]

MESH_SUFFIXES = (".obj", ".stl", ".ply", ".off", ".gltf", ".glb", ".dae")
MAX_BYTES = 1_000_000_000


class _FolderResolver(Resolver):
    """Gives a mesh file the files beside or below it, and no others."""

    def __init__(self, folder: Path, error: type[XdexError], max_bytes: int) -> None:
        self.folder, self.error, self.max_bytes = folder.resolve(), error, max_bytes

    def get(self, key: str) -> bytes:
        target = (self.folder / str(key).strip()).resolve()
        if not target.is_relative_to(self.folder):
            raise self.error(f"refers to {key!r}, which is outside its folder; move that file beside the mesh")
        if not target.is_file():
            raise self.error(f"refers to {key!r}, which is missing; put that file beside the mesh")
        if target.stat().st_size > self.max_bytes:
            raise self.error(f"refers to {key!r}, which exceeds {self.max_bytes} bytes; use a smaller mesh")
        return target.read_bytes()

    def write(self, name: str, data: Any) -> None:
        raise self.error("mesh files are only read")

    def namespaced(self, namespace: str) -> Resolver:
        return _FolderResolver(self.folder, self.error, self.max_bytes)

    def keys(self) -> list[str]:
        return []


def read_triangles(path: Path, error: type[XdexError], *, max_bytes: int = MAX_BYTES) -> tuple[Array, Faces]:
    """Reads the triangles of a mesh file, all meshes of a scene file joined.

    Files that the mesh refers to (glTF buffers) must lie in or below its folder; materials and textures are not read.

    Args:
        path: File of one of the types `MESH_SUFFIXES`.
        error: Class of the error to raise.
        max_bytes: Greatest size of the file, and of each file that it refers to.

    Returns:
        Vertices in the file's unit, shape (n, 3), and vertex indices of the triangles, shape (m, 3); nothing is checked
        or merged.

    Raises:
        XdexError: Of class `error`: the file is missing, too large, or no mesh of a known type.
    """
    suffix = path.suffix.lower()
    if not path.exists():
        raise error(f"{path}: no such file; check the path")
    if not path.is_file():
        raise error(f"{path}: not a file; give the path of a mesh file")
    if suffix in (".urdf", ".sdf", ".xml"):
        raise error(f"{path}: a model description, not a mesh; give the mesh file that it refers to")
    if suffix not in MESH_SUFFIXES:
        raise error(f"{path}: unknown type {suffix!r}; convert the mesh to one of {', '.join(MESH_SUFFIXES)}")
    if path.stat().st_size == 0:
        raise error(f"{path}: the file is empty; export the mesh again")
    if path.stat().st_size > max_bytes:
        raise error(f"{path}: larger than {max_bytes} bytes; simplify the mesh first")
    data = path.read_bytes()
    options: dict[str, Any] = {"skip_materials": True} if suffix in (".obj", ".gltf", ".glb") else {}
    try:
        if suffix == ".gltf":
            json.loads(data)
        scene = trimesh.load_scene(
            io.BytesIO(data),
            file_type=suffix[1:],
            resolver=_FolderResolver(path.parent, error, max_bytes),
            process=False,
            **options,
        )
        mesh = scene.to_mesh()
    except error as cause:
        raise error(f"{path}: {cause}") from None
    except ImportError as cause:
        raise error(f"{path}: reading {suffix} needs the package {cause.name}; install it, or use OBJ") from None
    except Exception as cause:  # The readers raise anything, from struct.error to RecursionError, on a broken file.
        reason = " ".join(str(cause).split())[:120] or type(cause).__name__
        raise error(f"{path}: not a readable {suffix[1:]} mesh ({reason}); export it again") from None
    return np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3), np.asarray(mesh.faces, dtype=np.int64).reshape(
        -1, 3
    )
