"""Hands that are generated, each from its name alone: `g0-0137` is hand 137 of seed 0.

Every fifth hand is a human one, the others vary the five robot hands of the library, so that any number of hands has
the paper's mix (section 3.2: 200 human, 800 robot). A hand's random numbers come from its own seed and index, so it
does not depend on the others; what the checks refuse is drawn again. The originals are never among them: a robot hand
is always scaled, as a whole or in part.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from xdex_drake.errors import ConfigError, UnknownHand
from xdex_drake.hand.checks import check_hand, check_in_drake, repaired_rest
from xdex_drake.hand.description import Hand
from xdex_drake.hand.human import HumanShape, human_hand, sample_shape
from xdex_drake.hand.shipped import shipped_hand
from xdex_drake.hand.variation import Operation, apply_operation

BASES = ("ability", "allegro", "inspire", "schunk_svh", "shadow")
"""The robot hands that are varied."""

HUMAN_EVERY = 5
"""Hands whose index is a multiple of this are human."""

MAX_ATTEMPTS = 200
"""Draws until a hand is given up; on average two are needed."""

GENERATOR = 1
"""Version of the rule from name to hand; raised whenever a name comes to mean another hand."""

REST_STEP = 0.05
"""Step of the second that each hand is simulated at rest [s]; ten times a lift's, since a hand at rest stands still."""


@dataclass(frozen=True)
class Generated:
    """A generated hand and how it came about.

    Attributes:
        hand: The hand; `hand.sources["variation"]` names its operations, `hand.sources["base"]` what they began with.
        base: `human` or the name of the robot hand.
        operations: The operations on the base, in order; a human hand may have none.
        rejected: Reasons why earlier draws were refused, one a draw.
    """

    hand: Hand
    base: str
    operations: tuple[Operation, ...]
    rejected: tuple[str, ...]


def hand_name(seed: int, index: int) -> str:
    """Name of a generated hand."""
    return f"g{seed}-{index:04d}"


def read_hand_name(name: str) -> tuple[int, int] | None:
    """Seed and index of a generated hand's name; None for another name."""
    match = re.fullmatch(r"g(\d{1,9})-(\d{4,9})", name)
    if match is None:
        return None
    seed, index = int(match[1]), int(match[2])
    return (seed, index) if hand_name(seed, index) == name else None


def generated_hand(seed: int, index: int) -> Hand:
    """A generated hand.

    Args:
        seed: Seed of the set, 0 or more.
        index: Index in the set, 0 or more.

    Returns:
        The hand, checked by `check_hand` and `check_in_drake`.

    Raises:
        ConfigError: Seed or index is negative or too large.
        UnknownHand: No draw passed the checks.
    """
    return generate_hand(seed, index).hand


@lru_cache(maxsize=64)
def generate_hand(seed: int, index: int) -> Generated:
    """A generated hand with its history; see `generated_hand`.

    Args:
        seed: Seed of the set, 0 or more.
        index: Index in the set, 0 or more.

    Returns:
        The hand and its history.

    Raises:
        ConfigError: Seed or index is negative or too large.
        UnknownHand: No draw passed the checks.
    """
    name = hand_name(seed, index)
    if read_hand_name(name) != (seed, index):
        raise ConfigError(f"there is no generated hand of seed {seed} and index {index}; both must be 0 to 999999999")
    rng = np.random.default_rng([seed, index])
    rejected: list[str] = []
    for _ in range(MAX_ATTEMPTS):
        base, operations, hand = _draw(rng, human=index % HUMAN_EVERY == 0)
        reasons = check_hand(hand)
        if _first(reasons).startswith("overlap"):
            mended = repaired_rest(hand)
            if mended is not None:
                hand, reasons = mended, check_hand(mended)
        if not reasons:
            hand = replace(hand, name=name, display_name=f"{hand.display_name}, variation {name}")
            reasons = check_in_drake(hand, time_step=REST_STEP)
        if not reasons:
            return Generated(hand, base, operations, tuple(rejected))
        rejected.append(_first(reasons).partition(":")[0])
    raise UnknownHand(f"{name}: none of {MAX_ATTEMPTS} draws gave a sound hand; take another index")


def _first(reasons: Sequence[str]) -> str:
    return reasons[0] if reasons else ""


# ---- drawing


def _draw(rng: np.random.Generator, *, human: bool) -> tuple[str, tuple[Operation, ...], Hand]:
    """One draw: a base hand and operations on it."""
    if human:
        shape = sample_shape(rng)
        hand = human_hand(shape)
        hand = replace(hand, sources={**hand.sources, "base": f"human({_shape_text(shape)})"})
        hand, operations = _vary_topology(rng, hand, int(rng.choice(4, p=[0.25, 0.35, 0.25, 0.15])))
        return "human", operations, hand
    base = str(rng.choice(BASES))
    hand = shipped_hand(base)
    hand = replace(hand, sources={**hand.sources, "base": base})
    # Topology first: scaling then treats duplicates each in its own way.
    hand, operations = _vary_topology(rng, hand, int(rng.choice(5, p=[0.05, 0.25, 0.3, 0.25, 0.15])))
    scaling = _draw_scaling(rng, hand)
    return base, (*operations, scaling), apply_operation(hand, scaling)


def _shape_text(shape: HumanShape) -> str:
    dimensions = (
        f"hand_length {shape.hand_length:g}, palm_length {shape.palm_length:g}, hand_breadth {shape.hand_breadth:g}, "
        f"hand_circumference {shape.hand_circumference:g}, wrist_circumference {shape.wrist_circumference:g}, "
        f"thickness {shape.thickness:g}"
    )
    return f"{dimensions}, segments {' '.join(f'{v:g}' for row in shape.segments for v in row)}"


def _draw_scaling(rng: np.random.Generator, hand: Hand) -> Operation:
    """The whole hand by 0.75 to 1.25, or three in ten links each by 0.8 to 1.25; by at least 3 % in any case."""
    if rng.random() < 0.5:
        return Operation("scale_hand", (), (_draw_factor(rng, 0.75, 1.25),))
    solid = [link.name for link in hand.links if link.geometry]
    chosen = [name for name in solid if rng.random() < 0.3] or [str(rng.choice(solid))]
    return Operation("scale_links", tuple(chosen), tuple(_draw_factor(rng, 0.8, 1.25) for _ in chosen))


def _draw_factor(rng: np.random.Generator, low: float, high: float) -> float:
    while True:
        factor = round(float(np.exp(rng.uniform(np.log(low), np.log(high)))), 3)
        if abs(factor - 1.0) >= 0.03:
            return factor


def _vary_topology(rng: np.random.Generator, hand: Hand, count: int) -> tuple[Hand, tuple[Operation, ...]]:
    """Applies some operations of random kinds at random places; places that do not fit are drawn again."""
    operations = []
    for _ in range(count):
        for _ in range(20):
            operation = _draw_operation(rng, hand)
            try:
                hand = apply_operation(hand, operation)
            except ConfigError:
                continue
            operations.append(operation)
            break
    return hand, tuple(operations)


def _draw_operation(rng: np.random.Generator, hand: Hand) -> Operation:
    kind = str(rng.choice(["duplicate_link", "remove_link", "remove_finger", "merge_links"], p=[0.35, 0.2, 0.2, 0.25]))
    if kind == "remove_finger":
        # Without a thumb nothing opposes the fingers of these hands.
        names = [finger.name for finger in hand.fingers if finger.name != "thumb"]
        return Operation(kind, (str(rng.choice(names)),))
    names = [link.name for link in hand.links[1:]]
    return Operation(kind, (str(rng.choice(names)),), (), kind == "duplicate_link" and bool(rng.random() < 0.5))


# ---- topology


def topology(hand: Hand) -> str:
    """A hand's tree with the kinds of its joints and their couplings, the same for trees of the same form.

    A joint is written `r` or `p`; a coupled one adds how many links further up its master is, or `x` where the master
    is in another branch. Names, sizes and the order of branches do not matter.

    Args:
        hand: The hand.

    Returns:
        The tree in brackets, branches in alphabetical order.
    """
    joint_above = {joint.child: joint for joint in hand.joints}
    below: dict[str, list[str]] = {link.name: [] for link in hand.links}
    for joint in hand.joints:
        below[joint.parent].append(joint.child)

    def label(link: str) -> str:
        joint = joint_above[link]
        mark = joint.kind[0]
        if joint.coupling is not None:
            steps, at = 0, joint
            while at is not None and at.name != joint.coupling.master:
                steps, at = steps + 1, joint_above.get(at.parent)
            mark += str(steps) if at is not None else "x"
        return mark + form(link)

    def form(link: str) -> str:
        return "(" + "".join(sorted(label(child) for child in below[link])) + ")"

    return form(hand.links[0].name)
