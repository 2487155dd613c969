"""Forces as arrows in Meshcat: one arrow a contact, drawn where the hand pushes, ending at the contact point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatAnimation, MeshcatCone, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.visualization.film import Push
from xdex_drake.visualization.page import Legend

NEWTONS_PER_METER = 50.0
"""Force that an arrow of one metre stands for [N/m]."""

FORCE_COLOR = (0.85, 0.10, 0.35)
HEAD_LENGTH, HEAD_RADIUS, SHAFT_RADIUS = 0.013, 0.006, 0.0022


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
    # The point of a contact lies between finger and object: an arrow is seen through both.
    for part in ("head", "shaft/rod"):
        for name, value in (("depthTest", False), ("transparent", True)):
            meshcat.SetProperty(f"{path}/{part}/<object>", f"material.{name}", value)


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


def play_pushes(
    meshcat: Meshcat,
    animation: MeshcatAnimation,
    path: str,
    pushes: Mapping[int, Sequence[Push]],
) -> None:
    """Adds the forces of a recorded lift to an animation, one arrow a contact.

    Args:
        meshcat: Where arrows are drawn.
        animation: Grows by their tracks, which all end together: otherwise a recording in a loop falls out of step.
        path: Path under which arrows are drawn.
        pushes: The forces at each frame of the animation.
    """
    shown: dict[str, dict[int, Push]] = {}
    for moment, now in pushes.items():
        count: dict[str, int] = {}
        for push in now:
            count[push.link] = count.get(push.link, 0) + 1
            shown.setdefault(f"{path}/{push.link}/{count[push.link]}", {})[moment] = push
    for arrow, by_moment in shown.items():
        add_arrow(meshcat, arrow)
        meshcat.SetProperty(arrow, "visible", False)
        held = next(iter(by_moment.values()))
        for moment in pushes:
            held = by_moment.get(moment, held)
            X_WA, scale = arrow_placement(held.p_WC, held.f_W)
            animation.SetProperty(moment, arrow, "visible", moment in by_moment)
            animation.SetTransform(moment, arrow, X_WA)
            animation.SetProperty(moment, f"{arrow}/shaft", "scale", scale)


def force_legend(most_force: float) -> Legend:
    """The line of a legend that says what an arrow's length means."""
    text = f"force of the hand: {1000.0 / NEWTONS_PER_METER:.0f} mm are 1 N"
    return Legend("arrow", FORCE_COLOR, f"{text}; at most {most_force:.1f} N" if most_force > 0.0 else text)
