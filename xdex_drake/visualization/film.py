"""A lift as it was simulated, frame by frame: where everything was and how the hand pushed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults
from pydrake.systems.framework import Context, EventStatus

from xdex_drake.arrays import Array
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.description import Hand
from xdex_drake.scene.belonging import check_belonging, check_liftable
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.drake import LiftRig, lift_rig, simulate_lift
from xdex_drake.simulation.protocol import LiftProtocol, usual_protocol

FRAMES_PER_SECOND = 32.0
"""A power of two, whose multiples of the period are exact: no frame is rounded into its neighbour's place."""

REPLAY_CPU_LIMIT_S = 300.0
"""A recorded lift is never given up where the lift itself was not [s]."""

LEAST_FORCE = 0.02
"""Weaker forces are not recorded [N]."""


@dataclass(frozen=True, eq=False)
class Push:
    """A force of the hand at a contact.

    Attributes:
        link: Name of the link that pushes.
        p_WC: Where [m], shape (3,).
        f_W: Force on what is pushed [N], shape (3,).
    """

    link: str
    p_WC: Array
    f_W: Array


@dataclass(frozen=True, eq=False)
class Frame:
    """A moment of a lift.

    Attributes:
        X_WLs: Poses of the hand's links, in their order.
        X_WO: Pose of the object.
        pushes: Forces of the hand on object and table.
    """

    X_WLs: tuple[RigidTransform, ...]
    X_WO: RigidTransform
    pushes: tuple[Push, ...]


@dataclass(frozen=True, eq=False)
class Film:
    """A recorded lift.

    Attributes:
        grasp: The grasp.
        hand: Its hand.
        scene: Its scene.
        lift: What the simulation showed.
        frames: Moments at `FRAMES_PER_SECOND`; at least one.
    """

    grasp: Grasp
    hand: Hand
    scene: Scene
    lift: Lift
    frames: tuple[Frame, ...]

    @property
    def most_force(self) -> float:
        """The greatest force of all frames [N]; 0 where there is none."""
        return max((float(np.linalg.norm(p.f_W)) for frame in self.frames for p in frame.pushes), default=0.0)


def film_lift(grasp: Grasp, hand: Hand, scene: Scene, *, protocol: LiftProtocol | None = None) -> Film:
    """Simulates a lift and records it, failed ones too.

    Args:
        grasp: A grasp with pre-grasp and squeeze targets.
        hand: Its hand.
        scene: Its scene.
        protocol: The protocol; that of `usual_protocol` where None.

    Returns:
        The recorded lift.

    Raises:
        ConfigError: Grasp, hand and scene do not belong together, or the grasp has no pre-grasp or no squeeze.
    """
    check_belonging(grasp, hand, scene)
    check_liftable(grasp)
    protocol = protocol or usual_protocol(scene)
    patient = replace(protocol, cpu_limit_s=max(protocol.cpu_limit_s, REPLAY_CPU_LIMIT_S))
    rig = lift_rig(hand, scene, protocol=patient)
    context = rig.scene_plant.plant.GetMyContextFromRoot(rig.simulator.get_context())
    frames: list[Frame] = []

    def monitor(root: Context) -> EventStatus:
        if int(root.get_time() * FRAMES_PER_SECOND + 1e-6) >= len(frames):
            frames.append(_frame(rig, context))
        return EventStatus.DidNothing()

    rig.simulator.set_monitor(monitor)
    lift = simulate_lift(rig, grasp)
    rig.simulator.clear_monitor()
    # The end, which no step sees: where the lift fails before its first step it is the only frame.
    if lift.failure_reason != "simulation_failed" or not frames:
        frames.append(_frame(rig, context))
    return Film(grasp, hand, scene, lift, tuple(frames))


def _frame(rig: LiftRig, context: Context) -> Frame:
    plant, scene_plant = rig.scene_plant.plant, rig.scene_plant
    assert scene_plant.object_body is not None
    X_WLs = tuple(plant.EvalBodyPoseInWorld(context, body) for body in scene_plant.links)
    X_WO = plant.EvalBodyPoseInWorld(context, scene_plant.object_body)
    names = {body.index(): body.name() for body in scene_plant.links}
    results = cast(ContactResults, plant.get_contact_results_output_port().Eval(context))
    pushes = []
    for k in range(results.num_point_pair_contacts()):
        info = results.point_pair_contact_info(k)
        a, b, force = info.bodyA_index(), info.bodyB_index(), np.array(info.contact_force())
        if (a in names) == (b in names) or np.linalg.norm(force) < LEAST_FORCE:
            continue
        # The force that Drake reports acts on B.
        link, force = (names[a], force) if a in names else (names[b], -force)
        pushes.append(Push(link, np.array(info.contact_point()), force))
    return Frame(X_WLs, X_WO, tuple(pushes))
