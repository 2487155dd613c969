"""The retargeting program of Eq. (2): another hand's keypoints, under contact, clearance and force closure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from xdex_drake.arrays import Array
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.programs.force_closure import PolishSettings, polish_program
from xdex_drake.programs.grasp_types import random_contact_sets
from xdex_drake.programs.inverse_kinematics import keypoint_targets, solve_points
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.search import Candidates, SearchSettings, refine
from xdex_drake.programs.terms.keypoints import keypoint_cost
from xdex_drake.scene.belonging import check_hand_of
from xdex_drake.scene.tabletop import Scene

IMPROVEMENT = 0.05
"""Gain of a step at which a feasible retargeting is good enough, for `solve`: keypoints then are within 2 % of what
further steps reach (measured on four hands), in half of the time."""


def corresponding_fingers(fingers: set[str], target: Hand) -> NDArray[np.bool_]:
    """Which fingers of a target hand shall touch: those of the same names, and at least one beside the thumb.

    Args:
        fingers: Names of the source hand's fingers that touch.
        target: The target hand.

    Returns:
        In the order of `target.fingers`.
    """
    names = [f.name for f in target.fingers]
    chosen = np.array([name in fingers for name in names])
    if "thumb" in names:
        chosen[names.index("thumb")] = True
    others = [k for k, name in enumerate(names) if name != "thumb" and not chosen[k]]
    while chosen.sum() < min(3, len(names)) and others:
        chosen[others.pop(0)] = True
    return chosen


def warm_start(source: Grasp, source_hand: Hand, target: Hand, *, wrist: float = 0.1) -> tuple[RigidTransform, Array]:
    """Kinematic retargeting: keypoints alone, from the target's rest posture at the source's wrist.

    Args:
        source: The source grasp.
        source_hand: Its hand.
        target: The target hand.
        wrist: Weight of the wrist's keypoint.

    Returns:
        Wrist pose and joint values of the target hand.
    """
    targets = keypoint_targets(source_hand, source.X_WH, source.q, target, wrist=wrist)
    found = solve_points(
        target,
        targets,
        source.X_WH.rotation().matrix()[None],
        source.X_WH.translation()[None],
        target.q_rest[None],
        iterations=15,
        tolerance=1e-3,
    )
    R_WH = RotationMatrix.ProjectToRotationMatrix(found.R_WHs[0])
    return RigidTransform(R_WH, found.p_WHs[0]), found.qs[0]


@dataclass(frozen=True)
class RetrySettings:
    """How a grasp is tried again that does not carry over as it is.

    Attributes:
        starts: Number of starts about the kinematic one, refined as one batch; 0 for none.
        turn: Standard deviation of the wrist's turn [rad].
        shift: Standard deviation of the wrist's displacement [m].
        joints: Standard deviation of the joints, as a fraction of their range.
        other_fingers: Fraction of the starts that touch with other fingers than the source's.
    """

    starts: int = 8
    turn: float = float(np.deg2rad(7.0))
    shift: float = 0.008
    joints: float = 0.1
    other_fingers: float = 0.5


RETRY = RetrySettings()
"""The same for all hands; measured in `studies/retargeting`."""


REFINEMENT = SearchSettings(iterations=60, translation_step=0.002, rotation_step=0.02, joint_step=0.03)
"""The short descent that takes a warm start out of penetration and onto the surface, where hands differ much."""


def refined_start(
    source: Grasp, source_hand: Hand, target: Hand, scene: Scene, *, settings: SearchSettings = REFINEMENT
) -> tuple[RigidTransform, Array]:
    """The warm start after a short descent of the energy of Eq. (1).

    Args:
        source: The source grasp.
        source_hand: Its hand.
        target: The target hand.
        scene: Their scene.
        settings: Settings of the descent.

    Returns:
        Wrist pose and joint values of the target hand.
    """
    alone = replace(RETRY, starts=0)
    found = refined_starts(source, source_hand, target, scene, seed=0, retry=alone, settings=settings)
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(found.R_WHs[0]), found.p_WHs[0]), found.qs[0]


def refined_starts(
    source: Grasp,
    source_hand: Hand,
    target: Hand,
    scene: Scene,
    *,
    seed: int,
    retry: RetrySettings = RETRY,
    settings: SearchSettings = REFINEMENT,
) -> Candidates:
    """The warm start, and jittered ones about it, after a short descent of the energy of Eq. (1).

    They descend as one batch, which takes hardly longer than one start alone: at these sizes the time of a step does
    not depend on the number of candidates.

    Args:
        source: The source grasp.
        source_hand: Its hand.
        target: The target hand.
        scene: Their scene.
        seed: Seed of the jitter and of the other fingers.
        retry: How many jittered starts, and how far about.
        settings: Settings of the descent.

    Returns:
        The warm start first, then the others, least energy first.
    """
    X_WH, q = warm_start(source, source_hand, target)
    fingers = corresponding_fingers(_touching_fingers(source, source_hand), target)
    rng = np.random.default_rng(seed)
    starts = jittered_starts(target, X_WH, q, fingers, rng, retry=retry, contacts=settings.contacts)
    found = refine(target, scene, starts, settings=settings)
    order = np.concatenate([[0], 1 + np.argsort(found.energy[1:], kind="stable")]).astype(int)
    return found.take(order)


def jittered_starts(
    hand: Hand,
    X_WH: RigidTransform,
    q: Array,
    fingers: NDArray[np.bool_],
    rng: np.random.Generator,
    *,
    retry: RetrySettings = RETRY,
    contacts: int = REFINEMENT.contacts,
) -> Candidates:
    """A configuration, and others about it, some of which touch with other fingers.

    Args:
        hand: The hand.
        X_WH: Wrist pose.
        q: Joint values, shape (n,).
        fingers: Which fingers shall touch, in the order of `hand.fingers`.
        rng: Generator of the jitter and of the other fingers.
        retry: How many others, and how far about.
        contacts: Greatest number of fingers in a drawn set.

    Returns:
        The configuration itself first, then the others, energies zero.
    """
    count = retry.starts
    sets = np.tile(fingers, (1 + count, 1))
    others = round(retry.other_fingers * count)
    if others:
        sets[1 : 1 + others] = random_contact_sets(hand, rng, others, contacts)
    low, high = hand.limits
    jittered = np.arange(1 + count) > 0  # all but the first
    shape = (1 + count, 3)
    turns = Rotation.from_rotvec(retry.turn * jittered[:, None] * rng.normal(size=shape)).as_matrix()
    shifts = retry.shift * jittered[:, None] * rng.normal(size=shape)
    bends = retry.joints * (high - low) * jittered[:, None] * rng.normal(size=(1 + count, len(q)))
    return Candidates(
        R_WHs=turns @ X_WH.rotation().matrix(),
        p_WHs=X_WH.translation() + shifts,
        qs=np.clip(q + bends, low, high),
        fingers=sets,
        energy=np.zeros(1 + count),
        terms={},
    )


def retargeting_program(
    source: Grasp,
    source_hand: Hand,
    target: Hand,
    scene: Scene,
    *,
    start: tuple[RigidTransform, Array] | None = None,
    fingers: NDArray[np.bool_] | None = None,
    settings: PolishSettings | None = None,
) -> GraspProgram:
    """The retargeting program.

    Args:
        source: A grasp of the source hand.
        source_hand: The source hand.
        target: The target hand.
        scene: The scene.
        start: Wrist pose and joint values to start from; `warm_start` where None.
        fingers: Which fingers shall touch, in the order of `target.fingers`; the corresponding ones where None.
        settings: Numbers of the hard constraints; the defaults where None.

    Returns:
        The program: posture and effort, keypoints, and the constraints of the force-closure program.

    Raises:
        ConfigError: The grasp is not of the source hand. Its object may be another one than the scene's.
    """
    check_hand_of(source, source_hand)
    X_WH, q = start if start is not None else warm_start(source, source_hand, target)
    if fingers is None:
        fingers = corresponding_fingers(_touching_fingers(source, source_hand), target)
    targets = keypoint_targets(source_hand, source.X_WH, source.q, target)
    return polish_program(
        target,
        scene,
        X_WH,
        q,
        fingers,
        settings=settings,
        extra_costs=(keypoint_cost(targets),),
        name="retargeting",
    )


def _touching_fingers(source: Grasp, hand: Hand) -> set[str]:
    if source.certificate is None:
        return {f.name for f in hand.fingers}
    links = {contact.link for contact in source.certificate.contacts}
    return {f.name for f in hand.fingers if links & set(f.links)}
