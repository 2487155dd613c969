"""Times and errors of batched link-pose inverse kinematics, Eq. (6), from a cold start."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.bench.watch import Tick, Watch
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.programs.link_pose_ik import link_pose_ik
from xdex_drake.programs.search import random_rotations


def reachable_poses(hand: Hand, count: int, seed: int) -> tuple[Array, Array, Array, Array]:
    """Random configurations within the joint limits, and their link poses as the model predicts them.

    Args:
        hand: The hand.
        count: How many.
        seed: Seed.

    Returns:
        Link pose rotations R_WL R_HL(0)^T, shape (count, n_links, 3, 3), link origins [m], shape (count, n_links, 3),
        wrist rotations, shape (count, 3, 3), and joint values, shape (count, n).
    """
    rng = np.random.default_rng(seed)
    R_WHs, p_WHs = random_rotations(rng, count), rng.uniform(-0.3, 0.3, size=(count, 3))
    qs = rng.uniform(*hand.limits, size=(count, len(hand.joint_names)))
    R_HLs, _ = forward_kinematics(hand, RigidTransform(), np.zeros(len(hand.joint_names)))
    poses = [
        forward_kinematics(hand, RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), p), q)
        for R, p, q in zip(R_WHs, p_WHs, qs, strict=True)
    ]
    R_WLs = np.array([R for R, _ in poses]) @ np.swapaxes(R_HLs, 1, 2)
    return R_WLs, np.array([p for _, p in poses]), R_WHs, qs


def tip_errors(hand: Hand, p_WLs: Array, R_WLs: Array, X_WHs: list[RigidTransform], qs: Array) -> Array:
    """Distance of the fingertips from those of the targets [m], shape (count, n_fingers)."""
    R_HLs, _ = forward_kinematics(hand, RigidTransform(), np.zeros(len(hand.joint_names)))
    errors = np.empty((len(qs), len(hand.fingers)))
    for row, (X_WH, q) in enumerate(zip(X_WHs, qs, strict=True)):
        R, p = forward_kinematics(hand, X_WH, q)
        for column, finger in enumerate(hand.fingers):
            link = hand.link_index[finger.tip_link]
            goal = R_WLs[row, link] @ R_HLs[link] @ finger.p_LTip + p_WLs[row, link]
            errors[row, column] = np.linalg.norm(R[link] @ finger.p_LTip + p[link] - goal)
    return errors


def bench_ik(watch: Watch, hands: tuple[Hand, ...], *, repeats: int, batch: int, seed: int, tick: Tick) -> None:
    """Link poses of random configurations, solved for from the rest posture.

    Args:
        watch: Where times a pose go, one stage a hand; facts are the share of poses whose fingertips are all within
            1 mm, by hand, and the 99th percentile of the fingertips' errors.
        hands: The hands.
        repeats: Number of batches of each hand.
        batch: Poses of a batch.
        seed: Seed of the poses.
        tick: Called after each batch.
    """
    for hand in hands:
        errors = []
        for repeat in range(repeats):
            R_WLs, p_WLs, _, _ = reachable_poses(hand, batch, seed + repeat)
            found = watch.time(
                f"{hand.name}, a pose of {batch}",
                lambda hand=hand, R=R_WLs, p=p_WLs: link_pose_ik(hand, R, p),
                share=batch,
                target_ms=2.0,
            )
            X_WHs = [
                RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), p)
                for R, p in zip(found.R_WHs, found.p_WHs, strict=True)
            ]
            errors.append(tip_errors(hand, p_WLs, R_WLs, X_WHs, found.qs))
            tick()
        worst = np.concatenate(errors).max(axis=1)
        watch.facts[f"{hand.name}: poses with tips within 1 mm"] = round(float(np.mean(worst <= 1e-3)), 4)
        watch.facts[f"{hand.name}: p99 of the worst tip [mm]"] = round(1e3 * float(np.quantile(worst, 0.99)), 4)
