"""The rest posture: half open, the thumb opposite the fingers, nothing in contact that need not be."""

import numpy as np
from numpy.typing import NDArray

from xdex_drake.hand.description import Array, Hand
from xdex_drake.hand.importing.anatomy import Anatomy
from xdex_drake.hand.importing.bodies import link_poses
from xdex_drake.hand.importing.decisions import Decision, Decisions

CURL = 1.4
"""How far the last link of a finger is turned at rest [rad], where its range allows."""

SHARE = 0.45
"""Greatest share of a finger's bending that is used at rest."""

OPENING = 0.06
"""Distance of the thumb's tip from the tips it opposes, for a hand of `USUAL_SIZE` [m]."""

USUAL_SIZE = 0.18
"""Distance from the wrist to the farthest tip of a usual hand [m]."""

CLEARANCE = 2e-3
"""Distance that links keep at rest where they can [m]."""

TRIALS = 3000
ROUNDS = 4


def rest_posture(hand: Hand, anatomy: Anatomy, decisions: Decisions) -> Array:
    """A relaxed posture.

    Fingers bend by `CURL`, or by `SHARE` of their range; joints that spread them stay near zero. The thumb's joints are
    searched for the posture in which its pad and those of the first two fingers face each other at a hand's breadth.

    Args:
        hand: The hand, complete but for its rest posture.
        anatomy: Its fingers.
        decisions: Grows by what was decided.

    Returns:
        Actuated joint values [rad or m], shape (n,).
    """
    lower, upper = hand.limits
    zero = np.clip(0.0, lower, upper)
    q = _spread_posture(hand, zero)
    C = hand.coupling_matrix
    for digit, name in zip(anatomy.digits, anatomy.names, strict=True):
        if name == "thumb" and len(anatomy.digits) > 1:
            continue
        q = _bent(hand, q, digit.closing, digit.chain.path, C)
    if "thumb" not in anatomy.names:
        return q
    thumb = anatomy.digits[anatomy.names.index("thumb")]
    moves = np.flatnonzero((C[[k - 1 for k in thumb.chain.path]] != 0.0).any(axis=0)).astype(np.int64)
    if len(anatomy.digits) <= 3 and (thumb.closing[moves] != 0.0).all():
        # Claws and grippers: the thumb is one finger more.
        q = _bent(hand, q, thumb.closing, thumb.chain.path, C)
        if not _rubbing(hand, q[None])[0] > 0.0:
            return q
    best = _opposed(hand, anatomy, q, moves)
    left = _rubbing(hand, best[None])[0]
    if left > 1e-3:
        text = f"its links overlap by up to {1e3 * left:.1f} mm at the rest posture; give it a freer one if they do."
        decisions.append(Decision("warning", "hand", text))
    return best


def _spread_posture(hand: Hand, zero: Array) -> Array:
    """Zero, or a little inside where zero is a limit."""
    lower, upper = hand.limits
    return np.clip(zero, lower + 0.05 * (upper - lower), upper - 0.05 * (upper - lower))


def _bent(hand: Hand, q: Array, closing: Array, path: tuple[int, ...], C: Array) -> Array:
    lower, upper = hand.limits
    zero = np.clip(0.0, lower, upper)
    begin = np.where(closing > 0.0, np.maximum(zero, lower), np.minimum(zero, upper))
    end = np.where(closing > 0.0, upper, lower)
    room = np.abs(end - begin)
    if (room < 1e-6).all():
        begin = np.where(closing > 0.0, lower, upper)
        room = np.abs(end - begin)
    rows = [k - 1 for k in path]
    kinds = hand.prismatic[rows]
    turn = float((np.abs(C[rows]) * (~kinds)[:, None] @ (room * (closing != 0.0))).sum())
    already = float(np.abs(hand.coupling_offset[rows][~kinds]).sum())
    share = 0.5 if kinds.any() or turn == 0.0 else float(np.clip((CURL - 0.5 * already) / turn, 0.15, SHARE))
    return np.where(closing != 0.0, begin + share * (end - begin), q)


def _opposed(hand: Hand, anatomy: Anatomy, q: Array, moves: NDArray[np.int64]) -> Array:
    """The best of many postures of the thumb, refined by shrinking random steps."""
    lower, upper = hand.limits
    rng = np.random.default_rng(0)
    qs = np.repeat(q[None], TRIALS, axis=0)
    qs[:, moves] = lower[moves] + rng.random((TRIALS, len(moves))) * (upper - lower)[moves]
    scale = 0.5
    for _ in range(ROUNDS):
        cost = _cost(hand, anatomy, qs)
        order = np.argsort(cost, kind="stable")[:60]
        exact = cost[order] + 60.0 * _rubbing(hand, qs[order])
        best = qs[order[np.argsort(exact, kind="stable")[:12]]]
        scale *= 0.4
        steps = scale * (upper - lower)[moves] * rng.normal(size=(12 * 60, len(moves))) * 0.5
        more = np.repeat(best, 60, axis=0)
        more[:, moves] = np.clip(more[:, moves] + steps, lower[moves], upper[moves])
        qs = np.concatenate([best, more])
    return qs[0]


def _cost(hand: Hand, anatomy: Anatomy, qs: Array) -> Array:
    R, p = link_poses(hand, qs)
    x_B = hand.R_HB[0]
    tips, pads = {}, {}
    for digit, name in zip(anatomy.digits, anatomy.names, strict=True):
        k = digit.chain.bodies[-1]
        tips[name] = p[:, k] + R[:, k] @ digit.p_LTip
        pads[name] = R[:, k] @ digit.n_LPad
    partners = [name for name in anatomy.names if name != "thumb"][:2]
    size = max(float(np.linalg.norm(hand.R_HB @ tips[name][0] + hand.p_HB)) for name in partners)
    opening = OPENING * np.clip(size / USUAL_SIZE, 0.5, 1.6)
    cost = np.zeros(len(qs))
    for name in partners:
        way = tips[name] - tips["thumb"]
        distance = np.linalg.norm(way, axis=1)
        u = way / np.maximum(distance, 1e-9)[:, None]
        cost += 4.0 * ((distance - opening) / opening) ** 2
        cost += 1.5 * (1.0 - (pads["thumb"] * u).sum(axis=1)) + (1.0 + (pads[name] * u).sum(axis=1))
    # In front of the palm, and not at the ends of the range.
    front = (tips["thumb"] - p[:, 0]) @ x_B + hand.p_HB[0]
    cost += 200.0 * np.maximum(0.015 - front, 0.0)
    lower, upper = hand.limits
    middle, half = 0.5 * (lower + upper), np.maximum(0.5 * (upper - lower), 1e-9)
    return cost + 0.3 * (((qs - middle) / half) ** 4).mean(axis=1)


def _rubbing(hand: Hand, qs: Array) -> Array:
    """Greatest overlap of links that are not neighbors, over what they overlap by at every posture [m], shape (N,)."""
    R, p = link_poses(hand, qs)
    solid = [k for k, link in enumerate(hand.links) if len(link.spheres)]
    parent = {k: _solid_parent(hand, k) for k in solid}
    centers = {k: p[:, k, None] + np.einsum("nab,mb->nma", R[:, k], hand.links[k].spheres[:, :3]) for k in solid}
    worst = np.zeros(len(qs))
    for n, i in enumerate(solid):
        for j in solid[n + 1 :]:
            if parent[i] == j or parent[j] == i or _grandparent(parent, i) == j or _grandparent(parent, j) == i:
                continue
            radii = hand.links[i].spheres[:, 3, None] + hand.links[j].spheres[None, :, 3]
            reach = _radius(centers[i]) + _radius(centers[j]) + radii.max() + CLEARANCE
            near = np.linalg.norm(centers[i].mean(axis=1) - centers[j].mean(axis=1), axis=1) < reach
            if not near.any():
                continue
            a, b = centers[i][near], centers[j][near]
            gap = np.linalg.norm(a[:, :, None] - b[:, None], axis=-1) - radii
            worst[near] = np.maximum(worst[near], CLEARANCE - gap.min(axis=(1, 2)))
    return worst


def _radius(points: Array) -> Array:
    return np.linalg.norm(points - points.mean(axis=1, keepdims=True), axis=-1).max(axis=1)


def _solid_parent(hand: Hand, k: int) -> int:
    k = int(hand.parents[k])
    while k >= 0 and not len(hand.links[k].spheres):
        k = int(hand.parents[k])
    return k


def _grandparent(parent: dict[int, int], k: int) -> int | None:
    return parent.get(parent[k])
