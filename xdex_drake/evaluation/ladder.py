"""The diagnosis ladder: at which step, from labels to draws, grasps stop lifting.

On grasps of a data set, each step takes away one thing that is known:

    labels      the stored grasp, lifted again
    poses       its link poses through inverse kinematics: what the representation loses
    posterior   encoded and decoded: what the latent loses
    prior       a latent drawn at the true object point: what sampling loses
    point       a point of the model's own as well: what a user gets

Each step but the first is lifted raw and refined.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.dataset.files import StoredGrasp, load_grasps
from xdex_drake.dataset.folder import read_manifest, shard_paths
from xdex_drake.errors import CheckpointError, DatasetError
from xdex_drake.evaluation.verdicts import Verdict, judge
from xdex_drake.grasp import Grasp
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.jobs.processes import run_units
from xdex_drake.jobs.workbench import hand_of, rig_of, scene_of, use_one_thread
from xdex_drake.learning.features import hand_features, link_frames
from xdex_drake.learning.predict import Prediction, decode, encode, sample
from xdex_drake.learning.proposer import configurations, load_model, scene_features
from xdex_drake.learning.protocol import LatentModel
from xdex_drake.scene.facts import SceneFacts
from xdex_drake.simulation.drake import simulate_lift

STEPS = ("labels", "poses", "posterior", "prior", "point")


@dataclass(frozen=True, eq=False)
class Rung:
    """Grasps of one hand in one scene, to be taken down the ladder.

    Attributes:
        group: Group of the hand: `seen` or `unseen`.
        hand: Name or path of the hand.
        scene: The scene.
        grasps: The stored grasps.
        points_O: Object points that condition them, in O [m], shape (n, 3).
        checkpoint: The model.
        seed: Seed of the draws.
    """

    group: str
    hand: str
    scene: SceneFacts
    grasps: tuple[Grasp, ...]
    points_O: Array
    checkpoint: str
    seed: int


def rungs(
    folder: str | Path, checkpoint: str | Path, *, unseen: Sequence[str] = (), count: int = 40, seed: int = 0
) -> list[Rung]:
    """Lifted grasps of a data set, hand by hand and scene by scene.

    Args:
        folder: Folder of the data set, of scenes that the model has not seen.
        checkpoint: The model.
        unseen: Names of hands that it has not seen.
        count: Number of grasps, at most, drawn from all shards.
        seed: Seed of their choice and of the draws.

    Returns:
        The rungs.

    Raises:
        DatasetError: The folder is no data set, or holds no lifted grasp.
        GraspFileError: A shard cannot be used.
    """
    read_manifest(folder)
    rng, shards = np.random.default_rng(seed), shard_paths(folder)
    paths = [shards[k] for k in rng.permutation(len(shards))]
    chosen: dict[tuple[str, str], list[StoredGrasp]] = {}
    left = count
    for path in paths:
        lifted = [s for s in load_grasps(path) if s.grasp.lift is not None and s.grasp.lift.success]
        few = [lifted[k] for k in rng.permutation(len(lifted))[: max(1, min(left, -(-count // 8)))]]
        for stored in few:
            chosen.setdefault((stored.hand_path, stored.facts.scene_id), []).append(stored)
        left -= len(few)
        if left <= 0:
            break
    if not chosen:
        raise DatasetError(f"{folder}: holds no lifted grasp to begin a ladder with")
    return [
        Rung(
            group="unseen" if some[0].hand.name in unseen else "seen",
            hand=hand,
            scene=some[0].facts,
            grasps=tuple(s.grasp for s in some),
            points_O=np.array([s.row["source_object_point_O"] or s.row["object_point_O"] for s in some]),
            checkpoint=str(checkpoint),
            seed=seed,
        )
        for (hand, _), some in chosen.items()
    ]


def descend(rung: Rung) -> list[Verdict]:
    """Takes grasps down the ladder.

    Args:
        rung: The grasps.

    Returns:
        Verdicts; their stage is the step, and after it `raw` or `refined`.

    Raises:
        CheckpointError: The model has no latent to encode to.
    """
    use_one_thread()
    model = load_model(rung.checkpoint)
    if not isinstance(model, LatentModel):
        raise CheckpointError(f"{rung.checkpoint}: this model cannot encode grasps; train one with `xdex train`")
    hand, scene, rig = hand_of(rung.hand), scene_of(rung.scene), rig_of(rung.hand, rung.scene)
    known, cloud = hand_features(hand), scene_features(scene)
    p_WPoints = (scene.X_WO @ rung.points_O.T).T
    poses = [forward_kinematics(hand, grasp.X_WH, grasp.q) for grasp in rung.grasps]
    R_WGs, p_WGs = link_frames(known, *(np.array(part) for part in zip(*poses, strict=True)))
    n = len(rung.grasps)

    verdicts = []
    for number, grasp in enumerate(rung.grasps):
        lift = simulate_lift(rig, grasp)
        depth = 100.0 * grasp.penetration_mesh_m
        verdicts.append(
            Verdict(
                rung.group, hand.name, scene.scene_id, "labels", number, True, lift.success, lift.failure_reason,
                depth, 0.0, 0.0, 0.0,
            )
        )  # fmt: skip

    latents, indices = encode(model, known, cloud, R_WGs, p_WGs, p_WPoints)
    true = Prediction(R_WGs, p_WGs, p_WPoints, indices, latents)
    makers: dict[str, Callable[[], Prediction]] = {
        "poses": lambda: true,
        "posterior": lambda: decode(model, known, cloud, latents, indices),
        "prior": lambda: sample(model, known, cloud, n, seed=rung.seed, point_indices=indices),
        "point": lambda: sample(model, known, cloud, n, seed=rung.seed),
    }
    tips = known.keypoint_links[1:]
    offsets = known.keypoint_offsets[1:]

    def tip_points(p: Prediction) -> np.ndarray:
        return p.p_WGs[:, tips] + (p.R_WGs[:, tips] @ offsets[..., None])[..., 0]

    for step, make in makers.items():
        made = make()
        raw = configurations(hand, scene, made)
        error = 1000.0 * np.linalg.norm(tip_points(made) - tip_points(true), axis=-1).mean(axis=1)
        for verdict, _ in judge(hand, scene, rig, raw, ("raw", "refined"), judged=n, group=rung.group, seed=rung.seed):
            # Beside the label, the fingertips' error of what is decoded; of what is drawn there is no true one.
            known_error = float(error[verdict.sample]) if step == "posterior" else verdict.tip_mm
            verdicts.append(replace(verdict, stage=f"{step} {verdict.stage}", tip_mm=known_error))
    return verdicts


def climb(
    some: Sequence[Rung], *, workers: int = 2, on_done: Callable[[Rung], None] | None = None
) -> Iterator[Verdict]:
    """Takes many rungs down the ladder.

    Args:
        some: The rungs.
        workers: Number of processes; 0 works in this one.
        on_done: Called after each.

    Yields:
        Their verdicts.

    Raises:
        CheckpointError: See `descend`.
        RuntimeError: A rung was lost.
    """
    for done in run_units(some, descend, workers=workers, timeout_s=1800.0):
        if done.value is None:
            if done.failure is not None and done.failure.error is not None:
                raise done.failure.error
            raise RuntimeError(f"{done.unit.hand} on {done.unit.scene.scene_id} was lost: {done.failure}")
        if on_done is not None:
            on_done(done.unit)
        yield from done.value
