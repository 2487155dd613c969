"""Minimal ground truth for the study of holds: a lift, 2 s more, then six pushes of m g from that state restored."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce

from xdex_drake.grasp import Grasp
from xdex_drake.simulation.lift import LiftRig, simulate_lift

SLIP_M, TURN_RAD = 0.02, np.deg2rad(15.0)
HOLD_S, RAMP_S, PUSH_S, LOOK_S = 2.0, 0.1, 0.5, 0.05
DIRECTIONS = np.kron(np.eye(3), [[1.0], [-1.0]])


@dataclass(frozen=True)
class Held:
    """What became of a grasp: `reason` is empty where it survived, else where it failed first."""

    lifted: bool
    rested: bool
    survived: bool
    reason: str
    slip_mm: float
    turn_deg: float
    slips_mm: tuple[float, ...]
    turns_deg: tuple[float, ...]
    rest_mm: float


def _track(rig: LiftRig):
    bench = rig.bench
    plant, body, p_OOcm = bench.plant, bench.object_body, bench.scene.object.p_OOcm
    context = plant.GetMyContextFromRoot(rig.simulator.get_context())

    def pose() -> tuple[np.ndarray, RigidTransform]:
        X_BO = plant.EvalBodyPoseInWorld(context, bench.links[0]).inverse() @ plant.EvalBodyPoseInWorld(context, body)
        return X_BO @ p_OOcm, X_BO

    return pose


def hold(rig: LiftRig, grasp: Grasp, *, all_pushes: bool = False) -> Held:
    """Lifts, holds, pushes; ends at the first violation unless `all_pushes`."""
    bench, simulator = rig.bench, rig.simulator
    plant = bench.plant
    pose, seen = _track(rig), []
    squeezed = rig.protocol.close_s + rig.protocol.squeeze_s
    port = plant.get_applied_spatial_force_input_port()
    nothing = Value[list[ExternallyAppliedSpatialForce]]([])
    port.FixValue(plant.GetMyMutableContextFromRoot(simulator.get_mutable_context()), nothing)

    def monitor(root):
        from pydrake.systems.framework import EventStatus

        if not seen and root.get_time() >= squeezed - 1e-9:
            seen.append(pose())
        return EventStatus.DidNothing()

    simulator.set_monitor(monitor)
    verdict = simulate_lift(rig, grasp)
    simulator.clear_monitor()
    worst = [0.0, 0.0]

    def away() -> tuple[float, float]:
        p, X = pose()
        p0, X0 = seen[0]
        turn = abs((X0.rotation().inverse() @ X.rotation()).ToAngleAxis().angle())
        return 1e3 * float(np.linalg.norm(p - p0)), float(np.rad2deg(turn))

    def run(until: float) -> bool:
        t = simulator.get_context().get_time()
        while t < until - 1e-9:
            t = min(t + LOOK_S, until)
            simulator.AdvanceTo(t)
            slip, turn = away()
            worst[0], worst[1] = max(worst[0], slip), max(worst[1], turn)
            if slip > 1e3 * SLIP_M or turn > np.rad2deg(TURN_RAD):
                return False
        return True

    if not verdict.success:
        return Held(False, False, False, verdict.failure_reason, np.nan, np.nan, (), (), np.nan)
    context = simulator.get_mutable_context()
    start = context.get_time()
    if not run(start + HOLD_S):
        return Held(True, False, False, "rest", *worst, (), (), worst[0])
    rest = worst[0]
    kept, t0 = context.Clone(), start + HOLD_S
    plant_context = plant.GetMyMutableContextFromRoot(context)
    model = bench.scene.object
    slips, turns, reason = [], [], ""
    for k, direction in enumerate(DIRECTIONS):
        context.SetTimeStateAndParametersFrom(kept)
        simulator.Initialize()
        worst[:] = [0.0, 0.0]
        ok, step = True, rig.protocol.plant.time_step
        for s in np.arange(step, RAMP_S + 1e-9, step):
            push = ExternallyAppliedSpatialForce()
            push.body_index = bench.object_body.index()
            push.p_BoBq_B = model.p_OOcm
            force = model.mass * 9.81 * min(1.0, s / RAMP_S) * direction
            push.F_Bq_W = SpatialForce(np.zeros(3), force)
            port.FixValue(plant_context, Value[list[ExternallyAppliedSpatialForce]]([push]))
            simulator.AdvanceTo(t0 + s)
        ok = run(t0 + PUSH_S)
        slips.append(worst[0])
        turns.append(worst[1])
        if not ok and not reason:
            reason = f"push{k}"
            if not all_pushes:
                break
    return Held(True, True, reason == "", reason, max(slips), max(turns), tuple(slips), tuple(turns), rest)


def with_torques(grasp: Grasp, torques: np.ndarray, kp: float) -> Grasp:
    """The grasp with another squeeze."""
    return replace(grasp, q_squeeze=grasp.q + torques / kp)
