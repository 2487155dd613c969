"""Lets a grasp touch where hand and object are: by shapes in place of spheres, on the mesh in place of parts.

Programs know a hand by spheres and an object by convex parts. Spheres bulge out of boxes and hulls by up to
millimetres, and parts smooth a mesh. Here contacts are moved until the gap between shape and mesh is zero at each of
them, and points and normals of the contacts are taken from the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.contact.penetration import hand_depths
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.point import Point
from xdex_drake.scene.object import ObjectModel
from xdex_drake.scene.tabletop import Scene

PATCH_RADIUS = 1.5e-3
"""Radius of the patch of the mesh over which a contact's normal is averaged: that of a fingertip's touch [m]."""

TOUCH = 5e-5
"""Gap at which a contact counts as touching [m]."""

ROUNDS = 6
"""Greatest number of steps until contacts touch."""

PROJECTIONS = 8
"""Projections to and fro between shape and mesh in search of their nearest points."""

MOVE_SCALE = np.array([0.05, 0.05, 0.05, 0.005, 0.005, 0.005])
"""Turn [rad] and displacement [m] of the wrist that count as much as a turn of a joint by `JOINT_SCALE`."""

JOINT_SCALE = 0.15
"""See `MOVE_SCALE` [rad]."""


@dataclass(frozen=True)
class Touches:
    """Contacts between a hand's shapes and an object's mesh.

    Attributes:
        k: The hand's configuration.
        p_WCs: Contact points on the mesh [m], shape (nc, 3).
        n_WCs: Unit normals into the object, averaged over a fingertip's patch, shape (nc, 3).
        gaps: Gap between shape and mesh at each contact, negative where they overlap [m], shape (nc,).
        smoothing: Distance of each contact point from the surface of the convex parts [m], shape (nc,).
    """

    k: Configuration
    p_WCs: Array
    n_WCs: Array
    gaps: Array
    smoothing: Array


def touch(hand: Hand, point: Point) -> Touches:
    """Moves a hand a little until its shapes touch the mesh at the contacts of a point.

    The step is the least one, in the sense of `MOVE_SCALE`, that closes all gaps to first order; a few are taken.

    Args:
        hand: The hand.
        point: A point whose contact spheres touch the parts.

    Returns:
        The contacts. Where joint limits or contacts that contradict one another forbid it, gaps remain.
    """
    scene, k, links = point.scene, point.k, point.contacts.links
    p_WCs = point.exact_contacts()[0]
    scale = np.concatenate([MOVE_SCALE, np.full(len(k.q), JOINT_SCALE)])
    for _ in range(ROUNDS):
        p_WCs, gaps, away = nearest_points(hand, k, scene, links, p_WCs)
        if np.abs(gaps).max(initial=0.0) < TOUCH:
            break
        # A link that moves along `away` comes nearer: d gap = -away . J dx.
        rows = k.pull_back_each(links, p_WCs, away) * scale
        step = scale * np.asarray(np.linalg.lstsq(rows, gaps, rcond=1e-6)[0], dtype=np.float64)
        k = k.moved(step)
        k = Configuration.at(hand, k.X_WH, np.clip(k.q, *hand.limits))
    p_WCs, gaps, away = nearest_points(hand, k, scene, links, p_WCs)
    p_OCs, R_WO = _to_object(scene, p_WCs), scene.X_WO.rotation().matrix()
    smoothing = np.abs(scene.object.exact.query(p_OCs).distance)
    n_WCs = -patch_normals(scene.object, p_OCs, -away @ R_WO) @ R_WO.T
    return Touches(k, p_WCs, n_WCs, gaps, smoothing)


def nearest_points(
    hand: Hand, k: Configuration, scene: Scene, links: NDArray[np.int64], p_WCs: Array
) -> tuple[Array, Array, Array]:
    """Points of the mesh that are nearest to links, by projections to and fro.

    Args:
        hand: The hand.
        k: Its configuration.
        scene: The scene.
        links: Index of each contact's link, shape (nc,).
        p_WCs: Points to begin with, near the mesh [m], shape (nc, 3).

    Returns:
        Points on the mesh [m], shape (nc, 3), the distance of each from its link's shapes, negative inside [m], shape
        (nc,), and the unit direction in W in which it grows, shape (nc, 3).
    """
    p = _on_mesh(scene, p_WCs)
    best, least = p, np.full(len(p), np.inf)
    for _ in range(PROJECTIONS):
        gaps, away = _link_distances(hand, k, links, p)
        nearer = gaps < least
        best, least = np.where(nearer[:, None], p, best), np.where(nearer, gaps, least)
        if not nearer.any():
            break
        p = _on_mesh(scene, p - gaps[:, None] * away)
    gaps, away = _link_distances(hand, k, links, best)
    return best, gaps, away


def patch_normals(obj: ObjectModel, p_OCs: Array, outward_O: Array) -> Array:
    """Outward normals of a mesh as a fingertip feels them.

    The mean, over a disk of `PATCH_RADIUS` that is as far above the contact point, of the directions from the nearest
    points of the mesh: the face's normal on a face, a blend of the faces' on an edge or where facets are small.

    Args:
        obj: The object.
        p_OCs: Points on the mesh, in O [m], shape (n, 3).
        outward_O: Unit direction from each to the inside of the link that touches there, in O, shape (n, 3).

    Returns:
        Unit normals in O, shape (n, 3).
    """
    mesh = obj.mesh_distance
    across = np.linalg.svd(outward_O[:, None, :])[2][:, 1:]  # (n, 2, 3)
    angles = 2.0 * np.pi * np.arange(8) / 8.0
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    disk = PATCH_RADIUS * np.concatenate([np.zeros((1, 2)), 0.5 * ring, ring])
    points = ((p_OCs + PATCH_RADIUS * outward_O)[:, None] + disk @ across).reshape(-1, 3)
    closest, face = mesh.closest(points)
    offset = points - closest
    # Points of the disk that dip into the object see its surface from inside.
    offset *= np.where((offset * mesh.normals[face]).sum(1) < 0.0, -1.0, 1.0)[:, None]
    offset /= np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-9)
    mean = offset.reshape(len(p_OCs), -1, 3).mean(axis=1)
    return mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9)


def lowest_height(hand: Hand, k: Configuration) -> float:
    """Height of the lowest point of a hand's shapes above the table [m]."""
    down = -k.R_WLs[:, 2]  # of each link, in its frame
    return min(
        float(p[2]) - geometry.support(d)
        for link, p, d in zip(hand.links, k.p_WLs, down, strict=True)
        for geometry in link.geometry
    )


def clear(hand: Hand, k: Configuration, points_W: Array, gap: float) -> bool:
    """Whether some points are at least a gap [m] away from a hand's shapes.

    Args:
        hand: The hand.
        k: Its configuration.
        points_W: Points [m], shape (m, 3).
        gap: Gap [m].

    Returns:
        The answer.
    """
    return not hand_depths(hand, k.R_WLs, k.p_WLs, points_W, reach=gap).any()


def _link_distances(hand: Hand, k: Configuration, links: NDArray[np.int64], p_Ws: Array) -> tuple[Array, Array]:
    """Distance of each point from its link's shapes [m], and the unit direction in W in which it grows."""
    h = 1e-6
    stencil = np.concatenate([np.zeros((1, 3)), h * np.eye(3), -h * np.eye(3)])
    gaps, away = np.empty(len(p_Ws)), np.empty((len(p_Ws), 3))
    for row, (link, p_W) in enumerate(zip(links, p_Ws, strict=True)):
        p_L = (p_W - k.p_WLs[link]) @ k.R_WLs[link]
        distances = np.min([geometry.signed_distance(p_L + stencil) for geometry in hand.links[link].geometry], axis=0)
        slope = distances[1:4] - distances[4:]
        gaps[row], away[row] = distances[0], k.R_WLs[link] @ slope / max(float(np.linalg.norm(slope)), 1e-12)
    return gaps, away


def _on_mesh(scene: Scene, p_Ws: Array) -> Array:
    """The nearest point of the mesh to each point, in W."""
    closest, _ = scene.object.mesh_distance.closest(_to_object(scene, p_Ws))
    return closest @ scene.X_WO.rotation().matrix().T + scene.X_WO.translation()


def _to_object(scene: Scene, p_Ws: Array) -> Array:
    return (p_Ws - scene.X_WO.translation()) @ scene.X_WO.rotation().matrix()
