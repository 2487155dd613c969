"""Closed loops, as of four-bar linkages, as affine laws: the joints of a loop that one motor drives follow it.

A loop is a point of one link that coincides with a point of another. With one motor in a loop of one degree of freedom
all other joints are functions of the motor's; each is taken as the straight line that fits it best over the range in
which the loop can be closed.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.importing.bodies import Tree, build_tree, link_poses
from xdex_drake.hand.importing.decisions import Decision, Decisions, join
from xdex_drake.hand.importing.model import FileMimic, FileModel

CLOSED = 5e-4
"""A loop counts as closed where its points are nearer to each other than this [m]."""

STEPS = 40
"""Number of steps in which a motor's range is gone through."""

Ends = list[tuple[int, Array, int, Array]]
"""For each loop a body and a point in its frame, and another body and point."""


def close_loops(model: FileModel, decisions: Decisions) -> FileModel:
    """Gives the joints of each closed loop a law, where one joint drives it.

    Args:
        model: A checked robot.
        decisions: Grows by what was decided.

    Returns:
        The robot, its loops' joints coupled.
    """
    if not model.loops:
        return model
    tree = build_tree(model, None, [])
    for joints, ends in _groups(tree, model):
        names = join([tree.skeleton.joint_names[k] for k in joints])
        found = _solve(tree, joints, ends)
        if isinstance(found, str):
            text = f"are part of a closed loop that {found}; it is left open. Give the joints that it ties a coupling."
            decisions.append(Decision("warning", f"joint {names}", text))
            continue
        model = _coupled(model, tree, joints, *found, decisions)
    return model


def _groups(tree: Tree, model: FileModel) -> list[tuple[list[int], Ends]]:
    """Loops that share joints, with the indices of their actuated joints."""
    hand = tree.skeleton
    place = {m.link.name: (k, m.X_LF) for k, body in enumerate(tree.members) for m in body}
    C = hand.coupling_matrix != 0.0
    groups: list[tuple[set[int], Ends]] = []
    for loop in model.loops:
        if not set(loop.links) <= set(place):
            continue
        (a, X_A), (b, X_B) = (place[name] for name in loop.links)
        rows = np.flatnonzero(hand.ancestors[:, a] != hand.ancestors[:, b])
        joints = {int(k) for k in np.flatnonzero(C[rows].any(axis=0))}
        if not joints:
            continue
        p_A, p_B = (X[:3, :3] @ p + X[:3, 3] for X, p in zip((X_A, X_B), loop.points, strict=True))
        ends: Ends = [(a, p_A, b, p_B)]
        for other in [group for group in groups if group[0] & joints]:
            groups.remove(other)
            joints, ends = joints | other[0], [*other[1], *ends]
        groups.append((joints, ends))
    return [(sorted(joints), ends) for joints, ends in groups]


def _gaps(hand: Hand, qs: Array, ends: Ends) -> Array:
    """How far the points of each loop are from each other [m], shape (N, 3 * number of loops)."""
    R, p = link_poses(hand, qs)
    return np.concatenate([p[:, a] + R[:, a] @ p_A - p[:, b] - R[:, b] @ p_B for a, p_A, b, p_B in ends], axis=1)


def _jacobian(hand: Hand, q: Array, joints: list[int], ends: Ends) -> Array:
    """Derivative of the gaps by some joints, shape (3 * number of loops, len(joints))."""
    step = 1e-6
    qs = np.repeat(q[None], 2 * len(joints), axis=0)
    for n, k in enumerate(joints):
        qs[2 * n, k] += step
        qs[2 * n + 1, k] -= step
    gaps = _gaps(hand, qs, ends)
    return (gaps[::2] - gaps[1::2]).T / (2.0 * step)


def _closed(hand: Hand, q: Array, joints: list[int], ends: Ends) -> Array | None:
    """A posture near `q`, changed in some joints alone, at which the loops are closed; None where there is none."""

    def at(x: Array) -> Array:
        out = q.copy()
        out[joints] = x
        return out

    solution = least_squares(
        lambda x: _gaps(hand, at(x)[None], ends)[0],
        q[joints],
        jac=lambda x: _jacobian(hand, at(x), joints, ends),  # pyright: ignore[reportArgumentType]
        method="lm" if 3 * len(ends) >= len(joints) else "trf",
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
    )
    q = at(solution.x)
    return q if np.abs(_gaps(hand, q[None], ends)).max() < CLOSED else None


def _solve(tree: Tree, joints: list[int], ends: Ends) -> tuple[int, Array, list[int]] | str:
    """Postures along a loop's motion, or why it is not one motor's.

    Returns:
        Index of the motor's joint, postures over its range, shape (n, n_actuated), and the joints that stay where they
        are: of a loop of two degrees of freedom the ones that rest at a limit, as springs keep them there.
    """
    hand = tree.skeleton
    names = [joint.name for joint in hand.joints]
    driven = [k for k in joints if tree.driven[names.index(hand.joint_names[k])] is True]
    if len(driven) > 1:
        return f"{len(driven)} motors drive"
    lower, upper = hand.limits
    q = _closed(hand, np.clip(0.0, lower, upper), joints, ends)
    if q is None:
        return "cannot be closed near the zero posture"
    motor = driven[0] if driven else joints[0]
    others = [k for k in joints if k != motor]
    free = len(joints) - int(np.linalg.matrix_rank(_jacobian(hand, q, joints, ends), tol=1e-5))
    if free < 1:
        return "leaves its joints no motion"
    slack = np.minimum(np.abs(q - lower), np.abs(upper - q))
    resting = sorted((k for k in others if slack[k] < 1e-3), key=lambda k: slack[k])[: free - 1]
    if free - 1 > len(resting):
        return f"has {free} degrees of freedom"
    moving = [k for k in others if k not in resting]
    if not moving:
        return "leaves its joints no motion"
    way = _follow(hand, q, motor, moving, ends)
    if len(way) < 3:
        return "can hardly be moved"
    return motor, way, resting


def _follow(hand: Hand, start: Array, motor: int, moving: list[int], ends: Ends) -> Array:
    """Postures over the motor's range as far as the loop closes within the limits, in rising order of the motor."""
    lower, upper = hand.limits
    step = (upper[motor] - lower[motor]) / STEPS
    sides = []
    for sign in (-1.0, 1.0):
        q, before, way = start, start, []
        while True:
            ahead = 2.0 * q - before  # Each step starts from where the last one led.
            ahead[motor] = np.clip(q[motor] + sign * step, lower[motor], upper[motor])
            if abs(ahead[motor] - q[motor]) < 1e-9:
                break
            found = _closed(hand, ahead, moving, ends)
            slack = 0.05 * (upper - lower)
            if found is None or (found < lower - slack)[moving].any() or (found > upper + slack)[moving].any():
                break
            if np.abs(found - q)[moving].max() > 0.5 * max(1.0, float(np.max(upper - lower))):
                break  # It has snapped over.
            before, q = q, found
            way.append(q)
        sides.append(way)
    return np.array([*sides[0][::-1], start, *sides[1]])


def _coupled(
    model: FileModel, tree: Tree, joints: list[int], motor: int, way: Array, resting: list[int], decisions: Decisions
) -> FileModel:
    """The model with laws for the joints of one loop, and its motor's range that of the loop."""
    names = tree.skeleton.joint_names
    laws: dict[str, FileMimic] = {}
    worst = 0.0
    for k in joints:
        if k == motor:
            continue
        slope, offset = np.polyfit(way[:, motor], way[:, k], 1) if k not in resting else (0.0, way[0, k])
        worst = max(worst, float(np.abs(slope * way[:, motor] + offset - way[:, k]).max()))
        laws[names[k]] = FileMimic(names[motor], float(slope), float(offset))
    low, high = float(way[0, motor]), float(way[-1, motor])
    made = []
    for joint in model.joints:
        if joint.name in laws:
            # The loop bounds these joints by itself; their law must not narrow the motor's range further.
            joint = replace(joint, mimic=laws[joint.name], lower=-np.inf, upper=np.inf)
        elif joint.name == names[motor]:
            joint = replace(joint, lower=max(joint.lower, low), upper=min(joint.upper, high))
        made.append(joint)
    error = np.degrees(worst)
    text = f"follow joint {names[motor]} around a closed loop, as straight lines within {error:.2g} degrees of it for "
    decisions.append(Decision("decided", f"joint {join(list(laws))}", text + f"values of {low:.3g} to {high:.3g}."))
    return replace(model, joints=tuple(made))
