"""Kinematics of a hand at one configuration, in NumPy; for many at once see `batched_kinematics`.

A configuration is (X_WH, q). Its tangent is (w_WH, v_WH, qdot), of dimension 6 + n: angular velocity of the wrist
frame, velocity of its origin, both in W, then the rates of the actuated joints. A point fixed to link L moves with

    v_WP = v_WH + w_WH x (p_WP - p_WHo) + sum over the joints j above L of axis_j x (p_WP - p_Wj) qdot_full_j,

and the adjoint of that map turns gradients with respect to points into gradients with respect to the configuration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.hand.description import Array, Hand


def rotation_about(axis: Array, angle: float) -> Array:
    """Rotation matrix about a unit axis (Rodrigues).

    Args:
        axis: Unit axis, shape (3,).
        angle: Angle [rad].

    Returns:
        Rotation matrix, shape (3, 3).
    """
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)


def skew(v: Array) -> Array:
    """Cross-product matrices S with S u = v x u.

    Args:
        v: Vectors, shape (..., 3).

    Returns:
        Matrices, shape (..., 3, 3).
    """
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def forward_kinematics(hand: Hand, X_WH: RigidTransform, q: Array) -> tuple[Array, Array]:
    """Poses of all links.

    Args:
        hand: The hand.
        X_WH: Pose of the wrist frame.
        q: Actuated joint values [rad or m], shape (n,).

    Returns:
        R_WLs, shape (n_links, 3, 3), and p_WLs [m], shape (n_links, 3).
    """
    tree, q_full = _tree(hand), hand.q_full(q)
    turn = np.where(hand.prismatic, 0.0, q_full)[:, None, None]
    R_PLs = tree.R_PJs + np.sin(turn) * tree.RK + (1.0 - np.cos(turn)) * tree.RKK
    p_PLs = tree.p_PJs + np.where(hand.prismatic, q_full, 0.0)[:, None] * tree.slides
    R_WH, p_WH = X_WH.rotation().matrix(), X_WH.translation()
    R = np.empty((len(hand.links), 3, 3))
    p = np.empty((len(hand.links), 3))
    R[0] = R_WH @ hand.R_HB
    p[0] = p_WH + R_WH @ hand.p_HB
    for links, parents in tree.levels:
        R_WP = R[parents]
        R[links] = R_WP @ R_PLs[links - 1]
        p[links] = p[parents] + (R_WP @ p_PLs[links - 1, :, None])[..., 0]
    return R, p


@dataclass(frozen=True)
class _Tree:
    """Constants of a hand's joints, stacked: R_PJ exp(K q) = R_PJ + sin q (R_PJ K) + (1 - cos q) (R_PJ K K)."""

    p_PJs: Array
    R_PJs: Array
    RK: Array
    RKK: Array
    slides: Array
    axes: Array
    levels: tuple[tuple[NDArray[np.int64], NDArray[np.int64]], ...]


@lru_cache(maxsize=64)
def _tree(hand: Hand) -> _Tree:
    n = len(hand.joints)
    axes = np.array([joint.axis for joint in hand.joints], dtype=float).reshape(n, 3)
    R_PJs = np.array([joint.R_PJ for joint in hand.joints], dtype=float).reshape(n, 3, 3)
    p_PJs = np.array([joint.p_PJ for joint in hand.joints], dtype=float).reshape(n, 3)
    K = skew(axes)
    slides = (R_PJs @ axes[:, :, None])[..., 0]
    return _Tree(p_PJs, R_PJs, R_PJs @ K, R_PJs @ K @ K, slides, axes, tree_levels(hand))


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


def cross(a: Array, b: Array) -> Array:
    """A x b along the last axis; `numpy.cross` takes five times as long for few vectors."""
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    z = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.stack([x, y, z], axis=-1)


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
        return self.p_WLs[links] + (self.R_WLs[links] @ p_LPs[:, :, None])[..., 0]

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
        above, C = self.hand.ancestors, self.hand.coupling_matrix
        axes = np.where(self.hand.prismatic[:, None], 0.0, self._joint_axes_W)
        columns = above[:, links].T[:, :, None] * axes[None]  # (m, n_joints, 3)
        J = np.zeros((len(links), 3, 6 + C.shape[1]))
        J[:, :, :3] = np.eye(3)
        J[:, :, 6:] = np.swapaxes(columns, 1, 2) @ C
        return J

    def jacobian(self, links: NDArray[np.int64], p_WPs: Array) -> Array:
        """Jacobian of points fixed to links with respect to the tangent (w_WH, v_WH, qdot).

        Args:
            links: Index of each point's link, shape (m,).
            p_WPs: The points in W [m], shape (m, 3).

        Returns:
            Jacobian, shape (m, 3, 6 + n).
        """
        above, prismatic, C = self.hand.ancestors, self.hand.prismatic, self.hand.coupling_matrix
        axes = self._joint_axes_W
        arms = p_WPs[:, None, :] - self.p_WLs[None, 1:, :]  # (m, n_joints, 3)
        columns = np.where(prismatic[None, :, None], axes[None], cross(axes[None], arms))
        columns = columns * above[:, links].T[:, :, None]
        J = np.empty((len(links), 3, 6 + C.shape[1]))
        J[:, :, :3] = -skew(p_WPs - self.X_WH.translation())
        J[:, :, 3:6] = np.eye(3)
        J[:, :, 6:] = np.swapaxes(columns, 1, 2) @ C
        return J

    @cached_property
    def _joint_screws(self) -> Array:
        """What a force's (torque about the origin of W, force) must be multiplied by to feel it at each joint."""
        axes, prismatic = self._joint_axes_W, self.hand.prismatic[:, None]
        turning = np.concatenate([axes, cross(self.p_WLs[1:], axes)], axis=1)
        return np.where(prismatic, np.concatenate([np.zeros_like(axes), axes], axis=1), turning)

    def pull_back_each(self, links: NDArray[np.int64], p_WPs: Array, v_Ws: Array) -> Array:
        """Jacobian of points along given directions: row k is v_k . (Jacobian of point k), without that Jacobian.

        Args:
            links: Index of each point's link, shape (m,).
            p_WPs: The points in W [m], shape (m, 3).
            v_Ws: A vector for each point, in W, shape (m, 3).

        Returns:
            Rows, shape (m, 6 + n).
        """
        moment = cross(p_WPs, v_Ws)
        full = (np.concatenate([moment, v_Ws], axis=1) @ self._joint_screws.T) * self.hand.ancestors.T[links]
        about_wrist = moment - cross(self.X_WH.translation(), v_Ws)
        return np.concatenate([about_wrist, v_Ws, full @ self.hand.coupling_matrix], axis=1)

    def moved(self, step: Array) -> Configuration:
        """The configuration after a step along the tangent.

        Args:
            step: (rotation vector, translation, joint increments), shape (6 + n,).

        Returns:
            The new configuration.
        """
        angle = float(np.linalg.norm(step[:3]))
        R = rotation_about(step[:3] / angle, angle) if angle > 1e-12 else np.eye(3)
        R_WH = RotationMatrix.ProjectToRotationMatrix(R @ self.X_WH.rotation().matrix())
        X_WH = RigidTransform(R_WH, self.X_WH.translation() + step[3:6])
        return Configuration.at(self.hand, X_WH, self.q + step[6:])
