"""How even an object's surface is about a contact: normals of points around it against its own."""

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import contact_frames
from xdex_drake.scene.object import ObjectModel

RADIUS = 3e-3
"""Radius of a patch [m]: what a fingertip may touch where contact is a millimetre or two off."""

POINTS = 6
"""Points around a patch."""


def normal_spread(model: ObjectModel, p_OCs: Array, n_OCs: Array) -> Array:
    """Mean angle between a contact's normal and those of the surface around it.

    A fingertip touches a few millimetres beside where a grasp puts it, and rolls when it is loaded. On an even surface
    that changes little; across an edge or on a fine relief the force meets another normal.

    Args:
        model: The object; its surface is that of its convex parts.
        p_OCs: Contact points in O [m], shape (n, 3).
        n_OCs: Unit normals into the object in O, shape (n, 3).

    Returns:
        Mean angles [rad], shape (n,).
    """
    angle = 2.0 * np.pi * np.arange(POINTS) / POINTS
    around = RADIUS * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(POINTS)])
    # From a little outside, so that points on the surface have a gradient.
    points = p_OCs[:, None] + np.einsum("cab,kb->cka", contact_frames(n_OCs), around) - 1e-3 * n_OCs[:, None]
    normals = -model.exact.query(points.reshape(-1, 3)).gradient.reshape(len(p_OCs), POINTS, 3)
    return np.arccos(np.clip(np.einsum("cka,ca->ck", normals, n_OCs), -1.0, 1.0)).mean(axis=1)
