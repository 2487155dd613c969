"""Puts an object and a table into a Drake plant.

Hand and object touch by point contact. Object and table touch by hydroelastic contact, in any plant whose contact model
is Drake's default `kHydroelasticWithFallback`. Point contact would give the pair a single point, on which a box walks
46 mm across the table in 2 s; on a patch of pressure it stays where it is (measured, lagged, 5 ms steps).
"""

import trimesh
from pydrake.common import MemoryFile
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    Convex,
    InMemoryMesh,
    Mesh,
    ProximityProperties,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import RigidBody, RotationalInertia, SpatialInertia

from xdex_drake.scene.object import ObjectModel

POINT_STIFFNESS = 1e5
TABLE_MODULUS = 1e8
TABLE_SIZE = (2.0, 2.0, 0.2)
OBJECT_COLOR = (0.85, 0.62, 0.35, 1.0)
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


def add_object(
    plant: MultibodyPlant, object: ObjectModel, *, name: str = "object", point_stiffness: float = POINT_STIFFNESS
) -> RigidBody:
    """Adds an object as a free body whose frame is O: collision by its convex parts, looks by its mesh.

    Args:
        plant: Plant, not finalised; geometry is added where it has a scene graph.
        object: The object.
        name: Name of the model instance and of the body, unique in the plant.
        point_stiffness: Contact stiffness [N/m].

    Returns:
        The body.
    """
    inertia = RotationalInertia(*object.I_OcmO.diagonal(), *object.I_OcmO[[0, 0, 1], [1, 2, 2]])
    spatial = SpatialInertia.MakeFromCentralInertia(object.mass, object.p_OOcm, inertia)
    body = plant.AddRigidBody(name, plant.AddModelInstance(name), spatial)
    if not plant.geometry_source_is_registered():
        return body
    material = contact_material(object.friction, point_stiffness=point_stiffness)
    AddRigidHydroelasticProperties(1.0, material)
    for k, (vertices, _) in enumerate(object.parts):
        shape = Convex(points=vertices.T, label=f"{name}_part_{k}")
        plant.RegisterCollisionGeometry(body, RigidTransform(), shape, f"{name}_part_{k}", material)
    plant.RegisterVisualGeometry(body, RigidTransform(), visual_mesh(object), f"{name}_mesh", OBJECT_COLOR)
    return body


def visual_mesh(object: ObjectModel) -> Mesh:
    """The object's mesh as a Drake shape, held in memory.

    Args:
        object: The object.

    Returns:
        The shape; its frame is O.
    """
    # Faces that meet at an edge get normals of their own there; averaged ones smear the light over a can's rim.
    mesh = trimesh.graph.smooth_shade(trimesh.Trimesh(object.vertices, object.faces, process=False), angle=0.5)
    text = mesh.export(file_type="obj", include_normals=True)
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(str(text), ".obj", object.name)))


def add_table(plant: MultibodyPlant, friction: float, *, point_stiffness: float = POINT_STIFFNESS) -> None:
    """Adds a table to the world: a box whose top is the plane z = 0 of W.

    Args:
        plant: Plant with a scene graph, not finalised.
        friction: Coefficient of friction.
        point_stiffness: Contact stiffness for point contact, with the hand [N/m].
    """
    X_WT = RigidTransform([0.0, 0.0, -0.5 * TABLE_SIZE[2]])
    shape, world = Box(*TABLE_SIZE), plant.world_body()
    material = contact_material(friction, point_stiffness=point_stiffness)
    AddCompliantHydroelasticProperties(1.0, TABLE_MODULUS, material)
    plant.RegisterCollisionGeometry(world, X_WT, shape, "table", material)
    plant.RegisterVisualGeometry(world, X_WT, shape, "table", TABLE_COLOR)
