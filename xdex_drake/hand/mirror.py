"""A left hand from a right one, and another fingertip for a finger."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Finger, Geometry, Hand, Joint, Link
from xdex_drake.hand.inertia import link_inertia
from xdex_drake.hand.shapes import FLIP
from xdex_drake.hand.spheres import fit_spheres

_OTHER = {"right": "left", "left": "right"}
_NOTE = "mirror"


def mirror(hand: Hand) -> Hand:
    """The mirror image of a hand: a left one of a right one and the other way round.

    Every frame F of the hand becomes S X_HF S with S the reflection in the plane y = 0 of the wrist frame H, so each
    joint keeps its name, its limits and its values, and the same q gives the mirrored pose. Mirroring twice gives the
    hand itself.

    Args:
        hand: The hand.

    Returns:
        Its mirror image, named with `_left` in the place of `_right` or at the end, and the other way round.
    """
    sources = {key: text for key, text in hand.sources.items() if key != _NOTE}
    original = re.fullmatch(r"mirror image of (\S+) \((.*)\)", hand.sources.get(_NOTE, ""))
    if original is not None:
        name, display_name = original.groups()
    else:
        name = _mirrored_name(hand.name, hand.side, "_")
        display_name = _mirrored_name(hand.display_name, hand.side, ", ")
        sources[_NOTE] = f"mirror image of {hand.name} ({hand.display_name})"
    return Hand(
        name=name,
        display_name=display_name,
        side=_OTHER[hand.side],
        links=tuple(_mirrored_link(link) for link in hand.links),
        joints=tuple(_mirrored_joint(joint) for joint in hand.joints),
        fingers=tuple(replace(f, p_LTip=_flip(f.p_LTip), n_LPad=_flip(f.n_LPad)) for f in hand.fingers),
        p_HB=_flip(hand.p_HB),
        R_HB=_flip_rotation(hand.R_HB),
        q_rest=hand.q_rest,
        sources=sources,
        ignored_contacts=hand.ignored_contacts,
    )


def _mirrored_name(name: str, side: str, separator: str) -> str:
    """`allegro` becomes `allegro_left`, `svh_right` becomes `svh_left`."""
    words = name.split(separator)
    if side in words:
        return separator.join(_OTHER[side] if word == side else word for word in words)
    return f"{name}{separator}{_OTHER[side]}"


def _flip(v: Array) -> Array:
    return v * FLIP


def _flip_rotation(R: Array) -> Array:
    return R * np.outer(FLIP, FLIP)


def _mirrored_link(link: Link) -> Link:
    return Link(
        link.name,
        tuple(shape.mirrored() for shape in link.geometry),
        link.mass,
        _flip(link.p_LLcm),
        _flip_rotation(link.I_LLcm),
        link.spheres * np.array([*FLIP, 1.0]),
    )


def _mirrored_joint(joint: Joint) -> Joint:
    # Turning about a, seen in a mirror, is turning about -S a by the same angle.
    sign = 1.0 if joint.kind == "prismatic" else -1.0
    return replace(joint, p_PJ=_flip(joint.p_PJ), R_PJ=_flip_rotation(joint.R_PJ), axis=sign * _flip(joint.axis))


def replace_tip(
    hand: Hand,
    finger: str,
    geometry: Sequence[Geometry] | str | Path,
    *,
    scale: float = 1.0,
    p_LM: Array | None = None,
    R_LM: Array | None = None,
    mass: float | None = None,
) -> Hand:
    """Gives a finger another fingertip: the shape of its last link, with spheres, inertia and tip point to match.

    Args:
        hand: The hand.
        finger: Name of the finger.
        geometry: Primitives in the frame L of the finger's tip link, or a mesh file, which becomes convex parts.
        scale: Factor from the mesh file's unit to metres.
        p_LM: Origin of the mesh's frame M in L [m], shape (3,); zero where None.
        R_LM: Rotation of M in L, shape (3, 3); the identity where None.
        mass: Mass of the new tip link [kg]; that of its volume at the usual density where None.

    Returns:
        The hand with the new tip. The tip point moves with the surface, along the direction from the link's origin to
        the old tip point; the pad's direction stays.

    Raises:
        HandFileError: There is no such finger, or the mesh cannot be used.
    """
    found = next((f for f in hand.fingers if f.name == finger), None)
    if found is None:
        known = ", ".join(f.name for f in hand.fingers)
        raise HandFileError(f"hand {hand.name}: there is no finger {finger!r}; name one of {known}")
    index = hand.link_index[found.tip_link]
    old = hand.links[index]
    if isinstance(geometry, str | Path):
        shapes = _mesh_parts(Path(geometry), old.name, scale, p_LM, R_LM)
        source = Path(geometry).name
    else:
        shapes, source = tuple(geometry), "primitives of the user's"
    if not shapes:
        raise HandFileError(f"hand {hand.name}: the new tip of {finger!r} has no shape; give at least one primitive")
    link = Link(old.name, shapes, *link_inertia(shapes, mass), fit_spheres(shapes))
    tip = replace(found, p_LTip=_moved_tip(found, old.geometry, shapes))
    return replace(
        hand,
        links=(*hand.links[:index], link, *hand.links[index + 1 :]),
        fingers=tuple(tip if f is found else f for f in hand.fingers),
        sources={**hand.sources, f"tip of {finger}": source},
    )


def _mesh_parts(path: Path, link: str, scale: float, p_LM: Array | None, R_LM: Array | None) -> tuple[Geometry, ...]:
    from xdex_drake.hand.importing.bodies import Member
    from xdex_drake.hand.importing.mesh_files import MeshFiles, MissingMesh, placed
    from xdex_drake.hand.importing.model import FileLink
    from xdex_drake.hand.importing.shape import link_shapes

    try:
        mesh = MeshFiles(path).read(path.name, np.full(3, scale))
    except MissingMesh as cause:
        raise HandFileError(f"{path}: the mesh {cause}; give a readable mesh file") from None
    R, p = np.eye(3) if R_LM is None else R_LM, np.zeros(3) if p_LM is None else p_LM
    return link_shapes(link, (Member(FileLink(link, (), (placed(mesh, R, p),)), np.eye(4), True),), [])


def _moved_tip(finger: Finger, old: tuple[Geometry, ...], new: tuple[Geometry, ...]) -> Array:
    length = float(np.linalg.norm(finger.p_LTip))
    d = finger.p_LTip / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
    before = max((shape.support(d) for shape in old), default=length)
    return finger.p_LTip + (max(shape.support(d) for shape in new) - before) * d
