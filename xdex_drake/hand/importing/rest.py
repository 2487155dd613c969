"""The rest posture: half open, the thumb opposite the fingers, nothing in contact that need not be."""

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.hand.collision import ignored_indices
from xdex_drake.hand.description import Hand
from xdex_drake.hand.importing.anatomy import Anatomy
from xdex_drake.hand.importing.bodies import link_poses
from xdex_drake.hand.importing.decisions import Decision, Decisions
from xdex_drake.hand.importing.postures import Senses, senses

CURL = 1.6
"""How far the last link of a finger is turned at rest [rad], where its range allows."""

SHARE = 0.45
"""Greatest share of a finger's bending that is used at rest."""

OPENING = 0.06
"""Distance of the thumb's tip from the tips it opposes, for a hand of `USUAL_SIZE` [m]."""

USUAL_SIZE = 0.18
"""Distance from the wrist to the farthest tip of a usual hand [m]."""

SLACK = 2e-3
"""Spheres of boxes and hulls bulge: an overlap of this much [m] is no contact."""

CLEARANCE = 1e-3
"""Distance that links keep at rest where they can [m]."""

TRIALS = 3000
"""Number of postures that are tried first."""

ROUNDS = 7
"""Number of times that the best ones are refined."""

PRESS = 300.0
"""Cost of an overlap [1/m], against which that of a thumb that points elsewhere is of order one."""

Pair = tuple[int, int, float]
"""Two links and the distance they should keep [m]."""


def rest_posture(hand: Hand, anatomy: Anatomy, decisions: Decisions) -> Array:
    """A relaxed posture.

    Fingers bend by about `CURL`, or by `SHARE` of their range; joints that spread them stay near zero. The thumb's
    joints are searched for the posture in which its pad and those of the first two fingers face each other at a hand's
    breadth; the others give way where links would touch.

    Args:
        hand: The hand, complete but for its rest posture.
        anatomy: Its fingers.
        decisions: Grows by what was decided.

    Returns:
        Actuated joint values [rad or m], shape (n,).
    """
    lower, upper = hand.limits
    q = _spread_posture(hand, np.clip(0.0, lower, upper))
    C = hand.coupling_matrix
    for digit, name in zip(anatomy.digits, anatomy.names, strict=True):
        if name != "thumb" or len(anatomy.digits) == 1:
            q = _bent(hand, q, digit.closing, digit.chain.path, C)
    if "thumb" not in anatomy.names:
        return q
    drawn = senses(hand, anatomy)
    pairs = _free_pairs(hand, drawn)
    thumb = anatomy.digits[anatomy.names.index("thumb")]
    moves = (C[[k - 1 for k in thumb.chain.path]] != 0.0).any(axis=0)
    if len(anatomy.digits) <= 3 and (thumb.closing[moves] != 0.0).all():
        # Claws and grippers: all close together, as far as suits the tips; sliding jaws are half open.
        closing = np.sum([digit.closing for digit in anatomy.digits], axis=0)
        q = _bent(hand, q, thumb.closing, thumb.chain.path, C)
        turning = (closing != 0.0) & ~(C[hand.prismatic] != 0.0).any(axis=0)
        open_, closed = np.where(closing > 0.0, lower, upper), np.where(closing > 0.0, upper, lower)
        qs = np.where(turning, open_ + np.linspace(0.02, 0.98, 49)[:, None] * (closed - open_), q)
        q = qs[int(np.argmin(_cost(hand, anatomy, qs) + PRESS * _overlap(hand, qs, pairs)))]
        if _overlap(hand, q[None], pairs)[0] <= SLACK:
            return q
    best = _opposed(hand, anatomy, q, moves, pairs, drawn)
    left = _overlap(hand, best[None], pairs)[0]
    if left > CLEARANCE + SLACK:
        text = f"its links overlap by {1e3 * (left - CLEARANCE):.1f} mm at the rest posture; look at it and change it."
        decisions.append(Decision("warning", "hand", text))
    return best


def _spread_posture(hand: Hand, zero: Array) -> Array:
    """Zero, or a little inside where zero is a limit."""
    lower, upper = hand.limits
    return np.clip(zero, lower + 0.05 * (upper - lower), upper - 0.05 * (upper - lower))


def _bent(hand: Hand, q: Array, closing: Array, path: tuple[int, ...], C: Array) -> Array:
    """A posture in which one finger is half bent; sliding jaws, and what is closed at zero, are half open."""
    lower, upper = hand.limits
    end = np.where(closing > 0.0, upper, lower)
    begin = np.clip(0.0, lower, upper)
    rows = [k - 1 for k in path]
    slides = (C[rows][hand.prismatic[rows]] != 0.0).any(axis=0)
    full = slides | (np.abs(end - begin) < 0.1 * (upper - lower))
    begin = np.where(full, np.where(closing > 0.0, lower, upper), begin)
    gain = np.abs(C[rows])[~hand.prismatic[rows]].sum(axis=0)
    turn = float((gain * np.abs(end - begin) * (closing != 0.0)).sum())
    already = float(np.abs(hand.coupling_offset[rows][~hand.prismatic[rows]]).sum())
    share = float(np.clip((CURL - 0.5 * already) / turn, 0.15, SHARE)) if turn > 0.0 else SHARE
    return np.where(closing != 0.0, begin + np.where(full, 0.5, share) * (end - begin), q)


def _opposed(
    hand: Hand, anatomy: Anatomy, q: Array, moves: NDArray[np.bool_], pairs: list[Pair], drawn: Senses
) -> Array:
    """The best of many postures, refined by shrinking random steps: the thumb's anywhere, the others' near `q`."""
    lower, upper = hand.limits
    span = upper - lower
    rng = np.random.default_rng(0)
    thumb = anatomy.digits[anatomy.names.index("thumb")]

    def cost(qs: Array) -> Array:
        shift = np.where(moves & (thumb.closing == 0.0), 0.0, (qs - q) / np.maximum(span, 1e-9))
        weight = np.where(moves, 1.0, 6.0)
        backwards = np.maximum(thumb.closing * (np.clip(0.0, lower, upper) - qs), 0.0)
        return _cost(hand, anatomy, qs) + (weight * shift**2).sum(axis=1) + 3.0 * (backwards**2).sum(axis=1)

    q = np.where(moves, _bent(hand, q, thumb.closing, thumb.chain.path, hand.coupling_matrix), q)
    qs = np.repeat(q[None], TRIALS, axis=0)
    qs[1:] += np.where(moves, 0.0, 0.12) * span * drawn.steps(rng.normal(size=(TRIALS - 1, len(q))))
    anywhere = lower + drawn.shares(rng.random((TRIALS - 1, len(q)))) * span
    qs[1:, moves] = anywhere[:, moves]
    qs = np.clip(qs, lower, upper)
    scale = 0.2
    for _ in range(ROUNDS):
        costs = cost(qs)
        order = np.argsort(costs, kind="stable")[:150]
        exact = costs[order] + PRESS * _overlap(hand, qs[order], pairs)
        best = qs[order[np.argsort(exact, kind="stable")[:10]]]
        steps = scale * span * drawn.steps(rng.normal(size=(600, len(q)))) * np.where(moves, 1.0, 0.3)
        qs = np.concatenate([best, np.clip(np.repeat(best, 60, axis=0) + steps, lower, upper)])
        scale *= 0.6
    best = qs[0]

    def total(q: Array) -> float:
        return float((cost(q[None]) + PRESS * _overlap(hand, q[None], pairs))[0])

    # What need not give way goes back.
    for k in [k for k in drawn.order if not moves[k]]:
        calm = best.copy()
        calm[k] = q[k]
        if total(calm) < total(best) + 0.02:
            best = calm
    return best


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
    # Facing the palm, in front of it, and not at the ends of the range.
    cost += 0.8 * (1.0 + pads["thumb"] @ x_B)
    front = (tips["thumb"] - p[:, 0]) @ x_B + hand.p_HB[0]
    cost += 200.0 * np.maximum(0.015 - front, 0.0)
    lower, upper = hand.limits
    middle, half = 0.5 * (lower + upper), np.maximum(0.5 * (upper - lower), 1e-9)
    return cost + 0.5 * (((qs - middle) / half) ** 4).mean(axis=1)


def _free_pairs(hand: Hand, drawn: Senses) -> list[Pair]:
    """Pairs of links that are no neighbors, with the distance that they can be expected to keep."""
    lower, upper = hand.limits
    rng = np.random.default_rng(1)
    qs = lower + drawn.shares(rng.random((48, len(lower)))) * (upper - lower)
    solid = [k for k, link in enumerate(hand.links) if len(link.spheres)]
    parent = {k: _solid_parent(hand, k) for k in solid}
    placed = _placed(hand, qs)
    ignored = set(ignored_indices(hand))
    pairs = []
    for n, i in enumerate(solid):
        for j in solid[n + 1 :]:
            if parent[i] != j and parent[j] != i and (i, j) not in ignored and (j, i) not in ignored:
                reached = float(_gap(hand, placed, i, j, cut=CLEARANCE).max())
                pairs.append((i, j, min(CLEARANCE, reached)))
    return pairs


def _overlap(hand: Hand, qs: Array, pairs: list[Pair]) -> Array:
    """By how much some pair of links is nearer than it should be [m], shape (N,)."""
    placed = _placed(hand, qs)
    worst = np.zeros(len(qs))
    for i, j, distance in pairs:
        worst = np.maximum(worst, distance - _gap(hand, placed, i, j, cut=distance))
    return worst


def _placed(hand: Hand, qs: Array) -> list[tuple[Array, Array, float]]:
    """For each link the centers of its spheres in B, and a ball that holds them: its center and its radius."""
    R, p = link_poses(hand, qs)
    placed = []
    for k, link in enumerate(hand.links):
        centers, radii = link.spheres[:, :3], link.spheres[:, 3]
        middle = centers.mean(axis=0) if len(centers) else np.zeros(3)
        reach = float((np.linalg.norm(centers - middle, axis=1) + radii).max(initial=0.0))
        turned = np.swapaxes(R[:, k], 1, 2)
        placed.append((p[:, k, None] + centers @ turned, p[:, k] + R[:, k] @ middle, reach))
    return placed


def _gap(hand: Hand, placed: list[tuple[Array, Array, float]], i: int, j: int, *, cut: float) -> Array:
    """Distance between two links' spheres [m], exact where it is below `cut`, shape (N,)."""
    (a, middle_a, reach_a), (b, middle_b, reach_b) = placed[i], placed[j]
    apart = np.linalg.norm(middle_a - middle_b, axis=1) - reach_a - reach_b
    near = np.flatnonzero(apart < cut)
    gap = np.maximum(apart, cut)
    if len(near):
        radii = hand.links[i].spheres[:, 3, None] + hand.links[j].spheres[None, :, 3]
        a, b = a[near], b[near]
        squares = (a**2).sum(axis=2)[:, :, None] + (b**2).sum(axis=2)[:, None] - 2.0 * a @ np.swapaxes(b, 1, 2)
        gap[near] = (np.sqrt(np.maximum(squares, 0.0)) - radii).min(axis=(1, 2))
    return gap


def _solid_parent(hand: Hand, k: int) -> int:
    k = int(hand.parents[k])
    while k >= 0 and not len(hand.links[k].spheres):
        k = int(hand.parents[k])
    return k
