"""Objects that rest on the table."""

import hashlib
import math
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.scene.object import ObjectModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scene:
    """An object on the table, whose top is the plane z = 0 of W.

    Attributes:
        object: The object.
        X_WO: Pose of the object in W.
        scene_id: Identifier: the object's name, its digest's first digits, and the seed or a digest of the pose.
    """

    object: ObjectModel
    X_WO: RigidTransform
    scene_id: str


def make_scene(object: ObjectModel, *, seed: int = 0, pose: RigidTransform | None = None) -> Scene:
    """Lays an object on the table.

    Args:
        object: The object.
        seed: Choice of the stable pose; unused where `pose` is given.
        pose: Pose X_WO to take instead of a stable one.

    Returns:
        The scene; the same arguments give the same scene.
    """
    X_WO = stable_pose(object, seed=seed) if pose is None else pose
    mark = (
        f"{seed}" if pose is None else "p" + hashlib.sha256(np.round(X_WO.GetAsMatrix34(), 9).tobytes()).hexdigest()[:8]
    )
    return Scene(object, X_WO, f"{object.name}-{object.digest[:8]}-{mark}")


def stable_pose(object: ObjectModel, *, seed: int = 0) -> RigidTransform:
    """A pose at which an object rests on the table, its center of mass above the origin.

    Args:
        object: The object.
        seed: 0 takes the most probable pose; others draw one by its probability. The yaw is drawn too.

    Returns:
        X_WO.
    """
    rng = np.random.default_rng([seed, int(object.digest[:8], 16)])
    points = np.concatenate([vertices for vertices, _ in object.parts])
    hull = trimesh.Trimesh(points, process=False).convex_hull
    poses, probabilities = trimesh.poses.compute_stable_poses(hull, center_mass=object.p_OOcm, sigma=0.0, n_samples=1)
    pick = 0 if seed == 0 else int(rng.choice(len(poses), p=probabilities / probabilities.sum()))
    R_WO = RotationMatrix.MakeZRotation(rng.uniform(-math.pi, math.pi)) @ RotationMatrix.ProjectToRotationMatrix(
        poses[pick][:3, :3]
    )
    p_WO = -(R_WO @ object.p_OOcm)
    p_WO[2] = -(points @ R_WO.matrix()[2]).min()
    return RigidTransform(R_WO, p_WO)


def point_cloud(scene: Scene, n: int, seed: int = 0, *, in_world: bool = True) -> tuple[Array, Array]:
    """Points spread evenly at random over the whole surface of a scene's object.

    Args:
        scene: The scene.
        n: Number of points.
        seed: Seed of the sampling.
        in_world: Whether the points are expressed in W; otherwise in O.

    Returns:
        Points [m], shape (n, 3), and unit normals out of the object, shape (n, 3).
    """
    points, normals = scene.object.surface_samples(n, seed)
    if not in_world:
        return points, normals
    R_WO = scene.X_WO.rotation().matrix()
    return points @ R_WO.T + scene.X_WO.translation(), normals @ R_WO.T
