"""Hands as they look, in place of the primitives by which they touch."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby

from pydrake.common import MemoryFile
from pydrake.geometry import (
    GeometryInstance,
    IllustrationProperties,
    InMemoryMesh,
    Mesh,
    PerceptionProperties,
    Rgba,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from xdex_drake.hand.description import Hand
from xdex_drake.hand.looks import COARSE, FINE, Color, Detail, Surface, hand_surfaces, surface_obj

MANY_HANDS = 6
"""From this many hands on a page they are drawn coarsely."""


def detail_for(hands: int) -> Detail:
    """How finely hands are drawn on a page of so many."""
    return FINE if hands < MANY_HANDS else COARSE


def dress(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    hand: Hand,
    *,
    model_name: str | None = None,
    detail: Detail = FINE,
) -> None:
    """Makes visualizers and cameras see a hand as it looks; what touches stays.

    Args:
        plant: A finalized plant with the hand.
        scene_graph: Its scene graph, before the diagram has a context.
        hand: The hand.
        model_name: Name of its model instance; the hand's name where None.
        detail: How finely.
    """
    source = plant.get_source_id()
    assert source is not None
    instance = plant.GetModelInstanceByName(model_name or hand.name)
    for link, surfaces in zip(hand.links, hand_surfaces(hand, detail), strict=True):
        body = plant.GetBodyByName(link.name, instance)
        for geometry in plant.GetVisualGeometriesForBody(body):
            scene_graph.RemoveRole(source, geometry, Role.kIllustration)
            scene_graph.RemoveRole(source, geometry, Role.kPerception)
        frame = plant.GetBodyFrameIdOrThrow(body.index())
        for k, (color, mesh) in enumerate(meshes_by_color(surfaces)):
            drawn = GeometryInstance(RigidTransform(), mesh, f"{body.name()}_look_{k}")
            illustration, perception = IllustrationProperties(), PerceptionProperties()
            illustration.AddProperty("phong", "diffuse", Rgba(*color))
            perception.AddProperty("phong", "diffuse", Rgba(*color))
            drawn.set_illustration_properties(illustration)
            drawn.set_perception_properties(perception)
            scene_graph.RegisterGeometry(source, frame, drawn)


def meshes_by_color(surfaces: Iterable[Surface]) -> list[tuple[Color, Mesh]]:
    """The surfaces of a link as Drake shapes, one for each color.

    Args:
        surfaces: The surfaces, in L.

    Returns:
        Colors and shapes; the shapes' frames are L.
    """
    ordered = sorted(surfaces, key=lambda surface: surface.color)
    return [
        (color, Mesh(InMemoryMesh(mesh_file=MemoryFile(surface_obj(list(group)), ".obj", "look"))))
        for color, group in groupby(ordered, key=lambda surface: surface.color)
    ]
