"""What the studio computes in a process of its own, so that its page never waits."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.description import Hand
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.variation import scale_hand, scale_links
from xdex_drake.hand.yaml_file import hand_digest, write_hand
from xdex_drake.jobs.grasps import BatchUnit, GraspRequest, run_batch
from xdex_drake.jobs.stored import RetargetUnit, run_retarget
from xdex_drake.programs.grasp_types import GraspType
from xdex_drake.programs.search import SearchSettings
from xdex_drake.scene.facts import SceneFacts
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene, stable_poses
from xdex_drake.visualization.film import Frame, film_lift

FIND_LIMIT_S = 60.0
"""Time after which a search takes what it has [s]."""

APPROACHES: dict[str, tuple[float, float, float] | None] = {
    "any": None,
    "from above": (0.0, 0.0, -1.0),
    "along x": (1.0, 0.0, 0.0),
    "against x": (-1.0, 0.0, 0.0),
    "along y": (0.0, 1.0, 0.0),
    "against y": (0.0, -1.0, 0.0),
}
"""Directions in which the palm may be asked to come, in W."""


@dataclass(frozen=True)
class Set:
    """Hand and scene.

    Attributes:
        hand: Name or path of the hand.
        scene: The scene.
        poses: How many ways the object has to rest on the table.
    """

    hand: str
    scene: SceneFacts
    poses: int


@dataclass(frozen=True, eq=False)
class Found:
    """A grasp, or why there is none.

    Attributes:
        grasp: The grasp; None where there is none.
        said: What came of it, in words.
    """

    grasp: Grasp | None
    said: str


def shaped_hand(name: str, size: float, fingers: float, folder: Path) -> str:
    """A hand of another size or with longer fingers, as a file.

    Args:
        name: Name or path of the hand.
        size: Factor on all lengths.
        fingers: Factor on the lengths of its fingers.
        folder: Folder of the file; made where it does not exist.

    Returns:
        Path of the file; the name itself where both factors are one.
    """
    if size == fingers == 1.0:
        return name
    hand = shaped(load_hand(name), size, fingers)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{hand.name}-{hand_digest(hand)[:8]}.yaml"
    if not file.is_file():
        write_hand(hand, file)
    return str(file)


def shaped(hand: Hand, size: float, fingers: float) -> Hand:
    """A hand of another size and with longer fingers; see `shaped_hand`."""
    longer = {link: fingers for finger in hand.fingers for link in finger.links}
    return scale_links(scale_hand(hand, size), longer)


def lay_out(hand: str, object: str, pose: int, size: float, friction: float) -> Set:
    """Prepares a scene.

    Args:
        hand: Name or path of the hand.
        object: Name or path of the object.
        pose: Number of its pose at rest; the last one where there are fewer.
        size: Factor on its size.
        friction: Coefficient of friction.

    Returns:
        Hand and scene.
    """
    plain = load_object(object, friction=friction)
    thing = plain if size == 1.0 else load_object(object, scale=size * plain.scale, friction=friction)
    poses = stable_poses(thing)
    scene = make_scene(thing, pose=poses[min(pose, len(poses) - 1)].X_WO)
    return Set(hand, SceneFacts.of(scene), len(poses))


def find(place: Set, grasp_type: GraspType, approach: str, batch: int) -> Found:
    """Searches for a grasp: one that lifts, else one that is certified.

    Args:
        place: Hand and scene.
        grasp_type: Type of the grasp.
        approach: One of `APPROACHES`.
        batch: Number of the search; another number finds others.

    Returns:
        What was found.
    """
    search = SearchSettings(grasp_type=grasp_type, approach=APPROACHES[approach])
    request = GraspRequest(place.hand, place.scene, search=search)
    result = run_batch(BatchUnit(request, batch, 1, time.time() + FIND_LIMIT_S))
    best = max(result.grasps, key=lambda grasp: grasp.lift is not None and grasp.lift.success, default=None)
    tally = result.tally
    if best is None:
        why = ", ".join(f"{reason.replace('_', ' ')} {n}" for reason, n in tally.rejected.most_common(3))
        return Found(None, f"no grasp among {tally.tried} candidates ({why}); press next to search on")
    return Found(best, f"found in {tally.seconds:.1f} s, candidate {tally.tried}")


def carry(grasp: Grasp, place: Set, target: str) -> Found:
    """Carries a grasp to another hand in the same scene, and lifts it.

    Args:
        grasp: The grasp.
        place: Its hand and scene.
        target: Name or path of the other hand.

    Returns:
        The other hand's grasp.
    """
    outcome = run_retarget(RetargetUnit(0, grasp, place.scene, place.hand, target))
    if outcome.grasp is None:
        return Found(None, f"cannot be carried: {outcome.reason}")
    return Found(outcome.grasp, f"carried in {outcome.grasp.seconds:.1f} s")


def film(grasp: Grasp, place: Set) -> tuple[Lift, tuple[Frame, ...]]:
    """Simulates and records the lift of a grasp.

    Args:
        grasp: The grasp.
        place: Its hand and scene.

    Returns:
        The verdict and the moments.
    """
    recorded = film_lift(grasp, load_hand(place.hand), place.scene.build())
    return recorded.lift, recorded.frames
