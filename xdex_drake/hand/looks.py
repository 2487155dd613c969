"""What a hand looks like: surfaces to draw, made from the facts that the hand consists of.

Nothing here is touched: collision, certificates and the digest know the primitives of the links alone. A look follows
them to a fraction of a millimeter where an object can touch, so that a contact is seen where it is. Primitives of a
link flow into one rounded surface; joints get drums, gaps between links struts, fingertips pads (people: nails).
A hand whose file brought surfaces of its own (`Link.surfaces`) is drawn by those, and by nothing that is made here but
the bodies of links without any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Box, Capsule, Convex, Finger, Geometry, Hand, Link, Sphere
from xdex_drake.hand.surface import Color, Faces, Surface

FINGER_COLORS = {
    "thumb": (0.84, 0.42, 0.30),
    "index": (0.30, 0.53, 0.78),
    "middle": (0.36, 0.66, 0.47),
    "ring": (0.90, 0.70, 0.30),
    "little": (0.60, 0.45, 0.72),
}
"""Color (red, green, blue) of each finger's pad."""

OTHER_FINGER_COLOR = (0.45, 0.65, 0.68)
PALM_COLOR = (0.33, 0.36, 0.41)
SHELL_COLOR = (0.80, 0.82, 0.85)
METAL_COLOR = (0.20, 0.21, 0.24)
SKIN_COLOR = (0.87, 0.67, 0.55)
NAIL_COLOR = (0.95, 0.80, 0.75)

FILLET = 4e-3
"""Radius over which primitives of a link flow into each other [m]."""

EDGE = 6e-3
"""Greatest radius of a box's edges [m]."""

SMOOTHING = 6
"""Rounds by which a body of several primitives is smoothed."""

PAD_RISE = 4e-4
"""How far a pad stands out of its link [m]."""


@dataclass(frozen=True)
class Detail:
    """How finely surfaces are drawn.

    Attributes:
        part: Squares along each face of a cube that becomes a part's ball.
        body: The same for a body of several primitives.
        palm: The same for a body of many.
        drum: Sides of a drum.
    """

    part: int
    body: int
    palm: int
    drum: int


FINE = Detail(part=5, body=7, palm=13, drum=16)
"""For a page of a few hands: some 12 000 triangles a hand."""

COARSE = Detail(part=3, body=4, palm=7, drum=8)
"""For a page of many hands: some 4000 triangles a hand."""


@lru_cache(maxsize=64)
def hand_surfaces(hand: Hand, detail: Detail = FINE) -> tuple[tuple[Surface, ...], ...]:
    """What is drawn of each link of a hand.

    Args:
        hand: The hand.
        detail: How finely.

    Returns:
        The surfaces of each link, in the order of `hand.links`.
    """
    human = hand.sources.get("base", "").startswith("human")
    colors = shell_colors(hand, human)
    drawn = [
        list(link.surfaces) or _body(link.geometry, color, detail)
        for link, color in zip(hand.links, colors, strict=True)
    ]
    if any(link.surfaces for link in hand.links):
        return tuple(tuple(surfaces) for surfaces in drawn)
    for finger in hand.fingers:
        tip = hand.link_index[finger.tip_link]
        if hand.links[tip].geometry:
            drawn[tip].append((_nail if human else _pad)(hand, finger, detail))
    for k, surfaces in enumerate(_joint_surfaces(hand, human, detail)):
        drawn[k] += surfaces
    return tuple(tuple(surfaces) for surfaces in drawn)


def primitive_surface(shape: Geometry, color: Color, detail: Detail = FINE) -> Surface:
    """The surface of a primitive by itself, edges of a box rounded.

    Args:
        shape: The primitive.
        color: Red, green, blue.
        detail: How finely.

    Returns:
        The surface, in L.
    """
    return _one(shape, color, detail)


def surface_obj(surfaces: Sequence[Surface]) -> str:
    """Surfaces as one OBJ file with normals.

    Args:
        surfaces: The surfaces, in one frame.

    Returns:
        The file's text.
    """
    lines, first = [], 1
    for surface in surfaces:
        lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in surface.vertices.tolist()]
        lines += [f"vn {x:.2f} {y:.2f} {z:.2f}" for x, y, z in surface.normals.tolist()]
        lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (surface.faces + first).tolist()]
        first += len(surface.vertices)
    return "\n".join(lines) + "\n"


def link_colors(hand: Hand) -> list[Array]:
    """Color of each link's primitives (red, green, blue, opacity), shape (4,): a finger's lightens toward its tip."""
    colors = {}
    for finger in hand.fingers:
        for k, name in enumerate(finger.links):
            colors[name] = _mixed(finger_color(finger), (1.0, 1.0, 1.0), 0.35 * (k + 1) / len(finger.links))
    return [np.array([*colors.get(link.name, PALM_COLOR), 1.0]) for link in hand.links]


def finger_color(finger: Finger) -> Color:
    """The color by which a finger is told."""
    return FINGER_COLORS.get(finger.name, OTHER_FINGER_COLOR)


# ---- colors


def shell_colors(hand: Hand, human: bool = False) -> list[Color]:
    """Color of each link's body, in the order of `hand.links`: skin, or a shell with a tint of its finger's color."""
    if human:
        return [SKIN_COLOR] * len(hand.links)
    colors: dict[str, Color] = {}
    for finger in hand.fingers:
        for name in finger.links:
            colors[name] = _mixed(SHELL_COLOR, finger_color(finger), 0.22)
    return [colors.get(link.name, PALM_COLOR) for link in hand.links]


def _mixed(a: Color, b: Color, share: float) -> Color:
    x, y, z = (1.0 - share) * np.array(a) + share * np.array(b)
    return float(x), float(y), float(z)


# ---- bodies


def _body(shapes: Sequence[Geometry], color: Color, detail: Detail) -> list[Surface]:
    """The primitives of a link as one surface where one point sees all of them, else each by itself."""
    if not shapes:
        return []
    if len(shapes) > 1 or isinstance(shapes[0], Convex):
        center = _seeing_center(shapes)
        if center is not None:
            return [_star(shapes, center, color, detail)]
    return [_one(shape, color, detail) for shape in shapes]


def _one(shape: Geometry, color: Color, detail: Detail) -> Surface:
    """A primitive by itself: a ball's surface whose parts are moved apart."""
    if isinstance(shape, Convex):
        return _star([shape], shape.vertices.mean(axis=0), color, detail)
    v, faces = _cube_sphere(detail.part)
    if isinstance(shape, Sphere):
        return Surface(shape.center + shape.radius * v, v, faces, color)
    if isinstance(shape, Box):
        edge = _edge(shape)
        points = edge * v + np.sign(v) * (0.5 * shape.size - edge)
        return Surface(points @ shape.R_LG.T + shape.p_LG, v @ shape.R_LG.T, faces, color)
    axis = shape.axis
    along = (v @ axis)[:, None]
    points = shape.radius * v + np.where(along > 0.0, shape.p1, shape.p0)
    return Surface(points, v, faces, color)


def _edge(box: Box) -> float:
    return min(EDGE, 0.35 * float(np.min(box.size)))


@lru_cache(maxsize=4)
def _cube_sphere(n: int) -> tuple[Array, Faces]:
    """The unit sphere by n x n squares on each face of a cube; for odd n no corner lies on a coordinate plane."""
    t = np.tan(np.linspace(-0.25 * np.pi, 0.25 * np.pi, n + 1))
    a, b = (grid.ravel() for grid in np.meshgrid(t, t, indexing="ij"))
    m = len(t)
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(m - 1), np.arange(m - 1), indexing="ij"))
    corner = i * m + j
    squares = np.concatenate(
        [np.stack([corner, corner + m, corner + m + 1], axis=1), np.stack([corner, corner + m + 1, corner + 1], axis=1)]
    )
    vertices, faces = [], []
    for axis in range(3):
        for sign in (1.0, -1.0):
            side = np.zeros((m * m, 3))
            side[:, axis], side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = sign, a, b
            faces.append((squares if sign > 0 else squares[:, ::-1]) + len(vertices) * m * m)
            vertices.append(side)
    mesh = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
    mesh.merge_vertices(digits_vertex=9)
    points = np.asarray(mesh.vertices)
    return points / np.linalg.norm(points, axis=1, keepdims=True), np.asarray(mesh.faces, dtype=np.int64)


def _key_points(shape: Geometry) -> Array:
    if isinstance(shape, Capsule):
        return np.array([shape.p0, shape.p1])
    if isinstance(shape, Sphere):
        return np.asarray(shape.center)[None]
    if isinstance(shape, Box):
        return np.asarray(shape.p_LG)[None]
    return shape.vertices.mean(axis=0, keepdims=True)


def _seeing_center(shapes: Sequence[Geometry]) -> Array | None:
    """A point inside from which the middles of all primitives are seen through their inside; None where none does."""
    keys = np.concatenate([_key_points(shape) for shape in shapes])
    volumes = [shape.volume() for shape in shapes]
    weights = np.array([v.volume for v in volumes])
    middle = weights @ np.array([v.p_LCenter for v in volumes]) / weights.sum()
    candidates = [middle, keys.mean(axis=0), *keys]
    s = np.linspace(0.0, 1.0, 13)[:, None]
    for center in candidates:
        paths = np.concatenate([center + s * (key - center) for key in keys])
        if (_distance(shapes, paths) < 0.0).all():
            return np.asarray(center)
    return None


def _distance(shapes: Sequence[Geometry], points: Array) -> Array:
    """Signed distance to the primitives flowing into each other, boxes with rounded edges [m]."""
    total: Array | None = None
    for shape in shapes:
        if isinstance(shape, Box):
            edge = _edge(shape)
            d = Box(shape.size - 2.0 * edge, shape.p_LG, shape.R_LG).signed_distance(points) - edge
        else:
            d = shape.signed_distance(points)
        if total is None:
            total = d
            continue
        # The smooth minimum of Quilez (2013): nothing changes where the distances differ by more than the fillet.
        h = np.maximum(FILLET - np.abs(total - d), 0.0) / FILLET
        total = np.minimum(total, d) - 0.25 * FILLET * h**2
    assert total is not None
    return total


def _star(shapes: Sequence[Geometry], center: Array, color: Color, detail: Detail) -> Surface:
    """The outermost surface that rays from a point meet: every ray is walked inward until it is there."""
    corners = np.concatenate([shape.corners() for shape in shapes])
    # Directions are spread as on an ellipsoid of the body's shape: a long finger is not drawn by its sides alone.
    spread = corners - center
    axes = np.linalg.svd(spread - spread.mean(axis=0), full_matrices=False)[2]
    reach = np.abs(spread @ axes.T).max(axis=0)
    ball, faces = _cube_sphere(detail.palm if len(shapes) > 3 or isinstance(shapes[0], Convex | Box) else detail.body)
    start = center + (ball * reach * 1.8) @ axes
    ray = center - start
    length = np.linalg.norm(ray, axis=1, keepdims=True)
    ray, t = ray / length, np.zeros(len(start))
    for _ in range(60):
        t = np.minimum(t + 0.9 * np.maximum(_distance(shapes, start + t[:, None] * ray), 0.0), length[:, 0])
    points = start + t[:, None] * ray
    if np.linalg.det(axes) < 0.0:
        faces = faces[:, ::-1]
    mesh = trimesh.Trimesh(points, faces, process=False)
    # What is left of the grooves that rays skim is smoothed without shrinking the body (Taubin 1995).
    trimesh.smoothing.filter_taubin(mesh, lamb=0.5, nu=0.53, iterations=SMOOTHING)
    return Surface(np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals, dtype=float), faces, color)


# ---- parts of fingers


def _tip_frame(hand: Hand, finger: Finger) -> tuple[Array, Array, Array]:
    """Along the last link toward the tip, out of the pad, and across, unit vectors in its frame."""
    link = hand.links[hand.link_index[finger.tip_link]]
    middle = np.mean([shape.volume().p_LCenter for shape in link.geometry], axis=0)
    pad = finger.n_LPad
    along = finger.p_LTip - middle
    along = along - (along @ pad) * pad
    length = float(np.linalg.norm(along))
    along = along / length if length > 1e-6 else np.linalg.svd(pad[None])[2][1]
    return along, pad, np.asarray(np.cross(along, pad), dtype=float)


def _patch(hand: Hand, finger: Finger, side: float, back: float, size: Array, color: Color, detail: Detail) -> Surface:
    """A flattened ball on the last link of a finger: on its pad (side 1) or behind it (side -1)."""
    link = hand.links[hand.link_index[finger.tip_link]]
    along, pad, across = _tip_frame(hand, finger)
    out = side * pad
    radius = float(np.linalg.norm(size[:2])) / np.sqrt(2.0)
    inside = finger.p_LTip - back * radius * along
    # The surface is looked for from far out.
    t = 0.05
    for _ in range(60):
        t -= 0.9 * max(float(_distance(link.geometry, (inside + t * out)[None])[0]), 0.0)
        if t < -0.02:
            break
    top = inside + max(t, 0.0) * out
    v, faces = _cube_sphere(detail.part)
    frame = np.stack([along, across, out])
    points = top + (PAD_RISE - size[2]) * out + (v * size) @ frame
    normals = (v / size) @ frame
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Surface(points, normals, faces if np.linalg.det(frame) > 0.0 else faces[:, ::-1], color)


def _tip_radius(hand: Hand, finger: Finger) -> float:
    """Radius of the shape that is nearest to a fingertip [m]."""
    shapes = hand.links[hand.link_index[finger.tip_link]].geometry
    nearest = min(shapes, key=lambda shape: float(shape.signed_distance(finger.p_LTip)))
    if isinstance(nearest, Capsule | Sphere):
        return nearest.radius
    return 0.35 * float(np.min(np.ptp(nearest.bounds(), axis=0)))


def _pad(hand: Hand, finger: Finger, detail: Detail) -> Surface:
    size = _tip_radius(hand, finger) * np.array([1.15, 0.78, 0.55])
    return _patch(hand, finger, 1.0, 1.15, size, finger_color(finger), detail)


def _nail(hand: Hand, finger: Finger, detail: Detail) -> Surface:
    size = _tip_radius(hand, finger) * np.array([0.80, 0.62, 0.40])
    return _patch(hand, finger, -1.0, 0.85, size, NAIL_COLOR, detail)


def _joint_surfaces(hand: Hand, human: bool, detail: Detail) -> list[list[Surface]]:
    """Drums at hinges, and struts where links are apart."""
    drawn: list[list[Surface]] = [[] for _ in hand.links]
    for k, joint in enumerate(hand.joints):
        parent, child = int(hand.parents[k + 1]), k + 1
        ends = ((parent, joint.p_PJ), (child, np.zeros(3)))
        depths = [_depth(hand.links[link], p) for link, p in ends]
        color = SKIN_COLOR if human else METAL_COLOR
        radius = float(np.clip(max(depths), 4e-3, 1.1e-2))
        for (link, p), depth in zip(ends, depths, strict=True):
            if depth < -1e-3:
                foot = _foot(hand.links[link], p)
                if foot is not None:
                    drawn[link].append(_one(Capsule(p, foot, 0.8 * radius), color, detail))
        if not hand.links[child].geometry:
            # A hub without shape is drawn by what it ties together.
            for out, other in zip(hand.joints, hand.parents[1:], strict=True):
                if int(other) == child and np.linalg.norm(out.p_PJ) > 1e-3:
                    drawn[child].append(_one(Capsule(np.zeros(3), out.p_PJ, 0.8 * radius), color, detail))
        if joint.kind == "revolute" and not human:
            drawn[child].append(_drum(joint.axis, 0.55 * radius, 1.06 * radius, detail.drum))
    return drawn


def _depth(link: Link, p: Array) -> float:
    """How deep a point is in a link, negative outside [m]; 0 where the link has no shape."""
    return -float(min(shape.signed_distance(p) for shape in link.geometry)) if link.geometry else 0.0


def _foot(link: Link, p: Array) -> Array | None:
    """The middle of the shape that is nearest to a point: where a strut ends."""
    nearest = min(link.geometry, key=lambda shape: float(shape.signed_distance(p)))
    keys = _key_points(nearest)
    if isinstance(nearest, Capsule):
        along = nearest.p1 - nearest.p0
        t = np.clip((p - nearest.p0) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        return nearest.p0 + t * along
    foot = keys[0]
    for _ in range(30):
        # Halfway toward the middle until it is inside by some millimeters.
        if float(nearest.signed_distance(p)) < -4e-3:
            return p
        p = p + 0.2 * (foot - p)
    return p


def _drum(axis: Array, radius: float, half: float, sides: int) -> Surface:
    """A cylinder with beveled rims about an axis through the origin."""
    bevel = 0.2 * radius
    profile = np.array(
        [
            [0.0, half],
            [radius - bevel, half],
            [radius, half - bevel],
            [radius, bevel - half],
            [radius - bevel, -half],
            [0.0, -half],
        ]
    )
    basis = np.linalg.svd(np.asarray(axis, dtype=float)[None])[2]
    basis[2] *= np.linalg.det(basis)
    angles = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.concatenate([np.column_stack([np.full(sides, z), r * ring]) for r, z in profile])
    slope = np.diff(profile, axis=0)
    # Each band has corners of its own, so that its rims stay sharp.
    bands, normals, faces = [], [], []
    at = np.arange(sides)
    after = (at + 1) % sides
    for k, (dr, dz) in enumerate(slope):
        first = 2 * sides * k
        bands += [points[sides * k : sides * (k + 2)]]
        out = np.array([-dz, dr]) / np.hypot(dr, dz)
        normals += [np.tile(np.column_stack([np.full(sides, out[1]), out[0] * ring]), (2, 1))]
        low, high = first + at, first + sides + at
        low2, high2 = first + after, first + sides + after
        faces += [np.stack([low, high, high2], axis=1), np.stack([low, high2, low2], axis=1)]
    return Surface(np.concatenate(bands) @ basis, np.concatenate(normals) @ basis, np.concatenate(faces), METAL_COLOR)
