"""Everyday shapes built in code, so that the library needs no mesh files."""

import re
from collections.abc import Callable

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold
from numpy.typing import NDArray

from xdex_drake.arrays import Array

Faces = NDArray[np.int64]

SIDES = 48

BOX_SIDE = re.compile(r"\d+(\.\d*)?|\.\d+")
"""A side in the name of a box."""


def list_objects() -> tuple[str, ...]:
    """The names of the shapes, in alphabetical order."""
    return tuple(sorted(_SHAPES))


def box_sides(name: str) -> tuple[float, ...] | None:
    """Sides of the box that a name stands for, such as `0.1x0.2x0.3`, in metres along x, y and z; None for others."""
    parts = name.split("x")
    if len(parts) != 3 or not all(BOX_SIDE.fullmatch(part) for part in parts):
        return None
    return tuple(float(part) for part in parts)


def box_mesh(sides: tuple[float, ...]) -> tuple[Array, Faces]:
    """A box on z = 0, its base centered at the origin; see `procedural_mesh`."""
    mesh = trimesh.creation.box(sides)
    return np.asarray(mesh.vertices) + np.array([0.0, 0.0, 0.5 * sides[2]]), np.asarray(mesh.faces, dtype=np.int64)


def procedural_mesh(name: str) -> tuple[Array, Faces]:
    """Builds a shape of the library.

    Args:
        name: One of `list_objects()`.

    Returns:
        Vertices [m], shape (n, 3), and outward faces, shape (m, 3), of a watertight mesh; the base lies at z = 0.

    Raises:
        KeyError: There is no such shape.
    """
    mesh = _SHAPES[name]().to_mesh64()
    vertices = np.array(mesh.vert_properties, dtype=np.float64)[:, :3]
    faces = np.array(mesh.tri_verts, dtype=np.int64)
    vertices[:, 2] -= vertices[:, 2].min()
    return vertices, faces


def _lathe(profile: list[tuple[float, float]]) -> Manifold:
    """A body of revolution about z from its half profile: (radius, height), counter-clockwise."""
    return CrossSection([np.array(profile)]).revolve(SIDES)


def _cylinder(radius: float, height: float) -> Manifold:
    return Manifold.cylinder(height, radius, radius, SIDES)


def _box() -> Manifold:
    return Manifold.cube((0.06, 0.05, 0.09), True)


def _brick() -> Manifold:
    return Manifold.cube((0.10, 0.045, 0.035), True)


def _can() -> Manifold:
    return _cylinder(0.033, 0.11)


def _ball() -> Manifold:
    return Manifold.sphere(0.035, SIDES)


def _egg() -> Manifold:
    angles = np.linspace(-np.pi / 2, np.pi / 2, 25)
    radius = (0.026 * np.cos(angles) * (1.0 - 0.12 * np.sin(angles))).clip(0.0)
    return _lathe(list(zip(radius, 0.036 * np.sin(angles), strict=True)))


def _pear() -> Manifold:
    belly = [(0.0, 0.0), (0.018, 0.002), (0.032, 0.012), (0.037, 0.028), (0.034, 0.045)]
    neck = [(0.025, 0.062), (0.018, 0.078), (0.014, 0.092), (0.008, 0.099), (0.0, 0.101)]
    return _lathe(belly + neck)


def _bottle() -> Manifold:
    body = [(0.0, 0.0), (0.031, 0.0), (0.033, 0.003), (0.033, 0.095), (0.028, 0.112)]
    neck = [(0.015, 0.13), (0.0135, 0.14), (0.0135, 0.165), (0.0, 0.165)]
    return _lathe(body + neck)


def _jar() -> Manifold:
    body = [(0.0, 0.0), (0.036, 0.0), (0.038, 0.003), (0.038, 0.062), (0.034, 0.07), (0.034, 0.073)]
    lid = [(0.037, 0.073), (0.037, 0.088), (0.0, 0.088)]
    return _lathe(body + lid)


def _cup() -> Manifold:
    return _lathe([(0.0, 0.0), (0.026, 0.0), (0.038, 0.085), (0.0345, 0.085), (0.0232, 0.004), (0.0, 0.004)])


def _bowl() -> Manifold:
    angles = np.linspace(0.0, 1.25, 10)
    outer = [(0.06 * np.sin(t), 0.06 * (1.0 - np.cos(t))) for t in angles]
    inner = [(0.056 * np.sin(t), 0.06 - 0.056 * np.cos(t)) for t in angles[::-1]]
    return _lathe(outer + inner)


def _ring(radius: float, tube: float) -> Manifold:
    section = CrossSection.circle(tube, 20).translate((radius, 0.0))
    return section.revolve(SIDES)


def _mug() -> Manifold:
    handle = _ring(0.024, 0.0055).rotate((90.0, 0.0, 0.0)).translate((0.04, 0.0, 0.047))
    return (_cylinder(0.04, 0.095) + handle) - _cylinder(0.0365, 0.2).translate((0.0, 0.0, 0.005))


def _torus() -> Manifold:
    return _ring(0.035, 0.013)


def _hammer() -> Manifold:
    handle = _cylinder(0.013, 0.13).scale((1.0, 0.8, 1.0)).translate((0.0, 0.0, -0.13))
    head = _cylinder(0.017, 0.085).rotate((0.0, 90.0, 0.0)).translate((-0.0425, 0.0, 0.0))
    return (handle + head).rotate((90.0, 0.0, 0.0))


def _cross() -> Manifold:
    bar = Manifold.cube((0.09, 0.03, 0.03), True)
    return bar + bar.rotate((0.0, 0.0, 90.0))


def _prism() -> Manifold:
    return Manifold.cylinder(0.08, 0.036, 0.036, 3)


def _hexagon() -> Manifold:
    return Manifold.cylinder(0.05, 0.035, 0.035, 6)


def _angle() -> Manifold:
    return Manifold.cube((0.08, 0.035, 0.03)) + Manifold.cube((0.03, 0.035, 0.08))


def _spray_bottle() -> Manifold:
    body = _lathe([(0.0, 0.0), (0.034, 0.0), (0.036, 0.003), (0.036, 0.09), (0.014, 0.125), (0.014, 0.14), (0.0, 0.14)])
    head = Manifold.cube((0.07, 0.024, 0.028)).translate((-0.025, -0.012, 0.138))
    trigger = Manifold.cube((0.010, 0.014, 0.04)).rotate((0.0, -15.0, 0.0)).translate((0.03, -0.007, 0.105))
    return body.scale((1.0, 0.75, 1.0)) + head + trigger


def _superquadric() -> Manifold:
    ball = trimesh.creation.icosphere(subdivisions=4)
    direction = ball.vertices / np.abs(ball.vertices).max(axis=1, keepdims=True)
    norm = (np.abs(direction) ** 4).sum(axis=1, keepdims=True) ** 0.25
    return Manifold.hull_points(direction / norm * np.array([0.03, 0.025, 0.042]))


_SHAPES: dict[str, Callable[[], Manifold]] = {
    "angle": _angle,
    "ball": _ball,
    "bottle": _bottle,
    "bowl": _bowl,
    "box": _box,
    "brick": _brick,
    "can": _can,
    "cross": _cross,
    "cup": _cup,
    "egg": _egg,
    "hammer": _hammer,
    "hexagon": _hexagon,
    "jar": _jar,
    "mug": _mug,
    "pear": _pear,
    "prism": _prism,
    "spray_bottle": _spray_bottle,
    "superquadric": _superquadric,
    "torus": _torus,
}
