"""What the model is told about a hand, an object and a grasp: plain arrays, made from descriptions. No torch here."""

import hashlib

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand, Link
from xdex_drake.hand.heading import heading, object_point
from xdex_drake.hand.kinematics import zero_configuration
from xdex_drake.learning.pack import FEATURE_SCHEMA, HandFeatures, ObjectFeatures

__all__ = [
    "FEATURE_SCHEMA",
    "HandFeatures",
    "ObjectFeatures",
    "hand_features",
    "heading",
    "object_features",
    "object_point",
    "shortest_path_distances",
]

POINTS_PER_LINK = 64
POINTS_PER_OBJECT = 1024


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
    samples = [sample_link(link, points, rng) for link in hand.links]
    link_points = np.stack([p_LPs @ R.T + p for (p_LPs, _), R, p in zip(samples, R_HLs, p_HLs, strict=True)])
    link_normals = np.stack([n_LPs @ R.T for (_, n_LPs), R in zip(samples, R_HLs, strict=True)])
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
        link_normals=link_normals,
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
    p_WPoints: Array,
    p_WCenter: Array | None = None,
    count: int = POINTS_PER_OBJECT,
    seed: int = 0,
    name: str = "",
    *,
    n_WPoints: Array | None = None,
) -> ObjectFeatures:
    """Features of an object from its points in W.

    Args:
        p_WPoints: Points on its surface in W, the table at z = 0 [m], shape (n, 3).
        p_WCenter: Its center in W [m], shape (3,); by default the mean of the points.
        count: Points to keep; fewer given points are all kept.
        seed: Seed of the choice.
        name: Name of the scene.
        n_WPoints: Unit normals out of the object at the points, shape (n, 3); None where they are not known.

    Returns:
        Its features.

    Raises:
        ValueError: The points are not an array of finite numbers with three columns and at least one row.
    """
    if p_WPoints.ndim != 2 or p_WPoints.shape[1] != 3 or len(p_WPoints) == 0 or not np.isfinite(p_WPoints).all():
        raise ValueError(f"object points must be finite, of shape (n, 3) with n > 0; got shape {p_WPoints.shape}")
    center = p_WPoints.mean(axis=0) if p_WCenter is None else np.asarray(p_WCenter, dtype=float)
    normals = np.zeros_like(p_WPoints) if n_WPoints is None else n_WPoints
    if len(p_WPoints) > count:
        kept = np.random.default_rng(seed).choice(len(p_WPoints), count, replace=False)
        p_WPoints, normals = p_WPoints[kept], normals[kept]
    return ObjectFeatures(p_WPoints - center, normals, center, name)


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


def sample_link(link: Link, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Points spread over the surface of a link's shapes; its origin repeated where it has none.

    Args:
        link: The link.
        count: Number of points.
        rng: Generator.

    Returns:
        Points in L [m], shape (count, 3), and unit normals out of the shapes, zero where there is none, shape
        (count, 3).
    """
    if not link.geometry:
        return np.zeros((count, 3)), np.zeros((count, 3))
    shares = np.array([g.area() for g in link.geometry]) + 1e-12
    many = rng.multinomial(8 * count, shares / shares.sum())
    samples = [g.sample(n, rng) for g, n in zip(link.geometry, many, strict=True)]
    points, normals = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    chosen = _spread(points, count)
    return points[chosen], normals[chosen]


def _spread(points: Array, count: int) -> np.ndarray:
    """Farthest-point subset, shape (count,): even where independent samples clump."""
    chosen = np.zeros(count, dtype=np.int64)
    distance = np.full(len(points), np.inf)
    for k in range(1, count):
        distance = np.minimum(distance, np.sum((points - points[chosen[k - 1]]) ** 2, axis=1))
        chosen[k] = np.argmax(distance)
    return chosen
