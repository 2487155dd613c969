"""Finds the hand in a robot file: palm, fingers and their names, wrist frame, shapes, inertias, a rest posture."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from xdex_drake.errors import HandFileError
from xdex_drake.hand.collision import OVERLAP_MARGIN, sphere_distance, spheres_of_links
from xdex_drake.hand.description import Array, Finger, Geometry, Hand, Link
from xdex_drake.hand.importing.anatomy import Anatomy, find_digits, name_fingers, zero_posture
from xdex_drake.hand.importing.bodies import Member, Tree
from xdex_drake.hand.importing.check import check_model
from xdex_drake.hand.importing.decisions import Decision, Decisions, join
from xdex_drake.hand.importing.finger_names import side_from_names
from xdex_drake.hand.importing.mass import body_inertias, joint_efforts
from xdex_drake.hand.importing.model import FileLink, FileModel
from xdex_drake.hand.importing.palm import find_chains, find_hand
from xdex_drake.hand.importing.rest import rest_posture
from xdex_drake.hand.importing.shape import link_shapes, surface_points
from xdex_drake.hand.spheres import fit_spheres

SLIP = 100.0
"""A link whose shape is this many times as large as the usual one was drawn in millimetres."""

LONGEST = 1.0
"""No hand reaches farther from its palm [m]."""

MOST_TURN_OF_DEGREES = np.pi / 20.0
"""Greatest range of a hand whose joint limits were meant in radians and taken as degrees, or nearly so [rad]."""

SHORTEST = 0.02
"""No hand reaches less far [m]."""


NESTED_TRIALS = 24
"""Number of postures, besides zero, that tell nested parts from ones that touch now and then."""


@dataclass(frozen=True)
class FileFrame:
    """Where a link of the file is in the hand.

    Attributes:
        link: Name of the hand's link that it is part of.
        X_LF: Its pose in that link's frame, homogeneous, shape (4, 4).
    """

    link: str
    X_LF: Array


@dataclass(frozen=True)
class Imported:
    """A hand found in a file.

    Attributes:
        hand: The hand.
        decisions: What was decided, mended or is doubtful.
        frames: For each link of the file that belongs to the hand, where it is now.
    """

    hand: Hand
    decisions: tuple[Decision, ...]
    frames: dict[str, FileFrame]


def interpret(model: FileModel, *, name: str, side: str | None = None, palm: str | None = None) -> Imported:
    """Finds the hand in a robot file, without annotation.

    Args:
        model: The robot as its file has it.
        name: Name of the hand.
        side: "right" or "left", where the file cannot tell.
        palm: Name of the link that the fingers grow from, where it is not to be found by itself.

    Returns:
        The hand and all that was decided on the way.

    Raises:
        HandFileError: The file does not describe a hand; the message names file, field and remedy.
    """
    if side not in (None, "right", "left"):
        raise HandFileError(f"{model.source}: side is {side!r}; give right or left")
    check_model(model)
    decisions: Decisions = [Decision("warning", "file", note) for note in model.notes]
    model = _mend_scales(model, decisions)
    tree = find_hand(model, palm, decisions)
    chains = find_chains(tree, decisions)
    digits = find_digits(tree, chains, decisions)
    by_names = side_from_names([model.name, *(m.link.name for body in tree.members for m in body)])
    anatomy = name_fingers(tree, digits, side or by_names, decisions)
    p_HB = _wrist_origin(tree, anatomy, decisions)
    _check_size(model, tree, anatomy)
    hand = _with_bodies(tree, anatomy, decisions)
    hand = replace(
        hand,
        name=name,
        display_name=_display_name(model, name),
        side=_side(anatomy, side, by_names, decisions),
        p_HB=p_HB,
        R_HB=anatomy.R_HB,
    )
    hand = replace(hand, ignored_contacts=_ignored_contacts(hand, model, tree, anatomy, decisions))
    hand = replace(hand, q_rest=rest_posture(hand, anatomy, decisions), sources=_sources(model, decisions))
    _say_undriven(tree, decisions)
    _say_narrow(hand, decisions)
    frames = {
        member.link.name: FileFrame(link.name, member.X_LF)
        for link, body in zip(hand.links, tree.members, strict=True)
        for member in body
    }
    return Imported(hand, tuple(decisions), frames)


def _mend_scales(model: FileModel, decisions: Decisions) -> FileModel:
    """Shrinks the shapes of links that are a thousand times as large as the others."""
    sizes: dict[str, float] = {}
    for link in model.links:
        points = surface_points((Member(link, np.eye(4), True),))
        if len(points):
            sizes[link.name] = float(np.abs(points).max())
    if len(sizes) < 3:
        return model
    usual = float(np.median(list(sizes.values())))
    links: list[FileLink] = []
    for link in model.links:
        factors = {}
        for kind, shapes in (("visual", link.visual), ("collision", link.collision)):
            mended = []
            for shape in shapes:
                points = surface_points((Member(FileLink("", (shape,)), np.eye(4), True),))
                large = len(points) > 0 and float(np.abs(points).max()) > max(SLIP * usual, 1.0)
                mended.append(shape.scaled(1e-3) if large else shape)
                factors[kind] = factors.get(kind, False) or large
            if factors.get(kind):
                link = replace(link, **{kind: tuple(mended)})
        if any(factors.values()):
            text = "its shape is hundreds of times as large as the others', as if drawn in millimetres; it was shrunk."
            decisions.append(Decision("mended", f"link {link.name}", text))
        links.append(link)
    return replace(model, links=tuple(links))


def _wrist_origin(tree: Tree, anatomy: Anatomy, decisions: Decisions) -> Array:
    """p_HB: the base's origin in H, whose own origin is set at the wrist."""
    named = [m for m in tree.members[0][1:] if "wrist" in m.link.name.lower() and m.leaf]
    if named:
        where, p_BHo = f"frame {named[0].link.name} of the file", named[0].X_LF[:3, 3]
    elif tree.inbound is not None:
        where, p_BHo = f"joint {tree.inbound.name} that carries the palm", np.zeros(3)
    else:
        where, p_BHo = "file's base frame", np.zeros(3)
        points = surface_points(tree.members[0])
        if len(points):
            z = anatomy.R_HB[2]
            low, high = float((points @ z).min()), float((points @ z).max())
            if not low - 0.1 < 0.0 < low + 0.35 * (high - low):
                bottom = points[points @ z < low + 0.15 * (high - low)]
                p_BHo = 0.5 * (bottom.min(axis=0) + bottom.max(axis=0))
                p_BHo = p_BHo + z * (low - p_BHo @ z)
                where = "rear end of the palm's shape"
    decisions.append(Decision("decided", "hand", f"the wrist frame H is set at the {where}."))
    return -anatomy.R_HB @ p_BHo


def _check_size(model: FileModel, tree: Tree, anatomy: Anatomy) -> None:
    roots = np.array([digit.p_BRoot for digit in anatomy.digits])
    reach = max(float(np.linalg.norm(d.p_BTip - roots.mean(axis=0))) for d in anatomy.digits)
    if not SHORTEST < reach < LONGEST:
        raise HandFileError(
            f"{model.source}: the fingertips are {reach:.3g} m from the roots of the fingers; write lengths in metres"
        )


def _with_bodies(tree: Tree, anatomy: Anatomy, decisions: Decisions) -> Hand:
    """The tree with shapes, inertias, spheres, efforts and fingers."""
    skeleton = tree.skeleton
    names = [link.name for link in skeleton.links]
    geometry = [link_shapes(n, body, decisions) for n, body in zip(names, tree.members, strict=True)]
    _say_shapeless(skeleton, geometry, anatomy, decisions)
    inertias = body_inertias(names, tree.members, geometry, decisions)
    tips = [(digit.chain.bodies[-1], digit.p_LTip) for digit in anatomy.digits]
    efforts = joint_efforts(skeleton, tips, zero_posture(skeleton), decisions)
    links = tuple(
        Link(n, shapes, mass, p_LLcm, I_LLcm, fit_spheres(shapes))
        for n, shapes, (mass, p_LLcm, I_LLcm) in zip(names, geometry, inertias, strict=True)
    )
    fingers = tuple(
        Finger(
            name,
            tuple(names[k] for k in digit.chain.bodies),
            names[digit.chain.bodies[-1]],
            digit.p_LTip,
            digit.n_LPad,
        )
        for name, digit in zip(anatomy.names, anatomy.digits, strict=True)
    )
    joints = tuple(replace(joint, effort=effort) for joint, effort in zip(skeleton.joints, efforts, strict=True))
    return replace(skeleton, links=links, joints=joints, fingers=fingers)


def _say_shapeless(
    skeleton: Hand, geometry: list[tuple[Geometry, ...]], anatomy: Anatomy, decisions: Decisions
) -> None:
    last = {digit.chain.bodies[-1] for digit in anatomy.digits}
    bare = [skeleton.links[k].name for k in last if not geometry[k]]
    if bare:
        text = "ends a finger but has no shape, so it touches nothing; give it a geometry."
        decisions.append(Decision("warning", f"link {join(bare)}", text))
    if not geometry[0]:
        decisions.append(Decision("warning", f"link {skeleton.links[0].name}", "is the palm but has no shape."))


def _side(anatomy: Anatomy, side: str | None, by_names: str | None, decisions: Decisions) -> str:
    found = anatomy.side
    chosen = side or found or by_names or "right"
    if found is not None and found != chosen:
        text = f"its thumb and fingers are those of a {found} hand; it is called a {chosen} one as asked for."
        decisions.append(Decision("warning", "hand", text))
    elif found is not None and by_names not in (None, found):
        text = f"its names say {by_names}, but its thumb and fingers are those of a {found} hand."
        decisions.append(Decision("warning", "hand", text))
    elif found is None:
        why = "as asked for" if side else ("by its names" if by_names else "by convention, for it is symmetric")
        decisions.append(Decision("decided", "hand", f"it is taken as a {chosen} hand, {why}."))
    else:
        decisions.append(Decision("decided", "hand", f"it is a {found} hand by the place of its thumb."))
    return chosen


def _say_undriven(tree: Tree, decisions: Decisions) -> None:
    joints = zip(tree.skeleton.joints, tree.driven, strict=True)
    idle = [joint.name for joint, driven in joints if driven is False and joint.coupling is None]
    if idle:
        text = "moved by nothing in the file; taken as actuated. Give it a coupling, or equal limits to hold it."
        decisions.append(Decision("warning", f"joint {join(idle)}", text))


def _say_narrow(hand: Hand, decisions: Decisions) -> None:
    turns = [joint.upper - joint.lower for joint in hand.joints if joint.kind == "revolute"]
    if turns and max(turns) < MOST_TURN_OF_DEGREES:
        text = f"no joint turns by more than {np.degrees(max(turns)):.1f} degrees: are its angles in another unit?"
        decisions.append(Decision("warning", "hand", text))


def _ignored_contacts(
    hand: Hand, model: FileModel, tree: Tree, anatomy: Anatomy, decisions: Decisions
) -> tuple[tuple[str, str], ...]:
    """Pairs that the file rules out, and links near a finger's root that are nested in the palm."""
    body_of = {member.link.name: k for k, body in enumerate(tree.members) for member in body}
    pairs: dict[tuple[int, int], None] = {}
    for first, second in model.ignored_pairs:
        i, j = sorted((body_of.get(first, -1), body_of.get(second, -1)))
        solid = i >= 0 and bool(hand.links[i].geometry) and bool(hand.links[j].geometry)
        if solid and i != j and hand.parents[j] != i:
            pairs[i, j] = None
    if pairs:
        text = f"the file rules out contact between {_pair_names(hand, list(pairs))}; it is ignored."
        decisions.append(Decision("decided", "hand", text))
    nested = [pair for pair in _nested_in_palm(hand, anatomy) if pair not in pairs]
    if nested:
        text = f"{_pair_names(hand, nested)} overlap at the zero posture and mostly elsewhere, as nested parts do; "
        decisions.append(Decision("decided", "hand", text + "their contact is ignored."))
    return tuple((hand.links[i].name, hand.links[j].name) for i, j in [*pairs, *nested])


def _nested_in_palm(hand: Hand, anatomy: Anatomy) -> list[tuple[int, int]]:
    """Second links of fingers that overlap the palm at the zero posture and in at least half of all others.

    A finger's first link is the palm's neighbor; contact of the palm with links beyond the second is one of the
    posture's.
    """
    rng = np.random.default_rng(0)
    lower, upper = hand.limits
    qs = [zero_posture(hand), *rng.uniform(lower, upper, (NESTED_TRIALS, len(lower)))]
    postures = [spheres_of_links(hand, q) for q in qs]
    nested: dict[tuple[int, int], None] = {}
    for digit in anatomy.digits:
        for k in [k for k in digit.chain.path if len(hand.links[k].spheres)][1:2]:
            if not len(hand.links[0].spheres):
                continue
            overlaps = [sphere_distance(spheres_H[0], spheres_H[k]) <= OVERLAP_MARGIN for spheres_H in postures]
            if overlaps[0] and 2 * sum(overlaps) >= len(overlaps):
                nested[0, k] = None
    return list(nested)


def _pair_names(hand: Hand, pairs: list[tuple[int, int]]) -> str:
    return join([f"{hand.links[i].name} and {hand.links[j].name}" for i, j in pairs])


def _display_name(model: FileModel, name: str) -> str:
    return model.name.replace("_", " ").strip() or name


def _sources(model: FileModel, decisions: Decisions) -> dict[str, str]:
    file = Path(model.source).name
    mended = {"mass": False, "effort": False}
    for decision in decisions:
        mended["mass"] |= "inertia" in decision.text and decision.severity == "mended"
        mended["effort"] |= "an effort that is missing" in decision.text
    return {
        "kinematics": f"{file}: joint origins, axes, limits and couplings; rigidly attached links are merged.",
        "efforts": f"{file}" + ("; placeholders were replaced by 10 N at the fingertip." if mended["effort"] else "."),
        "masses": f"{file}" + ("; what was missing or invalid follows from the shapes." if mended["mass"] else "."),
        "geometry": f"{file}: its collision shapes as primitives and convex parts.",
        "wrist": "Found from the fingers' roots and from the side to which they close.",
    }
