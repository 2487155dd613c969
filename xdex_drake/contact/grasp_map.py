"""What the wrench programs are about: forces at contacts, what they do to an object, and what a hand can apply."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.contact.conic import HoldingForces, holding_forces, torque_scaling
from xdex_drake.errors import ConfigError


@dataclass(frozen=True)
class GraspMap:
    """Contacts as an object feels them: the wrench G f about its center of mass, of forces f in their friction cones.

    Attributes:
        G: Grasp matrix, `contact.grasp_matrix`: torque first, forces stacked in contact frames, shape (6, 3 n).
        mu: Coefficient of friction, one, or one for each contact, shape (n,).
        length: Length that divides torques, a size of the object [m]; 1 where G's torques are divided already.
    """

    G: Array
    mu: float | Array
    length: float

    def __post_init__(self) -> None:
        """Refuses what is no grasp.

        Raises:
            ConfigError: Shapes do not match or a number is out of range.
        """
        G, mu = np.asarray(self.G), np.asarray(self.mu, dtype=float)
        if G.ndim != 2 or G.shape[0] != 6 or G.shape[1] % 3 != 0:
            raise ConfigError(f"G: shape {G.shape} is not (6, 3 n); build it with contact.grasp_matrix")
        n = G.shape[1] // 3
        if mu.ndim > 1 or (mu.ndim == 1 and mu.shape != (n,)) or not np.all((mu >= 0.0) & np.isfinite(mu)):
            raise ConfigError(f"mu: {self.mu} must be one coefficient or {n}, finite and not negative")
        if not (self.length > 0.0 and math.isfinite(self.length)):
            raise ConfigError(f"length: {self.length} must be positive; use a size of the object in meters")
        if not np.all(np.isfinite(G)):
            raise ConfigError("G: not finite; check the contact points and normals")

    @property
    def contacts(self) -> int:
        """Number of contacts."""
        return self.G.shape[1] // 3

    @cached_property
    def mus(self) -> Array:
        """Coefficient of friction of each contact, shape (n,)."""
        return np.full(self.contacts, 1.0) * np.asarray(self.mu, dtype=float)

    @cached_property
    def scaling(self) -> Array:
        """Factors that divide the torques of a wrench by `length`, shape (6,)."""
        return torque_scaling(self.length)

    @cached_property
    def scaled(self) -> Array:
        """G with its torques divided by `length`, shape (6, 3 n)."""
        return self.scaling[:, None] * self.G

    @cached_property
    def holding(self) -> HoldingForces:
        """The forces that balance a wrench whose torque is divided by `length`."""
        return holding_forces(self.scaled)


@dataclass(frozen=True)
class Effort:
    """What limits contact forces beside friction: |A f| <= limits.

    Attributes:
        A: Map of contact forces to the torques of the actuated joints, `contact.effort_map`, shape (n_act, 3 n).
        limits: Greatest torque of each [N m or N], shape (n_act,); infinite entries are no limits.
    """

    A: Array
    limits: Array

    def __post_init__(self) -> None:
        """Refuses limits that do not match their map.

        Raises:
            ConfigError: Shapes do not match or a limit is negative.
        """
        A, limits = np.asarray(self.A), np.asarray(self.limits)
        if A.ndim != 2 or limits.shape != A.shape[:1] or not np.all(limits >= 0.0):
            raise ConfigError(
                f"effort: shapes {A.shape}, {limits.shape} are not (n_act, 3 n), (n_act,) with limits >= 0"
            )

    @staticmethod
    def of_normal_forces(contacts: int, most: float) -> Effort:
        """No contact presses with more than `most` [N], whatever hand is behind it."""
        return Effort(np.eye(3 * contacts)[2::3], np.full(contacts, most))


def effort_limits(effort: Effort | None, contacts: int) -> tuple[Array, Array]:
    """A and limits of the joints that are limited at all, shapes (m, 3 n) and (m,); m is 0 where None is.

    Raises:
        ConfigError: The map is not one of the forces of so many contacts.
    """
    if effort is None:
        return np.zeros((0, 3 * contacts)), np.zeros(0)
    A, limits = effort.A, effort.limits
    if A.shape[1] != 3 * contacts:
        raise ConfigError(f"effort: A of shape {A.shape} is not (n_act, {3 * contacts}), for {contacts} contacts")
    limited = np.isfinite(limits) & (np.abs(A).max(axis=1, initial=0.0) > 1e-12)
    return A[limited], limits[limited]
