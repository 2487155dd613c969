"""Puts an object and a table into a Drake plant; everything touches by point contact.

Hand and object touch by the object's convex parts. Object and table touch by the object's *feet*: tiny balls inside of
the corners of its convex hull. Point contact between a convex part and a table is a single point, on which a box walks
46 mm in 2 s. Hydroelastic contact has a force for each triangle, and a box stands on two: it walks 5 mm in 1 s wherever
the pressure mesh of the table has no edge below it. On feet eight shapes at three poses each move under 0.3 mm and turn
under 0.1 degrees in 1 s, and have a dozen contacts instead of 261 under a can (measured, lagged, 5 ms steps).
"""

from collections.abc import Sequence

import numpy as np
import trimesh
from pydrake.common import MemoryFile
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    Convex,
    GeometrySet,
    InMemoryMesh,
    Mesh,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody, RotationalInertia, SpatialInertia

from xdex_drake.scene.hulls import convex_hull, grow
from xdex_drake.scene.materials import object_color
from xdex_drake.scene.object import Array, ObjectModel

POINT_STIFFNESS = 1e5
FOOT_RADIUS = 2e-4
"""Radius of a foot [m]."""

FOOT_TOLERANCE = 2e-4
"""Corners of the hull are left out as long as it loses no more than this [m]."""

COARSE_FEET = 24
"""Number of feet away from the table, on which a tilted object stands."""

RESTING_FEET = 12
"""Greatest number of feet on the table."""

TABLE_SIZE = (2.0, 2.0, 0.2)
FIXTURE_COLOR = (0.36, 0.45, 0.56, 1.0)
TABLE_COLOR = (0.55, 0.57, 0.6, 1.0)


def contact_material(friction: float, *, point_stiffness: float = POINT_STIFFNESS) -> ProximityProperties:
    """Proximity properties for point contact.

    Two surfaces act in series: two stiffnesses of 1e5 N/m make one of 5e4 N/m.

    Args:
        friction: Coefficient of friction, static and dynamic alike.
        point_stiffness: Stiffness [N/m].

    Returns:
        The properties.
    """
    properties = ProximityProperties()
    AddContactMaterial(
        point_stiffness=point_stiffness, friction=CoulombFriction(friction, friction), properties=properties
    )
    return properties


def feet(object: ObjectModel, X_WO: RigidTransform | None = None) -> Array:
    """Centers of the feet of an object.

    A foot touches the faces of the convex hull about a corner from inside, so that the object stands as high on its
    feet as on its hull.

    Args:
        object: The object.
        X_WO: Pose at which it rests on the table: there it gets at most `RESTING_FEET`, spread widely, and
            `COARSE_FEET` elsewhere. Where None it gets all corners of its hull, to stand on any side.

    Returns:
        Points in O [m], shape (n, 3).
    """
    points = np.concatenate([vertices for vertices, _ in object.parts])
    hull = convex_hull(points, tolerance=FOOT_TOLERANCE if X_WO is None else 0.0)
    inner = grow(*hull, -FOOT_RADIUS)[0]
    if X_WO is None:
        return inner
    heights = inner @ X_WO.rotation().matrix()[2]
    low = inner[heights < heights.min() + FOOT_TOLERANCE]
    coarse = grow(*convex_hull(points, limit=COARSE_FEET), -FOOT_RADIUS)[0]
    return np.concatenate([_spread(low, RESTING_FEET), coarse])


def _spread(points: Array, limit: int) -> Array:
    """Points far from one another: each next one is the farthest from those that were taken."""
    taken = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    gap = np.linalg.norm(points - points[taken[0]], axis=1)
    while len(taken) < min(limit, len(points)):
        taken.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(points - points[taken[-1]], axis=1))
    return points[taken]


def add_object(
    plant: MultibodyPlant,
    object: ObjectModel,
    *,
    name: str = "object",
    point_stiffness: float = POINT_STIFFNESS,
    X_WO: RigidTransform | None = None,
    stands: bool = True,
) -> RigidBody:
    """Adds an object as a free body whose frame is O: collision by its convex parts and feet, looks by its mesh.

    Args:
        plant: Plant, not finalised; geometry is added where it has a scene graph.
        object: The object.
        name: Name of the model instance and of the body, unique in the plant.
        point_stiffness: Contact stiffness [N/m].
        X_WO: Pose at which it rests on the table, which needs fewer feet; see `feet`.
        stands: Whether it gets feet, to stand on a table; without one it needs none.

    Returns:
        The body. It touches a table that `add_table` puts under it by its feet alone.
    """
    inertia = RotationalInertia(*object.I_OcmO.diagonal(), *object.I_OcmO[[0, 0, 1], [1, 2, 2]])
    spatial = SpatialInertia.MakeFromCentralInertia(object.mass, object.p_OOcm, inertia)
    body = plant.AddRigidBody(name, plant.AddModelInstance(name), spatial)
    if not plant.geometry_source_is_registered():
        return body
    material = contact_material(object.friction, point_stiffness=point_stiffness)
    for k, (vertices, _) in enumerate(object.parts):
        shape = Convex(points=vertices.T, label=f"{name}_part_{k}")
        plant.RegisterCollisionGeometry(body, RigidTransform(), shape, f"{name}_part_{k}", material)
    for k, p_OF in enumerate(feet(object, X_WO) if stands else ()):
        plant.RegisterCollisionGeometry(body, RigidTransform(p_OF), Sphere(FOOT_RADIUS), f"{name}_foot_{k}", material)
    color = (*object_color(object.name), 1.0)
    plant.RegisterVisualGeometry(body, RigidTransform(), visual_mesh(object), f"{name}_mesh", color)
    return body


def add_fixture(
    plant: MultibodyPlant,
    object: ObjectModel,
    X_WF: RigidTransform,
    *,
    name: str = "obstacle",
    point_stiffness: float = POINT_STIFFNESS,
) -> RigidBody:
    """Adds an obstacle: a body that is welded to the world, with the object's convex parts.

    Args:
        plant: Plant with a scene graph, not finalised.
        object: What it is.
        X_WF: Its pose in W.
        name: Name of the model instance and of the body, unique in the plant.
        point_stiffness: Contact stiffness [N/m].

    Returns:
        The body.
    """
    body = plant.AddRigidBody(name, plant.AddModelInstance(name), SpatialInertia.Zero())
    plant.WeldFrames(plant.world_frame(), body.body_frame(), X_WF)
    material = contact_material(object.friction, point_stiffness=point_stiffness)
    for k, (vertices, _) in enumerate(object.parts):
        shape = Convex(points=vertices.T, label=f"{name}_part_{k}")
        plant.RegisterCollisionGeometry(body, RigidTransform(), shape, f"{name}_part_{k}", material)
    plant.RegisterVisualGeometry(body, RigidTransform(), visual_mesh(object), f"{name}_mesh", FIXTURE_COLOR)
    return body


def visual_mesh(object: ObjectModel) -> Mesh:
    """The object's mesh as a Drake shape, held in memory.

    Args:
        object: The object.

    Returns:
        The shape; its frame is O.
    """
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(visual_obj(object), ".obj", object.name)))


def visual_obj(object: ObjectModel) -> str:
    """The object's mesh as an OBJ file with normals.

    Args:
        object: The object.

    Returns:
        The file's text; its frame is O.
    """
    # Faces that meet at an edge get normals of their own there; averaged ones smear the light over a can's rim.
    mesh = trimesh.graph.smooth_shade(trimesh.Trimesh(object.vertices, object.faces, process=False), angle=0.5)
    return str(mesh.export(file_type="obj", include_normals=True))


def add_table(
    plant: MultibodyPlant,
    friction: float,
    objects: Sequence[RigidBody],
    *,
    height: float = 0.0,
    point_stiffness: float = POINT_STIFFNESS,
) -> None:
    """Adds a table to the world: a box whose top is the plane z = 0 of W, or higher.

    Args:
        plant: Plant with a scene graph, not finalised, with all its other bodies.
        friction: Coefficient of friction.
        objects: Bodies of `add_object`: they touch the table by their feet, and all else by their parts.
        height: Height of the top [m].
        point_stiffness: Contact stiffness [N/m].
    """
    others = [
        geometry
        for index in range(plant.num_bodies())
        if (body := plant.get_body(BodyIndex(index))) not in objects
        for geometry in plant.GetCollisionGeometriesForBody(body)
    ]
    X_WT = RigidTransform([0.0, 0.0, height - 0.5 * TABLE_SIZE[2]])
    shape, world = Box(*TABLE_SIZE), plant.world_body()
    material = contact_material(friction, point_stiffness=point_stiffness)
    table = plant.RegisterCollisionGeometry(world, X_WT, shape, "table", material)
    plant.RegisterVisualGeometry(world, X_WT, shape, "table", TABLE_COLOR)
    # The plant does not hand out its scene graph in Python; a parser made for the plant does.
    scene_graph = Parser(plant).scene_graph()
    names = scene_graph.model_inspector().GetName
    declaration = CollisionFilterDeclaration()
    for body in objects:
        ids = plant.GetCollisionGeometriesForBody(body)
        foot_ids = [geometry for geometry in ids if "_foot_" in names(geometry)]
        parts = [geometry for geometry in ids if geometry not in foot_ids]
        declaration.ExcludeBetween(GeometrySet(parts), GeometrySet(table))
        declaration.ExcludeBetween(GeometrySet(foot_ids), GeometrySet(others))
    scene_graph.collision_filter_manager().Apply(declaration)
