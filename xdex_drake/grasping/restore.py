"""Makes a whole grasp again from what little is stored of it: wrist pose, joint values and what touches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.grasping.finish import GIVEN, Outcome, certified, polish, prepared
from xdex_drake.grasping.passive import holding_squeeze
from xdex_drake.grasping.reasons import Rejection
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.force_closure import contact_set, polish_program
from xdex_drake.programs.point import Point
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LIFT

RESTORED = replace(GIVEN, squeezes=(*GIVEN.squeezes, (0.97, 0.25)), touch_m=4e-4, smoothing_m=6e-4, penetration_m=6e-4)
"""A little wider than what was asked of the grasp, so that rounding does not take it across a bound."""


def restore(hand: Hand, scene: Scene, X_WH: RigidTransform, q: Array, slots: NDArray[np.bool_]) -> Outcome:
    """Certificate, pre-grasp, approach and squeeze of a grasp whose pose was rounded.

    Args:
        hand: The hand.
        scene: The scene.
        X_WH: Wrist pose, right to some 10 micrometres.
        q: Joint values, shape (n,).
        slots: Which contact slots touch: the fingers, in the order of `hand.fingers`, then the palm.

    Returns:
        The grasp as `finish` makes it; where rounding took it across a bound, after a polish from where it is.
    """
    k = Configuration.at(hand, X_WH, q)
    contacts = contact_set(hand, scene, k, slots)
    found = certified(hand, Point(k, scene, contacts, np.zeros((len(contacts.spheres), 3))), RESTORED)
    if not isinstance(found, Rejection):
        # Idle fingers rest already.
        holding = holding_squeeze(hand, found[0], scene, found[1], kp=LIFT.plant.kp)
        outcome = prepared(hand, scene, *found, holding, protocol=LIFT, demands=RESTORED)
        if outcome.grasp is not None:
            return outcome
    return polish(polish_program(hand, scene, X_WH, q, slots), demands=RESTORED)
