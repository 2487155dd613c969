"""Which of a hand's spheres stand for it, and which pairs of them must stay apart."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from xdex_drake.hand.collision import self_collision_pairs
from xdex_drake.hand.description import Hand
from xdex_drake.programs.grasp_types import contact_slots

SPACING = 1.0
"""Distance between neighbouring spheres of a link in the search, in radii; the polish takes all of them."""

PAIR_SPACING = 2.0
"""The same for spheres of links that must stay apart."""


@lru_cache(maxsize=64)
def search_spheres(hand: Hand, *, palm: bool = False) -> NDArray[np.int64]:
    """The spheres that energy terms keep apart from object and table; all of those of links that may touch.

    Args:
        hand: The hand.
        palm: Whether the palm may touch.

    Returns:
        Indices into `hand.spheres`, rising, shape (m,).
    """
    slots = contact_slots(hand)
    return spread_spheres(hand, spacing=SPACING, whole=[slot.link for slot in (slots if palm else slots[:-1])])


def spread_spheres(hand: Hand, *, spacing: float, whole: Collection[int] = ()) -> NDArray[np.int64]:
    """Fewer spheres that still stand for the hand.

    Spheres overlap along a link, so not all are needed everywhere: each link keeps those that lie at least some radii
    from the ones kept before them, and its last.

    Args:
        hand: The hand.
        spacing: Distance between neighbours that are kept, in radii.
        whole: Links that keep all.

    Returns:
        Indices into `hand.spheres`, rising, shape (m,).
    """
    keep: list[int] = []
    for link in range(len(hand.links)):
        rows = np.flatnonzero(hand.sphere_links == link)
        kept: list[int] = []
        for row in rows:
            center, radius = hand.spheres[row, :3], hand.spheres[row, 3]
            apart = np.linalg.norm(hand.spheres[kept, :3] - center, axis=1) > spacing * radius
            if link in whole or row == rows[-1] or apart.all():
                kept.append(int(row))
        keep += kept
    return np.array(keep, dtype=np.int64)


@lru_cache(maxsize=64)
def sphere_pairs(hand: Hand, *, spacing: float = 0.8, base: bool = True) -> NDArray[np.int64]:
    """Pairs of spheres on links that must stay apart.

    Args:
        hand: The hand.
        spacing: Distance between neighbouring spheres that are kept, in radii; see `spread_spheres`.
        base: Whether the base link takes part.

    Returns:
        Indices into `hand.spheres`, shape (m, 2).
    """
    coarse = spread_spheres(hand, spacing=spacing)
    link_of = hand.sphere_links[coarse]
    apart = np.zeros((len(hand.links), len(hand.links)), dtype=bool)
    for a, b in self_collision_pairs(hand):
        apart[a, b] = apart[b, a] = base or (a > 0 and b > 0)
    i, j = np.triu_indices(len(coarse), 1)
    kept = apart[link_of[i], link_of[j]]
    return np.stack([coarse[i[kept]], coarse[j[kept]]], axis=1)
