"""Parts of an object, as a box or a closed mesh in its frame O: where contacts may lie."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.mesh_file import Faces
from xdex_drake.scene.distance import DistanceGrid, ExactDistance, build_grid
from xdex_drake.scene.mesh import read_mesh

HOW = (
    "give bounds in metres such as z=0.06: or x=-0.02:0.02,z=0:0.1, or the path of a closed mesh in the object's frame"
)
_BOUND = re.compile(r"([xyz])=([^:=]*):([^:=]*)")


@dataclass(frozen=True, eq=False)
class Region:
    """The inside of a box whose sides are along the axes of O, or of a closed mesh.

    Attributes:
        low: Lower bounds along x, y and z, minus infinity for none [m].
        high: Upper bounds, plus infinity for none [m].
        vertices: Vertices of the mesh in O [m], shape (n, 3); None for a box.
        faces: Its outward triangles, shape (m, 3).
    """

    low: tuple[float, float, float] = (-math.inf, -math.inf, -math.inf)
    high: tuple[float, float, float] = (math.inf, math.inf, math.inf)
    vertices: Array | None = field(default=None, repr=False)
    faces: Faces | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Refuses a box without an inside.

        Raises:
            ConfigError: A lower bound is not below its upper one.
        """
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            raise ConfigError(f"the region from {self.low} to {self.high} has no inside; give lower bounds first")

    @cached_property
    def exact(self) -> ExactDistance | None:
        """Exact distance to the mesh; None for a box."""
        return None if self.vertices is None or self.faces is None else ExactDistance(self.vertices, self.faces)

    @cached_property
    def grid(self) -> DistanceGrid | None:
        """The same on a grid, for batches; None for a box."""
        return None if self.exact is None else build_grid(self.exact)

    def distances(self, p_Os: Array) -> tuple[Array, Array]:
        """Signed distances of points, negative inside.

        Args:
            p_Os: Points in O [m], shape (n, 3).

        Returns:
            Distances [m], shape (n,), and the unit directions in O in which they grow, shape (n, 3).
        """
        if self.exact is not None:
            found = self.exact.query(p_Os)
            return found.distance, found.gradient
        under, over = np.array(self.low) - p_Os, p_Os - np.array(self.high)
        beyond = np.maximum(under, over)
        sign = np.where(over > under, 1.0, -1.0)
        out = np.maximum(beyond, 0.0)
        length = np.sqrt((out * out).sum(axis=1))
        nearest = np.arange(3) == beyond.argmax(axis=1)[:, None]
        direction = np.where(length[:, None] > 0.0, out / np.maximum(length, 1e-12)[:, None], nearest)
        return np.where(length > 0.0, length, beyond.max(axis=1)), sign * direction


def read_region(text: str) -> Region:
    """A region as the shell gives it.

    Args:
        text: Bounds along some axes of O, such as `z=0.06:` or `x=-0.02:0.02,z=0:0.1` [m], or the path of a closed mesh
            in O, in metres.

    Returns:
        The region.

    Raises:
        ConfigError: The text is neither.
        ObjectFileError: The mesh cannot be used.
    """
    parts = [_BOUND.fullmatch(part.strip()) for part in text.split(",")]
    if not all(parts):
        if not Path(text).suffix:
            raise ConfigError(f"region {text!r} is not understood; {HOW}")
        mesh = read_mesh(text, scale=1.0)
        if not mesh.watertight:
            raise ConfigError(f"region {text}: the mesh is not closed, so that it has no inside; close it")
        return Region(vertices=mesh.vertices, faces=mesh.faces)
    low, high = [-math.inf] * 3, [math.inf] * 3
    for part in parts:
        assert part is not None
        axis = "xyz".index(part[1])
        try:
            low[axis], high[axis] = float(part[2] or "-inf"), float(part[3] or "inf")
        except ValueError:
            raise ConfigError(f"region {text!r} is not understood; {HOW}") from None
    return Region((low[0], low[1], low[2]), (high[0], high[1], high[2]))
