"""What an imported hand looks like: the visual shapes of its file, made light, each in its color."""

from dataclasses import replace

import numpy as np
import trimesh

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.importing.bodies import Member, Tree
from xdex_drake.hand.importing.model import Cylinder, FileGeometry, TriangleMesh
from xdex_drake.hand.looks import primitive_surface, shell_colors
from xdex_drake.hand.surface import Color, Faces, Surface

MOST_FACES = 2500
"""Triangles of a visual mesh, beyond which its corners are drawn together: a page of the hand stays below 3 MB."""

FIRST_CELL = 3e-4
"""Edge of the cells whose corners are drawn together first; it grows until the mesh is light enough [m]."""

CREASE = 0.6
"""Faces that meet at a greater angle keep a sharp edge [rad]."""


def with_surfaces(hand: Hand, tree: Tree) -> Hand:
    """A hand with the visual meshes of its file.

    Args:
        hand: The hand.
        tree: Where its file's links are; its bodies are in the order of `hand.links`.

    Returns:
        The hand; the same one where its file brought no visual mesh.
    """
    if not any(isinstance(shape, TriangleMesh) for body in tree.members for m in body for shape in m.link.visual):
        return hand
    links = tuple(
        replace(link, surfaces=tuple(_surfaces(body, color)))
        for link, body, color in zip(hand.links, tree.members, shell_colors(hand), strict=True)
    )
    return replace(hand, links=links)


def _surfaces(body: tuple[Member, ...], color: Color) -> list[Surface]:
    found = []
    for member in body:
        R, p = member.X_LF[:3, :3], member.X_LF[:3, 3]
        found += [_surface(shape.moved(R, p), color) for shape in member.link.visual]
    return [surface for surface in found if len(surface.faces)]


def _surface(shape: FileGeometry, color: Color) -> Surface:
    if isinstance(shape, TriangleMesh):
        return _smoothed(*lighter(shape.vertices, shape.faces), shape.color or color)
    if isinstance(shape, Cylinder):
        mesh = trimesh.creation.cylinder(shape.radius, segment=np.stack([shape.p0, shape.p1]), sections=24)
        return _smoothed(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64), color)
    return primitive_surface(shape, color)


def _smoothed(vertices: Array, faces: Faces, color: Color) -> Surface:
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if len(faces):
        mesh = trimesh.graph.smooth_shade(mesh, angle=CREASE)
    return Surface(
        np.array(mesh.vertices, dtype=float),
        np.array(mesh.vertex_normals, dtype=float),
        np.array(mesh.faces, dtype=np.int64),
        color,
    )


def lighter(vertices: Array, faces: Faces, most: int = MOST_FACES) -> tuple[Array, Faces]:
    """A mesh of few triangles: corners within a cell become their mean, and triangles that collapse are left out.

    Args:
        vertices: Corners [m], shape (n, 3).
        faces: Corner indices, shape (m, 3).
        most: Greatest number of triangles.

    Returns:
        Corners and triangles.
    """
    cell = FIRST_CELL
    # Corners that agree are one, so that faces share normals; formats as STL repeat them.
    vertices, faces = _clustered(vertices, faces, 1e-6)
    light = vertices, faces
    while len(light[1]) > most:
        light = _clustered(vertices, faces, cell)
        cell *= 1.3
    return light


def _clustered(vertices: Array, faces: Faces, cell: float) -> tuple[Array, Faces]:
    _, at = np.unique(np.floor(vertices / cell + 0.5).astype(np.int64), axis=0, return_inverse=True)
    at = at.reshape(-1)
    count = np.bincount(at)
    means = np.column_stack([np.bincount(at, vertices[:, k]) for k in range(3)]) / count[:, None]
    moved = at[faces]
    whole = (moved[:, 0] != moved[:, 1]) & (moved[:, 1] != moved[:, 2]) & (moved[:, 2] != moved[:, 0])
    moved = moved[whole]
    _, first = np.unique(np.sort(moved, axis=1), axis=0, return_index=True)
    return means, moved[np.sort(first)].astype(np.int64)
