"""What a lift is: every number of every protocol in one place, and the protocols by their names."""

import difflib
from dataclasses import dataclass, field, replace
from typing import Literal

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
    """A lift from the table, or the release of an object that floats.

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
        start_offset_H: Way from the grasp's wrist position to where the wrist starts, in H [m], with stretched fingers,
            None for the grasp's own pre-grasp; see `pushes.from_afar`.
        off_table_m: Least height of the object's lowest point at the end [m], None for any.
        hold: What comes after the lift, None for nothing; it has a verdict of its own.
        release: Whether the object is kept in place, as if held by another hand, until the squeeze is over.
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
    start_offset_H: tuple[float, float, float] | None = None
    off_table_m: float | None = None
    hold: HoldTest | None = None
    release: bool = False
    differs: str = ""

    @property
    def grip(self) -> "LiftProtocol":
        """The protocol of the rig that plays this: itself."""
        return self

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

RELEASE = LiftProtocol(
    name="release",
    rise_s=1.0,
    hold_s=1.0,
    rise_m=0.0,
    success_m=-0.02,
    max_shift_m=0.02,
    max_turn_rad=float(np.deg2rad(15.0)),
    release=True,
)
"""For objects that float: the object is kept in place until the squeeze is over, then let go; the hand holds it against
gravity for two seconds, within 2 cm and 15 degrees of where it was. Nothing is lifted."""

LIFT_05 = LiftProtocol(
    name="lift-0.5-like",
    plant=PlantSettings(time_step=0.002),
    close_s=0.5,
    rise_s=1.0,
    rise_m=0.5,
    success_m=0.0,
    fingertips=0,
    cpu_limit_s=60.0,
    start_offset_H=(-0.03, 0.0, -0.03),
    off_table_m=1e-3,
    differs="simulated by Drake instead of MuJoCo; the hand is the given one, on slides that do not turn, instead of a "
    "MANO hand of 0.4 kg on a ball joint; the thumb starts as at the pre-grasp instead of turned by 1 rad; the squeeze "
    "applies the certificate's forces instead of a little extra flexion; friction, mass, gains and times are not "
    "published: they are the library's, 0.5 s for the way and 1 s for the rise",
)
"""The lift of HUG-Bench: from 3 cm backwards and 3 cm dorsal of the grasp, half a metre straight up."""


@dataclass(frozen=True)
class PushProtocol:
    """A closed hand and an object far from any table and without weight, which is then accelerated.

    Attributes:
        name: Name under which results are published.
        grip: Physics, and the times in which the hand closes and squeezes.
        closing: Where the joints start and are sent: `squeeze`, from the pre-grasp over the grasp to its squeeze;
            `fractions`, from the grasp opened by 0.25 of each joint's way to its limit to the grasp closed by 0.15 of
            it; `dip`, at a posture whose contacts are 1 mm deep, from the begin.
        accelerations: Accelerations of the object, one after the other [m/s^2].
        push_s: Duration of each [s].
        reset: Whether each starts from the state after closing.
        only_end: Whether the bounds count at the end of the last one alone.
        from_start: Whether shift and turn count from the object's pose before the hand closes.
        max_shift_m: Greatest distance of the center of mass from where it was [m], None for any.
        max_turn_rad: Greatest turn [rad], None for any.
        contact: Whether hand and object must touch at the end of each.
        needed: How many of them the hand must pass.
        max_depth_m: Greatest depth of an object point in the hand at the grasp [m], None for any.
        max_depth_sum_m: Greatest sum of the depths of 2,048 object points [m], None for any.
        differs: How it differs from the one that was published, in words.
    """

    name: str
    grip: LiftProtocol
    closing: Literal["squeeze", "fractions", "dip"]
    accelerations: tuple[tuple[float, float, float], ...]
    push_s: float
    reset: bool = True
    only_end: bool = False
    from_start: bool = False
    max_shift_m: float | None = None
    max_turn_rad: float | None = None
    contact: bool = False
    needed: int = 6
    max_depth_m: float | None = None
    max_depth_sum_m: float | None = None
    differs: str = ""

    @property
    def hold(self) -> None:
        """Nothing comes after."""
        return None


AnyProtocol = LiftProtocol | PushProtocol


def _six(size: float, order: str) -> tuple[tuple[float, float, float], ...]:
    """Accelerations along axes in an order such as `+x -x`."""
    signs = [(1.0 if word[0] == "+" else -1.0, "xyz".index(word[1])) for word in order.split()]
    return tuple(tuple(sign * size if k == axis else 0.0 for k in range(3)) for sign, axis in signs)  # type: ignore[misc]


def _grip(name: str, plant: PlantSettings, close_s: float, squeeze_s: float) -> LiftProtocol:
    """How a hand closes that does not rise."""
    return LiftProtocol(
        name=name,
        plant=plant,
        close_s=close_s,
        squeeze_s=squeeze_s,
        rise_s=0.01,
        hold_s=0.0,
        rise_m=0.0,
        ramp="linear",
        cpu_limit_s=60.0,
    )


_RIGID = PlantSettings(time_step=0.005, friction=3.0, kp=1000.0, kd=200.0, carriage_kp=1000.0, carriage_kd=200.0)

PUSH_6_WEAK = PushProtocol(
    name="push-6-weak",
    grip=replace(_grip("push-6-weak", _RIGID, 1.0, 0.01), density=500.0, friction=3.0),
    closing="fractions",
    accelerations=_six(0.5, "+x +y +z -x -y -z"),
    push_s=1.0,
    reset=False,
    only_end=True,
    max_shift_m=0.02,
    differs="simulated by Drake instead of PhysX; joints open away from the object's center and close towards it by "
    "the motion of their own fingertip instead of link directions drawn by hand; targets move linearly within the "
    "second of closing instead of by one step; the wrist rides on three slides with the fingers' gains instead of six "
    "joints; no penetration at the open posture is filtered out",
)
"""The validation of D(R,O) and T(R,O): six pushes of 0.5 m/s^2 that cancel in pairs, no reset, judged at the end."""

_GRAVITY = PlantSettings(time_step=1.0 / 120.0, friction=3.0, kp=1000.0, kd=0.0)

GRAV_6_ALL = PushProtocol(
    name="grav-6-all",
    grip=replace(_grip("grav-6", _GRAVITY, 0.01, 0.01), density=500.0, friction=3.0),
    closing="dip",
    accelerations=_six(9.8, "-y +y +x -x -z +z"),
    push_s=100.0 / 60.0,
    contact=True,
    max_depth_sum_m=1e-3,
    differs="simulated by Drake instead of PhysX; links within 1 mm are sent 1 mm further in by least squares instead "
    "of by one gradient step; the object is weightless for the first 0.02 s; 2,048 points of the mesh tell the "
    "penetration",
)
"""The validation of DexGraspNet: gravity from six sides, contact must remain under each."""

GRAV_6_ANY = replace(
    GRAV_6_ALL,
    name="grav-6-any",
    needed=1,
    max_depth_m=5e-3,
    max_depth_sum_m=None,
)
"""The rule of UGG: contact remains under at least one of the six, and no point is deeper than 5 mm."""

SHAKE_6 = PushProtocol(
    name="shake-6-like",
    grip=_grip("shake-6-like", PlantSettings(), 0.3, 0.4),
    closing="squeeze",
    accelerations=_six(9.81, "+x -x +y -y +z -z"),
    push_s=1.0,
    max_shift_m=0.02,
    differs="size and duration of the loads, gains and friction are not published: they are 1 g for 1 s, and the "
    "library's; studies/protocols sweeps them",
)
"""The shaking of EquiDexFlow: inertial loads along both senses of three axes, drift below 2 cm under each."""

BENCH_FC = PushProtocol(
    name="bench-fc",
    grip=replace(
        _grip("bench-fc", PlantSettings(time_step=0.004, kp=5.0), 0.4, 0.4),
        mass_kg=0.1,
        friction=0.6,
        start_depth_m=0.01,
    ),
    closing="squeeze",
    accelerations=_six(10.0, "-x +x -y +y -z +z"),
    push_s=2.0,
    from_start=True,
    max_shift_m=0.05,
    max_turn_rad=float(np.deg2rad(15.0)),
    differs="simulated by Drake instead of MuJoCo, without torsional friction (0.02 m there); targets move without "
    "steps; the squeeze applies the certificate's forces",
)
"""The force-closure test of DexGraspBench, main branch: six pushes of 10 m/s^2 for two seconds."""

PROTOCOLS: dict[str, AnyProtocol] = {
    protocol.name: protocol
    for protocol in (
        *(LIFT, HOLD, FROGGER_LIFT, BENCH_LIFT, LIFT_05, RELEASE),
        *(BENCH_FC, PUSH_6_WEAK, GRAV_6_ALL, GRAV_6_ANY, SHAKE_6),
    )
}
"""The protocols by their names."""


def find_protocol(name: str) -> AnyProtocol:
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


def usual_protocol(scene: Scene) -> LiftProtocol:
    """The protocol by which the grasps of a scene are judged unless another is given.

    Args:
        scene: The scene.

    Returns:
        `LIFT` where the object lies on a table, `RELEASE` where it floats.
    """
    return LIFT if scene.table is not None else RELEASE


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
