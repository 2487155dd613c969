"""Lifts that repeat under errors of pose, friction and mass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.description import Hand
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.drake import lift
from xdex_drake.simulation.protocol import LiftProtocol, protocol_scene, usual_protocol, with_physics


@dataclass(frozen=True)
class RobustSettings:
    """Errors under which a lift is repeated, one kind at a time.

    Attributes:
        repeats: Number of repeats under errors of pose.
        position_m: Greatest error of the wrist's position [m]; direction and size are uniform at random.
        angle_rad: Greatest error of the wrist's rotation about the object's center of mass [rad]; axis and size are
            uniform at random.
        friction_factor: Factor of every coefficient of friction in one more repeat.
        mass_factor: Factor of the object's mass in one more repeat.
        seed: Seed of the errors of pose; they are the same for each grasp.
    """

    repeats: int = 5
    position_m: float = 5e-3
    angle_rad: float = float(np.deg2rad(5.0))
    friction_factor: float = 0.75
    mass_factor: float = 2.0
    seed: int = 0


ROBUST = RobustSettings()


@dataclass(frozen=True)
class RobustLift:
    """What repeated lifts showed.

    Attributes:
        lift: All repeats as one verdict: it succeeds where each one does; else it is the first that failed to lift, or
            to hold where all lift, of protocol `robust:` and the name of the repeated one.
        poses: The repeats under errors of pose.
        slippery: The repeat with less friction.
        heavy: The repeat with more mass.
    """

    lift: Lift
    poses: tuple[Lift, ...]
    slippery: Lift
    heavy: Lift

    @property
    def share(self) -> float:
        """Share of all repeats that succeeded."""
        return float(np.mean([one.passed for one in (*self.poses, self.slippery, self.heavy)]))


def robust_lift(
    grasp: Grasp,
    hand: Hand,
    scene: Scene,
    *,
    protocol: LiftProtocol | None = None,
    settings: RobustSettings = ROBUST,
    lift: Callable[..., Lift] = lift,
) -> RobustLift:
    """Repeats a lift under errors of pose, with less friction, and with more mass.

    Args:
        grasp: A grasp with pre-grasp and squeeze targets.
        hand: Its hand.
        scene: Its scene.
        protocol: The protocol of each repeat; that of `usual_protocol` where None.
        settings: The errors.
        lift: Plays one lift: that of Drake, or `simulation.mujoco.lift`.

    Returns:
        The verdicts.
    """
    protocol = protocol or usual_protocol(scene)
    scene = protocol_scene(scene, protocol)
    # Mass and friction are in the scene now; what the protocol says about them must not undo a change.
    protocol = replace(protocol, mass_kg=None, density=None, friction=None)
    rng = np.random.default_rng(settings.seed)
    poses = tuple(
        lift(displaced(grasp, scene, rng, settings), hand, scene, protocol=protocol) for _ in range(settings.repeats)
    )
    model, factor = scene.object, settings.friction_factor
    slippery = lift(
        grasp,
        hand,
        with_physics(scene, mass=model.mass, friction=factor * model.friction),
        protocol=replace(protocol, plant=replace(protocol.plant, friction=factor * protocol.plant.friction)),
    )
    heavier = with_physics(scene, mass=settings.mass_factor * model.mass, friction=model.friction)
    heavy = lift(grasp, hand, heavier, protocol=protocol)
    every = (*poses, slippery, heavy)
    failed = [one for one in every if not one.success] or [one for one in every if not one.passed]
    first = failed[0] if failed else min(every, key=lambda one: one.lift_height_m)
    verdict = replace(first, protocol=f"robust:{first.protocol}", seconds=sum(one.seconds for one in every))
    return RobustLift(verdict, poses, slippery, heavy)


def displaced(grasp: Grasp, scene: Scene, rng: np.random.Generator, settings: RobustSettings = ROBUST) -> Grasp:
    """A grasp whose wrist is somewhere else than it should be, at pre-grasp and grasp alike.

    Args:
        grasp: The grasp.
        scene: Its scene.
        rng: Source of the errors.
        settings: Their size.

    Returns:
        The displaced grasp.
    """
    assert grasp.X_WH_pregrasp is not None
    axis, direction = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    angle, distance = rng.uniform(0.0, settings.angle_rad), rng.uniform(0.0, settings.position_m)
    R = RotationMatrix(AngleAxis(angle, axis))
    p_WOcm = grasp.X_WO @ scene.object.p_OOcm
    error = RigidTransform(R, p_WOcm - R @ p_WOcm + distance * direction)
    return replace(grasp, X_WH=error @ grasp.X_WH, X_WH_pregrasp=error @ grasp.X_WH_pregrasp)
