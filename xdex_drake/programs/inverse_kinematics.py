"""Inverse kinematics of many poses at once: points of links to targets, for Eq. (6) and the keypoints of Eq. (2).

A 9-D link pose (position, first two columns of R_WL R_HL(0)^T) is the same as three points of the link: its origin, and
two points one `ARM` along the wrist frame's x and y axes as they stand in the link at the zero configuration. Least
squares on link poses is therefore least squares on points, and keypoints, link poses and mixtures of both are one
problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from xdex_drake.hand.batched_kinematics import BatchedHand, rotation_step
from xdex_drake.hand.description import Array, Hand
from xdex_drake.hand.kinematics import forward_kinematics

ARM = 0.03
"""Length that turns a link's rotation error into a distance [m]; about half a finger's width times three."""


@dataclass(frozen=True)
class PointTargets:
    """Points of links and where they should be.

    Attributes:
        links: Index of each point's link, shape (m,).
        p_LPs: The points in their links' frames [m], shape (m, 3).
        p_WPs: Targets in W [m], shape (B, m, 3).
        weights: Weight of each point's squared distance, shape (m,).
    """

    links: NDArray[np.int64]
    p_LPs: Array
    p_WPs: Array
    weights: Array


@dataclass(frozen=True)
class IkResult:
    """Configurations found by inverse kinematics.

    Attributes:
        R_WHs: Wrist rotations, shape (B, 3, 3).
        p_WHs: Wrist origins [m], shape (B, 3).
        qs: Actuated joint values [rad or m], shape (B, n).
        errors: Root of the weighted mean of squared distances [m], shape (B,).
    """

    R_WHs: Array
    p_WHs: Array
    qs: Array
    errors: Array


def link_pose_targets(hand: Hand, R_WLs: Array, p_WLs: Array, links: NDArray[np.int64] | None = None) -> PointTargets:
    """Targets from link poses whose rotations are R_WL R_HL(0)^T, as in the link pose vector.

    Args:
        hand: The hand.
        R_WLs: R_WL R_HL(0)^T of each link, shape (B, n_links, 3, 3).
        p_WLs: Origins of the links [m], shape (B, n_links, 3).
        links: Which links count; all where None.

    Returns:
        Three points a link.
    """
    chosen = np.arange(len(hand.links)) if links is None else links
    R_HLs, _ = forward_kinematics(hand, RigidTransform(), np.zeros(len(hand.joint_names)))
    points, targets = [], []
    for axis in (None, 0, 1):
        if axis is None:
            points.append(np.zeros((len(chosen), 3)))
            targets.append(p_WLs[:, chosen])
        else:
            points.append(ARM * R_HLs[chosen][:, axis, :])
            targets.append(p_WLs[:, chosen] + ARM * R_WLs[:, chosen][:, :, :, axis])
    weights = np.ones(3 * len(chosen)) / 3.0
    return PointTargets(np.tile(chosen, 3), np.concatenate(points), np.concatenate(targets, axis=1), weights)


def keypoint_targets(source: Hand, X_WH: RigidTransform, q: Array, target: Hand, *, wrist: float = 0.1) -> PointTargets:
    """Targets of a hand's fingertips and wrist from another hand's, by the names of the fingers.

    Args:
        source: The source hand.
        X_WH: Its wrist pose.
        q: Its joint values, shape (n,).
        target: The target hand.
        wrist: Weight of the wrist's keypoint; fingertips weigh 1.

    Returns:
        One point for each finger that both hands have, then three for the wrist frame, so that it faces the same way.
    """
    R_WLs, p_WLs = forward_kinematics(source, X_WH, q)
    tips = {f.name: p_WLs[i] + R_WLs[i] @ f.p_LTip for f in source.fingers for i in (source.link_index[f.tip_link],)}
    shared = [f for f in target.fingers if f.name in tips]
    links = [target.link_index[f.tip_link] for f in shared] + [0, 0, 0]
    R_BH = target.R_HB.T
    marks_H = np.array([[0.0, 0.0, 0.0], [ARM, 0.0, 0.0], [0.0, 0.0, ARM]])
    points = [f.p_LTip for f in shared] + list((marks_H - target.p_HB) @ R_BH.T)
    goals = [tips[f.name] for f in shared] + list((X_WH @ marks_H.T).T)
    weights = np.array([1.0] * len(shared) + [wrist / 3.0] * 3)
    return PointTargets(np.array(links), np.array(points), np.array(goals)[None], weights)


def solve_points(
    hand: Hand,
    targets: PointTargets,
    R_WHs: Array,
    p_WHs: Array,
    qs: Array,
    *,
    iterations: int = 30,
    prior: float = 1e-6,
    device: str = "cpu",
) -> IkResult:
    """Least squares on points within joint limits and couplings, for a batch of poses.

    Levenberg-Marquardt on the tangent of (X_WH, q), each pose with its own damping; joints that would leave their
    limits are held there.

    Args:
        hand: The hand.
        targets: Points and targets; a batch of one is repeated.
        R_WHs: Starts: wrist rotations, shape (B, 3, 3).
        p_WHs: Starts: wrist origins [m], shape (B, 3).
        qs: Starts: joint values, shape (B, n).
        iterations: Number of steps.
        prior: Weight of squared joint increments [m^2/rad^2], for joints that no point constrains.
        device: Torch device.

    Returns:
        The configurations.
    """
    batched = BatchedHand(hand, dtype=torch.float64, device=device)

    def tensor(values: Array) -> torch.Tensor:
        return torch.tensor(np.asarray(values, dtype=float), dtype=torch.float64, device=device)

    B, n = len(qs), qs.shape[1]
    links = torch.as_tensor(np.asarray(targets.links), device=device)
    local, goal, weights = tensor(targets.p_LPs), tensor(targets.p_WPs).expand(B, -1, -1), tensor(targets.weights)
    R, p, q = tensor(R_WHs), tensor(p_WHs), tensor(qs)
    low, high = batched.limits
    q = torch.minimum(torch.maximum(q, low), high)
    damping = torch.full((B, 1), 1e-4, dtype=torch.float64, device=device)
    regular = torch.cat([torch.zeros(6, dtype=torch.float64, device=device), torch.full((n,), prior, device=device)])

    def cost_of(R: torch.Tensor, p: torch.Tensor, q: torch.Tensor) -> tuple[torch.Tensor, ...]:
        poses = batched.forward(R, p, q)
        points = batched.points(poses, links, local)
        error = points - goal
        return (weights * (error * error).sum(-1)).sum(-1), poses, points, error  # type: ignore[return-value]

    with torch.no_grad():
        cost, poses, points, error = cost_of(R, p, q)
        for _ in range(iterations):
            J = batched.jacobian(poses, links, points)  # type: ignore[arg-type]
            Jw = (weights[:, None, None] * J).flatten(1, 2)
            J = J.flatten(1, 2)
            H = Jw.transpose(1, 2) @ J
            g = (Jw.transpose(1, 2) @ error.flatten(1)[..., None])[..., 0]
            # A joint at its limit whose descent leads out of it is held.
            held = ((q <= low + 1e-12) & (g[:, 6:] > 0.0)) | ((q >= high - 1e-12) & (g[:, 6:] < 0.0))
            free = torch.cat([torch.ones((B, 6), dtype=torch.bool, device=device), ~held], dim=1).to(H.dtype)
            H = H * free[:, :, None] * free[:, None, :]
            lengths = torch.cat([torch.full((3,), ARM**2), torch.ones(3), torch.full((n,), ARM**2)]).to(H)
            ridge = damping * lengths + regular + 1e-12 + (1.0 - free)
            step = -torch.linalg.solve(H + torch.diag_embed(ridge), g * free)
            R_new = rotation_step(R, step[:, :3])
            p_new = p + step[:, 3:6]
            q_new = torch.minimum(torch.maximum(q + step[:, 6:], low), high)
            new_cost, *_ = cost_of(R_new, p_new, q_new)
            better = new_cost < cost
            damping = torch.where(better[:, None], damping * 0.2, damping * 5.0).clamp(1e-9, 1e3)
            R = torch.where(better[:, None, None], R_new, R)
            p = torch.where(better[:, None], p_new, p)
            q = torch.where(better[:, None], q_new, q)
            if float((step * better[:, None]).abs().max()) < 1e-7:
                cost = torch.where(better, new_cost, cost)
                break
            cost, poses, points, error = cost_of(R, p, q)
    errors = (cost / weights.sum()).sqrt()
    return IkResult(R.cpu().numpy(), p.cpu().numpy(), q.cpu().numpy(), errors.cpu().numpy())
