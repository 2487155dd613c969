"""A robot file's tree without joints that do not move: rigidly attached links become one body, laws become affine."""

from dataclasses import dataclass, replace

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Coupling, Hand, Joint, Link
from xdex_drake.hand.importing.decisions import Decision, Decisions, join
from xdex_drake.hand.importing.model import FileJoint, FileLink, FileModel
from xdex_drake.hand.kinematics import rotation_about

NO_RANGE = 1e-6
"""A joint whose limits are nearer than this does not move [rad or m]."""

DEFAULT_STROKE = 0.05
"""Range of a sliding joint without limits [m]."""


@dataclass(frozen=True)
class Member:
    """A link of the file as part of a body.

    Attributes:
        link: The link.
        X_LF: Its pose in the body's frame L, homogeneous, shape (4, 4).
        leaf: Whether nothing is attached to it.
    """

    link: FileLink
    X_LF: Array
    leaf: bool


@dataclass(frozen=True)
class Tree:
    """Bodies and the joints that move them.

    Attributes:
        skeleton: The tree as a hand whose links have neither shape nor mass yet, and whose base frame is H.
        members: Links of the file that make up each body; first the one whose frame the body has.
        inbound: The joint of the file that would move the base; None where the base is the file's root.
        driven: For each joint, what the file says of its drive.
    """

    skeleton: Hand
    members: tuple[tuple[Member, ...], ...]
    inbound: FileJoint | None
    driven: tuple[bool | None, ...]


@dataclass(frozen=True)
class _Law:
    """q = multiplier q_master + offset; an actuated joint where there is no master."""

    master: str | None
    multiplier: float
    offset: float


def link_poses(hand: Hand, qs: Array) -> tuple[Array, Array]:
    """Poses of all links in B for many joint vectors.

    Args:
        hand: The hand.
        qs: Actuated joint values [rad or m], shape (N, n).

    Returns:
        R_BLs, shape (N, n_links, 3, 3), and p_BLs [m], shape (N, n_links, 3).
    """
    q_full = hand.q_full(np.atleast_2d(qs))
    R = np.empty((len(q_full), len(hand.links), 3, 3))
    p = np.empty((len(q_full), len(hand.links), 3))
    R[:, 0], p[:, 0] = np.eye(3), 0.0
    for k, joint in enumerate(hand.joints):
        parent = hand.parents[k + 1]
        R_BJ = R[:, parent] @ joint.R_PJ
        p[:, k + 1] = p[:, parent] + R[:, parent] @ joint.p_PJ
        if joint.kind == "revolute":
            x, y, z = joint.axis
            K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            s, c = np.sin(q_full[:, k])[:, None, None], np.cos(q_full[:, k])[:, None, None]
            R[:, k + 1] = R_BJ @ (np.eye(3) + s * K + (1.0 - c) * (K @ K))
        else:
            R[:, k + 1] = R_BJ
            p[:, k + 1] += (R_BJ @ joint.axis) * q_full[:, k, None]
    return R, p


def build_tree(
    model: FileModel,
    base: str | None,
    decisions: Decisions,
    *,
    without: frozenset[str] = frozenset(),
    apart: frozenset[str] = frozenset(),
) -> Tree:
    """Merges rigidly attached links and resolves mimic laws, from one link on.

    Args:
        model: A checked robot.
        base: Name of a link of the body at which the tree starts; what is behind it is left out. None for the root.
        decisions: Grows by what was decided.
        without: Names of joints that are left out with all that they carry.
        apart: Names of links that are no part of the hand, also where the base is fixed to them.

    Returns:
        The tree.

    Raises:
        HandFileError: Nothing moves beyond the base.
    """
    inbound = {joint.child: joint for joint in model.joints}
    outbound: dict[str, list[FileJoint]] = {link.name: [] for link in model.links}
    for joint in model.joints:
        if joint.name not in without:
            outbound[joint.parent].append(joint)
    links = {link.name: link for link in model.links}
    limits = {joint.name: _limits(joint, []) for joint in model.joints if joint.kind != "fixed"}
    held = _held_values(model, limits, set(), [])
    start = base if base is not None else next(link.name for link in model.links if link.name not in inbound)
    while start in inbound and inbound[start].name in held and inbound[start].parent not in apart:
        start = inbound[start].parent
    # Once more for the joints of the hand alone, to say what was decided about them.
    ours = _joints_beyond(start, outbound)
    for joint in model.joints:
        if joint.name in ours and joint.kind != "fixed":
            _limits(joint, decisions)
    _held_values(model, limits, ours, decisions)

    bodies: list[tuple[Member, ...]] = []
    joints: list[tuple[FileJoint, int, Array]] = []  # Joint, index of its parent body, X_PJ.
    todo: list[tuple[str, int, FileJoint | None, Array]] = [(start, -1, None, np.eye(4))]
    while todo:
        top, parent, joint, X_PJ = todo.pop()
        if joint is not None:
            joints.append((joint, parent, X_PJ))
        members: list[Member] = []
        beyond: list[tuple[str, int, FileJoint | None, Array]] = []
        inside = [(top, np.eye(4))]
        while inside:
            name, X_LF = inside.pop(0)
            members.append(Member(links[name], X_LF, not outbound[name]))
            for out in outbound[name]:
                X_LJ = X_LF @ homogeneous(out.R_PJ, out.p_PJ)
                if out.name in held:
                    inside.append((out.child, X_LJ @ joint_motion(out, held[out.name])))
                else:
                    beyond.append((out.child, len(bodies), out, X_LJ))
        bodies.append(tuple(members))
        todo.extend(reversed(beyond))
    if not joints:
        raise HandFileError(
            f"{model.source}: no joint moves beyond link {start!r}; name the link that the fingers grow from"
        )
    skeleton = _skeleton(model, bodies, joints, limits, decisions)
    return Tree(skeleton, tuple(bodies), inbound.get(start), tuple(joint.driven for joint, _, _ in joints))


def homogeneous(R: Array, p: Array) -> Array:
    """A pose as a matrix.

    Args:
        R: Rotation, shape (3, 3).
        p: Origin [m], shape (3,).

    Returns:
        The matrix, shape (4, 4).
    """
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, p
    return X


def _skeleton(
    model: FileModel,
    bodies: list[tuple[Member, ...]],
    joints: list[tuple[FileJoint, int, Array]],
    limits: dict[str, tuple[float, float]],
    decisions: Decisions,
) -> Hand:
    laws = _laws(model, [joint for joint, _, _ in joints], decisions)
    names = [_body_name(body, model, decisions) for body in bodies]
    made = []
    for k, (joint, parent, X_PJ) in enumerate(joints):
        law = laws[joint.name]
        made.append(
            Joint(
                name=joint.name,
                kind="prismatic" if joint.kind == "prismatic" else "revolute",
                parent=names[parent],
                child=names[k + 1],
                p_PJ=X_PJ[:3, 3].copy(),
                R_PJ=X_PJ[:3, :3].copy(),
                axis=np.asarray(joint.axis, dtype=float) / np.linalg.norm(joint.axis),
                lower=limits[joint.name][0],
                upper=limits[joint.name][1],
                effort=np.nan if joint.effort is None else float(joint.effort),
                coupling=None if law.master is None else Coupling(law.master, law.multiplier, law.offset),
            )
        )
    return Hand(
        name=model.name,
        display_name=model.name,
        side="right",
        links=tuple(Link(name, (), 1.0, np.zeros(3), np.eye(3), np.zeros((0, 4))) for name in names),
        joints=_consistent_limits(tuple(made), decisions),
        fingers=(),
        p_HB=np.zeros(3),
        R_HB=np.eye(3),
        q_rest=np.zeros(0),
        sources={},
    )


def _limits(joint: FileJoint, decisions: Decisions) -> tuple[float, float]:
    """A joint's limits in order and finite; those of a coupled joint without limits stay infinite."""
    lower, upper = float(joint.lower), float(joint.upper)
    subject = f"joint {joint.name}"
    if joint.kind == "continuous":
        if joint.mimic is not None:
            return -np.inf, np.inf
        decisions.append(Decision("decided", subject, "turns without end in the file; it gets limits of -pi and pi."))
        return -np.pi, np.pi
    if lower > upper:
        text = f"its limits {lower:g} and {upper:g} are the wrong way round; they were swapped."
        decisions.append(Decision("mended", subject, text))
        lower, upper = upper, lower
    if joint.mimic is not None:
        return lower, upper
    if joint.kind == "revolute" and max(-lower, upper) > 2.0 * np.pi + 1e-3:
        low, high = max(lower, -np.pi), min(upper, np.pi)
        text = f"its limits {lower:g} and {upper:g} are beyond a whole turn; they become {low:.6g} and {high:.6g}."
        decisions.append(Decision("mended", subject, text))
        return low, high
    if joint.kind == "prismatic" and not np.isfinite([lower, upper]).all():
        low = lower if np.isfinite(lower) else (upper - DEFAULT_STROKE if np.isfinite(upper) else 0.0)
        high = upper if np.isfinite(upper) else low + DEFAULT_STROKE
        decisions.append(
            Decision("warning", subject, f"slides without limits in the file; it gets {low:g} to {high:g} m.")
        )
        return low, high
    return lower, upper


def joint_motion(joint: FileJoint, q: float) -> Array:
    """Pose of a joint's child in the joint's frame at a value q [rad or m], homogeneous, shape (4, 4)."""
    if joint.kind == "fixed" or q == 0.0:
        return np.eye(4)
    axis = np.asarray(joint.axis, dtype=float) / np.linalg.norm(joint.axis)
    if joint.kind == "prismatic":
        return homogeneous(np.eye(3), axis * q)
    return homogeneous(rotation_about(axis, q), np.zeros(3))


def _joints_beyond(start: str, outbound: dict[str, list[FileJoint]]) -> set[str]:
    names: set[str] = set()
    todo = [start]
    while todo:
        for joint in outbound[todo.pop()]:
            names.add(joint.name)
            todo.append(joint.child)
    return names


def _held_values(
    model: FileModel, limits: dict[str, tuple[float, float]], ours: set[str], decisions: Decisions
) -> dict[str, float]:
    """Values of the joints that do not move: fixed ones, ones without range, and ones that follow such a joint.

    Decisions are stated for `ours` alone.
    """
    by_name = {joint.name: joint for joint in model.joints}
    held = {joint.name: 0.0 for joint in model.joints if joint.kind == "fixed"}
    without_range = []
    for joint in model.joints:
        if joint.kind == "fixed" or joint.mimic is not None:
            continue
        lower, upper = limits[joint.name]
        if upper - lower < NO_RANGE:
            held[joint.name] = 0.5 * (lower + upper)
            if joint.name in ours:
                without_range.append(joint.name)
    if without_range:
        text = "no range between its limits; what it carries is taken as rigidly attached."
        decisions.append(Decision("mended", f"joint {join(without_range)}", text))
    for joint in model.joints:
        if joint.mimic is None or joint.name in held:
            continue
        master, multiplier, offset, _ = _chain(joint, by_name)
        if master.name in held or multiplier == 0.0:
            held[joint.name] = multiplier * held.get(master.name, 0.0) + offset
            if joint.name in ours:
                text = f"follows joint {master.name}, which does not move it; it is held at {held[joint.name]:g}."
                decisions.append(Decision("decided", f"joint {joint.name}", text))
    return held


def _chain(joint: FileJoint, by_name: dict[str, FileJoint]) -> tuple[FileJoint, float, float, int]:
    """The joint at the end of a chain of mimic laws, the law that ties them, and the number of laws."""
    multiplier, offset, here, steps = 1.0, 0.0, joint, 0
    while here.mimic is not None:
        offset += multiplier * here.mimic.offset
        multiplier *= here.mimic.multiplier
        here, steps = by_name[here.mimic.master], steps + 1
    return here, multiplier, offset, steps


def _laws(model: FileModel, moving: list[FileJoint], decisions: Decisions) -> dict[str, _Law]:
    """The law of each moving joint in terms of an actuated joint of the hand."""
    by_name = {joint.name: joint for joint in model.joints}
    inside = {joint.name for joint in moving}
    laws: dict[str, _Law] = {}
    adopted: dict[str, tuple[str, float, float]] = {}  # Master outside -> the joint of the hand that stands for it.
    for joint in moving:
        master, multiplier, offset, steps = _chain(joint, by_name)
        if steps == 0:
            laws[joint.name] = _Law(None, 1.0, 0.0)
        elif master.name in inside:
            laws[joint.name] = _Law(master.name, multiplier, offset)
            if steps > 1:
                text = f"follows joint {master.name} through {steps - 1} others; here directly, "
                text += f"q = {multiplier:.6g} q_master + {offset:.6g}."
                decisions.append(Decision("decided", f"joint {joint.name}", text))
        elif master.name in adopted:
            other, m, o = adopted[master.name]  # q_other = m a + o and q = multiplier a + offset.
            laws[joint.name] = _Law(other, multiplier / m, offset - multiplier * o / m)
        else:
            adopted[master.name] = (joint.name, multiplier, offset)
            laws[joint.name] = _Law(None, 1.0, 0.0)
            text = f"follows joint {master.name}, which is not part of the hand; it is actuated here."
            decisions.append(Decision("warning", f"joint {joint.name}", text))
    return laws


def _consistent_limits(joints: tuple[Joint, ...], decisions: Decisions) -> tuple[Joint, ...]:
    """Finite limits for all, and for coupled joints such as let their masters move."""
    free = []
    for joint in joints:
        if joint.coupling is None:  # One without limits was coupled to a joint that is left out, or has none at all.
            most = np.pi if joint.kind == "revolute" else DEFAULT_STROKE
            joint = replace(joint, lower=max(joint.lower, -most), upper=min(joint.upper, most))
        free.append(joint)
    masters = {joint.name: joint for joint in free}
    out = []
    for joint in free:
        if joint.coupling is None:
            out.append(joint)
            continue
        law, master = joint.coupling, masters[joint.coupling.master]
        low, high = sorted(law.multiplier * q + law.offset for q in (master.lower, master.upper))
        if min(joint.upper, high) - max(joint.lower, low) < 0.1 * (high - low):
            text = f"its limits {joint.lower:g} to {joint.upper:g} would keep its master {master.name} from moving; "
            text += f"they become {low:.6g} to {high:.6g}."
            decisions.append(Decision("mended", f"joint {joint.name}", text))
            out.append(replace(joint, lower=low, upper=high))
        else:
            lower = joint.lower if np.isfinite(joint.lower) else low
            upper = joint.upper if np.isfinite(joint.upper) else high
            out.append(replace(joint, lower=lower, upper=upper))
    return tuple(out)


def _body_name(body: tuple[Member, ...], model: FileModel, decisions: Decisions) -> str:
    name = body[0].link.name
    if name != "world":
        return name
    taken = {link.name for link in model.links}
    new = next(n for n in ("base", "hand_base", "palm", "robot_base") if n not in taken)
    text = f"Drake keeps the name 'world' for the world itself; the link is called {new!r} here."
    decisions.append(Decision("decided", "link world", text))
    return new
