"""What a lift is: every number of the protocol `lift-0.2/2tips` in one place."""

from dataclasses import dataclass, field

from xdex_drake.scene.plant import PlantSettings


@dataclass(frozen=True)
class LiftProtocol:
    """A lift from the table.

    The hand starts at the pre-grasp, closes to the grasp, squeezes, rises and holds.

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

    @property
    def duration_s(self) -> float:
        """Simulated time of a whole lift [s]."""
        return self.close_s + self.squeeze_s + self.rise_s + self.hold_s


LIFT = LiftProtocol()
