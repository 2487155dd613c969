"""Link poses from a model: sampling and neural retargeting. Inverse kinematics then turns them into grasps."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from xdex_drake.arrays import Array
from xdex_drake.learning.losses import rotations_from_columns
from xdex_drake.learning.pack import HandFeatures, ObjectFeatures, pose_vectors
from xdex_drake.learning.protocol import (
    Clouds,
    Drawn,
    HandBatch,
    LatentModel,
    Model,
    denormalize_poses,
    normalize_poses,
)


@dataclass(frozen=True)
class Prediction:
    """Link poses of some grasps of one hand: those of the frames G of its tokens (see `features`).

    Attributes:
        R_WGs: Rotations in W, shape (count, L, 3, 3).
        p_WGs: Origins in W [m], shape (count, L, 3).
        p_WPoints: The object points that the grasps are conditioned on, in W [m], shape (count, 3).
        point_indices: Their indices in the object's points, shape (count,).
        latents: What else was drawn, shape (count, D).
    """

    R_WGs: Array
    p_WGs: Array
    p_WPoints: Array
    point_indices: np.ndarray
    latents: Array


def sample(
    model: Model,
    hand: HandFeatures,
    object: ObjectFeatures,
    count: int,
    *,
    seed: int = 0,
    temperature: float = 1.0,
    point_indices: np.ndarray | None = None,
) -> Prediction:
    """Draws grasps of an object by a hand.

    What does not depend on the hand is drawn alike for every hand: calls for several hands with one seed give
    corresponding grasps.

    Args:
        model: The model.
        hand: The hand.
        object: The object.
        count: Number of grasps.
        seed: Seed of the draw.
        temperature: Factor on what is drawn from a normal distribution; 0 gives the most typical grasp of each point.
        point_indices: Condition on these points of the object instead of drawn ones, shape (count,).

    Returns:
        The grasps.
    """
    rng = np.random.default_rng(seed)
    with torch.inference_mode():
        points = None if point_indices is None else _indices(point_indices, model)
        arguments = one_hand(hand, model), one_cloud(object, model), count, rng
        drawn = model.sample(*arguments, temperature=temperature, points=points)
        return _prediction(drawn, object)


def encode(
    model: LatentModel, hand: HandFeatures, object: ObjectFeatures, R_WGs: Array, p_WGs: Array, p_WPoints: Array
) -> tuple[Array, np.ndarray]:
    """Most likely latents of given grasps, and the nearest of the object's points to the point that each heads for.

    Args:
        model: The model.
        hand: The hand of the grasps.
        object: The object.
        R_WGs: Rotations of its frames G in W, shape (count, L, 3, 3).
        p_WGs: Their origins in W [m], shape (count, L, 3).
        p_WPoints: Object points in W [m], shape (count, 3).

    Returns:
        Latents, shape (count, D), and indices of points, shape (count,).
    """
    apart = (p_WPoints - object.p_WCenter)[:, None] - object.points
    indices = np.argmin(np.linalg.norm(apart, axis=-1), axis=1)
    with torch.inference_mode():
        vectors = pose_vectors(R_WGs, p_WGs - object.p_WCenter)
        poses = normalize_poses(_tensor(vectors, model), _tensor(object.points[indices], model))
        latents = model.encode_grasps(one_hand(hand, model), one_cloud(object, model), poses, _indices(indices, model))
    return latents.double().cpu().numpy(), indices


def neural_retarget(
    model: LatentModel,
    source: HandFeatures,
    target: HandFeatures,
    object: ObjectFeatures,
    R_WGs: Array,
    p_WGs: Array,
    p_WPoints: Array,
) -> Prediction:
    """Neural retargeting, Eq. (7): encode one hand's grasps, decode their most likely latents for another hand.

    Args:
        model: The model.
        source: The hand of the given grasps.
        target: The hand to carry them to.
        object: The object.
        R_WGs: Rotations of the source's frames G in W, shape (count, L, 3, 3).
        p_WGs: Their origins in W [m], shape (count, L, 3).
        p_WPoints: Object points that the given grasps head for, in W [m], shape (count, 3).

    Returns:
        The target's grasps.
    """
    mean, indices = encode(model, source, object, R_WGs, p_WGs, p_WPoints)
    return decode(model, target, object, mean, indices)


def decode(
    model: LatentModel, hand: HandFeatures, object: ObjectFeatures, latents: Array, point_indices: np.ndarray
) -> Prediction:
    """The grasps of given latents.

    Args:
        model: The model.
        hand: The hand.
        object: The object.
        latents: Latents, shape (count, D).
        point_indices: Indices of the object's points that they are conditioned on, shape (count,).

    Returns:
        The grasps.
    """
    with torch.inference_mode():
        z, points = _tensor(latents, model), _indices(point_indices, model)
        poses = model.decode_grasps(one_hand(hand, model), one_cloud(object, model), z, points)
        return _prediction(Drawn(poses, points, z), object)


def one_hand(hand: HandFeatures, model: Model) -> HandBatch:
    """A hand as a model takes it, on the model's device."""
    L = len(hand.link_names)
    return HandBatch(
        points=_tensor(hand.link_points, model),
        normals=_tensor(hand.link_normals, model),
        centers=_tensor(hand.centers, model),
        joints=_tensor(hand.joints, model),
        spd=_indices(hand.spd, model)[None],
        mask=torch.ones((1, L), dtype=torch.bool, device=_device(model)),
    )


def one_cloud(object: ObjectFeatures, model: Model) -> Clouds:
    """An object as a model takes it, on the model's device."""
    table = _tensor(-object.p_WCenter[2:], model)
    return Clouds(_tensor(object.points, model)[None], _tensor(object.normals, model)[None], table)


def _prediction(drawn: Drawn, object: ObjectFeatures) -> Prediction:
    indices = drawn.points.cpu().numpy()
    points = torch.as_tensor(object.points[indices], dtype=drawn.poses.dtype, device=drawn.poses.device)
    vectors = denormalize_poses(drawn.poses, points).double().cpu()
    return Prediction(
        R_WGs=rotations_from_columns(vectors[..., 3:]).numpy(),
        p_WGs=vectors[..., :3].numpy() + object.p_WCenter,
        p_WPoints=object.points[indices] + object.p_WCenter,
        point_indices=indices,
        latents=drawn.latents.double().cpu().numpy(),
    )


def _device(model: Model) -> torch.device:
    return next(model.parameters()).device


def _tensor(array: Array, model: Model) -> Tensor:
    return torch.as_tensor(array, dtype=torch.float32, device=_device(model))


def _indices(array: np.ndarray, model: Model) -> Tensor:
    return torch.as_tensor(array, dtype=torch.int64, device=_device(model))
