"""A grasp as a robot plays it: where the base link and the joints are to be, when, and with which torques."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Grasp
from xdex_drake.grasping.approach import straight_approach
from xdex_drake.hand.description import Hand
from xdex_drake.hand.yaml_file import hand_digest
from xdex_drake.interchange.records import seven
from xdex_drake.scene.belonging import check_belonging
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import LIFT, LiftProtocol

APPROACH_SPEED = 0.1
"""Speed of the wrist on its way to the pre-grasp [m/s]."""

APPROACH_LENGTH = 0.1
"""Length of that way [m]."""


def execution_package(grasp: Grasp, hand: Hand, scene: Scene, *, protocol: LiftProtocol = LIFT) -> dict[str, Any]:
    """Everything that it takes to play a grasp, in plain numbers and names.

    Waypoints are `approach` (left out where no straight way is clear), `pregrasp`, `grasp`, `squeeze` and `lift`, with
    the times of a protocol's lift. Each has the pose of the base link in the world and in the object's frame, positions
    of the actuated joints, and feed-forward torques beside them: joints are driven by
    kp (position - q) - kd dq/dt + torque within their efforts.

    Args:
        grasp: A grasp with pre-grasp and squeeze.
        hand: Its hand.
        scene: Its scene.
        protocol: The protocol whose times and gains hold.

    Returns:
        What JSON can hold. SI units, radians; poses are x, y, z, qw, qx, qy, qz.

    Raises:
        ConfigError: Grasp, hand and scene do not belong together, or the grasp has no pre-grasp or squeeze.
    """
    check_belonging(grasp, hand, scene)
    if grasp.q_pregrasp is None or grasp.X_WH_pregrasp is None or grasp.tau_squeeze is None:
        raise ConfigError(f"grasp {grasp.grasp_id}: it has no pre-grasp or squeeze to play; make it with `xdex grasp`")
    X_HB = RigidTransform(RotationMatrix(hand.R_HB), hand.p_HB)
    X_OW, still = scene.X_WO.inverse(), np.zeros(len(hand.joint_names))

    def waypoint(name: str, t: float, X_WH: RigidTransform, q: Array, tau: Array) -> dict[str, Any]:
        X_WB = X_WH @ X_HB
        return {
            "name": name,
            "time_s": round(t, 6),
            "X_WB": seven(X_WB).tolist(),
            "X_OB": seven(X_OW @ X_WB).tolist(),
            "position": q.tolist(),
            "torque": tau.tolist(),
        }

    waypoints, t = [], 0.0
    way = straight_approach(hand, scene, grasp.X_WH_pregrasp, grasp.q_pregrasp, length=APPROACH_LENGTH)
    if way is not None:
        back = RigidTransform(APPROACH_LENGTH * way.direction_W) @ grasp.X_WH_pregrasp
        waypoints.append(waypoint("approach", t, back, grasp.q_pregrasp, still))
        t += APPROACH_LENGTH / APPROACH_SPEED
    waypoints.append(waypoint("pregrasp", t, grasp.X_WH_pregrasp, grasp.q_pregrasp, still))
    waypoints.append(waypoint("grasp", t := t + protocol.close_s, grasp.X_WH, grasp.q, still))
    waypoints.append(waypoint("squeeze", t := t + protocol.squeeze_s, grasp.X_WH, grasp.q, grasp.tau_squeeze))
    top = RigidTransform(np.array([0.0, 0.0, protocol.rise_m])) @ grasp.X_WH
    waypoints.append(waypoint("lift", t + protocol.rise_s, top, grasp.q, grasp.tau_squeeze))
    model = scene.object
    return {
        "grasp_id": grasp.grasp_id,
        "hand": {
            "name": hand.name,
            "digest": hand_digest(hand),
            "side": hand.side,
            "base_link": hand.links[0].name,
            "joint_names": list(hand.joint_names),
            "effort": hand.effort.tolist(),
            "kp": protocol.plant.kp,
            "kd": protocol.plant.kd,
        },
        "object": {
            "name": model.name,
            "digest": model.digest,
            "scale": model.scale,
            "mass_kg": model.mass,
            "friction": model.friction,
            "X_WO": seven(scene.X_WO).tolist(),
        },
        "protocol": protocol.name,
        "waypoints": waypoints,
    }
