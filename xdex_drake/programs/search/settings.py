"""Settings of the batched search."""

from __future__ import annotations

from dataclasses import dataclass, field

from xdex_drake.programs.grasp_types import GraspType


@dataclass(frozen=True)
class EnergyWeights:
    """Weights of Eq. (1).

    Attributes:
        fc: Force closure.
        dis: Contact distance.
        sdf: Penetration of object and table.
        j: Joint limits.
        s: Self-collision.
        pad: Alignment of contact normals with the pads of the fingers.
        approach: The palm's direction, where one is asked for.
        spread: Distance between contacts, where one is asked for.
    """

    fc: float = 10.0
    dis: float = 100.0
    sdf: float = 100.0
    j: float = 1.0
    s: float = 50.0
    pad: float = 3.0
    approach: float = 10.0
    spread: float = 100.0


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the batched search.

    Attributes:
        weights: Weights of the energy.
        iterations: Number of Adam steps.
        halfway: Fraction of the steps after which the candidates of highest energy are dropped.
        survivors: Fraction of the candidates that go on from there.
        translation_step: First step of the wrist [m].
        rotation_step: First step of the wrist [rad].
        joint_step: First step of the joints, as a fraction of one radian.
        oversample: How many starts are looked at for each one that descends.
        contacts: Greatest number of fingers that touch.
        friction_fraction: Fraction of the friction that the search's forces may use, so that a margin is left.
        force_steps: Projected-gradient steps on the contact forces for each step of the search.
        estimator: "wrench" for forces in exact cones, "normals" for the paper's estimator |G n|^2.
        pad_cosine: Cosine between contact normal and pad normal that is enough.
        clearance: Distance from the object that spheres without contact keep in the search [m].
        grasp_type: Type of grasp: which fingers, and whether the palm, carry contact.
        approach: Direction that the palm shall come along, in W, of any length; any where None.
        approach_cosine: Cosine between the palm's direction and that one that is enough.
        spread: Distance that contact points shall keep from each other [m]; any where 0.
    """

    weights: EnergyWeights = field(default_factory=EnergyWeights)
    iterations: int = 100
    halfway: float = 0.3
    survivors: float = 0.5
    translation_step: float = 0.004
    rotation_step: float = 0.04
    joint_step: float = 0.04
    oversample: int = 8
    contacts: int = 4
    friction_fraction: float = 0.4
    force_steps: int = 3
    estimator: str = "wrench"
    pad_cosine: float = 0.6
    clearance: float = 0.001
    grasp_type: GraspType = "any"
    approach: tuple[float, float, float] | None = None
    approach_cosine: float = 0.9
    spread: float = 0.0
