"""Where joints and wrist are sent during a lift, as functions of time; no simulator is needed."""

from __future__ import annotations

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.grasp import Grasp
from xdex_drake.simulation.protocol import LiftProtocol


def targets(grasp: Grasp, protocol: LiftProtocol, t: float) -> tuple[Array, Array]:
    """Joint targets and carriage offset at a time of the lift.

    Args:
        grasp: A grasp with pre-grasp and squeeze.
        protocol: The protocol.
        t: Time [s].

    Returns:
        q_target [rad or m], shape (n,), and the carriage's offset from the grasp's wrist position [m], shape (3,).
    """
    assert grasp.q_pregrasp is not None
    close = _ramp(t / protocol.close_s, protocol.ramp)
    squeeze = _ramp((t - protocol.close_s) / protocol.squeeze_s, protocol.ramp)
    rising_s = t - protocol.close_s - protocol.squeeze_s
    rise = _ramp(rising_s / protocol.rise_s, protocol.ramp)
    q = grasp.q_pregrasp + close * (grasp.q - grasp.q_pregrasp) + squeeze * (squeezed(grasp, protocol) - grasp.q)
    offset = (1.0 - close) * retreat(grasp) + np.array([0.0, 0.0, rise * protocol.rise_m])
    return q, offset + _shake(protocol, rising_s)


def target_rates(grasp: Grasp, protocol: LiftProtocol, t: float) -> tuple[Array, Array]:
    """Rates that the targets are said to have: their own while the hand closes, then zero.

    Targets whose rate is said to be zero are followed with a lag of kd / kp, 0.1 s. Closing so, fingers arrive one
    after the other while they squeeze already, stick where they touch first, and press with other forces than the
    certificate's. From the squeeze on targets are forces by way of the springs, not motions.

    Args:
        grasp: A grasp with pre-grasp and squeeze.
        protocol: The protocol.
        t: Time [s].

    Returns:
        Rate of the joint targets [rad/s or m/s], shape (n,), and of the carriage's offset [m/s], shape (3,).
    """
    assert grasp.q_pregrasp is not None
    rate = _ramp_rate(t / protocol.close_s, protocol.ramp) / protocol.close_s
    return rate * (grasp.q - grasp.q_pregrasp), -rate * retreat(grasp)


def retreat(grasp: Grasp) -> Array:
    """Way of the wrist from the grasp back to the pre-grasp, in W [m], shape (3,)."""
    assert grasp.X_WH_pregrasp is not None
    return grasp.X_WH_pregrasp.translation() - grasp.X_WH.translation()


def squeezed(grasp: Grasp, protocol: LiftProtocol) -> Array:
    """Targets q + tau / kp that squeeze by the springs alone [rad or m], shape (n,).

    They drive each joint by the same torque as targets q with a feed-forward tau: kp (q - q_now) + tau. So they may lie
    beyond the joint limits, where no joint ever gets.
    """
    assert grasp.tau_squeeze is not None
    return grasp.q + grasp.tau_squeeze / protocol.plant.kp


def _ramp(s: float, shape: str) -> float:
    """Ramp from 0 to 1; a smooth one has zero velocity at both ends."""
    s = min(max(s, 0.0), 1.0)
    return s if shape == "linear" else s * s * (3.0 - 2.0 * s)


def _ramp_rate(s: float, shape: str) -> float:
    """Derivative of the ramp."""
    if not 0.0 <= s < 1.0:
        return 0.0
    return 1.0 if shape == "linear" else 6.0 * s * (1.0 - s)


def _shake(protocol: LiftProtocol, rising_s: float) -> Array:
    """Offset of the shaking a while after the begin of the rise."""
    shaking = protocol.shaking
    if shaking is None or not shaking.after_s <= rising_s <= protocol.rise_s:
        return np.zeros(3)
    angle = np.array(shaking.rate) * (shaking.clock_s + rising_s) + np.array(shaking.phase)
    return shaking.amplitude_m * np.sin(angle)
