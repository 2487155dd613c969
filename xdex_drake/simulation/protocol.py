"""What a lift is: every number of every protocol in one place, and the protocols by their names."""

import difflib
from dataclasses import dataclass, field, replace

import numpy as np
import trimesh

from xdex_drake.errors import ConfigError
from xdex_drake.scene.plant import PlantSettings
from xdex_drake.scene.tabletop import Scene


@dataclass(frozen=True)
class Shaking:
    """A motion of the wrist on top of its rise: along each axis k of W, `amplitude_m` sin(rate[k] t + phase[k]).

    Attributes:
        amplitude_m: Amplitude [m].
        rate: Angular frequency along x, y and z [rad/s].
        phase: Phase along x, y and z [rad].
        after_s: Time from the begin of the rise until the shaking begins [s]; it ends with the rise.
        clock_s: Value of the clock t at the begin of the rise [s].
    """

    amplitude_m: float
    rate: tuple[float, float, float]
    phase: tuple[float, float, float]
    after_s: float
    clock_s: float


@dataclass(frozen=True)
class HoldTest:
    """What comes after a lift: the hand holds still, then the object is pushed along +x, -x, +y, -y, +z and -z of W.

    Each push starts from the state after holding still. Slip is the distance of the object's center of mass from where
    it was in the wrist frame at the end of the squeeze, turn the angle since then; the greatest values over time count.

    Attributes:
        still_s: Duration of holding still [s].
        weights: Force of a push at the center of mass [m g].
        ramp_s: Time in which it grows, linearly [s].
        push_s: Time for which it then stays [s].
        max_slip_m: Bound of the slip [m].
        max_turn_rad: Bound of the turn [rad].
    """

    still_s: float = 2.0
    weights: float = 1.0
    ramp_s: float = 0.1
    push_s: float = 0.4
    max_slip_m: float = 0.02
    max_turn_rad: float = float(np.deg2rad(15.0))


@dataclass(frozen=True)
class LiftProtocol:
    """A lift from the table.

    The hand starts at the pre-grasp, closes to the grasp, squeezes, rises and holds. A lift succeeds where every bound
    is met that is given.

    Attributes:
        name: Name under which results are published.
        plant: Physics: time step, friction, contact stiffness, gains.
        close_s: Duration of closing from pre-grasp to grasp [s].
        squeeze_s: Duration of the ramp from grasp to squeeze targets [s].
        rise_s: Duration of the rise [s].
        hold_s: Duration of holding at the top [s].
        rise_m: Height by which the wrist rises [m].
        success_m: Least rise of the object's center of mass [m].
        fingertips: Least number of fingertips that touch the object at the end.
        cpu_limit_s: Processor time after which a lift is given up [s].
        ramp: `smooth`, at rest at both ends, or `linear`.
        shaking: Motion on top of the rise, None for none.
        mass_kg: Mass of the object [kg], None for its own.
        density: Density of the object [kg/m^3], None for its own mass; unused where `mass_kg` is given.
        friction: Coefficient of friction of the object, None for its own; that of hand and table is in `plant`.
        start_depth_m: Penetration of hand and object that is forgiven at the start [m].
        max_height_error_m: Greatest difference of the object's rise from the wrist's [m], None for any.
        max_shift_m: Greatest distance of the object from where the rise should have carried it [m], None for any.
        max_turn_rad: Greatest turn of the object [rad], None for any.
        hold: What comes after the lift, None for nothing; it has a verdict of its own.
        differs: How a peers' protocol differs here from the one that was published, in words.
    """

    name: str = "lift-0.2/2tips"
    plant: PlantSettings = field(default_factory=PlantSettings)
    close_s: float = 0.3
    squeeze_s: float = 0.4
    rise_s: float = 0.7
    hold_s: float = 0.3
    rise_m: float = 0.25
    success_m: float = 0.2
    fingertips: int = 2
    cpu_limit_s: float = 20.0
    ramp: str = "smooth"
    shaking: Shaking | None = None
    mass_kg: float | None = None
    density: float | None = None
    friction: float | None = None
    start_depth_m: float = 0.0
    max_height_error_m: float | None = None
    max_shift_m: float | None = None
    max_turn_rad: float | None = None
    hold: HoldTest | None = None
    differs: str = ""

    @property
    def duration_s(self) -> float:
        """Simulated time of a whole lift [s]."""
        return self.close_s + self.squeeze_s + self.rise_s + self.hold_s


LIFT = LiftProtocol()

FROGGER_LIFT = LiftProtocol(
    name="frogger-lift",
    plant=PlantSettings(time_step=0.001, friction=0.5, carriage_kp=500.0, carriage_kd=90.0),
    squeeze_s=0.2,
    rise_s=1.0,
    hold_s=1.5,
    rise_m=0.1,
    success_m=0.025,
    fingertips=0,
    cpu_limit_s=60.0,
    ramp="linear",
    shaking=Shaking(0.003, (5.0, 4.0, 3.0), (0.0, 0.5 * np.pi, 0.5 * np.pi), after_s=0.25, clock_s=0.2),
    density=150.0,
    friction=0.5,
    max_height_error_m=0.075,
    max_turn_rad=float(np.deg2rad(30.0)),
    differs="the fingers hold constant squeeze targets instead of a force controller that sees the object's pose; the "
    "wrist rides on slides of 500 N/m and 90 N s/m instead of an arm with joints of 500 N m/rad; the hand closes from "
    "its pre-grasp before the clock starts; a lift runs to its end instead of stopping at the first violation",
)
"""The lift of FRoGGeR (Li et al., 2023), numbers of its published code."""

BENCH_LIFT = LiftProtocol(
    name="bench-lift",
    plant=PlantSettings(time_step=0.004, kp=5.0),
    close_s=0.4,
    squeeze_s=0.4,
    rise_s=0.4,
    hold_s=0.0,
    rise_m=0.1,
    success_m=0.05,
    fingertips=0,
    ramp="linear",
    mass_kg=0.1,
    friction=0.6,
    start_depth_m=0.01,
    max_shift_m=0.05,
    max_turn_rad=float(np.deg2rad(15.0)),
    differs="simulated by Drake instead of MuJoCo, without torsional friction (0.02 m there); targets move without "
    "steps instead of in ten steps a phase; the squeeze applies the certificate's forces",
)
"""The tabletop lift of DexGraspBench (Chen et al., 2025), main branch: 100 g, 10 x 10 steps of 4 ms a phase."""

HOLD = replace(LIFT, name="hold", cpu_limit_s=60.0, hold=HoldTest())
"""The lift of `LIFT`, then two seconds of holding and six pushes of the object's weight."""

PROTOCOLS = {protocol.name: protocol for protocol in (LIFT, HOLD, FROGGER_LIFT, BENCH_LIFT)}
"""The protocols by their names."""


def find_protocol(name: str) -> LiftProtocol:
    """A protocol by its name.

    Args:
        name: One of `PROTOCOLS`.

    Returns:
        The protocol.

    Raises:
        ConfigError: There is none of this name.
    """
    if name not in PROTOCOLS:
        close = difflib.get_close_matches(name, PROTOCOLS, n=1)
        hint = f"did you mean {close[0]}?" if close else f"use one of {', '.join(PROTOCOLS)}"
        raise ConfigError(f"protocol {name!r} is not known; {hint}")
    return PROTOCOLS[name]


def protocol_scene(scene: Scene, protocol: LiftProtocol) -> Scene:
    """The scene with the mass and friction that a protocol asks for.

    Args:
        scene: The scene.
        protocol: The protocol.

    Returns:
        The same scene where the protocol leaves the object as it is.
    """
    model = scene.object
    mass = protocol.mass_kg
    if mass is None and protocol.density is not None:
        solid = (model.vertices, model.faces) if model.report.inertia_source == "mesh" else model.surface
        mass = protocol.density * float(trimesh.Trimesh(*solid, process=False).volume)
    return with_physics(
        scene,
        mass=model.mass if mass is None else mass,
        friction=model.friction if protocol.friction is None else protocol.friction,
    )


def with_physics(scene: Scene, *, mass: float, friction: float) -> Scene:
    """A scene whose object has another mass and friction.

    Args:
        scene: The scene.
        mass: Mass [kg]; the inertia is scaled with it.
        friction: Coefficient of friction of the object.

    Returns:
        The scene.
    """
    model = scene.object
    if (mass, friction) == (model.mass, model.friction):
        return scene
    inertia = model.I_OcmO * (mass / model.mass)
    return replace(scene, object=replace(model, mass=mass, I_OcmO=inertia, friction=friction))
