"""Operations that turn a hand into another one: scaled, with links added, taken away or merged, with a finger less.

Each is a pure function and keeps a hand's description consistent: couplings whose master goes are carried over to
another master, tips move to the link that is last then, spheres and mass follow the geometry. What an operation leaves
may still be no useful hand (fingers that cannot close, links that overlap): `checks.check_hand` judges that.

An `Operation` is the record of one such step; a hand made of several names them in `sources["variation"]`, which
`read_operations` understands.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Coupling, Finger, Geometry, Hand, Joint, Link
from xdex_drake.hand.inertia import ROTOR_INERTIA, link_inertia, offset_moment
from xdex_drake.hand.kinematics import rotation_about
from xdex_drake.hand.spheres import fit_spheres

SHORTEST = 8e-3
"""A link whose next joint is nearer than this [m] is a hub or a stub; a copy of it would share its axis."""

GAP = 5e-3
"""Between a link and its copy there is no wider gap than this on either side of their joint [m]."""

KINDS = ("scale_hand", "scale_links", "duplicate_link", "remove_link", "remove_finger", "merge_links")


@dataclass(frozen=True)
class Operation:
    """One step of a variation.

    Attributes:
        kind: One of `KINDS`.
        names: Names of links (`scale_links`, `duplicate_link`, `remove_link`, `merge_links`: the child) or the name of
            a finger (`remove_finger`); empty for `scale_hand`.
        factors: Factor on lengths: one for `scale_hand`, one a link for `scale_links`; otherwise empty.
        coupled: Whether a duplicate follows its original instead of being driven by itself.
    """

    kind: str
    names: tuple[str, ...] = ()
    factors: tuple[float, ...] = ()
    coupled: bool = False

    def __str__(self) -> str:
        """A line that a person can read, and `read_operations` too."""
        if self.kind == "scale_hand":
            return f"scale_hand({self.factors[0]:g})"
        if self.kind == "scale_links":
            pairs = zip(self.names, self.factors, strict=True)
            return f"scale_links({', '.join(f'{name} {factor:g}' for name, factor in pairs)})"
        return f"{self.kind}({self.names[0]}{', coupled' if self.coupled else ''})"


def read_operations(text: str) -> tuple[Operation, ...]:
    """Operations from their text, as in `sources["variation"]`.

    Args:
        text: Operations as `str` writes them, with `; ` between them.

    Returns:
        The operations.

    Raises:
        ConfigError: The text has another form.
    """
    return tuple(_read_operation(part.strip()) for part in text.split(";") if part.strip())


def _read_operation(text: str) -> Operation:
    match = re.fullmatch(r"(\w+)\(([^()]*)\)", text)
    if match is None or match[1] not in KINDS:
        raise ConfigError(f"{text!r} is no operation on a hand; write one of {', '.join(KINDS)} with its arguments")
    kind, words = match[1], [word.strip() for word in match[2].split(",")]
    try:
        if kind == "scale_hand":
            return Operation(kind, (), (float(match[2]),))
        if kind == "scale_links":
            pairs = [word.rsplit(" ", 1) for word in words]
            return Operation(kind, tuple(name for name, _ in pairs), tuple(float(factor) for _, factor in pairs))
    except ValueError:
        raise ConfigError(f"{text!r}: a factor is missing; write scale_hand(1.1) or scale_links(LINK 1.1)") from None
    if not words[0]:
        raise ConfigError(f"{text!r}: a name is missing; write {kind}(NAME)")
    return Operation(kind, (words[0],), (), words[1:] == ["coupled"])


def apply_operation(hand: Hand, operation: Operation) -> Hand:
    """Applies one operation and appends it to `sources["variation"]`.

    Args:
        hand: The hand.
        operation: The operation.

    Returns:
        The new hand, under the same name.

    Raises:
        ConfigError: The operation does not fit the hand.
    """
    if operation.kind not in KINDS:
        raise ConfigError(f"there is no operation {operation.kind!r}; known are {', '.join(KINDS)}")
    if operation.kind == "scale_hand":
        varied = scale_hand(hand, operation.factors[0])
    elif operation.kind == "scale_links":
        varied = scale_links(hand, dict(zip(operation.names, operation.factors, strict=True)))
    elif operation.kind == "duplicate_link":
        varied = duplicate_link(hand, operation.names[0], coupled=operation.coupled)
    else:
        function = {"remove_link": remove_link, "remove_finger": remove_finger, "merge_links": merge_links}
        varied = function[operation.kind](hand, operation.names[0])
    before = hand.sources.get("variation")
    return replace(
        varied, sources={**hand.sources, "variation": f"{before}; {operation}" if before else str(operation)}
    )


def apply_operations(hand: Hand, operations: Sequence[Operation]) -> Hand:
    """Applies operations one after the other; see `apply_operation`."""
    for operation in operations:
        hand = apply_operation(hand, operation)
    return hand


# ---- size


def scale_hand(hand: Hand, factor: float) -> Hand:
    """The whole hand larger or smaller.

    All lengths grow by the factor and masses by its cube; so do efforts, as a motor's torque with its volume (a slide's
    force with the square).

    Args:
        hand: The hand.
        factor: Factor on lengths, positive.

    Returns:
        The hand; link positions in H at any joint angles are `factor` times the original's.

    Raises:
        ConfigError: The factor is not positive.
    """
    _require_factor(factor)
    slides = {joint.name: joint.kind == "prismatic" for joint in hand.joints}

    def scaled(joint: Joint) -> Joint:
        unit = factor if slides[joint.name] else 1.0
        law = joint.coupling
        if law is not None:
            master = factor if slides[law.master] else 1.0
            law = Coupling(law.master, law.multiplier * unit / master, law.offset * unit)
        effort = joint.effort * (factor**2 if slides[joint.name] else factor**3)
        return replace(
            joint,
            p_PJ=factor * joint.p_PJ,
            lower=unit * joint.lower,
            upper=unit * joint.upper,
            effort=effort,
            coupling=law,
        )

    units = np.array([factor if slides[name] else 1.0 for name in hand.joint_names])
    return replace(
        hand,
        links=tuple(_scaled_link(link, factor) for link in hand.links),
        joints=tuple(scaled(joint) for joint in hand.joints),
        fingers=tuple(replace(finger, p_LTip=factor * finger.p_LTip) for finger in hand.fingers),
        p_HB=factor * hand.p_HB,
        q_rest=units * hand.q_rest,
    )


def scale_links(hand: Hand, factors: Mapping[str, float]) -> Hand:
    """Some links larger or smaller, each by its own factor.

    A link is scaled about its frame; what is mounted on it moves along, and its own orientation and size stay. The base
    is scaled about the wrist.

    Args:
        hand: The hand.
        factors: Factor on lengths of each link that is to change, by its name.

    Returns:
        The hand.

    Raises:
        ConfigError: There is no such link, or a factor is not positive.
    """
    for name, factor in factors.items():
        _require_link(hand, name)
        _require_factor(factor)
    return replace(
        hand,
        links=tuple(_scaled_link(link, factors[link.name]) if link.name in factors else link for link in hand.links),
        joints=tuple(replace(j, p_PJ=factors.get(j.parent, 1.0) * j.p_PJ) for j in hand.joints),
        fingers=tuple(replace(f, p_LTip=factors.get(f.tip_link, 1.0) * f.p_LTip) for f in hand.fingers),
        p_HB=factors.get(hand.links[0].name, 1.0) * hand.p_HB,
    )


def _scaled_link(link: Link, factor: float) -> Link:
    geometry = tuple(shape.scaled(factor) for shape in link.geometry)
    # Mass properties that were computed from the geometry are so again; others keep their form.
    mass, p_LLcm, I_LLcm = link_inertia(link.geometry, link.mass)
    if np.array_equal(p_LLcm, link.p_LLcm) and np.array_equal(I_LLcm, link.I_LLcm):
        mass, p_LLcm, I_LLcm = link_inertia(geometry, link.mass * factor**3)
    else:
        # Nothing below what a rotor adds, or gains that suit a finger would be stiff for its tip.
        floor = max(0.0, 1.0 - factor**5) * ROTOR_INERTIA * np.eye(3)
        mass, p_LLcm, I_LLcm = link.mass * factor**3, factor * link.p_LLcm, factor**5 * link.I_LLcm + floor
    return Link(link.name, geometry, mass, p_LLcm, I_LLcm, _refitted(link, geometry, factor * link.spheres))


def _refitted(link: Link, geometry: tuple[Geometry, ...], otherwise: Array) -> Array:
    """Spheres of changed geometry: fitted again where they were fitted before, else the ones that are given."""
    return fit_spheres(geometry) if np.array_equal(link.spheres, fit_spheres(link.geometry)) else otherwise


# ---- topology


def duplicate_link(hand: Hand, name: str, *, coupled: bool = False) -> Hand:
    """A finger with one link more: a copy of a link, with its joint, mounted where the link ends.

    What was mounted on the link is mounted on the copy; the tip moves to the copy of a tip link. At zero the copy
    continues the link straight on.

    Args:
        hand: The hand.
        name: Name of a link of a finger, which carries one link or is a tip.
        coupled: Whether the copy's joint follows the original's one to one; a joint that is coupled itself passes its
            law on.

    Returns:
        The hand; the copy and its joint are named after the original, with a number.

    Raises:
        ConfigError: The link is not part of a finger, carries several links, or has no shape to copy.
    """
    k = _require_link(hand, name)
    if k == 0 or not any(name in finger.links for finger in hand.fingers):
        raise ConfigError(f"hand {hand.name}: link {name!r} is not part of a finger; duplicate one that is")
    joint, link = hand.joints[k - 1], hand.links[k]
    mounted = [j for j in hand.joints if j.parent == name]
    if len(mounted) > 1:
        raise ConfigError(
            f"hand {hand.name}: link {name!r} carries {len(mounted)} links; duplicate one that carries one"
        )
    end = _end(hand, name)
    if np.linalg.norm(end) < SHORTEST:
        raise ConfigError(f"hand {hand.name}: link {name!r} is a hub; duplicate a longer one")
    if max(_gap(link, np.zeros(3)), _gap(link, end)) > GAP:
        raise ConfigError(f"hand {hand.name}: link {name!r} has no shape where its joints are; duplicate another")
    copy_name = _free_name(name, [other.name for other in hand.links])
    joint_name = _free_name(joint.name, [other.name for other in hand.joints])
    law = joint.coupling
    if law is None and coupled:
        law = Coupling(joint.name, 1.0, 0.0)
    copy_joint = replace(
        joint,
        name=joint_name,
        parent=name,
        child=copy_name,
        p_PJ=end,
        R_PJ=np.eye(3),
        coupling=law,
    )
    rest = _rest_of(hand)
    # Half of the original's angle: both together bend less than twice as much.
    rest[joint_name] = float(np.clip(0.5 * rest[joint.name], joint.lower, joint.upper))
    joints = [*(replace(j, parent=copy_name) if j.parent == name else j for j in hand.joints), copy_joint]
    fingers = []
    for finger in hand.fingers:
        if name in finger.links:
            at = finger.links.index(name) + 1
            chain = (*finger.links[:at], copy_name, *finger.links[at:])
            tip_link = copy_name if finger.tip_link == name else finger.tip_link
            finger = replace(finger, links=chain, tip_link=tip_link)
        fingers.append(finger)
    return _assembled(hand, [*hand.links, replace(link, name=copy_name)], joints, fingers, rest)


def remove_link(hand: Hand, name: str) -> Hand:
    """A finger with one link less: a link goes, with its joint, and what it carried takes its place.

    The joint that goes is frozen at its rest. Without its tip link a finger ends at the link before, and hubs that
    carry nothing then go too.

    Args:
        hand: The hand.
        name: Name of a link of a finger, not its only one with geometry.

    Returns:
        The hand.

    Raises:
        ConfigError: The link is not part of a finger, or all that the finger has.
    """
    k = _require_link(hand, name)
    if k == 0 or not any(name in finger.links for finger in hand.fingers):
        raise ConfigError(f"hand {hand.name}: link {name!r} is not part of a finger; remove one that is")
    rest = _rest_of(hand)
    joint = hand.joints[k - 1]
    R = joint.R_PJ @ _motion(joint, rest[joint.name])[0]
    mounted = {j.name for j in hand.joints if j.parent == name}
    joints = []
    for j in _without_masters(hand, {joint.name}):
        if j.name == joint.name:
            continue
        if j.name in mounted:
            j = replace(j, parent=joint.parent, p_PJ=joint.p_PJ, R_PJ=_orthonormal(R @ j.R_PJ))
        joints.append(j)
    fingers = [_without_link(hand, finger, name, R) for finger in hand.fingers]
    links = [link for link in hand.links if link.name != name]
    # Hubs and other links that carry nothing, because they carried the tip.
    while True:
        parents, tips = {j.parent for j in joints}, {finger.tip_link for finger in fingers}
        idle = {k.name for k in links[1:] if not k.geometry and k.name not in parents and k.name not in tips}
        if not idle:
            break
        dead = {j.name for j in joints if j.child in idle}
        joints = [j for j in _recoupled(joints, dead) if j.name not in dead]
        links = [link for link in links if link.name not in idle]
    return _assembled(hand, links, joints, fingers, rest)


def _without_link(hand: Hand, finger: Finger, name: str, R: Array) -> Finger:
    """A finger whose link `name`, at rotation R in its parent, goes; hubs at the end of its chain go with a tip."""
    if name not in finger.links:
        return finger
    solid = {link.name for link in hand.links if link.geometry}
    chain = [link for link in finger.links if link != name]
    if not any(link in solid for link in chain):
        raise ConfigError(f"hand {hand.name}: {name!r} is all that finger {finger.name!r} has; remove the finger")
    if finger.tip_link != name:
        return replace(finger, links=tuple(chain))
    n = R @ finger.n_LPad
    ended = name
    while True:
        joint = next(j for j in hand.joints if j.child == ended)
        last = chain[-1]
        if last in solid:
            break
        # A hub is no tip: the pad's normal goes on to what carries it.
        hub = next(j for j in hand.joints if j.child == last)
        n = hub.R_PJ @ _motion(hub, _rest_of(hand)[hub.name])[0] @ n
        ended = last
        chain.pop()
    end = _surface_beyond(hand.links[hand.link_index[last]], joint.p_PJ)
    return Finger(finger.name, tuple(chain), last, end, n / np.linalg.norm(n))


def remove_finger(hand: Hand, name: str) -> Hand:
    """A hand with one finger less; links that it shares with another finger stay.

    Args:
        hand: The hand.
        name: Name of the finger, not the only one.

    Returns:
        The hand.

    Raises:
        ConfigError: There is no such finger, or no other.
    """
    names = [finger.name for finger in hand.fingers]
    if name not in names or len(names) < 2:
        raise ConfigError(f"hand {hand.name}: finger {name!r} cannot be removed; there are {', '.join(names)}")
    kept = [finger for finger in hand.fingers if finger.name != name]
    needed = {link for finger in kept for link in finger.links}
    doomed = {link for finger in hand.fingers if finger.name == name for link in finger.links} - needed
    # Whatever hangs on the finger goes with it.
    for joint in hand.joints:
        if joint.parent in doomed and joint.child not in needed:
            doomed.add(joint.child)
    dead = {joint.name for joint in hand.joints if joint.child in doomed}
    joints = [joint for joint in _without_masters(hand, dead) if joint.name not in dead]
    links = [link for link in hand.links if link.name not in doomed]
    return _assembled(hand, links, joints, kept, _rest_of(hand))


def merge_links(hand: Hand, name: str) -> Hand:
    """A link and its parent as one rigid link: the joint between them is frozen at its rest.

    Args:
        hand: The hand.
        name: Name of the child; its parent takes it up and keeps its own name.

    Returns:
        The hand.

    Raises:
        ConfigError: The link is the base, or all that moves of a finger.
    """
    k = _require_link(hand, name)
    if k == 0:
        raise ConfigError(f"hand {hand.name}: {name!r} is the base; name the child of the two links to merge")
    joint, child, rest = hand.joints[k - 1], hand.links[k], _rest_of(hand)
    if any(finger.links == (name,) for finger in hand.fingers):
        raise ConfigError(f"hand {hand.name}: {name!r} is all that moves of a finger; remove the finger instead")
    parent = hand.links[int(hand.parents[k])]
    R_motion, p_motion = _motion(joint, rest[joint.name])
    R, p = _orthonormal(joint.R_PJ @ R_motion), joint.p_PJ + joint.R_PJ @ p_motion
    joints = [
        replace(j, parent=parent.name, p_PJ=p + R @ j.p_PJ, R_PJ=_orthonormal(R @ j.R_PJ)) if j.parent == name else j
        for j in _without_masters(hand, {joint.name})
        if j.name != joint.name
    ]
    fingers = []
    for finger in hand.fingers:
        if name in finger.links:
            chain = tuple(link for link in finger.links if link != name)
            if finger.tip_link == name:
                tip_link = chain[-1]
                finger = Finger(finger.name, chain, tip_link, p + R @ finger.p_LTip, R @ finger.n_LPad)
            else:
                finger = replace(finger, links=chain)
        fingers.append(finger)
    merged = _merged(parent, child, R, p)
    links = [merged if link is parent else link for link in hand.links if link is not child]
    ignored: list[tuple[str, str]] = []
    for pair in hand.ignored_contacts:
        a, b = (parent.name if end == name else end for end in pair)
        if a != b and (a, b) not in ignored and (b, a) not in ignored:
            ignored.append((a, b))
    return _assembled(replace(hand, ignored_contacts=tuple(ignored)), links, joints, fingers, rest)


def _merged(parent: Link, child: Link, R: Array, p: Array) -> Link:
    """Two links as one, in the frame of the parent; R and p are the child's pose there."""
    if not child.geometry and not len(child.spheres):
        return parent  # the small mass of a hub is within what is known of any link's
    geometry = (*parent.geometry, *(shape.moved(R, p) for shape in child.geometry))
    mass = parent.mass + child.mass
    p_cm = (parent.mass * parent.p_LLcm + child.mass * (p + R @ child.p_LLcm)) / mass
    derived = all(_is_derived(link) for link in (parent, child))
    if derived:
        mass, p_cm, inertia = link_inertia(geometry, mass)
    else:
        inertia = parent.I_LLcm + parent.mass * offset_moment(parent.p_LLcm - p_cm)
        inertia = inertia + R @ child.I_LLcm @ R.T + child.mass * offset_moment(p + R @ child.p_LLcm - p_cm)
        inertia = 0.5 * (inertia + inertia.T)
    spheres = np.concatenate([parent.spheres, np.column_stack([child.spheres[:, :3] @ R.T + p, child.spheres[:, 3]])])
    fitted = all(np.array_equal(link.spheres, fit_spheres(link.geometry)) for link in (parent, child))
    return Link(parent.name, geometry, mass, p_cm, inertia, fit_spheres(geometry) if fitted else spheres)


def _is_derived(link: Link) -> bool:
    """Whether a link's mass is spread as its geometry says."""
    _, p_LLcm, I_LLcm = link_inertia(link.geometry, link.mass)
    return np.array_equal(p_LLcm, link.p_LLcm) and np.array_equal(I_LLcm, link.I_LLcm)


# ---- what the operations share


def _require_link(hand: Hand, name: str) -> int:
    if name not in hand.link_index:
        raise ConfigError(f"hand {hand.name}: there is no link {name!r}; there are {', '.join(hand.link_index)}")
    return hand.link_index[name]


def _require_factor(factor: float) -> None:
    if not (np.isfinite(factor) and factor > 0.0):
        raise ConfigError(f"the factor {factor:g} is not positive; give one such as 1.1")


def _rest_of(hand: Hand) -> dict[str, float]:
    """Rest value of each joint, coupled ones included [rad or m]."""
    values = hand.q_full(hand.q_rest)
    return {joint.name: float(value) for joint, value in zip(hand.joints, values, strict=True)}


def _motion(joint: Joint, value: float) -> tuple[Array, Array]:
    """Rotation and translation of a joint at a value, in the joint frame."""
    if joint.kind == "revolute":
        return rotation_about(joint.axis, value), np.zeros(3)
    return np.eye(3), value * joint.axis


def _orthonormal(R: Array) -> Array:
    """The rotation nearest to a product of rotations, so that errors do not add up from step to step."""
    u, _, vt = np.linalg.svd(R)
    return u @ vt


def _without_masters(hand: Hand, gone: set[str]) -> list[Joint]:
    return _recoupled(list(hand.joints), gone)


def _recoupled(joints: Sequence[Joint], gone: set[str]) -> list[Joint]:
    """Joints none of which follows one that goes: the first of its followers is driven in its place.

    From q_i = m_i q + o_i and q_f = m_f q + o_f follows q_i = (m_i / m_f) q_f + o_i - (m_i / m_f) o_f.
    """
    heirs: dict[str, Joint] = {}
    for joint in joints:
        law = joint.coupling
        if law is not None and law.master in gone and joint.name not in gone and law.multiplier != 0.0:
            heirs.setdefault(law.master, joint)
    out = []
    for joint in joints:
        law = joint.coupling
        if law is not None and law.master in gone and joint.name not in gone:
            heir = heirs.get(law.master)
            if heir is None or heir is joint:
                law = None
            else:
                assert heir.coupling is not None
                ratio = law.multiplier / heir.coupling.multiplier
                law = Coupling(heir.name, ratio, law.offset - ratio * heir.coupling.offset)
            joint = replace(joint, coupling=law)
        out.append(joint)
    return out


def _end(hand: Hand, name: str) -> Array:
    """Where a link of a finger ends, in its frame: at its next joint, or, for a tip, at the center of its round end."""
    for joint in hand.joints:
        if joint.parent == name:
            return joint.p_PJ
    finger = next(finger for finger in hand.fingers if finger.tip_link == name)
    spheres = hand.links[hand.link_index[name]].spheres
    if not len(spheres):
        return finger.p_LTip
    gaps = np.linalg.norm(spheres[:, :3] - finger.p_LTip, axis=1) - spheres[:, 3]
    return spheres[int(np.argmin(gaps)), :3].copy()


def _gap(link: Link, p: Array) -> float:
    """Distance of a point of a link's frame from its spheres [m]."""
    gaps = np.linalg.norm(link.spheres[:, :3] - p, axis=1) - link.spheres[:, 3]
    return float(np.min(gaps, initial=np.inf))


def _surface_beyond(link: Link, p: Array) -> Array:
    """The point of a link's surface in the direction of a point of its frame; that point for a link without shape."""
    length = float(np.linalg.norm(p))
    if not len(link.spheres) or length < 1e-9:
        return p
    u = p / length
    reach = link.spheres[:, :3] @ u + link.spheres[:, 3]
    best = link.spheres[int(np.argmax(reach))]
    return best[:3] + best[3] * u


def _free_name(name: str, taken: Sequence[str]) -> str:
    stem = re.sub(r"_copy\d+$", "", name)
    k = 1
    while f"{stem}_copy{k}" in taken:
        k += 1
    return f"{stem}_copy{k}"


def _assembled(
    hand: Hand, links: Sequence[Link], joints: Sequence[Joint], fingers: Sequence[Finger], rest: Mapping[str, float]
) -> Hand:
    """A hand of changed parts: links in tree order, the rest posture by joint name and within the limits."""
    by_name = {link.name: link for link in links}
    ordered = _depth_first(hand.links[0].name, joints)
    varied = replace(
        hand,
        links=(by_name[hand.links[0].name], *(by_name[joint.child] for joint in ordered)),
        joints=tuple(ordered),
        fingers=tuple(fingers),
        ignored_contacts=tuple((a, b) for a, b in hand.ignored_contacts if a in by_name and b in by_name),
    )
    low, high = varied.limits
    q_rest = np.array([rest[name] for name in varied.joint_names])
    return replace(varied, q_rest=np.minimum(np.maximum(q_rest, low), high))


def _depth_first(base: str, joints: Sequence[Joint]) -> list[Joint]:
    """Joints so that each follows the one that carries it, and a finger's stand together."""
    out: list[Joint] = []
    for joint in joints:
        if joint.parent == base:
            out += [joint, *_depth_first(joint.child, joints)]
    return out
