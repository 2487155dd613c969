"""Settings of the batched search."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import get_args

from xdex_drake.errors import ConfigError
from xdex_drake.programs.contact_forces import FORCE_FRICTION
from xdex_drake.programs.grasp_types import GraspType
from xdex_drake.programs.term import Term
from xdex_drake.programs.terms import EQ_1
from xdex_drake.programs.terms.approach import APPROACH_COSINE, Approach, checked_direction
from xdex_drake.programs.terms.spread import Spread
from xdex_drake.scene.region import Region

LOWEST_APPROACH = 0.35
"""Greatest upward part of a palm's direction: from further below, no hand comes past the table."""


@dataclass(frozen=True)
class EnergyWeights:
    """Weights in place of the terms' own, by the names of Eq. (1) and of the wishes; None leaves a term its own.

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

    fc: float | None = None
    dis: float | None = None
    sdf: float | None = None
    j: float | None = None
    s: float | None = None
    pad: float | None = None
    approach: float | None = None
    spread: float | None = None


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the batched search.

    Attributes:
        terms: Terms of the energy; `(*EQ_1, mine)` adds one of the user's own.
        weights: Weights in place of the terms' own.
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
        grasp_type: Type of grasp: which fingers, and whether the palm, carry contact.
        approach: Direction that the palm shall come along, in W, of any length; any where None.
        approach_cosine: Cosine between the palm's direction and that one that is enough; polished grasps keep it.
        spread: Distance that contact points shall keep from each other [m]; any where 0.
        region: Part of the object in which contacts shall lie; anywhere where None.
    """

    terms: tuple[Term, ...] = EQ_1
    weights: EnergyWeights = field(default_factory=EnergyWeights)
    iterations: int = 100
    halfway: float = 0.3
    survivors: float = 0.5
    translation_step: float = 0.004
    rotation_step: float = 0.04
    joint_step: float = 0.04
    oversample: int = 8
    contacts: int = 4
    friction_fraction: float = FORCE_FRICTION
    force_steps: int = 3
    grasp_type: GraspType = "any"
    approach: tuple[float, float, float] | None = None
    approach_cosine: float = APPROACH_COSINE
    spread: float = 0.0
    region: Region | None = None

    def __post_init__(self) -> None:
        """Refuses what can be no setting.

        Raises:
            ConfigError: A number is out of range, the grasp type is none, or the approach is zero.
        """
        kinds = get_args(GraspType)
        if self.grasp_type not in kinds:
            raise ConfigError(f"grasp_type is {self.grasp_type!r}; choose one of {', '.join(kinds)}")
        for name, least in (("contacts", 1), ("iterations", 0), ("oversample", 1)):
            if getattr(self, name) < least:
                raise ConfigError(f"{name} is {getattr(self, name)}; give {least} or more")
        if not 0.0 <= self.spread < 0.5:
            raise ConfigError(f"spread is {self.spread:g} m; give a distance between 0 and 0.5")
        if self.approach is not None:
            checked_direction(self.approach)

    def energy(self) -> tuple[tuple[float, Term], ...]:
        """The terms with the weights that hold: those of `terms`, and the wishes that were made.

        Returns:
            Weights and terms.

        Raises:
            ConfigError: Two terms have one name.
        """
        terms: list[Term] = list(self.terms)
        if self.spread > 0.0:
            terms.append(Spread(self.spread))
        if self.approach is not None:
            terms.append(Approach(self.approach, self.approach_cosine))
        names = [term.name for term in terms]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ConfigError(f"terms: two are named {twice[0]!r}; give each a name of its own")
        given = {name: weight for name, weight in vars(self.weights).items() if weight is not None}
        return tuple((given.get(term.name, term.weight), term) for term in terms)


def check_approach(approach: tuple[float, float, float] | None) -> None:
    """Refuses an approach that no hand can take where there is a table.

    Args:
        approach: Direction that the palm shall come along, in W; any where None.

    Raises:
        ConfigError: It points up so that the hand would have to come from below the table.
    """
    if approach is not None and checked_direction(approach)[2] > LOWEST_APPROACH:
        raise ConfigError(
            f"approach {list(approach)} comes from below the table; give a direction that points down or sideways, "
            "such as (0, 0, -1), or take the table away"
        )
