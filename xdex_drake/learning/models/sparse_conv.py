"""Submanifold sparse 3-D convolution in plain torch, on CPU and GPU.

Features live on the occupied voxels only, and stay there: the output of a layer is read at the same voxels (Graham and
van der Maaten, "Submanifold sparse convolutional networks", 2017). On those voxels it equals
`torch.nn.functional.conv3d` of the dense grid. Which voxels are neighbors is found once for a batch of clouds, and all
layers share it.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

KERNEL = 27
"""Cells of a 3 x 3 x 3 kernel, z fastest; cell 26 - k lies opposite of cell k."""


@dataclass(frozen=True)
class VoxelGrid:
    """The occupied voxels of a batch of clouds, and which of them touch.

    Attributes:
        cells: Cloud index and integer coordinates (b, x, y, z) of each voxel, sorted, shape (V, 4), int64.
        neighbors: The voxel at each of the 27 kernel cells around each voxel, V where none is, shape (V, 27), int64.
    """

    cells: Tensor
    neighbors: Tensor


def voxelize(points: Tensor, batch: Tensor, size: float) -> tuple[VoxelGrid, Tensor]:
    """Voxels of a batch of clouds; the voxel grid is aligned with the origin.

    Args:
        points: Points of all clouds, one after the other [m], shape (P, 3).
        batch: Index of each point's cloud, shape (P,), int64.
        size: Edge of a voxel [m].

    Returns:
        The grid, and the voxel of each point, shape (P,).
    """
    cells = torch.cat([batch[:, None], torch.floor(points / size).long()], dim=1)
    return make_grid(cells)


def coarsen(grid: VoxelGrid) -> tuple[VoxelGrid, Tensor]:
    """Voxels of twice the edge.

    Args:
        grid: The fine grid.

    Returns:
        The coarse grid, and the coarse voxel of each fine one, shape (V,).
    """
    halves = torch.cat([grid.cells[:, :1], torch.div(grid.cells[:, 1:], 2, rounding_mode="floor")], dim=1)
    return make_grid(halves)


def make_grid(cells: Tensor) -> tuple[VoxelGrid, Tensor]:
    """Grid of the distinct cells, with its neighbors.

    Args:
        cells: Rows (cloud, x, y, z), repeats allowed, shape (P, 4), int64.

    Returns:
        The grid, and the voxel of each row, shape (P,).

    Raises:
        ValueError: There are no cells, or they spread too far to be numbered by 64 bits.
    """
    if len(cells) == 0:
        raise ValueError("a voxel grid needs at least one point")
    low = cells.amin(dim=0)
    low[1:] -= 1  # an empty margin, so that no neighbor's key can wrap into the next row or the next cloud
    nb, nx, ny, nz = (int(n) for n in (cells.amax(dim=0) - low + 2).tolist())
    if nb * nx * ny * nz >= 2**62:
        raise ValueError("the points spread too far for the voxel size; are they in metres?")
    b, x, y, z = (cells - low).unbind(dim=1)
    keys, index = torch.unique(((b * nx + x) * ny + y) * nz + z, return_inverse=True)

    step = torch.arange(-1, 2, device=cells.device)
    offsets = ((step[:, None, None] * ny + step[None, :, None]) * nz + step).reshape(1, KERNEL)
    wanted = keys[:, None] + offsets  # (V, 27)
    found = torch.searchsorted(keys, wanted).clamp_(max=len(keys) - 1)
    neighbors = torch.where(keys[found] == wanted, found, len(keys))

    rest, z = keys // nz, keys % nz
    rest, y = rest // ny, rest % ny
    distinct = torch.stack([rest // nx, rest % nx, y, z], dim=1) + low
    return VoxelGrid(distinct, neighbors), index


class _Convolution(torch.autograd.Function):
    """Sum over kernel cells k of x[neighbors_k] W_k: one gather and one matrix product.

    If v is the neighbor of u at cell k, u is that of v at cell 26 - k: the adjoint is the same gather with the mirrored
    kernel, so nothing is ever scattered, and sums have one order.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, neighbors: Tensor) -> Tensor:
        around = _gather(x, neighbors)
        ctx.save_for_backward(around, weight, neighbors)
        return around @ weight.flatten(0, 1)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, Tensor, None]:
        around, weight, neighbors = ctx.saved_tensors
        grad = grad_outputs[0].contiguous()
        grad_weight = (around.T @ grad).view(weight.shape)
        if not ctx.needs_input_grad[0]:
            return None, grad_weight, None
        mirrored = weight.flip(0).transpose(1, 2).flatten(0, 1)  # (27 out, in)
        return _gather(grad, neighbors) @ mirrored, grad_weight, None


def _gather(x: Tensor, neighbors: Tensor) -> Tensor:
    """Features of the 27 cells around each voxel, zero where none is, shape (V, 27 C)."""
    padded = torch.cat([x, x.new_zeros(1, x.shape[1])])
    return padded.index_select(0, neighbors.flatten()).view(len(x), -1)


class SubmanifoldConv(nn.Module):
    """A 3 x 3 x 3 convolution over the occupied voxels, with bias.

    The weight has shape (27, in, out); `weight[9 (i + 1) + 3 (j + 1) + (k + 1)]` multiplies the neighbor at (i, j, k).
    """

    def __init__(self, channels_in: int, channels_out: int) -> None:
        """Make the layer.

        Args:
            channels_in: Channels of the input.
            channels_out: Channels of the output.
        """
        super().__init__()
        # On a surface about nine of the 27 cells are occupied: they, not all 27, are the fan-in.
        scale = (2.0 / (9 * channels_in)) ** 0.5
        self.weight = nn.Parameter(torch.randn(KERNEL, channels_in, channels_out) * scale)
        self.bias = nn.Parameter(torch.zeros(channels_out))

    def forward(self, x: Tensor, grid: VoxelGrid) -> Tensor:
        """Convolve.

        Args:
            x: Features of the voxels, shape (V, in).
            grid: The voxels and their neighbors.

        Returns:
            Features of the same voxels, shape (V, out).
        """
        weight = self.weight
        if torch.is_autocast_enabled(x.device.type):  # which cannot see into a function with an adjoint of its own
            half = torch.get_autocast_dtype(x.device.type)
            x, weight = x.to(half), weight.to(half)
        return _Convolution.apply(x, weight, grid.neighbors) + self.bias  # type: ignore[operator]


def mean_by_index(x: Tensor, index: Tensor, count: int) -> Tensor:
    """Mean of the rows that share an index.

    Args:
        x: Rows, shape (P, C).
        index: Group of each row, shape (P,), int64.
        count: Number of groups, each with at least one row.

    Returns:
        Means, shape (count, C).
    """
    total = x.new_zeros(count, x.shape[1]).index_add(0, index, x)
    return total / torch.bincount(index, minlength=count)[:, None]
