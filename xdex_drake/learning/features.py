"""What the model is told about a hand, an object and a grasp: plain arrays, made from descriptions. No torch here.

A hand's tokens are its links, each with a frame G of its own that no choice of a description's author can move: its
axes are those of the wrist frame H in the rest posture, its origin the mean of the points sampled on the link. How a
file turns its link frames, where along its axis it puts a joint, and which angle it calls zero all drop out.
"""

import hashlib
from collections.abc import Sequence

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Convex, Geometry, Hand
from xdex_drake.hand.heading import heading, object_point
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.learning.pack import FEATURE_SCHEMA, JOINT_FEATURES, HandFeatures, ObjectFeatures

__all__ = [
    "FEATURE_SCHEMA",
    "HandFeatures",
    "ObjectFeatures",
    "hand_features",
    "heading",
    "link_frames",
    "object_features",
    "object_point",
    "shortest_path_distances",
]

POINTS_PER_LINK = 64
POINTS_PER_OBJECT = 1024
UNIT = 0.1
"""Metres that make one unit among the features of joints."""


def hand_features(hand: Hand, points: int = POINTS_PER_LINK, seed: int = 0) -> HandFeatures:
    """Features of a hand.

    Tokens are the base, every link with geometry, and the last link of every finger. A link without geometry is no
    token, but its joint counts in the distances between those that are.

    Args:
        hand: The hand.
        points: Points on each link.
        seed: Seed of the points.

    Returns:
        Its features.
    """
    R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), hand.q_rest)
    tips = [hand.link_index[finger.tip_link] for finger in hand.fingers]
    links = np.array(sorted({0, *tips} | {k for k, link in enumerate(hand.links) if link.geometry}), dtype=np.int64)
    # What stands for a link without geometry: the wrist for the base, the tip point for the last link of a finger.
    bare = {0: np.zeros(3)} | {k: p_HLs[k] + R_HLs[k] @ f.p_LTip for k, f in zip(tips, hand.fingers, strict=True)}
    samples = []
    for k in links:
        shapes = [_rounded(shape.moved(R_HLs[k], p_HLs[k])) for shape in hand.links[k].geometry]
        samples.append(sample_shapes(shapes, points, np.random.default_rng(seed), bare.get(int(k), p_HLs[k])))
    link_points, link_normals = (np.stack(parts) for parts in zip(*samples, strict=True))
    centers = link_points.mean(axis=1)
    R_LGs = np.swapaxes(R_HLs[links], -1, -2)
    token = {int(link): k for k, link in enumerate(links)}
    offsets = [p_HLs[k] + R_HLs[k] @ f.p_LTip - centers[token[k]] for k, f in zip(tips, hand.fingers, strict=True)]
    spd = shortest_path_distances(hand.parents)[np.ix_(links, links)]
    joints = np.array([_joint_features(hand, int(k), R_HLs, p_HLs, c) for k, c in zip(links, centers, strict=True)])
    keypoint_links = np.array([0, *(token[k] for k in tips)], dtype=np.int64)
    keypoint_offsets = np.array([-centers[0], *offsets])
    sha = hashlib.sha256()
    for array in (link_points, link_normals, spd, joints, keypoint_links, keypoint_offsets):
        sha.update(np.ascontiguousarray(array).tobytes())
    return HandFeatures(
        name=hand.name,
        links=links,
        link_names=tuple(hand.links[k].name for k in links),
        link_points=link_points,
        link_normals=link_normals,
        centers=centers,
        joints=joints,
        spd=spd,
        R_LGs=R_LGs,
        p_LGs=np.einsum("kij,kj->ki", R_LGs, centers - p_HLs[links]),
        keypoint_names=("wrist", *(finger.name for finger in hand.fingers)),
        keypoint_links=keypoint_links,
        keypoint_offsets=keypoint_offsets,
        digest=sha.hexdigest(),
    )


def link_frames(hand: HandFeatures, R_WLs: Array, p_WLs: Array) -> tuple[Array, Array]:
    """Frames G of a hand's tokens from the poses of its links.

    Args:
        hand: The hand's features.
        R_WLs: Rotations of all links in W, shape (..., n_links, 3, 3).
        p_WLs: Origins of all links in W [m], shape (..., n_links, 3).

    Returns:
        Rotations R_WG, shape (..., L, 3, 3), and origins p_WG [m], shape (..., L, 3).
    """
    R, p = R_WLs[..., hand.links, :, :], p_WLs[..., hand.links, :]
    return R @ hand.R_LGs, p + (R @ hand.p_LGs[..., None])[..., 0]


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


def sample_shapes(
    shapes: Sequence[Geometry], count: int, rng: np.random.Generator, otherwise: Array
) -> tuple[Array, Array]:
    """Points spread over the surface of shapes.

    Args:
        shapes: The shapes.
        count: Number of points.
        rng: Generator.
        otherwise: A point to repeat where there are no shapes, shape (3,).

    Returns:
        Points in the frame of the shapes [m], shape (count, 3), and unit normals out of them, zero where there are no
        shapes, shape (count, 3).
    """
    if not shapes:
        return np.tile(otherwise, (count, 1)), np.zeros((count, 3))
    shares = np.array([shape.area() for shape in shapes]) + 1e-12
    many = rng.multinomial(8 * count, shares / shares.sum())
    samples = [shape.sample(n, rng) for shape, n in zip(shapes, many, strict=True)]
    points, normals = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    chosen = _spread(points, count)
    return points[chosen], normals[chosen]


def _rounded(shape: Geometry) -> Geometry:
    """A hull with its vertices rounded to 0.1 um: which triangles it is cut into must not hang on rounding errors."""
    return Convex(np.round(shape.vertices, 7)) if isinstance(shape, Convex) else shape


def _joint_features(hand: Hand, link: int, R_HLs: Array, p_HLs: Array, center: Array) -> Array:
    """How a link's own joint moves it, in terms that no choice of sign, zero or origin changes.

    With a the axis in H at rest and low, high the range about rest [rad, or 0.1 m]: a (low + high) / 2, half the range,
    the axis' point nearest to the link's center from there [0.1 m] (0 for a joint that slides), the products xx, yy,
    zz, xy, xz, yz of a's entries, and 1 for a joint that slides; zeros for the base. Shape (14,).
    """
    features = np.zeros(JOINT_FEATURES)
    if link == 0:
        return features
    j, joint = link - 1, hand.joints[link - 1]
    slides = joint.kind == "prismatic"
    # Only its master moves a coupled joint, so the ends of its range are at the ends of the master's.
    ends = (hand.limits - hand.q_rest) @ hand.coupling_matrix[j]
    low, high = np.clip(np.sort(ends), -2.0 * np.pi, 2.0 * np.pi) / (UNIT if slides else 1.0)
    a = R_HLs[link] @ joint.axis
    from_center = p_HLs[link] - center
    features[:3], features[3] = 0.5 * (low + high) * a, 0.5 * (high - low)
    features[4:7] = 0.0 if slides else (from_center - (from_center @ a) * a) / UNIT
    features[7:10], features[10:13] = a * a, [a[0] * a[1], a[0] * a[2], a[1] * a[2]]
    features[13] = float(slides)
    return features


def _spread(points: Array, count: int) -> np.ndarray:
    """Farthest-point subset, shape (count,): even where independent samples clump."""
    chosen = np.zeros(count, dtype=np.int64)
    distance = np.full(len(points), np.inf)
    for k in range(1, count):
        distance = np.minimum(distance, np.sum((points - points[chosen[k - 1]]) ** 2, axis=1))
        chosen[k] = np.argmax(distance)
    return chosen
