"""Contacts lie on the pads of the fingers: as an energy, and as a constraint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from xdex_drake.arrays import Array, cross
from xdex_drake.programs.block import Block, without_forces
from xdex_drake.programs.point import Point
from xdex_drake.programs.term import Pull, View


def alignment(a_Ws: Any, b_Ws: Any, least: float, weights: Any) -> tuple[Any, Any, Any]:
    """How far pairs of unit vectors fall short of a least cosine: keeps contacts on the pads of the fingers.

    E = sum_i w_i max(0, least - a_i . b_i)

    Args:
        a_Ws: Unit vectors, shape (..., m, 3).
        b_Ws: Unit vectors, shape (..., m, 3).
        least: Cosine that is enough.
        weights: Weight of each pair, shape (..., m).

    Returns:
        Value, shape (...), gradients with respect to `a_Ws` and `b_Ws`, shape (..., m, 3).
    """
    short = (least - (a_Ws * b_Ws).sum(-1)).clip(min=0.0)
    active = (weights * (short > 0.0))[..., None]
    return (weights * short).sum(-1), -active * b_Ws, -active * a_Ws


@dataclass(frozen=True)
class PadAlignment:
    """Contact normals and pad normals are nearly one; see `alignment`.

    Attributes:
        weight: Weight.
        least: Cosine that is enough.
        name: Name.
    """

    weight: float = 3.0
    least: float = 0.6
    name: str = "pad"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value and gradient."""
        value, on_normals, on_pads = alignment(view.normals_W, view.pads_W, self.least, view.touching)
        return value, Pull(normals_W=on_normals, pads_W=on_pads)


def pad_block(pads_L: Array, least: float) -> Block:
    """Contacts lie on the pads: n_pad . n_contact >= least.

    Args:
        pads_L: Pad normal of each contact's finger in its tip link, shape (nc, 3).
        least: Least cosine.

    Returns:
        The block.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        pads = point.k.vectors(point.contacts.links, pads_L)
        n = point.normals_W
        J_turn = point.k.angular_jacobian(point.contacts.links)
        J = np.einsum("ka,kab->kb", cross(pads, n), J_turn) + np.einsum("ka,kab->kb", pads, point.normal_jacobian)
        return (pads * n).sum(1), without_forces(point, J)

    m = len(pads_L)
    return Block("pad", evaluate, np.full(m, least), np.full(m, np.inf), "-", "cosine of contact and pad normals")
