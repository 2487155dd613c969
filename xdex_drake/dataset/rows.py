"""Rows of grasps, with the object points that condition the model."""

from __future__ import annotations

from dataclasses import replace

from xdex_drake.dataset.schema import ObjectFacts, Row, row_from_grasp
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Array, Hand
from xdex_drake.hand.heading import object_point
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.yaml_file import hand_digest
from xdex_drake.scene.object import ObjectModel
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LIFT

OBJECT_POINTS = 2048
"""Surface points among which a grasp's object point is chosen."""


def object_facts(obj: ObjectModel, path: str) -> ObjectFacts:
    """What rows say about an object.

    Args:
        obj: The object.
        path: Library name or path by which it was loaded.

    Returns:
        The facts.
    """
    return ObjectFacts(obj.name, path, obj.digest, obj.scale, obj.mass, obj.friction, obj.p_OOcm, obj.length)


def grasp_object_point(hand: Hand, grasp: Grasp, scene: Scene) -> Array:
    """The object point that a grasp heads for, in O [m], shape (3,); see `hand.heading`."""
    R_WLs, p_WLs = forward_kinematics(hand, grasp.X_WH, grasp.q)
    points_O, _ = scene.object.surface_samples(OBJECT_POINTS)
    return points_O[object_point(hand, R_WLs, p_WLs, (scene.X_WO @ points_O.T).T)]


def rows_of_scene(
    grasps: list[Grasp], hands: dict[str, Hand], scene: Scene, path: str, digests: dict[str, str] | None = None
) -> list[Row]:
    """Rows of grasps of one scene, with the object points that condition the model.

    Args:
        grasps: Grasps; a retargeted one comes after its source.
        hands: Their hands by name.
        scene: Their scene.
        path: Library name or path of the object.
        digests: Digest of each hand by name; computed where None.

    Returns:
        One row a grasp.
    """
    facts = object_facts(scene.object, path)
    digests = digests or {name: hand_digest(hand) for name, hand in hands.items()}
    points = {grasp.grasp_id: grasp_object_point(hands[grasp.hand], grasp, scene) for grasp in grasps}
    return [
        row_from_grasp(
            # Times differ from run to run; rows do not.
            replace(grasp, seconds=0.0, lift=None if grasp.lift is None else replace(grasp.lift, seconds=0.0)),
            scene_id=scene.scene_id,
            hand=hands[grasp.hand],
            hand_digest=digests[grasp.hand],
            object=facts,
            gains=(LIFT.plant.kp, LIFT.plant.kd),
            object_point_O=points[grasp.grasp_id],
            source_object_point_O=points.get(grasp.source_grasp_id or grasp.grasp_id),
        )
        for grasp in grasps
    ]
