"""Spheres that stand for a link's geometry in the terms of a grasp program.

A capsule is swept by a sphere, so spheres along its axis miss its surface by the scallop between two of them alone. A
box or a convex hull is covered from inside by a greedy choice: each sphere bulges out of a face by a stated amount, and
the one that covers most of the surface left comes first.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.distance import cdist

from xdex_drake.arrays import Array
from xdex_drake.hand.shapes import Geometry, Round, Solid, values_of

SCALLOP = 4e-4
"""Greatest depth of the groove between neighboring spheres of a capsule [m], where the number of spheres allows it."""

MAX_PER_CAPSULE = 12
"""Greatest number of spheres of one capsule."""

BULGE = 2.8e-3
"""How far a sphere of a box or hull reaches beyond its surface [m]."""

REACH = 2.8e-3
"""Distance from a sphere at which a point of a box or hull counts as covered [m]."""

CANDIDATES = 700
"""Number of candidate centers in a box or hull, roughly."""

MOST_CANDIDATES, MOST_ALONG = 6000, 100
"""Greatest number of candidate centers in one box or hull, and along its longest side."""

MAX_PER_SOLID = 36
"""Greatest number of spheres of one box or hull."""

MAX_TOGETHER = 80
"""Greatest number of spheres of all boxes and hulls of a link that is covered as a whole."""

LEFT_TOGETHER = 0.015
"""Share of the surface points of such a link that may stay uncovered: corners and edges, of which there are many."""


def fit_spheres(geometry: tuple[Geometry, ...]) -> Array:
    """Spheres that approximate a link's geometry.

    Spheres of a capsule have its radius, lie on its axis and include both ends. Spheres of a box or hull bulge by at
    most `BULGE`; together they come within `REACH` of nearly all of its surface. A link of three shapes or more, among
    them two boxes or hulls, is covered as a whole: a sphere may span several shapes. The result depends on the input
    alone.

    Args:
        geometry: Primitives in L.

    Returns:
        Rows (x, y, z, radius) in L [m], shape (n, 4); shape (0, 4) for a link without geometry.
    """
    solids = sum(isinstance(shape, Solid) for shape in geometry)
    if len(geometry) >= 3 and solids >= 2:
        return _spheres_of_known_parts(_Key(-1, geometry)).copy()
    rows = [_spheres_of(k, geometry) for k in range(len(geometry))]
    return np.concatenate(rows) if rows else np.zeros((0, 4))


def _spheres_of(k: int, geometry: tuple[Geometry, ...]) -> Array:
    shape = geometry[k]
    if isinstance(shape, Round):
        return shape.balls(SCALLOP, MAX_PER_CAPSULE)
    # A box or hull takes some 50 ms; reading, writing and varying a hand all ask for the same ones.
    return _spheres_of_known_solid(_Key(k, geometry)).copy()


class _Key:
    """A primitive among others, or all of them (k = -1), by value."""

    def __init__(self, k: int, geometry: tuple[Geometry, ...]) -> None:
        self.k, self.geometry = k, geometry
        values = [value for shape in geometry for value in values_of(shape)]
        self.value = (k, *(v if isinstance(v, str) else np.asarray(v).tobytes() for v in values))

    def __hash__(self) -> int:
        return hash(self.value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self.value == other.value


@lru_cache(maxsize=256)
def _spheres_of_known_solid(key: _Key) -> Array:
    shape = key.geometry[key.k]
    assert isinstance(shape, Solid)
    return _spheres_of_solid(shape, key.geometry[: key.k] + key.geometry[key.k + 1 :])


def _spheres_of_solid(solid: Solid, others: tuple[Geometry, ...]) -> Array:
    """Greedy cover of the surface by spheres whose centers lie inside."""
    (normals, offsets), corners = solid.half_spaces(), solid.corners()
    low, high = corners.min(axis=0), corners.max(axis=0)
    # A grid of candidate centers, about `CANDIDATES` in number, and points on the surface at the same spacing.
    step = _spacing(float(np.prod(high - low)), (high - low)[None])
    centers, depth = _grid_inside(normals, offsets, corners, step)
    radii = depth + BULGE
    points = _surface_points(corners, step)
    for other in others:
        points = points[other.signed_distance(points) > 0.0]
    if len(points) == 0 or len(centers) == 0:
        center = corners.mean(axis=0)
        return np.array([[*center, float(np.min(offsets - normals @ center))]])
    gaps = cdist(centers, points)
    gaps -= radii[:, None]
    covers = gaps <= REACH
    # Ties, of which a regular grid has many, go to the sphere that comes nearest to the points it covers.
    score = 1e-3 * np.clip(REACH - gaps[covers], 0.0, 2.0 * REACH) / REACH
    chosen: list[int] = []
    # Rounded to binary fractions, so that sums are exact, and the same on every machine.
    worth = np.zeros_like(gaps)
    worth[covers] = np.round((1.0 + score) * 2.0**30) / 2.0**30
    left = np.ones(len(points), dtype=bool)
    gain = worth.sum(axis=1)
    while left.sum() > 0.01 * len(points) and len(chosen) < MAX_PER_SOLID:
        best = int(np.argmax(gain))
        if gain[best] <= 0.5:  # less than one point; what is there is rounding
            break
        chosen.append(best)
        newly = left & covers[best]
        gain -= worth[:, newly].sum(axis=1)
        left &= ~newly
    return np.column_stack([centers[chosen], radii[chosen]])


@lru_cache(maxsize=64)
def _spheres_of_known_parts(key: _Key) -> Array:
    return _spheres_of_parts(key.geometry)


def _spheres_of_parts(geometry: tuple[Geometry, ...]) -> Array:
    """Greedy cover of the union's surface by spheres that may reach from one solid into the next."""
    swept = [_spheres_of(k, geometry) for k, shape in enumerate(geometry) if isinstance(shape, Round)]
    rows = np.concatenate([np.zeros((0, 4)), *swept])
    solids = [(*shape.half_spaces(), shape.corners()) for shape in geometry if isinstance(shape, Solid)]
    others = [shape for shape in geometry if isinstance(shape, Round)]
    sizes = np.array([np.ptp(corners, axis=0) for _, _, corners in solids])
    step = _spacing(float(sizes.prod(axis=1).sum()), sizes)

    def outside(points: Array, but: int = -1) -> Array:
        """How far points lie outside of all solids (but one) and other shapes [m]."""
        distances = [(points @ n.T - d).max(axis=1) for k, (n, d, _) in enumerate(solids) if k != but]
        distances += [other.signed_distance(points) for other in others]
        return np.min(distances, axis=0)

    centers, radii, points = [], [], []
    for k, (normals, offsets, corners) in enumerate(solids):
        inside, depth = _grid_inside(normals, offsets, corners, step)
        centers.append(inside)
        radii.append(depth)
        surface = _surface_points(corners, 0.8 * step)
        points.append(surface[outside(surface, but=k) > 0.0])
    center, radius, point = np.concatenate(centers), np.concatenate(radii), np.concatenate(points)
    if len(rows) and len(point):
        point = point[(cdist(point, rows[:, :3]) - rows[:, 3]).min(axis=1) > REACH]
    if len(point) == 0 or len(center) == 0:
        return rows if len(rows) else np.array([[*solids[0][2].mean(axis=0), 1e-3]])
    safe, radius = radius + BULGE, _grown(center, radius + BULGE, outside, _directions(200))
    gaps = cdist(center, point)
    covers = gaps <= radius[:, None] + REACH
    while True:
        chosen = _greedy(covers, LEFT_TOGETHER, MAX_TOGETHER)
        # Seen more closely, a few stand out too far after all.
        fine = _directions(2000)
        bad = [k for k in chosen if radius[k] > safe[k] and outside(center[k] + radius[k] * fine).max() > BULGE + 5e-5]
        if not bad:
            break
        radius[bad] = safe[bad]
        covers[bad] = gaps[bad] <= safe[bad, None] + REACH
    # What later choices cover too is not needed.
    for k in list(chosen):
        rest = [c for c in chosen if c != k]
        if not (covers[k] & ~covers[rest].any(axis=0)).any():
            chosen = rest
    found = np.column_stack([center[chosen], radius[chosen]])
    # A swept sphere within one of these adds nothing.
    apart = np.linalg.norm(rows[:, None, :3] - found[None, :, :3], axis=2) + rows[:, 3, None] - found[None, :, 3]
    return np.concatenate([rows[(apart > 0.0).all(axis=1)], found])


def _greedy(covers: NDArray[np.bool_], left_over: float, most: int) -> list[int]:
    """Rows that cover most columns, the best first; ties go to the first row."""
    left = np.ones(covers.shape[1], dtype=bool)
    gain = covers.sum(axis=1)
    chosen: list[int] = []
    while left.sum() > left_over * len(left) and len(chosen) < most:
        best = int(np.argmax(gain))
        if gain[best] <= 0:
            break
        chosen.append(best)
        newly = left & covers[best]
        gain = gain - covers[:, newly].sum(axis=1)
        left &= ~newly
    return chosen


def _grown(centers: Array, radii: Array, outside: Callable[[Array], Array], directions: Array) -> Array:
    """Radii, enlarged as long as the spheres stand out of the union by at most `BULGE` in these directions."""
    few = np.zeros(len(directions), dtype=bool)
    few[::10] = True  # Most spheres that are too large stand out in one of few directions already.
    for factor in (1.6, 1.3, 1.15, 1.07):
        trial = np.minimum(radii * factor, radii + 0.02)
        fits = np.arange(len(centers))
        for some in (directions[few], directions[~few]):
            points = centers[fits, None] + trial[fits, None, None] * some
            if len(fits):
                fits = fits[outside(points.reshape(-1, 3)).reshape(len(fits), -1).max(axis=1) <= BULGE]
        radii[fits] = trial[fits]
    return radii


def _directions(count: int) -> Array:
    """Unit vectors spread evenly over the sphere, shape (count, 3)."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z**2)
    return np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])


def _spacing(volume: float, sizes: Array) -> float:
    """Spacing of candidates and surface points [m]: wider in needles and sheets, of which there would be millions."""
    step = (volume / CANDIDATES) ** (1 / 3)
    while (
        step < sizes.max() / MOST_ALONG
        or np.maximum(sizes / max(step, 1e-12), 3.0).prod(axis=1).max() > MOST_CANDIDATES
    ):
        step = 1.25 * step + 1e-9
    return step


def _grid_inside(normals: Array, offsets: Array, corners: Array, step: float) -> tuple[Array, Array]:
    """Points of a grid inside of a solid, shape (n, 3), and their depths [m], shape (n,)."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    axes = [np.linspace(a, b, max(3, round((b - a) / step) + 1)) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    depth = (offsets - grid @ normals.T).min(axis=1)
    return grid[depth > 0.0], depth[depth > 0.0]


def _surface_points(corners: Array, spacing: float) -> Array:
    """Points on the surface of a hull, about `spacing` apart, shape (n, 3)."""
    hull = ConvexHull(corners)
    points = [corners]
    for triangle in corners[hull.simplices]:
        a, b, c = triangle
        longest = max(np.linalg.norm(b - a), np.linalg.norm(c - a), np.linalg.norm(c - b))
        n = max(1, int(np.ceil(longest / spacing)))
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        keep = i + j <= n
        u, v = i[keep] / n, j[keep] / n
        points.append(a + np.outer(u, b - a) + np.outer(v, c - a))
    return np.concatenate(points)
