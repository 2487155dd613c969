"""Where to look from: a camera that frames a grasp and sees the object, the fingertips not the back of a hand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.scene.camera import look_at
from xdex_drake.scene.tabletop import Scene

Mask = NDArray[np.bool_]

ELEVATIONS = (0.20, 0.45, 0.75)
"""Elevations of the directions that are tried [rad]."""

AZIMUTHS = 16
"""Number of azimuths that are tried at each elevation."""

OBJECT_SAMPLES = 160
"""Points of the object's surface by which its visibility is judged."""


@dataclass(frozen=True)
class Blobs:
    """Balls that stand for what is seen.

    Attributes:
        centers_W: Centers [m], shape (n, 3).
        radii: Radii [m], shape (n,).
    """

    centers_W: Array
    radii: Array


def hand_blobs(hand: Hand, X_WH: RigidTransform, q: Array) -> Blobs:
    """The spheres of a hand.

    Args:
        hand: The hand.
        X_WH: Wrist pose.
        q: Joint values [rad or m], shape (n,).

    Returns:
        The spheres in W, in the order of `hand.spheres`.
    """
    k = Configuration.at(hand, X_WH, q)
    return Blobs(k.points(hand.sphere_links, hand.spheres[:, :3]), hand.spheres[:, 3])


def object_points(scene: Scene, X_WO: RigidTransform | None = None) -> tuple[Array, Array, float]:
    """Points spread over an object's surface.

    Args:
        scene: The scene.
        X_WO: Pose of the object; the scene's where None.

    Returns:
        Points in W [m], shape (n, 3), outward unit normals, shape (n, 3), and the typical gap between neighbours [m].
    """
    points, normals = scene.object.surface_samples(OBJECT_SAMPLES, 0)
    X_WO = scene.X_WO if X_WO is None else X_WO
    vertices, faces = scene.object.surface
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    R_WO = X_WO.rotation().matrix()
    return points @ R_WO.T + X_WO.translation(), normals @ R_WO.T, float(np.sqrt(area / OBJECT_SAMPLES))


def frame_blobs(blobs: Blobs, direction: Array, *, fov_y: float, aspect: float, margin: float = 1.06) -> RigidTransform:
    """The nearest camera from a direction that has everything in the picture.

    Args:
        blobs: What to frame.
        direction: Direction from what is seen toward the camera in W, shape (3,), not vertical.
        fov_y: Vertical field of view [rad].
        aspect: Width of the picture divided by its height.
        margin: Factor on the room that everything takes in the picture.

    Returns:
        X_WC.
    """
    d = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    R_WC = look_at(d, np.zeros(3)).rotation().matrix()
    tangents = np.tan(0.5 * fov_y) * np.array([aspect, 1.0]) / margin
    p_C = blobs.centers_W @ R_WC
    # A ball touches the picture's edge where the edge's plane is tangent to it.
    r = blobs.radii[:, None] * np.sqrt(1.0 + tangents**2)
    # Along each axis of the picture: |p - c| + r <= (z + distance) tangent, an interval for the center c.
    high = (p_C[:, :2] + r - p_C[:, 2:] * tangents).max(axis=0)
    low = (-p_C[:, :2] + r - p_C[:, 2:] * tangents).max(axis=0)
    center = 0.5 * (high - low)
    distance = float((0.5 * (high + low) / tangents).max())
    return RigidTransform(RotationMatrix(R_WC), R_WC @ np.array([*center, -distance]))


def _hidden(p_WPs: Array, p_WC: Array, blobs: Blobs, skip: Mask) -> Mask:
    """Which points are hidden from a camera by blobs, shape (m,); `skip` (m, n) names pairs that do not count."""
    rays = p_WC - p_WPs
    lengths = np.linalg.norm(rays, axis=1)
    rays = rays / lengths[:, None]
    to_center = blobs.centers_W[None] - p_WPs[:, None]
    along = np.einsum("mna,ma->mn", to_center, rays)
    gap2 = np.einsum("mna,mna->mn", to_center, to_center) - along**2
    hit = (gap2 < (0.95 * blobs.radii) ** 2) & (along > 0.0) & (along < lengths[:, None]) & ~skip
    return hit.any(axis=1)


def best_direction(grasp: Grasp, hand: Hand, scene: Scene) -> Array:
    """Direction toward a camera that sees a grasp well: fingertips and contacts first, then the object.

    Args:
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.

    Returns:
        Unit vector in W from the grasp toward the camera, shape (3,).
    """
    blobs = hand_blobs(hand, grasp.X_WH, grasp.q)
    points, normals, gap = object_points(scene, grasp.X_WO)
    k = Configuration.at(hand, grasp.X_WH, grasp.q)
    tip_links = np.array([hand.link_index[f.tip_link] for f in hand.fingers])
    tips = k.points(tip_links, np.array([f.p_LTip for f in hand.fingers]))
    if grasp.certificate is not None:
        contacts = np.array([(grasp.X_WO @ c.p_OC) for c in grasp.certificate.contacts]).reshape(-1, 3)
        links = np.array([hand.link_index[c.link] for c in grasp.certificate.contacts], dtype=int)
        tips, tip_links = np.concatenate([tips, contacts]), np.concatenate([tip_links, links])
    beside = _obstacle_blobs(scene)
    everything = Blobs(
        np.concatenate([blobs.centers_W, points, beside.centers_W]),
        np.concatenate([blobs.radii, np.full(len(points), 0.6 * gap), beside.radii]),
    )
    n_hand = len(blobs.radii)
    sphere_links = np.concatenate([hand.sphere_links, np.full(len(points) + len(beside.radii), -1)])
    near = np.linalg.norm(everything.centers_W[None] - tips[:, None], axis=2) < everything.radii + 0.006
    skip_tips = (sphere_links[None] == tip_links[:, None]) | near
    index = np.arange(len(everything.radii))
    skip_object = np.broadcast_to((index >= n_hand) & (index < n_hand + len(points)), (len(points), len(index)))
    # A third of the spheres stands for the whole hand; what lies about a sphere's center does not hide it.
    some = blobs.centers_W[::3]
    apart = np.linalg.norm(everything.centers_W[None] - some[:, None], axis=2)
    skip_some = apart < everything.radii + blobs.radii[::3, None]
    center = points.mean(axis=0)
    best, best_score = np.array([0.0, -1.0, 0.5]), -np.inf
    for elevation in ELEVATIONS:
        for azimuth in np.arange(AZIMUTHS) * (2.0 * np.pi / AZIMUTHS):
            d = np.array([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)])
            d /= np.linalg.norm(d)
            p_WC = center + 0.6 * d
            faces_camera = np.einsum("ma,ma->m", p_WC - points, normals) > 0.0
            seen = faces_camera & ~_hidden(points, p_WC, everything, skip_object)
            seen_tips = ~_hidden(tips, p_WC, everything, skip_tips)
            # A three-quarter view from a little above is the pleasant one where nothing else decides.
            seen_hand = ~_hidden(some, p_WC, everything, skip_some)
            score = (
                seen_tips.mean()
                + 0.5 * seen_hand.mean()
                + 1.2 * seen.sum() / max(1, faces_camera.sum())
                - 0.4 * abs(elevation - 0.45)
            )
            if score > best_score + 1e-9:
                best, best_score = d, float(score)
    return best


def _obstacle_blobs(scene: Scene) -> Blobs:
    """Balls about the surfaces of a scene's obstacles."""
    centers, radii = [np.zeros((0, 3))], [np.zeros(0)]
    for fixture in scene.obstacles:
        points, _, gap = object_points(replace(scene, object=fixture.object), fixture.X_WF)
        centers.append(points)
        radii.append(np.full(len(points), 0.6 * gap))
    return Blobs(np.concatenate(centers), np.concatenate(radii))


def grasp_blobs(grasp: Grasp, hand: Hand, scene: Scene, *, rise_m: float = 0.0) -> Blobs:
    """Balls about everything that a picture of a grasp is to hold.

    Args:
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.
        rise_m: Height by which everything will rise and stay in the picture, from the pre-grasp on [m].

    Returns:
        Hand and object, and both of them risen.
    """
    parts = [hand_blobs(hand, grasp.X_WH, grasp.q)]
    if grasp.X_WH_pregrasp is not None and grasp.q_pregrasp is not None and rise_m > 0.0:
        parts.append(hand_blobs(hand, grasp.X_WH_pregrasp, grasp.q_pregrasp))
    points, _, _ = object_points(scene, grasp.X_WO)
    parts.append(Blobs(points, np.full(len(points), 0.005)))
    if rise_m > 0.0:
        parts += [Blobs(part.centers_W + np.array([0.0, 0.0, rise_m]), part.radii) for part in parts]
    return Blobs(np.concatenate([part.centers_W for part in parts]), np.concatenate([part.radii for part in parts]))


def best_view(
    grasp: Grasp,
    hand: Hand,
    scene: Scene,
    *,
    fov_y: float,
    aspect: float,
    rise_m: float = 0.0,
    direction: Array | None = None,
    margin: float = 1.06,
) -> RigidTransform:
    """A camera that frames hand and object of a grasp.

    Args:
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.
        fov_y: Vertical field of view [rad].
        aspect: Width of the picture divided by its height.
        rise_m: Height by which everything will rise and stay in the picture [m].
        direction: Direction from the grasp toward the camera in W, shape (3,); `best_direction` where None.
        margin: Factor on the room that hand and object take in the picture.

    Returns:
        X_WC.
    """
    d = best_direction(grasp, hand, scene) if direction is None else direction
    if direction is None and rise_m > 0.0:
        # From high above, a rise is hard to see.
        d = np.array([d[0], d[1], min(d[2], np.hypot(d[0], d[1]) * np.tan(ELEVATIONS[1]))])
    blobs = grasp_blobs(grasp, hand, scene, rise_m=rise_m)
    return frame_blobs(blobs, d, fov_y=fov_y, aspect=aspect, margin=margin)
