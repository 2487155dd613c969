"""Mass properties of a link, from its geometry."""

import numpy as np
from scipy.spatial import ConvexHull

from xdex_drake.hand.description import Array, Box, Capsule, Convex, Geometry, Sphere

DENSITY = 1100.0
"""Density of a link whose mass is not known [kg/m^3]: plastic and metal with hollows."""

HUB_MASS = 5e-3
"""Mass of a link without geometry [kg]."""

HUB_RADIUS = 6e-3
"""Radius of the ball that stands for the inertia of a link without geometry [m]."""

ROTOR_INERTIA = 2e-6
"""Inertia added about every axis of every link [kg m^2], as the geared rotors of a real hand do.

A fingertip of 5 g has moments of 1e-7 kg m^2; without this, joint gains that suit a finger are stiff for its tip.
"""


def link_inertia(geometry: tuple[Geometry, ...], mass: float | None = None) -> tuple[float, Array, Array]:
    """Mass, center of mass and rotational inertia of a link of uniform density.

    The primitives are summed; where they overlap, the overlap counts twice.

    Args:
        geometry: Primitives in L; a link without any is a small ball at its origin.
        mass: Mass of the link [kg]; None for that of the geometry at `DENSITY`.

    Returns:
        Mass [kg]; center of mass in L [m], shape (3,); inertia about the center of mass, axes of L [kg m^2], shape
        (3, 3), which is physically valid and at least `ROTOR_INERTIA` about every axis.
    """
    rotor = ROTOR_INERTIA * np.eye(3)
    if not geometry:
        mass = HUB_MASS if mass is None else mass
        return mass, np.zeros(3), 0.4 * mass * HUB_RADIUS**2 * np.eye(3) + rotor
    parts = [_volume_properties(shape) for shape in geometry]
    volume = sum(part[0] for part in parts)
    center = sum((part[0] * part[1] for part in parts), np.zeros(3)) / volume
    moments = sum((part[2] + part[0] * _offset_moment(part[1] - center) for part in parts), np.zeros((3, 3)))
    mass = DENSITY * volume if mass is None else mass
    return mass, center, mass / volume * moments + rotor


def _offset_moment(p: Array) -> Array:
    return float(p @ p) * np.eye(3) - np.outer(p, p)


def _volume_properties(shape: Geometry) -> tuple[float, Array, Array]:
    """Volume [m^3], centroid [m] and second moments about the centroid, at unit density [m^5]."""
    if isinstance(shape, Sphere):
        volume = 4.0 / 3.0 * np.pi * shape.radius**3
        return volume, shape.center, 0.4 * volume * shape.radius**2 * np.eye(3)
    if isinstance(shape, Capsule):
        return _capsule_properties(shape)
    if isinstance(shape, Box):
        volume = float(np.prod(shape.size))
        x, y, z = shape.size**2
        moments = volume / 12.0 * np.diag([y + z, x + z, x + y])
        return volume, shape.p_LG, shape.R_LG @ moments @ shape.R_LG.T
    return _hull_properties(shape)


def _capsule_properties(capsule: Capsule) -> tuple[float, Array, Array]:
    r = capsule.radius
    d = capsule.p1 - capsule.p0
    length = float(np.linalg.norm(d))
    cylinder, ball = np.pi * r**2 * length, 4.0 / 3.0 * np.pi * r**3
    axial = 0.5 * cylinder * r**2 + 0.4 * ball * r**2
    # Half balls at the ends: their centroid lies 3r/8 from the flat face.
    across = cylinder * (length**2 / 12.0 + r**2 / 4.0) + ball * (0.4 * r**2 + 0.375 * r * length + length**2 / 4.0)
    u = d / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    moments = across * np.eye(3) + (axial - across) * np.outer(u, u)
    return cylinder + ball, 0.5 * (capsule.p0 + capsule.p1), moments


def _hull_properties(convex: Convex) -> tuple[float, Array, Array]:
    """Sum over the tetrahedra between an inner point and the faces of the hull."""
    hull = ConvexHull(convex.vertices)
    origin = convex.vertices[hull.vertices].mean(axis=0)
    corners = convex.vertices[hull.simplices] - origin  # (n, 3, 3)
    volumes = np.abs(np.linalg.det(corners)) / 6.0
    volume = float(volumes.sum())
    center = (volumes[:, None] * corners.sum(axis=1)).sum(axis=0) / (4.0 * volume)
    # Integral of x x^T over a tetrahedron with a corner at 0: V / 20 (sum_ij p_i p_j^T + sum_i p_i p_i^T).
    totals = corners.sum(axis=1)
    second = np.einsum("n,ni,nj->ij", volumes, totals, totals) + np.einsum("n,nki,nkj->ij", volumes, corners, corners)
    second = second / 20.0 - volume * np.outer(center, center)
    return volume, origin + center, np.trace(second) * np.eye(3) - second
