"""Spheres stay out of what stands around the object: as an energy, and as constraints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.block import MM, Block
from xdex_drake.programs.point import CLOSE, Point
from xdex_drake.programs.term import Pull, View
from xdex_drake.programs.terms.penetration import penetration
from xdex_drake.scene.fixtures import Fixture
from xdex_drake.scene.tabletop import Scene

if TYPE_CHECKING:
    import torch

    from xdex_drake.scene.grid_torch import TorchGrid

NEAR = 0.05
"""Gap to an obstacle from which on a sphere does not matter to a program [m]."""


@dataclass(frozen=True)
class Surroundings:
    """Penetration of the obstacles of a scene, as `Penetration` is of object and table.

    Attributes:
        fixtures: The obstacles.
        weight: Weight.
        clearance: Gap that spheres keep [m].
        name: Name.
    """

    fixtures: tuple[Fixture, ...]
    weight: float = 100.0
    clearance: float = 0.002
    name: str = "obstacles"

    @staticmethod
    def of(scene: Scene) -> tuple[Surroundings, ...]:
        """The term of a scene; none where there is no obstacle."""
        return (Surroundings(scene.obstacles),) if scene.obstacles else ()

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value [m] and gradient; by distance grids in a search, exact at a point."""
        keep_off, total, pull = view.radii + self.clearance, 0.0, 0.0
        for fixture in self.fixtures:
            distances, directions = _distances(fixture, view.centers_W)
            value, slope = penetration(distances, keep_off)
            total, pull = total + value, pull + slope[..., None] * directions
        return total, Pull(centers_W=pull)


def _distances(fixture: Fixture, centers_W: Any) -> tuple[Any, Any]:
    """Distances of points [m], shape (..., m), and the directions in which they grow, shape (..., m, 3)."""
    if isinstance(centers_W, np.ndarray):
        return fixture.distances(centers_W)
    grid, R_WF, p_WF = _tensors(fixture, centers_W.dtype, str(centers_W.device))
    distances, directions = grid.nearest(R_WF.T @ (centers_W.transpose(1, 2) - p_WF[:, None]))
    return distances, (R_WF @ directions).transpose(1, 2)


@lru_cache(maxsize=16)
def _tensors(fixture: Fixture, dtype: torch.dtype, device: str) -> tuple[TorchGrid, torch.Tensor, torch.Tensor]:
    import torch  # only where a batch needs it

    from xdex_drake.scene.grid_torch import TorchGrid

    R_WF, p_WF = fixture.X_WF.rotation().matrix(), fixture.X_WF.translation()
    grid = TorchGrid(fixture.object.grid, dtype=dtype, device=device)
    return grid, torch.tensor(R_WF, dtype=dtype, device=device), torch.tensor(p_WF, dtype=dtype, device=device)


def obstacle_blocks(start: Point, clearance: float, *, spheres: NDArray[np.int64] | None = None) -> tuple[Block, ...]:
    """Spheres stay out of the obstacles: SDF(c_i) - r_i >= clearance.

    Args:
        start: Initial guess; spheres that are far from an obstacle there are left out.
        clearance: Least gap [m]; spheres that are nearer at the start already need not go away if they are given.
        spheres: Indices among `hand.spheres`; all where None.

    Returns:
        One block, none where the scene has no obstacle.
    """
    scene, radii = start.scene, start.k.hand.spheres[:, 3]
    if not scene.obstacles:
        return ()
    rows = np.arange(len(radii)) if spheres is None else spheres
    gaps = [fixture.distances(start.centers_W[rows])[0] - radii[rows] for fixture in scene.obstacles]
    near = [rows[some < NEAR] for some in gaps]
    low = np.concatenate([np.full(len(some), clearance) for some in near])
    if spheres is not None:
        low = np.minimum(low, np.concatenate([some[some < NEAR] for some in gaps]))

    def evaluate(point: Point) -> tuple[Array, Array]:
        g, J = [np.zeros(0)], [np.zeros((0, point.size))]
        for fixture, some in zip(scene.obstacles, near, strict=True):
            if len(some) == 0:
                continue
            distance, direction = fixture.distances(point.centers_W[some])
            gap, slope = distance - radii[some], np.zeros((len(some), point.size))
            close = np.flatnonzero(gap < CLOSE)
            slope[close, : point.moving] = MM * point.pull_back_spheres(some[close], direction[close])
            g.append(MM * gap)
            J.append(slope)
        return np.concatenate(g), np.concatenate(J)

    block = Block("obstacle", evaluate, MM * low, np.full(len(low), np.inf), "mm", "gap between sphere and obstacle")
    if spheres is not None:
        return (block,)
    return (replace(block, whole=lambda point: MM * max(0.0, clearance - obstacle_gap(point.k, scene))),)


def obstacle_gap(k: Configuration, scene: Scene) -> float:
    """Least gap between a sphere of a hand and an obstacle [m].

    Args:
        k: The hand's configuration.
        scene: The scene.

    Returns:
        The gap, negative where they overlap; infinite where there is no obstacle.
    """
    if not scene.obstacles:
        return float("inf")
    centers, radii = k.points(k.hand.sphere_links, k.hand.spheres[:, :3]), k.hand.spheres[:, 3]
    return float(min((gap - radii).min() for gap in _gaps(scene, centers)))


def _gaps(scene: Scene, centers_W: Array) -> Iterator[Array]:
    return (fixture.distances(centers_W)[0] for fixture in scene.obstacles)
