"""The palm: the link that the fingers branch from. What carries it, an arm or a forearm, is left out."""

from dataclasses import dataclass

import numpy as np

from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Array, Hand
from xdex_drake.hand.importing.bodies import Tree, build_tree, link_poses
from xdex_drake.hand.importing.decisions import Decision, Decisions, join
from xdex_drake.hand.importing.model import FileModel

MOST_JOINTS = 8
"""A finger has at most this many joints."""

MOST_REACH = 0.5
"""No joint of a finger is farther from the palm's frame than this [m]; those of an arm are."""

FOLLOW = 3e-3
"""A bar whose end stays this near to a point of a finger that shares its motor is part of that finger's gear [m]."""


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


def find_hand(model: FileModel, palm: str | None, decisions: Decisions) -> Tree:
    """Cuts the hand out of a robot.

    Args:
        model: A checked robot.
        palm: Name of the palm's link where a person says so.
        decisions: Grows by what was decided.

    Returns:
        The tree from the palm on.

    Raises:
        HandFileError: There is no such link, or the robot has several hands.
    """
    if palm is not None:
        if palm not in {link.name for link in model.links}:
            known = join([link.name for link in model.links], 8)
            raise HandFileError(f"{model.source}: palm {palm!r} is no link of the file; name one of {known}")
        return build_tree(model, palm, decisions)
    whole = build_tree(model, None, [])
    body = _palm_body(whole, model)
    name = whole.members[body][0].link.name
    tree = build_tree(model, name if body else None, decisions)
    if body:
        above, k = [], body
        while k:
            above.append(whole.skeleton.joints[k - 1].name)
            k = int(whole.skeleton.parents[k])
        behind = [member.link.name for b in _ancestors(whole.skeleton, body)[::-1] for member in whole.members[b]]
        text = f"is the palm, from which the fingers branch; left out are {join(behind)} behind it and "
        text += f"{'joint' if len(above) == 1 else 'joints'} {join(above[::-1])}."
        decisions.append(Decision("decided", f"link {name}", text))
    return tree


def find_chains(tree: Tree, decisions: Decisions) -> list[Chain]:
    """The chains of links from the palm to the tips, in the order of the file.

    Args:
        tree: The hand.
        decisions: Grows by what was decided.

    Returns:
        One chain for each finger.
    """
    hand = tree.skeleton
    children: list[list[int]] = [[] for _ in hand.links]
    for k in range(1, len(hand.links)):
        children[hand.parents[k]].append(k)
    chains = []
    for tip in _leaves(hand):
        path = [tip]
        while hand.parents[path[-1]] > 0:
            path.append(int(hand.parents[path[-1]]))
        path = path[::-1]
        branch = max((n + 1 for n, k in enumerate(path[:-1]) if len(children[k]) > 1), default=0)
        chains.append(Chain(tuple(path[branch:]), tuple(path[:branch])))
    kept = [
        chain
        for k, chain in enumerate(chains)
        if not _is_idle(tree, chain) and not _is_gear(hand, chain, chains[:k] + chains[k + 1 :])
    ]
    if 0 < len(kept) < len(chains):
        bars = [hand.links[chain.bodies[-1]].name for chain in chains if chain not in kept]
        text = "not taken as a finger: a bar of a finger's gear, which ends on it or which nothing else moves."
        decisions.append(Decision("decided", f"link {join(bars)}", text))
        return kept
    return chains


def _is_idle(tree: Tree, chain: Chain) -> bool:
    """Whether the file says of each joint of a chain that nothing drives it."""
    joints = tree.skeleton.joints
    return all(tree.driven[k - 1] is False and joints[k - 1].coupling is None for k in chain.path)


def _leaves(hand: Hand) -> list[int]:
    parents = set(hand.parents.tolist())
    return [k for k in range(1, len(hand.links)) if k not in parents]


def _ancestors(hand: Hand, body: int) -> list[int]:
    out, k = [], int(hand.parents[body])
    while k >= 0:
        out.append(k)
        k = int(hand.parents[k])
    return out


def _palm_body(tree: Tree, model: FileModel) -> int:
    """The deepest body that carries the most finger-like chains and no other."""
    hand = tree.skeleton
    leaves = _leaves(hand)
    _, p = link_poses(hand, np.clip(0.0, *hand.limits)[None])
    p_BLs = p[0]
    above = {leaf: _ancestors(hand, leaf) for leaf in leaves}
    if len(leaves) == 1:
        if len(above[leaves[0]]) <= 4:
            return 0
        link = tree.members[int(hand.parents[leaves[0]])][0].link.name
        raise HandFileError(
            f"{model.source}: the robot is a chain of {len(above[leaves[0]])} joints without a branch, as an arm "
            f"without a hand; give a hand, or, for a gripper with one moving jaw, its base, as by palm={link!r}"
        )
    counts: dict[int, int] = {}
    for body in range(len(hand.links)):
        below = [leaf for leaf in leaves if body in above[leaf]]
        joints = [above[leaf].index(body) + 1 for leaf in below]
        reach = [float(np.linalg.norm(p_BLs[leaf] - p_BLs[body])) for leaf in below]
        if below and max(joints) <= MOST_JOINTS and max(reach) <= MOST_REACH:
            counts[body] = len(below)
    most = max(counts.values(), default=0)
    if most < 2:
        return 0
    candidates = [body for body, count in counts.items() if count == most]
    deepest = [b for b in candidates if not any(b in _ancestors(hand, c) for c in candidates)]
    if len(deepest) > 1:
        names = [tree.members[b][0].link.name for b in deepest]
        raise HandFileError(
            f"{model.source}: the robot has several hands, at links {', '.join(names)}; say which by palm={names[0]!r}"
        )
    return deepest[0]


def _is_gear(hand: Hand, chain: Chain, others: list[Chain]) -> bool:
    """Whether a chain is a bar of a parallelogram that another chain, moved by the same motor, also belongs to.

    Its end then stays on a link of the other: there is a point that is fixed in both. Fingers side by side also move
    together, but about one axis.
    """
    C = hand.coupling_matrix != 0.0
    motors = {int(k) for body in chain.bodies for k in np.flatnonzero(C[body - 1])}
    if len(motors) != 1:
        return False
    lower, upper = hand.limits
    q = lower + np.linspace(0.0, 1.0, 7)[:, None] * (upper - lower)
    R, p = link_poses(hand, q)
    for other in others:
        if len(other.bodies) <= len(chain.bodies):
            continue
        if motors != {int(k) for body in other.bodies for k in np.flatnonzero(C[body - 1])}:
            continue
        axis = R[0, chain.bodies[0]] @ hand.joints[chain.bodies[0] - 1].axis
        apart = p[0, chain.bodies[0]] - p[0, other.bodies[0]]
        across = apart - axis * (apart @ axis)
        if 3e-3 < float(np.linalg.norm(across)) < 0.05 and _stay_joined(R, p, chain.bodies[-1], other.bodies[-1]):
            return True
    return False


def _stay_joined(R: Array, p: Array, a: int, b: int) -> bool:
    """Whether some point is fixed in both of two links over all postures."""
    rows = np.concatenate([R[:, a], -R[:, b]], axis=2).reshape(-1, 6)  # R_a c_a + p_a = R_b c_b + p_b
    gap = (p[:, b] - p[:, a]).ravel()
    solution = np.linalg.lstsq(rows, gap, rcond=1e-6)[0]
    near = bool(np.linalg.norm(solution[:3]) < 0.15)
    return near and float(np.abs(rows @ solution - gap).max()) < FOLLOW
