"""The object that is held, as the wrench programs know it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import contact_frames, grasp_matrix
from xdex_drake.contact.grasp_map import GraspMap
from xdex_drake.contact.wrench import GRAVITY
from xdex_drake.errors import ConfigError

if TYPE_CHECKING:
    from xdex_drake.scene.tabletop import Scene


@dataclass(frozen=True)
class HeldObject:
    """An object in a hand.

    Attributes:
        mass: Mass [kg], positive.
        length: Length that divides torques [m].
        p_OOcm: Center of mass in O [m], shape (3,).
        friction: Coefficient of friction, one, or one for each contact, shape (n,).
        R_WO: Rotation of the object in W, whose -z is the direction of gravity, shape (3, 3).
    """

    mass: float
    length: float
    p_OOcm: Array
    friction: float | Array
    R_WO: Array

    def __post_init__(self) -> None:
        """Refuses a mass that is none.

        Raises:
            ConfigError: The mass is not positive.
        """
        if not self.mass > 0.0:
            raise ConfigError(f"mass: {self.mass} must be positive")

    @staticmethod
    def of(scene: Scene) -> HeldObject:
        """The object of a scene, as it lies there."""
        model = scene.object
        return HeldObject(model.mass, model.length, model.p_OOcm, model.friction, scene.X_WO.rotation().matrix())

    @property
    def weight(self) -> float:
        """Weight m g [N]."""
        return self.mass * GRAVITY

    def grasp_map(self, p_OCs: ArrayLike, n_OCs: ArrayLike) -> GraspMap:
        """The grasp map in W of contacts given in O.

        The contact frame is fixed to the object, R_WC = R_WO contact_frames(n_OC), so that stored forces keep their
        meaning when the object turns.

        Args:
            p_OCs: Contact points in O [m], shape (n, 3).
            n_OCs: Normals in O, into the object, shape (n, 3).

        Returns:
            The grasp map.

        Raises:
            ConfigError: Shapes do not match or a normal has zero length.
        """
        R, p = np.asarray(self.R_WO, dtype=float), np.asarray(p_OCs, dtype=float).reshape(-1, 3)
        R_WCs = R @ contact_frames(np.asarray(n_OCs, dtype=float).reshape(-1, 3))
        G = grasp_matrix((p - np.asarray(self.p_OOcm, dtype=float)) @ R.T, R_WCs, np.zeros(3))
        return GraspMap(G, self.friction, self.length)
