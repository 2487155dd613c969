"""A scene by plain facts: what another process, or a later run, needs to build it again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xdex_drake.errors import GraspFileError, XdexError

if TYPE_CHECKING:
    from xdex_drake.scene.tabletop import Scene


@dataclass(frozen=True)
class SceneFacts:
    """An object at its pose on the table, by what it takes to build it; hashable and picklable.

    Attributes:
        object_path: Library name, name of a generated shape, or path of the mesh.
        digest: Digest of the mesh.
        scale: Factor from the mesh file's unit to metres.
        mass: Mass of the object [kg].
        friction: Coefficient of friction.
        X_WO: Pose of the object, the rows of the matrix [R | p] one after the other, 12 numbers.
        scene_id: Identifier of the scene.
    """

    object_path: str
    digest: str
    scale: float
    mass: float
    friction: float
    X_WO: tuple[float, ...]
    scene_id: str

    @staticmethod
    def of(scene: Scene) -> SceneFacts:
        """The facts of a scene; `build` gives it back to the last bit."""
        model = scene.object
        path = model.name if model.path is None else str(model.path)
        pose = tuple(scene.X_WO.GetAsMatrix34().ravel().tolist())
        return SceneFacts(path, model.digest, model.scale, model.mass, model.friction, pose, scene.scene_id)

    def build(self) -> Scene:
        """Prepares the object and lays it as it lay.

        Returns:
            The scene.

        Raises:
            GraspFileError: The mesh has changed since, or cannot be found.
        """
        from pydrake.math import RigidTransform

        from xdex_drake.scene.object import load_object
        from xdex_drake.scene.tabletop import Scene

        try:
            model = load_object(self.object_path, scale=self.scale, mass=self.mass, friction=self.friction)
        except XdexError as error:
            raise GraspFileError(f"scene {self.scene_id}: its object cannot be found: {error}") from None
        if model.digest != self.digest:
            raise GraspFileError(
                f"scene {self.scene_id}: {self.object_path} is not the mesh of its grasps; restore that mesh"
            )
        return Scene(model, RigidTransform(np.array(self.X_WO).reshape(3, 4)), self.scene_id)
