"""A left hand from a right one."""

import re
from dataclasses import replace

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand, Joint, Link
from xdex_drake.hand.shapes import FLIP

_OTHER = {"right": "left", "left": "right"}
_NOTE = "mirror"


def mirror(hand: Hand) -> Hand:
    """The mirror image of a hand: a left one of a right one and the other way round.

    Every frame F of the hand becomes S X_HF S with S the reflection in the plane y = 0 of the wrist frame H, so each
    joint keeps its name, its limits and its values, and the same q gives the mirrored pose. Mirroring twice gives the
    hand itself.

    Args:
        hand: The hand.

    Returns:
        Its mirror image, named with `_left` in the place of `_right` or at the end, and the other way round.
    """
    sources = {key: text for key, text in hand.sources.items() if key != _NOTE}
    original = re.fullmatch(r"mirror image of (\S+) \((.*)\)", hand.sources.get(_NOTE, ""))
    if original is not None:
        name, display_name = original.groups()
    else:
        name = _mirrored_name(hand.name, hand.side, "_")
        display_name = _mirrored_name(hand.display_name, hand.side, ", ")
        sources[_NOTE] = f"mirror image of {hand.name} ({hand.display_name})"
    return Hand(
        name=name,
        display_name=display_name,
        side=_OTHER[hand.side],
        links=tuple(_mirrored_link(link) for link in hand.links),
        joints=tuple(_mirrored_joint(joint) for joint in hand.joints),
        fingers=tuple(replace(f, p_LTip=_flip(f.p_LTip), n_LPad=_flip(f.n_LPad)) for f in hand.fingers),
        p_HB=_flip(hand.p_HB),
        R_HB=_flip_rotation(hand.R_HB),
        q_rest=hand.q_rest,
        sources=sources,
        ignored_contacts=hand.ignored_contacts,
    )


def _mirrored_name(name: str, side: str, separator: str) -> str:
    """`allegro` becomes `allegro_left`, `svh_right` becomes `svh_left`."""
    words = name.split(separator)
    if side in words:
        return separator.join(_OTHER[side] if word == side else word for word in words)
    return f"{name}{separator}{_OTHER[side]}"


def _flip(v: Array) -> Array:
    return v * FLIP


def _flip_rotation(R: Array) -> Array:
    return R * np.outer(FLIP, FLIP)


def _mirrored_link(link: Link) -> Link:
    return Link(
        link.name,
        tuple(shape.mirrored() for shape in link.geometry),
        link.mass,
        _flip(link.p_LLcm),
        _flip_rotation(link.I_LLcm),
        link.spheres * np.array([*FLIP, 1.0]),
        tuple(surface.mirrored() for surface in link.surfaces),
    )


def _mirrored_joint(joint: Joint) -> Joint:
    # Turning about a, seen in a mirror, is turning about -S a by the same angle.
    sign = 1.0 if joint.kind == "prismatic" else -1.0
    return replace(joint, p_PJ=_flip(joint.p_PJ), R_PJ=_flip_rotation(joint.R_PJ), axis=sign * _flip(joint.axis))
