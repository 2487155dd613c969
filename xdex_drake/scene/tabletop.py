"""Objects that rest on the table."""

import hashlib
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import KDTree

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.scene.bodies import add_object, add_table
from xdex_drake.scene.fixtures import Fixture
from xdex_drake.scene.object import DEFAULT_FRICTION, DEFAULT_MASS, ObjectModel, load_object

_log = logging.getLogger(__name__)

ROUNDING = (0.0, 1e-4, 3e-4, 1e-3)
"""Roundings of the hull's points that are tried until its facets account for `ACCOUNTED` of the orientations [m]."""

ACCOUNTED = 0.8
"""Sum of the facets' probabilities that is enough; it is one where trimesh loses none."""

LEAST_PROBABILITY = 0.01
"""Poses on a facet that are rarer are left out of `stable_poses`."""

STABLE_TILT = math.radians(5.0)
"""A pose is stable where the object, let go at it, comes to rest tilted by less than this [rad]."""

SAME_SHAPE = 0.03
"""Two poses are the same where, after the best yaw, the surfaces are this close (p95) [object lengths]."""

OFF_TABLE = 2e-3
"""Height of the lowest point above or below the table that a user's own pose may have [m]."""

HIGHEST_TABLE = 3.0
"""Greatest height of a table, up or down [m]."""

SEEN_POINTS = 2000
"""Points of the object's surface that must lie outside of the obstacles."""

TABLE_HALF = 1.0
"""Half the side of the table [m]."""

UPRIGHT_DEG = 15.0
"""Greatest angle between an object's z axis and up at which it stands upright [degrees]."""

DROP_HEIGHT = 5e-3
"""Height of the lowest point above the table from which `drop` lets go [m]."""


@dataclass(frozen=True, eq=False)
class Scene:
    """An object on the table, whose top is the plane z = 0 of W unless another height is given.

    Attributes:
        object: The object.
        X_WO: Pose of the object in W.
        scene_id: Identifier: the object's name, its digest's first digits, and the seed or a digest of the pose; with a
            digest of table and obstacles where these are not the usual ones.
        table: Height of the table's top [m]; None where there is no table, and the object floats until it is held.
        obstacles: What is fixed in the world beside the object.
    """

    object: ObjectModel
    X_WO: RigidTransform
    scene_id: str
    table: float | None = 0.0
    obstacles: tuple[Fixture, ...] = ()

    @property
    def floor(self) -> float:
        """Height of the table's top [m]; minus infinity where there is none."""
        return -math.inf if self.table is None else self.table

    def __repr__(self) -> str:
        """One line."""
        return f"Scene({self.scene_id!r}, {self.object!r})"


def make_scene(
    object: ObjectModel,
    *,
    seed: int = 0,
    pose: RigidTransform | None = None,
    spread_m: float = 0.0,
    table: float | None = 0.0,
    obstacles: Sequence[Fixture] = (),
) -> Scene:
    """Lays an object on the table, or lets it float.

    Args:
        object: The object.
        seed: Choice of the stable pose, its yaw and its place; unused where `pose` is given.
        pose: Pose X_WO to take instead of a stable one; the object must lie on the table at it, where there is one.
        spread_m: Half the side of the square about the origin in which the object is placed at random [m].
        table: Height of the table's top [m]. None for no table: the object floats where it would rest on one at z = 0,
            a hand may come from anywhere, below too, and a grasp is judged by the protocol `release`.
        obstacles: What is fixed in the world beside the object; hands keep clear of it.

    Returns:
        The scene; the same arguments give the same scene.

    Raises:
        ConfigError: `spread_m` is negative or leaves the table, the pose is in the table, above it or beyond it, or an
            obstacle is in the object.
    """
    if table is not None and not abs(table) <= HIGHEST_TABLE:
        raise ConfigError(f"the table's height is {table:g}; give metres, at most {HIGHEST_TABLE:g} up or down")
    if not 0.0 <= spread_m <= 0.5:
        raise ConfigError(f"spread_m is {spread_m:g}; give metres from 0 to 0.5, the table is 2 m wide")
    if pose is not None:
        if table is not None:
            _check_pose(object, pose, table)
        mark = "p" + hashlib.sha256(np.round(pose.GetAsMatrix34(), 9).tobytes()).hexdigest()[:8]
        return _surrounded(object, pose, mark, table, obstacles)
    X_WO, mark = stable_pose(object, seed=seed), f"{seed}"
    if table:
        X_WO = RigidTransform(X_WO.rotation(), X_WO.translation() + np.array([0.0, 0.0, table]))
    if spread_m > 0.0:
        x, y = np.random.default_rng([seed, 1]).uniform(-spread_m, spread_m, 2)
        X_WO, mark = RigidTransform(X_WO.rotation(), X_WO.translation() + np.array([x, y, 0.0])), f"{seed}s{spread_m:g}"
    return _surrounded(object, X_WO, mark, table, obstacles)


def _surrounded(
    object: ObjectModel, X_WO: RigidTransform, mark: str, table: float | None, obstacles: Sequence[Fixture]
) -> Scene:
    """The scene with table and obstacles, which must not be in the object."""
    points = object.surface_samples(SEEN_POINTS)[0] if obstacles else np.zeros((0, 3))
    for fixture in obstacles:
        depth = -float(fixture.distances((X_WO @ points.T).T)[0].min())
        if depth > 0.0:
            raise ConfigError(
                f"obstacle {fixture.object.name}: it is {1e3 * depth:.0f} mm inside of {object.name}; move it away"
            )
    if table != 0.0 or obstacles or object.inertia_given:
        mass = [repr((object.p_OOcm.tolist(), object.I_OcmO.tolist()))] if object.inertia_given else []
        seen = [
            repr(table),
            *mass,
            *(f"{f.object.digest} {np.round(f.X_WF.GetAsMatrix34(), 9).tolist()}" for f in obstacles),
        ]
        mark += "-w" + hashlib.sha256("\n".join(seen).encode()).hexdigest()[:8]
    return Scene(object, X_WO, f"{object.name}-{object.digest[:8]}-{mark}", table, tuple(obstacles))


def _check_pose(object: ObjectModel, pose: RigidTransform, table: float) -> None:
    """Refuses a pose of a user's own at which nothing can lie."""
    low = float((_points(object) @ pose.rotation().matrix()[2]).min() + pose.translation()[2]) - table
    where = "below the table" if low < 0.0 else "above the table"
    if abs(low) > OFF_TABLE:
        raise ConfigError(
            f"pose of {object.name}: its lowest point is {1e3 * abs(low):.0f} mm {where}, which is the plane z = "
            f"{table:g}; {'raise' if low < 0.0 else 'lower'} it by as much, or give the table's height, or no table"
        )
    x, y, _ = pose @ object.p_OOcm
    if max(abs(x), abs(y)) > TABLE_HALF:
        raise ConfigError(
            f"pose of {object.name}: its center of mass is at x = {x:.2f}, y = {y:.2f} m, beyond the table, which "
            f"reaches {TABLE_HALF:g} m from its middle"
        )


def pose_of(object: ObjectModel, *, number: int | None = None, upright: bool = False) -> RigidTransform:
    """One of the ways in which an object rests: by its number, or as its file has it upright.

    Args:
        object: The object.
        number: Number among `stable_poses`, the most probable one 0.
        upright: Whether the object's z axis shall point up instead.

    Returns:
        X_WO, its center of mass over the origin.

    Raises:
        ConfigError: There is no such pose.
    """
    poses = stable_poses(object)
    if upright:
        up = [math.degrees(math.acos(min(1.0, float(pose.X_WO.rotation().matrix()[2, 2])))) for pose in poses]
        best = int(np.argmin(up))
        if up[best] > UPRIGHT_DEG:
            raise ConfigError(
                f"{object.name} does not stand upright: of its {len(poses)} poses, number {best} comes nearest, "
                f"z of its file {up[best]:.0f} degrees from up; choose a pose by its number"
            )
        return poses[best].X_WO
    if number is None or not 0 <= number < len(poses):
        raise ConfigError(
            f"{object.name} has no pose {number}; it rests in {len(poses)} ways, 0 to {len(poses) - 1}, which "
            "`xdex object show` lists"
        )
    return poses[number].X_WO


def random_scene(
    name_or_path: str | Path,
    *,
    seed: int,
    scale: tuple[float, float] = (0.8, 1.2),
    spread_m: float = 0.1,
    mass: float = DEFAULT_MASS,
    friction: float = DEFAULT_FRICTION,
) -> Scene:
    """An object of random scale, at a random stable pose, yaw and place on the table, as XDex asks of its scenes.

    Args:
        name_or_path: See `load_object`.
        seed: Seed of all that is drawn; a seed above zero, as 0 stands for the most probable pose.
        scale: Least and greatest factor on the object's size; drawn in steps of 0.05, so that few sizes are prepared.
        spread_m: See `make_scene`.
        mass: Mass [kg].
        friction: Coefficient of friction.

    Returns:
        The scene; the same arguments give the same scene.

    Raises:
        ConfigError: A number is out of range.
    """
    low, high = scale
    if not (0.0 < low <= high and math.isfinite(high)):
        raise ConfigError(f"scale is from {low:g} to {high:g}; give two factors above zero, the smaller one first")
    factor = float(np.random.default_rng([seed, 2]).uniform(low, high))
    factor = round(min(max(0.05 * round(factor / 0.05), low), high), 6)
    model = load_object(name_or_path, mass=mass, friction=friction)
    if factor != 1.0:
        model = load_object(name_or_path, scale=round(model.scale * factor, 9), mass=mass, friction=friction)
    return make_scene(model, seed=seed, spread_m=spread_m)


def resting_scene(object: ObjectModel, *, index: int, seed: int = 0) -> Scene:
    """One of many scenes of an object: all its poses at rest take turns, rare ones too, each time at another yaw.

    Args:
        object: The object.
        index: Number of the scene, from 0.
        seed: Seed of the order of the poses and of the yaws.

    Returns:
        The scene, the center of mass above the origin; the same arguments give the same scene.
    """
    poses = stable_poses(object)
    own = int(object.digest[:8], 16)
    order = np.random.default_rng([seed, own]).permutation(len(poses))
    yaw = np.random.default_rng([seed, own, index]).uniform(-math.pi, math.pi)
    X_WO = RigidTransform(RotationMatrix.MakeZRotation(yaw)) @ poses[order[index % len(poses)]].X_WO
    return Scene(object, X_WO, f"{object.name}-{object.digest[:8]}-{seed}r{index}")


@dataclass(frozen=True, eq=False)
class StablePose:
    """A way in which an object rests on the table; poses that differ by yaw or by a symmetry are one.

    Attributes:
        X_WO: Pose, with the center of mass over the origin.
        probability: Share of the drops from a random orientation that end so, by the convex-hull method.
        tilt_rad: Angle by which the object tilts, let go at the facet of its hull, until it rests [rad].
    """

    X_WO: RigidTransform
    probability: float
    tilt_rad: float


def stable_poses(object: ObjectModel) -> tuple[StablePose, ...]:
    """All ways in which an object rests on the table, the most probable first.

    Candidates are the facets of the convex hull with their quasi-static probabilities (trimesh, after Goldberg et al.
    1999); those that look alike after a yaw are joined. Each is let go in Drake: where the object comes to rest (slower
    than 2 mm/s and 0.05 rad/s for 0.1 s, within 2 s) tilted by less than 5 degrees it is confirmed; else its
    probability goes to the pose into which it rolled.

    Args:
        object: The object.

    Returns:
        The poses; probabilities add up to one.
    """
    facets, probabilities = _facets(object)
    samples = object.surface_samples(600, 0)[0] - object.p_OOcm
    groups: list[tuple[RotationMatrix, float]] = []
    for pick in np.argsort(-probabilities, kind="stable"):
        R_WO = RotationMatrix.ProjectToRotationMatrix(facets[pick][:3, :3])
        same = next((k for k, (R, _) in enumerate(groups) if same_pose(object, R, R_WO, samples)), None)
        if same is None:
            groups.append((R_WO, float(probabilities[pick])))
        else:
            groups[same] = (groups[same][0], groups[same][1] + float(probabilities[pick]))
    drop_table = _DropTable(object)
    found: list[StablePose] = []
    rolled: list[tuple[RotationMatrix, float, float]] = []
    for R_WO, probability in sorted(groups, key=lambda group: -group[1]):
        if probability < LEAST_PROBABILITY:
            continue
        X_WO, at_rest = drop_table.settle(_lay_down(object, R_WO))
        tilt = _tilt(R_WO, X_WO.rotation())
        if at_rest and tilt < STABLE_TILT:
            found.append(StablePose(_lay_down(object, X_WO.rotation()), probability, tilt))
        else:
            rolled.append((X_WO.rotation(), probability, tilt))
    for R_WO, probability, tilt in rolled:
        same = next((k for k, p in enumerate(found) if same_pose(object, p.X_WO.rotation(), R_WO, samples)), None)
        if same is None:
            found.append(StablePose(_lay_down(object, R_WO), probability, tilt))
        else:
            found[same] = replace(found[same], probability=found[same].probability + probability)
    total = sum(pose.probability for pose in found)
    ordered = sorted(found, key=lambda pose: -pose.probability)
    return tuple(replace(pose, probability=pose.probability / total) for pose in ordered)


def drop(object: ObjectModel, *, count: int, seed: int = 0) -> list[RigidTransform]:
    """Drops an object from orientations that are uniform at random, and waits until it rests.

    Args:
        object: The object.
        count: Number of drops.
        seed: Seed of the orientations.

    Returns:
        Poses X_WO at which it came to rest within 4 s; drops after which it still moves are left out.
    """
    rng, drop_table = np.random.default_rng(seed), _DropTable(object)
    poses = []
    for _ in range(count):
        quaternion = rng.normal(size=4)
        X_WO = _lay_down(object, RotationMatrix(Quaternion(quaternion / np.linalg.norm(quaternion))))
        lifted = RigidTransform(X_WO.rotation(), X_WO.translation() + np.array([0.0, 0.0, DROP_HEIGHT]))
        rest, at_rest = drop_table.settle(lifted, limit_s=4.0)
        if at_rest:
            poses.append(rest)
    return poses


def same_pose(object: ObjectModel, R_WO: RotationMatrix, other: RotationMatrix, samples: Array | None = None) -> bool:
    """Whether two orientations of an object differ by a yaw and a symmetry of its shape only.

    Args:
        object: The object.
        R_WO: An orientation.
        other: Another one.
        samples: Points of the surface about the center of mass, in O [m], shape (n, 3); drawn where None.

    Returns:
        Whether the surfaces agree within `SAME_SHAPE` of the object's length (p95) after the best of 48 yaws.
    """
    if _tilt(R_WO, other) < 1e-3:
        return True
    points = object.surface_samples(600, 0)[0] - object.p_OOcm if samples is None else samples
    first, second = points @ R_WO.matrix().T, points @ other.matrix().T
    # Random samples of one surface are about this far apart, whatever the shape.
    spacing = float(np.median(KDTree(points).query(points, k=2)[0][:, 1]))
    limit = SAME_SHAPE * object.length + 2.0 * spacing
    if abs(first[:, 2].min() - second[:, 2].min()) > limit:
        return False
    profiles = [np.column_stack((np.linalg.norm(p[:, :2], axis=1), p[:, 2])) for p in (first, second)]
    if np.percentile(KDTree(profiles[0]).query(profiles[1])[0], 95) > limit:
        return False
    tree = KDTree(first)
    for yaw in np.linspace(0.0, 2.0 * math.pi, 48, endpoint=False):
        turned = second @ RotationMatrix.MakeZRotation(yaw).matrix().T
        if np.percentile(tree.query(turned)[0], 95) < limit:
            return True
    return False


def _tilt(R_WO: RotationMatrix, other: RotationMatrix) -> float:
    """Angle between the vertical directions of two orientations, seen from the object [rad]."""
    up, other_up = R_WO.matrix()[2], other.matrix()[2]
    return float(np.arctan2(np.linalg.norm(np.cross(up, other_up)), up @ other_up))


def _facets(object: ObjectModel) -> tuple[Array, Array]:
    """Poses on the facets of the convex hull, shape (n, 4, 4), and their probabilities, shape (n,).

    Slivers among the hull's triangles make trimesh lose facets with their probability, on a few meshes all of them.
    Points are then rounded until most are accounted for.
    """
    exact = _points(object)
    poses, probabilities = np.zeros((0, 4, 4)), np.zeros(0)
    for grid in ROUNDING:
        points = grid * np.unique(np.round(exact / grid), axis=0) if grid > 0.0 else exact
        hull = trimesh.Trimesh(points, process=False).convex_hull
        found = trimesh.poses.compute_stable_poses(hull, center_mass=object.p_OOcm, sigma=0.0, n_samples=1)
        poses, probabilities = np.asarray(found[0]), np.asarray(found[1])
        if probabilities.sum() > ACCOUNTED:
            break
    if len(poses) == 0:
        raise ConfigError(f"object {object.name}: no facet of its convex hull is a pose of rest; it only rolls")
    return poses, probabilities


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
    poses, probabilities = _facets(object)
    pick = 0 if seed == 0 else int(rng.choice(len(poses), p=probabilities / probabilities.sum()))
    R_WO = RotationMatrix.ProjectToRotationMatrix(poses[pick][:3, :3])
    yaw = RotationMatrix.MakeZRotation(rng.uniform(-math.pi, math.pi))
    return _lay_down(object, yaw @ _DropTable(object).settle(_lay_down(object, R_WO))[0].rotation())


def _points(object: ObjectModel) -> Array:
    return np.concatenate([vertices for vertices, _ in object.parts])


def _lay_down(object: ObjectModel, R_WO: RotationMatrix) -> RigidTransform:
    """Pose with a given rotation, center of mass over the origin, lowest point on the table."""
    p_WO = -(R_WO.matrix() @ object.p_OOcm)
    p_WO[2] = -(_points(object) @ R_WO.matrix()[2]).min()
    return RigidTransform(R_WO, p_WO)


class _DropTable:
    """An object on a table in Drake, to be let go any number of times."""

    def __init__(self, object: ObjectModel) -> None:
        builder = DiagramBuilder()
        self.name = object.name
        self.plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.005)
        self.plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
        self.body = add_object(self.plant, object)
        add_table(self.plant, object.friction, [self.body])
        self.plant.Finalize()
        self.diagram = builder.Build()

    def settle(self, X_WO: RigidTransform, *, limit_s: float = 2.0) -> tuple[RigidTransform, bool]:
        """Pose of the object after it has come to rest, and whether it has."""
        plant, body = self.plant, self.body
        simulator = Simulator(self.diagram)
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        plant.SetFreeBodyPose(context, body, X_WO)
        still = 0
        for k in range(round(limit_s / 0.025)):
            try:
                simulator.AdvanceTo(0.025 * (k + 1))
            except RuntimeError as error:  # The contact solver gave up: the pose on the facet is still one of rest.
                _log.warning("%s does not settle: %s", self.name, error)
                return X_WO, False
            V_WO = plant.EvalBodySpatialVelocityInWorld(context, body)
            slow = np.linalg.norm(V_WO.translational()) < 2e-3 and np.linalg.norm(V_WO.rotational()) < 0.05
            still = still + 1 if slow else 0
            if still == 4:
                break
        return plant.EvalBodyPoseInWorld(context, body), still == 4


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
