"""How a hand moves: fingertips, which way each finger closes, which finger is the thumb, and the wrist frame H.

Everything is read from the tree and its limits at the zero posture (zero clipped to the limits), where most makers'
fingers are straight, or, for grippers, from how the tips come together.
"""

from dataclasses import dataclass, replace

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.importing.bodies import Member, Tree, link_poses
from xdex_drake.hand.importing.decisions import Decision, Decisions
from xdex_drake.hand.importing.finger_names import FINGER_NAMES, named_fingers
from xdex_drake.hand.importing.palm import Chain
from xdex_drake.hand.importing.shape import surface_points

PARALLEL = 0.7
"""Cosine above which two joint axes count as parallel."""

TIP_INSET = 0.012
"""A frame that the file sets at a fingertip lies at most this far before the end of the shape [m]."""

BLUNT = 0.12
"""The share of a link's length that counts as its end where the direction to the tip is looked for."""

PHALANX = 0.5
"""A step from joint to joint that is shorter than this share of the finger's longest is a hub, no phalanx."""

STRAIGHTER = 0.015
"""A finger that is straighter when open, by this share of its length, is drawn half bent at zero."""

CURLED = 0.1
"""Ends of a finger's range at which it is straight to this different degree tell which way it closes."""

STRAY = np.deg2rad(40.0)
"""A first phalanx that leads farther than this away from the tip does not tell the finger's direction [rad]."""

SIDEWAYS = 0.6
"""Cosine between the axis of a thumb and the direction of the fingers above which it is no jaw among others."""

LEAN = 0.4
"""Sine of the angle by which the fingers of a gripper may lean to one side for lack of a common range."""

NO_SHAPE_TIP = 0.02
"""Length of a last link of which nothing is known [m]."""


@dataclass(frozen=True)
class Digit:
    """A finger before it has a name.

    Attributes:
        chain: Its links.
        p_LTip: Tip point in the frame of the last link [m], shape (3,).
        n_LPad: Direction out of the pad in that frame, shape (3,).
        closing: For each actuated joint, +1 or -1 where it bends the finger that way, else 0; shape (n,).
        axis: Axis in B that the finger bends about at the zero posture, counterclockwise; zero for sliders, shape (3,).
        sweep: Unit vector in B along which the tip moves when the finger begins to close, shape (3,).
        along: Unit vector in B along the finger at the zero posture, shape (3,).
        p_BRoot: First joint's center at the zero posture [m], shape (3,).
        p_BTip: Tip at the zero posture [m], shape (3,).
    """

    chain: Chain
    p_LTip: Array
    n_LPad: Array
    closing: Array
    axis: Array
    sweep: Array
    along: Array
    p_BRoot: Array
    p_BTip: Array


@dataclass(frozen=True)
class Anatomy:
    """A hand's fingers with names, and its wrist frame.

    Attributes:
        digits: Fingers, thumb first, then from the index finger on.
        names: Their names.
        R_HB: Rotation of the base in H, shape (3, 3).
        side: "right" or "left"; None where the shape does not say.
    """

    digits: tuple[Digit, ...]
    names: tuple[str, ...]
    R_HB: Array
    side: str | None


def zero_posture(hand: Hand) -> Array:
    """Zero, clipped to the limits, shape (n,)."""
    return np.clip(0.0, *hand.limits)


def find_tip(hand: Hand, body: int, members: tuple[Member, ...], palm: Array, decisions: Decisions) -> Array:
    """The tip point of a finger's last link.

    A frame that the file sets near the end of the link's shape is taken; else the end of the shape itself.

    Args:
        hand: The tree.
        body: Index of the last link.
        members: Links of the file that make it up.
        palm: Middle of the palm's shape in B [m], shape (3,).
        decisions: Grows by what was decided.

    Returns:
        p_LTip [m], shape (3,).
    """
    name = hand.links[body].name
    points = surface_points(members)
    frames = [m for m in members[1:] if m.leaf and (_says_tip(m) or not (m.link.visual or m.link.collision))]
    if len(points) == 0:
        if frames:
            return max((m.X_LF[:3, 3] for m in frames), key=lambda p: float(p @ p)).copy()
        R, p = link_poses(hand, zero_posture(hand))
        back = p[0, body] - p[0, hand.parents[body]]
        length = float(np.linalg.norm(back))
        u = R[0, body].T @ back / length if length > 1e-4 else np.array([0.0, 0.0, 1.0])
        text = f"has neither shape nor tip frame; its tip is set {1e3 * NO_SHAPE_TIP:.0f} mm beyond its joint."
        decisions.append(Decision("warning", f"link {name}", text))
        return NO_SHAPE_TIP * u
    far, u = _far_end(hand, body, points, palm)
    extent = float((points @ u).max())
    near = [m for m in frames if float(m.X_LF[:3, 3] @ u) > extent - TIP_INSET and _near(points, m.X_LF[:3, 3])]
    if near:
        best = max(near, key=lambda m: (_says_tip(m), float(m.X_LF[:3, 3] @ u)))
        return best.X_LF[:3, 3].copy()
    return far


def _says_tip(member: Member) -> bool:
    return "tip" in member.link.name.lower()


def _near(points: Array, p: Array) -> bool:
    low, high = points.min(axis=0) - 3e-3, points.max(axis=0) + 3e-3
    return bool((p > low).all() and (p < high).all())


def _far_end(hand: Hand, body: int, points: Array, palm: Array) -> tuple[Array, Array]:
    """The far end of a link's shape, and the unit direction from its joint to there."""
    joint = hand.joints[body - 1]
    R, p = link_poses(hand, zero_posture(hand))
    if joint.kind == "prismatic":
        # A jaw reaches away from the palm, across the direction in which it slides.
        u = points.mean(axis=0) - R[0, body].T @ (palm - p[0, body])
        u = u - joint.axis * (u @ joint.axis)
        u = u / max(float(np.linalg.norm(u)), 1e-9)
    else:
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        ahead = points[points @ middle > 0.0]
        ahead = points if len(ahead) == 0 else ahead
        u = ahead[int(np.linalg.norm(ahead, axis=1).argmax())]
        u = u / max(float(np.linalg.norm(u)), 1e-9)
        # Of a blunt end, from the corner that happens to be farthest to its middle.
        for _ in range(3):
            s = points @ u
            end = points[s > s.max() - BLUNT * max(float(s.max()), 1e-9)]
            u = 0.5 * (end.min(axis=0) + end.max(axis=0))
            u = u / max(float(np.linalg.norm(u)), 1e-9)
    top = points[points @ u > (points @ u).max() - 3e-3]
    return 0.5 * (top.min(axis=0) + top.max(axis=0)), u


def find_digits(tree: Tree, chains: list[Chain], decisions: Decisions) -> list[Digit]:
    """Tips and closing directions of all fingers.

    Args:
        tree: The hand.
        chains: Its fingers' links.
        decisions: Grows by what was decided.

    Returns:
        The fingers, in the order of `chains`.
    """
    hand = tree.skeleton
    palm_points = surface_points(tree.members[0])
    palm = 0.5 * (palm_points.min(axis=0) + palm_points.max(axis=0)) if len(palm_points) else np.zeros(3)
    tips = [find_tip(hand, c.bodies[-1], tree.members[c.bodies[-1]], palm, decisions) for c in chains]
    R, p = (x[0] for x in link_poses(hand, zero_posture(hand)))
    digits = []
    for n, chain in enumerate(chains):
        tip = chain.bodies[-1]
        p_BTip = p[tip] + R[tip] @ tips[n]
        closing, axis = _closing(hand, chains, tips, n, decisions)
        sweep = _sweep(hand, tip, tips[n], closing)
        pad = _pad(hand, tip, tips[n], closing, axis, sweep)
        along = _along(hand, chain, tips[n], closing)
        digits.append(Digit(chain, tips[n], pad, closing, axis, sweep, along, p[chain.bodies[0]], p_BTip))
    return _facing(hand, digits) if len(digits) == 2 else digits


def _along(hand: Hand, chain: Chain, p_LTip: Array, closing: Array) -> Array:
    """Unit vector along a finger, in B: at the zero posture, or where it is open, if it is much straighter there."""
    lower, upper = hand.limits
    q0 = zero_posture(hand)
    open_ = np.where(closing > 0.0, lower, np.where(closing < 0.0, upper, q0))
    found = [_phalanx(hand, chain, q, p_LTip) for q in (q0, open_)]
    return found[int(found[1][1] > found[0][1] + STRAIGHTER)][0]


def _phalanx(hand: Hand, chain: Chain, q: Array, p_LTip: Array) -> tuple[Array, float]:
    """Unit vector in B along a finger's first phalanx at a posture, and how straight the finger is from there on.

    A phalanx leads to a joint that bends the finger, or to the tip; hubs, which may step aside, are shorter than half
    of the longest one. Where the finger as a whole leads elsewhere, the way from there to the tip counts.
    """
    R, p = (x[0] for x in link_poses(hand, q))
    turning = [k for k in chain.bodies if hand.joints[k - 1].kind == "revolute"]
    axes = {k: R[k] @ hand.joints[k - 1].axis for k in turning}
    bending = [k for k in turning if abs(axes[k] @ axes[turning[-1]]) > PARALLEL]
    first = chain.bodies.index(bending[0]) if bending else 0
    p_BTip = p[chain.bodies[-1]] + R[chain.bodies[-1]] @ p_LTip
    centers = np.array([*(p[k] for k in chain.bodies[first:]), p_BTip])
    bends = np.array([k in bending or not bending for k in chain.bodies[first + 1 :]] + [True])
    steps = np.linalg.norm(np.diff(centers, axis=0), axis=1)
    sizes = steps * bends
    start = int(np.argmax(sizes >= PHALANX * sizes.max()))
    way, whole = centers[start + 1] - centers[start], p_BTip - centers[start]
    if way @ whole < np.cos(STRAY) * np.linalg.norm(way) * np.linalg.norm(whole):
        way = whole
    straight = float(np.linalg.norm(whole) / max(float(steps[start:].sum()), 1e-9))
    return way / max(float(np.linalg.norm(way)), 1e-9), straight


def _facing(hand: Hand, digits: list[Digit]) -> list[Digit]:
    """Two fingers with pads that face each other at mid range, also where the last joint turns the tips aside."""
    R, p = (x[0] for x in link_poses(hand, hand.limits.mean(axis=0)))
    last = [digit.chain.bodies[-1] for digit in digits]
    tips = [p[k] + R[k] @ digit.p_LTip for k, digit in zip(last, digits, strict=True)]
    way = tips[1] - tips[0]
    if np.linalg.norm(way) < 1e-3:
        return digits
    way = way / np.linalg.norm(way)
    out = []
    for digit, k, u in zip(digits, last, (way, -way), strict=True):
        u_L = R[k].T @ u
        out.append(digit if digit.n_LPad @ u_L > PARALLEL else replace(digit, n_LPad=u_L))
    return out


def _closing(hand: Hand, chains: list[Chain], tips: list[Array], n: int, decisions: Decisions) -> tuple[Array, Array]:
    """Which way each actuated joint bends a finger, and the axis it bends about, in B at the zero posture.

    Joints parallel to the last one bend the finger: it closes towards that end of their range where it is less
    straight, be it drawn open or closed at zero. A finger of one phalanx has more room to bend than to stretch. Where
    the limits do not say, or there are two fingers only, the way in which the tips approach each other counts.
    """
    chain = chains[n]
    C = hand.coupling_matrix
    q0 = zero_posture(hand)
    R, _ = (x[0] for x in link_poses(hand, q0))
    joints = [k - 1 for k in chain.path]
    axes = {j: R[j + 1] @ hand.joints[j].axis for j in joints}
    turning = [j for j in joints if hand.joints[j].kind == "revolute"]
    last = turning[-1] if turning else None
    weight = np.zeros(C.shape[1])  # Turn of the last link about the last axis for each unit of an actuated joint.
    bends = np.zeros(C.shape[1], dtype=bool)
    for k in range(C.shape[1]):
        mine = [j for j in joints if C[j, k] != 0.0]
        if not mine:
            continue
        if last is None or any(j not in turning for j in mine):
            bends[k] = True
            continue
        cosines = np.array([axes[j] @ axes[last] for j in mine])
        gains = np.abs(C[mine, k])
        bends[k] = bool((np.abs(cosines) * gains).sum() > PARALLEL * gains.sum())
        turn = float((C[mine, k] * cosines).sum())
        weight[k] = turn if bends[k] and abs(turn) > 0.2 * gains.sum() else 0.0
    lower, upper = hand.limits
    room = weight * ((upper - q0) - (q0 - lower))
    total = float((np.abs(weight) * (upper - lower)).sum())
    ends = [np.where(weight == 0.0, q0, np.where(way * weight > 0.0, upper, lower)) for way in (1.0, -1.0)]
    straight = [_phalanx(hand, chain, q, tips[n])[1] for q in ends]
    sign = 0.0
    if len(chains) > 2 and total > 0.0 and abs(straight[0] - straight[1]) > CURLED:
        sign = float(np.sign(straight[1] - straight[0]))
    elif len(chains) > 2 and total > 0.0 and abs(room.sum()) > 0.2 * total:
        sign = float(np.sign(room.sum()))
    elif total > 0.0:
        sign = _approach(hand, chains, tips, n, np.sign(weight))
        if len(chains) > 2:
            text = "has as much room to bend backwards; it is taken to close towards the other fingertips."
            decisions.append(Decision("decided", f"finger at {hand.links[chain.bodies[-1]].name}", text))
    closing = sign * np.sign(weight)
    # A slider, a gear that keeps its jaw's direction, any joint of a gripper: what brings the tips together closes.
    for k in np.flatnonzero(bends if len(chains) == 2 else bends & (weight == 0.0)):
        alone = np.zeros(C.shape[1])
        alone[k] = 1.0
        closing[k] = _approach(hand, chains, tips, n, alone)
    if len(chains) == 2 and (closing @ weight) != 0.0:
        sign = float(np.sign(closing @ weight))
    axis = np.zeros(3) if last is None else (sign or 1.0) * axes[last]
    return closing, axis


def _approach(hand: Hand, chains: list[Chain], tips: list[Array], n: int, direction: Array) -> float:
    """+1 where the tip nears the other tips as its joints move in a direction from end to end, else -1."""
    lower, upper = hand.limits
    q0 = zero_posture(hand)
    ends = np.stack([np.where(direction > 0, lower, upper), np.where(direction > 0, upper, lower)])
    R, p = link_poses(hand, np.where(direction == 0.0, q0, ends))
    at = [p[:, c.bodies[-1]] + R[:, c.bodies[-1]] @ tip for c, tip in zip(chains, tips, strict=True)]
    others = [x for k, x in enumerate(at) if k != n]
    if not others:
        # A lone finger closes towards its palm.
        distance = np.linalg.norm(at[n] - p[:, 0], axis=1)
    else:
        distance = np.linalg.norm(at[n] - np.mean(others, axis=0), axis=1)
    return 1.0 if distance[1] < distance[0] else -1.0


def _sweep(hand: Hand, tip: int, p_LTip: Array, closing: Array) -> Array:
    lower, upper = hand.limits
    q0 = zero_posture(hand)
    room = np.where(closing > 0, upper - q0, np.where(closing < 0, lower - q0, 0.0))
    if np.abs(room).max(initial=0.0) < 1e-6:  # The zero posture is the closed one.
        q0 = np.where(closing > 0, lower, np.where(closing < 0, upper, q0))
        room = closing * (upper - lower)
    R, p = link_poses(hand, np.stack([q0, q0 + 0.3 * room]))
    at = p[:, tip] + R[:, tip] @ p_LTip
    way = at[1] - at[0]
    return way / max(float(np.linalg.norm(way)), 1e-9)


def _pad(hand: Hand, tip: int, p_LTip: Array, closing: Array, axis: Array, sweep: Array) -> Array:
    """Where the tip goes when the last joint bends, in the last link's frame."""
    R, _ = (x[0] for x in link_poses(hand, zero_posture(hand)))
    joint = hand.joints[tip - 1]
    row = hand.coupling_matrix[tip - 1]
    moves = closing[np.flatnonzero(row)]
    n_LPad = R[tip].T @ sweep
    if joint.kind == "revolute" and moves.any() and np.linalg.norm(axis) > 0.5:
        a = joint.axis * np.sign(joint.axis @ (R[tip].T @ axis))
        turned = np.cross(a, p_LTip)
        if np.linalg.norm(turned) > 1e-4 and turned @ n_LPad > -0.3 * np.linalg.norm(turned):
            n_LPad = turned
    return n_LPad / max(float(np.linalg.norm(n_LPad)), 1e-9)


def name_fingers(tree: Tree, digits: list[Digit], side: str | None, decisions: Decisions) -> Anatomy:
    """Names the fingers and finds the wrist frame's directions.

    The thumb is the finger whose removal leaves the others most alike. The others are in order of their roots across
    the palm, the index finger on the thumb's side. Names in the file that are clear go before this.

    Args:
        tree: The hand.
        digits: Its fingers.
        side: "right" or "left" where a person or the file's names say so.
        decisions: Grows by what was decided.

    Returns:
        Fingers in order, their names, and the rotation of H.
    """
    hand = tree.skeleton
    said = named_fingers([_names_along(tree, digit) for digit in digits])
    thumb = _thumb(digits, said, decisions)
    rest = [k for k in range(len(digits)) if k != thumb]
    along = _finger_direction(hand, digits, rest, thumb)
    across = _lateral(digits, rest, along)
    out = _palm_normal(digits, rest, thumb, along, across, decisions)
    y = np.cross(along, out)
    # Towards the index finger: by names, else towards the thumb.
    order = sorted(rest, key=lambda k: float(digits[k].p_BRoot @ y))
    toward = 0.0
    ranks = [FINGER_NAMES.index(said[k]) if said[k] is not None else None for k in order]
    known = [(n, r) for n, r in enumerate(ranks) if r]
    if len(known) >= 2:
        toward = -float(np.sign(np.corrcoef(np.array(known, dtype=float).T)[0, 1]))
    lean = _thumb_side(digits, rest, thumb, y)
    if toward != 0.0 and lean != 0.0 and toward != lean:
        text = "the names put the index finger away from the thumb; the names were followed."
        decisions.append(Decision("warning", "hand", text))
    toward = toward or lean
    found = None if toward == 0.0 else ("right" if toward > 0.0 else "left")
    chosen = found or side or "right"
    if chosen == "right":
        order = order[::-1]
    names: dict[int, str] = {} if thumb is None else {thumb: "thumb"}
    free = [name for name in FINGER_NAMES[1:]]
    all_said = all(said[k] in FINGER_NAMES[1:] for k in rest)
    for n, k in enumerate(order):
        by_place = free[n] if n < len(free) else f"finger_{n + 2}"
        names[k] = str(said[k]) if all_said else by_place
    ordered = ([] if thumb is None else [thumb]) + sorted(order, key=lambda k: _rank(names[k]))
    R_HB = np.stack([out, y, along])
    for k in ordered:
        by = "named so in the file" if said[k] == names[k] else "by its place and motion"
        links = [hand.links[b].name for b in digits[k].chain.bodies]
        text = f"links {links[0]} to {links[-1]}, {by}."
        decisions.append(Decision("decided", f"finger {names[k]}", text))
    return Anatomy(tuple(digits[k] for k in ordered), tuple(names[k] for k in ordered), R_HB, found)


def _rank(name: str) -> int:
    return FINGER_NAMES.index(name) if name in FINGER_NAMES else len(FINGER_NAMES) + int(name.rsplit("_", 1)[1])


def _names_along(tree: Tree, digit: Digit) -> list[str]:
    names = []
    for body in digit.chain.bodies:
        names.append(tree.skeleton.joints[body - 1].name)
        names.extend(member.link.name for member in tree.members[body])
    return names


def _thumb(digits: list[Digit], said: list[str | None], decisions: Decisions) -> int | None:
    """Index of the thumb; None for a hand of one finger."""
    if len(digits) == 1:
        return None
    by_name = said.index("thumb") if "thumb" in said else None
    if len(digits) == 2:
        return 1 if by_name is None else by_name
    costs = [_unlikeness([d for k, d in enumerate(digits) if k != t]) for t in range(len(digits))]
    by_motion = int(np.argmin(costs))
    if by_name is None:
        alike = [k for k, cost in enumerate(costs) if cost < costs[by_motion] + 0.02]
        if len(alike) > 1:
            text = "no finger alone differs from the others; the thumb is the one that comes first in the file."
            decisions.append(Decision("decided", "hand", text))
        return alike[0]
    if by_name != by_motion and costs[by_name] > costs[by_motion] + 0.1:
        text = "another finger looks more like a thumb than the one that the file names so; the name was followed."
        decisions.append(Decision("warning", "finger thumb", text))
    return by_name


def _unlikeness(digits: list[Digit]) -> float:
    """How much fingers differ in the axes they bend about, in their direction and in the way they close."""
    total = 0.0
    for vectors in ([d.axis for d in digits], [d.along for d in digits], [d.sweep for d in digits]):
        total += 1.0 - float(np.linalg.norm(np.mean(vectors, axis=0)))
    return total


def _finger_direction(hand: Hand, digits: list[Digit], rest: list[int], thumb: int | None) -> Array:
    along = np.mean([digits[k].along for k in rest], axis=0)
    if thumb is not None and len(digits) <= 4:
        ways = np.array([digit.p_BTip - digit.p_BRoot for digit in digits])
        R, p = (x[0] for x in link_poses(hand, hand.limits.mean(axis=0)))
        last = [digit.chain.bodies[-1] for digit in digits]
        tips = np.array([p[k] + R[k] @ digit.p_LTip for k, digit in zip(last, digits, strict=True)])
        mid = tips - p[[digit.chain.bodies[0] for digit in digits]]
        ways, mid = (v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-9) for v in (ways, mid))
        common = mid.mean(axis=0) / max(float(np.linalg.norm(mid.mean(axis=0))), 1e-9)
        sweeps = np.array([digit.sweep - common * (digit.sweep @ common) for digit in digits])
        meet = sweeps[thumb] @ sweeps[rest].mean(axis=0) < -0.5 * np.linalg.norm(sweeps, axis=1).max() ** 2
        # A claw of three may be drawn wide open.
        alike = max(v[thumb] @ v[rest].mean(axis=0) for v in ((ways, mid) if len(digits) == 3 else (ways,))) > 0.5
        # A thumb that is set sideways bends about the direction in which the fingers point, a jaw across it.
        sideways = abs(digits[thumb].axis @ common) > SIDEWAYS
        if not sideways and (len(digits) == 2 or (alike and meet)):
            # A claw: the thumb points as the fingers do and comes to meet them. Leaning outwards cancels at mid range.
            along = mid[thumb] + mid[rest].mean(axis=0)
            if np.linalg.norm(along) < 0.3:
                along = ways[rest].mean(axis=0)
        if len(digits) == 2 and not sideways:
            # Jaws whose ranges differ lean to one side at mid range; a gripper's fingers stand across their roots.
            across = digits[1].p_BRoot - digits[0].p_BRoot
            across = across / max(float(np.linalg.norm(across)), 1e-2)
            if abs(along @ across) < LEAN * np.linalg.norm(along):
                along = along - across * (along @ across)
    return along / max(float(np.linalg.norm(along)), 1e-9)


def _lateral(digits: list[Digit], rest: list[int], along: Array) -> Array | None:
    """Unit direction across the palm, through the roots of the fingers; None where they do not span one."""
    if len(rest) < 2:
        return None
    roots = np.array([digits[k].p_BRoot for k in rest])
    spread = roots - roots.mean(axis=0)
    spread = spread - np.outer(spread @ along, along)
    _, size, axes = np.linalg.svd(spread)
    return axes[0] if size[0] > 5e-3 else None


def _palm_normal(
    digits: list[Digit], rest: list[int], thumb: int | None, along: Array, across: Array | None, decisions: Decisions
) -> Array:
    """Out of the palm: across the finger direction, to the side to which the fingers close."""
    sweep = np.sum([digits[k].sweep - along * (digits[k].sweep @ along) for k in rest], axis=0)
    if np.linalg.norm(sweep) < 1e-3:
        others = np.mean([digits[k].p_BTip for k in rest], axis=0)
        sweep = (digits[thumb].p_BTip if thumb is not None else np.ones(3)) - others
        sweep = sweep - along * (sweep @ along)
    sweep = sweep / max(float(np.linalg.norm(sweep)), 1e-9)
    if across is None:
        return sweep
    normal = np.cross(along, across)
    normal = normal / np.linalg.norm(normal) * np.sign(normal @ sweep or 1.0)
    if normal @ sweep < np.cos(np.deg2rad(40.0)):
        angle = np.degrees(np.arccos(np.clip(normal @ sweep, -1.0, 1.0)))
        text = f"the fingers close {angle:.0f} degrees away from the normal of their roots; out of the palm is where "
        decisions.append(Decision("warning", "hand", text + "they close to."))
        return sweep
    return normal


def _thumb_side(digits: list[Digit], rest: list[int], thumb: int | None, y: Array) -> float:
    """Sign of the side of the palm along y where the thumb is; 0 where it is in the middle."""
    if thumb is None or len(rest) < 2:
        return 0.0
    roots = np.array([digits[k].p_BRoot @ y for k in rest])
    half = max(0.5 * float(np.ptp(roots)), 5e-3)
    middle = 0.5 * float(roots.min() + roots.max())
    root = (digits[thumb].p_BRoot @ y - middle) / half
    tip = (digits[thumb].p_BTip @ y - middle) / half
    lean = root + 0.5 * tip
    return 0.0 if abs(lean) < 0.3 else float(np.sign(lean))
