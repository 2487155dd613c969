"""Which chains of joints can be fingers: they move a shape, are no longer than a finger, and are no bar of a gear."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.hand.importing.bodies import Tree, homogeneous, joint_motion, link_poses
from xdex_drake.hand.importing.model import FileJoint, FileModel
from xdex_drake.hand.importing.shape import surface_points

MOST_JOINTS = 8
"""A finger has at most this many joints."""

MOST_REACH = 0.5
"""No joint of a finger is farther from the palm's frame than this [m]; those of an arm are."""

MOST_LENGTH = 0.3
"""No finger is longer [m]; arms and legs are."""

HEAVY = 1.0, 0.2
"""Nor is one heavier than this that is longer than that [kg, m]."""

STILL = 0.1
"""The middle of a part that turns in its place moves by less than this share of the part's size."""

FOLLOW = 3e-3
"""A bar whose end stays this near to a point of another link is tied to it [m]."""

PIN = 6e-3
"""A pin lies at most this far beyond the shape of the bar that it holds [m]."""

FOLDED = 0.7
"""Cosine between a bar and the way back to its finger's root, at least, in all postures."""

NO_TIP = ("motor", "rotor", "encoder", "virtual", "dummy", "tendon", "spring", "servo", "pulley", "actuator", "sensor")
"""Words in the names of what moves but is no part of a finger."""


def joints_without_shape(model: FileModel) -> frozenset[str]:
    """Joints that move nothing that has a shape and that end no finger: motors, encoders, links of virtual tendons.

    The last link of a finger may lack a shape by mistake. It is no fingertip where something else that moves and has a
    shape hangs on the same link as it does, as on a palm, or where it is called a motor or the like.

    Args:
        model: A checked robot.

    Returns:
        Names of the outermost such joints.
    """
    inbound = {joint.child: joint for joint in model.joints}
    shaped: set[str] = set()
    for link in model.links:
        name = link.name
        while link.has_shape and name not in shaped:
            shaped.add(name)
            name = inbound[name].parent if name in inbound else name
    moving = [joint for joint in model.joints if joint.kind != "fixed"]
    bodies = {joint.name: _body(joint.parent, inbound) for joint in moving}
    busy = {bodies[joint.name] for joint in moving if joint.child in shaped}
    out = set()
    for joint in moving:
        words = f"{joint.name} {joint.child}".lower()
        if joint.child not in shaped and (bodies[joint.name] in busy or any(word in words for word in NO_TIP)):
            out.add(joint.name)
    return frozenset(out)


def _body(name: str, inbound: dict[str, FileJoint]) -> str:
    """The link that stands for the rigid body that a link is part of."""
    while name in inbound and inbound[name].kind == "fixed":
        name = inbound[name].parent
    return name


def held_in_place(model: FileModel, tree: Tree) -> tuple[FileModel, list[str]]:
    """The robot with the joints of knobs and wheels held, which turn in their place and so are no fingers.

    Args:
        model: The robot.
        tree: It as a tree.

    Returns:
        The robot, and the names of the links that were held.
    """
    hand = tree.skeleton
    children = np.bincount(hand.parents[1:], minlength=len(hand.links))
    held: set[str] = set()
    names = []
    for leaf in np.flatnonzero(children == 0):
        path, k = [], int(leaf)
        while k > 0 and (not path or children[k] == 1):
            path.append(k)
            k = int(hand.parents[k])
        points = surface_points(tree.members[leaf])
        if not path or len(points) == 0 or _travel(tree, path, points) > STILL * np.linalg.norm(np.ptp(points, axis=0)):
            continue
        held |= {hand.joints[j - 1].name for j in path}
        names.append(tree.members[leaf][0].link.name)
    if not held:
        return model, []
    return replace(model, joints=tuple(_fixed(j) if j.name in held else j for j in model.joints)), names


def _fixed(joint: FileJoint) -> FileJoint:
    X = homogeneous(joint.R_PJ, joint.p_PJ) @ joint_motion(joint, float(np.clip(0.0, joint.lower, joint.upper)))
    return replace(joint, kind="fixed", p_PJ=X[:3, 3], R_PJ=X[:3, :3], mimic=None)


def _travel(tree: Tree, path: list[int], points: Array) -> float:
    """How far the middle of the first of some links is from an axis, or slides: the most over its joints [m]."""
    hand = tree.skeleton
    R, p = (x[0] for x in link_poses(hand, np.clip(0.0, *hand.limits)))
    middle = p[path[0]] + R[path[0]] @ (0.5 * (points.min(axis=0) + points.max(axis=0)))
    most = 0.0
    for k in path:
        joint = hand.joints[k - 1]
        lever = float(np.linalg.norm(np.cross(R[k] @ joint.axis, middle - p[k])))
        most = max(most, joint.upper - joint.lower if joint.kind == "prismatic" else lever)
    return most


def bars(tree: Tree) -> set[int]:
    """Bodies at the ends of chains that are bars of a gear: they hang on a finger and lead back to its root.

    A bar is moved by the gear, not by a motor of its own, and its far end is tied to a link nearer to the palm, or it
    lies folded back along its finger in all postures.

    Args:
        tree: A robot.

    Returns:
        Indices of these bodies.
    """
    hand = tree.skeleton
    out: set[int] = set()
    while True:
        parents = {int(hand.parents[k]) for k in range(1, len(hand.links)) if k not in out}
        leaves = [k for k in range(1, len(hand.links)) if k not in parents and k not in out]
        found = {leaf for leaf in leaves if _is_bar(tree, leaf)}
        if not found:
            return out
        out |= found


def _is_bar(tree: Tree, leaf: int) -> bool:
    hand = tree.skeleton
    joint = hand.joints[leaf - 1]
    parent = int(hand.parents[leaf])
    points = surface_points(tree.members[leaf])
    if parent == 0 or len(points) == 0 or (joint.coupling is None and tree.driven[leaf - 1] is not False):
        return False
    if not any(m.link.visual or m.link.collision for m in tree.members[parent]):
        return False
    path = [leaf]
    while path[-1] > 0:
        path.append(int(hand.parents[path[-1]]))
    lower, upper = hand.limits
    qs = lower + np.linspace(0.0, 1.0, 9)[:, None] * (upper - lower)
    R, p = link_poses(hand, qs)
    motors = {int(k) for body in path[:-1] for k in np.flatnonzero(hand.coupling_matrix[body - 1])}
    if len(motors) == 1 and any(_ties(joined_at(R, p, leaf, a), points) for a in path[2:]):
        return True
    ahead = R[:, leaf] @ (0.5 * (points.min(axis=0) + points.max(axis=0)))
    back = p[:, path[-2]] - p[:, leaf]
    cosine = (ahead * back).sum(axis=1)
    cosine = cosine / np.maximum(np.linalg.norm(ahead, axis=1) * np.linalg.norm(back, axis=1), 1e-9)
    return bool(np.linalg.norm(ahead, axis=1).min() > 5e-3 and cosine.min() > FOLDED)


def _ties(point: Array | None, shape: Array) -> bool:
    """Whether a point of a link lies at its shape and away from its joint, as the pin at a bar's other end does."""
    if point is None:
        return False
    low, high = shape.min(axis=0), shape.max(axis=0)
    near = bool((point > low - PIN).all() and (point < high + PIN).all())
    return near and bool(np.linalg.norm(point) > 0.3 * np.linalg.norm(high - low))


def joined_at(R: Array, p: Array, a: int, b: int) -> Array | None:
    """The point that is fixed in both of two links over all postures.

    Args:
        R: Rotations of the links, shape (N, n_links, 3, 3).
        p: Their origins [m], shape (N, n_links, 3).
        a: Index of one link.
        b: Index of the other.

    Returns:
        The point in the frame of the first link [m], shape (3,); None where there is none, up to `FOLLOW`.
    """
    rows = np.concatenate([R[:, a], -R[:, b]], axis=2).reshape(-1, 6)  # R_a c_a + p_a = R_b c_b + p_b
    gap = (p[:, b] - p[:, a]).ravel()
    solution = np.asarray(np.linalg.lstsq(rows, gap, rcond=1e-6)[0], dtype=np.float64)
    return solution[:3] if float(np.abs(rows @ solution - gap).max()) < FOLLOW else None


def limb_size(tree: Tree, leaf: int, base: int, p_BLs: Array, p_BFrom: Array) -> tuple[int, float, float, float]:
    """How large the chain from one body to a tip is.

    Args:
        tree: A robot.
        leaf: Its last body.
        base: The body that it grows from.
        p_BLs: Origins of all bodies at the zero posture [m], shape (n_links, 3).
        p_BFrom: Where the link that carries the chain has its own frame [m], shape (3,).

    Returns:
        Number of joints; distance of the last joint from that frame [m]; length along the chain from its first
        joint to the farthest point of the last body [m]; mass that the file gives its links [kg].
    """
    path = [leaf]
    while (above := int(tree.skeleton.parents[path[-1]])) != base:
        path.append(above)
    steps = [float(np.linalg.norm(p_BLs[a] - p_BLs[b])) for a, b in pairwise(path)]
    points = surface_points(tree.members[leaf])
    end = float(np.linalg.norm(points, axis=1).max()) if len(points) else 0.0
    masses = [m.link.inertia.mass for k in path for m in tree.members[k] if m.link.inertia is not None]
    mass = float(sum(m for m in masses if np.isfinite(m) and m > 0.0))
    return len(path), float(np.linalg.norm(p_BLs[leaf] - p_BFrom)), sum(steps) + end, mass
