"""Counts of what became of candidates: tried, certified, lifted, and why not."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from xdex_drake.grasp import Lift

if TYPE_CHECKING:
    from xdex_drake.grasping.finish import Outcome


@dataclass
class Tally:
    """What became of candidates.

    Attributes:
        tried: Candidates that were finished, as a grasp or with a reason.
        certified: Candidates that were certified.
        lifted: Certified grasps that lifted.
        held: Those of them that passed all of their protocol; the lift alone where it asks for no more.
        rejected: How often each reason rejected a candidate, by `Rejection.name`.
        failed: How often each reason failed a lift.
        lost: What happened to work that gave no result: a process that crashed or ran out of time.
        seconds: Wall time spent, as whoever counts measures it [s].
    """

    tried: int = 0
    certified: int = 0
    lifted: int = 0
    held: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    failed: Counter[str] = field(default_factory=Counter)
    lost: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, outcome: Outcome) -> None:
        """Counts a finished candidate, and its lift where it has one."""
        self.tried += 1
        if outcome.grasp is None:
            assert outcome.reason is not None
            self.rejected[outcome.reason.name] += 1
            return
        self.certified += 1
        if outcome.grasp.lift is not None:
            self.add_lift(outcome.grasp.lift)

    def add_lift(self, lift: Lift) -> None:
        """Counts the lift of a certified grasp."""
        self.lifted += lift.success
        self.held += lift.passed
        if not lift.passed:
            self.failed[lift.failure_reason or (lift.hold.reason if lift.hold else "")] += 1

    def merge(self, other: Tally) -> None:
        """Adds the counts of another tally."""
        self.tried += other.tried
        self.certified += other.certified
        self.lifted += other.lifted
        self.held += other.held
        self.rejected += other.rejected
        self.failed += other.failed
        self.lost += other.lost
        self.seconds += other.seconds

    @property
    def simulated(self) -> int:
        """Grasps that were lifted, with success or not."""
        return self.held + self.failed.total()

    @property
    def rate(self) -> str:
        """Lifted of certified, as text."""
        return f"{100.0 * self.lifted / self.certified:.0f} %" if self.certified else "-"

    def row(self) -> tuple[int, int, int, str, str]:
        """Tried, certified, lifted, and the reasons of rejections and of failed lifts: a row to print."""
        return self.tried, self.certified, self.lifted, counted(self.rejected), counted(self.failed)


def counted(reasons: Counter[str]) -> str:
    """How often each reason came up, the most frequent first."""
    ordered = sorted(reasons.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{name} {count}" for name, count in ordered) or "-"
