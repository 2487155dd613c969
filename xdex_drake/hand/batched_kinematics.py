"""Kinematics of many configurations at once, in torch, on any device, in float32 or float64, with gradients.

The tangent of a configuration is that of `kinematics`. Functions here are differentiable by torch as well; the adjoint
written out (`pull_back`) is several times faster and needs no graph.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from xdex_drake.arrays import Array, skew
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import tree_levels


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


@dataclass(frozen=True)
class FixedPoints:
    """Points fixed to links, or differences of such points, as one linear map of the poses of all links.

    A point of link L is [R_WL | p_WL] (p_LP, 1), so all points of all configurations are one matrix product, which on
    a CPU is several times faster than gathering a rotation for each point.

    Attributes:
        map: The map, shape (4 n_links, m).
    """

    map: torch.Tensor

    def minus(self, other: FixedPoints) -> FixedPoints:
        """Differences of points, one by one."""
        return FixedPoints(self.map - other.map)

    def subset(self, rows: torch.Tensor) -> FixedPoints:
        """Some of the points; `rows` are their indices, shape (k,)."""
        return FixedPoints(self.map[:, rows])

    def positions(self, poses: LinkPoses) -> torch.Tensor:
        """Where the points are.

        Args:
            poses: Poses of the links.

        Returns:
            Components of p_WPs [m], shape (B, 3, m).
        """
        B, L = poses.p_WLs.shape[:2]
        rows = torch.cat([poses.R_WLs.permute(0, 2, 1, 3), poses.p_WLs.transpose(1, 2)[..., None]], dim=-1)
        return (rows.reshape(3 * B, 4 * L) @ self.map).view(B, 3, -1)

    def wrenches(self, poses: LinkPoses, gradient: torch.Tensor) -> torch.Tensor:
        """The adjoint of `positions`: forces at the points gathered on the links.

        Args:
            poses: Poses of the links.
            gradient: Gradient of some value with respect to each point, shape (B, 3, m).

        Returns:
            (torque, force) on each link about the origin of W, shape (B, n_links, 6); see `BatchedHand.to_tangent`.
        """
        B, L = poses.p_WLs.shape[:2]
        on_rows = (gradient.reshape(3 * B, -1) @ self.map.T).view(B, 3, L, 4)
        force = on_rows[..., 3].transpose(1, 2)
        # M = (sum over points of arm force^T), whose skew part is the torque about the link's origin.
        M = poses.R_WLs @ on_rows[..., :3].permute(0, 2, 3, 1)
        torque = torch.stack(
            [M[..., 1, 2] - M[..., 2, 1], M[..., 2, 0] - M[..., 0, 2], M[..., 0, 1] - M[..., 1, 0]], dim=-1
        )
        return torch.cat([torque + torch.cross(poses.p_WLs, force, dim=-1), force], dim=-1)


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
        self.hand = hand
        self.dtype = torch.float32 if dtype is None else dtype
        self.device = device

        def tensor(values: object) -> torch.Tensor:
            return torch.as_tensor(np.asarray(values, dtype=float), dtype=self.dtype, device=device)

        joints = hand.joints
        self._levels = [
            (torch.as_tensor(links, device=device), torch.as_tensor(parents, device=device))
            for links, parents in tree_levels(hand)
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
        self.sphere_radii = tensor(hand.spheres[:, 3])
        self.spheres = self.fixed_points(hand.sphere_links, hand.spheres[:, :3])

    def forward(self, R_WH: torch.Tensor, p_WH: torch.Tensor, q: torch.Tensor) -> LinkPoses:
        """Poses of all links.

        Args:
            R_WH: Wrist rotations, shape (B, 3, 3).
            p_WH: Wrist origins [m], shape (B, 3).
            q: Actuated joint values [rad or m], shape (B, n).

        Returns:
            The poses.
        """
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

    def fixed_points(self, links: NDArray[np.int64], p_LPs: Array) -> FixedPoints:
        """Points whose positions are asked for again and again.

        Args:
            links: Index of each point's link, shape (m,).
            p_LPs: The points in their links' frames [m], shape (m, 3).

        Returns:
            The points as a linear map.
        """
        m = len(links)
        rows = np.zeros((len(self.hand.links), 4, m))
        rows[links, :3, np.arange(m)] = p_LPs
        rows[links, 3, np.arange(m)] = 1.0
        return FixedPoints(torch.as_tensor(rows.reshape(-1, m), dtype=self.dtype, device=self.device))

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
        return self.to_tangent(poses, self.wrenches(links, p_WPs, gradient, torque))

    def wrenches(
        self, links: torch.Tensor, p_WPs: torch.Tensor, gradient: torch.Tensor, torque: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Forces at points gathered on their links; arguments as in `pull_back`.

        Returns:
            (torque, force) on each link about the origin of W, shape (B, n_links, 6).
        """
        B, L = p_WPs.shape[0], len(self.hand.links)
        moment = torch.cross(p_WPs, gradient, dim=-1)
        if torque is not None:
            moment = moment + torque
        wrench = torch.cat([moment, gradient], dim=-1)  # (B, m, 6)
        on_links = torch.zeros((B, L, 6), dtype=self.dtype, device=self.device)
        if links.dim() == 1:
            return on_links.index_add(1, links, wrench)
        return on_links.scatter_add(1, links[:, :, None].expand(-1, -1, 6), wrench)

    def to_tangent(self, poses: LinkPoses, on_links: torch.Tensor) -> torch.Tensor:
        """Gradient with respect to the tangent from wrenches on links.

        As in statics: a gradient is a force at its point, and a joint feels the torque of all that lies beyond it.

        Args:
            poses: Poses of the links.
            on_links: (torque, force) on each link about the origin of W, shape (B, n_links, 6).

        Returns:
            Gradient with respect to (w_WH, v_WH, qdot), shape (B, 6 + n).
        """
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


class PaddedHands:
    """Several hands as one batch: each row of a batch is a configuration of a hand of its own.

    Hands are padded to the greatest number of links, joints and points among them; what is padded stays at the base
    and is marked false in the masks. The pass goes joint by joint, so its cost hardly depends on the number of rows.

    Attributes:
        hands: The hands.
        n_actuated: Greatest number of actuated joints.
        actuated: True for true joints of `q`, shape (n_hands, n_actuated).
        links: True for true links, shape (n_hands, n_links).
        limits: Limits of `q`, zero where padded [rad or m], shape (n_hands, 2, n_actuated).
    """

    def __init__(self, hands: Sequence[Hand], *, dtype: torch.dtype | None = None, device: str = "cpu") -> None:
        """Pads the hands' trees.

        Args:
            hands: The hands, at least one.
            dtype: Floating-point type; float32 where None.
            device: Torch device.
        """
        self.hands, self.device = tuple(hands), device
        self.dtype = torch.float32 if dtype is None else dtype
        H, n_links = len(hands), max(len(hand.links) for hand in hands)
        self.n_actuated = n = max(len(hand.joint_names) for hand in hands)
        parents = np.zeros((H, n_links - 1), dtype=np.int64)
        p_PJs, axes = np.zeros((H, n_links - 1, 3)), np.zeros((H, n_links - 1, 3))
        R_PJs = np.tile(np.eye(3), (H, n_links - 1, 1, 1))
        slides, C, c = np.zeros((H, n_links - 1)), np.zeros((H, n_links - 1, n)), np.zeros((H, n_links - 1))
        limits, actuated, links = np.zeros((H, 2, n)), np.zeros((H, n), dtype=bool), np.zeros((H, n_links), dtype=bool)
        for h, hand in enumerate(hands):
            k, m = len(hand.joints), len(hand.joint_names)
            parents[h, :k] = hand.parents[1:]
            p_PJs[h, :k] = [joint.p_PJ for joint in hand.joints]
            R_PJs[h, :k] = [joint.R_PJ for joint in hand.joints]
            axes[h, :k] = [joint.axis for joint in hand.joints]
            slides[h, :k] = hand.prismatic
            C[h, :k, :m], c[h, :k] = hand.coupling_matrix, hand.coupling_offset
            limits[h, :, :m], actuated[h, :m], links[h, : k + 1] = hand.limits, True, True

        def tensor(values: Array) -> torch.Tensor:
            return torch.as_tensor(values, dtype=self.dtype, device=device)

        self._parents = torch.as_tensor(parents, device=device)
        self._p_PJs, self._axes, self._slides = tensor(p_PJs), tensor(axes), tensor(slides)
        K = tensor(skew(axes))
        R = tensor(R_PJs)
        self._R0, self._RK, self._RKK = R, R @ K, R @ K @ K
        self._C, self._c = tensor(C), tensor(c)
        self._R_HBs = tensor(np.array([hand.R_HB for hand in hands]))
        self._p_HBs = tensor(np.array([hand.p_HB for hand in hands]))
        self.limits = tensor(limits)
        self.actuated = torch.as_tensor(actuated, device=device)
        self.links = torch.as_tensor(links, device=device)

    def pad(self, values: Sequence[Array]) -> tuple[torch.Tensor, torch.Tensor]:
        """Arrays of different length, one for each hand, as one tensor.

        Args:
            values: For each hand an array of shape (n_h, ...), equal in all but the first dimension.

        Returns:
            Values, zero where padded, shape (n_hands, n, ...), and which are true, shape (n_hands, n).
        """
        n = max(len(v) for v in values)
        padded = np.zeros((len(values), n, *np.shape(values[0])[1:]), dtype=np.asarray(values[0]).dtype)
        mask = np.zeros((len(values), n), dtype=bool)
        for row, v in enumerate(values):
            padded[row, : len(v)], mask[row, : len(v)] = v, True
        tensor = torch.as_tensor(padded, device=self.device)
        return tensor.to(self.dtype) if tensor.is_floating_point() else tensor, torch.as_tensor(
            mask, device=self.device
        )

    def forward(self, rows: torch.Tensor, R_WH: torch.Tensor, p_WH: torch.Tensor, q: torch.Tensor) -> LinkPoses:
        """Poses of all links.

        Args:
            rows: Which hand each configuration is of, shape (B,).
            R_WH: Wrist rotations, shape (B, 3, 3).
            p_WH: Wrist origins [m], shape (B, 3).
            q: Actuated joint values [rad or m], shape (B, n_actuated).

        Returns:
            The poses, padded.
        """
        B, n_joints = q.shape[0], self._parents.shape[1]
        q_full = (self._C[rows] @ q[:, :, None])[..., 0] + self._c[rows]
        slides = self._slides[rows]
        turn = q_full * (1.0 - slides)
        s, c1 = torch.sin(turn)[..., None, None], (1.0 - torch.cos(turn))[..., None, None]
        R0 = self._R0[rows]
        R_PL = R0 + s * self._RK[rows] + c1 * self._RKK[rows]
        slide = (q_full * slides)[..., None] * self._axes[rows]
        p_PL = self._p_PJs[rows] + (R0 @ slide[..., None])[..., 0]
        parents, here = self._parents[rows], torch.arange(B, device=self.device)
        R = torch.empty((B, n_joints + 1, 3, 3), dtype=self.dtype, device=self.device)
        p = torch.empty((B, n_joints + 1, 3), dtype=self.dtype, device=self.device)
        R[:, 0] = R_WH @ self._R_HBs[rows]
        p[:, 0] = p_WH + (R_WH @ self._p_HBs[rows][..., None])[..., 0]
        for k in range(n_joints):
            R_WP = R[here, parents[:, k]]
            R[:, k + 1] = R_WP @ R_PL[:, k]
            p[:, k + 1] = p[here, parents[:, k]] + (R_WP @ p_PL[:, k, :, None])[..., 0]
        return LinkPoses(R_WH, p_WH, R, p)

    def points(self, poses: LinkPoses, links: torch.Tensor, p_LPs: torch.Tensor) -> torch.Tensor:
        """Points fixed to links.

        Args:
            poses: Poses of the links.
            links: Index of each point's link, shape (B, m).
            p_LPs: The points in their links' frames [m], shape (B, m, 3).

        Returns:
            p_WPs [m], shape (B, m, 3).
        """
        here = torch.arange(len(links), device=self.device)[:, None]
        return poses.p_WLs[here, links] + (poses.R_WLs[here, links] @ p_LPs[..., None])[..., 0]


def rotation_step(R: torch.Tensor, w: torch.Tensor) -> torch.Tensor:
    """Rotates by rotation vectors given in W: exp(w) R, kept orthonormal by Gram-Schmidt.

    Args:
        R: Rotations, shape (B, 3, 3).
        w: Rotation vectors [rad], shape (B, 3).

    Returns:
        Rotations, shape (B, 3, 3).
    """
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
