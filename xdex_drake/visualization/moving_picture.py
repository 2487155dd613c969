"""A moving picture of recorded lifts side by side, with the forces: for pages that show pictures only."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import trimesh
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    GeometryInstance,
    InMemoryMesh,
    Mesh,
    PerceptionProperties,
    Rgba,
    SceneGraph,
    Shape,
)
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.hand.looks import COARSE, Detail, hand_surfaces
from xdex_drake.scene.bodies import visual_mesh
from xdex_drake.scene.materials import object_color
from xdex_drake.visualization.dress import meshes_by_color
from xdex_drake.visualization.film import Film, Frame
from xdex_drake.visualization.forces import FORCE_COLOR, HEAD_LENGTH, HEAD_RADIUS, SHAFT_RADIUS, arrow_placement
from xdex_drake.visualization.pictures import Image, add_renderer, color_image, require_rendering

FLOOR_COLOR = (0.52, 0.54, 0.57)
STAND_OFF = 0.02
"""Distance of an arrow's tip from the contact [m]."""

Drawn = tuple[Shape, RigidTransform, Sequence[float]]


def render_films(
    films: Sequence[Film],
    offsets: Array,
    moments: Sequence[int],
    X_WC: RigidTransform,
    *,
    size: tuple[int, int],
    detail: Detail = COARSE,
) -> Iterator[Image]:
    """Renders recorded lifts, moment by moment; a lift that has ended stands still.

    Args:
        films: The lifts.
        offsets: Where each is moved to [m], shape (n, 3).
        moments: Numbers of frames.
        X_WC: Pose of the camera, z forward and y down.
        size: Width and height [pixels].
        detail: How finely hands are drawn.

    Yields:
        A picture for each moment: red, green and blue, shape (height, width, 3).

    Raises:
        MissingExtra: This machine cannot render.
    """
    require_rendering()
    meshes = [[meshes_by_color(surfaces) for surfaces in hand_surfaces(film.hand, detail)] for film in films]
    for moment in moments:
        scene_graph = SceneGraph()
        add_renderer(scene_graph)
        source = scene_graph.RegisterSource("films")
        drawn: list[Drawn] = [(Box(8.0, 8.0, 0.1), RigidTransform([0.0, 0.0, -0.05]), FLOOR_COLOR)]
        for film, offset, links in zip(films, offsets, meshes, strict=True):
            frame = film.frames[min(moment, len(film.frames) - 1)]
            X_WS = RigidTransform(offset)
            for X_WL, link in zip(frame.X_WLs, links, strict=True):
                drawn += [(mesh, X_WS @ X_WL, color) for color, mesh in link]
            thing = film.scene.object
            drawn.append((visual_mesh(thing), X_WS @ frame.X_WO, object_color(thing.name)))
            drawn += [(shape, X_WS @ X_WA, FORCE_COLOR) for shape, X_WA in _arrows(frame)]
        for k, (shape, X_WG, color) in enumerate(drawn):
            properties = PerceptionProperties()
            properties.AddProperty("phong", "diffuse", Rgba(*color))
            instance = GeometryInstance(X_WG, shape, str(k))
            instance.set_perception_properties(properties)
            scene_graph.RegisterAnchoredGeometry(source, instance)
        yield color_image(scene_graph, scene_graph.CreateDefaultContext(), X_WC, size)


def _arrows(frame: Frame) -> Iterator[tuple[Mesh, RigidTransform]]:
    """An arrow for each force; it ends behind the finger that pushes, since nothing is seen through here."""
    for push in frame.pushes:
        back = STAND_OFF * push.f_W / np.linalg.norm(push.f_W)
        X_WA, scale = arrow_placement(push.p_WC - back, push.f_W)
        head = trimesh.creation.cone(HEAD_RADIUS, HEAD_LENGTH, sections=16)
        # A cone of trimesh opens downward from its tip.
        head.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [1.0, 0.0, 0.0]))
        head.apply_translation([0.0, 0.0, HEAD_LENGTH])
        shaft = trimesh.creation.cylinder(SHAFT_RADIUS, scale[2], sections=16)
        shaft.apply_translation([0.0, 0.0, HEAD_LENGTH + 0.5 * scale[2]])
        mesh = trimesh.graph.smooth_shade(trimesh.util.concatenate([head, shaft]), angle=0.8)
        text = str(mesh.export(file_type="obj", include_normals=True))
        yield Mesh(InMemoryMesh(mesh_file=MemoryFile(text, ".obj", "arrow"))), X_WA
