"""Convex parts by plane cuts where the hulls stand out of the mesh most, joined again where that costs nothing.

A wall of a cup needs cuts through the cup's axis, and its bottom one along the bottom. CoACD, which takes its
planes along the axes and stops by the depth of each part's hollows, leaves such walls up to 2 mm thicker.
"""

from dataclasses import dataclass

import igl
import manifold3d
import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.scene.distance import Part, sample_surface

Faces = NDArray[np.int64]

SPACING = 2.5e-3
"""Distance between the points at which a hull's bulge is measured [m]."""

LEAST_VOLUME = 1e-12
"""Smaller pieces are dropped [m^3]: a cube of 0.1 mm."""

LEAST_GAIN = 0.03
"""A cut that removes less of the hollow volume is no better than one through the middle."""

DEEPEST = 4
"""Number of places of greatest bulge through which cuts are tried."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """A piece of the solid, its hull, and how the hull stands out of the mesh.

    Attributes:
        solid: The piece; None where two pieces have been joined, which are not cut again.
        hull: Its convex hull.
        excess: Volume of the hull outside of the piece [m^3].
        bad: Area of the hull that stands out of the mesh by more than the target [m^2].
        deep: Points of greatest bulge on the hull, shape (n, 3), and the mesh's closest ones, shape (n, 3) [m].
    """

    solid: manifold3d.Manifold | None
    hull: manifold3d.Manifold
    excess: float
    bad: float
    deep: tuple[Array, Array]


class Bulge:
    """Height of points above a mesh, exact where it matters."""

    def __init__(self, vertices: Array, faces: Faces, target: float) -> None:
        """Builds the tree of the mesh.

        Args:
            vertices: Vertices [m], shape (n, 3).
            faces: Outward triangles, shape (m, 3).
            target: Bulge that is allowed [m].
        """
        self.vertices, self.faces = np.ascontiguousarray(vertices), np.ascontiguousarray(faces)
        self.target = target
        self._tree = igl.AABB()
        self._tree.init(self.vertices, self.faces)

    def of(self, points: Array) -> tuple[Array, Array]:
        """Bulge of points and the closest points of the mesh.

        Args:
            points: Points [m], shape (n, 3).

        Returns:
            Distances [m], zero inside of the mesh and where they are less than half of the target, shape (n,), and the
            closest points [m], shape (n, 3).
        """
        square, _, closest = self._tree.squared_distance(self.vertices, self.faces, np.ascontiguousarray(points))
        distance, closest = np.sqrt(np.reshape(square, -1)), np.reshape(closest, (-1, 3))
        distance[distance < 0.5 * self.target] = 0.0
        far = np.flatnonzero(distance)
        if len(far):
            inside = np.asarray(igl.fast_winding_number(self.vertices, self.faces, np.ascontiguousarray(points[far])))
            distance[far[inside > 0.5]] = 0.0
        return distance, closest


def split_by_planes(solid: manifold3d.Manifold, bulge: Bulge, *, share: float, most: int) -> list[Part]:
    """Splits a solid by planes until little of its parts' hulls stands out of a mesh.

    Args:
        solid: The solid, close to the mesh.
        bulge: Height above the mesh, with the target.
        share: Area that may bulge by more than the target [areas of the hulls' union].
        most: Greatest number of pieces before they are joined.

    Returns:
        Vertices (n, 3) [m] and outward faces (m, 3) of the parts' hulls.
    """
    allowed = share * solid.surface_area()
    pieces = [_piece(body, bulge) for body in solid.decompose() if body.volume() > LEAST_VOLUME]
    whole: list[_Piece] = []  # No cut helps these.
    while pieces and len(pieces) + len(whole) < most:
        if sum(piece.bad for piece in pieces + whole) <= allowed:
            union = manifold3d.Manifold.batch_boolean([p.hull for p in pieces + whole], manifold3d.OpType.Add)
            if (smaller := share * union.surface_area()) > 0.98 * allowed:
                break
            allowed = smaller  # The hulls' union has no creases: its area is the smaller one.
            continue
        worst = pieces.pop(max(range(len(pieces)), key=lambda k: pieces[k].bad))
        halves = _cut(worst, bulge)
        whole += [] if halves else [worst]
        pieces += halves
    pieces += whole
    pieces = _joined(pieces, bulge, max(allowed, sum(piece.bad for piece in pieces)))
    return [_arrays(piece.hull) for piece in pieces]


def _arrays(solid: manifold3d.Manifold) -> Part:
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties, dtype=np.float64)[:, :3], np.array(mesh.tri_verts, dtype=np.int64)


def _piece(solid: manifold3d.Manifold, bulge: Bulge) -> _Piece:
    hull = solid.hull()
    bad, deep = _bad_area(hull, bulge)
    return _Piece(solid, hull, hull.volume() - solid.volume(), bad, deep)


def _bad_area(hull: manifold3d.Manifold, bulge: Bulge, spacing: float = SPACING) -> tuple[float, tuple[Array, Array]]:
    area = hull.surface_area()
    points = sample_surface(*_arrays(hull), int(np.clip(area / spacing**2, 100, 4000)), 0)[0]
    height, closest = bulge.of(points)
    order, chosen = np.argsort(-height, kind="stable"), []
    for k in order[: np.count_nonzero(height)]:
        if all(np.linalg.norm(closest[k] - closest[j]) > 2.0 * SPACING for j in chosen):
            chosen.append(int(k))
            if len(chosen) == DEEPEST:
                break
    return area * float(np.mean(height > bulge.target)), (points[chosen], closest[chosen])


def _cut(piece: _Piece, bulge: Bulge) -> list[_Piece]:
    """The pieces of the best cut: that which removes most of the volume between pieces and hulls, for each new piece.

    One cut in two gains nothing on a ring, whose halves fill the same hull; so a cut in four is among those tried.
    """
    if piece.solid is None:
        return []
    singles, crosses, fallback = _planes(piece)
    best, most = [], LEAST_GAIN * piece.excess
    for planes in [*([plane] for plane in singles), *crosses, [fallback]]:
        bodies = _bodies(piece.solid, planes)
        if len(bodies) < 2:
            continue
        gain = (piece.excess - sum(body.hull().volume() - body.volume() for body in bodies)) / (len(bodies) - 1)
        if gain > most or (planes[0] is fallback and not best):
            best, most = bodies, gain
    return [_piece(body, bulge) for body in best]


def _bodies(solid: manifold3d.Manifold, planes: list[tuple[Array, float]]) -> list[manifold3d.Manifold]:
    """The connected bodies that are left of a solid when it is cut along planes."""
    pieces = [solid]
    for normal, offset in planes:
        pieces = [half for piece in pieces for half in piece.split_by_plane(normal.tolist(), float(offset))]
    return [body for piece in pieces for body in piece.decompose() if body.volume() > LEAST_VOLUME]


def _planes(
    piece: _Piece,
) -> tuple[list[tuple[Array, float]], list[list[tuple[Array, float]]], tuple[Array, float]]:
    """Cuts to try: normals and offsets. Along the axes of the frame and of the piece, and at the deepest hollows.

    Returns:
        Single planes, pairs of planes that cut in four, and the plane through the middle of the longest side.
    """
    assert piece.solid is not None
    points = sample_surface(*_arrays(piece.solid), 400, 0)[0]
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    planes = []
    for normal, shares in [(a, (0.25, 0.5, 0.75)) for a in axes] + [
        (a, (0.2, 0.35, 0.5, 0.65, 0.8)) for a in np.eye(3)
    ]:
        heights = points @ normal
        low, high = heights.min(), heights.max()
        planes += [(normal, low + share * (high - low)) for share in shares]
    for point, closest in zip(*piece.deep, strict=True):
        out = (point - closest) / np.linalg.norm(point - closest)
        planes.append((out, out @ closest))
        for axis in (*axes, *np.eye(3)):
            across = np.cross(out, axis)
            if (length := np.linalg.norm(across)) > 0.3:
                planes.append((across / length, across @ closest / length))
    center = points.mean(axis=0)
    crosses = [
        [(frame[i], frame[i] @ center), (frame[j], frame[j] @ center)]
        for frame in (axes, np.eye(3))
        for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    return planes, crosses, (axes[0], axes[0] @ (0.5 * (points.min(axis=0) + points.max(axis=0))))


def _joined(pieces: list[_Piece], bulge: Bulge, allowed: float) -> list[_Piece]:
    """Joins neighbours, those first whose common hull stands out least, as long as the sum stays within the allowed."""
    pieces, total = list(pieces), sum(piece.bad for piece in pieces)
    alive, joints = set(range(len(pieces))), {}

    def consider(i: int, j: int) -> None:
        a, b = (np.array(pieces[k].hull.bounding_box()) for k in (i, j))
        if (a[:3] > b[3:] + 1e-4).any() or (b[:3] > a[3:] + 1e-4).any():
            return
        hull = manifold3d.Manifold.batch_hull([pieces[i].hull, pieces[j].hull])
        hollow = hull.volume() - pieces[i].hull.volume() - pieces[j].hull.volume()
        if hollow > 0.5 * bulge.target * hull.surface_area():  # Spares the sampling of most pairs.
            return
        bad, deep = _bad_area(hull, bulge)
        cost = bad - pieces[i].bad - pieces[j].bad
        if cost <= allowed:
            joints[i, j] = (cost, _Piece(None, hull, 0.0, bad, deep), False)

    for i in range(len(pieces)):
        for j in range(i):
            consider(i, j)
    while joints:
        pair = min(joints, key=lambda key: (joints[key][0], key))
        cost, joint, sure = joints[pair]
        if total + cost > allowed:
            break
        if (
            not sure
        ):  # What looks best among many is likely to have been measured too well: once more, with more points.
            bad, deep = _bad_area(joint.hull, bulge, SPACING / 3.0)
            bad = max(bad, joint.bad)
            cost = bad - sum(pieces[k].bad for k in pair)
            joints[pair] = (cost, _Piece(None, joint.hull, 0.0, bad, deep), True)
            continue
        total += cost
        alive -= set(pair)
        joints = {key: value for key, value in joints.items() if not set(key) & set(pair)}
        pieces.append(joint)
        for k in sorted(alive):
            consider(len(pieces) - 1, k)
        alive.add(len(pieces) - 1)
    return [pieces[k] for k in sorted(alive)]
