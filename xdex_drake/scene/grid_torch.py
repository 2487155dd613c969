"""The distance grid of an object as tensors, for batches of candidates."""

from __future__ import annotations

import numpy as np
import torch

from xdex_drake.scene.distance import DistanceGrid


class TorchGrid:
    """A distance grid as tensors, looked up in batches."""

    def __init__(self, grid: DistanceGrid, *, dtype: torch.dtype = torch.float32, device: str = "cpu") -> None:
        """Copies the grid.

        Args:
            grid: The grid of an object.
            dtype: Floating-point type.
            device: Torch device.
        """
        self.shape = torch.tensor(grid.values.shape, device=device)
        table = np.concatenate([grid.values[..., None], grid.gradients], axis=-1).reshape(-1, 4)
        self.table = torch.as_tensor(table, dtype=dtype, device=device)
        self.origin = torch.as_tensor(np.asarray(grid.origin), dtype=dtype, device=device)
        self.spacing = float(grid.spacing)
        self.last = (self.shape - 1).to(dtype)
        strides = np.array([grid.values.shape[1] * grid.values.shape[2], grid.values.shape[2], 1])
        self.strides = torch.as_tensor(strides, device=device)
        # The eight corners of a cell: their rows in the table from its first, and their weights sign * t + offset.
        bits = np.array([[c >> 2 & 1, c >> 1 & 1, c & 1] for c in range(8)])
        self.corner_rows = torch.as_tensor(bits @ strides, device=device)
        self.corner_signs = torch.as_tensor(2 * bits - 1, dtype=dtype, device=device)
        self.corner_offsets = torch.as_tensor(1 - bits, dtype=dtype, device=device)

    def nearest(self, x_O: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Distance by a first-order expansion about the nearest grid point: one look-up for each point.

        Args:
            x_O: Components of points in O [m], shape (B, 3, m).

        Returns:
            Signed distance [m], shape (B, m), and components of its gradient, shape (B, 3, m).
        """
        cell = ((x_O - self.origin[:, None]) * (1.0 / self.spacing)).round()
        cell = torch.minimum(cell.clamp_min(0.0), self.last[:, None])
        row = self.table.index_select(0, (cell.long() * self.strides[:, None]).sum(1).flatten())
        row = row.view(*x_O.shape[::2], 4)
        gradient = row[..., 1:].transpose(1, 2)
        away = x_O - self.origin[:, None] - cell * self.spacing
        return row[..., 0] + (gradient * away).sum(1), gradient

    def smooth(self, p_OPs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Trilinear distance and gradient, with the derivative of the gradient, for the few points that are contacts.

        Args:
            p_OPs: Points in O [m], shape (..., 3).

        Returns:
            Signed distance [m], shape (...), unit gradient, shape (..., 3), and its Jacobian, shape (..., 3, 3).
        """
        x = (p_OPs - self.origin) / self.spacing
        x = torch.minimum(x.clamp_min(0.0), self.last - 1e-3)
        cell = x.floor()
        t = (x - cell)[..., None, :]
        corner = (cell.long() * self.strides).sum(-1, keepdim=True) + self.corner_rows
        row = self.table[corner]  # (..., 8, 4)
        w = self.corner_signs * t + self.corner_offsets  # (..., 8, 3): t or 1 - t
        wx, wy, wz = w.unbind(-1)
        slope = self.corner_signs * torch.stack([wy * wz, wx * wz, wx * wy], dim=-1)
        mean = ((wx * wy * wz)[..., None] * row).sum(-2)
        value, gradient = mean[..., 0], mean[..., 1:]
        hessian = row[..., 1:].transpose(-1, -2) @ slope / self.spacing
        size = gradient.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        unit = gradient / size
        hessian = (hessian - unit[..., None] * (unit[..., None, :] @ hessian)) / size[..., None]
        return value, unit, hessian
