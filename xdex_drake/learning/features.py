"""What the model is told about a hand, an object and a grasp: plain arrays, made from descriptions. No torch here."""

import hashlib

import numpy as np
from pydrake.math import RigidTransform
from scipy.spatial import ConvexHull

from xdex_drake.hand.description import Array, Box, Capsule, Geometry, Hand, Link, Sphere
from xdex_drake.hand.heading import heading, object_point
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.learning.pack import FEATURE_SCHEMA, HandFeatures, ObjectFeatures

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
    shares = np.array([_area(g) for g in link.geometry]) + 1e-12
    many = rng.multinomial(8 * count, shares / shares.sum())
    samples = [_sample(g, n, rng) for g, n in zip(link.geometry, many, strict=True)]
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


def _area(geometry: Geometry) -> float:
    """Surface area [m^2]."""
    if isinstance(geometry, Sphere):
        return 4.0 * np.pi * geometry.radius**2
    if isinstance(geometry, Capsule):
        length = float(np.linalg.norm(geometry.p1 - geometry.p0))
        return 2.0 * np.pi * geometry.radius * (length + 2.0 * geometry.radius)
    if isinstance(geometry, Box):
        x, y, z = geometry.size
        return 2.0 * float(x * y + y * z + z * x)
    return float(ConvexHull(geometry.vertices, qhull_options="QJ").area)


def _sample(geometry: Geometry, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Independent points, uniform on the surface, in L [m], shape (count, 3), and their normals."""
    if isinstance(geometry, Sphere):
        normals = _directions(count, rng)
        return geometry.center + geometry.radius * normals, normals
    if isinstance(geometry, Capsule):
        return _sample_capsule(geometry, count, rng)
    if isinstance(geometry, Box):
        x, y, z = geometry.size
        faces = np.array([y * z, z * x, x * y])
        axis = rng.choice(3, count, p=faces / faces.sum())
        points, normals = rng.uniform(-0.5, 0.5, (count, 3)), np.zeros((count, 3))
        side = rng.choice([-0.5, 0.5], count)
        points[np.arange(count), axis], normals[np.arange(count), axis] = side, 2.0 * side
        return (points * geometry.size) @ geometry.R_LG.T + geometry.p_LG, normals @ geometry.R_LG.T
    hull = ConvexHull(geometry.vertices, qhull_options="QJ")
    a, b, c = geometry.vertices[hull.simplices].transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) + 1e-15
    face = rng.choice(len(areas), count, p=areas / areas.sum())
    s, t = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    return a[face] * (1.0 - s) + b[face] * (s * (1.0 - t)) + c[face] * (s * t), hull.equations[face, :3]


def _sample_capsule(capsule: Capsule, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Uniform on the surface: the side and the two half spheres by area."""
    along = capsule.p1 - capsule.p0
    length = float(np.linalg.norm(along))
    axis = along / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    direction = _directions(count, rng)
    on_side = rng.random(count) < length / (length + 2.0 * capsule.radius)
    radial = direction - (direction @ axis)[:, None] * axis
    radial /= np.maximum(np.linalg.norm(radial, axis=1, keepdims=True), 1e-12)
    side = capsule.p0 + rng.random(count)[:, None] * along + capsule.radius * radial
    cap = np.where((direction @ axis)[:, None] > 0.0, capsule.p1, capsule.p0) + capsule.radius * direction
    return np.where(on_side[:, None], side, cap), np.where(on_side[:, None], radial, direction)


def _directions(count: int, rng: np.random.Generator) -> Array:
    """Unit vectors, uniform on the sphere, shape (count, 3)."""
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)
