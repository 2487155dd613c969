"""Kinematics of a hand in NumPy; for many configurations at once, with gradients, see `batched_kinematics`.

A configuration is (X_WH, q). Its tangent is (w_WH, v_WH, qdot), of dimension 6 + n: angular velocity of the wrist
frame, velocity of its origin, both in W, then the rates of the actuated joints. A point fixed to link L moves with

    v_WP = v_WH + w_WH x (p_WP - p_WHo) + sum over the joints j above L of axis_j x (p_WP - p_Wj) qdot_full_j,

and the adjoint of that map turns gradients with respect to points into gradients with respect to the configuration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array, cross, skew
from xdex_drake.hand.description import Hand


def rotation_about(axis: Array, angle: float) -> Array:
    """Rotation matrix about a unit axis (Rodrigues).

    Args:
        axis: Unit axis, shape (3,).
        angle: Angle [rad].

    Returns:
        Rotation matrix, shape (3, 3).
    """
    x, y, z = (float(value) for value in axis)
    s, c = math.sin(angle), math.cos(angle)
    xv, yv, zv = (1.0 - c) * x, (1.0 - c) * y, (1.0 - c) * z
    return np.array(
        [
            [c + xv * x, xv * y - s * z, xv * z + s * y],
            [yv * x + s * z, c + yv * y, yv * z - s * x],
            [zv * x - s * y, zv * y + s * x, c + zv * z],
        ]
    )


def forward_kinematics(hand: Hand, X_WH: RigidTransform, q: Array) -> tuple[Array, Array]:
    """Poses of all links, at one posture or at many.

    Args:
        hand: The hand.
        X_WH: Pose of the wrist frame.
        q: Actuated joint values [rad or m], shape (..., n).

    Returns:
        R_WLs, shape (..., n_links, 3, 3), and p_WLs [m], shape (..., n_links, 3).
    """
    tree, q_full = _tree(hand), hand.q_full(q)
    turn, slide = q_full * tree.turns, q_full - q_full * tree.turns
    X_PLs = (
        tree.still
        + np.sin(turn)[..., None, None] * tree.sine
        + (1.0 - np.cos(turn))[..., None, None] * tree.versine
        + slide[..., None, None] * tree.slide
    )
    X = np.empty((*q_full.shape[:-1], len(hand.links), 4, 4))
    X[..., 0, :, :] = X_WH.GetAsMatrix4() @ tree.X_HB
    for links, parents in tree.levels:
        X[..., links, :, :] = X[..., parents, :, :] @ X_PLs[..., links - 1, :, :]
    return np.ascontiguousarray(X[..., :3, :3]), np.ascontiguousarray(X[..., :3, 3])


def zero_configuration(hand: Hand) -> tuple[Array, Array]:
    """Link poses in the wrist frame with all actuated joints at zero, within their limits or not.

    Args:
        hand: The hand.

    Returns:
        Rotations R_HL(0), shape (n_links, 3, 3), and origins p_HL(0) [m], shape (n_links, 3).
    """
    return forward_kinematics(hand, RigidTransform(), np.zeros(len(hand.joint_names)))


@dataclass(frozen=True)
class _Tree:
    """Constants of a hand's joints, stacked.

    The pose of joint j's child in its parent is still + sin q sine + (1 - cos q) versine for a joint that turns, and
    still + q slide for one that slides: exp(K q) = I + sin q K + (1 - cos q) K K.

    Attributes:
        still, sine, versine, slide: Shape (n_joints, 4, 4).
        turns: 1 for a joint that turns, 0 for one that slides, shape (n_joints,).
        axes: Axes in the frames of the joints, shape (n_joints, 3).
        moves: Entry (l, c) is 1 where column c of a tangent with all joints, (w_WH, v_WH, qdot_full), moves link l.
        joining: Matrix that joins columns of coupled joints, shape (6 + n_joints, 6 + n); None where none are coupled.
        X_HB: Pose of the base link in the wrist frame, shape (4, 4).
        levels: See `tree_levels`.
    """

    still: Array
    sine: Array
    versine: Array
    slide: Array
    turns: Array
    axes: Array
    moves: Array
    joining: Array | None
    X_HB: Array
    levels: tuple[tuple[NDArray[np.int64], NDArray[np.int64]], ...]


@lru_cache(maxsize=64)
def _tree(hand: Hand) -> _Tree:
    n = len(hand.joints)
    axes = np.array([joint.axis for joint in hand.joints], dtype=float).reshape(n, 3)
    R_PJs = np.array([joint.R_PJ for joint in hand.joints], dtype=float).reshape(n, 3, 3)
    K = skew(axes)
    still, sine, versine, slide = np.zeros((4, n, 4, 4))
    still[:, :3, :3], still[:, 3, 3] = R_PJs, 1.0
    still[:, :3, 3] = np.array([joint.p_PJ for joint in hand.joints], dtype=float).reshape(n, 3)
    sine[:, :3, :3], versine[:, :3, :3] = R_PJs @ K, R_PJs @ K @ K
    slide[:, :3, 3] = (R_PJs @ axes[:, :, None])[..., 0]
    C = hand.coupling_matrix
    joining = None
    if C.shape[1] != n or not np.array_equal(C, np.eye(n)):
        joining = np.zeros((6 + n, 6 + C.shape[1]))
        joining[:6, :6], joining[6:, 6:] = np.eye(6), C
    X_HB = np.eye(4)
    X_HB[:3, :3], X_HB[:3, 3] = hand.R_HB, hand.p_HB
    moves = np.ones((len(hand.links), 6 + n))
    moves[:, 6:] = hand.ancestors.T
    turns = np.where(hand.prismatic, 0.0, 1.0)
    return _Tree(still, sine, versine, slide, turns, axes, moves, joining, X_HB, tree_levels(hand))


def tree_levels(hand: Hand) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], ...]:
    """Links of one depth, whose poses can be computed together.

    Args:
        hand: The hand.

    Returns:
        For each depth below the base: indices of its links, and of their parents.
    """
    depth = np.zeros(len(hand.links), dtype=int)
    for link in range(1, len(hand.links)):
        depth[link] = depth[hand.parents[link]] + 1
    return tuple(
        (np.flatnonzero(depth == d), hand.parents[depth == d]) for d in range(1, int(depth.max(initial=0)) + 1)
    )


@dataclass(frozen=True)
class Configuration:
    """A hand at one configuration, from which terms read points and their Jacobians.

    Attributes:
        hand: The hand.
        X_WH: Pose of the wrist frame.
        q: Actuated joint values [rad or m], shape (n,).
        R_WLs: Rotations of the links, shape (n_links, 3, 3).
        p_WLs: Origins of the links [m], shape (n_links, 3).
    """

    hand: Hand
    X_WH: RigidTransform
    q: Array
    R_WLs: Array
    p_WLs: Array

    @staticmethod
    def at(hand: Hand, X_WH: RigidTransform, q: Array) -> Configuration:
        """The hand at a wrist pose and joint values; see `forward_kinematics`."""
        R, p = forward_kinematics(hand, X_WH, q)
        return Configuration(hand, X_WH, np.asarray(q, dtype=float), R, p)

    @cached_property
    def _joint_axes_W(self) -> Array:
        # An axis is fixed in its joint's child link.
        return (self.R_WLs[1:] @ _tree(self.hand).axes[:, :, None])[..., 0]

    def points(self, links: NDArray[np.int64], p_LPs: Array) -> Array:
        """Points fixed to links.

        Args:
            links: Index of each point's link, shape (m,).
            p_LPs: The points in their links' frames [m], shape (m, 3).

        Returns:
            p_WPs [m], shape (m, 3).
        """
        return self.p_WLs[links] + np.einsum("mab,mb->ma", self.R_WLs[links], p_LPs)

    def vectors(self, links: NDArray[np.int64], v_Ls: Array) -> Array:
        """Directions fixed to links, in W; arguments as in `points`, shape (m, 3)."""
        return np.einsum("mab,mb->ma", self.R_WLs[links], v_Ls)

    def angular_jacobian(self, links: NDArray[np.int64]) -> Array:
        """Jacobian of the angular velocity of links with respect to the tangent.

        Args:
            links: Link indices, shape (m,).

        Returns:
            Jacobian, shape (m, 3, 6 + n).
        """
        tree = _tree(self.hand)
        J = self._twists[:3] * tree.moves[links][:, None, :]
        return J if tree.joining is None else J @ tree.joining

    def jacobian(self, links: NDArray[np.int64], p_WPs: Array) -> Array:
        """Jacobian of points fixed to links with respect to the tangent (w_WH, v_WH, qdot).

        Args:
            links: Index of each point's link, shape (m,).
            p_WPs: The points in W [m], shape (m, 3).

        Returns:
            Jacobian, shape (m, 3, 6 + n).
        """
        tree = _tree(self.hand)
        J = (self._twists[3:] - skew(p_WPs) @ self._twists[:3]) * tree.moves[links][:, None, :]
        return J if tree.joining is None else J @ tree.joining

    def jacobian_slopes(self, links: NDArray[np.int64], p_WPs: Array) -> Array:
        """Second derivatives of points fixed to links with respect to the actuated joints, the wrist being held.

        Turning joint i carries all that hangs on it, the motion J_j of a joint j further out included, so that
        d J_j / d q_i = axis_i x J_j; derivatives do not depend on their order, which gives the other half.

        Args:
            links: Index of each point's link, shape (m,).
            p_WPs: The points in W [m], shape (m, 3).

        Returns:
            Derivatives, shape (m, 3, n, n), symmetric in the last two axes.
        """
        tree = _tree(self.hand)
        axes, moves = self._twists[:3, 6:], tree.moves[links][:, None, 6:]
        J = (self._twists[3:, 6:] - skew(p_WPs) @ axes) * moves
        carried = np.einsum("abi,mbj->maij", skew(axes.T).transpose(1, 2, 0), J) * moves[..., None]
        outward = np.triu(carried)  # a joint comes before those further out
        slopes = outward + np.swapaxes(np.triu(carried, 1), -1, -2)
        return slopes if tree.joining is None else tree.joining[6:, 6:].T @ slopes @ tree.joining[6:, 6:]

    @cached_property
    def _twists(self) -> Array:
        """Twists (angular velocity, velocity at the origin of W) of (w_WH, v_WH, qdot_full), shape (6, 6 + n_joints).

        A point p that moves with all of them has the velocity v + w x p.
        """
        axes, turns = self._joint_axes_W.T, _tree(self.hand).turns
        twists = np.zeros((6, 6 + len(turns)))
        twists[:3, :3] = twists[3:, 3:6] = np.eye(3)
        twists[3:, :3] = skew(self.X_WH.translation())
        twists[:3, 6:] = turns * axes
        twists[3:, 6:] = turns * cross(self.p_WLs[1:], axes.T).T + (1.0 - turns) * axes
        return twists

    def pull_back_each(self, links: NDArray[np.int64], p_WPs: Array, v_Ws: Array) -> Array:
        """Jacobian of points along given directions: row k is v_k . (Jacobian of point k), without that Jacobian.

        Args:
            links: Index of each point's link, shape (m,).
            p_WPs: The points in W [m], shape (m, 3).
            v_Ws: A vector for each point, in W, shape (m, 3).

        Returns:
            Rows, shape (m, 6 + n).
        """
        tree = _tree(self.hand)
        rows = (np.concatenate([cross(p_WPs, v_Ws), v_Ws], axis=1) @ self._twists) * tree.moves[links]
        return rows if tree.joining is None else rows @ tree.joining

    def moved(self, step: Array) -> Configuration:
        """The configuration after a step along the tangent.

        Args:
            step: (rotation vector, translation, joint increments), shape (6 + n,).

        Returns:
            The new configuration.
        """
        angle = math.sqrt(step[:3] @ step[:3])
        R = rotation_about(step[:3] / angle, angle) if angle > 1e-12 else np.eye(3)
        R_WH = RotationMatrix.ProjectToRotationMatrix(R @ self.X_WH.rotation().matrix())
        X_WH = RigidTransform(R_WH, self.X_WH.translation() + step[3:6])
        return Configuration.at(self.hand, X_WH, self.q + step[6:])
