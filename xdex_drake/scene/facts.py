"""A scene by plain facts: what another process, or a later run, needs to build it again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xdex_drake.errors import GraspFileError, XdexError

if TYPE_CHECKING:
    from xdex_drake.scene.fixtures import Fixture
    from xdex_drake.scene.object import ObjectModel
    from xdex_drake.scene.tabletop import Scene


def source_of(model: ObjectModel) -> str:
    """The name or path by which an object is loaded again.

    Args:
        model: The object.

    Returns:
        Name or path.

    Raises:
        GraspFileError: It was made of a mesh in memory.
    """
    from xdex_drake.scene.object import is_built

    if model.path is not None:
        return str(model.path)
    if not is_built(model.name):
        raise GraspFileError(
            f"object {model.name!r} was made of a mesh in memory, and cannot be found again; write the mesh to a file "
            "and give its path to load_object"
        )
    return model.name


@dataclass(frozen=True)
class FixtureFacts:
    """An obstacle by what it takes to build it.

    Attributes:
        object_path: Library name, sides of a box, or path of the mesh.
        digest: Digest of the mesh.
        scale: Factor from the mesh file's unit to metres.
        X_WF: Pose, the rows of the matrix [R | p] one after the other, 12 numbers.
    """

    object_path: str
    digest: str
    scale: float
    X_WF: tuple[float, ...]

    @staticmethod
    def of(fixture: Fixture) -> FixtureFacts:
        """The facts of an obstacle."""
        thing = fixture.object
        path = source_of(thing)
        return FixtureFacts(path, thing.digest, thing.scale, tuple(fixture.X_WF.GetAsMatrix34().ravel().tolist()))


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
        table: Height of the table's top [m], None where there is none.
        obstacles: What is fixed in the world beside the object.
        p_OOcm: Center of mass, where it was given [m].
        I_OcmO: Rotational inertia, where it was given, 9 numbers row by row [kg m^2].
    """

    object_path: str
    digest: str
    scale: float
    mass: float
    friction: float
    X_WO: tuple[float, ...]
    scene_id: str
    table: float | None = 0.0
    obstacles: tuple[FixtureFacts, ...] = ()
    p_OOcm: tuple[float, ...] | None = None
    I_OcmO: tuple[float, ...] | None = None

    @staticmethod
    def of(scene: Scene) -> SceneFacts:
        """The facts of a scene; `build` gives it back to the last bit."""
        model = scene.object
        path = source_of(model)
        pose = tuple(scene.X_WO.GetAsMatrix34().ravel().tolist())
        physics = (model.digest, model.scale, model.mass, model.friction)
        obstacles = tuple(FixtureFacts.of(fixture) for fixture in scene.obstacles)
        given: tuple = (None, None)
        if model.inertia_given:
            given = tuple(model.p_OOcm.tolist()), tuple(model.I_OcmO.ravel().tolist())
        return SceneFacts(path, *physics, pose, scene.scene_id, scene.table, obstacles, *given)

    def build(self) -> Scene:
        """Prepares the object and lays it as it lay.

        Returns:
            The scene.

        Raises:
            GraspFileError: The mesh has changed since, or cannot be found.
        """
        from pydrake.math import RigidTransform

        from xdex_drake.scene.fixtures import Fixture
        from xdex_drake.scene.object import load_object
        from xdex_drake.scene.tabletop import Scene

        fixtures = []
        for facts in self.obstacles:
            try:
                thing = load_object(facts.object_path, scale=facts.scale)
            except XdexError as error:
                raise GraspFileError(f"scene {self.scene_id}: an obstacle cannot be found: {error}") from None
            if thing.digest != facts.digest:
                raise GraspFileError(
                    f"scene {self.scene_id}: {facts.object_path} is not the obstacle that it was; restore that mesh"
                )
            fixtures.append(Fixture(thing, RigidTransform(np.array(facts.X_WF).reshape(3, 4))))
        try:
            model = load_object(
                self.object_path,
                scale=self.scale,
                mass=self.mass,
                friction=self.friction,
                p_OOcm=None if self.p_OOcm is None else np.array(self.p_OOcm),
                I_OcmO=None if self.I_OcmO is None else np.array(self.I_OcmO).reshape(3, 3),
            )
        except XdexError as error:
            raise GraspFileError(f"scene {self.scene_id}: its object cannot be found: {error}") from None
        if model.digest != self.digest:
            raise GraspFileError(
                f"scene {self.scene_id}: {self.object_path} is not the mesh of its grasps; restore that mesh"
            )
        X_WO = RigidTransform(np.array(self.X_WO).reshape(3, 4))
        return Scene(model, X_WO, self.scene_id, self.table, tuple(fixtures))
