"""Grasps from the model: draw link poses, solve inverse kinematics, refine, certify."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Literal

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.grasp import Grasp
from xdex_drake.grasping.finish import penetrations
from xdex_drake.grasping.pregrasp import pregrasp
from xdex_drake.grasping.proposers import Candidate
from xdex_drake.grasping.reasons import Reason, Rejection
from xdex_drake.grasping.squeeze import squeeze_by_rule
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration, forward_kinematics
from xdex_drake.learning.checkpoint import load_checkpoint
from xdex_drake.learning.features import ObjectFeatures, hand_features, link_frames, object_features
from xdex_drake.learning.first_model import FirstModel, is_first, load_first
from xdex_drake.learning.predict import Prediction, sample
from xdex_drake.learning.protocol import Model
from xdex_drake.programs.force_closure import PolishSettings, polish_program
from xdex_drake.programs.inverse_kinematics import IkResult, frame_targets, solve_points
from xdex_drake.programs.link_pose_ik import reach_block, touching_fingers
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.retargeting import REFINEMENT, RETRY, RetrySettings, jittered_starts
from xdex_drake.programs.search import Candidates, refine
from xdex_drake.scene.tabletop import Scene, point_cloud
from xdex_drake.simulation.protocol import LIFT

OBJECT_POINTS = 1024
"""Points of the object's surface that the model sees."""

TIP_RESIDUAL = 0.01
"""Mean distance of the fingertips from where they were predicted above which a raw grasp is none [m]."""

REACH = 0.02
"""How far a refined grasp's wrist may be from the prediction's [m]."""


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
        One candidate a prediction, in its order; the energy is how far the fingertips are from where they were
        predicted, their mean [m].
    """
    known, R_WGs, p_WGs = _features(hand), prediction.R_WGs, prediction.p_WGs
    targets = frame_targets(known.links, known.R_LGs, known.p_LGs, R_WGs, p_WGs)
    # The axes of the base's G are those of H.
    p_WHs = p_WGs[:, 0] - R_WGs[:, 0] @ known.centers[0]
    found = solve_points(hand, targets, R_WGs[:, 0], p_WHs, np.tile(hand.q_rest, (len(R_WGs), 1)))
    tips, offsets = known.keypoint_links[1:], known.keypoint_offsets[1:]
    residuals = np.zeros(len(R_WGs))
    for k in range(len(R_WGs) if len(tips) else 0):
        R, p = link_frames(known, *forward_kinematics(hand, _pose(found.R_WHs[k], found.p_WHs[k]), found.qs[k]))
        apart = p[tips] - p_WGs[k, tips] + ((R[tips] - R_WGs[k, tips]) @ offsets[..., None])[..., 0]
        residuals[k] = np.linalg.norm(apart, axis=1).mean()
    return _with_fingers(hand, scene, replace(found, errors=residuals))


def _with_fingers(hand: Hand, scene: Scene, found: IkResult) -> Candidates:
    poses = [_pose(R, p) for R, p in zip(found.R_WHs, found.p_WHs, strict=True)]
    fingers = np.array([touching_fingers(hand, scene, X, q) for X, q in zip(poses, found.qs, strict=True)])
    return Candidates(found.R_WHs, found.p_WHs, found.qs, fingers, found.errors, {})


def _pose(R: Array, p: Array) -> RigidTransform:
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), p)


def draw_raw(model: Model | FirstModel, hand: Hand, scene: Scene, *, count: int, seed: int = 0) -> Candidates:
    """Predicted grasps by inverse kinematics alone.

    Args:
        model: The model.
        hand: The hand; the model need not have seen it.
        scene: The scene.
        count: Number of predictions.
        seed: Seed of the draws.

    Returns:
        One candidate a prediction, in its order; see `configurations`.
    """
    if isinstance(model, FirstModel):
        return _with_fingers(hand, scene, model.configurations(hand, scene_features(scene), count, seed))
    return configurations(hand, scene, predict(model, hand, scene, count=count, seed=seed))


def raw_grasp(hand: Hand, scene: Scene, raw: Candidates, k: int) -> Grasp | Rejection:
    """A predicted grasp as inverse kinematics gives it, opened for its pre-grasp and squeezed by the rule.

    Args:
        hand: The hand.
        scene: The scene.
        raw: What `draw_raw` gave.
        k: Which of them.

    Returns:
        The grasp, without certificate; or the reason why there is none.
    """
    if raw.energy[k] > TIP_RESIDUAL:
        return Rejection(Reason.INVERSE_KINEMATICS)
    X_WH, q = _pose(raw.R_WHs[k], raw.p_WHs[k]), np.clip(raw.qs[k], *hand.limits)
    opened = pregrasp(hand, scene, X_WH, q)
    parts, mesh = penetrations(hand, Configuration.at(hand, X_WH, q), scene)
    grasp = Grasp(
        hand=hand.name,
        object=scene.object.name,
        X_WO=scene.X_WO,
        X_WH=X_WH,
        q=q,
        X_WH_pregrasp=opened.X_WH,
        q_pregrasp=opened.q,
        penetration_parts_m=parts,
        penetration_mesh_m=mesh,
    )
    return squeeze_by_rule(hand, grasp, scene, LIFT.plant.kp)


def refined_starts(
    hand: Hand, scene: Scene, raw: Candidates, *, seed: int = 0, retry: RetrySettings = RETRY
) -> list[Candidates]:
    """Starts of the post-optimisation about every prediction, after one short descent of all of them together.

    A good prediction needs no descent. Each also descends as it is, and from jittered starts about it, some of which
    touch with other fingers: the nearest fingers alone do not say which contacts hold. Starts that end more than
    `REACH` from the prediction's wrist are another grasp, and are left out.

    Args:
        hand: The hand.
        scene: The scene.
        raw: The predictions.
        seed: Seed of the jitter.
        retry: How many jittered starts, and how far about.

    Returns:
        For each prediction its starts: the prediction itself, itself after the descent, the others, least energy first.
    """
    rng = np.random.default_rng([seed, 1])
    about = [
        jittered_starts(hand, _pose(raw.R_WHs[k], raw.p_WHs[k]), raw.qs[k], raw.fingers[k], rng, retry=retry)
        for k in range(len(raw.energy))
    ]
    found = refine(hand, scene, _joined(about), settings=REFINEMENT)
    each = 1 + retry.starts
    starts = []
    for k in range(len(raw.energy)):
        rows = np.arange(k * each, (k + 1) * each)
        rows = np.append(rows[0], rows[1:][np.argsort(found.energy[rows[1:]], kind="stable")])
        near = rows[np.linalg.norm(found.p_WHs[rows] - raw.p_WHs[k], axis=1) <= REACH]
        starts.append(_joined([raw.take(slice(k, k + 1)), found.take(near)]))
    return starts


def _joined(parts: Sequence[Candidates]) -> Candidates:
    return Candidates(
        R_WHs=np.concatenate([part.R_WHs for part in parts]),
        p_WHs=np.concatenate([part.p_WHs for part in parts]),
        qs=np.concatenate([part.qs for part in parts]),
        fingers=np.concatenate([part.fingers for part in parts]),
        energy=np.concatenate([part.energy for part in parts]),
        terms={},
    )


@dataclass(frozen=True)
class ModelProposer:
    """Proposes what a model draws; equal seeds give corresponding candidates of different hands.

    Attributes:
        checkpoint: File of the model, or the folder that holds it.
        stage: `refined` polishes each draw, from several starts about it, until one is certified; `raw` takes what
            inverse kinematics gives.
        polish: Numbers of the hard constraints of the candidates' programs; the defaults where None.
        retry: Jittered starts about each draw.
    """

    checkpoint: str
    stage: Literal["raw", "refined"] = "refined"
    polish: PolishSettings | None = None
    retry: RetrySettings = RETRY

    def __call__(self, hand: Hand, scene: Scene, count: int, seed: int) -> Iterator[Candidate]:
        """Draws, solves inverse kinematics and refines once, for all candidates; see `grasping.proposers.Proposer`."""
        start = time.perf_counter()
        raw = draw_raw(load_model(self.checkpoint), hand, scene, count=count, seed=seed)
        if self.stage == "raw":
            yield from raw_candidates(hand, scene, raw, seconds=time.perf_counter() - start)
            return
        starts = refined_starts(hand, scene, raw, seed=seed, retry=self.retry)
        yield from refined_candidates(hand, scene, starts, seconds=time.perf_counter() - start, polish=self.polish)


def raw_candidates(hand: Hand, scene: Scene, raw: Candidates, *, seconds: float = 0.0) -> Iterator[Candidate]:
    """Predictions as inverse kinematics gives them, `m0`, `m1`, ...; `seconds` went into all of them."""
    for k in range(len(raw.energy)):
        yield Candidate(f"m{k}", partial(_raw, hand, scene, raw, k), seconds / len(raw.energy))


def refined_candidates(
    hand: Hand,
    scene: Scene,
    starts: Sequence[Candidates],
    *,
    seconds: float = 0.0,
    polish: PolishSettings | None = None,
) -> Iterator[Candidate]:
    """Predictions with their starts, `m0`, `m1`, ...: polished in turn until one is certified; see `refined_starts`."""
    for k, some in enumerate(starts):
        yield Candidate(f"m{k}", partial(_programs, hand, scene, some, polish), seconds / len(starts))


def _programs(hand: Hand, scene: Scene, starts: Candidates, polish: PolishSettings | None) -> Iterator[GraspProgram]:
    for R_WH, p_WH, q, fingers in zip(starts.R_WHs, starts.p_WHs, starts.qs, starts.fingers, strict=True):
        # The first start is the prediction itself.
        near = (reach_block(starts.p_WHs[0], REACH),)
        yield polish_program(hand, scene, _pose(R_WH, p_WH), q, fingers, settings=polish, extra_constraints=near)


def _raw(hand: Hand, scene: Scene, raw: Candidates, k: int) -> Iterator[Grasp | Rejection]:
    yield raw_grasp(hand, scene, raw, k)


def best_grasp(grasps: Sequence[Grasp]) -> Grasp | None:
    """The grasp that is foretold to hold best, by what is stored with it and never by simulation; None of none.

    `foretold_motion` separates grasps that hold from others best of all that is known of them (`studies/holds`).
    """
    return min(grasps, key=lambda g: np.nan_to_num(g.foretold_motion, nan=np.inf), default=None)


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
