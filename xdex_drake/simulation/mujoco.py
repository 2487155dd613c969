"""Lifts a grasped object in MuJoCo: the same protocol and the same rule as in Drake, on the exported MJCF scene.

A second simulator with another contact model tells which verdicts are the physics' and which are the simulator's.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.errors import MissingExtra
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.description import Hand
from xdex_drake.interchange.mjcf import MJCF, MjcfSettings, ModelFile, body_name, obstacle_name
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import AnyProtocol, LiftProtocol, protocol_scene, usual_protocol
from xdex_drake.simulation.pushes import play
from xdex_drake.simulation.scenes import lift_scene
from xdex_drake.simulation.shared import shared
from xdex_drake.simulation.trajectory import target_rates, targets
from xdex_drake.simulation.verdict import Touch, play_lift

MOUNT = 4
"""The body that carries the wrist frame: after the world and the carriage's slides; see `scene_mjcf`."""

CARRIAGE = slice(0, 3)
"""The carriage's joints and actuators."""


@dataclass(eq=False)
class MujocoRig:
    """A scene in MuJoCo, ready to lift any number of grasps.

    Attributes:
        protocol: The protocol.
        hand: The hand.
        scene: The object on its table, with the protocol's mass and friction.
        model: The model, an `mujoco.MjModel`.
        data: Its state, an `mujoco.MjData`.
        joint_addresses: Place of each of `hand.joints` among MuJoCo's joint values, shape (n_joints,).
        link_of: Index into `hand.links` of each body of the hand.
        obstacles: The bodies of the obstacles.
        grasp: The grasp whose lift is played.
        kept: Joint values at which the object is kept; None where it is free.
    """

    protocol: LiftProtocol
    hand: Hand
    scene: Scene
    model: Any
    data: Any
    joint_addresses: NDArray[np.int64] = field(repr=False)
    link_of: dict[int, int] = field(repr=False)
    obstacles: frozenset[int] = frozenset()
    grasp: Grasp | None = None
    kept: Array | None = None

    @property
    def base_body(self) -> int:
        """The body of the hand's base link."""
        return next(body for body, link in self.link_of.items() if link == 0)

    @property
    def object_body(self) -> int:
        """The object's body, MuJoCo's last one."""
        return self.model.nbody - 1

    def start(self, grasp: Grasp) -> None:
        """Puts hand and object at the begin of a lift, time zero, and takes up the lift's targets.

        Args:
            grasp: A grasp with pre-grasp and squeeze targets.
        """
        mujoco, self.grasp = mujoco_module(), grasp
        # The mount stands at the grasp; the pre-grasp is an offset of the carriage.
        self.model.body_pos[MOUNT] = grasp.X_WH.translation()
        self.model.body_quat[MOUNT] = grasp.X_WH.rotation().ToQuaternion().wxyz()
        pose = np.concatenate([grasp.X_WO.translation(), grasp.X_WO.rotation().ToQuaternion().wxyz()])
        self.model.qpos0[-7:] = pose
        # Contacts are as stiff as the bodies are heavy at the reference configuration, which has changed.
        mujoco.mj_setConst(self.model, self.data)
        mujoco.mj_resetData(self.model, self.data)
        q, offset = targets(grasp, self.protocol, 0.0)
        self.data.qpos[CARRIAGE] = offset
        self.data.qpos[self.joint_addresses] = self.hand.q_full(q)
        self.kept = pose if self.protocol.release else None
        mujoco.mj_forward(self.model, self.data)

    def release(self) -> None:
        """Lets the object go that the protocol kept in place."""
        self.kept = None

    def advance_to(self, t: float) -> None:
        """Simulates until a time [s]; a RuntimeError where the state is no number any more."""
        mujoco, step = mujoco_module(), self.model.opt.timestep
        with _silent(mujoco):
            for _ in range(round((t - self.data.time) / step)):
                self.data.ctrl[:] = self._controls(self.data.time + step)
                mujoco.mj_step(self.model, self.data)
                if self.kept is not None:  # as if another hand held it
                    self.data.qpos[-7:], self.data.qvel[-6:] = self.kept, 0.0
        # MuJoCo goes on from the begin where a state is bad, and only counts it.
        if any(int(warning.number) for warning in self.data.warning):
            raise RuntimeError("MuJoCo's simulation became unstable")

    def _controls(self, t: float) -> Array:
        """What the actuators get to follow the targets of a time with their rates, shape (3 + n,)."""
        assert self.grasp is not None
        plant, played = self.protocol.plant, (self.grasp, self.protocol, t)
        (q, offset), (q_rate, offset_rate) = targets(*played), target_rates(*played)
        # A position actuator knows no rate of its target: kp (ctrl - q) - kd v is to be kp (q_t - q) + kd (v_t - v).
        carriage = offset + plant.carriage_kd / plant.carriage_kp * offset_rate
        return np.concatenate([carriage, q + plant.kd / plant.kp * q_rate])

    def touching_at_rest(self, depth: float = 0.0) -> Touch:
        """Contacts of the configuration as it stands and at least as deep as given [m], from geometry alone."""
        mujoco_module().mj_fwdPosition(self.model, self.data)
        return self._touches(depth)

    def touching(self) -> Touch:
        """Contacts of the last step."""
        return self._touches(0.0)

    def _touches(self, depth: float) -> Touch:
        contact, body_of = self.data.contact, self.model.geom_bodyid
        deep = np.asarray(contact.dist) < min(-depth, 0.0) if depth == 0.0 else np.asarray(contact.dist) <= -depth
        on_object, on_table, on_obstacle = set(), set(), set()
        for pair in body_of[np.asarray(contact.geom).reshape(-1, 2)[deep]]:
            for one, other in (pair, pair[::-1]):
                link = self.link_of.get(int(one))
                if link is not None and other == self.object_body:
                    on_object.add(link)
                elif link is not None and other == 0:
                    on_table.add(link)
                elif link is not None and other in self.obstacles:
                    on_obstacle.add(link)
        return Touch(frozenset(on_object), frozenset(on_table), frozenset(on_obstacle))

    def X_WO(self) -> RigidTransform:
        """Pose of the object."""
        wxyz = self.data.qpos[-4:]
        return RigidTransform(RotationMatrix(Quaternion(wxyz / np.linalg.norm(wxyz))), self.data.qpos[-7:-4])

    def X_WH(self) -> RigidTransform:
        """Pose of the wrist frame."""
        base = self.base_body
        R_WB = RotationMatrix(Quaternion(self.data.xquat[base] / np.linalg.norm(self.data.xquat[base])))
        X_WB = RigidTransform(R_WB, self.data.xpos[base])
        return X_WB @ RigidTransform(RotationMatrix(self.hand.R_HB), self.hand.p_HB).inverse()

    def push(self, f_W: Array) -> None:
        """Applies a force at the object's center of mass from now on.

        Args:
            f_W: The force in W [N], shape (3,); zero ends it.
        """
        self.data.xfrc_applied[self.object_body, :3] = f_W

    def state(self) -> Array:
        """All that the further simulation depends on, to go on from here again by `restore`."""
        mujoco = mujoco_module()
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, self.data, state, kind)
        return state

    def restore(self, state: Array) -> None:
        """Goes back to a state of the same lift."""
        mujoco = mujoco_module()
        mujoco.mj_setState(self.model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self.model, self.data)


def mujoco_module() -> Any:
    """MuJoCo's Python package, imported when it is first needed.

    Raises:
        MissingExtra: It is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise MissingExtra("MuJoCo is not installed; install it with `pip install 'xdex_drake[mujoco]'`") from None
    return mujoco


def load_model(mjcf: ModelFile) -> Any:
    """A model as MuJoCo compiles it, without files.

    Args:
        mjcf: The model.

    Returns:
        An `mujoco.MjModel`.

    Raises:
        MissingExtra: MuJoCo is not installed.
    """
    files = {name: text.encode("ascii") for name, text in mjcf.meshes.items()}
    return mujoco_module().MjModel.from_xml_string(mjcf.xml, files)


def mujoco_rig(
    hand: Hand, scene: Scene, *, protocol: LiftProtocol | None = None, settings: MjcfSettings = MJCF
) -> MujocoRig:
    """Builds the scene of a lift in MuJoCo.

    Args:
        hand: The hand.
        scene: The object on its table.
        protocol: The protocol; that of `usual_protocol` where None. Its time step and contact stiffness are Drake's
            alone.
        settings: MuJoCo's physics.

    Returns:
        The rig; lifts on one rig do not influence each other.

    Raises:
        MissingExtra: MuJoCo is not installed.
    """
    protocol = protocol or usual_protocol(scene)
    model = load_model(lift_scene(hand, scene, protocol=protocol, settings=settings))
    addresses = [int(model.joint(joint.name).qposadr[0]) for joint in hand.joints]
    link_of = {int(model.body(body_name(link)).id): k for k, link in enumerate(hand.links)}
    return MujocoRig(
        protocol,
        hand,
        protocol_scene(scene, protocol),
        model,
        mujoco_module().MjData(model),
        np.array(addresses, dtype=np.int64),
        link_of,
        frozenset(int(model.body(obstacle_name(k, hand)).id) for k in range(len(scene.obstacles))),
    )


def simulate_lift(rig: MujocoRig, grasp: Grasp) -> Lift:
    """Simulates one lift.

    Args:
        rig: The rig of the grasp's hand and scene.
        grasp: A grasp with pre-grasp and squeeze targets.

    Returns:
        Verdict, with the first failure reason of `FAILURE_REASONS` that matches where it failed; its protocol is
        `mujoco:` and the protocol's name.
    """
    verdict = play_lift(rig, grasp)
    return replace(verdict, protocol=f"mujoco:{verdict.protocol}")


def lift(grasp: Grasp, hand: Hand, scene: Scene, *, protocol: AnyProtocol | None = None) -> Lift:
    """Judges one grasp in MuJoCo, on the shared rig of its hand and scene; see `simulation.pushes.play`.

    Args:
        grasp: A grasp with pre-grasp and squeeze targets.
        hand: Its hand.
        scene: Its scene.
        protocol: The protocol: a lift, or pushes without weight; that of `usual_protocol` where None.

    Returns:
        The verdict; its protocol is `mujoco:` and the protocol's name.

    Raises:
        MissingExtra: MuJoCo is not installed.
    """
    protocol = protocol or usual_protocol(scene)
    grip = protocol.grip
    rig = shared(lambda: mujoco_rig(hand, scene, protocol=grip), "mujoco", hand, scene, grip)
    verdict = play(rig, grasp, protocol)
    return replace(verdict, protocol=f"mujoco:{verdict.protocol}")


@contextmanager
def _silent(mujoco: Any) -> Iterator[None]:
    """Keeps MuJoCo from writing its warnings into a file of the working directory."""
    known = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(known)
