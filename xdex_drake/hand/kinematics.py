"""Kinematics of a hand: tree data, one configuration in NumPy, many configurations in torch.

A configuration is (X_WH, q). Its tangent is (w_WH, v_WH, qdot), of dimension 6 + n: angular velocity of the wrist
frame, velocity of its origin, both in W, then the rates of the actuated joints. A point fixed to link L moves with

    v_WP = v_WH + w_WH x (p_WP - p_WHo) + sum over the joints j above L of axis_j x (p_WP - p_Wj) qdot_full_j,

and the adjoint of that map turns gradients with respect to points into gradients with respect to the configuration.
Both are written once here, from the same tree, for NumPy (`Configuration`) and for torch (`BatchedHand`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.hand.description import Array, Hand

if TYPE_CHECKING:
    import torch


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
    q_full = hand.q_full(q)
    R_WH, p_WH = X_WH.rotation().matrix(), X_WH.translation()
    R = np.empty((len(hand.links), 3, 3))
    p = np.empty((len(hand.links), 3))
    R[0] = R_WH @ hand.R_HB
    p[0] = p_WH + R_WH @ hand.p_HB
    for k, joint in enumerate(hand.joints):
        parent = hand.parents[k + 1]
        p[k + 1] = p[parent] + R[parent] @ joint.p_PJ
        R[k + 1] = R[parent] @ joint.R_PJ
        if joint.kind == "revolute":
            R[k + 1] = R[k + 1] @ rotation_about(joint.axis, q_full[k])
        else:
            p[k + 1] += R[k + 1] @ joint.axis * q_full[k]
    return R, p


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
        axes = np.array([joint.axis for joint in self.hand.joints])
        # An axis is fixed in its joint's child link.
        return np.einsum("jab,jb->ja", self.R_WLs[1:], axes)

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
        columns = np.where(prismatic[None, :, None], axes[None], np.cross(axes[None], arms))
        columns = columns * above[:, links].T[:, :, None]
        J = np.empty((len(links), 3, 6 + C.shape[1]))
        J[:, :, :3] = -skew(p_WPs - self.X_WH.translation())
        J[:, :, 3:6] = np.eye(3)
        J[:, :, 6:] = np.swapaxes(columns, 1, 2) @ C
        return J

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


@dataclass(frozen=True)
class LinkPoses:
    """Poses of the links of many configurations.

    Attributes:
        R_WH: Wrist rotations, shape (B, 3, 3).
        p_WH: Wrist origins [m], shape (B, 3).
        R_WLs: Link rotations, shape (B, n_links, 3, 3).
        p_WLs: Link origins [m], shape (B, n_links, 3).
    """

    R_WH: torch.Tensor
    p_WH: torch.Tensor
    R_WLs: torch.Tensor
    p_WLs: torch.Tensor


class BatchedHand:
    """A hand's tree as tensors, for many configurations at once, on any device.

    Links of one depth are computed together, so a forward pass costs a few operations for each level of the tree and
    not for each joint.
    """

    def __init__(self, hand: Hand, *, dtype: torch.dtype | None = None, device: str = "cpu") -> None:
        """Copies the tree into tensors.

        Args:
            hand: The hand.
            dtype: Floating-point type; float32 where None.
            device: Torch device.
        """
        import torch

        self.hand = hand
        self.dtype = torch.float32 if dtype is None else dtype
        self.device = device

        def tensor(values: object) -> torch.Tensor:
            return torch.as_tensor(np.asarray(values, dtype=float), dtype=self.dtype, device=device)

        joints = hand.joints
        depth = np.zeros(len(hand.links), dtype=int)
        for link in range(1, len(hand.links)):
            depth[link] = depth[hand.parents[link]] + 1
        # For each depth below the base: its links and their parents.
        self._levels = [
            (
                torch.as_tensor(np.flatnonzero(depth == d), device=device),
                torch.as_tensor(hand.parents[depth == d], device=device),
            )
            for d in range(1, int(depth.max(initial=0)) + 1)
        ]
        n = len(joints)
        self.R_HB, self.p_HB = tensor(hand.R_HB), tensor(hand.p_HB)
        self.p_PJs = tensor([j.p_PJ for j in joints]).reshape(n, 3)
        self.axes = tensor([j.axis for j in joints]).reshape(n, 3)
        self.revolute = tensor([j.kind == "revolute" for j in joints])
        K = tensor([skew(j.axis) for j in joints]).reshape(n, 3, 3)
        R_PJ = tensor([j.R_PJ for j in joints]).reshape(n, 3, 3)
        # R_PJ exp(K q) = R_PJ + sin q (R_PJ K) + (1 - cos q) (R_PJ K K).
        self._R0, self._RK, self._RKK = R_PJ, R_PJ @ K, R_PJ @ K @ K
        self.C, self.c = tensor(hand.coupling_matrix), tensor(hand.coupling_offset)
        self.ancestors = tensor(hand.ancestors)
        self.limits = tensor(hand.limits)
        self.sphere_links = torch.as_tensor(hand.sphere_links, device=device)
        self.sphere_centers, self.sphere_radii = tensor(hand.spheres[:, :3]), tensor(hand.spheres[:, 3])

    def forward(self, R_WH: torch.Tensor, p_WH: torch.Tensor, q: torch.Tensor) -> LinkPoses:
        """Poses of all links.

        Args:
            R_WH: Wrist rotations, shape (B, 3, 3).
            p_WH: Wrist origins [m], shape (B, 3).
            q: Actuated joint values [rad or m], shape (B, n).

        Returns:
            The poses.
        """
        import torch

        B, L = q.shape[0], len(self.hand.links)
        q_full = q @ self.C.T + self.c
        turn = q_full * self.revolute
        s, c1 = torch.sin(turn)[:, :, None, None], (1.0 - torch.cos(turn))[:, :, None, None]
        R_PL = self._R0 + s * self._RK + c1 * self._RKK  # (B, n_joints, 3, 3)
        slide = (q_full * (1.0 - self.revolute))[:, :, None] * self.axes
        p_PL = self.p_PJs + torch.einsum("jab,Bjb->Bja", self._R0, slide)
        R = torch.empty((B, L, 3, 3), dtype=self.dtype, device=self.device)
        p = torch.empty((B, L, 3), dtype=self.dtype, device=self.device)
        R[:, 0] = R_WH @ self.R_HB
        p[:, 0] = p_WH + R_WH @ self.p_HB
        for links, parents in self._levels:
            R_WP = R[:, parents]
            R[:, links] = R_WP @ R_PL[:, links - 1]
            p[:, links] = p[:, parents] + (R_WP @ p_PL[:, links - 1, :, None])[..., 0]
        return LinkPoses(R_WH, p_WH, R, p)

    def points(self, poses: LinkPoses, links: torch.Tensor, p_LPs: torch.Tensor) -> torch.Tensor:
        """Points fixed to links.

        Args:
            poses: Poses of the links.
            links: Index of each point's link, shape (m,).
            p_LPs: The points in their links' frames [m], shape (m, 3).

        Returns:
            p_WPs [m], shape (B, m, 3).
        """
        return poses.p_WLs[:, links] + (poses.R_WLs[:, links] @ p_LPs[:, :, None])[..., 0]

    def joint_axes(self, poses: LinkPoses) -> torch.Tensor:
        """Joint axes in W, shape (B, n_joints, 3)."""
        return (poses.R_WLs[:, 1:] @ self.axes[:, :, None])[..., 0]

    def pull_back(
        self,
        poses: LinkPoses,
        links: torch.Tensor,
        p_WPs: torch.Tensor,
        gradient: torch.Tensor,
        torque: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Gradient with respect to the tangent from gradients with respect to points.

        Args:
            poses: Poses of the links.
            links: Index of each point's link, shape (m,) or (B, m).
            p_WPs: The points in W [m], shape (B, m, 3).
            gradient: Gradient of some value with respect to each point, shape (B, m, 3).
            torque: Gradient with respect to each point's link's rotation (as an angular velocity), shape (B, m, 3).

        Returns:
            Gradient with respect to (w_WH, v_WH, qdot), shape (B, 6 + n).
        """
        import torch

        B, L = p_WPs.shape[0], len(self.hand.links)
        # As in statics: a gradient is a force at its point; a joint feels the torque of all that lies beyond it.
        moment = torch.cross(p_WPs, gradient, dim=-1)
        if torque is not None:
            moment = moment + torque
        wrench = torch.cat([moment, gradient], dim=-1)  # (B, m, 6), about the origin of W
        on_links = torch.zeros((B, L, 6), dtype=self.dtype, device=self.device)
        if links.dim() == 1:
            on_links.index_add_(1, links, wrench)
        else:
            on_links.scatter_add_(1, links[:, :, None].expand(-1, -1, 6), wrench)
        total = on_links.sum(1)
        force = total[:, 3:]
        rotation = total[:, :3] - torch.cross(poses.p_WH, force, dim=-1)
        beyond = self.ancestors @ on_links  # (B, n_joints, 6)
        F, T = beyond[..., 3:], beyond[..., :3]
        axes = self.joint_axes(poses)
        about = T - torch.cross(poses.p_WLs[:, 1:], F, dim=-1)
        g_full = (axes * about).sum(-1) * self.revolute + (axes * F).sum(-1) * (1.0 - self.revolute)
        return torch.cat([rotation, force, g_full @ self.C], dim=-1)

    def jacobian(self, poses: LinkPoses, links: torch.Tensor, p_WPs: torch.Tensor) -> torch.Tensor:
        """Jacobian of points fixed to links with respect to (w_WH, v_WH, qdot).

        Args:
            poses: Poses of the links.
            links: Index of each point's link, shape (m,).
            p_WPs: The points in W [m], shape (B, m, 3).

        Returns:
            Jacobian, shape (B, m, 3, 6 + n).
        """
        import torch

        B, m = p_WPs.shape[:2]
        axes = self.joint_axes(poses)[:, None]  # (B, 1, n_joints, 3)
        arms = p_WPs[:, :, None] - poses.p_WLs[:, None, 1:]
        revolute = self.revolute[:, None]
        columns = torch.cross(axes.expand_as(arms), arms, dim=-1) * revolute + axes * (1.0 - revolute)
        columns = columns * self.ancestors[:, links].T[:, :, None]
        J = torch.zeros((B, m, 3, 6 + self.C.shape[1]), dtype=self.dtype, device=self.device)
        r = p_WPs - poses.p_WH[:, None]
        J[..., 0, 1], J[..., 0, 2] = r[..., 2], -r[..., 1]
        J[..., 1, 0], J[..., 1, 2] = -r[..., 2], r[..., 0]
        J[..., 2, 0], J[..., 2, 1] = r[..., 1], -r[..., 0]
        for k in range(3):
            J[..., k, 3 + k] = 1.0
        J[..., 6:] = columns.transpose(-1, -2) @ self.C
        return J


def rotation_step(R: torch.Tensor, w: torch.Tensor) -> torch.Tensor:
    """Rotates by rotation vectors given in W: exp(w) R, kept orthonormal by Gram-Schmidt.

    Args:
        R: Rotations, shape (B, 3, 3).
        w: Rotation vectors [rad], shape (B, 3).

    Returns:
        Rotations, shape (B, 3, 3).
    """
    import torch

    angle = w.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    k = w / angle
    s, c = torch.sin(angle)[..., None], torch.cos(angle)[..., None]
    cross = torch.cross(k[:, :, None].expand_as(R), R, dim=1)
    along = k[:, :, None] * (k[:, None, :] @ R)
    R = R * c + cross * s + along * (1.0 - c)
    x = R[:, :, 0] / R[:, :, 0].norm(dim=-1, keepdim=True)
    y = R[:, :, 1] - (x * R[:, :, 1]).sum(-1, keepdim=True) * x
    y = y / y.norm(dim=-1, keepdim=True)
    return torch.stack([x, y, torch.cross(x, y, dim=-1)], dim=-1)
