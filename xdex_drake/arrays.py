"""The type of all arrays of numbers, and two products of vectors that NumPy lacks or takes long for. NumPy alone."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
"""An array of double precision; docstrings state shape, unit and frame."""

_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


def cross(a: Array, b: Array) -> Array:
    """A x b along the last axis; `numpy.cross` takes ten times as long for few vectors."""
    return a.take(_NEXT, -1) * b.take(_LAST, -1) - a.take(_LAST, -1) * b.take(_NEXT, -1)


def skew(v: ArrayLike) -> Array:
    """Cross-product matrices S with S u = v x u.

    Args:
        v: Vectors, shape (..., 3).

    Returns:
        Matrices, shape (..., 3, 3).
    """
    v = np.asarray(v, dtype=float)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out
