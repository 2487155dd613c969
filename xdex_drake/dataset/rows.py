"""Rows of grasps, with the object points that condition the model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.dataset.schema import ObjectFacts, Row, row_from_grasp
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.hand.heading import object_point
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.yaml_file import hand_digest
from xdex_drake.scene.facts import source_of
from xdex_drake.scene.object import ObjectModel
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LIFT, LiftProtocol

OBJECT_POINTS = 2048
"""Surface points among which a grasp's object point is chosen."""


def object_facts(obj: ObjectModel) -> ObjectFacts:
    """What rows say about an object.

    Args:
        obj: The object.

    Returns:
        The facts.
    """
    path = source_of(obj)
    return ObjectFacts(obj.name, path, obj.digest, obj.scale, obj.mass, obj.friction, obj.p_OOcm, obj.length)


def grasp_object_point(hand: Hand, grasp: Grasp, scene: Scene) -> Array:
    """The object point that a grasp heads for, in O [m], shape (3,); see `hand.heading`."""
    R_WLs, p_WLs = forward_kinematics(hand, grasp.X_WH, grasp.q)
    points_O, _ = scene.object.surface_samples(OBJECT_POINTS)
    return points_O[object_point(hand, R_WLs, p_WLs, (scene.X_WO @ points_O.T).T)]


def rows_of(
    grasps: Iterable[Grasp],
    hand: Hand,
    scene: Scene,
    *,
    source_points: Mapping[str, Sequence[float] | Array] | None = None,
    protocol: LiftProtocol = LIFT,
) -> list[Row]:
    """Rows of grasps by one hand in one scene, with the object points that condition the model.

    Args:
        grasps: The grasps.
        hand: Their hand.
        scene: Their scene.
        source_points: Object point, in O [m], of each source grasp by its identifier, for retargeted grasps.
        protocol: The protocol whose gains the squeeze targets are for.

    Returns:
        The rows, ready for `grasp_file.write_grasps`.
    """
    digest, facts = hand_digest(hand), object_facts(scene.object)
    rows = []
    for grasp in grasps:
        point = grasp_object_point(hand, grasp, scene)
        source = (source_points or {}).get(grasp.source_grasp_id) if grasp.source_grasp_id else point
        rows.append(
            row_from_grasp(
                grasp,
                scene_id=scene.scene_id,
                hand=hand,
                hand_digest=digest,
                object=facts,
                gains=(protocol.plant.kp, protocol.plant.kd),
                object_point_O=point,
                source_object_point_O=None if source is None else np.asarray(source, dtype=float),
            )
        )
    return rows


def timeless(grasp: Grasp) -> Grasp:
    """The grasp without the times that it took, which differ from run to run where rows shall not."""
    return replace(grasp, seconds=0.0, lift=None if grasp.lift is None else replace(grasp.lift, seconds=0.0))
