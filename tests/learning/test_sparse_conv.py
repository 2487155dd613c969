import numpy as np
import pytest
import torch

from xdex_drake.learning.models.layers import SparseUNet
from xdex_drake.learning.models.sparse_conv import SubmanifoldConv, coarsen, make_grid, mean_by_index, voxelize
from xdex_drake.learning.protocol import Clouds


def _cloud(points: torch.Tensor) -> Clouds:
    normals = torch.nn.functional.normalize(points + 0.01, dim=-1)
    return Clouds(points, normals, torch.full((len(points),), -0.03))


def _cells(seed: int = 0) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    cells = np.concatenate([rng.integers(0, 2, (300, 1)), rng.integers(-4, 4, (300, 3))], axis=1)
    return torch.as_tensor(cells)


def _dense(grid, x, layer):
    """The same layer by `conv3d` on the dense grid, read at the voxels."""
    volume = x.new_zeros(2, x.shape[1], 8, 8, 8)
    b, i, j, k = (grid.cells + torch.tensor([0, 4, 4, 4])).unbind(1)
    volume = volume.index_put((b, torch.arange(x.shape[1])[:, None], i, j, k), x.T)
    kernel = layer.weight.view(3, 3, 3, *layer.weight.shape[1:]).permute(4, 3, 0, 1, 2)
    out = torch.nn.functional.conv3d(volume, kernel, layer.bias, padding=1)
    return out[b, :, i, j, k]


def test_equals_conv3d_with_its_gradients():
    grid, _ = make_grid(_cells())
    torch.manual_seed(0)
    layer = SubmanifoldConv(5, 7).double()
    x = torch.randn(len(grid.cells), 5, dtype=torch.float64, requires_grad=True)
    weights = torch.randn(len(grid.cells), 7, dtype=torch.float64)
    results = []
    for y in (layer(x, grid), _dense(grid, x, layer)):
        results.append((y, *torch.autograd.grad((y * weights).sum(), [x, layer.weight, layer.bias])))
    for sparse, dense in zip(*results, strict=True):
        torch.testing.assert_close(sparse, dense, rtol=0.0, atol=1e-10)


def test_voxels_of_points():
    points = torch.tensor([[0.001, 0.001, 0.001], [0.004, 0.0, 0.0], [-0.001, 0.0, 0.0], [0.001, 0.001, 0.001]])
    grid, index = voxelize(points, torch.tensor([0, 0, 0, 1]), 0.005)
    assert grid.cells.tolist() == [[0, -1, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0]]
    assert index.tolist() == [1, 1, 0, 2]
    coarse, parent = coarsen(grid)
    assert coarse.cells.tolist() == [[0, -1, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0]]
    assert parent.tolist() == [0, 1, 2]


def test_clouds_of_a_batch_do_not_touch():
    torch.manual_seed(0)
    net = SparseUNet((8, 8), 16, 0.005).eval()
    rng = np.random.default_rng(0)
    clouds = torch.as_tensor(rng.uniform(-0.03, 0.03, (3, 100, 3)), dtype=torch.float32)
    together = net(_cloud(clouds))
    for k in range(3):
        torch.testing.assert_close(net(_cloud(clouds[k : k + 1]))[0], together[k], rtol=0.0, atol=1e-5)


def test_features_follow_a_permutation_of_the_points():
    torch.manual_seed(0)
    net = SparseUNet((8, 8), 16, 0.005).eval()
    rng = np.random.default_rng(0)
    cloud = torch.as_tensor(rng.uniform(-0.03, 0.03, (1, 200, 3)), dtype=torch.float32)
    order = torch.as_tensor(rng.permutation(200))
    torch.testing.assert_close(net(_cloud(cloud[:, order])), net(_cloud(cloud))[:, order], rtol=0.0, atol=1e-5)


def test_mean_by_index():
    x = torch.tensor([[1.0], [3.0], [5.0]])
    assert mean_by_index(x, torch.tensor([0, 1, 0]), 2).tolist() == [[3.0], [3.0]]


def test_bad_clouds_are_refused():
    with pytest.raises(ValueError, match="at least one point"):
        make_grid(torch.zeros(0, 4, dtype=torch.int64))
    with pytest.raises(ValueError, match="in metres"):
        voxelize(torch.tensor([[0.0, 0.0, 0.0], [1e6, 1e6, 1e6]]), torch.tensor([0, 0]), 0.001)
