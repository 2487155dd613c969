"""Contacts lie on the surface: E_dis of Eq. (1), and as a constraint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.programs.block import MM, Block, without_forces
from xdex_drake.programs.point import Point
from xdex_drake.programs.term import Pull, View


def contact_distance(distances: Any, radii: Any, weights: Any) -> tuple[Any, Any]:
    """Sum of gaps between contact spheres and the surface: E_dis of Eq. (1).

    E_dis = sum_i w_i |SDF(c_i) - r_i|

    Args:
        distances: Signed distance of each contact sphere's center [m], shape (..., nc).
        radii: Their radii [m], shape (..., nc).
        weights: 1 for a contact that is asked for and 0 for one that is not, shape (..., nc).

    Returns:
        Value [m], shape (...), and gradient with respect to `distances`, shape (..., nc); 0 where a contact is exact.
    """
    gap = distances - radii
    return (weights * abs(gap)).sum(-1), weights * (1.0 * (gap > 0.0) - 1.0 * (gap < 0.0))


@dataclass(frozen=True)
class ContactDistance:
    """E_dis of Eq. (1): gaps of the contacts that are asked for; see `contact_distance`."""

    weight: float = 100.0
    name: str = "dis"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value [m] and gradient."""
        value, gradient = contact_distance(view.contact_distances, view.contact_radii, view.touching)
        return value, Pull(contact_distances=gradient)


def contact_block(contacts: int) -> Block:
    """Contact spheres lie on the surface: SDF(c_k) - r_k = 0."""

    def evaluate(point: Point) -> tuple[Array, Array]:
        J = np.einsum("ka,kab->kb", point.gap_gradients, point.contact_jacobian)
        return MM * point.contact_gaps, MM * without_forces(point, J)

    zero = np.zeros(contacts)
    return Block("contact", evaluate, zero, zero, "mm", "gap of each contact sphere is zero")
