"""Building blocks of the model: PointNet, sparse U-Net, transformer block, topology bias. Shapes stand at line ends.

Letters: B batch, H hands, L links (padded), N points, S clouds, V voxels, d width, h heads.
"""

from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from xdex_drake.learning.models.sparse_conv import SubmanifoldConv, VoxelGrid, coarsen, mean_by_index, voxelize

LENGTH_UNIT = 0.1
"""Metres that make one unit inside the networks."""


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


class PointNet(nn.Module):
    """One feature for a set of points: a shared MLP, the maximum over the points, an MLP (Qi et al. 2017)."""

    def __init__(self, channels_in: int, width: int) -> None:
        """Make the network.

        Args:
            channels_in: Channels of a point.
            width: Width of the feature.
        """
        super().__init__()
        self.shared = mlp(channels_in, width // 2, width)
        self.after = mlp(width, width, width)

    def forward(self, points: Tensor) -> Tensor:
        """Describe sets of points.

        Args:
            points: Points, shape (..., N, channels_in).

        Returns:
            Features, shape (..., width).
        """
        return self.after(self.shared(points).amax(dim=-2))


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


def padding_bias(mask: Tensor) -> Tensor:
    """Attention bias that hides padding.

    Args:
        mask: True where a link is real, shape (B, L).

    Returns:
        0 for real keys and -inf for padded ones, shape (B, 1, 1, L).
    """
    zero = torch.zeros(mask.shape, dtype=torch.float32, device=mask.device)
    return zero.masked_fill(~mask, -torch.inf)[:, None, None, :]


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

    def forward(self, x: Tensor, bias: Tensor, source: Tensor | None = None) -> Tensor:
        """Transform the tokens.

        Args:
            x: Tokens, shape (B, L, d).
            bias: Added to attention scores, -inf hides a key, broadcastable to shape (B, h, L, L).
            source: The source token, shape (B, source_width); None in an encoder.

        Returns:
            Tokens, shape (B, L, d).
        """
        B, L, d = x.shape
        qkv = self.qkv(self.norm_1(x)).view(B, L, 3, self.heads, d // self.heads)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)  # each (B, h, L, d / h)
        attended = F.scaled_dot_product_attention(q, k, v, attn_mask=bias.expand(B, self.heads, L, L))
        x = x + self.project(attended.transpose(1, 2).reshape(B, L, d))
        if self.cross is not None and source is not None:
            x = x + self.cross(source)[:, None, :]
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


class SparseUNet(nn.Module):
    """Per-point features of an object: a U-Net over voxels of one, two and four times the edge."""

    def __init__(self, channels: tuple[int, ...], width: int, voxel_size: float) -> None:
        """Make the network.

        Args:
            channels: Channels of each level, the finest first.
            width: Width of a point's feature.
            voxel_size: Edge of the finest voxels [m].
        """
        super().__init__()
        self.voxel_size = voxel_size
        self.enter = nn.Linear(7, channels[0])
        self.down = nn.ModuleList([SparseBlock(c) for c in channels])
        self.widen = nn.ModuleList([nn.Linear(a, b) for a, b in pairwise(channels)])
        self.merge = nn.ModuleList([nn.Linear(a + b, a) for a, b in pairwise(channels)])
        self.up = nn.ModuleList([SparseBlock(c) for c in channels[:-1]])
        self.leave = mlp(channels[0] + 7, width, width)

    def forward(self, points: Tensor) -> Tensor:
        """Describe every point.

        Args:
            points: Clouds relative to the object's center, axes of W [m], shape (S, N, 3).

        Returns:
            Features, shape (S, N, width).
        """
        S, N, _ = points.shape
        flat = points.reshape(S * N, 3)
        batch = torch.arange(S, device=points.device).repeat_interleave(N)
        grid, voxel = voxelize(flat, batch, self.voxel_size)

        # A point is its position, its place within the voxel, and its height over the lowest point (the table).
        within = flat / self.voxel_size - grid.cells[voxel, 1:] - 0.5
        height = (points[..., 2] - points[..., 2].amin(dim=1, keepdim=True)).reshape(S * N, 1)
        inputs = torch.cat([flat / LENGTH_UNIT, within, height / LENGTH_UNIT], dim=1)  # (S N, 7)

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
