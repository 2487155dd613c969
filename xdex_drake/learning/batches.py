"""Training data: grasps in memory, and the batches that a training step draws from them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.learning.features import HandFeatures, ObjectFeatures, link_pose_vectors
from xdex_drake.learning.models.cvae import HandBatch, normalize_poses
from xdex_drake.learning.models.layers import LENGTH_UNIT


@dataclass(frozen=True)
class Sample:
    """A grasp to learn from.

    Attributes:
        hand: Index of its hand in the training set.
        scene: Index of its scene.
        R_WLs: Rotations of the links in W, shape (L, 3, 3).
        p_WLs: Origins of the links in W [m], shape (L, 3).
        p_WPoint: The object point that it heads for (its source grasp's, where it was retargeted) in W [m], shape (3,).
        pair: Grasps of one scene with one number are versions of one grasp for several hands; -1 for none.
    """

    hand: int
    scene: int
    R_WLs: Array
    p_WLs: Array
    p_WPoint: Array
    pair: int = -1


@dataclass(frozen=True)
class TrainingSet:
    """What to learn from, in memory.

    Attributes:
        hands: The hands.
        scenes: The scenes, each with more points than a training step uses (four times as many is good).
        samples: The grasps.
    """

    hands: tuple[HandFeatures, ...]
    scenes: tuple[ObjectFeatures, ...]
    samples: tuple[Sample, ...]


class Data(NamedTuple):
    """A training set as tensors. Positions are relative to the center of the grasp's object, axes of W.

    Attributes:
        hands: All hands.
        keypoint_links: Links of the keypoints, shape (H, K), int64; K runs over the names of all hands.
        keypoint_offsets: Their offsets in the networks' unit, shape (H, K, 3).
        keypoint_mask: True where the hand has the keypoint, shape (H, K).
        clouds: Points of each scene [m], shape (n, 3) each.
        vectors: Link pose vectors, shape (M, L, 9).
        points: Object points [m], shape (M, 3).
        hand: Hand of each grasp, shape (M,).
        scene: Scene of each grasp, shape (M,).
        pair: Pair of each grasp, shape (M,).
    """

    hands: HandBatch
    keypoint_links: Tensor
    keypoint_offsets: Tensor
    keypoint_mask: Tensor
    clouds: list[Tensor]
    vectors: Tensor
    points: Tensor
    hand: np.ndarray
    scene: np.ndarray
    pair: np.ndarray


class BatchSizes(NamedTuple):
    """Sizes of a batch.

    Attributes:
        batch: Grasps, an even number.
        scenes: Scenes, which share the grasps evenly.
        points: Points of each scene.
        jitter: Standard deviation of the noise on points [m].
        latent: Dimensions of the latents.
    """

    batch: int
    scenes: int
    points: int
    jitter: float
    latent: int


class Batch(NamedTuple):
    """A step's data. Grasps 2 i and 2 i + 1 are a couple, where possible two versions of one grasp.

    Attributes:
        hands: The hands of the step.
        hand_indices: Their indices in the data, shape (H,).
        hand: Hand of each grasp among them, shape (B,).
        clouds: The scenes' points [m], shape (S, N, 3).
        cloud: Scene of each grasp among them, shape (B,).
        point: Conditioned point of each grasp in its cloud, shape (B,).
        point_weights: How much each point is headed for by all grasps of its scene, shape (S, N).
        poses: Normalised link pose vectors, shape (B, L, 9).
        paired: True where a couple is a pair, shape (B / 2,).
        noise: Standard normal draws for the latents, shape (B, latent).
    """

    hands: HandBatch
    hand_indices: Tensor
    hand: Tensor
    clouds: Tensor
    cloud: Tensor
    point: Tensor
    point_weights: Tensor
    poses: Tensor
    paired: Tensor
    noise: Tensor


def pack(samples: TrainingSet, device: torch.device) -> Data:
    """Turn a training set into tensors.

    Args:
        samples: The training set.
        device: Where to put them.

    Returns:
        The tensors.

    Raises:
        ConfigError: A grasp does not fit its hand or scene, or holds numbers that are not finite.
    """
    names = sorted({name for hand in samples.hands for name in hand.keypoint_names})
    H, L, K = len(samples.hands), max((len(h.link_names) for h in samples.hands), default=0), len(names)
    N = {hand.link_points.shape[1] for hand in samples.hands}
    if len(N) != 1 or not samples.samples:
        raise ConfigError("a training set needs grasps, and hands with one number of points on every link")
    points, origins = np.zeros((H, L, N.pop(), 3)), np.zeros((H, L, 3))
    spd, mask = np.zeros((H, L, L), dtype=np.int64), np.zeros((H, L), dtype=bool)
    links, offsets, has = np.zeros((H, K), dtype=np.int64), np.zeros((H, K, 3)), np.zeros((H, K), dtype=bool)
    for h, hand in enumerate(samples.hands):
        n = len(hand.link_names)
        points[h, :n], origins[h, :n], spd[h, :n, :n], mask[h, :n] = hand.link_points, hand.p_HLs_zero, hand.spd, True
        columns = [names.index(name) for name in hand.keypoint_names]
        links[h, columns], has[h, columns] = hand.keypoint_links, True
        offsets[h, columns] = hand.keypoint_offsets / LENGTH_UNIT

    vectors, heads = np.zeros((len(samples.samples), L, 9)), np.zeros((len(samples.samples), 3))
    vectors[..., 3] = vectors[..., 7] = 1.0
    for k, grasp in enumerate(samples.samples):
        if not (0 <= grasp.hand < H and 0 <= grasp.scene < len(samples.scenes)):
            raise ConfigError(f"grasp {k} of the training set names hand {grasp.hand} and scene {grasp.scene}")
        hand, scene = samples.hands[grasp.hand], samples.scenes[grasp.scene]
        n = len(hand.link_names)
        if grasp.R_WLs.shape != hand.R_HLs_zero.shape or grasp.p_WLs.shape != hand.p_HLs_zero.shape:
            raise ConfigError(f"grasp {k} of the training set does not have the {n} links of {hand.name}")
        vectors[k, :n] = link_pose_vectors(grasp.R_WLs, grasp.p_WLs - scene.p_WCenter, hand.R_HLs_zero)
        heads[k] = grasp.p_WPoint - scene.p_WCenter
    if not (np.isfinite(vectors).all() and np.isfinite(heads).all()):
        raise ConfigError("a grasp of the training set holds numbers that are not finite; check the data set")

    def put(array: np.ndarray) -> Tensor:
        return torch.as_tensor(array, dtype=torch.float32 if array.dtype == np.float64 else None, device=device)

    return Data(
        hands=HandBatch(put(points), put(origins), put(spd), put(mask)),
        keypoint_links=put(links),
        keypoint_offsets=put(offsets),
        keypoint_mask=put(has),
        clouds=[put(scene.points) for scene in samples.scenes],
        vectors=put(vectors),
        points=put(heads),
        hand=np.array([s.hand for s in samples.samples]),
        scene=np.array([s.scene for s in samples.samples]),
        pair=np.array([s.pair for s in samples.samples]),
    )


def draw_batch(data: Data, scenes: np.ndarray, sizes: BatchSizes, rng: np.random.Generator) -> Batch:
    """Draw a step's data: scenes by their number of grasps, grasps two by two, all turned about the vertical.

    Args:
        data: The data.
        scenes: Scenes to draw from, each with grasps.
        sizes: Sizes of the batch.
        rng: Generator.

    Returns:
        The batch.
    """
    counts = np.bincount(data.scene, minlength=len(data.clouds))[scenes].astype(float)
    S = min(sizes.scenes, len(scenes))
    chosen = rng.choice(scenes, S, replace=False, p=counts / counts.sum())
    couples = np.array_split(np.zeros(sizes.batch // 2), S)
    grasps = np.concatenate([draw_couples(data, s, len(share), rng) for s, share in zip(chosen, couples, strict=True)])
    yaws = rng.uniform(-np.pi, np.pi, S)
    return make_batch(data, chosen, grasps, yaws, sizes, rng)


def draw_couples(data: Data, scene: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw grasps of a scene, each followed by another version of it, or by any of its grasps where there is none.

    Args:
        data: The data.
        scene: The scene.
        count: Number of couples.
        rng: Generator.

    Returns:
        Indices of grasps, shape (2 count,).
    """
    here = np.flatnonzero(data.scene == scene)
    grasps = np.empty(2 * count, dtype=np.int64)
    for k, first in enumerate(rng.choice(here, count, replace=count > len(here))):
        mates = here[(data.pair[here] == data.pair[first]) & (data.pair[here] >= 0) & (here != first)]
        grasps[2 * k : 2 * k + 2] = first, rng.choice(mates if len(mates) else here)
    return grasps


def make_batch(
    data: Data, scenes: np.ndarray, grasps: np.ndarray, yaws: np.ndarray, sizes: BatchSizes, rng: np.random.Generator
) -> Batch:
    """Batch of given grasps.

    Args:
        data: The data.
        scenes: Scenes of the batch, shape (S,).
        grasps: Grasps, each of one of these scenes, two by two, shape (B,).
        yaws: Angles to turn the scenes by, about the vertical through the object's center [rad], shape (S,).
        sizes: Sizes of the batch.
        rng: Generator of the points' choice, their noise, and the latents' noise.

    Returns:
        The batch.
    """
    device = data.vectors.device

    def put(array: np.ndarray) -> Tensor:
        return torch.as_tensor(array, dtype=torch.float32 if array.dtype == np.float64 else None, device=device)

    clouds, weights = [], []
    c, s, o, i = np.cos(yaws), np.sin(yaws), np.zeros_like(yaws), np.ones_like(yaws)
    R = put(np.stack([c, -s, o, s, c, o, o, o, i], axis=1).reshape(-1, 3, 3))
    for k, scene in enumerate(scenes):
        cloud = data.clouds[scene]
        kept = rng.choice(len(cloud), sizes.points, replace=len(cloud) < sizes.points)
        noise = sizes.jitter * rng.standard_normal((sizes.points, 3))
        clouds.append((cloud[put(kept)] + put(noise)) @ R[k].T)
        weights.append(graspness(clouds[-1], data.points[put(np.flatnonzero(data.scene == scene))] @ R[k].T))

    position = {scene: k for k, scene in enumerate(scenes)}
    cloud = put(np.array([position[scene] for scene in data.scene[grasps]], dtype=np.int64))
    hands, hand = np.unique(data.hand[grasps], return_inverse=True)
    index, hand_indices, points = put(grasps), put(hands), torch.stack(clouds)
    L = int(data.hands.mask[hand_indices].sum(dim=1).max())
    turned = data.vectors[index, :L].unflatten(-1, (3, 3)) @ R[cloud][:, None].transpose(-1, -2)  # rows p, x, y
    heads = (R[cloud] @ data.points[index][:, :, None]).squeeze(-1)
    point = torch.cdist(heads[:, None], points[cloud]).squeeze(1).argmin(dim=1)
    pair = data.pair[grasps]
    return Batch(
        hands=HandBatch(
            data.hands.points[hand_indices, :L],
            data.hands.origins[hand_indices, :L],
            data.hands.spd[hand_indices, :L, :L],
            data.hands.mask[hand_indices, :L],
        ),
        hand_indices=hand_indices,
        hand=put(hand.astype(np.int64)),
        clouds=points,
        cloud=cloud,
        point=point,
        point_weights=torch.stack(weights),
        poses=normalize_poses(turned.flatten(-2), points[cloud, point]),
        paired=put((pair[::2] == pair[1::2]) & (pair[::2] >= 0) & (grasps[::2] != grasps[1::2])),
        noise=put(rng.standard_normal((len(grasps), sizes.latent))),
    )


def graspness(points: Tensor, heads: Tensor) -> Tensor:
    """How much points of an object are headed for: the sum over grasps of 10^(-150 distance), after DexGraspNet 2.0.

    Args:
        points: Points of the object [m], shape (N, 3).
        heads: Object points of grasps [m], shape (G, 3).

    Returns:
        Graspness, positive, shape (N,).
    """
    return (10.0 ** (-150.0 * torch.cdist(points, heads))).sum(dim=1) + 1e-12
