"""The shape of a link in the description's primitives: few of them, with few vertices, for each costs time to simulate.

Rules: spheres, boxes and capsules stay what they are. A cylinder that is at least as long as wide becomes the capsule
of the same radius and volume, a shorter one a prism. A mesh is taken apart into its pieces; a piece becomes its convex
hull, or several where that hull would stand out of its surface by more than `CONCAVITY`.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree, QhullError

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Capsule, Convex, Geometry
from xdex_drake.hand.importing.bodies import Member, Tree
from xdex_drake.hand.importing.decisions import Decision, Decisions, join
from xdex_drake.hand.importing.model import Cylinder, FileGeometry, TriangleMesh
from xdex_drake.hand.shapes import circle

Faces = NDArray[np.int64]

CONCAVITY = 4e-3
"""How far a piece's hull may stand out of its surface [m] before it is split."""

SAMPLES = 4000
"""Number of points that stand for the surface of a piece."""

CUTS = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Where cuts are tried, as shares of the length along an axis."""

OVERLAP = 1e-3
"""Both halves of a cut reach this far beyond it [m], so that no slit opens between them."""

MOST_PARTS = 8
"""Greatest number of convex parts of one link's meshes."""

MOST_VERTICES = 40
"""Greatest number of vertices of one convex part."""

HULL_LOSS = 3e-4
"""A hull leaves out vertices as long as none of them stands out of it by more than this [m]."""

THINNEST = 1e-3
"""A flat piece is thickened to this [m]."""

SMALLEST = 4e-3
"""A piece whose box has no longer diagonal than this is left out [m], where it is not the only one."""

PRISM_SIDES = 16
"""Number of sides of the prism that stands for a flat cylinder."""


def link_shapes(name: str, members: tuple[Member, ...], decisions: Decisions) -> tuple[Geometry, ...]:
    """What collides of a body, from the shapes of the links that it is made of.

    Args:
        name: The body's name, for messages.
        members: Its links.
        decisions: Grows by what was decided.

    Returns:
        Primitives in L; none where the file has no shape at all.
    """
    shapes: list[Geometry] = []
    from_visual = []
    for member in members:
        given = member.link.collision
        if not given and member.link.visual:
            given = member.link.visual
            from_visual.append(member.link.name)
        for shape in given:
            shapes.extend(_primitives(shape.moved(*_rotation_and_origin(member)), name, decisions))
    if from_visual:
        text = "has no collision shape; its visual shape is used instead."
        decisions.append(Decision("decided", f"link {join(from_visual)}", text))
    return tuple(shapes)


def without_markers(tree: Tree, decisions: Decisions) -> Tree:
    """Leaves out what is drawn to mark a frame: visual primitives of links that do not collide, on a body that does.

    Args:
        tree: The hand.
        decisions: Grows by what was decided.

    Returns:
        The hand without these shapes.
    """
    bodies, marks = [], []
    for body in tree.members:
        if any(member.link.collision for member in body):
            for k, member in enumerate(body):
                drawn = tuple(shape for shape in member.link.visual if isinstance(shape, TriangleMesh))
                if not member.link.collision and len(drawn) < len(member.link.visual):
                    body = (*body[:k], replace(member, link=replace(member.link, visual=drawn)), *body[k + 1 :])
                    marks.append(member.link.name)
        bodies.append(body)
    if marks:
        text = (
            "its visual primitives collide with nothing, though other shapes of its body do; taken as marks, left out."
        )
        decisions.append(Decision("decided", f"link {join(marks)}", text))
    return replace(tree, members=tuple(bodies))


def surface_points(members: tuple[Member, ...]) -> Array:
    """Points that span the surface of a body, of its collision shapes and of its visual ones but for marks.

    Primitives that are drawn only are marks where the body has anything that collides.

    Args:
        members: Its links.

    Returns:
        Points in L [m], shape (n, 3).
    """
    collides = any(member.link.collision for member in members)
    points = []
    for member in members:
        drawn = [shape for shape in member.link.visual if isinstance(shape, TriangleMesh) or not collides]
        points += [shape.moved(*_rotation_and_origin(member)).corners() for shape in (*member.link.collision, *drawn)]
    return np.concatenate(points) if points else np.zeros((0, 3))


def _rotation_and_origin(member: Member) -> tuple[Array, Array]:
    return member.X_LF[:3, :3], member.X_LF[:3, 3]


def _primitives(shape: FileGeometry, name: str, decisions: Decisions) -> tuple[Geometry, ...]:
    if isinstance(shape, Cylinder):
        return (_from_cylinder(shape),)
    if isinstance(shape, TriangleMesh):
        return mesh_shapes(shape, name, decisions)
    return (shape,)


def mesh_shapes(mesh: TriangleMesh, name: str, decisions: Decisions) -> tuple[Geometry, ...]:
    """Convex parts of a mesh.

    Args:
        mesh: The mesh, in L.
        name: Name of its body, for messages.
        decisions: Grows by what was decided.

    Returns:
        The parts, in L; none where the mesh has no usable triangle.
    """
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
        text = f"the mesh {mesh.source or 'of it'} has no usable triangle and is left out."
        decisions.append(Decision("warning", f"link {name}", text))
        return ()
    origin = mesh.vertices.mean(axis=0)
    # Links that use one mesh share its parts: the same vertices in another frame differ in their last digits.
    parts = _mesh_parts(np.round(mesh.vertices - origin, 9).tobytes(), np.asarray(mesh.faces, dtype=np.int64).tobytes())
    return tuple(Convex(part + origin) for part in parts)


def _from_cylinder(cylinder: Cylinder) -> Geometry:
    d = cylinder.p1 - cylinder.p0
    length = float(np.linalg.norm(d))
    u = d / max(length, 1e-12)
    middle, r = 0.5 * (cylinder.p0 + cylinder.p1), cylinder.radius
    if length >= 2.0 * r:
        half = 0.5 * (length - 4.0 / 3.0 * r)
        return Capsule(middle - half * u, middle + half * u, r)
    ring = circle(u, r, np.linspace(0.0, 2.0 * np.pi, PRISM_SIDES, endpoint=False))
    return Convex(np.concatenate([ring + cylinder.p0, ring + cylinder.p1]))


@lru_cache(maxsize=256)
def _mesh_parts(vertices: bytes, faces: bytes) -> tuple[Array, ...]:
    """Corners of the convex parts of a mesh."""
    points = np.frombuffer(vertices).reshape(-1, 3)
    triangles = np.frombuffer(faces, dtype=np.int64).reshape(-1, 3)
    pieces = _pieces(points, triangles)
    return tuple(_merge([part for piece in pieces for part in _split(*piece)]))


def _pieces(points: Array, faces: Faces) -> list[tuple[Array, Faces]]:
    """Connected pieces of a mesh, without those that others contain or that are too small to matter."""
    _, first, weld = np.unique(np.round(points, 6), axis=0, return_index=True, return_inverse=True)
    points, faces = points[first], np.asarray(weld.reshape(-1)[faces], dtype=np.int64)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(points), len(points)))
    count, label = connected_components(graph, directed=False)
    if count > 1:
        boxes = [(np.ptp(points[label == k], axis=0), k) for k in np.unique(label[faces[:, 0]])]
        order = [k for _, k in sorted(((-float(np.linalg.norm(box)), int(k)) for box, k in boxes))]
    else:
        order = [0]
    kept: list[tuple[Array, Faces]] = []
    bodies: list[tuple[Array, Array]] = []
    for k in order:
        mine = points[label == k]
        if kept and np.linalg.norm(np.ptp(mine, axis=0)) < SMALLEST:
            break
        if any((mine @ n.T <= d + 5e-4).all() for n, d in bodies):
            continue
        number = np.full(len(points), -1, dtype=np.int64)
        number[label == k] = np.arange(len(mine))
        kept.append((mine, number[faces[label[faces[:, 0]] == k]]))
        hull = _hull(mine)
        bodies.append((hull.equations[:, :3], -hull.equations[:, 3]))
        if len(kept) >= 24:
            break
    return kept


def _hull(points: Array) -> ConvexHull:
    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return ConvexHull(_thickened(points))


def _thickened(points: Array) -> Array:
    """Flat or straight points, moved both ways along the directions in which they have no extent."""
    center = points.mean(axis=0)
    axes = np.linalg.svd(points - center, full_matrices=True)[2] if len(points) > 1 else np.eye(3)
    out = points
    for axis in axes:
        if np.ptp(points @ axis) < THINNEST:
            out = np.concatenate([out - 0.5 * THINNEST * axis, out + 0.5 * THINNEST * axis])
    return out


def small_hull(points: Array) -> Array:
    """Corners of a convex hull of few vertices: the points that matter most, taken greedily from the farthest.

    Args:
        points: Points [m], shape (n, 3); flat ones are thickened.

    Returns:
        Corners [m], shape (m, 3), m at most `MOST_VERTICES`.
    """
    hull = _hull(points)
    points = hull.points[hull.vertices]
    if len(points) <= 8:
        return points
    directions = np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]]])
    chosen = list(dict.fromkeys(int(k) for k in (points @ directions.T).argmax(axis=0)))
    while len(chosen) < min(MOST_VERTICES, len(points)):
        try:
            hull = ConvexHull(points[chosen])
        except QhullError:
            return points[:: max(1, len(points) // MOST_VERTICES)][:MOST_VERTICES]
        outside = (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
        far = int(outside.argmax())
        if outside[far] <= HULL_LOSS or far in chosen:
            break
        chosen.append(far)
    return points[sorted(chosen)]


def _samples(points: Array, faces: Faces, count: int) -> Array:
    """Points on triangles, evenly by area; the same for the same mesh."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rng = np.random.default_rng(0)
    total = float(area.sum())
    if total <= 0.0:
        return points
    pick = rng.choice(len(faces), size=count, p=area / total)
    u, v = rng.random((2, count, 1))
    flip = u + v > 1.0
    u, v = np.where(flip, 1.0 - u, u), np.where(flip, 1.0 - v, v)
    return a[pick] + u * (b[pick] - a[pick]) + v * (c[pick] - a[pick])


def _split(points: Array, faces: Faces) -> list[Array]:
    """Corners of convex parts of a connected piece: one hull, or several where one would fill a concavity.

    The piece is cut in two by the plane across one of its principal axes that leaves least volume in the two hulls, and
    each half again, as long as some hull stands out of the surface by more than `CONCAVITY`. It works on points of the
    surface, so it needs no closed mesh; a few milliseconds a cut.
    """
    surface = _samples(points, faces, SAMPLES)
    tree = KDTree(surface)
    spacing = float(np.median(tree.query(surface[::10], k=2)[0][:, 1]))
    hull = _hull(points)  # Of flat pieces it has other points than they.
    whole = np.concatenate([surface, hull.points[hull.vertices]])
    parts: list[tuple[Array, list[tuple[Array, float]]]] = [(whole, [])]
    done: list[Array] = []
    while parts:
        part, planes = parts.pop(0)
        full = len(parts) + len(done) + 2 > MOST_PARTS
        halves = None if full or _bulge(part, planes, tree, spacing) <= CONCAVITY else _halves(part)
        if halves is None:
            done.append(small_hull(part))
            continue
        low, high, plane = halves
        parts += [(low, [*planes, plane]), (high, [*planes, plane])]
    return done


def _bulge(part: Array, planes: list[tuple[Array, float]], surface: KDTree, spacing: float) -> float:
    """How far a part's hull stands out of the surface, where 95 % of it does not stand out farther [m].

    What lies on a cut is inside of the piece and does not count.
    """
    body = _hull(part)
    shell = _samples(body.points, body.simplices.astype(np.int64), 500)
    for normal, offset in planes:
        shell = shell[np.abs(shell @ normal - offset) > OVERLAP + 1e-4]
    if len(shell) < 20:
        return 0.0
    return float(np.percentile(surface.query(shell)[0], 95)) - spacing


def _halves(part: Array) -> tuple[Array, Array, tuple[Array, float]] | None:
    """A part cut in two, with the plane (unit normal, offset); None where no cut leaves less volume."""
    volume = float(_hull(part).volume)
    axes = np.linalg.svd(part - part.mean(axis=0), full_matrices=False)[2]
    few = part[:: max(1, len(part) // 700)]
    best: tuple[float, Array, float] = (0.97 * volume, axes[0], np.nan)
    for axis in axes:
        s = part @ axis
        for share in CUTS:
            offset = float(s.min() + share * np.ptp(s))
            low, high = few[few @ axis <= offset], few[few @ axis > offset]
            if min(len(low), len(high)) < 12:
                continue
            both = float(_hull(low).volume + _hull(high).volume)
            if both < best[0]:
                best = (both, axis, offset)
    _, axis, offset = best
    if np.isnan(offset):
        return None
    s = part @ axis
    low, high = part[s <= offset + OVERLAP], part[s >= offset - OVERLAP]
    return (low, high, (axis, offset)) if min(len(low), len(high)) >= 4 else None


def _merge(parts: list[Array]) -> list[Array]:
    """Joins parts, those first whose common hull adds least volume, until few are left."""
    parts = list(parts)
    volumes = [float(ConvexHull(part).volume) for part in parts]
    cost: dict[tuple[int, int], float] = {}
    alive = list(range(len(parts)))

    def price(i: int, j: int) -> float:
        if (i, j) not in cost:
            both = float(ConvexHull(np.concatenate([parts[i], parts[j]])).volume)
            cost[i, j] = both - volumes[i] - volumes[j]
        return cost[i, j]

    while len(alive) > 1:
        i, j = min(((i, j) for n, i in enumerate(alive) for j in alive[n + 1 :]), key=lambda pair: price(*pair))
        worthless = price(i, j) <= 0.03 * (volumes[i] + volumes[j])
        if len(alive) <= MOST_PARTS and not worthless:
            break
        parts.append(small_hull(np.concatenate([parts[i], parts[j]])))
        volumes.append(float(ConvexHull(parts[-1]).volume))
        alive = [k for k in alive if k not in (i, j)] + [len(parts) - 1]
    return [parts[k] for k in alive]
