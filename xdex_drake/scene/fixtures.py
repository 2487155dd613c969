"""Obstacles beside the object: things that are fixed in the world, and that a hand must not touch."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.scene.object import ObjectModel, load_object

HOW = "give it as FILE@x,y,z or FILE@x,y,z,yaw, in metres and degrees, such as 0.1x0.4x0.3@0.2,0,0"


@dataclass(frozen=True, eq=False)
class Fixture:
    """An obstacle: an object that is fixed in the world.

    Attributes:
        object: What it is; its mass does not matter.
        X_WF: Its pose in W.
    """

    object: ObjectModel
    X_WF: RigidTransform

    def __repr__(self) -> str:
        """One line."""
        x, y, z = self.X_WF.translation()
        return f"Fixture({self.object.name!r} at {x:.3g}, {y:.3g}, {z:.3g} m)"

    def distances(self, p_Ws: Array) -> tuple[Array, Array]:
        """Exact signed distances of points.

        Args:
            p_Ws: Points in W [m], shape (n, 3).

        Returns:
            Distances, negative inside [m], shape (n,), and the unit directions in W in which they grow, shape (n, 3).
        """
        R_WF = self.X_WF.rotation().matrix()
        found = self.object.exact.query((p_Ws - self.X_WF.translation()) @ R_WF)
        return found.distance, found.gradient @ R_WF.T

    def lower_bounds(self, p_Ws: Array) -> Array:
        """Signed distances by the grid; no true one falls short of them, but for the grid's own error.

        Args:
            p_Ws: Points in W [m], shape (n, 3).

        Returns:
            Distances [m], shape (n,).
        """
        return self.object.grid.lower_bounds((p_Ws - self.X_WF.translation()) @ self.X_WF.rotation().matrix())


def read_fixture(text: str) -> Fixture:
    """An obstacle as the shell gives it.

    Args:
        text: `FILE@x,y,z` or `FILE@x,y,z,yaw`: the object as `load_object` takes it, the place of its frame [m], and
            its turn about z [degrees].

    Returns:
        The obstacle.

    Raises:
        ConfigError: The text is none of these.
        XdexError: The object cannot be used.
    """
    name, at, numbers = text.rpartition("@")
    parts = re.split(r"\s*,\s*", numbers.strip())
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if not at or not name or len(values) not in (3, 4) or not all(map(math.isfinite, values)):
        raise ConfigError(f"obstacle {text!r} is not understood; {HOW}")
    yaw = math.radians(values[3]) if len(values) == 4 else 0.0
    return Fixture(load_object(name), RigidTransform(RollPitchYaw(0.0, 0.0, yaw), np.array(values[:3])))
