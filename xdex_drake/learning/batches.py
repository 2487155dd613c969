"""The batches that training steps draw from a training pack."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from xdex_drake.learning.pack import NORMAL, Pack
from xdex_drake.learning.protocol import LENGTH_UNIT, Batch, Clouds, HandBatch, Keypoints, normalize_poses


class Data(NamedTuple):
    """A training pack on a device; arrays as in `Pack`.

    Attributes:
        links: Number of links of each hand, shape (H,), int64.
        first_links: Row of each hand's first link, shape (H,), int64.
        first_spd: Row of each hand's first distance, shape (H,), int64.
        link_points: Points on the links, shape (L, N, 3).
        link_normals: Normals there, shape (L, N, 3).
        link_origins: Origins of the links, shape (L, 3).
        spd: Shortest-path distances, shape (sum of links^2,), uint8.
        keypoints: Keypoints of all hands.
        clouds: All scenes.
        first_vectors: Row of each grasp's first link, shape (M,), int64.
        vectors: Link pose vectors, shape (V, 9).
        points: Object points [m], shape (M, 3).
        hand: Hand of each grasp, shape (M,).
        scene: Scene of each grasp, shape (M,).
        pair: Pair of each grasp, shape (M,).
    """

    links: Tensor
    first_links: Tensor
    first_spd: Tensor
    link_points: Tensor
    link_normals: Tensor
    link_origins: Tensor
    spd: Tensor
    keypoints: Keypoints
    clouds: Clouds
    first_vectors: Tensor
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
    """

    batch: int
    scenes: int
    points: int
    jitter: float


def load_pack(pack: Pack, device: torch.device) -> Data:
    """Puts a training pack on a device.

    Args:
        pack: The pack.
        device: The device.

    Returns:
        Its data.
    """

    def put(array: np.ndarray) -> Tensor:
        return torch.tensor(array, device=device)

    squares = pack.links.astype(np.int64) ** 2
    return Data(
        links=put(pack.links.astype(np.int64)),
        first_links=put(pack.first_links),
        first_spd=put(np.cumsum(squares) - squares),
        link_points=put(pack.link_points),
        link_normals=put(pack.link_normals),
        link_origins=put(pack.link_origins),
        spd=put(pack.spd),
        keypoints=Keypoints(
            put(pack.keypoint_links.astype(np.int64).clip(min=0)),
            put(pack.keypoint_offsets) / LENGTH_UNIT,
            put(pack.keypoint_links >= 0),
        ),
        clouds=Clouds(put(pack.clouds), put(pack.cloud_normals), put(-pack.centers[:, 2])),
        first_vectors=put(pack.first_vectors),
        vectors=put(pack.vectors),
        points=put(pack.points),
        hand=pack.hand,
        scene=pack.scene,
        pair=pack.pair,
    )


def hand_batch(data: Data, hands: Tensor) -> HandBatch:
    """Some hands of the data, padded to the most links that one of them has.

    Args:
        data: The data.
        hands: Indices of the hands, shape (H,).

    Returns:
        The hands; padding repeats a hand's last link.
    """
    links = data.links[hands][:, None]
    link = torch.arange(int(links.max()), device=links.device)
    inside = torch.minimum(link, links - 1)  # (H, L)
    row = data.first_links[hands][:, None] + inside
    spd = data.first_spd[hands][:, None, None] + inside[:, :, None] * links[:, :, None] + inside[:, None, :]
    return HandBatch(
        points=data.link_points[row].float(),
        normals=data.link_normals[row].float() / NORMAL,
        origins=data.link_origins[row],
        spd=data.spd[spd].long(),
        mask=link < links,
    )


def grasp_vectors(data: Data, grasps: Tensor, hand: Tensor, length: int) -> Tensor:
    """Link pose vectors of grasps, positions relative to the center of the object.

    Args:
        data: The data.
        grasps: Indices of the grasps, shape (B,).
        hand: Their hands, shape (B,).
        length: Number of links to pad to.

    Returns:
        Vectors, shape (B, length, 9); padding repeats a hand's last link.
    """
    link = torch.arange(length, device=grasps.device)
    row = data.first_vectors[grasps][:, None] + torch.minimum(link, data.links[hand][:, None] - 1)
    vectors = data.vectors[row].float()
    vectors[..., :3] += data.points[grasps][:, None]
    return vectors


def grasps_of_scenes(scene: np.ndarray, grasps: np.ndarray) -> dict[int, np.ndarray]:
    """Grasps by their scenes.

    Args:
        scene: Scene of each of all grasps, shape (M,).
        grasps: Indices of grasps, shape (G,).

    Returns:
        Indices of the grasps of each scene that has any.
    """
    scenes = scene[grasps]
    return {int(s): grasps[scenes == s] for s in np.unique(scenes)}


def draw_batch(data: Data, pool: dict[int, np.ndarray], sizes: BatchSizes, rng: np.random.Generator) -> Batch:
    """Draws a step's data: scenes by their number of grasps, grasps two by two, all turned about the vertical.

    Args:
        data: The data.
        pool: The grasps to draw from by their scenes.
        sizes: Sizes of the batch.
        rng: Generator.

    Returns:
        The batch.
    """
    scenes = np.array(list(pool))
    counts = np.array([len(grasps) for grasps in pool.values()], dtype=float)
    S = min(sizes.scenes, len(scenes))
    chosen = {int(s): pool[int(s)] for s in rng.choice(scenes, S, replace=False, p=counts / counts.sum())}
    shares = np.array_split(np.zeros(sizes.batch // 2), S)
    couples = [draw_couples(data, here, len(share), rng) for here, share in zip(chosen.values(), shares, strict=True)]
    return make_batch(data, chosen, np.concatenate(couples), rng.uniform(-np.pi, np.pi, S), sizes, rng)


def draw_couples(data: Data, here: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draws grasps of a scene, each followed by another version of it, or by any of its grasps where there is none.

    Args:
        data: The data.
        here: The grasps of the scene to draw from.
        count: Number of couples.
        rng: Generator.

    Returns:
        Indices of grasps, shape (2 count,).
    """
    grasps = np.empty(2 * count, dtype=np.int64)
    for k, first in enumerate(rng.choice(here, count, replace=count > len(here))):
        mates = here[(data.pair[here] == data.pair[first]) & (data.pair[here] >= 0) & (here != first)]
        grasps[2 * k : 2 * k + 2] = first, rng.choice(mates if len(mates) else here)
    return grasps


def make_batch(
    data: Data,
    pool: dict[int, np.ndarray],
    grasps: np.ndarray,
    yaws: np.ndarray,
    sizes: BatchSizes,
    rng: np.random.Generator,
) -> Batch:
    """Batch of given grasps.

    Args:
        data: The data.
        pool: All grasps that head for a point in each scene of the batch; S scenes.
        grasps: Grasps, each of one of these scenes, two by two, shape (B,).
        yaws: Angles to turn the scenes by, about the vertical through the object's center [rad], shape (S,).
        sizes: Sizes of the batch.
        rng: Generator of the points' choice and of their noise.

    Returns:
        The batch.
    """

    def put(array: np.ndarray) -> Tensor:
        return torch.tensor(array, dtype=torch.float32 if array.dtype.kind == "f" else None, device=data.points.device)

    R = turns(put(yaws))
    clouds = draw_clouds(data, list(pool), R, sizes, rng)
    heads = [data.points[put(here)] @ R[k].T for k, here in enumerate(pool.values())]
    weights = torch.stack([graspness(cloud, p) for cloud, p in zip(clouds.points, heads, strict=True)])

    position = {scene: k for k, scene in enumerate(pool)}
    cloud = put(np.array([position[int(scene)] for scene in data.scene[grasps]], dtype=np.int64))
    hands, hand = np.unique(data.hand[grasps], return_inverse=True)
    batch_of_hands = hand_batch(data, put(hands))
    vectors = grasp_vectors(data, put(grasps), put(data.hand[grasps]), batch_of_hands.mask.shape[1])
    turned = (vectors.unflatten(-1, (3, 3)) @ R[cloud][:, None].transpose(-1, -2)).flatten(-2)  # rows p, x, y
    p_heads = (R[cloud] @ data.points[put(grasps)][:, :, None]).squeeze(-1)
    point = torch.cdist(p_heads[:, None], clouds.points[cloud]).squeeze(1).argmin(dim=1)
    pair = data.pair[grasps]
    return Batch(
        hands=batch_of_hands,
        keypoints=Keypoints(*(entry[put(hands)] for entry in data.keypoints)),
        hand=put(hand.astype(np.int64)),
        clouds=clouds,
        cloud=cloud,
        point=point,
        point_weights=weights,
        poses=normalize_poses(turned, clouds.points[cloud, point]),
        paired=put((pair[::2] == pair[1::2]) & (pair[::2] >= 0) & (grasps[::2] != grasps[1::2])),
    )


def turns(yaws: Tensor) -> Tensor:
    """Rotations about the vertical by angles [rad], shape (S,) to (S, 3, 3)."""
    c, s, o = yaws.cos(), yaws.sin(), torch.zeros_like(yaws)
    return torch.stack([c, -s, o, s, c, o, o, o, o + 1.0], dim=1).view(-1, 3, 3)


def draw_clouds(data: Data, scenes: list[int], R: Tensor, sizes: BatchSizes, rng: np.random.Generator) -> Clouds:
    """Draws points of some scenes, with noise, turned.

    Args:
        data: The data.
        scenes: The scenes.
        R: How to turn each, shape (S, 3, 3).
        sizes: Sizes of the batch.
        rng: Generator.

    Returns:
        The clouds.
    """
    points, normals = [], []
    available = data.clouds.points.shape[1]
    for k, scene in enumerate(scenes):
        kept = torch.tensor(rng.choice(available, sizes.points, replace=available < sizes.points), device=R.device)
        noise = torch.tensor(sizes.jitter * rng.standard_normal((sizes.points, 3)), dtype=R.dtype, device=R.device)
        points.append((data.clouds.points[scene, kept].float() + noise) @ R[k].T)
        normals.append(data.clouds.normals[scene, kept].float() / NORMAL @ R[k].T)
    return Clouds(torch.stack(points), torch.stack(normals), data.clouds.tables[scenes])


def graspness(points: Tensor, heads: Tensor) -> Tensor:
    """How much points of an object are headed for: the sum over grasps of 10^(-150 distance), after DexGraspNet 2.0.

    Args:
        points: Points of the object [m], shape (N, 3).
        heads: Object points of grasps [m], shape (G, 3).

    Returns:
        Graspness, positive, shape (N,).
    """
    return (10.0 ** (-150.0 * torch.cdist(points, heads))).sum(dim=1) + 1e-12
