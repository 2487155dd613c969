"""The palm: the link that the fingers branch from. What carries it, an arm or a forearm, is left out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.importing.bodies import Tree, build_tree, link_poses
from xdex_drake.hand.importing.decisions import Decision, Decisions, join
from xdex_drake.hand.importing.finger_names import FINGER_WORDS, LIMB_WORDS, name_words, side_from_names
from xdex_drake.hand.importing.limbs import (
    HEAVY,
    MOST_JOINTS,
    MOST_LENGTH,
    MOST_REACH,
    bars,
    held_in_place,
    joined_at,
    joints_without_shape,
    limb_size,
)
from xdex_drake.hand.importing.model import FileModel
from xdex_drake.hand.importing.shape import surface_points

BESIDE = 0.05
"""A bar of a gear has its joint at most this far from that of its finger [m]."""

APART = 0.2
"""Groups of fingers whose roots are farther from each other than this are two hands [m]."""


@dataclass(frozen=True)
class Chain:
    """The links from the palm to a tip.

    Attributes:
        bodies: Indices of the finger's own links, from root to tip.
        shared: Indices of links between the palm and the finger's root that other fingers share.
    """

    bodies: tuple[int, ...]
    shared: tuple[int, ...]

    @property
    def path(self) -> tuple[int, ...]:
        """All links from the palm, exclusive, to the tip."""
        return self.shared + self.bodies


@dataclass(frozen=True)
class Robot:
    """A robot's tree and the hands in it.

    Attributes:
        model: The robot, what turns in its place held.
        without: Joints that move nothing that has a shape.
        held: Links that turn in their place.
        palms: Names of the links that the fingers of each hand grow from.
        apart: Names of links that carry several hands.
        why: What else moves, for a message where there is no hand.
    """

    model: FileModel
    without: frozenset[str]
    held: tuple[str, ...]
    palms: tuple[str, ...]
    apart: frozenset[str]
    why: str


def find_hand(
    model: FileModel,
    side: str | None,
    palm: str | None,
    side_of: Callable[[Tree], str | None],
    decisions: Decisions,
) -> Tree:
    """Cuts the hand out of a robot.

    Args:
        model: A checked robot.
        side: "right" or "left", which of two hands is meant.
        palm: Name of the palm's link where a person says so.
        side_of: Tells the side of a hand by its shape, for hands whose names do not.
        decisions: Grows by what was decided.

    Returns:
        The tree from the palm on.

    Raises:
        HandFileError: There is no such link, no hand, or several of them.
    """
    if palm is not None and palm not in {link.name for link in model.links}:
        known = join([link.name for link in model.links], 8)
        raise HandFileError(f"{model.source}: palm {palm!r} is no link of the file; name one of {known}")
    robot = find_hands(model)
    if palm is None:
        palm = _choose(robot, side, side_of)
    tree = _cut(robot, palm, decisions)
    inside = {member.link.name for body in tree.members for member in body}
    _say_behind(robot.model, tree, decisions)
    _say_no_fingers(robot, inside, decisions)
    return tree


def find_hands(model: FileModel) -> Robot:
    """The hands of a robot: for each the deepest link that carries all of its fingers.

    Args:
        model: A checked robot.

    Returns:
        What was found.
    """
    without = joints_without_shape(model)
    if len(without) == sum(joint.kind != "fixed" for joint in model.joints):
        without = frozenset()
    model, held = held_in_place(model, build_tree(model, None, [], without=without))
    if all(joint.kind == "fixed" for joint in model.joints):
        return Robot(model, without, tuple(held), (), frozenset(), "all that moves turns in its place")
    tree = build_tree(model, None, [], without=without)
    ends = _ends_of_links(model, tree)
    top = next(link.name for link in model.links if link.name not in {joint.child for joint in model.joints})
    apart: set[str] = set()
    palms = _palms(model, tree, ends, top, apart)
    most = max((len(ends[name]) for name in palms), default=0)
    palms = [name for name in palms if 2 * len(ends[name]) >= most]
    return Robot(model, without, tuple(held), tuple(palms), frozenset(apart), _why(tree))


def _choose(robot: Robot, side: str | None, side_of: Callable[[Tree], str | None]) -> str:
    """The palm that is meant."""
    source, palms = robot.model.source, list(robot.palms)
    if not palms:
        raise HandFileError(f"{source}: there is no hand in it: {robot.why}; give a hand of two fingers or more")
    if len(palms) > 1 and side is not None:
        by_names = [name for name in palms if _side_below(robot.model, name) == side]
        palms = by_names or [name for name in palms if side_of(_cut(robot, name, [])) == side] or palms
    if len(palms) > 1:
        raise HandFileError(
            f"{source}: the robot has several hands, at {join(palms)}; choose one by --side right or --palm {palms[0]} "
            "(side= or palm= in Python)"
        )
    return palms[0]


def _cut(robot: Robot, palm: str, decisions: Decisions) -> Tree:
    return build_tree(robot.model, palm, decisions, without=robot.without, apart=robot.apart)


def _below(model: FileModel, top: str) -> list[str]:
    """Names of a link and of all that it carries."""
    children: dict[str, list[str]] = {}
    for joint in model.joints:
        children.setdefault(joint.parent, []).append(joint.child)
    names, todo = [], [top]
    while todo:
        names.append(todo.pop())
        todo += children.get(names[-1], [])
    return names


def _side_below(model: FileModel, top: str) -> str | None:
    """The side that a link's own name says, else those of what it carries, else of what carries it."""
    inbound = {joint.child: joint.parent for joint in model.joints}
    inside = set(_below(model, top))
    carriers, name = [], top
    while name in inbound:
        name = inbound[name]
        carriers.append(name)
    by_carriers = next((side for link in carriers if (side := side_from_names([link]))), None)
    return side_from_names([top]) or _side_of_names(model, inside) or by_carriers


def _side_of_names(model: FileModel, inside: set[str]) -> str | None:
    return side_from_names([*inside, *(joint.name for joint in model.joints if joint.child in inside)])


def _ends_of_links(model: FileModel, tree: Tree) -> dict[str, list[int]]:
    """For each link of the file the last bodies of the chains that it carries."""
    hand = tree.skeleton
    left_out = bars(tree)
    parents = {int(hand.parents[k]) for k in range(1, len(hand.links)) if k not in left_out}
    inbound = {joint.child: joint.parent for joint in model.joints}
    ends: dict[str, list[int]] = {link.name: [] for link in model.links}
    for leaf in range(1, len(hand.links)):
        if leaf in parents or leaf in left_out:
            continue
        name: str | None = inbound[tree.members[leaf][0].link.name]
        while name is not None:
            ends[name].append(leaf)
            name = inbound.get(name)
    return ends


def _palms(model: FileModel, tree: Tree, ends: dict[str, list[int]], top: str, apart: set[str]) -> list[str]:
    """Palms at or below a link; `apart` grows by links that carry several hands."""
    groups = [top]
    while len(groups) == 1 and len(ends[groups[0]]) == len(ends[top]):
        top = groups[0]
        groups = [joint.child for joint in model.joints if joint.parent == top and len(ends[joint.child]) >= 2]
    R, p = link_poses(tree.skeleton, np.clip(0.0, *tree.skeleton.limits)[None])
    place = next(((k, m.X_LF[:3, 3]) for k, body in enumerate(tree.members) for m in body if m.link.name == top), None)
    fits = place is not None and len(ends[top]) > 0 and not _says_limbs(tree, ends[top], place[0])
    if place is not None and fits:
        body, p_LTop = place
        p_BTop = p[0, body] + R[0, body] @ p_LTop
        fits = all(_is_finger(tree, leaf, body, p[0], p_BTop) for leaf in ends[top])
    if fits and not _are_hands(model, tree, ends, top, groups, p[0]):
        return [top] if len(ends[top]) >= 2 else []
    apart.add(top)
    return [name for group in groups for name in _palms(model, tree, ends, group, apart)]


def _is_finger(tree: Tree, leaf: int, base: int, p_BLs: Array, p_BTop: Array) -> bool:
    count, reach, length, mass = limb_size(tree, leaf, base, p_BLs, p_BTop)
    heavy = mass > HEAVY[0] and length > HEAVY[1]
    return count <= MOST_JOINTS and reach <= MOST_REACH and length <= MOST_LENGTH and not heavy


def _says_limbs(tree: Tree, leaves: list[int], base: int) -> bool:
    """Whether the names along two chains or more speak of arms, legs or a head, and none speaks of a finger."""
    hand = tree.skeleton
    limbs = 0
    for leaf in leaves:
        words: set[str] = set()
        while leaf != base:
            words |= name_words(hand.joints[leaf - 1].name) | name_words(hand.links[leaf].name)
            leaf = int(hand.parents[leaf])
        if words & FINGER_WORDS:
            return False
        limbs += bool(words & LIMB_WORDS)
    return limbs >= 2


def _are_hands(
    model: FileModel, tree: Tree, ends: dict[str, list[int]], top: str, groups: list[str], p_BLs: Array
) -> bool:
    """Whether groups of fingers that one link carries are hands of their own, not halves of one palm."""
    if len(groups) < 2:
        return False
    sides = [_side_below(model, name) for name in groups]
    if "left" in sides and "right" in sides:
        return True
    if sum(len(ends[name]) >= 3 for name in groups) >= 2:
        return True
    if sum(len(ends[name]) for name in groups) < len(ends[top]):
        return False
    roots = np.array([np.mean([_root(tree, leaf, p_BLs) for leaf in ends[name]], axis=0) for name in groups])
    return float(np.linalg.norm(roots[1:] - roots[0], axis=1).min()) > APART


def _root(tree: Tree, leaf: int, p_BLs: Array) -> Array:
    """Origin of the last joint of a chain but one, where there are two."""
    parent = int(tree.skeleton.parents[leaf])
    return p_BLs[parent if parent > 0 else leaf]


def _why(tree: Tree) -> str:
    """Why the chains of a robot are not the fingers of a hand."""
    hand = tree.skeleton
    leaves = _leaves(hand, bars(tree))
    p = link_poses(hand, np.clip(0.0, *hand.limits)[None])[1][0]
    branches = np.bincount(hand.parents[1:], minlength=len(hand.links))
    told = []
    for leaf in leaves:
        base = int(hand.parents[leaf])
        while base > 0 and branches[base] == 1:
            base = int(hand.parents[base])
        count, _, length, mass = limb_size(tree, leaf, base, p, p[base])
        name = tree.members[leaf][0].link.name
        told.append(f"{name} ends a chain of {count} joints, {length:.2g} m and {mass:.2g} kg")
    if len(leaves) == 1 and limb_size(tree, leaves[0], 0, p, p[0])[0] > 2:
        return f"it is a chain without a branch ({told[0]}), as an arm without a hand"
    if len(leaves) == 1:
        return f"one finger or jaw alone moves ({told[0]}), and nothing would oppose it"
    return join(told, 3) if told else "nothing in it moves a shape"


def _say_behind(model: FileModel, tree: Tree, decisions: Decisions) -> None:
    """Says what carries the palm and is left out."""
    inbound = {joint.child: joint for joint in model.joints}
    above, behind, name = [], [], tree.members[0][0].link.name
    while name in inbound:
        if inbound[name].kind != "fixed":
            above.append(inbound[name].name)
        name = inbound[name].parent
        behind.append(name)
    if behind:
        text = f"is the palm, from which the fingers branch; left out are {join(behind[::-1])} behind it"
        if above:
            text += f" and {'joint' if len(above) == 1 else 'joints'} {join(above[::-1])}"
        decisions.append(Decision("decided", f"link {tree.members[0][0].link.name}", text + "."))


def _say_no_fingers(robot: Robot, inside: set[str], decisions: Decisions) -> None:
    idle = [joint.child for joint in robot.model.joints if joint.name in robot.without and joint.parent in inside]
    if idle:
        text = "no finger: its joint moves nothing that has a shape, as that of a motor or an encoder; left out."
        decisions.append(Decision("decided", f"link {join(idle)}", text))
    still = [name for name in robot.held if name in inside]
    if still:
        text = "no finger: it turns in its place, as a knob or a wheel; taken as rigidly attached."
        decisions.append(Decision("decided", f"link {join(still)}", text))


def find_chains(tree: Tree, model: FileModel, decisions: Decisions) -> list[Chain]:
    """The chains of links from the palm to the tips, in the order of the file.

    Args:
        tree: The hand.
        model: The robot, for the points at which its loops are closed.
        decisions: Grows by what was decided.

    Returns:
        One chain for each finger.
    """
    hand = tree.skeleton
    folded = bars(tree)
    children: list[list[int]] = [[] for _ in hand.links]
    for k in range(1, len(hand.links)):
        if k not in folded:
            children[hand.parents[k]].append(k)
    chains = []
    for tip in _leaves(hand, folded):
        path = [tip]
        while hand.parents[path[-1]] > 0:
            path.append(int(hand.parents[path[-1]]))
        path = path[::-1]
        branch = max((n + 1 for n, k in enumerate(path[:-1]) if len(children[k]) > 1), default=0)
        chains.append(Chain(tuple(path[branch:]), tuple(path[:branch])))
    tied = _tied_by_loops(tree, model, chains)
    free = [chain for k, chain in enumerate(chains) if k not in tied and not _is_idle(tree, chain)]
    kept = [chain for chain in free if not _is_gear(hand, chain, [other for other in free if other is not chain])]
    kept = kept or chains
    names = [hand.links[chain.bodies[-1]].name for chain in chains if chain not in kept]
    names += [hand.links[k].name for k in sorted(folded)]
    if names:
        text = "not taken as a finger: a bar of a finger's gear, which ends on it or which nothing else moves."
        decisions.append(Decision("decided", f"link {join(names)}", text))
    return kept


def _tied_by_loops(tree: Tree, model: FileModel, chains: list[Chain]) -> set[int]:
    """Chains that a loop closes onto another one that reaches farther from the palm: bars of a linkage."""
    hand = tree.skeleton
    body_of = {member.link.name: k for k, body in enumerate(tree.members) for member in body}
    p = link_poses(hand, np.clip(0.0, *hand.limits)[None])
    reach = {}
    for n, chain in enumerate(chains):
        points = surface_points(tree.members[chain.bodies[-1]])
        points = np.zeros((1, 3)) if len(points) == 0 else points
        ends = points @ p[0][0, chain.bodies[-1]].T + p[1][0, chain.bodies[-1]]
        reach[n] = float(np.linalg.norm(ends, axis=1).max())
    tied = set()
    for loop in model.loops:
        a, b = (body_of.get(name, -1) for name in loop.links)
        of_a = [n for n, chain in enumerate(chains) if a in chain.path]
        of_b = [n for n, chain in enumerate(chains) if b in chain.path]
        if len(of_a) == 1 and len(of_b) == 1 and of_a != of_b:
            tied.add(min((of_a[0], of_b[0]), key=lambda n: reach[n]))
    return tied


def _is_idle(tree: Tree, chain: Chain) -> bool:
    """Whether the file says of each joint of a chain that nothing drives it."""
    joints = tree.skeleton.joints
    return all(tree.driven[k - 1] is False and joints[k - 1].coupling is None for k in chain.path)


def _leaves(hand: Hand, left_out: set[int]) -> list[int]:
    parents = {int(hand.parents[k]) for k in range(1, len(hand.links)) if k not in left_out}
    return [k for k in range(1, len(hand.links)) if k not in parents and k not in left_out]


def _is_gear(hand: Hand, chain: Chain, others: list[Chain]) -> bool:
    """Whether a chain is a bar of a parallelogram that another chain, moved by the same motor, also belongs to.

    It has fewer links than the other, grows beside it, and does not turn against it; or its end stays on a link of the
    other: there is a point that is fixed in both. Fingers side by side also move together, but about one axis.
    """
    C = hand.coupling_matrix
    motors = {int(k) for body in chain.bodies for k in np.flatnonzero(C[body - 1])}
    if len(motors) != 1:
        return False
    lower, upper = hand.limits
    q = lower + np.linspace(0.0, 1.0, 7)[:, None] * (upper - lower)
    R, p = link_poses(hand, q)
    root = chain.bodies[0]
    axis = R[0, root] @ hand.joints[root - 1].axis
    for other in others:
        if len(other.bodies) <= len(chain.bodies):
            continue
        if motors != {int(k) for body in other.bodies for k in np.flatnonzero(C[body - 1])}:
            continue
        apart = p[0, root] - p[0, other.bodies[0]]
        across = apart - axis * (apart @ axis)
        if not 3e-3 < float(np.linalg.norm(across)) < BESIDE:
            continue
        (motor,) = motors
        along = axis @ R[0, other.bodies[0]] @ hand.joints[other.bodies[0] - 1].axis
        gain, of_other = along * C[root - 1, motor], C[other.bodies[0] - 1, motor]
        same = abs(along) > 0.95 and gain * of_other > -0.5 * of_other**2
        if same and abs(float(apart @ axis)) < BESIDE:
            return True
        pin = joined_at(R, p, chain.bodies[-1], other.bodies[-1])
        if pin is not None and np.linalg.norm(pin) < 3.0 * BESIDE:
            return True
    return False
