"""The grasp value: what is stored, shown, simulated and learned."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array


@dataclass(frozen=True)
class Contact:
    """A point where the hand touches the object.

    Attributes:
        link: Name of the hand's link.
        p_OC: Contact point in the object frame [m], shape (3,).
        n_OC: Unit normal in the object frame, pointing into the object, shape (3,).
        mu: Coefficient of friction.
        f_C: Force on the object in the contact frame, whose z axis is the normal [N], shape (3,).
    """

    link: str
    p_OC: Array
    n_OC: Array
    mu: float
    f_C: Array


@dataclass(frozen=True)
class Certificate:
    """Forces and numbers that prove a grasp, to be checked again without a solver (`contact.check_certificate`).

    Attributes:
        contacts: The contacts with their forces.
        R_WO: Rotation of the object in W, shape (3, 3): gravity is -z of W.
        p_OOcm: Center of mass in the object frame [m], shape (3,).
        mass: Mass of the object [kg].
        length: Length that divides torques, lambda [m].
        wrench_residual: Norm of the unbalanced wrench, torque divided by `length`, divided by m g.
        task_margin: Greatest multiple of the stated disturbances that the grasp resists within its efforts.
        margin_lower: Certified lower bound of the ball margin.
        margin_upper: Certified upper bound of the ball margin.
        witness_forces: Forces f_C that attain `margin_lower` along +-each axis of the wrench space, shape (12, 3 nc).
        witness_direction: Unit wrench direction that attains `margin_upper`, torque first, shape (6,).
    """

    contacts: tuple[Contact, ...]
    R_WO: Array
    p_OOcm: Array
    mass: float
    length: float
    wrench_residual: float
    task_margin: float
    margin_lower: float
    margin_upper: float
    witness_forces: Array = field(default_factory=lambda: np.zeros((12, 0)))
    witness_direction: Array = field(default_factory=lambda: np.zeros(6))

    @property
    def friction_left(self) -> float:
        """Share of the friction that the forces leave unused at the contact that uses most of it.

        Of grasps that merely touch it tells as well as the task margin which ones lift (`studies/margins`): least
        forces that need nearly all of the friction slip at the smallest error.
        """
        f = np.array([contact.f_C for contact in self.contacts]).reshape(-1, 3)
        mu = np.array([contact.mu for contact in self.contacts])
        used = np.hypot(f[:, 0], f[:, 1]) / np.maximum(mu * f[:, 2], 1e-12)
        return 1.0 - float(np.max(used, initial=0.0))


@dataclass(frozen=True)
class Hold:
    """What holding and pushing a lifted object showed; see `simulation.protocol.HoldTest`.

    Attributes:
        holds: Whether slip and turn stayed within the protocol's bounds until the end.
        reason: What went wrong and when, `slipped:+x` for one; empty where it holds.
        slip_m: Greatest distance of the object's center of mass from where the hand had it at the end of the squeeze
            [m], NaN where it did not lift.
        turn_rad: Greatest turn of the object in the hand since then [rad], NaN where it did not lift.
    """

    holds: bool
    reason: str
    slip_m: float
    turn_rad: float


@dataclass(frozen=True)
class Lift:
    """What a simulated lift showed.

    Attributes:
        protocol: Name of the protocol, `lift-0.2/2tips`.
        success: Whether the protocol's rule was met.
        failure_reason: The first reason that matches, empty where it succeeded.
        lift_height_m: Final rise of the object's center of mass [m].
        fingertips: Names of the fingers whose tip touched at the end.
        seconds: Wall time of the simulation.
        hold: What came after the lift, None where the protocol ends with it.
    """

    protocol: str
    success: bool
    failure_reason: str
    lift_height_m: float
    fingertips: tuple[str, ...]
    seconds: float
    hold: Hold | None = None

    @property
    def passed(self) -> bool:
        """Whether the lift succeeded and, where the protocol goes on, the object was held."""
        return self.success and (self.hold is None or self.hold.holds)


@dataclass(frozen=True)
class Grasp:
    """A grasp of one object by one hand, in one scene.

    Attributes:
        hand: Name of the hand.
        object: Name of the object.
        X_WO: Pose of the object in W.
        X_WH: Pose of the wrist frame in W.
        q: Actuated joint values, in the order of `hand.joint_names` [rad or m], shape (n,).
        certificate: Proof of the grasp, None where there is none.
        X_WH_pregrasp: Wrist pose of the pre-grasp, None where it has not been computed.
        q_pregrasp: Joint values of the pre-grasp, None where it has not been computed.
        q_squeeze: Targets of a squeeze by positions alone, within the joint limits, None where they have not been
            computed.
        tau_squeeze: Torques of the squeeze [N m or N], shape (n,), None where they have not been computed. Joints are
            driven by kp (q - q_now) + tau_squeeze.
        lift: The result of simulation, None where it has not been simulated.
        grasp_id: Identifier, unique in a data set.
        source_grasp_id: Identifier of the grasp that this one was retargeted from, empty for a source grasp.
        penetration_parts_m: Depth of the deepest object point in the hand, against the convex parts [m].
        penetration_mesh_m: The same against the mesh [m].
        squeeze_margin: Multiple of the pushes that constant targets resist without sliding, NaN where it is not known.
        stiffness_least: Least eigenvalue of the stiffness with which the hand holds the object, turns times `length`
            [N/m], NaN where it is not known.
        foretold_motion: How far the object is foretold to move under pushes of its weight, as the logarithm of its
            share of the bounds of the protocol `hold`, NaN where it is not known.
        seconds: Wall time spent on this grasp, without the lift.
    """

    hand: str
    object: str
    X_WO: RigidTransform
    X_WH: RigidTransform
    q: Array
    certificate: Certificate | None = None
    X_WH_pregrasp: RigidTransform | None = None
    q_pregrasp: Array | None = None
    q_squeeze: Array | None = None
    tau_squeeze: Array | None = None
    lift: Lift | None = None
    grasp_id: str = ""
    source_grasp_id: str = ""
    penetration_parts_m: float = float("nan")
    penetration_mesh_m: float = float("nan")
    squeeze_margin: float = float("nan")
    stiffness_least: float = float("nan")
    foretold_motion: float = float("nan")
    seconds: float = 0.0

    def __repr__(self) -> str:
        """One line."""
        proof, lift = self.certificate, self.lift
        name = f"{self.grasp_id!r}, " if self.grasp_id else ""
        links = "not certified" if proof is None else f"touches by {', '.join(c.link for c in proof.contacts)}"
        does, not_done = ("lifts", "does not lift")
        if lift is not None and lift.protocol.endswith("release"):
            does, not_done = ("is held", "is not held")
        verdict = "not lifted yet" if lift is None else does if lift.success else f"{not_done}: {lift.failure_reason}"
        return f"Grasp({name}{self.object!r} by {self.hand!r}, {links}, {verdict})"
