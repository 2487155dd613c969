"""Whether a grasp, a hand and a scene belong together."""

from __future__ import annotations

import numpy as np

from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.scene.tabletop import Scene

SAME_POSE = 1e-6
"""Difference of an object's pose that counts as none [m and entries of a rotation]."""


def check_belonging(grasp: Grasp, hand: Hand, scene: Scene) -> None:
    """Refuses a grasp of another hand, object or pose than those given with it.

    Args:
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.

    Raises:
        ConfigError: They do not belong together; the message names both.
    """
    check_hand_of(grasp, hand)
    if grasp.object != scene.object.name:
        raise ConfigError(f"{_label(grasp)} is of object {grasp.object!r}, the scene holds {scene.object.name!r}")
    if not np.allclose(grasp.X_WO.GetAsMatrix34(), scene.X_WO.GetAsMatrix34(), rtol=0.0, atol=SAME_POSE):
        raise ConfigError(
            f"{_label(grasp)} is of {grasp.object!r} at another pose than scene {scene.scene_id}; give its own scene, "
            "make_scene(object, pose=grasp.X_WO)"
        )


def check_hand_of(grasp: Grasp, hand: Hand) -> None:
    """Refuses a grasp of another hand than the one given with it.

    Args:
        grasp: The grasp.
        hand: Its hand.

    Raises:
        ConfigError: It is of another hand, or of one with other joints or links.
    """
    if grasp.hand != hand.name:
        raise ConfigError(f"{_label(grasp)} is of hand {grasp.hand!r}, not of {hand.name!r}; give its own hand")
    for name in ("q", "q_pregrasp", "q_squeeze", "tau_squeeze"):
        values = getattr(grasp, name)
        if values is not None and len(values) != len(hand.joint_names):
            raise ConfigError(
                f"{_label(grasp)}: {name} has {len(values)} values, {hand.name} has {len(hand.joint_names)} actuated "
                "joints; give the hand as it was then"
            )
    contacts = () if grasp.certificate is None else grasp.certificate.contacts
    if strange := sorted({contact.link for contact in contacts} - set(hand.link_index)):
        raise ConfigError(f"{_label(grasp)} touches by {strange[0]!r}, no link of {hand.name}; give its own hand")


def check_liftable(grasp: Grasp) -> None:
    """Refuses a grasp that has no pre-grasp or squeeze.

    Args:
        grasp: The grasp.

    Raises:
        ConfigError: It cannot be lifted as it is.
    """
    if grasp.q_pregrasp is None or grasp.X_WH_pregrasp is None or grasp.tau_squeeze is None:
        raise ConfigError(f"{_label(grasp)} has no pre-grasp or squeeze to lift it by; make it with finish_grasp")


def _label(grasp: Grasp) -> str:
    return f"grasp {grasp.grasp_id}" if grasp.grasp_id else "the grasp"
