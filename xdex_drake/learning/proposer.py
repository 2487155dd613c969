"""Grasps from the model: draw link poses, solve inverse kinematics, refine, certify."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.grasping.proposers import Candidate
from xdex_drake.hand.description import Hand
from xdex_drake.learning.checkpoint import load_checkpoint
from xdex_drake.learning.features import ObjectFeatures, hand_features, object_features
from xdex_drake.learning.first_model import FirstModel, is_first, load_first
from xdex_drake.learning.predict import Prediction, sample
from xdex_drake.learning.protocol import Model
from xdex_drake.programs.force_closure import PolishSettings, polish_program
from xdex_drake.programs.inverse_kinematics import IkResult, frame_targets, solve_points
from xdex_drake.programs.link_pose_ik import touching_fingers
from xdex_drake.programs.retargeting import REFINEMENT
from xdex_drake.programs.search import Candidates, refine
from xdex_drake.scene.tabletop import Scene, point_cloud

OBJECT_POINTS = 1024
"""Points of the object's surface that the model sees."""


def default_checkpoint() -> Path:
    """Folder of the small checkpoint that the library ships."""
    return Path(__file__).parent / "weights" / "small"


def predict(model: Model, hand: Hand, scene: Scene, *, count: int, seed: int = 0) -> Prediction:
    """Draws link poses for a hand on a scene.

    Args:
        model: The model.
        hand: The hand.
        scene: The scene.
        count: Number of grasps.
        seed: Seed; equal seeds give corresponding grasps of different hands.

    Returns:
        Link poses in W.
    """
    return sample(model, _features(hand), scene_features(scene), count, seed=seed)


def scene_features(scene: Scene) -> ObjectFeatures:
    """A scene's object as the model sees it."""
    points_W, normals_W = point_cloud(scene, OBJECT_POINTS, seed=0)
    center_W = scene.X_WO @ scene.object.p_OOcm
    return object_features(points_W, center_W, count=OBJECT_POINTS, seed=0, n_WPoints=normals_W)


def configurations(hand: Hand, scene: Scene, prediction: Prediction) -> Candidates:
    """Configurations for predicted link poses by inverse kinematics alone (the raw stage).

    Args:
        hand: The hand.
        scene: The scene, which decides which fingers are meant to touch.
        prediction: Link poses.

    Returns:
        One candidate a prediction, in its order; the energy is the error of the inverse kinematics [m].
    """
    known, R_WGs, p_WGs = _features(hand), prediction.R_WGs, prediction.p_WGs
    targets = frame_targets(known.links, known.R_LGs, known.p_LGs, R_WGs, p_WGs)
    # The axes of the base's G are those of H.
    p_WHs = p_WGs[:, 0] - R_WGs[:, 0] @ known.centers[0]
    found = solve_points(hand, targets, R_WGs[:, 0], p_WHs, np.tile(hand.q_rest, (len(R_WGs), 1)))
    return _with_fingers(hand, scene, found)


def _with_fingers(hand: Hand, scene: Scene, found: IkResult) -> Candidates:
    fingers = np.array(
        [
            touching_fingers(
                hand, scene, RigidTransform(RotationMatrix.ProjectToRotationMatrix(found.R_WHs[k]), found.p_WHs[k]), q
            )
            for k, q in enumerate(found.qs)
        ]
    )
    return Candidates(found.R_WHs, found.p_WHs, found.qs, fingers, found.errors, {})


def draw_raw(model: Model | FirstModel, hand: Hand, scene: Scene, *, count: int, seed: int = 0) -> Candidates:
    """Predicted grasps by inverse kinematics alone; arguments as of `draw_candidates`."""
    if isinstance(model, FirstModel):
        return _with_fingers(hand, scene, model.configurations(hand, scene_features(scene), count, seed))
    return configurations(hand, scene, predict(model, hand, scene, count=count, seed=seed))


def draw_candidates(model: Model | FirstModel, hand: Hand, scene: Scene, *, count: int, seed: int = 0) -> Candidates:
    """Predicted grasps as configurations near which a program looks for a grasp: drawn, solved for, refined in a batch.

    Args:
        model: The model.
        hand: The hand; the model need not have seen it.
        scene: The scene.
        count: Number of predictions.
        seed: Seed of the draws.

    Returns:
        One candidate a prediction, in its order.
    """
    return refine(hand, scene, draw_raw(model, hand, scene, count=count, seed=seed), settings=REFINEMENT)


@dataclass(frozen=True)
class ModelProposer:
    """Proposes what a model draws, refined; equal seeds give corresponding candidates of different hands.

    Attributes:
        checkpoint: File of the model, or the folder that holds it.
        polish: Numbers of the hard constraints of the candidates' programs; the defaults where None.
    """

    checkpoint: str
    polish: PolishSettings | None = None

    def __call__(self, hand: Hand, scene: Scene, count: int, seed: int) -> Iterator[Candidate]:
        """Draws, solves inverse kinematics and refines once, for all candidates; see `grasping.proposers.Proposer`."""
        model, start = load_model(self.checkpoint), time.perf_counter()
        drawn = draw_candidates(model, hand, scene, count=count, seed=seed)
        share = (time.perf_counter() - start) / count
        for k in range(count):
            X_WH = RigidTransform(RotationMatrix.ProjectToRotationMatrix(drawn.R_WHs[k]), drawn.p_WHs[k])
            build = partial(polish_program, hand, scene, X_WH, drawn.qs[k], drawn.fingers[k], settings=self.polish)
            yield Candidate(f"m{k}", lambda build=build: iter((build(),)), share)


@lru_cache(maxsize=2)
def load_model(checkpoint: str) -> Model | FirstModel:
    """Reads a model, or takes the one that was read before.

    Args:
        checkpoint: File of the model, or the folder that holds it.

    Returns:
        The model.

    Raises:
        CheckpointError: There is no such file, or it is damaged or of another version.
    """
    return load_first(Path(checkpoint)) if is_first(Path(checkpoint)) else load_checkpoint(checkpoint)


_features = lru_cache(maxsize=16)(hand_features)
