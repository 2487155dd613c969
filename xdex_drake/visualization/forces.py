"""Forces as arrows in Meshcat: one arrow a contact, drawn where the hand pushes, ending at the contact point."""

from __future__ import annotations

from typing import cast

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatAnimation, MeshcatCone, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Context

from xdex_drake.arrays import Array

NEWTONS_PER_METER = 50.0
"""Force that an arrow of one metre stands for [N/m]."""

FORCE_COLOR = (0.85, 0.10, 0.35)
HEAD_LENGTH, HEAD_RADIUS, SHAFT_RADIUS = 0.012, 0.0055, 0.0022
LEAST_FORCE = 0.02
"""Weaker forces are not drawn [N]."""


def add_arrow(meshcat: Meshcat, path: str, color: tuple[float, float, float] = FORCE_COLOR) -> None:
    """Adds an arrow to Meshcat, to be placed by `place_arrow`.

    Args:
        meshcat: Where to draw.
        path: Path of the arrow.
        color: Red, green, blue.
    """
    # In the arrow's frame the tip is the origin and the force points along -z. A Meshcat cone has its apex at its
    # origin and opens along +z. The shaft has unit length, so that its scale is its length.
    meshcat.SetObject(f"{path}/head", MeshcatCone(HEAD_LENGTH, HEAD_RADIUS, HEAD_RADIUS), Rgba(*color))
    meshcat.SetObject(f"{path}/shaft/rod", Cylinder(SHAFT_RADIUS, 1.0), Rgba(*color))
    meshcat.SetTransform(f"{path}/shaft/rod", RigidTransform([0.0, 0.0, 0.5]))
    meshcat.SetTransform(f"{path}/shaft", RigidTransform([0.0, 0.0, HEAD_LENGTH]))


def arrow_placement(p_WTip: Array, f_W: Array) -> tuple[RigidTransform, list[float]]:
    """Pose of an arrow and scale of its shaft.

    Args:
        p_WTip: Point where the force acts [m], shape (3,).
        f_W: Force [N], shape (3,), not zero.

    Returns:
        X_WA of the arrow, and the scale of its shaft.
    """
    force = float(np.linalg.norm(f_W))
    X_WA = RigidTransform(RotationMatrix.MakeFromOneVector(-f_W / force, 2), p_WTip)
    return X_WA, [1.0, 1.0, max(force / NEWTONS_PER_METER - HEAD_LENGTH, 0.004)]


def place_arrow(meshcat: Meshcat, path: str, p_WTip: Array, f_W: Array, time: float | None = None) -> None:
    """Makes an arrow show a force.

    Args:
        meshcat: Where the arrow was added.
        path: Its path.
        p_WTip: Point where the force acts [m], shape (3,).
        f_W: Force [N], shape (3,), not zero.
        time: Time in the recording [s], where one is being made.
    """
    X_WA, scale = arrow_placement(p_WTip, f_W)
    meshcat.SetTransform(path, X_WA, time)
    meshcat.SetProperty(f"{path}/shaft", "scale", scale, time)


class HandForces:
    """Draws the forces by which a hand pushes on object and table, one arrow a contact.

    Drake's ContactVisualizer would draw the object's weight on the table as well, and ends the track of an arrow that
    vanishes early, so that a recording in a loop falls out of step. It is no system of the diagram either: a system
    written in Python keeps its diagram, and Meshcat's port with it, from ever being freed.
    """

    def __init__(self, meshcat: Meshcat, plant: MultibodyPlant, hand: ModelInstanceIndex, path: str) -> None:
        """Prepares to draw.

        Args:
            meshcat: Where to draw.
            plant: The plant.
            hand: The hand's model instance.
            path: Path under which arrows are drawn.
        """
        self._meshcat, self._plant, self._path = meshcat, plant, path
        self._names = {body: plant.get_body(body).name() for body in plant.GetBodyIndices(hand)}
        self._last: dict[str, tuple[Array, Array]] = {}

    def publish(self, context: Context, time: float) -> None:
        """Shows the forces of a moment.

        Args:
            context: Context of the plant.
            time: Time in the recording [s].
        """
        results = cast(ContactResults, self._plant.get_contact_results_output_port().Eval(context))
        count: dict[str, int] = {}
        active: dict[str, tuple[Array, Array]] = {}
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            a, b, force = info.bodyA_index(), info.bodyB_index(), np.array(info.contact_force())
            if (a in self._names) == (b in self._names) or np.linalg.norm(force) < LEAST_FORCE:
                continue
            # The force that Drake reports acts on B.
            link, force = (self._names[a], force) if a in self._names else (self._names[b], -force)
            count[link] = count.get(link, 0) + 1
            active[f"{self._path}/{link}/{count[link]}"] = (np.array(info.contact_point()), force)
        for path in active:
            if path not in self._last:
                add_arrow(self._meshcat, path)
                self._meshcat.SetProperty(path, "visible", False, 0.0)
        self._last |= active
        for path in self._last:
            self._meshcat.SetProperty(path, "visible", path in active, time)
            if path in active:
                place_arrow(self._meshcat, path, *active[path], time)

    def hold(self, animation: MeshcatAnimation, frame: int) -> None:
        """Extends every arrow's tracks to a frame, so that all tracks of a recording end together.

        Args:
            animation: The recording.
            frame: The frame.
        """
        for path, (p_WTip, f_W) in self._last.items():
            X_WA, scale = arrow_placement(p_WTip, f_W)
            animation.SetTransform(frame, path, X_WA)
            animation.SetProperty(frame, f"{path}/shaft", "scale", scale)
