"""Points of a hand in its wrist frame, with first and second derivatives, for many postures at once in NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array, skew
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import forward_kinematics

_AT_WRIST = RigidTransform()


@dataclass(frozen=True)
class Chains:
    """Points fixed to links of a hand, and what of its tree moves them.

    Attributes:
        hand: The hand.
        links: Index of each point's link, shape (m,).
        p_LPs: The points in their links' frames [m], shape (m, 3).
        axes: Axes of the joints in their links' frames, shape (n_joints, 3, 1).
        turns: 1 for a joint that turns, 0 for one that slides, shape (n_joints, 1).
        moves: 1 where joint j moves point k, shape (m, n_joints, 1).
        above: 1 where joint i lies between the base and joint j, a half where they are the same, (n_joints, n_joints).
        C: The coupling matrix, shape (n_joints, n).
    """

    hand: Hand
    links: NDArray[np.int64]
    p_LPs: Array
    axes: Array
    turns: Array
    moves: Array
    above: Array
    C: Array

    @staticmethod
    def of(hand: Hand, links: NDArray[np.int64], p_LPs: Array) -> Chains:
        """The chains from a hand's base to points of its links."""
        above = hand.ancestors[:, 1:].astype(float)
        np.fill_diagonal(above, 0.5)
        return Chains(
            hand,
            links,
            p_LPs,
            np.array([joint.axis for joint in hand.joints], dtype=float).reshape(-1, 3, 1),
            np.where(hand.prismatic, 0.0, 1.0)[:, None],
            hand.ancestors[:, links].T[:, :, None].astype(float),
            above,
            hand.coupling_matrix,
        )

    def place(self, q: Array) -> Placed:
        """Where the points are.

        Args:
            q: Actuated joint values [rad or m], shape (B, n).

        Returns:
            The placed points.
        """
        R_HLs, p_HLs = forward_kinematics(self.hand, _AT_WRIST, q)
        points = p_HLs[:, self.links] + (R_HLs[:, self.links] @ self.p_LPs[:, :, None])[..., 0]
        return Placed(R_HLs, p_HLs, points)

    def derivatives(self, placed: Placed) -> tuple[Array, Array]:
        """Jacobian of the points with respect to all joints, coupled ones as if they were free.

        Args:
            placed: The placed points.

        Returns:
            The Jacobian, shape (B, m, n_joints, 3), and the axes of the joints in H, zero for those that slide, shape
            (B, n_joints, 3).
        """
        axes = (placed.R_HLs[:, 1:] @ self.axes)[..., 0]
        turning = axes * self.turns
        # At a point p a joint has the velocity a x (p - o); row by row, a x p is a [p]x.
        offset = (axes - turning) - (turning[..., None, :] @ skew(placed.p_HLs[:, 1:]))[..., 0, :]
        J = (turning[:, None] @ skew(placed.points) + offset[:, None]) * self.moves
        return J, turning

    def curvature(self, J: Array, axes: Array, forces: Array) -> Array:
        """Sum over the points of force . (second derivative of the point), with respect to all joints.

        A joint that turns carries the motion of each joint further out: d J_j / d q_i = a_i x J_j.

        Args:
            J: The Jacobian of `derivatives`.
            axes: Its axes.
            forces: A vector for each point, shape (B, m, 3).

        Returns:
            Symmetric matrices, shape (B, n_joints, n_joints).
        """
        moments = (J @ skew(forces)).sum(axis=1)
        half = (axes @ np.swapaxes(moments, -1, -2)) * self.above
        return half + np.swapaxes(half, -1, -2)


@dataclass(frozen=True)
class Placed:
    """Points of a hand at postures.

    Attributes:
        R_HLs: Rotations of the links, shape (B, n_links, 3, 3).
        p_HLs: Their origins [m], shape (B, n_links, 3).
        points: The points in H [m], shape (B, m, 3).
    """

    R_HLs: Array
    p_HLs: Array
    points: Array

    def rows(self, chosen: NDArray[np.bool_]) -> Placed:
        """Those of some postures."""
        return Placed(self.R_HLs[chosen], self.p_HLs[chosen], self.points[chosen])
