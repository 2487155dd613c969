"""Inverse kinematics of many poses at once: points of links to targets, for Eq. (6) and the keypoints of Eq. (2).

A 9-D link pose (position, first two columns of R_WL R_HL(0)^T) is the same as three points of the link: its origin, and
two points one `ARM` along the wrist frame's x and y axes as they stand in the link at the zero configuration. Least
squares on link poses is therefore least squares on points, and keypoints, link poses and mixtures of both are one
problem.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import daqp
import numpy as np
import torch
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.hand.batched_kinematics import BatchedHand, LinkPoses, rotation_step
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration, forward_kinematics, zero_configuration

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
    R_HLs, _ = zero_configuration(hand)
    origins = np.zeros((len(chosen), 3))
    return frame_targets(chosen, np.swapaxes(R_HLs[chosen], 1, 2), origins, R_WLs[:, chosen], p_WLs[:, chosen])


def frame_targets(links: NDArray[np.int64], R_LFs: Array, p_LFs: Array, R_WFs: Array, p_WFs: Array) -> PointTargets:
    """Targets from poses of frames that are fixed to links.

    Args:
        links: Index of each frame's link, shape (m,).
        R_LFs: Rotations of the frames in their links, shape (m, 3, 3).
        p_LFs: Origins of the frames in their links [m], shape (m, 3).
        R_WFs: Rotations that they should have in W, shape (B, m, 3, 3).
        p_WFs: Origins that they should have in W [m], shape (B, m, 3).

    Returns:
        Three points a frame: its origin, and one `ARM` along its x and y axes.
    """
    points, targets = [p_LFs], [p_WFs]
    for axis in (0, 1):
        points.append(p_LFs + ARM * R_LFs[:, :, axis])
        targets.append(p_WFs + ARM * R_WFs[:, :, :, axis])
    weights = np.ones(3 * len(links)) / 3.0
    return PointTargets(np.tile(links, 3), np.concatenate(points), np.concatenate(targets, axis=1), weights)


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


TOLERANCE = 1e-7
"""A row is done where a step lowers its cost by less than this fraction, or moves less than this [rad, m]."""

TURN = 0.5
"""Greatest turn of the wrist or a joint in one step of a single pose [rad]."""

FLOOR = 1e-14
"""A cost that is as good as none: the weighted squared distances of a tenth of a micrometre [m^2]."""


def solve_points(
    hand: Hand,
    targets: PointTargets,
    R_WHs: Array,
    p_WHs: Array,
    qs: Array,
    *,
    iterations: int = 30,
    prior: float = 1e-6,
    tolerance: float = TOLERANCE,
    device: str = "cpu",
) -> IkResult:
    """Least squares on points within joint limits and couplings, for a batch of poses.

    Levenberg-Marquardt on the tangent of (X_WH, q), each pose with its own damping; joints that would leave their
    limits are held there. Points of one link count by their moments alone, so that the normal matrix comes from the
    links' 6 x 6 matrices, gathered along the tree as a composite rigid body's inertia is (Featherstone 2008, chapter
    6), and no Jacobian of points is ever built. A single pose is solved in NumPy, whose operations start faster.

    Args:
        hand: The hand.
        targets: Points and targets; a batch of one is repeated.
        R_WHs: Starts: wrist rotations, shape (B, 3, 3).
        p_WHs: Starts: wrist origins [m], shape (B, 3).
        qs: Starts: joint values, shape (B, n).
        iterations: Number of steps.
        prior: Weight of squared joint increments [m^2/rad^2], for joints that no point constrains.
        tolerance: Relative decrease of the cost below which a pose is done.
        device: Torch device.

    Returns:
        The configurations.
    """
    if len(qs) == 1 and device == "cpu":
        return _solve_one(hand, targets, R_WHs[0], p_WHs[0], qs[0], iterations, prior, tolerance)
    batched = BatchedHand(hand, dtype=torch.float64, device=device)

    def tensor(values: Array) -> torch.Tensor:
        return torch.tensor(np.asarray(values, dtype=float), dtype=torch.float64, device=device)

    B, n = len(qs), qs.shape[1]
    points = batched.fixed_points(targets.links, targets.p_LPs)
    goal, weights = tensor(targets.p_WPs).transpose(1, 2).expand(B, -1, -1), tensor(targets.weights)
    moments = _LinkMoments(batched, targets, tensor)
    R, p, q = tensor(R_WHs), tensor(p_WHs), tensor(qs)
    low, high = batched.limits
    q = torch.minimum(torch.maximum(q, low), high)
    damping = torch.full((B, 1), 1e-4, dtype=torch.float64, device=device)
    lengths = tensor(np.concatenate([np.full(3, ARM**2), np.ones(3), np.full(n, ARM**2)]))
    regular = tensor(np.concatenate([np.zeros(6), np.full(n, prior)])) + 1e-12
    wrist_free = torch.ones((B, 6), dtype=torch.bool, device=device)

    def look(R: torch.Tensor, p: torch.Tensor, q: torch.Tensor) -> tuple[torch.Tensor, ...]:
        poses = batched.forward(R, p, q)
        error = points.positions(poses) - goal  # (B, 3, m)
        return ((error * error).sum(1) @ weights), poses.R_WLs, poses.p_WLs, error

    with torch.no_grad():
        state = look(R, p, q)
        for _ in range(iterations):
            cost, R_WLs, p_WLs, error = state
            H, g = moments.normal_equations(LinkPoses(R, p, R_WLs, p_WLs), error)
            # A joint at its limit whose descent leads out of it is held.
            held = ((q <= low + 1e-12) & (g[:, 6:] > 0.0)) | ((q >= high - 1e-12) & (g[:, 6:] < 0.0))
            free = torch.cat([wrist_free, ~held], dim=1).to(H.dtype)
            H = H * (free[:, :, None] * free[:, None, :])
            H.diagonal(dim1=1, dim2=2).add_(damping * lengths + regular + (1.0 - free))
            step = -torch.cholesky_solve((g * free)[..., None], torch.linalg.cholesky_ex(H)[0])[..., 0]
            trial = (
                rotation_step(R, step[:, :3]),
                p + step[:, 3:6],
                torch.minimum(torch.maximum(q + step[:, 6:], low), high),
            )
            seen = look(*trial)
            better = seen[0] < cost
            damping = torch.where(better[:, None], damping * 0.2, damping * 5.0).clamp(1e-9, 1e3)
            moved = step.abs().amax(1) > tolerance
            gained = (cost - seen[0] > tolerance * cost) & (seen[0] > FLOOR)
            R, p, q = (_where(better, a, b) for a, b in zip(trial, (R, p, q), strict=True))
            state = tuple(_where(better, a, b) for a, b in zip(seen, state, strict=True))
            # A refused step asks for a shorter one; an accepted one that gained next to nothing was the last.
            if not bool((moved & (gained | ~better)).any()):
                break
    errors = (state[0] / weights.sum()).sqrt()
    return IkResult(R.cpu().numpy(), p.cpu().numpy(), q.cpu().numpy(), errors.cpu().numpy())


def _where(mask: torch.Tensor, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return torch.where(mask.view(-1, *[1] * (a.dim() - 1)), a, b)


class _LinkMoments:
    """Normal equations of weighted points by the moments of each link's points."""

    def __init__(self, batched: BatchedHand, targets: PointTargets, tensor: Callable[[Array], torch.Tensor]) -> None:
        self._batched = batched
        L, links, weights = len(batched.hand.links), targets.links, targets.weights
        rows, first, second = np.zeros((L, len(links))), np.zeros((L, 3)), np.zeros((L, 3, 3))
        rows[links, np.arange(len(links))] = weights
        np.add.at(first, links, weights[:, None] * targets.p_LPs)
        np.add.at(second, links, weights[:, None, None] * targets.p_LPs[:, :, None] * targets.p_LPs[:, None, :])
        self._mass, self._first, self._second = tensor(rows.sum(axis=1)), tensor(first), tensor(second)
        # Forces and their moments in the link's frame, both as linear maps of the errors.
        arms = np.zeros((len(links), L, 4))
        arms[np.arange(len(links)), links] = weights[:, None] * np.concatenate(
            [targets.p_LPs, np.ones((len(links), 1))], axis=1
        )
        self._arms = tensor(arms.reshape(len(links), -1))
        above = batched.hand.ancestors
        self._gather = tensor(np.concatenate([np.ones((1, L)), above]).astype(float))
        # Entry (j, k): joint j lies between the base and joint k, or is k itself, which counts by half.
        mask = above[:, 1:].astype(float)
        np.fill_diagonal(mask, 0.5)
        self._mask = tensor(mask)

    def normal_equations(self, poses: LinkPoses, error: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """J^T W J and J^T W e with respect to (w_WH, v_WH, qdot).

        Args:
            poses: Poses of the links.
            error: Errors of the points [m], shape (B, 3, m).

        Returns:
            The matrix, shape (B, 6 + n, 6 + n), and the gradient, shape (B, 6 + n).
        """
        batched = self._batched
        B, L = poses.p_WLs.shape[:2]
        # About the wrist's origin: p_i = c + R x_i, so sum w p p^T = m c c^T + c (R s)^T + (R s) c^T + R S R^T.
        c = poses.p_WLs - poses.p_WH[:, None]
        Rs = (poses.R_WLs @ self._first[:, :, None])[..., 0]
        first = self._mass[:, None] * c + Rs
        half = c[..., :, None] * (0.5 * self._mass[:, None, None] * c[..., None, :] + Rs[..., None, :])
        second = half + half.transpose(-1, -2) + poses.R_WLs @ self._second @ poses.R_WLs.transpose(-1, -2)
        on_rows = (error.reshape(3 * B, -1) @ self._arms).view(B, 3, L, 4)
        force = on_rows[..., 3].transpose(1, 2)
        M = poses.R_WLs @ on_rows[..., :3].permute(0, 2, 3, 1) + c[..., :, None] * force[..., None, :]
        torque = torch.stack(
            [M[..., 1, 2] - M[..., 2, 1], M[..., 2, 0] - M[..., 0, 2], M[..., 0, 1] - M[..., 1, 0]], dim=-1
        )
        mass = self._mass[:, None].expand(B, L, 1)
        # Everything beyond the wrist, then beyond each joint: (B, 1 + n_joints, 19).
        beyond = self._gather @ torch.cat([mass, first, second.flatten(2), torque, force], dim=-1)
        m, first, second = beyond[..., 0], beyond[..., 1:4], beyond[..., 4:13].unflatten(-1, (3, 3))
        wrench = beyond[..., 13:]
        trace = second.diagonal(dim1=-2, dim2=-1).sum(-1)
        axes, arms = batched.joint_axes(poses), c[:, 1:]
        revolute = batched.revolute[:, None]
        w = axes * revolute
        v = torch.linalg.cross(arms, axes, dim=-1) * revolute + axes * (1.0 - revolute)
        # Momentum beyond joint j when it moves: (angular, linear).
        m_j, f_j, s_j, t_j = m[:, 1:, None], first[:, 1:], second[:, 1:], trace[:, 1:, None]
        linear = m_j * v + torch.linalg.cross(w, f_j, dim=-1)
        angular = t_j * w - (s_j @ w[..., None])[..., 0] + torch.linalg.cross(f_j, v, dim=-1)
        momentum = torch.cat([angular, linear], dim=-1)
        screws = torch.cat([w, v], dim=-1)
        full = (screws @ momentum.transpose(1, 2)) * self._mask
        full = full + full.transpose(1, 2)
        n = batched.C.shape[1]
        H = torch.empty((B, 6 + n, 6 + n), dtype=c.dtype, device=c.device)
        eye = torch.eye(3, dtype=c.dtype, device=c.device)
        H[:, :3, :3] = trace[:, 0, None, None] * eye - second[:, 0]
        H[:, 3:6, 3:6] = m[:, 0, None, None] * eye
        f = first[:, 0]
        zero = torch.zeros_like(f[:, 0])
        cross_f = torch.stack([zero, -f[:, 2], f[:, 1], f[:, 2], zero, -f[:, 0], -f[:, 1], f[:, 0], zero], dim=-1)
        H[:, :3, 3:6] = cross_f.view(B, 3, 3)
        H[:, 3:6, :3] = H[:, :3, 3:6].transpose(1, 2)
        H[:, :6, 6:] = momentum.transpose(1, 2) @ batched.C
        H[:, 6:, :6] = H[:, :6, 6:].transpose(1, 2)
        H[:, 6:, 6:] = batched.C.T @ full @ batched.C
        g = torch.cat([wrench[:, 0], (screws * wrench[:, 1:]).sum(-1) @ batched.C], dim=-1)
        return H, g


def _solve_one(
    hand: Hand,
    targets: PointTargets,
    R_WH: Array,
    p_WH: Array,
    q: Array,
    iterations: int,
    prior: float,
    tolerance: float,
) -> IkResult:
    """`solve_points` of one pose, in NumPy, by the Jacobian of its points and DAQP for bounded steps."""
    low, high = hand.limits
    n = len(q)
    weights, root = targets.weights, np.sqrt(targets.weights)[:, None]
    lengths = np.concatenate([np.full(3, ARM**2), np.ones(3), np.full(n, ARM**2)])
    regular = np.concatenate([np.zeros(6), np.full(n, prior)]) + 1e-12
    X_WH = RigidTransform(RotationMatrix.ProjectToRotationMatrix(R_WH), p_WH)
    k = Configuration.at(hand, X_WH, np.clip(q, low, high))

    def look(k: Configuration) -> tuple[float, Array, Array]:
        points = k.points(targets.links, targets.p_LPs)
        error = root * (points - targets.p_WPs[0])
        return float((error * error).sum()), points, error

    reach = np.concatenate([np.full(3, TURN), np.full(3, np.inf), np.full(n, TURN)])
    damping, (cost, points, error) = 1e-5, look(k)
    H, g, fresh = np.zeros(0), np.zeros(0), True
    no_rows, free = np.zeros((0, 6 + n)), np.zeros(6 + n, dtype=np.int32)
    for _ in range(iterations):
        if fresh:
            J = (k.jacobian(targets.links, points) * root[:, :, None]).reshape(-1, 6 + n)
            H, g = J.T @ J, error.ravel() @ J
        # Joint limits are bounds of the step: a clipped step would not be the one whose gain was foreseen.
        least, most = -reach, reach.copy()
        least[6:], most[6:] = np.maximum(least[6:], low - k.q), np.minimum(most[6:], high - k.q)
        P = H + np.diag(damping * lengths + regular)
        step, _, flag, _ = daqp.solve(P, g, no_rows, most, least, free)
        if flag <= 0:
            break
        trial = k.moved(np.asarray(step, dtype=np.float64))
        seen = look(trial)
        fresh = seen[0] < cost
        gain, promised = cost - seen[0], float(-2.0 * g @ step - step @ H @ step)
        good = gain > 0.75 * promised
        damping = min(max(damping * (0.1 if good else 0.7 if gain > 0.25 * promised else 6.0), 1e-9), 1e3)
        gained = gain > tolerance * cost and seen[0] > FLOOR
        if fresh:
            k, (cost, points, error) = trial, seen
        if np.abs(step).max() <= tolerance or (fresh and good and not gained):
            break
    errors = np.array([np.sqrt(cost / weights.sum())])
    return IkResult(k.X_WH.rotation().matrix()[None], k.X_WH.translation()[None], k.q[None], errors)
