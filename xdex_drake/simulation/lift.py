"""Lifts a grasped object in Drake and says why it failed where it failed."""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from pydrake.geometry import GeometryId, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from xdex_drake.grasp import Array, Grasp, Lift
from xdex_drake.hand.description import Hand
from xdex_drake.hand.yaml_file import hand_digest
from xdex_drake.scene.plant import ScenePlant, build_plant
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LIFT, LiftProtocol, protocol_scene

_log = logging.getLogger(__name__)

FAILURE_REASONS = (
    "simulation_failed",
    "timeout",
    "pregrasp_in_contact",
    "table_collision",
    "not_grasped",
    "slipped",
    "turned",
    "too_few_fingertips",
)


CHECK_STEPS = 20
"""Steps of the simulation between two looks at it."""

RIGS = 4
"""How many rigs `shared_rig` keeps; one takes a few megabytes."""


@dataclass(frozen=True)
class LiftRig:
    """The plant of one hand and one scene, ready to lift any number of grasps.

    Attributes:
        protocol: The protocol.
        bench: Hand on its carriage, object and table.
        simulator: Simulator of `bench.diagram`.
        hand_source: Plays the joints' targets and their rates; see `_trajectory`.
        carriage_source: The same of the carriage.
    """

    protocol: LiftProtocol
    bench: ScenePlant
    simulator: Simulator
    hand_source: TrajectorySource
    carriage_source: TrajectorySource


def lift_rig(
    hand: Hand,
    scene: Scene,
    *,
    protocol: LiftProtocol = LIFT,
    extend: Callable[[DiagramBuilder, MultibodyPlant, SceneGraph], None] | None = None,
) -> LiftRig:
    """Builds the plant of a lift.

    Args:
        hand: The hand.
        scene: The object on its table.
        protocol: The protocol.
        extend: Called before the diagram is built, to add a visualizer.

    Returns:
        The rig; lifts on one rig do not influence each other.
    """
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

    bench = build_plant(hand, scene, carriage=True, settings=protocol.plant, extend=add_sources)
    return LiftRig(protocol, bench, Simulator(bench.diagram), *sources)


_rigs: OrderedDict[tuple[str, str, float, float, bytes, LiftProtocol], LiftRig] = OrderedDict()


@lru_cache(maxsize=RIGS)
def _digest_by_identity(identity: _Identity) -> str:
    return hand_digest(identity.hand)


@dataclass(frozen=True, eq=False)
class _Identity:
    """A hand that is compared by identity: its digest takes as long as a tenth of a lift."""

    hand: Hand

    def __hash__(self) -> int:
        return id(self.hand)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Identity) and other.hand is self.hand


def _digest(hand: Hand) -> str:
    return _digest_by_identity(_Identity(hand))


def shared_rig(hand: Hand, scene: Scene, *, protocol: LiftProtocol = LIFT) -> LiftRig:
    """The rig of a hand and a scene, built once and kept; verdicts are the same as on a new one, to the last bit.

    Args:
        hand: The hand.
        scene: The object on its table.
        protocol: The protocol.

    Returns:
        A rig of this process; at most `RIGS` are kept, those that were used last. Not for use by several threads.
    """
    model = scene.object
    key = (_digest(hand), model.digest, model.mass, model.friction, scene.X_WO.GetAsMatrix34().tobytes(), protocol)
    rig = _rigs.pop(key, None) or lift_rig(hand, scene, protocol=protocol)
    _rigs[key] = rig
    while len(_rigs) > RIGS:
        _rigs.popitem(last=False)
    return rig


@dataclass(frozen=True)
class _Touch:
    """Which links touch the object, and the table, at one moment."""

    object_links: frozenset[int]
    table_links: frozenset[int]


def _sort_touches(bench: ScenePlant, pairs: Iterable[tuple[BodyIndex, BodyIndex]]) -> _Touch:
    """Sorts pairs of bodies in contact by what the hand's links touch."""
    index_of = {body.index(): k for k, body in enumerate(bench.links)}
    object_index = bench.object_body.index() if bench.object_body is not None else None
    world_index = bench.plant.world_body().index()
    on_object, on_table = set(), set()
    for pair in pairs:
        for one, other in (pair, pair[::-1]):
            if one in index_of:
                if other == object_index:
                    on_object.add(index_of[one])
                elif other == world_index:
                    on_table.add(index_of[one])
    return _Touch(frozenset(on_object), frozenset(on_table))


def _touching(bench: ScenePlant, context: Context) -> _Touch:
    """Contacts of the last step of the simulation."""
    results: Any = bench.plant.get_contact_results_output_port().Eval(context)
    infos = (results.point_pair_contact_info(k) for k in range(results.num_point_pair_contacts()))
    pairs = [(info.bodyA_index(), info.bodyB_index()) for info in infos]
    if results.num_hydroelastic_contacts():
        body_of = _body_of(bench, context)
        surfaces = (
            results.hydroelastic_contact_info(k).contact_surface() for k in range(results.num_hydroelastic_contacts())
        )
        pairs += [(body_of(surface.id_M()), body_of(surface.id_N())) for surface in surfaces]
    return _sort_touches(bench, pairs)


def _body_of(bench: ScenePlant, context: Context) -> Callable[[GeometryId], BodyIndex]:
    """Finds the body of a geometry."""
    query: Any = bench.plant.get_geometry_query_input_port().Eval(context)
    frame_of = query.inspector().GetFrameId

    def body(geometry: GeometryId) -> BodyIndex:
        found = bench.plant.GetBodyFromFrameId(frame_of(geometry))
        assert found is not None
        return found.index()

    return body


def _touching_at_rest(bench: ScenePlant, context: Context, depth: float = 0.0) -> _Touch:
    """Contacts of the configuration as it stands and at least as deep as given, from geometry alone."""
    query: Any = bench.plant.get_geometry_query_input_port().Eval(context)
    body = _body_of(bench, context)
    pairs = (p for p in query.ComputePointPairPenetration() if p.depth >= depth)
    return _sort_touches(bench, ((body(p.id_A), body(p.id_B)) for p in pairs))


def _ramp(s: float, shape: str) -> float:
    """Ramp from 0 to 1; a smooth one has zero velocity at both ends."""
    s = min(max(s, 0.0), 1.0)
    return s if shape == "linear" else s * s * (3.0 - 2.0 * s)


def targets(grasp: Grasp, protocol: LiftProtocol, t: float) -> tuple[Array, Array]:
    """Joint targets and carriage offset at a time of the lift.

    Args:
        grasp: A grasp with pre-grasp and squeeze.
        protocol: The protocol.
        t: Time [s].

    Returns:
        q_target [rad or m], shape (n,), and the carriage's offset from the grasp's wrist position [m], shape (3,).
    """
    assert grasp.q_pregrasp is not None and grasp.X_WH_pregrasp is not None
    close = _ramp(t / protocol.close_s, protocol.ramp)
    squeeze = _ramp((t - protocol.close_s) / protocol.squeeze_s, protocol.ramp)
    rising_s = t - protocol.close_s - protocol.squeeze_s
    rise = _ramp(rising_s / protocol.rise_s, protocol.ramp)
    q = grasp.q_pregrasp + close * (grasp.q - grasp.q_pregrasp) + squeeze * (_squeezed(grasp, protocol) - grasp.q)
    back = grasp.X_WH_pregrasp.translation() - grasp.X_WH.translation()
    return q, (1.0 - close) * back + np.array([0.0, 0.0, rise * protocol.rise_m]) + _shake(protocol, rising_s)


def _squeezed(grasp: Grasp, protocol: LiftProtocol) -> Array:
    """Squeeze targets for the gain of the protocol."""
    assert grasp.q_squeeze is not None
    if protocol.plant.kp == protocol.squeeze_kp:
        return grasp.q_squeeze
    return grasp.q + (grasp.q_squeeze - grasp.q) * (protocol.squeeze_kp / protocol.plant.kp)


def _shake(protocol: LiftProtocol, rising_s: float) -> Array:
    """Offset of the shaking a while after the begin of the rise."""
    shaking = protocol.shaking
    if shaking is None or not shaking.after_s <= rising_s <= protocol.rise_s:
        return np.zeros(3)
    angle = np.array(shaking.rate) * (shaking.clock_s + rising_s) + np.array(shaking.phase)
    return shaking.amplitude_m * np.sin(angle)


def _play_targets(rig: LiftRig, grasp: Grasp) -> None:
    """Hands the targets of a lift to the sources of a rig."""
    assert grasp.q_pregrasp is not None and grasp.X_WH_pregrasp is not None
    protocol, step = rig.protocol, rig.protocol.plant.time_step
    spans = [protocol.close_s, protocol.squeeze_s, protocol.rise_s]
    # The controller is implicit: a step aims at the targets of its end, so that they are played one step early.
    breaks = np.concatenate([[0.0], np.cumsum(spans)]) - step
    squeezed = _squeezed(grasp, protocol)
    q = np.column_stack([grasp.q_pregrasp, grasp.q, squeezed, squeezed])
    back, top = grasp.X_WH_pregrasp.translation() - grasp.X_WH.translation(), np.array([0.0, 0.0, protocol.rise_m])
    offset = np.column_stack([back, np.zeros(3), np.zeros(3), top])
    rig.hand_source.UpdateTrajectory(_trajectory(breaks, q, protocol.ramp))
    if protocol.shaking is None:
        rig.carriage_source.UpdateTrajectory(_trajectory(breaks, offset, protocol.ramp))
        return
    times = np.arange(0.0, sum(spans) + 2.0 * step, step)
    offset = np.column_stack([targets(grasp, protocol, t)[1] for t in times])
    rates = np.where(times < protocol.close_s, np.gradient(offset, step, axis=1), 0.0)
    samples = np.concatenate([offset, rates])
    rig.carriage_source.UpdateTrajectory(PiecewisePolynomial.FirstOrderHold(times - step, samples))


def _trajectory(breaks: Array, samples: Array, shape: str) -> PiecewisePolynomial:
    """Positions between samples, over their rates, which are those of the first span and then zero.

    Targets whose rate is said to be zero are followed with a lag of kd / kp, 0.1 s. Closing so, fingers arrive one
    after the other while they squeeze already, stick where they touch first, and press with other forces than the
    certificate's. From the squeeze on targets are forces by way of the springs, not motions.
    """
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
    protocol, bench, simulator = rig.protocol, rig.bench, rig.simulator
    # The limit is on time of the processor, so that a busy machine does not change a verdict.
    start, cpu_start = time.perf_counter(), time.process_time()
    context = simulator.get_mutable_context()
    bench.diagram.SetDefaultContext(context)
    context.SetTime(0.0)
    plant = bench.plant
    plant_context = plant.GetMyMutableContextFromRoot(context)
    _play_targets(rig, grasp)
    # The mount stands at the grasp; the pre-grasp is an offset of the carriage.
    bench.set_wrist(plant_context, grasp.X_WH)
    q, offset = targets(grasp, protocol, 0.0)
    bench.set_joints(plant_context, q)
    for joint, value in zip(bench.carriage, offset, strict=True):
        joint.set_translation(plant_context, value)
    bench.set_object(plant_context, grasp.X_WO)
    assert bench.object_body is not None and bench.scene is not None
    body, p_OOcm = bench.object_body, bench.scene.object.p_OOcm

    def center_height() -> float:
        X_WO = plant.EvalBodyPoseInWorld(plant_context, body)
        return float((X_WO @ p_OOcm)[2])

    def result(reason: str, height: float, tips: tuple[str, ...]) -> Lift:
        return Lift(protocol.name, reason == "", reason, height, tips, time.perf_counter() - start)

    z0 = center_height()
    begin = _touching_at_rest(bench, plant_context)
    if begin.object_links and _touching_at_rest(bench, plant_context, protocol.start_depth_m).object_links:
        return result("pregrasp_in_contact", 0.0, ())
    if begin.table_links:
        return result("table_collision", 0.0, ())
    step = protocol.plant.time_step
    squeezed = round((protocol.close_s + protocol.squeeze_s) / step)
    # Nothing that is left behind by half the rise comes up again.
    decided = squeezed + round(0.6 * protocol.rise_s / step)
    total = round(protocol.duration_s / step)
    after_squeeze = _Touch(frozenset(), frozenset())
    hit_table = False
    try:
        simulator.Initialize()
        for k in sorted({*range(CHECK_STEPS, total, CHECK_STEPS), squeezed, decided, total}):
            simulator.AdvanceTo(k * step)
            if time.process_time() - cpu_start > protocol.cpu_limit_s:
                return result("timeout", center_height() - z0, ())
            if k <= squeezed:
                after_squeeze = _touching(bench, plant_context)
                hit_table = hit_table or bool(after_squeeze.table_links)
            if k >= decided and center_height() - z0 < 0.1 * protocol.rise_m:
                break
    except RuntimeError as error:
        _log.info("lift of %s %s: %s", grasp.hand, grasp.grasp_id, error)
        return result("simulation_failed", float("nan"), ())
    rise = center_height() - z0
    if not np.isfinite(rise):
        return result("simulation_failed", float("nan"), ())
    end = _touching(bench, plant_context)
    slipped, turned = rise < protocol.success_m, False
    if protocol.max_height_error_m is not None:
        slipped = slipped or abs(rise - protocol.rise_m) >= protocol.max_height_error_m
    X_WO = plant.EvalBodyPoseInWorld(plant_context, body)
    if protocol.max_shift_m is not None:
        shift = X_WO.translation() - grasp.X_WO.translation() - np.array([0.0, 0.0, protocol.rise_m])
        slipped = slipped or float(np.linalg.norm(shift)) >= protocol.max_shift_m
    if protocol.max_turn_rad is not None:
        turn = (grasp.X_WO.rotation().inverse() @ X_WO.rotation()).ToAngleAxis().angle()
        turned = abs(turn) >= protocol.max_turn_rad
    hand = bench.hand
    tips = tuple(f.name for f in hand.fingers if hand.link_index[f.tip_link] in end.object_links)
    if not slipped and not turned and len(tips) >= protocol.fingertips:
        return result("", rise, tips)
    if hit_table:
        return result("table_collision", rise, tips)
    if not after_squeeze.object_links:
        return result("not_grasped", rise, tips)
    if slipped:
        return result("slipped", rise, tips)
    if turned:
        return result("turned", rise, tips)
    return result("too_few_fingertips", rise, tips)


def lift(grasp: Grasp, hand: Hand, scene: Scene, *, protocol: LiftProtocol = LIFT) -> Lift:
    """Lifts one grasp on the shared rig of its hand and scene; see `simulate_lift`.

    Args:
        grasp: A grasp with pre-grasp and squeeze targets.
        hand: Its hand.
        scene: Its scene.
        protocol: The protocol.

    Returns:
        The verdict.
    """
    return simulate_lift(shared_rig(hand, scene, protocol=protocol), grasp)
