"""Prepares an object and its scene in a process of their own, within a time limit that holds.

Libraries that mend meshes may take long in a single call, which nothing in the same process can end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xdex_drake.jobs.processes import FailureKind, run_apart

if TYPE_CHECKING:
    from xdex_drake.programs.grasp_types import GraspType
    from xdex_drake.scene.tabletop import Scene

LARGE_M = 0.5
"""Extent from which on it is asked whether a hand can hold an object at all before it is split [m]."""


@dataclass(frozen=True)
class SceneRequest:
    """A hand, and an object as it shall lie.

    Attributes:
        hand: Name or path of the hand.
        object: Name or path of the object.
        scale: Factor from the mesh file's unit to metres; guessed where None.
        mass: Mass [kg].
        density: Density [kg/m^3], None for the mass as given.
        friction: Coefficient of friction.
        seed: Choice of the stable pose.
        pose: Number of the pose, None for that of the seed.
        upright: Whether z of the object's file points up instead.
        table: Height of the table's top [m], None for no table.
        obstacles: What is fixed beside the object, as `read_fixture` takes it.
        contacts: Greatest number of fingers that touch.
        grasp_type: Type of grasp.
    """

    hand: str
    object: str
    scale: float | None = None
    mass: float = 0.1
    density: float | None = None
    friction: float = 0.6
    seed: int = 0
    pose: int | None = None
    upright: bool = False
    table: float | None = 0.0
    obstacles: tuple[str, ...] = ()
    contacts: int = 4
    grasp_type: GraspType = "any"


@dataclass(frozen=True, eq=False)
class Prepared:
    """What came of a preparation.

    Attributes:
        scene: The scene; None where the object is too large for the hand, which is seen before it is split.
        obstacle: What keeps the hand from the object, in words; empty where nothing does.
    """

    scene: Scene | None
    obstacle: str


def prepare(request: SceneRequest) -> Prepared:
    """Prepares object and scene, and looks at the object's size before it is split.

    Args:
        request: Hand and object.

    Returns:
        The scene, with what keeps the hand from the object.

    Raises:
        XdexError: Hand or object cannot be used.
    """
    from pydrake.math import RigidTransform

    from xdex_drake.hand.library import load_hand
    from xdex_drake.programs.obstacles import find_obstacles, too_thick
    from xdex_drake.scene.fixtures import read_fixture
    from xdex_drake.scene.object import load_object, object_mesh
    from xdex_drake.scene.tabletop import make_scene, pose_of

    hand, mesh = load_hand(request.hand), object_mesh(request.object, scale=request.scale)[2]
    if float(np.ptp(mesh.vertices, axis=0).max()) > LARGE_M:
        obstacle = too_thick(hand, mesh.vertices, mesh.faces)
        if obstacle is not None:
            return Prepared(None, obstacle.message)
    model = load_object(
        request.object, scale=request.scale, mass=request.mass, friction=request.friction, density=request.density
    )
    model.grid  # noqa: B018 - computed once, here, and read from the cache by whoever searches
    chosen = request.pose is not None or request.upright
    pose = pose_of(model, number=request.pose, upright=request.upright) if chosen else None
    if pose is not None and request.table:
        pose = RigidTransform(pose.rotation(), pose.translation() + np.array([0.0, 0.0, request.table]))
    fixtures = [read_fixture(text) for text in request.obstacles]
    for fixture in fixtures:
        fixture.object.grid  # noqa: B018 - as above
    scene = make_scene(model, seed=request.seed, pose=pose, table=request.table, obstacles=fixtures)
    found = find_obstacles(hand, scene, contacts=request.contacts, grasp_type=request.grasp_type)
    return Prepared(scene, found[0].message if found else "")


def prepare_in_time(
    request: SceneRequest, *, timeout_s: float, on_wait: Callable[[float], None] | None = None
) -> Prepared | None:
    """Prepares object and scene in a child process.

    Args:
        request: Hand and object.
        timeout_s: Wall time after which it is ended [s].
        on_wait: Called again and again meanwhile, with the seconds so far.

    Returns:
        The scene; None where the time was too short.

    Raises:
        XdexError: Hand or object cannot be used.
        RuntimeError: It met a bug, or ended its process.
    """
    done = run_apart(prepare, request, timeout_s=timeout_s, on_wait=on_wait)
    if done.value is not None:
        return done.value
    assert done.failure is not None
    if done.failure.kind is FailureKind.TIMEOUT:
        return None
    if done.failure.error is not None:
        raise done.failure.error
    raise RuntimeError(f"preparing {request.object}: {done.failure.trace or done.failure}")
