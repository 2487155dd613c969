"""Grasps in a diagram of the user's own: put into a context, and played as the targets of joints and carriage."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Grasp
from xdex_drake.hand.description import Hand
from xdex_drake.scene.belonging import check_hand_of, check_liftable
from xdex_drake.simulation.protocol import LIFT, LiftProtocol
from xdex_drake.simulation.trajectory import target_rates, targets


def apply_grasp(
    grasp: Grasp,
    hand: Hand,
    plant: MultibodyPlant,
    context: Context,
    *,
    instance: ModelInstanceIndex | None = None,
    pregrasp: bool = False,
) -> None:
    """Puts a hand in a plant of one's own at a grasp: all joints, coupled ones included, and the base if it floats.

    Args:
        grasp: The grasp.
        hand: Its hand.
        plant: A finalized plant with the hand, as `add_hand` adds it.
        context: The plant's context.
        instance: Model instance of the hand; that of the hand's name where None.
        pregrasp: Whether to take the pre-grasp instead.

    Raises:
        ConfigError: The grasp is of another hand, the plant has no such hand, or there is no pre-grasp.
    """
    check_hand_of(grasp, hand)
    instance = _instance(plant, hand) if instance is None else instance
    X_WH, q = grasp.X_WH, grasp.q
    if pregrasp:
        check_liftable(grasp)
        assert grasp.X_WH_pregrasp is not None and grasp.q_pregrasp is not None
        X_WH, q = grasp.X_WH_pregrasp, grasp.q_pregrasp
    positions = plant.GetPositions(context).copy()
    for joint, value in zip(hand.joints, hand.q_full(q), strict=True):
        positions[plant.GetJointByName(joint.name, instance).position_start()] = value
    plant.SetPositions(context, positions)
    base = plant.GetBodyByName(hand.links[0].name, instance)
    if base.is_floating_base_body():
        plant.SetFreeBodyPose(context, base, X_WH @ hand.X_HB)


def _instance(plant: MultibodyPlant, hand: Hand) -> ModelInstanceIndex:
    """The model instance that has the hand's name."""
    if not plant.HasModelInstanceNamed(hand.name):
        raise ConfigError(f"the plant has no model instance {hand.name!r}; add the hand by add_hand(plant, hand)")
    return plant.GetModelInstanceByName(hand.name)


class GraspPlayer(LeafSystem):
    """Plays a grasp from its pre-grasp: close, squeeze, rise, hold.

    Output ports, each a vector of positions and then of velocities, for `plant.get_desired_state_input_port`:

    - `joints`: targets of the actuated joints. The squeeze's torques are in the targets, q + tau / kp, for the gain of
      the protocol's plant: give `add_hand` the same, `pd_gains=(kp, kd)`.
    - `wrist`: offset of the wrist from the grasp, along x, y and z of W, for the slides of `add_carriage`.
    """

    def __init__(self, grasp: Grasp, hand: Hand, *, protocol: LiftProtocol = LIFT, start_s: float = 0.0) -> None:
        """Takes up the targets of a grasp.

        Args:
            grasp: A grasp with pre-grasp and squeeze.
            hand: Its hand.
            protocol: How long each phase takes, how far the wrist rises, and the gain of the joints.
            start_s: Time at which the hand begins to close [s].

        Raises:
            ConfigError: The grasp is of another hand, or has no pre-grasp or squeeze.
        """
        super().__init__()
        check_hand_of(grasp, hand)
        check_liftable(grasp)
        self._grasp, self._protocol, self._start = grasp, protocol, start_s
        self.DeclareVectorOutputPort("joints", BasicVector(2 * len(grasp.q)), self._joints)
        self.DeclareVectorOutputPort("wrist", BasicVector(6), self._wrist)

    @property
    def end_s(self) -> float:
        """Time at which the last phase ends [s]."""
        return self._start + self._protocol.duration_s

    def X_WH(self, t: float) -> RigidTransform:
        """Where the wrist shall be at a time [s]; for arms that follow poses."""
        offset = targets(self._grasp, self._protocol, max(0.0, t - self._start))[1]
        return RigidTransform(self._grasp.X_WH.rotation(), self._grasp.X_WH.translation() + offset)

    def _joints(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.concatenate(self._at(context, 0)))

    def _wrist(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.concatenate(self._at(context, 1)))

    def _at(self, context: Context, which: int) -> tuple[np.ndarray, np.ndarray]:
        t = context.get_time() - self._start
        still = np.zeros_like(self._grasp.q) if which == 0 else np.zeros(3)
        rate = target_rates(self._grasp, self._protocol, t)[which] if t >= 0.0 else still
        return targets(self._grasp, self._protocol, max(0.0, t))[which], rate
