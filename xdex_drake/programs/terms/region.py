"""Contacts lie in a part of the object: as an energy, and as a constraint."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.grasp import Grasp
from xdex_drake.programs.block import MM, Block, without_forces
from xdex_drake.programs.point import Point
from xdex_drake.programs.term import Pull, View
from xdex_drake.scene.region import Region
from xdex_drake.scene.tabletop import Scene

if TYPE_CHECKING:
    import torch

    from xdex_drake.scene.grid_torch import TorchGrid

MARGIN = 2e-3
"""How deep in the region contacts are asked to be: they still move a little until shapes touch the mesh [m]."""


@dataclass(frozen=True)
class InRegion:
    """How far contacts are from the region: sum over contacts of max(0, distance + margin).

    Attributes:
        region: The region.
        scene: The scene, for the object's pose.
        weight: Weight.
        name: Name.
    """

    region: Region
    scene: Scene
    weight: float = 50.0
    name: str = "region"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value [m] and gradient."""
        R_WO, p_WO = self.scene.X_WO.rotation().matrix(), self.scene.X_WO.translation()
        points = view.contacts_W
        if isinstance(points, np.ndarray):
            distance, direction = self.region.distances((points - p_WO) @ R_WO)
        else:
            R_WO, p_WO = (points.new_tensor(values) for values in (R_WO, p_WO))
            distance, direction = _batched(self.region, (points - p_WO) @ R_WO)
        out = (distance + MARGIN).clip(min=0.0)
        slope = view.touching * (out > 0.0)
        return (view.touching * out).sum(-1), Pull(contacts_W=slope[..., None] * (direction @ R_WO.T))


def _batched(region: Region, p_Os: Any) -> tuple[Any, Any]:
    """Distances of points of a batch, shape (B, m), and directions, shape (B, m, 3); a mesh's by its grid."""
    if region.grid is not None:
        distance, direction = _tensors(region, p_Os.dtype, str(p_Os.device)).nearest(p_Os.transpose(1, 2))
        return distance, direction.transpose(1, 2)
    distance, direction = region.distances(p_Os.reshape(-1, 3).cpu().numpy().astype(float))
    return p_Os.new_tensor(distance).view(p_Os.shape[:-1]), p_Os.new_tensor(direction).view(p_Os.shape)


@lru_cache(maxsize=8)
def _tensors(region: Region, dtype: torch.dtype, device: str) -> TorchGrid:
    from xdex_drake.scene.grid_torch import TorchGrid

    assert region.grid is not None
    return TorchGrid(region.grid, dtype=dtype, device=device)


def region_block(region: Region, count: int) -> Block:
    """Contacts lie in a region: distance <= -`MARGIN`.

    Args:
        region: The region.
        count: Number of contacts.

    Returns:
        The block.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        distance, direction = region.distances(point.to_object(point.contacts_W))
        toward_W = direction @ point.scene.X_WO.rotation().matrix().T
        J = np.einsum("ka,kab->kb", toward_W, point.surface_jacobian)
        return MM * distance, without_forces(point, MM * J)

    low, high = np.full(count, -np.inf), np.full(count, -MM * MARGIN)
    return Block("region", evaluate, low, high, "mm", "distance of contacts from their region")


def lies_in(grasp: Grasp, region: Region) -> bool:
    """Whether all contacts of a certified grasp lie in a region."""
    assert grasp.certificate is not None
    points = np.array([contact.p_OC for contact in grasp.certificate.contacts]).reshape(-1, 3)
    return bool((region.distances(points)[0] <= 0.0).all())
