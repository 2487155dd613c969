"""Metrics of grasps: success, consistency across hands, diversity (section 4.1 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration

BINS = 10_000
"""Bins of the entropy over a joint's range, as in Dex1B."""


def fingertips(hand: Hand, grasp: Grasp) -> dict[str, Array]:
    """Fingertips of a grasp in W.

    Args:
        hand: The grasp's hand.
        grasp: The grasp.

    Returns:
        Tip point of each finger by its name [m], shape (3,).
    """
    k = Configuration.at(hand, grasp.X_WH, grasp.q)
    links = np.array([hand.link_index[f.tip_link] for f in hand.fingers])
    points = k.points(links, np.array([f.p_LTip for f in hand.fingers]))
    return {f.name: point for f, point in zip(hand.fingers, points, strict=True)}


def position_difference(hand_a: Hand, a: Grasp, hand_b: Hand, b: Grasp) -> float:
    """Mean distance of corresponding fingertips and of the wrists, in W.

    Args:
        hand_a: Hand of the first grasp.
        a: First grasp.
        hand_b: Hand of the second grasp.
        b: Second grasp, of the same scene.

    Returns:
        Mean distance [cm].
    """
    tips_a, tips_b = fingertips(hand_a, a), fingertips(hand_b, b)
    shared = [name for name in tips_a if name in tips_b]
    distances = [float(np.linalg.norm(tips_a[name] - tips_b[name])) for name in shared]
    distances.append(float(np.linalg.norm(a.X_WH.translation() - b.X_WH.translation())))
    return 100.0 * float(np.mean(distances))


def vector_difference(hand_a: Hand, a: Grasp, hand_b: Hand, b: Grasp) -> float:
    """Mean distance of corresponding fingertips, each in its own wrist frame.

    Args:
        hand_a: Hand of the first grasp.
        a: First grasp.
        hand_b: Hand of the second grasp.
        b: Second grasp.

    Returns:
        Mean distance [cm]; NaN where the hands share no finger.
    """
    tips_a, tips_b = fingertips(hand_a, a), fingertips(hand_b, b)
    X_HaW, X_HbW = a.X_WH.inverse(), b.X_WH.inverse()
    distances = [
        float(np.linalg.norm(X_HaW @ tips_a[name] - X_HbW @ tips_b[name])) for name in tips_a if name in tips_b
    ]
    return 100.0 * float(np.mean(distances)) if distances else float("nan")


def joint_entropy(hand: Hand, qs: Array, *, bins: int = BINS) -> tuple[float, float]:
    """Entropy of each joint's values over its range: mean and standard deviation over joints.

    The mean is at most ln(min(bins, N)): state N beside it.

    Args:
        hand: The hand.
        qs: Joint values of N grasps [rad or m], shape (N, n).
        bins: Number of bins over each joint's range.

    Returns:
        Mean and standard deviation of the entropies [nat].
    """
    low, high = hand.limits
    entropies = []
    for k in range(qs.shape[1]):
        counts, _ = np.histogram(np.clip(qs[:, k], low[k], high[k]), bins=bins, range=(low[k], high[k]))
        p = counts[counts > 0] / len(qs)
        entropies.append(float(-(p * np.log(p)).sum()))
    return float(np.mean(entropies)), float(np.std(entropies))


def normalised_entropy(hand: Hand, qs: Array, *, bins: int = 32) -> tuple[float, float]:
    """Entropy of each joint's values as a share of the greatest: mean and standard deviation over joints.

    Unlike `joint_entropy` it does not saturate at ln N, from a few hundred grasps on. Ask it of grasps that lifted.

    Args:
        hand: The hand.
        qs: Joint values of N grasps [rad or m], shape (N, n).
        bins: Number of bins over each joint's range.

    Returns:
        Mean and standard deviation, from 0 for one value to 1 for values spread evenly over the range.
    """
    mean, deviation = joint_entropy(hand, qs, bins=bins)
    return mean / float(np.log(bins)), deviation / float(np.log(bins))


def wilson_interval(successes: int, trials: int, *, z: float = 1.96) -> tuple[float, float]:
    """Wilson's score interval of a success rate.

    Args:
        successes: Number of successes.
        trials: Number of trials.
        z: Quantile of the normal distribution; 1.96 for 95 %.

    Returns:
        Lower and upper bound; (0, 1) without a trial.
    """
    if trials == 0:
        return 0.0, 1.0
    p, n = successes / trials, trials
    center = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, float(center - half)), min(1.0, float(center + half))


def success_rate(grasps: Sequence[Grasp]) -> float:
    """Share of grasps whose lift succeeded; one that was not lifted counts as a failure."""
    lifted = sum(1 for grasp in grasps if grasp.lift is not None and grasp.lift.success)
    return lifted / len(grasps) if grasps else float("nan")
