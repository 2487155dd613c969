"""Graspable shapes without end: built from a seed and a number, the same on every machine, with no file.

Eight families take turns. Every shape is closed, of one piece, lies with its base at z = 0, and fits a hand: its middle
extent is drawn between 40 and 85 mm, and it is at least 30 mm high.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import trimesh
from manifold3d import CrossSection, JoinType, Manifold
from numpy.random import Generator
from numpy.typing import NDArray

from xdex_drake.arrays import Array

Faces = NDArray[np.int64]

NAME = re.compile(r"s(\d{1,9})-(\d{4,9})")
"""Names of generated shapes: `s0-0042` is number 42 of seed 0."""

SIDES = 40
MIN_HEIGHT = 0.03
"""Least height of a shape as it lies [m]."""

GRASPABLE = (0.025, 0.09)
"""Bounds of the extent that a hand grasps [m]: at least one of the three lies between them."""

LONGEST = 0.19
"""Greatest extent [m]."""

RECIPE = 1
"""Part of the seed; raised whenever a family changes, so that no name ever means two shapes unnoticed."""


def shape_name(seed: int, index: int) -> str:
    """Name of a generated shape.

    Args:
        seed: Seed of the set.
        index: Number within the set.

    Returns:
        For instance `s0-0042`.
    """
    return f"s{seed}-{index:04d}"


def is_shape_name(name: str) -> bool:
    """Whether a name has the form of a generated shape's."""
    return NAME.fullmatch(name) is not None


def family_name(name: str) -> str:
    """Family of a generated shape.

    Args:
        name: For instance `s0-0042`.

    Returns:
        For instance `vase`.
    """
    return list(FAMILIES)[int(name.split("-")[1]) % len(FAMILIES)]


def generated_mesh(name: str) -> tuple[Array, Faces]:
    """Builds a generated shape.

    Args:
        name: For instance `s0-0042`: number 42 of seed 0.

    Returns:
        Vertices [m], shape (n, 3), and outward faces, shape (m, 3), of a watertight mesh; the base lies at z = 0.

    Raises:
        KeyError: The name is not of this form.
    """
    match = NAME.fullmatch(name)
    if match is None:
        raise KeyError(name)
    seed, index = int(match[1]), int(match[2])
    family = FAMILIES[family_name(name)]
    # A draw may fall apart or be too flat; the next one of the same stream takes its place.
    rng = np.random.default_rng([RECIPE, seed, index])
    for _ in range(50):
        solid = family(rng)
        if not solid.is_empty() and len(solid.decompose()) == 1:
            mesh = _fit(solid, rng)
            if _is_graspable(*mesh):
                return mesh
    raise RuntimeError(f"{name}: fifty draws gave no graspable shape")


def _fit(solid: Manifold, rng: Generator) -> tuple[Array, Faces]:
    """The mesh at a size for a hand, its base at z = 0, its axis through the origin."""
    mesh = solid.simplify(1e-4 * float(np.cbrt(solid.volume()))).to_mesh64()
    vertices = np.array(mesh.vert_properties, dtype=np.float64)[:, :3]
    faces = np.array(mesh.tri_verts, dtype=np.int64)
    extents = np.sort(np.ptp(vertices, axis=0))
    scale = rng.uniform(0.04, 0.085) / extents[1]
    scale = min(scale, LONGEST / extents[2])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - [*(0.5 * (low + high)[:2]), low[2]]) * scale
    # Rounded to a tenth of a micrometre: the last bits of a sine differ between machines, and digests must not.
    return np.round(vertices, 7), faces


def _is_graspable(vertices: Array, faces: Faces) -> bool:
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    extents = np.ptp(vertices, axis=0)
    graspable = ((extents >= GRASPABLE[0]) & (extents <= GRASPABLE[1])).any()
    solid = mesh.is_watertight and mesh.is_winding_consistent and 1e-5 < mesh.volume < 1.5e-3
    return bool(graspable and solid and extents[2] >= MIN_HEIGHT and extents.max() <= LONGEST + 1e-6)


def _smooth_profile(radii: Array, heights: Array, steps: int) -> list[tuple[float, float]]:
    """Half profile through control points, by a cubic that does not overshoot, closed on the axis."""
    from scipy.interpolate import PchipInterpolator

    z = np.linspace(heights[0], heights[-1], steps)
    r = PchipInterpolator(heights, radii)(z)
    return [(0.0, float(z[0])), *zip(r.tolist(), z.tolist(), strict=True), (0.0, float(z[-1]))]


def _vase(rng: Generator) -> Manifold:
    """Body of revolution with a smooth profile: bottles, vases, bulbs."""
    n = int(rng.integers(4, 8))
    heights = np.linspace(0.0, 1.0, n)
    radii = rng.uniform(0.14, 0.42) * rng.uniform(0.45, 1.0, n)
    return Manifold.revolve(CrossSection([np.array(_smooth_profile(radii, heights, 28))]), SIDES)


def _stack(rng: Generator) -> Manifold:
    """Body of revolution with steps and tapers: jars, lids, knobs, candle holders."""
    n, z = int(rng.integers(2, 6)), 0.0
    profile = [(0.0, 0.0)]
    for _ in range(n):
        height, bottom = rng.uniform(0.12, 0.5), rng.uniform(0.15, 0.45)
        top = bottom * rng.uniform(0.75, 1.25) if rng.random() < 0.5 else bottom
        profile += [(bottom, z), (top, z + height)]
        z += height
    sides = int(rng.choice([5, 6, 8, SIDES, SIDES, SIDES]))
    return Manifold.revolve(CrossSection([np.array([*profile, (0.0, z)])]), sides)


def _prism(rng: Generator) -> Manifold:
    """Extrusion of a star, a polygon or a rounded rectangle, twisted and tapered a little."""
    kind = rng.integers(3)
    if kind == 0:
        points = int(rng.integers(4, 9))
        angles = np.arange(2 * points) * np.pi / points
        radii = np.where(np.arange(2 * points) % 2 == 0, 0.5, 0.5 * rng.uniform(0.55, 0.9))
        section = CrossSection([np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])])
        section = section.offset(0.04, JoinType.Round, 2.0, 16)
    elif kind == 1:
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 7)) + np.linspace(0.0, 2.0 * np.pi, 7, endpoint=False)
        angles *= 0.5
        section = CrossSection([np.column_stack([0.5 * np.cos(angles), rng.uniform(0.3, 0.5) * np.sin(angles)])])
    else:
        section = CrossSection.square((rng.uniform(0.5, 1.0), rng.uniform(0.3, 0.7)), True)
        section = section.offset(rng.uniform(0.02, 0.12), JoinType.Round, 2.0, 24)
    height, twist = rng.uniform(0.4, 1.8), rng.uniform(-50.0, 50.0) * (rng.random() < 0.5)
    taper = rng.uniform(0.6, 1.0)
    return Manifold.extrude(section, height, 12, twist, (taper, taper))


def _superquadric(rng: Generator) -> Manifold:
    """Superquadric between a pillow, an egg and a box, tapered along its axis."""
    ball = trimesh.creation.icosphere(subdivisions=4).vertices
    e1, e2 = rng.uniform(0.25, 1.4, 2)
    x, y, z = np.abs(ball).T
    ring = (x ** (2.0 / e2) + y ** (2.0 / e2)) ** (e2 / e1)
    points = ball / ((ring + z ** (2.0 / e1)) ** (0.5 * e1))[:, None]
    points = points * np.array([1.0, rng.uniform(0.55, 1.0), rng.uniform(0.5, 2.0)])
    top = points[:, 2].max()
    points[:, :2] *= 1.0 + rng.uniform(-0.35, 0.35) * points[:, 2:] / top
    return Manifold.hull_points(points)


def _block(rng: Generator) -> Manifold:
    """Box or cylinder out of which holes, slots and steps are cut."""
    size = np.array([rng.uniform(0.6, 1.4), rng.uniform(0.5, 1.0), rng.uniform(0.5, 1.4)])
    if rng.random() < 0.5:
        body = Manifold.cube(size.tolist(), True)
    else:
        body = Manifold.cylinder(size[2], 0.5 * size[1], 0.5 * size[1], SIDES, True)
    for _ in range(int(rng.integers(1, 4))):
        kind, axis = rng.integers(3), int(rng.integers(3))
        turn = [(0.0, 0.0, 0.0), (90.0, 0.0, 0.0), (0.0, 90.0, 0.0)][axis]
        if kind == 0:
            radius = 0.5 * size.min() * rng.uniform(0.25, 0.6)
            cut = Manifold.cylinder(4.0, radius, radius, 24, True).rotate(turn)
        elif kind == 1:
            cut = Manifold.cube([4.0, size.min() * rng.uniform(0.15, 0.35), size[2]], True).rotate(turn)
            cut = cut.translate((size * rng.uniform(0.3, 0.6, 3)).tolist())
        else:
            cut = Manifold.cube((size * rng.uniform(0.35, 0.6, 3)).tolist(), True)
            cut = cut.translate((0.5 * size * rng.choice([-1.0, 1.0], 3)).tolist())
        smaller = body - cut
        if smaller.volume() > 0.4 * body.volume():
            body = smaller
    return body


def _handled(rng: Generator) -> Manifold:
    """A body with one or two handles: mugs, jugs, trophies, kettlebells."""
    kind = rng.integers(4)
    if kind == 0:
        body = _vase(rng)
    elif kind == 1:
        body = _stack(rng)
    elif kind == 2:
        body = _prism(rng)
    else:
        bottom, top, height = *rng.uniform(0.25, 0.45, 2), rng.uniform(0.6, 1.1)
        wall = rng.uniform(0.05, 0.08)
        hollow = Manifold.cylinder(height, bottom - wall, top - wall, SIDES).translate((0.0, 0.0, wall))
        body = Manifold.cylinder(height, bottom, top, SIDES) - hollow
    low, high = np.array(body.bounding_box()[:3]), np.array(body.bounding_box()[3:])
    height, radius = high[2] - low[2], 0.5 * (high[0] - low[0])
    tube = rng.uniform(0.045, 0.075)
    ring = Manifold.revolve(CrossSection.circle(tube, 16).translate((rng.uniform(0.2, 0.3) * height, 0.0)), SIDES)
    ring = ring.scale((rng.uniform(0.7, 1.0), 1.0, 1.0)).rotate((90.0, 0.0, 0.0))
    where = low[2] + rng.uniform(0.45, 0.65) * height
    # What of a ring is inside of a mug would close its mouth.
    inside = Manifold.hull(body).scale((0.98, 0.98, 1.0))
    for side in (1.0, -1.0)[: int(rng.integers(1, 3))]:
        body = body + (ring.translate((side * 0.85 * radius, 0.0, where)) - (inside if kind == 3 else Manifold()))
    return body


def _tool(rng: Generator) -> Manifold:
    """A handle that carries a head: mallets, brushes, spoons, torches; it lies on its side."""
    thick = rng.uniform(0.08, 0.16)
    sides = int(rng.choice([4, 6, 24, 24]))
    handle = Manifold.cylinder(1.0, thick, thick * rng.uniform(0.6, 1.3), sides)
    kind, size = rng.integers(5), rng.uniform(0.6, 1.4, 3)
    if kind == 0:
        head = Manifold.cylinder(0.6 * size[0], 0.18 * size[1], 0.18 * size[2], SIDES, True).rotate((90.0, 0.0, 0.0))
    elif kind == 1:
        head = Manifold.sphere(1.0, 32).scale((0.2 * size).tolist())
    elif kind == 2:
        head = Manifold.cube((np.array([0.3, 0.5, 0.3]) * size).tolist(), True)
    elif kind == 3:
        head = Manifold.cylinder(0.5 * size[0], thick, 0.28 * size[1], SIDES).translate((0.0, 0.0, -0.1))
    else:
        ring = CrossSection.circle(0.07 * size[0], 16).translate((0.24 * size[1], 0.0))
        head = Manifold.revolve(ring, SIDES).rotate((90.0, 0.0, 0.0)).translate((0.0, 0.0, 0.22 * size[1]))
    solid = handle + head.translate((0.0, float(rng.uniform(-0.1, 0.1)), 1.0))
    if rng.random() < 0.4:
        solid = solid + Manifold.sphere(thick * rng.uniform(1.2, 1.9), 24)
    return solid.rotate((0.0, 90.0, 0.0))


def _sculpture(rng: Generator) -> Manifold:
    """Several bodies grown together at odd angles, with some cut away: shapes as those made to be hard to grasp."""
    body = Manifold()
    for k in range(int(rng.integers(3, 7))):
        kind, size = rng.integers(4), rng.uniform(0.3, 0.6, 3)
        if kind == 0:
            piece = Manifold.cube(size.tolist(), True)
        elif kind == 1:
            piece = Manifold.sphere(1.0, 24).scale((0.55 * size).tolist())
        elif kind == 2:
            piece = Manifold.cylinder(size[2] * 1.6, 0.4 * size[0], 0.4 * size[1], 24, True)
        else:
            piece = Manifold.cylinder(size[2], 0.5 * size[0], 0.5 * size[0], int(rng.integers(3, 7)), True)
        piece = piece.rotate(rng.uniform(0.0, 360.0, 3).tolist()).translate(rng.uniform(-0.28, 0.28, 3).tolist())
        body = body - piece.scale((0.6, 0.6, 0.6)) if k >= 3 and rng.random() < 0.4 else body + piece
    flat = Manifold.cube([4.0, 4.0, 2.0], True).translate((0.0, 0.0, body.bounding_box()[2] - 0.9))
    return body - flat


FAMILIES: dict[str, Callable[[Generator], Manifold]] = {
    "vase": _vase,
    "stack": _stack,
    "prism": _prism,
    "superquadric": _superquadric,
    "block": _block,
    "handled": _handled,
    "tool": _tool,
    "sculpture": _sculpture,
}
"""The families in the order in which they take turns."""
