"""Postures to try, the same for a hand and for its mirror image, in whatever order and sense a file has its joints."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.importing.anatomy import Anatomy, zero_posture
from xdex_drake.hand.importing.bodies import link_poses

_ASKEW = np.array([1.0, 0.7, 0.4])
"""No joint of a hand is likely to turn about an axis across this direction of H."""


@dataclass(frozen=True)
class Senses:
    """The order and the sense in which postures are drawn.

    Attributes:
        order: Actuated joints, thumb first, each finger from root to tip.
        sign: For each of these +1, or -1 where its mirror image or another maker would count the other way round.
    """

    order: NDArray[np.int64]
    sign: Array

    def steps(self, z: Array) -> Array:
        """Steps in joint space from ones drawn about zero, shape (N, n)."""
        out = np.empty_like(z)
        out[:, self.order] = z * self.sign
        return out

    def shares(self, u: Array) -> Array:
        """Shares of the joints' ranges from ones drawn within 0 and 1, shape (N, n)."""
        out = np.empty_like(u)
        out[:, self.order] = np.where(self.sign > 0.0, u, 1.0 - u)
        return out


def senses(hand: Hand, anatomy: Anatomy) -> Senses:
    """The order and sense of a hand's joints that its mirror image has, too.

    Joints that bend a finger count positive where they close it, the others by the side to which their axes point in
    the wrist frame of a right hand.

    Args:
        hand: The hand, with its wrist frame.
        anatomy: Its fingers.

    Returns:
        Order and signs.
    """
    C = hand.coupling_matrix
    R = link_poses(hand, zero_posture(hand))[0][0]
    mirrored = anatomy.side == "left"
    order: list[int] = []
    sign: dict[int, float] = {}
    everywhere = tuple(range(1, len(hand.links)))
    closings = [digit.closing for digit in anatomy.digits]
    for path, closing in zip([*(d.chain.path for d in anatomy.digits), everywhere], [*closings, None], strict=True):
        for body in path:
            for k in np.flatnonzero(C[body - 1]):
                if int(k) in sign:
                    continue
                order.append(int(k))
                joint = hand.joints[body - 1]
                v = anatomy.R_HB @ R[body] @ joint.axis * np.sign(C[body - 1, k])
                if mirrored:  # A turn is mirrored like an axial vector, a slide like a polar one.
                    v = v * (np.array([1.0, -1.0, 1.0]) if joint.kind == "prismatic" else np.array([-1.0, 1.0, -1.0]))
                bend = 0.0 if closing is None else float(closing[k])
                sign[int(k)] = bend or float(np.sign(v @ _ASKEW)) or 1.0
    return Senses(np.array(order, dtype=np.int64), np.array([sign[k] for k in order]))
