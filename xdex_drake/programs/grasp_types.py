"""Grasp types: which fingers, and whether the palm, carry contact, and from where a hand comes.

A contact slot is a part of the hand that can touch: the tip link of each finger, in the order of `hand.fingers`, and
after them the palm. A contact set is a row of booleans over the slots.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration

GraspType = Literal["any", "pinch", "tripod", "power"]
"""`any`: the thumb and two or more others; `pinch`: the thumb and one other; `tripod`: the thumb and two others;
`power`: the palm, the thumb and two or more others. A hand without a thumb uses neighbouring fingers instead."""


@dataclass(frozen=True)
class Slot:
    """A part of the hand that can touch.

    Attributes:
        name: Name of the finger, or `palm`.
        link: Index of its link.
        spheres: Indices of its spheres among `hand.spheres`, shape (k,).
        n_LPad: Unit vector out of its pad, in its link, shape (3,).
    """

    name: str
    link: int
    spheres: NDArray[np.int64]
    n_LPad: Array


def contact_slots(hand: Hand) -> tuple[Slot, ...]:
    """The contact slots of a hand: its fingers' tip links, then its palm.

    The palm is the base link. Its pad faces where those of the fingers, the thumb apart, face at zero joint angles.
    """
    slots = []
    for finger in hand.fingers:
        link = hand.link_index[finger.tip_link]
        slots.append(Slot(finger.name, link, np.flatnonzero(hand.sphere_links == link), finger.n_LPad))
    flat = Configuration.at(hand, RigidTransform(), np.clip(np.zeros(len(hand.q_rest)), *hand.limits))
    pads = [flat.R_WLs[slot.link] @ slot.n_LPad for slot in slots if slot.name != "thumb" or len(slots) == 1]
    n_LPad = flat.R_WLs[0].T @ np.mean(pads, axis=0)
    n_LPad = n_LPad / max(float(np.linalg.norm(n_LPad)), 1e-9)
    return (*slots, Slot("palm", 0, np.flatnonzero(hand.sphere_links == 0), n_LPad))


def random_contact_sets(
    hand: Hand, rng: np.random.Generator, count: int, contacts: int, grasp_type: GraspType = "any"
) -> NDArray[np.bool_]:
    """Which slots shall touch: the thumb, where there is one, and some neighbouring others; the palm for `power`.

    Args:
        hand: The hand.
        rng: Source of randomness.
        count: How many sets.
        contacts: Greatest number of fingers in a set.
        grasp_type: The type of grasp; for `pinch` and `tripod` it gives the number of fingers.

    Returns:
        Sets over the fingers, in the order of `hand.fingers`, and for `power` the palm, shape (count, n_slots).
    """
    names = [f.name for f in hand.fingers]
    thumb = [k for k, name in enumerate(names) if name == "thumb"]
    others = [k for k, name in enumerate(names) if name != "thumb"]
    power = grasp_type == "power"
    sets = np.zeros((count, len(names) + power), dtype=bool)
    fingers = {"pinch": 2, "tripod": 3}.get(grasp_type, contacts)
    most = min(fingers - len(thumb), len(others))
    # Two hard fingers cannot resist a torque about the line between them, so pinches are left to hands that can do no
    # more, and to those who ask for them.
    least = most if grasp_type in ("pinch", "tripod") else min(2, most)
    for row in sets:
        size = int(rng.integers(least, most + 1))
        first = int(rng.integers(0, len(others) - size + 1))
        row[thumb] = True
        row[others[first : first + size]] = True
        row[len(names) :] = True
    return sets


def finger_tips(hand: Hand) -> tuple[NDArray[np.int64], Array]:
    """The tips of a hand's fingers, in the order of `hand.fingers`.

    Args:
        hand: The hand.

    Returns:
        Indices of their links, shape (n_fingers,), and the points in those links' frames [m], shape (n_fingers, 3).
    """
    links = np.array([hand.link_index[f.tip_link] for f in hand.fingers])
    return links, np.array([f.p_LTip for f in hand.fingers])


@lru_cache(maxsize=64)
def approach_axis(hand: Hand) -> tuple[Array, Array]:
    """Where a hand at rest would hold an object, and from which direction it comes, in H.

    Args:
        hand: The hand.

    Returns:
        The midpoint of the thumb's tip and the mean of the other tips [m], shape (3,), and the unit vector from the
        palm to it.
    """
    at_rest = Configuration.at(hand, RigidTransform(), hand.q_rest)
    tips = at_rest.points(*finger_tips(hand))
    thumb = np.array([f.name == "thumb" for f in hand.fingers])
    opposed = thumb.any() and not thumb.all()
    center = 0.5 * (tips[thumb].mean(0) + tips[~thumb].mean(0)) if opposed else tips.mean(0)
    # The palm: the mean of the roots of the fingers.
    roots = np.array([hand.link_index[f.links[0]] for f in hand.fingers])
    direction = center - at_rest.p_WLs[roots].mean(0)
    return center, direction / np.linalg.norm(direction)
