"""Finger names that the names of links and joints give away."""

import re

FINGER_NAMES = ("thumb", "index", "middle", "ring", "little")

_WORDS = {
    "thumb": ("thumb", "pollex", "daumen", "pouce"),
    "index": ("index", "forefinger", "fore", "pointer", "zeigefinger"),
    "middle": ("middle", "mid", "mittelfinger"),
    "ring": ("ring", "ringfinger"),
    "little": ("little", "pinky", "pinkie", "baby", "kleinerfinger"),
}

FINGER_WORDS = frozenset(
    (*(word for words in _WORDS.values() for word in words), "finger", "fingers", "fingertip", "jaw", "claw", "gripper")
)
"""Words in the names of what is a finger."""

LIMB_WORDS = frozenset(
    (
        "arm",
        "shoulder",
        "elbow",
        "forearm",
        "leg",
        "hip",
        "thigh",
        "knee",
        "calf",
        "shin",
        "ankle",
        "foot",
        "head",
        "neck",
    )
)
"""Words in the names of limbs that are none."""

_CODES = {"thumb": "th", "index": "ff", "middle": "mf", "ring": "rf", "little": "lf"}
"""The two letters that the names of Shadow's links and joints begin with, and of many hands after it."""


def named_fingers(chains: list[list[str]]) -> list[str | None]:
    """The finger that the names along each chain speak of.

    A word that stands in every chain, as the name of a phalanx does, says nothing; two chains of one name say nothing.

    Args:
        chains: For each finger, the names of its links and joints.

    Returns:
        For each finger its name, or None where the names do not say.
    """
    counts = [{finger: sum(_speaks_of(name, finger) for name in names) for finger in FINGER_NAMES} for names in chains]
    for finger in FINGER_NAMES:
        if all(count[finger] for count in counts):
            least = min(count[finger] for count in counts)
            for count in counts:
                count[finger] -= least
    found: list[str | None] = []
    for count in counts:
        order = sorted(FINGER_NAMES, key=lambda finger: -count[finger])
        clear = count[order[0]] > 0 and count[order[0]] >= 2 * count[order[1]]
        found.append(order[0] if clear else None)
    return [name if found.count(name) == 1 else None for name in found]


def side_from_names(names: list[str]) -> str | None:
    """The side, "right" or "left", where names say so and do not contradict each other.

    Args:
        names: Names of the robot, its links and joints.

    Returns:
        The side, or None.
    """
    votes = {"right": 0, "left": 0}
    for name in names:
        words = re.split(r"[^a-z0-9]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower())
        for side in votes:
            votes[side] += any(word in (side, f"{side[0]}h", side[0]) for word in words)
    if votes["right"] == votes["left"]:
        return None
    side = "right" if votes["right"] > votes["left"] else "left"
    other = "left" if side == "right" else "right"
    return side if votes[side] > 3 * votes[other] else None


def _words(name: str) -> list[str]:
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return [word.lower() for word in re.split(r"[^A-Za-z]+", spaced) if word]


def name_words(name: str) -> frozenset[str]:
    """The words that a name is made of, in lower case: `LeftArm_2` has left and arm.

    Args:
        name: Name of a link or joint.

    Returns:
        The words.
    """
    return frozenset(_words(name))


def _speaks_of(name: str, finger: str) -> bool:
    words = _words(name)
    if any(word in _WORDS[finger] or word.startswith(_WORDS[finger][0]) for word in words):
        return True
    code = _CODES[finger]
    rest = r"(?:$|j|a|tip|knuckle|proximal|middle|distal|metacarpal|base|hub)"
    return any(re.match(code + rest, word) for word in words)
