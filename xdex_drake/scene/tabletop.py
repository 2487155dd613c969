"""Objects that rest on the table."""

import hashlib
import logging
import math
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from xdex_drake.scene.bodies import add_object, add_table
from xdex_drake.scene.object import ObjectModel

Array = NDArray[np.float64]
_log = logging.getLogger(__name__)


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

    The poses that are stable on a facet of the convex hull come with their probabilities (trimesh, after Goldberg et
    al. 1999). A short simulation then lets the object settle until it moves slower than 2 mm/s and 0.05 rad/s for
    0.1 s, or for at most 2 s; it is turned to a random yaw and laid down so that its lowest point is at z = 0.

    Args:
        object: The object.
        seed: 0 takes the most probable pose; others draw one by its probability. The yaw is drawn too.

    Returns:
        X_WO.
    """
    rng = np.random.default_rng([seed, int(object.digest[:8], 16)])
    hull = trimesh.Trimesh(_points(object), process=False).convex_hull
    poses, probabilities = trimesh.poses.compute_stable_poses(hull, center_mass=object.p_OOcm, sigma=0.0, n_samples=1)
    pick = 0 if seed == 0 else int(rng.choice(len(poses), p=probabilities / probabilities.sum()))
    R_WO = RotationMatrix.ProjectToRotationMatrix(poses[pick][:3, :3])
    yaw = RotationMatrix.MakeZRotation(rng.uniform(-math.pi, math.pi))
    return _lay_down(object, yaw @ _settle(object, _lay_down(object, R_WO)).rotation())


def _points(object: ObjectModel) -> Array:
    return np.concatenate([vertices for vertices, _ in object.parts])


def _lay_down(object: ObjectModel, R_WO: RotationMatrix) -> RigidTransform:
    """Pose with a given rotation, center of mass over the origin, lowest point on the table."""
    p_WO = -(R_WO.matrix() @ object.p_OOcm)
    p_WO[2] = -(_points(object) @ R_WO.matrix()[2]).min()
    return RigidTransform(R_WO, p_WO)


def _settle(object: ObjectModel, X_WO: RigidTransform) -> RigidTransform:
    """Pose of an object after it has come to rest on the table."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.005)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    body = add_object(plant, object)
    add_table(plant, object.friction, [body])
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodyPose(context, body, X_WO)
    still = 0
    for k in range(80):
        try:
            simulator.AdvanceTo(0.025 * (k + 1))
        except RuntimeError as error:  # The contact solver gave up: the pose on the facet is still one of rest.
            _log.warning("%s does not settle: %s", object.name, error)
            return X_WO
        V_WO = plant.EvalBodySpatialVelocityInWorld(context, body)
        slow = np.linalg.norm(V_WO.translational()) < 2e-3 and np.linalg.norm(V_WO.rotational()) < 0.05
        still = still + 1 if slow else 0
        if still == 4:
            break
    return plant.EvalBodyPoseInWorld(context, body)


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
