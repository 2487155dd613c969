"""What the model is told about a hand, an object and a grasp: plain arrays, made from descriptions. No torch here."""

import hashlib
from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand, Link
from xdex_drake.hand.heading import heading, object_point
from xdex_drake.hand.kinematics import forward_kinematics

__all__ = [
    "FEATURE_SCHEMA",
    "HandFeatures",
    "ObjectFeatures",
    "hand_features",
    "heading",
    "link_pose_vectors",
    "link_poses_from_vectors",
    "object_features",
    "object_point",
    "shortest_path_distances",
    "zero_configuration",
]

FEATURE_SCHEMA = 1
"""Version of what the arrays of this module mean; a checkpoint of another version is refused."""
POINTS_PER_LINK = 64
POINTS_PER_OBJECT = 1024


@dataclass(frozen=True)
class HandFeatures:
    """A hand as the model sees it.

    Attributes:
        name: Name of the hand.
        link_points: Points on the surface of each link, in H at the zero configuration [m], shape (L, N, 3).
        spd: Number of joints on the path between two links, shape (L, L), int64.
        parents: Index of each link's parent, -1 for the base, shape (L,), int64.
        link_names: Names of the links.
        R_HLs_zero: Rotations of the links in H at the zero configuration, shape (L, 3, 3).
        p_HLs_zero: Origins of the links in H at the zero configuration [m], shape (L, 3).
        keypoint_names: `wrist`, then the fingers in the order of the description.
        keypoint_links: Index of each keypoint's link, shape (K,), int64.
        keypoint_offsets: From the link's origin to the keypoint at the zero configuration, axes of H [m], shape (K, 3).
        digest: Hexadecimal digest of the arrays above.
    """

    name: str
    link_points: Array
    spd: np.ndarray
    parents: np.ndarray
    link_names: tuple[str, ...]
    R_HLs_zero: Array
    p_HLs_zero: Array
    keypoint_names: tuple[str, ...]
    keypoint_links: np.ndarray
    keypoint_offsets: Array
    digest: str


@dataclass(frozen=True)
class ObjectFeatures:
    """An object in a scene as the model sees it.

    Attributes:
        points: Points on its surface relative to its center, axes of W (z up) [m], shape (N, 3).
        p_WCenter: Its center, the center of mass or the mean of the points, in W [m], shape (3,).
        name: Name of the scene.
    """

    points: Array
    p_WCenter: Array = field(default_factory=lambda: np.zeros(3))
    name: str = ""


def hand_features(hand: Hand, points: int = POINTS_PER_LINK, seed: int = 0) -> HandFeatures:
    """Features of a hand.

    Args:
        hand: The hand.
        points: Points on each link.
        seed: Seed of the points.

    Returns:
        Its features.
    """
    R_HLs, p_HLs = zero_configuration(hand)
    rng = np.random.default_rng(seed)
    link_points = np.stack(
        [sample_link(link, points, rng) @ R.T + p for link, R, p in zip(hand.links, R_HLs, p_HLs, strict=True)]
    )
    tips = [hand.link_index[finger.tip_link] for finger in hand.fingers]
    links = np.array([0, *tips], dtype=np.int64)
    offsets = np.array([-p_HLs[0], *(R_HLs[k] @ f.p_LTip for k, f in zip(tips, hand.fingers, strict=True))])
    spd = shortest_path_distances(hand.parents)
    sha = hashlib.sha256()
    for array in (link_points, spd, R_HLs, p_HLs, links, offsets):
        sha.update(np.ascontiguousarray(array).tobytes())
    return HandFeatures(
        name=hand.name,
        link_points=link_points,
        spd=spd,
        parents=hand.parents,
        link_names=tuple(link.name for link in hand.links),
        R_HLs_zero=R_HLs,
        p_HLs_zero=p_HLs,
        keypoint_names=("wrist", *(finger.name for finger in hand.fingers)),
        keypoint_links=links,
        keypoint_offsets=offsets,
        digest=sha.hexdigest(),
    )


def object_features(
    p_WPoints: Array, p_WCenter: Array | None = None, count: int = POINTS_PER_OBJECT, seed: int = 0, name: str = ""
) -> ObjectFeatures:
    """Features of an object from its points in W.

    Args:
        p_WPoints: Points on its surface in W, the table at z = 0 [m], shape (n, 3).
        p_WCenter: Its center in W [m], shape (3,); by default the mean of the points.
        count: Points to keep; fewer given points are all kept.
        seed: Seed of the choice.
        name: Name of the scene.

    Returns:
        Its features.

    Raises:
        ValueError: The points are not an array of finite numbers with three columns and at least one row.
    """
    if p_WPoints.ndim != 2 or p_WPoints.shape[1] != 3 or len(p_WPoints) == 0 or not np.isfinite(p_WPoints).all():
        raise ValueError(f"object points must be finite, of shape (n, 3) with n > 0; got shape {p_WPoints.shape}")
    center = p_WPoints.mean(axis=0) if p_WCenter is None else np.asarray(p_WCenter, dtype=float)
    if len(p_WPoints) > count:
        p_WPoints = p_WPoints[np.random.default_rng(seed).choice(len(p_WPoints), count, replace=False)]
    return ObjectFeatures(p_WPoints - center, center, name)


def zero_configuration(hand: Hand) -> tuple[Array, Array]:
    """Link poses in the wrist frame with all actuated joints at zero, within their limits or not.

    Args:
        hand: The hand.

    Returns:
        Rotations R_HL, shape (L, 3, 3), and origins p_HL [m], shape (L, 3).
    """
    return forward_kinematics(hand, RigidTransform(), np.zeros(len(hand.joint_names)))


def shortest_path_distances(parents: np.ndarray) -> np.ndarray:
    """Number of joints on the path between every two links of a tree.

    Args:
        parents: Index of each link's parent, -1 for the base; parents come first, shape (L,).

    Returns:
        Distances, symmetric, zero on the diagonal, shape (L, L), int64.
    """
    spd = np.zeros((len(parents), len(parents)), dtype=np.int64)
    for k, parent in enumerate(parents):
        if parent >= 0:
            spd[k, :k] = spd[parent, :k] + 1
            spd[:k, k] = spd[k, :k]
    return spd


def link_pose_vectors(R_WLs: Array, p_WLs: Array, R_HLs_zero: Array) -> Array:
    """Link pose vectors: origin of L, then the first two columns of R_WL R_HL(0)^T.

    Args:
        R_WLs: Rotations of the links in W, shape (..., L, 3, 3).
        p_WLs: Origins of the links in W [m], shape (..., L, 3).
        R_HLs_zero: Rotations of the links in H at the zero configuration, shape (L, 3, 3).

    Returns:
        Vectors, shape (..., L, 9).
    """
    R = R_WLs @ np.swapaxes(R_HLs_zero, -1, -2)
    return np.concatenate([p_WLs, R[..., 0], R[..., 1]], axis=-1)


def link_poses_from_vectors(vectors: Array, R_HLs_zero: Array) -> tuple[Array, Array]:
    """Inverse of `link_pose_vectors`; the two columns are made orthonormal by Gram-Schmidt first.

    Args:
        vectors: Link pose vectors, shape (..., L, 9).
        R_HLs_zero: Rotations of the links in H at the zero configuration, shape (L, 3, 3).

    Returns:
        Rotations R_WL, shape (..., L, 3, 3), and origins p_WL [m], shape (..., L, 3).
    """
    x = vectors[..., 3:6] / np.linalg.norm(vectors[..., 3:6], axis=-1, keepdims=True)
    y = vectors[..., 6:9] - np.sum(vectors[..., 6:9] * x, axis=-1, keepdims=True) * x
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    R = np.stack([x, y, np.cross(x, y)], axis=-1)
    return R @ R_HLs_zero, vectors[..., :3].copy()


def sample_link(link: Link, count: int, rng: np.random.Generator) -> Array:
    """Points spread over the surface of a link's shapes; its origin repeated where it has none.

    Args:
        link: The link.
        count: Number of points.
        rng: Generator.

    Returns:
        Points in L [m], shape (count, 3).
    """
    if not link.geometry:
        return np.zeros((count, 3))
    shares = np.array([g.area() for g in link.geometry]) + 1e-12
    many = rng.multinomial(8 * count, shares / shares.sum())
    return _spread(np.concatenate([g.sample(n, rng) for g, n in zip(link.geometry, many, strict=True)]), count)


def _spread(points: Array, count: int) -> Array:
    """Farthest-point subset, shape (count, 3): even where independent samples clump."""
    chosen = np.zeros(count, dtype=np.int64)
    distance = np.full(len(points), np.inf)
    for k in range(1, count):
        distance = np.minimum(distance, np.sum((points - points[chosen[k - 1]]) ** 2, axis=1))
        chosen[k] = np.argmax(distance)
    return points[chosen]
