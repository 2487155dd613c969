"""Lifts a grasped object in Drake and says why it failed where it failed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import GeometryId, SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from xdex_drake.arrays import Array
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.description import Hand
from xdex_drake.scene.plant import ScenePlant, build_plant, simulator_of
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import AnyProtocol, LiftProtocol, protocol_scene, usual_protocol
from xdex_drake.simulation.pushes import play
from xdex_drake.simulation.shared import shared
from xdex_drake.simulation.trajectory import retreat, squeezed, targets
from xdex_drake.simulation.verdict import Touch, play_lift


@dataclass(frozen=True)
class LiftRig:
    """The plant of one hand and one scene, ready to lift any number of grasps.

    Attributes:
        protocol: The protocol.
        scene_plant: Hand on its carriage, object and table.
        simulator: Simulator of `scene_plant.diagram`.
        hand_source: Plays the joints' targets and their rates; see `_trajectory`.
        carriage_source: The same of the carriage.
    """

    protocol: LiftProtocol
    scene_plant: ScenePlant
    simulator: Simulator
    hand_source: TrajectorySource
    carriage_source: TrajectorySource

    @property
    def hand(self) -> Hand:
        """The hand."""
        return self.scene_plant.hand

    @property
    def scene(self) -> Scene:
        """The object on its table, with the protocol's mass and friction."""
        assert self.scene_plant.scene is not None
        return self.scene_plant.scene

    @property
    def _plant_context(self) -> Context:
        return self.scene_plant.plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())

    def start(self, grasp: Grasp) -> None:
        """Puts hand and object at the begin of a lift, time zero, and takes up the lift's targets.

        Args:
            grasp: A grasp with pre-grasp and squeeze targets.
        """
        scene_plant = self.scene_plant
        # Only the plant has a state. To set the whole diagram to its defaults would copy all geometry, which takes a
        # tenth of the lift.
        scene_plant.plant.SetDefaultContext(self._plant_context)
        self.simulator.get_mutable_context().SetTime(0.0)
        _play_targets(self, grasp)
        # The mount stands at the grasp; the pre-grasp is an offset of the carriage.
        scene_plant.set_wrist(self._plant_context, grasp.X_WH)
        q, offset = targets(grasp, self.protocol, 0.0)
        scene_plant.set_joints(self._plant_context, q)
        for joint, value in zip(scene_plant.carriage, offset, strict=True):
            joint.set_translation(self._plant_context, value)
        scene_plant.set_object(self._plant_context, grasp.X_WO)
        if self.protocol.release:
            assert scene_plant.object_body is not None
            scene_plant.object_body.Lock(self._plant_context)

    def release(self) -> None:
        """Lets the object go that the protocol kept in place."""
        assert self.scene_plant.object_body is not None
        self.scene_plant.object_body.Unlock(self._plant_context)

    def advance_to(self, t: float) -> None:
        """Simulates until a time [s]; a RuntimeError where Drake's solver gives up."""
        if self.simulator.get_context().get_time() == 0.0:
            self.simulator.Initialize()
        self.simulator.AdvanceTo(t)

    def touching_at_rest(self, depth: float = 0.0) -> Touch:
        """Contacts of the configuration as it stands and at least as deep as given [m], from geometry alone."""
        return _touching_at_rest(self.scene_plant, self._plant_context, depth)

    def touching(self) -> Touch:
        """Contacts of the last step."""
        return _touching(self.scene_plant, self._plant_context)

    def X_WO(self) -> RigidTransform:
        """Pose of the object."""
        assert self.scene_plant.object_body is not None
        return self.scene_plant.plant.EvalBodyPoseInWorld(self._plant_context, self.scene_plant.object_body)

    def X_WH(self) -> RigidTransform:
        """Pose of the wrist frame."""
        X_WB = self.scene_plant.plant.EvalBodyPoseInWorld(self._plant_context, self.scene_plant.links[0])
        return X_WB @ RigidTransform(RotationMatrix(self.hand.R_HB), self.hand.p_HB).inverse()

    def push(self, f_W: Array) -> None:
        """Applies a force at the object's center of mass from now on.

        Args:
            f_W: The force in W [N], shape (3,); zero ends it.
        """
        assert self.scene_plant.object_body is not None
        force = ExternallyAppliedSpatialForce()
        force.body_index = self.scene_plant.object_body.index()
        force.p_BoBq_B = self.scene.object.p_OOcm
        force.F_Bq_W = SpatialForce(np.zeros(3), f_W)
        port = self.scene_plant.plant.get_applied_spatial_force_input_port()
        port.FixValue(self._plant_context, [force] if np.any(f_W) else [])

    def state(self) -> tuple[float, Array]:
        """Time [s], and positions and velocities: all that the further simulation depends on."""
        t = self.simulator.get_context().get_time()
        return t, self.scene_plant.plant.GetPositionsAndVelocities(self._plant_context).copy()

    def restore(self, state: tuple[float, Array]) -> None:
        """Goes back to a state of the same lift."""
        self.simulator.get_mutable_context().SetTime(state[0])
        self.scene_plant.plant.SetPositionsAndVelocities(self._plant_context, state[1])
        self.simulator.Initialize()


def lift_rig(
    hand: Hand,
    scene: Scene,
    *,
    protocol: LiftProtocol | None = None,
    extend: Callable[[DiagramBuilder, MultibodyPlant, SceneGraph], None] | None = None,
) -> LiftRig:
    """Builds the plant of a lift.

    Args:
        hand: The hand.
        scene: The object on its table.
        protocol: The protocol; that of `usual_protocol` where None.
        extend: Called before the diagram is built, to add a visualizer.

    Returns:
        The rig; lifts on one rig do not influence each other.
    """
    protocol = protocol or usual_protocol(scene)
    scene = protocol_scene(scene, protocol)
    sources: list[TrajectorySource] = []

    def add_sources(builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
        # Played in C++: a call of Python for each step would cost a tenth of the lift.
        for instance in (plant.GetModelInstanceByName(hand.name), plant.GetModelInstanceByName("carriage")):
            size = 2 * plant.num_actuated_dofs(instance)
            source = TrajectorySource(PiecewisePolynomial(np.zeros((size, 1))))
            builder.AddSystem(source)
            builder.Connect(source.get_output_port(), plant.get_desired_state_input_port(instance))
            sources.append(source)
        if extend is not None:
            extend(builder, plant, scene_graph)

    scene_plant = build_plant(hand, scene, carriage=True, settings=protocol.plant, extend=add_sources)
    return LiftRig(protocol, scene_plant, simulator_of(scene_plant, protocol.plant), *sources)


def shared_rig(hand: Hand, scene: Scene, *, protocol: LiftProtocol | None = None) -> LiftRig:
    """The rig of a hand and a scene, built once and kept; verdicts are the same as on a new one, to the last bit.

    Args:
        hand: The hand.
        scene: The object on its table.
        protocol: The protocol; that of `usual_protocol` where None.

    Returns:
        A rig of this process; the last few are kept. Not for use by several threads.
    """
    protocol = protocol or usual_protocol(scene)
    return shared(lambda: lift_rig(hand, scene, protocol=protocol), "drake", hand, scene, protocol)


def _sort_touches(scene_plant: ScenePlant, pairs: Iterable[tuple[BodyIndex, BodyIndex]]) -> Touch:
    """Sorts pairs of bodies in contact by what the hand's links touch."""
    index_of = {body.index(): k for k, body in enumerate(scene_plant.links)}
    object_index = scene_plant.object_body.index() if scene_plant.object_body is not None else None
    world_index = scene_plant.plant.world_body().index()
    obstacle_indices = {body.index() for body in scene_plant.obstacles}
    on_object, on_table, on_obstacle = set(), set(), set()
    for pair in pairs:
        for one, other in (pair, pair[::-1]):
            if one in index_of:
                if other == object_index:
                    on_object.add(index_of[one])
                elif other == world_index:
                    on_table.add(index_of[one])
                elif other in obstacle_indices:
                    on_obstacle.add(index_of[one])
    return Touch(frozenset(on_object), frozenset(on_table), frozenset(on_obstacle))


def _touching(scene_plant: ScenePlant, context: Context) -> Touch:
    """Contacts of the last step of the simulation."""
    results: Any = scene_plant.plant.get_contact_results_output_port().Eval(context)
    infos = (results.point_pair_contact_info(k) for k in range(results.num_point_pair_contacts()))
    pairs = [(info.bodyA_index(), info.bodyB_index()) for info in infos]
    if results.num_hydroelastic_contacts():
        body_of = _body_of(scene_plant, context)
        surfaces = (
            results.hydroelastic_contact_info(k).contact_surface() for k in range(results.num_hydroelastic_contacts())
        )
        pairs += [(body_of(surface.id_M()), body_of(surface.id_N())) for surface in surfaces]
    return _sort_touches(scene_plant, pairs)


def _body_of(scene_plant: ScenePlant, context: Context) -> Callable[[GeometryId], BodyIndex]:
    """Finds the body of a geometry."""
    query: Any = scene_plant.plant.get_geometry_query_input_port().Eval(context)
    frame_of = query.inspector().GetFrameId

    def body(geometry: GeometryId) -> BodyIndex:
        found = scene_plant.plant.GetBodyFromFrameId(frame_of(geometry))
        assert found is not None
        return found.index()

    return body


def _touching_at_rest(scene_plant: ScenePlant, context: Context, depth: float = 0.0) -> Touch:
    """Contacts of the configuration as it stands and at least as deep as given, from geometry alone."""
    query: Any = scene_plant.plant.get_geometry_query_input_port().Eval(context)
    body = _body_of(scene_plant, context)
    pairs = (p for p in query.ComputePointPairPenetration() if p.depth >= depth)
    return _sort_touches(scene_plant, ((body(p.id_A), body(p.id_B)) for p in pairs))


def _play_targets(rig: LiftRig, grasp: Grasp) -> None:
    """Hands the targets of a lift to the sources of a rig."""
    assert grasp.q_pregrasp is not None
    protocol, step = rig.protocol, rig.protocol.plant.time_step
    spans = [protocol.close_s, protocol.squeeze_s, protocol.rise_s]
    # The controller is implicit: a step aims at the targets of its end, so that they are played one step early.
    early = step if protocol.plant.accuracy is None else 0.0
    breaks = np.concatenate([[0.0], np.cumsum(spans)]) - early
    q_squeezed = squeezed(grasp, protocol)
    q = np.column_stack([grasp.q_pregrasp, grasp.q, q_squeezed, q_squeezed])
    back, top = retreat(grasp), np.array([0.0, 0.0, protocol.rise_m])
    offset = np.column_stack([back, np.zeros(3), np.zeros(3), top])
    rig.hand_source.UpdateTrajectory(_trajectory(breaks, q, protocol.ramp))
    if protocol.shaking is None:
        rig.carriage_source.UpdateTrajectory(_trajectory(breaks, offset, protocol.ramp))
        return
    times = np.arange(0.0, sum(spans) + 2.0 * step, step)
    offset = np.column_stack([targets(grasp, protocol, t)[1] for t in times])
    rates = np.where(times < protocol.close_s, np.gradient(offset, step, axis=1), 0.0)
    samples = np.concatenate([offset, rates])
    rig.carriage_source.UpdateTrajectory(PiecewisePolynomial.FirstOrderHold(times - early, samples))


def _trajectory(breaks: Array, samples: Array, shape: str) -> PiecewisePolynomial:
    """Positions between samples, over their rates, which are those of the first span and then zero (`target_rates`)."""
    n = len(samples)
    still = np.zeros_like(samples[:, :2])
    rate = (samples[:, 1:2] - samples[:, :1]) / (breaks[1] - breaks[0])
    rest = np.concatenate([samples[:, 1:], np.zeros_like(samples[:, 1:])])
    if shape == "linear":
        closing = np.concatenate([samples[:, :2], np.tile(rate, 2)])
        first = PiecewisePolynomial.FirstOrderHold(breaks[:2], closing)
        first.ConcatenateInTime(PiecewisePolynomial.FirstOrderHold(breaks[1:], rest))
        return first
    # The rate of a smooth ramp is a parabola with slopes of 6 and -6 rates a span at its ends.
    bend = 6.0 * rate / (breaks[1] - breaks[0])
    closing, slopes = np.concatenate([samples[:, :2], still]), np.concatenate([still, np.hstack([bend, -bend])])
    first = PiecewisePolynomial.CubicHermite(breaks[:2], closing, slopes)
    first.ConcatenateInTime(PiecewisePolynomial.CubicHermite(breaks[1:], rest, np.zeros((2 * n, len(breaks) - 1))))
    return first


def simulate_lift(rig: LiftRig, grasp: Grasp) -> Lift:
    """Simulates one lift.

    Args:
        rig: The rig of the grasp's hand and scene.
        grasp: A grasp with pre-grasp and squeeze targets.

    Returns:
        Verdict, with the first failure reason of `FAILURE_REASONS` that matches where it failed.
    """
    return play_lift(rig, grasp)


def lift(grasp: Grasp, hand: Hand, scene: Scene, *, protocol: AnyProtocol | None = None) -> Lift:
    """Judges one grasp on the shared rig of its hand and scene; see `simulation.pushes.play`.

    Args:
        grasp: A grasp with pre-grasp and squeeze targets.
        hand: Its hand.
        scene: Its scene.
        protocol: The protocol: a lift, or pushes without weight; where None `LIFT`, or `RELEASE` in a scene without a
            table.

    Returns:
        The verdict.
    """
    protocol = protocol or usual_protocol(scene)
    return play(shared_rig(hand, scene, protocol=protocol.grip), grasp, protocol)
