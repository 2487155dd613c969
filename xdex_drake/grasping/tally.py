"""Counts of what became of candidates."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Tally:
    """Counts and seconds of a synthesis, for its closing table.

    Attributes:
        tried: Candidates polished.
        certified: Candidates that were certified.
        lifted: Certified grasps that lifted.
        rejected: How often each reason rejected a candidate.
        failed: How often each reason failed a lift.
        seconds: Wall time.
    """

    tried: int = 0
    certified: int = 0
    lifted: int = 0
    rejected: dict[str, int] = field(default_factory=dict)
    failed: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
