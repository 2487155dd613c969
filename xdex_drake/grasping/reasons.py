"""Why a candidate is no grasp: one list of reasons, and what each means in words."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from xdex_drake.programs.obstacles import CONSTRAINT_WORDS


class Reason(StrEnum):
    """The step at which a candidate is given up."""

    CONSTRAINT = "constraint"
    TOUCH = "touch"
    SURFACE = "surface"
    CERTIFICATE = "certificate"
    TASK_MARGIN = "task margin"
    PENETRATION = "penetration"
    PREGRASP = "pregrasp"
    APPROACH = "approach"
    HOLD = "hold"
    INVERSE_KINEMATICS = "inverse kinematics"


WORDS = {
    Reason.TOUCH: "the hand's shapes do not touch the object where the spheres that stand for them do",
    Reason.SURFACE: "the object's convex parts differ from its mesh at a contact",
    Reason.CERTIFICATE: "the contacts do not hold the object within friction and the motors' efforts",
    Reason.TASK_MARGIN: "the contacts hold the object, but do not resist a push of its own weight",
    Reason.PENETRATION: "the hand is more than the allowed depth inside the object",
    Reason.PREGRASP: "no way was found to open the hand and come near the object without touching it",
    Reason.APPROACH: "the open hand has no straight way of 10 cm to the object that is clear of object and table",
    Reason.INVERSE_KINEMATICS: "the hand's joints cannot bring its fingertips where they were predicted",
    Reason.HOLD: "the hand holds the object, but pushes of its own weight are foretold to tear it from the grasp",
}
"""What each reason means, for people; those of constraints are `CONSTRAINT_WORDS`."""


@dataclass(frozen=True)
class Rejection:
    """Why a candidate is no grasp.

    Attributes:
        reason: The step at which it was given up.
        detail: The constraint that could not be met, by name, or more about the reason; may be empty.
    """

    reason: Reason
    detail: str = ""

    @property
    def name(self) -> str:
        """What tables count by: the constraint's name, or the reason."""
        return self.detail if self.reason is Reason.CONSTRAINT else self.reason.value

    def __str__(self) -> str:
        """The name, and what there is to say beside it."""
        return self.name if self.reason is Reason.CONSTRAINT or not self.detail else f"{self.name}: {self.detail}"

    def in_words(self) -> str:
        """The name and what it means, for people."""
        more = "" if self.reason is Reason.CONSTRAINT or not self.detail else f" ({self.detail})"
        return in_words(self.name) + more


def in_words(name: str) -> str:
    """A name by which rejections are counted, with what it means.

    Args:
        name: Name of a constraint or value of a `Reason`.

    Returns:
        Name and meaning; the name alone where it is a user's own constraint.
    """
    words = {**CONSTRAINT_WORDS, **WORDS}.get(name)
    return name if words is None else f"{name}: {words}"
