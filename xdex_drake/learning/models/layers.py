"""Building blocks of the model: PointNet, sparse U-Net, transformer block, topology bias. Shapes stand at line ends.

Letters: B batch, H hands, L links (padded), T links in all (without padding), N points, S clouds, V voxels, d width,
h heads.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from xdex_drake.learning.models.sparse_conv import SubmanifoldConv, VoxelGrid, coarsen, mean_by_index, voxelize
from xdex_drake.learning.protocol import LENGTH_UNIT, Clouds


def mlp(*widths: int) -> nn.Sequential:
    """Linear layers with GELU between them.

    Args:
        *widths: Width of the input, of each hidden layer and of the output.

    Returns:
        The layers.
    """
    layers: list[nn.Module] = []
    for a, b in pairwise(widths):
        layers += [nn.Linear(a, b), nn.GELU()]
    return nn.Sequential(*layers[:-1])


class Ragged(NamedTuple):
    """Sets of tokens of unequal sizes, which all layers but attention see one after the other, without padding.

    Attributes:
        inside: Place of each token among the B L places of the padded batch, shape (T,), int64.
        padded: Token of each place; some token where there is none, shape (B L,), int64.
        owner: Set of each token, shape (T,), int64.
        mask: True where a place has a token, shape (B, L).
    """

    inside: Tensor
    padded: Tensor
    owner: Tensor
    mask: Tensor

    @staticmethod
    def of(mask: Tensor) -> "Ragged":
        """Sets of the sizes that a mask shows, each with at least one token, the tokens in its row-major order."""
        flat = mask.flatten()
        inside = flat.nonzero().squeeze(1)
        padded = flat.long().cumsum(0).sub_(1).clamp_(min=0)
        return Ragged(inside, padded, inside // mask.shape[1], mask)

    def pad(self, x: Tensor) -> Tensor:
        """Tokens, shape (T, C), in their places, shape (B, L, C); other places hold some token."""
        return _Select.apply(x, self.padded, self.inside).view(*self.mask.shape, -1)  # type: ignore[union-attr]

    def unpad(self, x: Tensor) -> Tensor:
        """The tokens of places, shape (B, L, C) to (T, C)."""
        return _Select.apply(x.flatten(0, 1), self.inside, None)  # type: ignore[return-value]

    def bias(self) -> Tensor:
        """Attention bias that hides padding: 0 for real keys and -inf for padded ones, shape (B, 1, 1, L)."""
        zero = torch.zeros(self.mask.shape, dtype=torch.float32, device=self.mask.device)
        return zero.masked_fill(~self.mask, -torch.inf)[:, None, None, :]


class _Select(torch.autograd.Function):
    """Rows of x, none of which counts twice: the adjoint moves rows and never adds."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, rows: Tensor, back: Tensor | None) -> Tensor:
        ctx.rows, ctx.back, ctx.length = rows, back, len(x)
        return x.index_select(0, rows)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, None, None]:
        (grad,) = grad_outputs
        if ctx.back is not None:  # what padding holds is hidden from attention and dropped: its gradient is zero
            return grad.index_select(0, ctx.back), None, None
        return grad.new_zeros(ctx.length, grad.shape[1]).index_copy_(0, ctx.rows, grad), None, None


class PointNet(nn.Module):
    """One feature for a set of points: a shared MLP, the maximum over the points, an MLP (Qi et al. 2017)."""

    def __init__(self, channels_in: int, width: int, beside: int = 0) -> None:
        """Make the network.

        Args:
            channels_in: Channels of a point.
            width: Width of the feature.
            beside: Number of what is known of a set besides its points.
        """
        super().__init__()
        self.shared = mlp(channels_in, 64, width)
        self.after = mlp(width + beside, width, width)

    def forward(self, points: Tensor, beside: Tensor | None = None) -> Tensor:
        """Describe sets of points.

        Args:
            points: Points, shape (..., N, channels_in).
            beside: What else is known of each set, shape (..., beside).

        Returns:
            Features, shape (..., width).
        """
        most = self.shared(points).amax(dim=-2)
        return self.after(most if beside is None else torch.cat([most, beside], dim=-1))


class TopologyBias(nn.Module):
    """A learned scalar for each head and shortest-path distance, added to attention scores (Ying et al. 2021).

    Distances beyond the table share its last entry.
    """

    def __init__(self, heads: int, max_distance: int) -> None:
        """Make the table.

        Args:
            heads: Number of attention heads.
            max_distance: Greatest distance with an entry of its own.
        """
        super().__init__()
        self.table = nn.Parameter(torch.randn(max_distance + 1, heads) * 0.02)

    def forward(self, spd: Tensor) -> Tensor:
        """Look the biases up.

        Args:
            spd: Shortest-path distances between links, shape (H, L, L), int64.

        Returns:
            Biases, shape (H, heads, L, L).
        """
        # index_select, here and below: its gradient adds in one order, so training repeats exactly on many threads.
        index = spd.clamp(max=len(self.table) - 1)
        return self.table.index_select(0, index.flatten()).view(*index.shape, -1).permute(0, 3, 1, 2)


class Block(nn.Module):
    """A transformer block, normalised before each part; with a source token it is a decoder block.

    There is one source token, so softmax over the source is 1 whatever the query: cross-attention is exactly a linear
    map of the token, and is written as that.
    """

    def __init__(self, width: int, heads: int, source_width: int = 0) -> None:
        """Make the block.

        Args:
            width: Width of the tokens.
            heads: Number of heads.
            source_width: Width of the source token; 0 in an encoder.
        """
        super().__init__()
        self.heads = heads
        self.norm_1, self.norm_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width)
        self.project = nn.Linear(width, width)
        self.cross = nn.Linear(source_width, width) if source_width else None
        self.feed_forward = mlp(width, 2 * width, width)

    def forward(self, x: Tensor, sets: Ragged, bias: Tensor, source: Tensor | None = None) -> Tensor:
        """Transform the tokens.

        Args:
            x: Tokens, shape (T, d).
            sets: Which tokens attend to each other.
            bias: Added to attention scores, -inf hides a key, broadcastable to shape (B, h, L, L).
            source: The source token of each set, shape (B, source_width); None in an encoder.

        Returns:
            Tokens, shape (T, d).
        """
        B, L = sets.mask.shape
        d = x.shape[-1]
        qkv = sets.pad(self.qkv(self.norm_1(x))).view(B, L, 3, self.heads, d // self.heads)
        q, k, v = qkv.float().permute(2, 0, 3, 1, 4)  # each (B, h, L, d / h)
        with torch.autocast(x.device.type, enabled=False):  # in 16 bits its adjoint is ten times as slow on a CPU
            attended = F.scaled_dot_product_attention(q, k, v, attn_mask=bias.expand(B, self.heads, L, L))
        x = x + self.project(sets.unpad(attended.transpose(1, 2).reshape(B, L, d)))
        if self.cross is not None and source is not None:
            x = x + self.cross(source).index_select(0, sets.owner)
        return x + self.feed_forward(self.norm_2(x))


class SparseBlock(nn.Module):
    """Two submanifold convolutions around a residual connection, each voxel normalised over its channels."""

    def __init__(self, channels: int) -> None:
        """Make the block.

        Args:
            channels: Channels of input and output.
        """
        super().__init__()
        self.norm_1, self.norm_2 = nn.LayerNorm(channels), nn.LayerNorm(channels)
        self.conv_1, self.conv_2 = SubmanifoldConv(channels, channels), SubmanifoldConv(channels, channels)

    def forward(self, x: Tensor, grid: VoxelGrid) -> Tensor:
        """Transform features of the voxels, shape (V, C), to the same shape."""
        y = self.conv_1(F.gelu(self.norm_1(x)), grid)
        return x + self.conv_2(F.gelu(self.norm_2(y)), grid)


POINT_CHANNELS = 7
"""Numbers that a point of an object brings: its place within its voxel, its normal, its height over the table."""


class SparseUNet(nn.Module):
    """Per-point features of an object: a U-Net over voxels of one, two, four, ... times the edge.

    Where the object stands on the table plays no part, but for the raster of the voxels.
    """

    def __init__(self, channels: tuple[int, ...], width: int, voxel_size: float) -> None:
        """Make the network.

        Args:
            channels: Channels of each level, the finest first.
            width: Width of a point's feature.
            voxel_size: Edge of the finest voxels [m].
        """
        super().__init__()
        self.voxel_size = voxel_size
        self.enter = nn.Linear(POINT_CHANNELS, channels[0])
        self.down = nn.ModuleList([SparseBlock(c) for c in channels])
        self.widen = nn.ModuleList([nn.Linear(a, b) for a, b in pairwise(channels)])
        self.merge = nn.ModuleList([nn.Linear(a + b, a) for a, b in pairwise(channels)])
        self.up = nn.ModuleList([SparseBlock(c) for c in channels[:-1]])
        self.leave = mlp(channels[0] + POINT_CHANNELS, width, width)

    def inputs(self, clouds: Clouds, within: Tensor) -> Tensor:
        """What is known of every point.

        Args:
            clouds: The objects.
            within: Place of each point within its voxel, in units of its edge, shape (S N, 3).

        Returns:
            Inputs, shape (S N, 7).
        """
        height = (clouds.points[..., 2] - clouds.tables[:, None]).flatten()[:, None]
        return torch.cat([within, clouds.normals.flatten(0, 1), height / LENGTH_UNIT], dim=1)

    def forward(self, clouds: Clouds) -> Tensor:
        """Describe every point.

        Args:
            clouds: The objects.

        Returns:
            Features, shape (S, N, width).
        """
        S, N, _ = clouds.points.shape
        flat = clouds.points.reshape(S * N, 3)
        batch = torch.arange(S, device=flat.device).repeat_interleave(N)
        grid, voxel = voxelize(flat, batch, self.voxel_size)
        inputs = self.inputs(clouds, flat / self.voxel_size - grid.cells[voxel, 1:] - 0.5)

        x = self.enter(mean_by_index(inputs, voxel, len(grid.cells)))  # (V, C0)
        skips: list[tuple[Tensor, VoxelGrid, Tensor]] = []
        for level, block in enumerate(self.down):
            x = block(x, grid)
            if level < len(self.widen):
                coarse, parent = coarsen(grid)
                skips.append((x, grid, parent))
                x = self.widen[level](mean_by_index(x, parent, len(coarse.cells)))
                grid = coarse
        for level in reversed(range(len(self.up))):
            skip, grid, parent = skips[level]
            x = self.up[level](self.merge[level](torch.cat([skip, x.index_select(0, parent)], dim=1)), grid)
        return self.leave(torch.cat([x.index_select(0, voxel), inputs], dim=1)).view(S, N, -1)
