"""The one builder of the joint Drake plant of hand, object and table, which programs, viewers and simulation share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddRigidHydroelasticProperties,
    ProximityProperties,
    RoleAssign,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RigidBody,
    SpatialInertia,
    WeldJoint,
)
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.plant import add_hand
from xdex_drake.scene.bodies import add_fixture, add_object, add_table
from xdex_drake.scene.tabletop import Scene

RESOLUTION_M = 5e-3
"""Edge of the triangles of round hydroelastic surfaces [m]."""

CARRIAGE_MASS = 1.0
"""Mass of each of the three slides that carry the wrist, balls of `CARRIAGE_RADIUS` [kg]."""

CARRIAGE_RADIUS = 0.05


LONGEST_STEP = 0.02
"""Longest step of error-controlled integration [s]."""


@dataclass(frozen=True)
class PlantSettings:
    """Physics of the joint plant.

    Attributes:
        time_step: Length of a discrete step [s].
        friction: Coefficient of friction of hand and table; the object's own is in its model.
        point_stiffness: Stiffness of point contact [N/m].
        kp: Proportional gain of every finger joint [N m/rad].
        kd: Derivative gain of every finger joint [N m s/rad].
        carriage_kp: Proportional gain of the carriage that carries the wrist [N/m].
        carriage_kd: Derivative gain of the carriage [N s/m].
        hydroelastic_modulus: Modulus of the hand's surface [Pa] where hand and object touch hydroelastically, with the
            object rigid: patches of pressure instead of points, at several times the cost. None for point contact.
        accuracy: Accuracy of error-controlled integration by CENIC (Kurtz and Castro, 2025) in place of steps of fixed
            length, no step longer than `LONGEST_STEP`. None for fixed steps.
    """

    time_step: float = 0.005
    friction: float = 0.6
    point_stiffness: float = 1e5
    kp: float = 1.0
    kd: float = 0.1
    carriage_kp: float = 1e4
    carriage_kd: float = 6e2
    hydroelastic_modulus: float | None = None
    accuracy: float | None = None


@dataclass(frozen=True)
class ScenePlant:
    """A finalized plant with its diagram.

    Attributes:
        diagram: Diagram of plant and scene graph (and of what `extend` added).
        plant: The plant.
        scene_graph: The scene graph.
        hand: The hand.
        scene: The scene, None where the hand is alone.
        hand_instance: Model instance of the hand.
        links: The hand's bodies, in the order of `hand.links`.
        object_body: The object, None where the hand is alone.
        carriage: The three prismatic joints (x, y, z) that carry the wrist, empty where the hand floats.
        mount: Frame of the carriage to which the wrist is welded, None where the hand floats.
        obstacles: The scene's obstacles.
    """

    diagram: Diagram
    plant: MultibodyPlant
    scene_graph: SceneGraph
    hand: Hand
    scene: Scene | None
    hand_instance: ModelInstanceIndex
    links: tuple[RigidBody, ...]
    object_body: RigidBody | None
    carriage: tuple[PrismaticJoint, ...]
    mount: FixedOffsetFrame | None
    obstacles: tuple[RigidBody, ...] = ()

    def set_joints(self, context: Context, q: Array) -> None:
        """Sets the hand's joints, coupled ones included.

        Args:
            context: Context of the plant.
            q: Actuated joint values [rad or m], shape (n,).
        """
        positions = self.plant.GetPositions(context, self.hand_instance)
        q_full = self.hand.q_full(np.asarray(q, dtype=float))
        for joint, value in zip(self.hand.joints, q_full, strict=True):
            handle = self.plant.GetJointByName(joint.name, self.hand_instance)
            # Positions of the instance may start with those of a floating base.
            positions[handle.position_start() - self._first_position] = value
        self.plant.SetPositions(context, self.hand_instance, positions)

    @property
    def _first_position(self) -> int:
        base = self.links[0]
        starts = [self.plant.GetJointByName(j.name, self.hand_instance).position_start() for j in self.hand.joints]
        if base.is_floating_base_body():
            starts.append(base.floating_positions_start())
        return min(starts)

    def set_wrist(self, context: Context, X_WH: RigidTransform) -> None:
        """Puts the wrist frame at X_WH: by the floating base, or by the mount with the carriage at zero.

        Args:
            context: Context of the plant.
            X_WH: Pose of the wrist frame.
        """
        X_HB = RigidTransform(RotationMatrix(self.hand.R_HB), self.hand.p_HB)
        if self.mount is None:
            self.plant.SetFreeBodyPose(context, self.links[0], X_WH @ X_HB)
        else:
            self.mount.SetPoseInParentFrame(context, X_WH)
            for joint in self.carriage:
                joint.set_translation(context, 0.0)

    def set_object(self, context: Context, X_WO: RigidTransform) -> None:
        """Puts the object at X_WO."""
        assert self.object_body is not None
        self.plant.SetFreeBodyPose(context, self.object_body, X_WO)


def simulator_of(scene_plant: ScenePlant, settings: PlantSettings) -> Simulator:
    """A simulator of a plant.

    Args:
        scene_plant: The plant.
        settings: The physics that it was built with.

    Returns:
        The simulator, with error-controlled integration where the settings name an accuracy.
    """
    simulator = Simulator(scene_plant.diagram)
    if settings.accuracy is not None:
        config = SimulatorConfig(integration_scheme="cenic", accuracy=settings.accuracy, max_step_size=LONGEST_STEP)
        ApplySimulatorConfig(config, simulator)
    return simulator


def build_plant(
    hand: Hand,
    scene: Scene | None = None,
    *,
    carriage: bool = False,
    settings: PlantSettings | None = None,
    extend: Callable[[DiagramBuilder, MultibodyPlant, SceneGraph], None] | None = None,
) -> ScenePlant:
    """Builds hand, object and table into one plant.

    Args:
        hand: The hand.
        scene: The object on its table; None for the hand alone.
        carriage: Whether the wrist rides on three driven slides, as in a lift; otherwise it floats.
        settings: Physics; the defaults where None.
        extend: Called before the diagram is built, to add a visualizer or a camera.

    Returns:
        The finalized plant in its diagram.
    """
    settings = settings or PlantSettings()
    builder = DiagramBuilder()
    discrete = settings.accuracy is None
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=settings.time_step if discrete else 0.0)
    if discrete:
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    modulus = settings.hydroelastic_modulus
    plant.set_contact_model(ContactModel.kPoint if modulus is None else ContactModel.kHydroelasticWithFallback)
    instance = add_hand(
        plant,
        hand,
        friction=settings.friction,
        point_stiffness=settings.point_stiffness,
        pd_gains=(settings.kp, settings.kd),
    )
    links = tuple(plant.GetBodyByName(link.name, instance) for link in hand.links)
    slides, mount = (), None
    if carriage:
        slides, mount = add_carriage(plant, hand, instance, settings=settings)
    plant.set_gravity_enabled(instance, False)
    object_body, obstacles = None, ()
    if scene is not None:
        stiffness = settings.point_stiffness
        stands = scene.table is not None
        object_body = add_object(plant, scene.object, point_stiffness=stiffness, X_WO=scene.X_WO, stands=stands)
        obstacles = tuple(
            add_fixture(plant, fixture.object, fixture.X_WF, name=f"obstacle_{k}", point_stiffness=stiffness)
            for k, fixture in enumerate(scene.obstacles)
        )
        if scene.table is not None:
            add_table(plant, settings.friction, [object_body], height=scene.table, point_stiffness=stiffness)
        if modulus is not None:
            _make_hydroelastic(plant, scene_graph, links, object_body, modulus)
    plant.Finalize()
    if extend is not None:
        extend(builder, plant, scene_graph)
    return ScenePlant(
        builder.Build(),
        plant,
        scene_graph,
        hand,
        scene,
        instance,
        links,
        object_body,
        slides,
        mount,
        obstacles,
    )


def add_carriage(
    plant: MultibodyPlant,
    hand: Hand,
    instance: ModelInstanceIndex,
    *,
    X_WH: RigidTransform | None = None,
    settings: PlantSettings | None = None,
) -> tuple[tuple[PrismaticJoint, ...], FixedOffsetFrame]:
    """Puts a hand's wrist on three driven slides along x, y and z of W, the stand-in for a robot's arm.

    Args:
        plant: Plant, not finalised, with the hand.
        hand: The hand.
        instance: Its model instance.
        X_WH: Pose of the wrist frame while the slides are at zero; the mount's pose in a context may be set anew.
        settings: Gains; the defaults where None.

    Returns:
        The slides, of a model instance named `carriage`, and the frame that carries the wrist.
    """
    settings = settings or PlantSettings()
    carriage_instance = plant.AddModelInstance("carriage")
    inertia = SpatialInertia.SolidSphereWithMass(CARRIAGE_MASS, CARRIAGE_RADIUS)
    slides: list[PrismaticJoint] = []
    parent = plant.world_body()
    for name, axis in zip("xyz", np.eye(3), strict=True):
        body = plant.AddRigidBody(f"carriage_{name}", carriage_instance, inertia)
        slide = PrismaticJoint(f"carriage_{name}", parent.body_frame(), body.body_frame(), axis, damping=0.0)
        joint = cast(PrismaticJoint, plant.AddJoint(slide))
        actuator = plant.AddJointActuator(f"carriage_{name}", joint)
        actuator.set_controller_gains(PdControllerGains(p=settings.carriage_kp, d=settings.carriage_kd))
        slides.append(joint)
        parent = body
    offset = FixedOffsetFrame("mount", parent.body_frame(), X_WH or RigidTransform())
    mount = cast(FixedOffsetFrame, plant.AddFrame(offset))
    base = plant.GetBodyByName(hand.links[0].name, instance)
    X_HB = RigidTransform(RotationMatrix(hand.R_HB), hand.p_HB)
    plant.AddJoint(WeldJoint("wrist", mount, base.body_frame(), X_HB))
    plant.set_gravity_enabled(carriage_instance, False)
    return tuple(slides), mount


def _make_hydroelastic(
    plant: MultibodyPlant, scene_graph: SceneGraph, links: Sequence[RigidBody], object_body: RigidBody, modulus: float
) -> None:
    """Gives the hand a compliant surface and the object's parts a rigid one; feet and table keep point contact."""
    inspector, source = scene_graph.model_inspector(), plant.get_source_id()
    assert source is not None
    for body in (*links, object_body):
        for geometry in plant.GetCollisionGeometriesForBody(body):
            if "_foot_" in inspector.GetName(geometry):
                continue
            properties = ProximityProperties(inspector.GetProximityProperties(geometry))
            if body is object_body:
                AddRigidHydroelasticProperties(RESOLUTION_M, properties)
            else:
                AddCompliantHydroelasticProperties(RESOLUTION_M, modulus, properties)
            scene_graph.AssignRole(source, geometry, properties, RoleAssign.kReplace)
