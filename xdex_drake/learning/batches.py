"""The batches that training steps draw from a training pack.

Every scene of a batch is turned about the vertical by an angle drawn anew, and mirrored by the flip of a coin: object,
point, and all hands of it, which become their mirror images, left ones of right ones.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from xdex_drake.learning.pack import JOINT_FEATURES, NORMAL, Pack
from xdex_drake.learning.protocol import LENGTH_UNIT, Batch, Clouds, HandBatch, Keypoints, normalize_poses


class Data(NamedTuple):
    """A training pack on a device; arrays as in `Pack`.

    Attributes:
        links: Number of links of each hand, shape (H,), int64.
        first_links: Row of each hand's first link, shape (H,), int64.
        first_spd: Row of each hand's first distance, shape (H,), int64.
        link_points: Points on the links, shape (L, N, 3).
        link_normals: Normals there, shape (L, N, 3).
        link_centers: Origins of the links' frames G, shape (L, 3).
        link_joints: How the links' joints move them, shape (L, 14).
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
    link_centers: Tensor
    link_joints: Tensor
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
        link_points: Points of each link, the first of them, which spread over it; 0 for all.
        hands: Hands, at most, as far as grasps in couples allow; 0 for any number.
        mirror: Share of scenes that are mirrored.
    """

    batch: int
    scenes: int
    points: int
    jitter: float
    link_points: int = 0
    hands: int = 0
    mirror: float = 0.0


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
        link_centers=put(pack.link_centers),
        link_joints=put(pack.link_joints),
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


def hand_batch(data: Data, hands: Tensor, mirrored: Tensor | None = None, points: int = 0) -> HandBatch:
    """Some hands of the data.

    Args:
        data: The data.
        hands: Indices of the hands, shape (H,).
        mirrored: Which of them are mirrored in the plane y = 0 of H, shape (H,); none where None.
        points: Points of each link, the first of them; 0 for all.

    Returns:
        The hands.
    """
    links = data.links[hands][:, None]
    link = torch.arange(int(links.max()), device=links.device)
    mask = link < links
    inside = torch.minimum(link, links - 1)  # (H, L)
    row = (data.first_links[hands][:, None] + inside)[mask]
    spd = data.first_spd[hands][:, None, None] + inside[:, :, None] * links[:, :, None] + inside[:, None, :]
    kept = slice(points or None)
    flipped = torch.zeros_like(row, dtype=torch.bool) if mirrored is None else mirrored[:, None].expand_as(mask)[mask]
    joints = data.link_joints[row].float()
    return HandBatch(
        points=_flip(data.link_points[row, kept].float(), flipped),
        normals=_flip(data.link_normals[row, kept].float() / NORMAL, flipped),
        centers=_flip(data.link_centers[row], flipped),
        joints=torch.where(flipped[:, None], joints * _joint_signs(joints), joints),
        spd=data.spd[spd].long(),
        mask=mask,
    )


def _flip(vectors: Tensor, flipped: Tensor) -> Tensor:
    """Mirrors some rows of vectors, shape (T, ..., 3), in the plane y = 0."""
    signs = torch.ones_like(vectors)
    signs[flipped, ..., 1] = -1.0
    return vectors * signs


def _joint_signs(joints: Tensor) -> Tensor:
    """Signs of features of joints in a mirror: an axis of rotation is a pseudo-vector, one of sliding a vector."""
    turn, slide = torch.ones(JOINT_FEATURES), torch.ones(JOINT_FEATURES)
    turn[[0, 2, 5, 10, 12]] = -1.0
    slide[[1, 5, 10, 12]] = -1.0
    return torch.where(joints[:, -1:] > 0.5, slide.to(joints.device), turn.to(joints.device))


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


class Views(NamedTuple):
    """How the scenes of a batch are seen: mirrored in the plane y = 0 of W, then turned about the vertical.

    Attributes:
        yaws: Angles of the turns, about the object's center [rad], shape (S,).
        mirrored: Which scenes are mirrored first, shape (S,).
    """

    yaws: np.ndarray
    mirrored: np.ndarray

    @staticmethod
    def plain(scenes: int) -> "Views":
        """The scenes as they are."""
        return Views(np.zeros(scenes), np.zeros(scenes, dtype=bool))

    @staticmethod
    def drawn(scenes: int, mirror: float, rng: np.random.Generator) -> "Views":
        """Any turn is as likely, a share of the scenes is mirrored."""
        return Views(rng.uniform(-np.pi, np.pi, scenes), rng.random(scenes) < mirror)

    def matrices(self, device: torch.device) -> Tensor:
        """What becomes of vectors, shape (S, 3, 3); of determinant -1 where the scene is mirrored."""
        R = turns(torch.tensor(self.yaws, dtype=torch.float32, device=device))
        signs = torch.ones(len(R), 1, 3, device=device)
        signs[torch.as_tensor(self.mirrored, device=device), :, 1] = -1.0
        return R * signs


def draw_batch(data: Data, pool: dict[int, np.ndarray], sizes: BatchSizes, rng: np.random.Generator) -> Batch:
    """Draws a step's data: scenes by their number of grasps, grasps two by two, each scene turned and maybe mirrored.

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
    most = sizes.hands // S
    couples = [
        draw_couples(data, here, len(share), rng, hands=most)
        for here, share in zip(chosen.values(), shares, strict=True)
    ]
    return make_batch(data, chosen, np.concatenate(couples), Views.drawn(S, sizes.mirror, rng), sizes, rng)


def draw_couples(data: Data, here: np.ndarray, count: int, rng: np.random.Generator, *, hands: int = 0) -> np.ndarray:
    """Draws grasps of a scene, each followed by another version of it, or by any of its grasps where there is none.

    Args:
        data: The data.
        here: The grasps of the scene to draw from.
        count: Number of couples.
        rng: Generator.
        hands: Draw from this many of their hands alone, where there are more; 0 for all.

    Returns:
        Indices of grasps, shape (2 count,).
    """
    present = np.unique(data.hand[here])
    if 0 < hands < len(present):
        # Hands of a few sources, so that versions of one grasp stay together.
        order = here[rng.permutation(len(here))]
        by_source = order[np.argsort(rng.permutation(int(data.pair.max()) + 2)[data.pair[order] + 1], kind="stable")]
        _, first = np.unique(data.hand[by_source], return_index=True)
        few = data.hand[by_source[np.sort(first)[:hands]]]
        here = here[np.isin(data.hand[here], few)]
    grasps = np.empty(2 * count, dtype=np.int64)
    pair = data.pair[here]
    for k, first in enumerate(rng.choice(len(here), count, replace=count > len(here))):
        mates = here[(pair == pair[first]) & (pair >= 0) & (here != here[first])]
        grasps[2 * k : 2 * k + 2] = here[first], rng.choice(mates if len(mates) else here)
    return grasps


def make_batch(
    data: Data,
    pool: dict[int, np.ndarray],
    grasps: np.ndarray,
    views: Views,
    sizes: BatchSizes,
    rng: np.random.Generator,
) -> Batch:
    """Batch of given grasps.

    Args:
        data: The data.
        pool: All grasps that head for a point in each scene of the batch; S scenes.
        grasps: Grasps, each of one of these scenes, two by two, shape (B,).
        views: How the scenes are seen.
        sizes: Sizes of the batch.
        rng: Generator of the points' choice and of their noise.

    Returns:
        The batch.
    """
    device = data.points.device

    def put(array: np.ndarray) -> Tensor:
        return torch.as_tensor(array, device=device)

    A = views.matrices(device)
    clouds = draw_clouds(data, list(pool), A, sizes, rng)
    heads = [data.points[put(here)] @ A[k].T for k, here in enumerate(pool.values())]
    weights = torch.stack([graspness(cloud, p) for cloud, p in zip(clouds.points, heads, strict=True)])

    position = {scene: k for k, scene in enumerate(pool)}
    scene = np.array([position[int(scene)] for scene in data.scene[grasps]], dtype=np.int64)
    cloud, flipped = put(scene), put(views.mirrored)
    # A hand that meets a mirrored scene is another hand.
    keys, hand = np.unique(2 * data.hand[grasps].astype(np.int64) + views.mirrored[scene], return_inverse=True)
    hands, mirrored = put(keys // 2), put(keys % 2 == 1)
    batch_of_hands = hand_batch(data, hands, mirrored, sizes.link_points)
    own = put(data.hand[grasps].astype(np.int64))
    vectors = grasp_vectors(data, put(grasps), own, batch_of_hands.mask.shape[1])
    seen = vectors.unflatten(-1, (3, 3)) @ A[cloud][:, None].transpose(-1, -2)  # rows p, x, y
    seen[..., 2, :] = torch.where(flipped[cloud][:, None, None], -seen[..., 2, :], seen[..., 2, :])  # S R S y = -S R y
    p_heads = (A[cloud] @ data.points[put(grasps)][:, :, None]).squeeze(-1)
    point = torch.cdist(p_heads[:, None], clouds.points[cloud]).squeeze(1).argmin(dim=1)
    pair = data.pair[grasps]
    links, offsets, has = (entry[hands] for entry in data.keypoints)
    return Batch(
        hands=batch_of_hands,
        keypoints=Keypoints(links, _flip(offsets, mirrored), has),
        hand=put(hand.astype(np.int64)),
        clouds=clouds,
        cloud=cloud,
        point=point,
        point_weights=weights,
        poses=normalize_poses(seen.flatten(-2), clouds.points[cloud, point]),
        paired=put((pair[::2] == pair[1::2]) & (pair[::2] >= 0) & (grasps[::2] != grasps[1::2])),
    )


def turns(yaws: Tensor) -> Tensor:
    """Rotations about the vertical by angles [rad], shape (S,) to (S, 3, 3)."""
    c, s, o = yaws.cos(), yaws.sin(), torch.zeros_like(yaws)
    return torch.stack([c, -s, o, s, c, o, o, o, o + 1.0], dim=1).view(-1, 3, 3)


def draw_clouds(data: Data, scenes: list[int], A: Tensor, sizes: BatchSizes, rng: np.random.Generator) -> Clouds:
    """Draws points of some scenes, with noise, as they are seen.

    Args:
        data: The data.
        scenes: The scenes.
        A: What becomes of vectors of each, shape (S, 3, 3).
        sizes: Sizes of the batch.
        rng: Generator.

    Returns:
        The clouds.
    """
    S, N = len(scenes), sizes.points
    available = data.clouds.points.shape[1]
    kept = torch.as_tensor(np.array([rng.choice(available, N, replace=available < N) for _ in scenes]), device=A.device)
    noise = torch.as_tensor(sizes.jitter * rng.standard_normal((S, N, 3), dtype=np.float32), device=A.device)
    row = torch.tensor(scenes, device=A.device)
    points = data.clouds.points[row[:, None], kept].float() + noise
    normals = data.clouds.normals[row[:, None], kept].float() / NORMAL
    A_t = A.transpose(1, 2)
    return Clouds(points @ A_t, normals @ A_t, data.clouds.tables[row])


def graspness(points: Tensor, heads: Tensor) -> Tensor:
    """How much points of an object are headed for: the sum over grasps of 10^(-150 distance), after DexGraspNet 2.0.

    Args:
        points: Points of the object [m], shape (N, 3).
        heads: Object points of grasps [m], shape (G, 3).

    Returns:
        Graspness, positive, shape (N,).
    """
    return (10.0 ** (-150.0 * torch.cdist(points, heads))).sum(dim=1) + 1e-12
