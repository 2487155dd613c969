"""Another fingertip for a finger."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Finger, Geometry, Hand, Link
from xdex_drake.hand.importing.mesh_files import MeshFiles, MissingMesh
from xdex_drake.hand.importing.shape import mesh_shapes
from xdex_drake.hand.inertia import link_inertia
from xdex_drake.hand.spheres import fit_spheres


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
    try:
        mesh = MeshFiles(path).read(path.name, np.full(3, scale))
    except MissingMesh as cause:
        raise HandFileError(f"{path}: the mesh {cause}; give a readable mesh file") from None
    R, p = np.eye(3) if R_LM is None else R_LM, np.zeros(3) if p_LM is None else p_LM
    return mesh_shapes(mesh.moved(R, p), link, [])


def _moved_tip(finger: Finger, old: tuple[Geometry, ...], new: tuple[Geometry, ...]) -> Array:
    length = float(np.linalg.norm(finger.p_LTip))
    d = finger.p_LTip / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
    before = max((shape.support(d) for shape in old), default=length)
    return finger.p_LTip + (max(shape.support(d) for shape in new) - before) * d
