"""Functions of NumPy arrays and torch tensors alike, which never import torch by themselves."""

from __future__ import annotations

import sys
from typing import Any, TypeVar

import numpy as np

# A NumPy array or a torch tensor: whatever comes in, its like goes out.
A = TypeVar("A")


def namespace(array: Any) -> Any:
    """The module, numpy or torch, that an array belongs to; never imports torch by itself."""
    return np if isinstance(array, np.ndarray) else sys.modules["torch"]


def cross(a: A, b: A) -> A:
    """Cross product along the last axis.

    Args:
        a: Vectors, shape (..., 3).
        b: Vectors, shape (..., 3).

    Returns:
        a x b, shape (..., 3).
    """
    return namespace(a).linalg.cross(a, b)


def like(array: A, values: Any) -> A:
    """Values as an array of the kind, type and device of another.

    Args:
        array: The other.
        values: Numbers, of any shape.

    Returns:
        The values.
    """
    if isinstance(array, np.ndarray):
        return np.asarray(values, dtype=array.dtype)
    return sys.modules["torch"].as_tensor(values, dtype=array.dtype, device=array.device)  # type: ignore[attr-defined]
