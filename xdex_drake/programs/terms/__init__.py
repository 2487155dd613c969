"""The terms of the grasp programs, one file each: the energy, and what holds a program to the same by costs or rows.

An energy is a function of arrays with its gradient, for NumPy and torch alike; a `Term` reads its arguments from a
`View`. The same term serves the batched search (`SearchSettings.terms`) and a program (`program.add`).
"""

from xdex_drake.programs.term import Pull, Term, View
from xdex_drake.programs.terms.center import Centered
from xdex_drake.programs.terms.contact import ContactDistance
from xdex_drake.programs.terms.force_closure import ForceClosure
from xdex_drake.programs.terms.joint_limits import JointLimits
from xdex_drake.programs.terms.pads import PadAlignment
from xdex_drake.programs.terms.penetration import Penetration
from xdex_drake.programs.terms.self_collision import SelfCollision

__all__ = ["EQ_1", "FIRM", "Pull", "Term", "View"]

EQ_1: tuple[Term, ...] = (
    ForceClosure(),
    ContactDistance(),
    Penetration(),
    JointLimits(),
    SelfCollision(),
    PadAlignment(),
)
"""Eq. (1), and the pads of the fingers."""

FIRM: tuple[Term, ...] = (*EQ_1, Centered())
"""Eq. (1) for grasps that shall hold while they are pushed, as synthesis searches them."""
