"""Finds the hand in a robot file: palm, fingers and their names, wrist frame, shapes, inertias, a rest posture."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.collision import OVERLAP_MARGIN, self_collision_pairs, sphere_distance, spheres_of_links
from xdex_drake.hand.description import Finger, Geometry, Hand, Link
from xdex_drake.hand.importing.anatomy import Anatomy, find_digits, name_fingers, zero_posture
from xdex_drake.hand.importing.bodies import Member, Tree, link_poses
from xdex_drake.hand.importing.check import check_model
from xdex_drake.hand.importing.decisions import Decision, Decisions, join
from xdex_drake.hand.importing.finger_names import side_from_names
from xdex_drake.hand.importing.loops import close_loops
from xdex_drake.hand.importing.mass import body_inertias, joint_efforts
from xdex_drake.hand.importing.model import FileLink, FileModel
from xdex_drake.hand.importing.painted import with_surfaces
from xdex_drake.hand.importing.palm import Chain, find_chains, find_hand
from xdex_drake.hand.importing.rest import rest_posture
from xdex_drake.hand.importing.shape import link_shapes, surface_points, without_markers
from xdex_drake.hand.spheres import BULGE, fit_spheres
from xdex_drake.hand.yaml_file import MAX_BYTES, hand_text, parse_hand

SLIP = 100.0
"""A link whose shape is this many times as large as the usual one was drawn in millimetres."""

LONGEST = 1.0
"""No hand reaches farther from its palm [m]."""

MOST_TURN_OF_DEGREES = 1.01 * np.deg2rad(4.0 * np.pi)
"""Greatest range of a hand whose joint limits were meant in radians, two turns at most, and taken as degrees."""

SHORTEST = 0.02
"""No hand reaches less far [m]."""


CROWDED_POSTURES = 15
"""Number of postures that tell a hand whose links overlap in most of them."""

NESTED_GAP = 2.0 * BULGE + OVERLAP_MARGIN
"""Parts that are nearer than this may count as overlapping, for the spheres of either bulge out of its shape [m]."""

NESTED_SHARE = 0.3
"""Parts that are that near in this share of their motion are nested; others touch now and then."""

OUTLINE = 150
"""Number of points that stand for the surface of each of a link's shapes, besides its corners."""

NESTED_GRID = {1: 33, 2: 9, 3: 6, 4: 4}
"""Number of values of each joint, by the number of joints, at which that is judged."""


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
    decisions: Decisions = [*model.decisions, *(Decision("warning", "file", note) for note in model.notes)]
    _check_shapes(model)
    model = close_loops(_mend_scales(model, decisions), decisions)
    tree = find_hand(model, side, palm, lambda tree: _side_of(tree, model), decisions)
    tree = without_markers(tree, decisions)
    chains = find_chains(tree, model, decisions)
    _check_fingers(model, tree, chains)
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
    _say_crowded(hand, anatomy, decisions)
    _check_written(model, hand)
    hand = with_surfaces(hand, tree)
    frames = {
        member.link.name: FileFrame(link.name, member.X_LF)
        for link, body in zip(hand.links, tree.members, strict=True)
        for member in body
    }
    return Imported(hand, tuple(decisions), frames)


def _side_of(tree: Tree, model: FileModel) -> str | None:
    """The side of a hand by the place of its thumb."""
    return name_fingers(tree, find_digits(tree, find_chains(tree, model, []), []), None, []).side


def _check_shapes(model: FileModel) -> None:
    """Refuses a hand without any shape, and says why its shapes are missing."""
    if any(link.visual or link.collision for link in model.links):
        return
    causes = list(dict.fromkeys(cause for link in model.links for cause in link.lost))
    why = f": the mesh {causes[0]}" if causes else ""
    more = f" (and {len(causes) - 1} more meshes)" if len(causes) > 1 else ""
    raise HandFileError(f"{model.source}: no link has a shape{why}{more}; a hand without shape touches nothing")


def _check_fingers(model: FileModel, tree: Tree, chains: list[Chain]) -> None:
    """Refuses hands that cannot hold a thing: of one finger, or with fingertips that touch nothing."""
    names = [link.name for link in tree.skeleton.links]
    if len(chains) < 2:
        raise HandFileError(
            f"{model.source}: one finger or jaw alone moves ({names[chains[0].bodies[-1]]}), and nothing opposes it; "
            "give a hand of two fingers or more"
        )
    bare = [k for k in (chain.bodies[-1] for chain in chains) if not len(surface_points(tree.members[k]))]
    if bare:
        lost = [cause for k in bare for member in tree.members[k] for cause in member.link.lost]
        why = f" ({lost[0]})" if lost else ""
        raise HandFileError(
            f"{model.source}: the last links of {len(bare)} of {len(chains)} fingers have no shape "
            f"({join([names[k] for k in bare], 8)}){why}, so that they touch nothing; give them a geometry"
        )


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
    _say_shapeless(skeleton, geometry, decisions)
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


def _say_shapeless(skeleton: Hand, geometry: list[tuple[Geometry, ...]], decisions: Decisions) -> None:
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


def _say_crowded(hand: Hand, anatomy: Anatomy, decisions: Decisions) -> None:
    """Warns where links overlap in most of the postures from a little before the rest posture to nearly closed ones."""
    lower, upper = hand.limits
    closing = np.sum([digit.closing for digit in anatomy.digits], axis=0)
    closed = np.where(closing > 0.0, upper, np.where(closing < 0.0, lower, hand.q_rest))
    shares = np.linspace(-0.25, 0.75, CROWDED_POSTURES)[:, None]
    qs = np.clip(hand.q_rest + shares * (closed - hand.q_rest), lower, upper)
    # Fingertips meet where a hand closes; a finger does not meet itself or the palm that soon.
    paths = [{0, *digit.chain.path} for digit in anatomy.digits]
    pairs = [(int(i), int(j)) for i, j in self_collision_pairs(hand) if any({i, j} <= path for path in paths)]
    count = np.zeros(len(pairs), dtype=int)
    for q in qs:
        at = spheres_of_links(hand, q)
        count += np.array([sphere_distance(at[i], at[j]) <= 0.0 for i, j in pairs], dtype=int)
    often = [pair for pair, n in zip(pairs, count, strict=True) if 2 * n > len(qs)]
    if often:
        text = f"{_pair_names(hand, often)} overlap in most postures between the rest posture and the closed one, so "
        text += "that most grasps will be rejected; add them to ignored_contacts where they are nested parts."
        decisions.append(Decision("warning", "hand", text))


def _check_written(model: FileModel, hand: Hand) -> None:
    """What is written can be read again: a hand that cannot is refused here, with the file that it comes from."""
    text = hand_text(hand)
    if len(text.encode()) > MAX_BYTES:
        raise HandFileError(f"{model.source}: the hand found in it has too many shapes to be written; simplify them")
    try:
        parse_hand(text, model.source)
    except HandFileError as error:
        said = str(error).removeprefix(f"{model.source}: ")
        raise HandFileError(f"{model.source}: the hand found in it cannot be used ({said})") from None


def _ignored_contacts(
    hand: Hand, model: FileModel, tree: Tree, anatomy: Anatomy, decisions: Decisions
) -> tuple[tuple[str, str], ...]:
    """Pairs that the file rules out, and links near a finger's root that are nested in the palm."""
    body_of = {member.link.name: k for k, body in enumerate(tree.members) for member in body}
    pairs: dict[tuple[int, int], None] = {}
    for first, second in model.ignored_pairs:
        i, j = sorted((body_of.get(first, -1), body_of.get(second, -1)))
        solid = i >= 0 and bool(hand.links[i].geometry) and bool(hand.links[j].geometry)
        if solid and i != j:
            pairs[i, j] = None
    if pairs:
        text = f"the file rules out contact between {_pair_names(hand, list(pairs))}; it is ignored."
        decisions.append(Decision("decided", "hand", text))
    nested = [pair for pair in _nested_in_palm(hand, anatomy) if pair not in pairs]
    if nested:
        text = (
            f"{_pair_names(hand, nested)} overlap at the zero posture and in much of their motion, as nested parts do; "
        )
        decisions.append(Decision("decided", "hand", text + "their contact is ignored."))
    gear = [pair for pair in _gear_pairs(hand, anatomy) if pair not in pairs]
    if gear:
        text = f"the bars of its gears touch what they are jointed to; contact of {_pair_names(hand, gear)} is ignored."
        decisions.append(Decision("decided", "hand", text))
    return tuple((hand.links[i].name, hand.links[j].name) for i, j in dict.fromkeys([*pairs, *nested, *gear]))


def _gear_pairs(hand: Hand, anatomy: Anatomy) -> list[tuple[int, int]]:
    """Pairs of a bar, which is part of no finger, with the palm and with the links that share its motor."""
    paths = {k for digit in anatomy.digits for k in digit.chain.path}
    C = hand.coupling_matrix != 0.0
    pairs = []
    for bar in [k for k in range(1, len(hand.links)) if k not in paths and hand.links[k].geometry]:
        mates = [k for k in range(1, len(hand.links)) if k != bar and (C[k - 1] & C[bar - 1]).any()]
        pairs += [(min(bar, k), max(bar, k)) for k in [0, *mates] if hand.links[k].geometry]
    return list(dict.fromkeys(pairs))


def _nested_in_palm(hand: Hand, anatomy: Anatomy) -> list[tuple[int, int]]:
    """Second links of fingers that are as near to the palm as nested parts at the zero posture and in their motion.

    A finger's first link is the palm's neighbor; contact of the palm with links beyond the second is one of the
    posture's. Judged is the share of the motion of the joints that carry the link, gone through evenly, and by the
    shapes, not by the spheres that stand for them, which no two fingers have alike. The thumb is judged by itself, the
    other fingers together, so that one of them that is a little farther off goes with the rest.
    """
    near: dict[str, list[tuple[int, float]]] = {"thumb": [], "others": []}
    for name, digit in zip(anatomy.names, anatomy.digits, strict=True):
        solid = [k for k in digit.chain.path if hand.links[k].geometry]
        if len(solid) < 2 or not hand.links[0].geometry:
            continue
        gaps = _gaps_to_palm(hand, digit.chain.path[: digit.chain.path.index(solid[1]) + 1])
        # A fingertip is meant to touch things, the palm among them: that it comes near is not enough.
        most = NESTED_GAP if solid[1] != digit.chain.bodies[-1] else 0.0
        if gaps[0] <= most:
            near["thumb" if name == "thumb" else "others"].append((solid[1], float((gaps[1:] <= most).mean())))
    nested = []
    for group in near.values():
        if group and np.mean([share for _, share in group]) >= NESTED_SHARE:
            nested += [(0, k) for k, share in group if share >= 0.5 * NESTED_SHARE]
    return list(dict.fromkeys(nested))


def _gaps_to_palm(hand: Hand, path: tuple[int, ...]) -> Array:
    """Distance of a path's last link from the palm at the zero posture, then evenly over its joints' ranges [m]."""
    motors = np.flatnonzero((hand.coupling_matrix[[k - 1 for k in path]] != 0.0).any(axis=0))
    count = NESTED_GRID.get(len(motors), 3)
    lower, upper = hand.limits
    zero = zero_posture(hand)
    axes = [np.linspace(lower[k], upper[k], count) for k in motors[:6]]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    qs = np.repeat(zero[None], len(grid) + 1, axis=0)
    qs[1:, motors[:6]] = grid
    R, p = link_poses(hand, qs)
    rng = np.random.default_rng(0)
    shapes = hand.links[path[-1]].geometry
    outline = np.concatenate([x for shape in shapes for x in (shape.corners(), shape.sample(OUTLINE, rng)[0])])
    gaps = np.full(len(qs), np.inf)
    for k in range(len(qs)):
        points = p[k, path[-1]] + outline @ R[k, path[-1]].T
        gaps[k] = min(float(shape.signed_distance(points).min()) for shape in hand.links[0].geometry)
    return gaps


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
