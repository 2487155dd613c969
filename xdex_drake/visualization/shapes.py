"""Still pictures of meshes alone."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import (
    GeometryInstance,
    InMemoryMesh,
    Mesh,
    PerceptionProperties,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.scene.materials import OTHER_MATERIALS
from xdex_drake.visualization.pictures import FOV_Y, Image, add_renderer, color_image, require_rendering

ELEVATION = 0.45
"""Elevation from which a shape is seen [rad]."""

AZIMUTH = -0.9
"""Azimuth from which a shape is seen [rad]."""


def render_shape(vertices: Array, faces: NDArray[np.int64], *, size: tuple[int, int] = (160, 140)) -> Image:
    """Renders a mesh, framed.

    Args:
        vertices: Vertices, z up [m], shape (n, 3).
        faces: Outward triangles, shape (m, 3).
        size: Width and height [pixels].

    Returns:
        Red, green and blue, shape (height, width, 3).

    Raises:
        MissingExtra: This machine cannot render.
    """
    require_rendering()
    mesh = trimesh.graph.smooth_shade(trimesh.Trimesh(vertices, faces, process=False), angle=0.5)
    text = str(mesh.export(file_type="obj", include_normals=True))
    scene_graph = SceneGraph()
    add_renderer(scene_graph, shadows=False)
    shape = Mesh(InMemoryMesh(mesh_file=MemoryFile(text, ".obj", "shape")))
    instance = GeometryInstance(RigidTransform(), shape, "shape")
    properties = PerceptionProperties()
    properties.AddProperty("phong", "diffuse", Rgba(*OTHER_MATERIALS[0]))
    instance.set_perception_properties(properties)
    scene_graph.RegisterAnchoredGeometry(scene_graph.RegisterSource("shapes"), instance)
    center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    radius = float(np.linalg.norm(vertices - center, axis=1).max())
    back = np.array([np.cos(ELEVATION) * np.cos(AZIMUTH), np.cos(ELEVATION) * np.sin(AZIMUTH), np.sin(ELEVATION)])
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    R_WC = RotationMatrix(np.column_stack([right, -np.cross(back, right), -back]))
    X_WC = RigidTransform(R_WC, center + back * 1.05 * radius / np.sin(0.5 * FOV_Y))
    return color_image(scene_graph, scene_graph.CreateDefaultContext(), X_WC, size, samples=1)
