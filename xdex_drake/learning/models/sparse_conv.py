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

CENTER = 13
"""Index of the center among the 27 cells of a 3 x 3 x 3 kernel, z fastest."""


@dataclass(frozen=True)
class VoxelGrid:
    """The occupied voxels of a batch of clouds, and which of them touch.

    Attributes:
        cells: Cloud index and integer coordinates (b, x, y, z) of each voxel, sorted, shape (V, 4), int64.
        outputs: For each of the 27 kernel cells, the voxels that have a neighbor there; 27 tensors of int64.
        inputs: For each of the 27 kernel cells, that neighbor, in the same order.
    """

    cells: Tensor
    outputs: tuple[Tensor, ...]
    inputs: tuple[Tensor, ...]


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
    offsets = ((step[:, None, None] * ny + step[None, :, None]) * nz + step).reshape(27, 1)
    wanted = keys + offsets  # (27, V)
    found = torch.searchsorted(keys, wanted).clamp_(max=len(keys) - 1)
    present = keys[found] == wanted
    kernel_cell, outputs = present.nonzero(as_tuple=True)
    counts = torch.bincount(kernel_cell, minlength=27).tolist()

    rest, z = keys // nz, keys % nz
    rest, y = rest // ny, rest % ny
    distinct = torch.stack([rest // nx, rest % nx, y, z], dim=1) + low
    return VoxelGrid(distinct, outputs.split(counts), found[present].split(counts)), index


class _Convolution(torch.autograd.Function):
    """Sum over kernel cells k of x[inputs_k] W_k, scattered to outputs_k.

    Within one kernel cell each voxel occurs once among the inputs and once among the outputs, so sums have one order on
    any device and results repeat exactly.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, grid: VoxelGrid) -> Tensor:
        ctx.save_for_backward(x, weight)
        ctx.grid = grid
        out = x @ weight[CENTER]
        for k, (inputs, outputs) in enumerate(zip(grid.inputs, grid.outputs, strict=True)):
            if k != CENTER:
                out.index_add_(0, outputs, x.index_select(0, inputs) @ weight[k])
        return out

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, Tensor, None]:
        x, weight = ctx.saved_tensors
        grad = grad_outputs[0].contiguous()
        grad_x, grad_weight = grad @ weight[CENTER].T, torch.empty_like(weight)
        for k, (inputs, outputs) in enumerate(zip(ctx.grid.inputs, ctx.grid.outputs, strict=True)):
            if k == CENTER:
                grad_weight[k] = x.T @ grad
                continue
            grad_k = grad.index_select(0, outputs)
            grad_weight[k] = x.index_select(0, inputs).T @ grad_k
            grad_x.index_add_(0, inputs, grad_k @ weight[k].T)
        return grad_x, grad_weight, None


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
        self.weight = nn.Parameter(torch.randn(27, channels_in, channels_out) * scale)
        self.bias = nn.Parameter(torch.zeros(channels_out))

    def forward(self, x: Tensor, grid: VoxelGrid) -> Tensor:
        """Convolve.

        Args:
            x: Features of the voxels, shape (V, in).
            grid: The voxels and their neighbors.

        Returns:
            Features of the same voxels, shape (V, out).
        """
        return _Convolution.apply(x, self.weight, grid) + self.bias  # type: ignore[operator]


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
