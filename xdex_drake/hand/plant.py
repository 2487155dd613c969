"""A hand in a Drake plant. Programs, inverse kinematics and simulation all build their plants by this one function."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
    ProximityProperties,
    Shape,
)
from pydrake.geometry import Box as DrakeBox
from pydrake.geometry import Capsule as DrakeCapsule
from pydrake.geometry import Convex as DrakeConvex
from pydrake.geometry import Sphere as DrakeSphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    RotationalInertia,
    SpatialInertia,
)

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.collision import ignored_pairs
from xdex_drake.hand.description import Box, Capsule, Geometry, Hand, Joint, Link, Sphere
from xdex_drake.hand.looks import link_colors

JOINT_DAMPING = 0.01
"""Viscous damping of every joint [N m s/rad or N s/m]."""

DISSIPATION = 10.0
"""Hunt-Crossley dissipation of point contact, where a stiffness is given [s/m]: a touch does not bounce."""

FACET_RAD = np.pi / 18.0
"""Angle between neighbouring facets of a round shape in contact [rad]."""

ShapeOf = Callable[[Geometry, str], tuple[Shape, RigidTransform]]
"""What a primitive in L becomes in Drake, with a label for messages: a shape in its own frame G, and X_LG."""


def add_hand(
    plant: MultibodyPlant,
    hand: Hand,
    *,
    model_name: str | None = None,
    friction: float = 0.6,
    point_stiffness: float | None = None,
    pd_gains: tuple[float, float] | None = None,
    shape_of: ShapeOf | None = None,
) -> ModelInstanceIndex:
    """Adds a hand to a plant that is not finalized.

    The base link is left free: weld it, or put it on joints of your own. Couplings become coupler constraints, which
    need a discrete plant of the SAP family (`similar` or `lagged`) to simulate. Each actuated joint gets an actuator of
    its name with its effort limit. Joints start at the rest posture, coupled ones included. Geometry is added only if
    the plant is registered with a scene graph; pairs of links that `self_collision_pairs` leaves out do not collide.

    Args:
        plant: The plant.
        hand: The hand.
        model_name: Name of the model instance; the hand's name where None.
        friction: Coefficient of friction of the hand's surface, static and dynamic.
        point_stiffness: Stiffness of point contact [N/m], with `DISSIPATION`; Drake's default where None.
        pd_gains: Gains (K_p [N m/rad], K_d [N m s/rad]) of implicit PD control on every actuator; discrete plants only.
        shape_of: What a primitive is in contact; `contact_shape` where None.

    Returns:
        The model instance.

    Raises:
        ConfigError: The plant is finalized already.
    """
    if plant.is_finalized():
        raise ConfigError(f"hand {hand.name}: the plant is finalized; add the hand before plant.Finalize()")
    instance = plant.AddModelInstance(model_name or hand.name)
    bodies = [plant.AddRigidBody(link.name, instance, _spatial_inertia(link)) for link in hand.links]
    if plant.geometry_source_is_registered():
        properties = _proximity_properties(friction, point_stiffness)
        colors = link_colors(hand)
        ids = [
            _add_geometry(plant, body, link, color, properties, shape_of or contact_shape)
            for body, link, color in zip(bodies, hand.links, colors, strict=True)
        ]
        _filter_collisions(plant, hand, ids)
    q_full = hand.q_full(hand.q_rest)
    for k, joint in enumerate(hand.joints):
        parent, child = bodies[int(hand.parents[k + 1])], bodies[k + 1]
        _add_joint(plant, joint, parent, child, instance, float(q_full[k]), pd_gains)
    for joint in hand.joints:
        if joint.coupling is not None:
            plant.AddCouplerConstraint(
                plant.GetJointByName(joint.name, instance),
                plant.GetJointByName(joint.coupling.master, instance),
                joint.coupling.multiplier,
                joint.coupling.offset,
            )
    return instance


def drake_shape(shape: Geometry, name: str) -> tuple[Shape, RigidTransform]:
    """A primitive as a Drake shape.

    Args:
        shape: The primitive, in L.
        name: Label of a convex hull in Drake's messages.

    Returns:
        The shape in its own frame G, and X_LG.
    """
    if isinstance(shape, Sphere):
        return DrakeSphere(shape.radius), RigidTransform(shape.center)
    if isinstance(shape, Box):
        return DrakeBox(*shape.size), RigidTransform(RotationMatrix(shape.R_LG), shape.p_LG)
    if isinstance(shape, Capsule):
        d = shape.p1 - shape.p0
        length = float(np.linalg.norm(d))
        if length < 1e-9:
            return DrakeSphere(shape.radius), RigidTransform(shape.p0)
        X_LG = RigidTransform(RotationMatrix.MakeFromOneVector(d / length, 2), 0.5 * (shape.p0 + shape.p1))
        return DrakeCapsule(shape.radius, length), X_LG
    return DrakeConvex(shape.vertices.T, name), RigidTransform()


def contact_shape(shape: Geometry, name: str) -> tuple[Shape, RigidTransform]:
    """The shape that a primitive has in contact: round ones become polyhedra with facets of `FACET_RAD`.

    Drake finds the normal of point contact with a convex mesh by minkowski portal refinement, and where the boundary
    of the Minkowski sum is curved, a sphere or a capsule on an edge or a corner of the mesh, it returns the direction
    between the centers of the two shapes instead: wrong by 17 degrees in the median and by up to 59 on the rim of a
    disk. Where both have facets the normal is that of a facet: wrong by less than 2 degrees in the median.

    Args:
        shape: The primitive, in L.
        name: Label of a convex hull in Drake's messages.

    Returns:
        The shape in its own frame G, and X_LG.
    """
    smooth, X_LG = drake_shape(shape, name)
    if not isinstance(smooth, DrakeSphere | DrakeCapsule):
        return smooth, X_LG
    length = smooth.length() if isinstance(smooth, DrakeCapsule) else 0.0
    # Half of the facets' sag outward, so that the polyhedron is as often too large as too small.
    half = (1.0 + FACET_RAD**2 / 16.0) * smooth.radius() * _half_sphere() + np.array([0.0, 0.0, 0.5 * length])
    return DrakeConvex(np.vstack([half, -half]).T, name), X_LG


@lru_cache(maxsize=1)
def _half_sphere() -> Array:
    """Points of the unit half sphere z >= 0 on rings about z, `FACET_RAD` apart, shape (n, 3)."""
    rings = []
    for latitude in np.linspace(0.0, 0.5 * np.pi, round(0.5 * np.pi / FACET_RAD) + 1):
        count = max(1, round(2.0 * np.pi * np.cos(latitude) / FACET_RAD))
        angle = 2.0 * np.pi * np.arange(count) / count
        ring = [np.cos(latitude) * np.cos(angle), np.cos(latitude) * np.sin(angle), np.full(count, np.sin(latitude))]
        rings.append(np.column_stack(ring))
    return np.vstack(rings)


def _spatial_inertia(link: Link) -> SpatialInertia:
    I = link.I_LLcm  # noqa: E741
    inertia = RotationalInertia(I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
    return SpatialInertia.MakeFromCentralInertia(link.mass, link.p_LLcm, inertia)


def _proximity_properties(friction: float, point_stiffness: float | None) -> ProximityProperties:
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=None if point_stiffness is None else DISSIPATION,
        point_stiffness=point_stiffness,
        friction=CoulombFriction(friction, friction),
        properties=properties,
    )
    return properties


def _add_geometry(
    plant: MultibodyPlant,
    body: RigidBody,
    link: Link,
    color: Array,
    properties: ProximityProperties,
    shape_of: ShapeOf,
) -> list[GeometryId]:
    ids = []
    for k, primitive in enumerate(link.geometry):
        name = f"{link.name}_{k}"
        touching, X_LC = shape_of(primitive, name)
        ids.append(plant.RegisterCollisionGeometry(body, X_LC, touching, name, properties))
        shape, X_LG = drake_shape(primitive, name)
        plant.RegisterVisualGeometry(body, X_LG, shape, name, color)
    return ids


def _filter_collisions(plant: MultibodyPlant, hand: Hand, ids: list[list[GeometryId]]) -> None:
    # The plant does not hand out its scene graph in Python; a parser made for the plant does.
    manager = Parser(plant).scene_graph().collision_filter_manager()
    declaration = CollisionFilterDeclaration()
    for i, j in ignored_pairs(hand):
        declaration.ExcludeBetween(GeometrySet(ids[i]), GeometrySet(ids[j]))
    manager.Apply(declaration)


def _add_joint(
    plant: MultibodyPlant,
    joint: Joint,
    parent: RigidBody,
    child: RigidBody,
    instance: ModelInstanceIndex,
    start: float,
    pd_gains: tuple[float, float] | None,
) -> None:
    X_PJ = RigidTransform(RotationMatrix(joint.R_PJ), joint.p_PJ)
    frame = plant.AddFrame(FixedOffsetFrame(f"{joint.name}_origin", parent.body_frame(), X_PJ, instance))
    if joint.kind == "revolute":
        drake_joint = RevoluteJoint(
            joint.name, frame, child.body_frame(), joint.axis, joint.lower, joint.upper, JOINT_DAMPING
        )
    else:
        drake_joint = PrismaticJoint(
            joint.name, frame, child.body_frame(), joint.axis, joint.lower, joint.upper, JOINT_DAMPING
        )
    drake_joint.set_default_positions(np.array([start]))
    added = plant.AddJoint(drake_joint)
    if joint.coupling is None:
        actuator = plant.AddJointActuator(joint.name, added, joint.effort)
        if pd_gains is not None:
            actuator.set_controller_gains(PdControllerGains(p=pd_gains[0], d=pd_gains[1]))
