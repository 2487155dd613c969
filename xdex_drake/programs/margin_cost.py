"""A cost that raises a grasp's margin: what a program may wish for beyond holding the object.

The wrench constraint of a program asks for forces that carry the object, and a grasp that barely does is as good to it
as one that withstands a shake. This cost tells them apart, by the margin that certificates state.
"""

from __future__ import annotations

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.contact.gradients import push_margins
from xdex_drake.programs.point import Point
from xdex_drake.programs.program import LeastSquares


def margin_cost(*, least: float = 6.0, most_force: float = 6.0, weight: float = 30.0) -> LeastSquares:
    """A cost on pushes that a grasp does not resist: 1/2 w sum over six pushes of max(0, log((1 + least) / (1 + s)))^2.

    The margin s against a push is the greatest multiple of the object's weight, along that axis of W, that the contacts
    resist beside gravity (`contact.task_margin`); by the logarithm the smallest counts most. Normal forces are bounded
    instead of joint torques: without a bound margins would be infinite, and this one needs no derivative of the hand's
    Jacobian. Where gravity is not held all margins are 0 and have no slope, so the cost does most in a program that
    starts from a solved one's point.

    Args:
        least: Margin that is enough.
        most_force: Greatest normal force of a contact, in units of the object's weight.
        weight: Weight.

    Returns:
        The cost; `program.add(margin_cost())`.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        obj = point.scene.object
        p_OcmCs = point.contacts_W - point.scene.X_WO @ obj.p_OOcm
        margins = push_margins(p_OcmCs, point.normals_W, obj.friction, obj.length, most_force=most_force)
        short = np.maximum(0.0, np.log((1.0 + least) / (1.0 + margins.values)))
        slope = np.einsum("knx,nxj->kj", margins.by_points, point.surface_jacobian)
        slope += np.einsum("knx,nxj->kj", margins.by_normals, point.normal_jacobian)
        J = np.zeros((len(short), point.size))
        J[:, : point.moving] = -np.where(short > 0.0, 1.0 / (1.0 + margins.values), 0.0)[:, None] * slope
        return short, J

    return LeastSquares("margin", weight, evaluate, "pushes that are not resisted, in weights")
