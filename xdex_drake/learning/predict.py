"""Link poses from the model: sampling and neural retargeting. Inverse kinematics then turns them into grasps."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from xdex_drake.arrays import Array
from xdex_drake.learning.features import HandFeatures, ObjectFeatures, link_pose_vectors, link_poses_from_vectors
from xdex_drake.learning.models.cvae import CVAE, HandBatch, denormalize_poses, normalize_poses


@dataclass(frozen=True)
class Prediction:
    """Link poses of some grasps of one hand.

    Attributes:
        R_WLs: Rotations of the links in W, shape (count, L, 3, 3).
        p_WLs: Origins of the links in W [m], shape (count, L, 3).
        p_WPoints: The object points that the grasps are conditioned on, in W [m], shape (count, 3).
        point_indices: Their indices in the object's points, shape (count,).
        latents: The latents, shape (count, latent).
    """

    R_WLs: Array
    p_WLs: Array
    p_WPoints: Array
    point_indices: np.ndarray
    latents: Array


def sample(
    model: CVAE,
    hand: HandFeatures,
    object: ObjectFeatures,
    count: int,
    *,
    seed: int = 0,
    temperature: float = 1.0,
    point_indices: np.ndarray | None = None,
    latents: Array | None = None,
) -> Prediction:
    """Draw grasps of an object by a hand.

    Object points and latents depend on the object and the seed alone: calls for several hands with one seed give
    corresponding grasps.

    Args:
        model: The model.
        hand: The hand.
        object: The object.
        count: Number of grasps.
        seed: Seed of the draw.
        temperature: Factor on the latents; 0 gives the most typical grasp of each point.
        point_indices: Condition on these points of the object instead of drawn ones, shape (count,).
        latents: Use these latents instead of drawn ones, shape (count, latent).

    Returns:
        The grasps.
    """
    rng = np.random.default_rng(seed)
    with torch.inference_mode():
        features, logits = _object(model, object)
        probability = torch.softmax(logits.double(), dim=0).cpu().numpy()
        drawn = rng.choice(len(probability), count, p=probability / probability.sum())
        noise = temperature * rng.standard_normal((count, model.config.latent))
        indices = drawn if point_indices is None else np.asarray(point_indices, dtype=np.int64)
        z = noise if latents is None else np.asarray(latents, dtype=float)
        return _decode(model, hand, object, features, indices, _tensor(z, model))


def encode(
    model: CVAE, hand: HandFeatures, object: ObjectFeatures, R_WLs: Array, p_WLs: Array, p_WPoints: Array
) -> tuple[Array, np.ndarray]:
    """Latent means of given grasps, and the nearest of the object's points to the point that each heads for.

    Args:
        model: The model.
        hand: The hand of the grasps.
        object: The object.
        R_WLs: Rotations of the links in W, shape (count, L, 3, 3).
        p_WLs: Origins of the links in W [m], shape (count, L, 3).
        p_WPoints: Object points in W [m], shape (count, 3).

    Returns:
        Means, shape (count, latent), and indices of points, shape (count,).
    """
    apart = (p_WPoints - object.p_WCenter)[:, None] - object.points
    indices = np.argmin(np.linalg.norm(apart, axis=-1), axis=1)
    with torch.inference_mode():
        features, _ = _object(model, object)
        vectors = link_pose_vectors(R_WLs, p_WLs - object.p_WCenter, hand.R_HLs_zero)
        poses = normalize_poses(_tensor(vectors, model), _tensor(object.points[indices], model))
        mask = torch.ones(poses.shape[:2], dtype=torch.bool, device=poses.device)
        mean, _ = model.encode(poses, mask, features[torch.as_tensor(indices, device=features.device)])
    return mean.double().cpu().numpy(), indices


def retarget(
    model: CVAE,
    source: HandFeatures,
    target: HandFeatures,
    object: ObjectFeatures,
    R_WLs: Array,
    p_WLs: Array,
    p_WPoints: Array,
) -> Prediction:
    """Neural retargeting, Eq. (7): encode one hand's grasps, decode their latent means for another hand.

    Args:
        model: The model.
        source: The hand of the given grasps.
        target: The hand to carry them to.
        object: The object.
        R_WLs: Rotations of the source's links in W, shape (count, L, 3, 3).
        p_WLs: Origins of the source's links in W [m], shape (count, L, 3).
        p_WPoints: Object points that the given grasps head for, in W [m], shape (count, 3).

    Returns:
        The target's grasps.
    """
    mean, indices = encode(model, source, object, R_WLs, p_WLs, p_WPoints)
    return sample(model, target, object, len(mean), point_indices=indices, latents=mean)


def _object(model: CVAE, object: ObjectFeatures) -> tuple[Tensor, Tensor]:
    """Features, shape (N, d), and logits, shape (N,), of the object's points."""
    features = model.point_features(_tensor(object.points, model)[None])
    return features[0], model.point_logits(features)[0]


def _decode(
    model: CVAE, hand: HandFeatures, object: ObjectFeatures, features: Tensor, indices: np.ndarray, z: Tensor
) -> Prediction:
    batch = HandBatch(
        points=_tensor(hand.link_points, model)[None],
        origins=_tensor(hand.p_HLs_zero, model)[None],
        spd=torch.as_tensor(hand.spd, device=z.device)[None],
        mask=torch.ones((1, len(hand.link_names)), dtype=torch.bool, device=z.device),
    )
    count = len(indices)
    links = model.link_features(batch).expand(count, -1, -1)
    poses = model.decode(links, batch.mask.expand(count, -1), z, features[torch.as_tensor(indices, device=z.device)])
    vectors = denormalize_poses(poses, _tensor(object.points[indices], model)).double().cpu().numpy()
    R_WLs, p_WLs = link_poses_from_vectors(vectors, hand.R_HLs_zero)
    return Prediction(
        R_WLs=R_WLs,
        p_WLs=p_WLs + object.p_WCenter,
        p_WPoints=object.points[indices] + object.p_WCenter,
        point_indices=indices,
        latents=z.double().cpu().numpy(),
    )


def _tensor(array: Array, model: CVAE) -> Tensor:
    return torch.as_tensor(array, dtype=torch.float32, device=next(model.parameters()).device)
