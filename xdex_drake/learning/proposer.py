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
from xdex_drake.learning.features import hand_features, object_features, zero_configuration
from xdex_drake.learning.models.cvae import CVAE
from xdex_drake.learning.predict import Prediction, sample
from xdex_drake.programs.force_closure import PolishSettings, polish_program
from xdex_drake.programs.link_pose_ik import link_pose_ik, touching_fingers
from xdex_drake.programs.retargeting import REFINEMENT
from xdex_drake.programs.search import Candidates, refine
from xdex_drake.scene.tabletop import Scene, point_cloud

OBJECT_POINTS = 1024
"""Points of the object's surface that the model sees."""


def default_checkpoint() -> Path:
    """Folder of the small checkpoint that the library ships."""
    return Path(__file__).parent / "weights" / "small"


def predict(model: CVAE, hand: Hand, scene: Scene, *, count: int, seed: int = 0) -> Prediction:
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
    points_W, _ = point_cloud(scene, OBJECT_POINTS, seed=0)
    cloud = object_features(points_W, scene.X_WO @ scene.object.p_OOcm, count=OBJECT_POINTS, seed=0)
    return sample(model, hand_features(hand), cloud, count, seed=seed)


def configurations(hand: Hand, scene: Scene, prediction: Prediction) -> Candidates:
    """Configurations for predicted link poses by inverse kinematics alone (the raw stage).

    Args:
        hand: The hand.
        scene: The scene, which decides which fingers are meant to touch.
        prediction: Link poses.

    Returns:
        One candidate a prediction, in its order; the energy is the error of the inverse kinematics [m].
    """
    R_HLs, _ = zero_configuration(hand)
    # The link pose vector's rotation, from which a vendor's choice of link axes has dropped out.
    R = prediction.R_WLs @ np.swapaxes(R_HLs, -1, -2)
    found = link_pose_ik(hand, R, prediction.p_WLs)
    fingers = np.array(
        [
            touching_fingers(
                hand, scene, RigidTransform(RotationMatrix.ProjectToRotationMatrix(found.R_WHs[k]), found.p_WHs[k]), q
            )
            for k, q in enumerate(found.qs)
        ]
    )
    return Candidates(found.R_WHs, found.p_WHs, found.qs, fingers, found.errors, {})


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
        model, start = _model(self.checkpoint), time.perf_counter()
        raw = configurations(hand, scene, predict(model, hand, scene, count=count, seed=seed))
        refined = refine(hand, scene, raw, settings=REFINEMENT)
        share = (time.perf_counter() - start) / count
        for k in range(count):
            X_WH = RigidTransform(RotationMatrix.ProjectToRotationMatrix(refined.R_WHs[k]), refined.p_WHs[k])
            build = partial(polish_program, hand, scene, X_WH, refined.qs[k], refined.fingers[k], settings=self.polish)
            yield Candidate(f"m{k}", lambda build=build: iter((build(),)), share)


@lru_cache(maxsize=2)
def _model(checkpoint: str) -> CVAE:
    return load_checkpoint(checkpoint)
