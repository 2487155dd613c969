"""Mass properties of a link, from its geometry."""

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.hand.shapes import Geometry

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
    parts = [shape.volume() for shape in geometry]
    volume = sum(part.volume for part in parts)
    center = sum((part.volume * part.p_LCenter for part in parts), np.zeros(3)) / volume
    moments = sum(
        (part.moments + part.volume * offset_moment(part.p_LCenter - center) for part in parts), np.zeros((3, 3))
    )
    mass = DENSITY * volume if mass is None else mass
    return mass, center, mass / volume * moments + rotor


def offset_moment(p: Array) -> Array:
    """Rotational inertia of a unit of mass at a point, about the origin (Steiner) [m^2], shape (3, 3)."""
    return float(p @ p) * np.eye(3) - np.outer(p, p)
