"""A surface to draw, and surfaces as a file."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError

Color = tuple[float, float, float]
Faces = NDArray[np.int64]

MAX_BYTES = 50_000_000


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface of triangles that is drawn with a link.

    Attributes:
        vertices: Corners in L [m], shape (n, 3).
        normals: Outward unit normals at the corners, shape (n, 3).
        faces: Corner indices, counterclockwise from outside, shape (m, 3).
        color: Red, green, blue.
    """

    vertices: Array
    normals: Array
    faces: Faces
    color: Color

    def mirrored(self) -> "Surface":
        """The mirror image in the plane y = 0."""
        flip = np.array([1.0, -1.0, 1.0])
        return Surface(self.vertices * flip, self.normals * flip, self.faces[:, ::-1], self.color)


def write_surfaces(surfaces: Mapping[str, Sequence[Surface]], path: Path) -> None:
    """Writes surfaces of links as a GLB file, which any viewer opens: a mesh for each, in its link's frame.

    Args:
        surfaces: Surfaces of each link.
        path: The file.
    """
    scene = trimesh.Scene()
    for link, drawn in surfaces.items():
        for k, surface in enumerate(drawn):
            mesh = trimesh.Trimesh(surface.vertices, surface.faces, vertex_normals=surface.normals, process=False)
            color = [*(round(255 * c) for c in surface.color), 255]
            material = PBRMaterial(baseColorFactor=color, metallicFactor=0.1)
            mesh.visual = TextureVisuals(material=material)
            # Names of meshes may change on the way; this entry does not.
            mesh.metadata = {"link": link}
            scene.add_geometry(mesh, node_name=f"{link}_{k}", geom_name=f"{link}_{k}")
    data = scene.export(file_type="glb", include_normals=True)
    assert isinstance(data, bytes)
    path.write_bytes(data)


def read_surfaces(path: Path) -> dict[str, tuple[Surface, ...]]:
    """Reads surfaces that `write_surfaces` wrote.

    Args:
        path: The file.

    Returns:
        Surfaces of each link.

    Raises:
        HandFileError: The file cannot be read or holds something else.
    """
    found: dict[str, list[Surface]] = {}
    try:
        if path.stat().st_size > MAX_BYTES:
            raise HandFileError(f"{path}: is larger than {MAX_BYTES} bytes; remove it, it is there only to be seen")
        # Read from memory: the file may name no other file.
        scene = trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type="glb", process=False)
        for mesh in scene.geometry.values():
            if not isinstance(mesh, trimesh.Trimesh) or "link" not in mesh.metadata:
                continue
            factor = np.asarray(cast(Any, mesh.visual).material.baseColorFactor, dtype=float)[:3] / 255.0
            color = (float(factor[0]), float(factor[1]), float(factor[2]))
            surface = Surface(
                np.array(mesh.vertices, dtype=float),
                np.array(mesh.vertex_normals, dtype=float),
                np.array(mesh.faces, dtype=np.int64),
                color,
            )
            found.setdefault(str(mesh.metadata["link"]), []).append(surface)
    except HandFileError:
        raise
    except Exception as error:  # trimesh raises whatever its reader meets
        raise HandFileError(
            f"{path}: cannot be read as a GLB file of surfaces ({type(error).__name__}); import the hand "
            "again, or remove it, it is there only to be seen"
        ) from error
    return {link: tuple(surfaces) for link, surfaces in found.items()}
