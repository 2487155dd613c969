"""What the importer decided, mended or doubts, in sentences a person can check against the hand."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Decision:
    """One thing that was not in the file as it stands.

    Attributes:
        severity: "decided" (a choice among several), "mended" (the file is wrong or silent) or "warning" (look at it).
        subject: What it is about, as `link thumb_tip`, `joint j5`, `finger index` or `hand`.
        text: One sentence.
    """

    severity: str
    subject: str
    text: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.subject}: {self.text}"


Decisions = list[Decision]
"""Grows while a hand is interpreted; each step appends what it decided."""


def join(names: list[str] | tuple[str, ...], most: int = 6) -> str:
    """Names in a sentence, the later ones of a long list counted only."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"
