"""Which links of a hand may collide and must be kept apart.

Programs (on spheres) and Drake plants (by collision filters) take the pairs from here, so that both agree.
"""

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import forward_kinematics

OVERLAP_MARGIN = 5e-4
"""Links whose spheres come nearer than this at the rest posture count as overlapping by construction [m]."""


def self_collision_pairs(hand: Hand) -> NDArray[np.int64]:
    """Pairs of links that may collide and must be kept apart.

    Left out are links without geometry, parent and child, a link and its grandchild through links without geometry
    (a hub), links that overlap at the rest posture, as nested joints do, and `hand.ignored_contacts`.

    Args:
        hand: The hand.

    Returns:
        Pairs (i, j) of indices into `hand.links`, i < j, in rising order, shape (m, 2).
    """
    spheres_H = spheres_of_links(hand, hand.q_rest)
    left_out = {(_solid_parent(hand, k), k) for k in range(1, len(hand.links))}
    left_out |= {(min(pair), max(pair)) for pair in ignored_indices(hand)}
    pairs = [
        (i, j)
        for i in range(len(hand.links))
        for j in range(i + 1, len(hand.links))
        if len(spheres_H[i])
        and len(spheres_H[j])
        and (i, j) not in left_out
        and sphere_distance(spheres_H[i], spheres_H[j]) > OVERLAP_MARGIN
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def ignored_pairs(hand: Hand) -> NDArray[np.int64]:
    """Pairs of links with geometry whose contact is to be ignored: all that `self_collision_pairs` leaves out.

    Args:
        hand: The hand.

    Returns:
        Pairs (i, j) of indices into `hand.links`, i < j, in rising order, shape (m, 2).
    """
    kept = {(int(i), int(j)) for i, j in self_collision_pairs(hand)}
    solid = [k for k, link in enumerate(hand.links) if link.geometry]
    pairs = [(i, j) for n, i in enumerate(solid) for j in solid[n + 1 :] if (i, j) not in kept]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def ignored_indices(hand: Hand) -> list[tuple[int, int]]:
    """The pairs of `hand.ignored_contacts` as indices into `hand.links`."""
    return [(hand.link_index[a], hand.link_index[b]) for a, b in hand.ignored_contacts]


def _solid_parent(hand: Hand, k: int) -> int:
    """Index of the nearest ancestor that has geometry; -1 where there is none."""
    k = int(hand.parents[k])
    while k >= 0 and not hand.links[k].geometry:
        k = int(hand.parents[k])
    return k


def spheres_of_links(hand: Hand, q: Array) -> list[Array]:
    """Spheres of each link at a posture.

    Args:
        hand: The hand.
        q: Actuated joint values [rad or m], shape (n,).

    Returns:
        For each link rows (x, y, z, radius), centers in H [m], shape (n_spheres, 4).
    """
    R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), q)
    return [
        np.column_stack([link.spheres[:, :3] @ R_HL.T + p_HL, link.spheres[:, 3]])
        for link, R_HL, p_HL in zip(hand.links, R_HLs, p_HLs, strict=True)
    ]


def sphere_distance(a: Array, b: Array) -> float:
    """Least distance between two sets of spheres, negative where they overlap [m].

    Args:
        a: Rows (x, y, z, radius) [m], shape (n, 4), n at least 1.
        b: Rows likewise, shape (m, 4), m at least 1.

    Returns:
        The distance [m].
    """
    centers = np.linalg.norm(a[:, None, :3] - b[None, :, :3], axis=-1)
    return float((centers - a[:, None, 3] - b[None, :, 3]).min())
