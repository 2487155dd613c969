"""The batched search: its gradient, its results, its determinism."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from xdex_drake.hand.batched_kinematics import rotation_step
from xdex_drake.hand.library import load_hand
from xdex_drake.programs.search import SearchSettings, evaluate, sample_starts, search, search_problem
from xdex_drake.programs.terms import EQ_1
from xdex_drake.programs.terms.force_closure import NormalClosure
from xdex_drake.scene.grid_torch import TorchGrid


def test_torch_grid_agrees_with_numpy(can_scene):
    grid = can_scene.object.grid
    rng = np.random.default_rng(0)
    points = rng.uniform(grid.origin, grid.upper, size=(200, 3))
    d, n, H = grid.smooth(points)
    td, tn, tH = TorchGrid(grid, dtype=torch.float64).smooth(torch.as_tensor(points))
    assert np.abs(d - td.numpy()).max() < 1e-9
    assert np.abs(n - tn.numpy()).max() < 1e-9
    assert np.abs(H - tH.numpy()).max() < 1e-6 * max(1.0, np.abs(H).max())
    # The derivative that comes with the normals is theirs.
    h = 1e-7
    for axis in range(3):
        step = h * np.eye(3)[axis]
        differences = (grid.smooth(points + step)[1] - grid.smooth(points - step)[1]) / (2 * h)
        ok = np.abs(differences - H[:, :, axis]).max(axis=1) < 1e-2 * (1.0 + np.abs(H[:, :, axis]).max(axis=1))
        assert ok.mean() > 0.98  # a step may cross the border of a cell


BY_NORMALS = (NormalClosure(), *EQ_1[1:])
"""Eq. (1) by the paper's estimator: forces that turn with the surface, so that the whole energy can be differenced."""


class Ball:
    """The distance of a ball in closed form, in place of a grid."""

    def __init__(self, center, radius):
        self.center, self.radius = torch.as_tensor(np.asarray(center, dtype=float)), radius

    def nearest(self, x):
        d, n, _ = self.smooth(x.transpose(1, 2))
        return d, n.transpose(1, 2)

    def smooth(self, p):
        away = p - self.center
        size = away.norm(dim=-1)
        d, n = size - self.radius, away / size[..., None]
        across = torch.eye(3, dtype=p.dtype) - n[..., :, None] * n[..., None, :]
        return d, n, across / (d + self.radius)[..., None, None]


@pytest.mark.parametrize("name", ["allegro", "ability"])
def test_the_gradient_agrees_with_differences(name, can_scene):
    hand = load_hand(name)
    problem = search_problem(hand, can_scene, replace(SearchSettings(), terms=BY_NORMALS), dtype=torch.float64)
    problem = replace(problem, grid=Ball(can_scene.object.p_OOcm, 0.04))
    state = sample_starts(problem, hand, can_scene, 8, 0)
    # Away from the kink at the limits, where starts are clipped to.
    state.q = torch.minimum(torch.maximum(state.q, problem.batched.limits[0] + 1e-3), problem.batched.limits[1] - 1e-3)
    _, gradient, _ = evaluate(problem, copy.copy(state))
    n, h = 6 + state.q.shape[1], 1e-7
    numeric = torch.zeros_like(gradient)
    for c in range(n):
        values = []
        for sign in (h, -h):
            d = torch.zeros((len(gradient), n), dtype=torch.float64)
            d[:, c] = sign
            moved = copy.copy(state)
            moved.R_WH = rotation_step(state.R_WH, d[:, :3])
            moved.p_WH, moved.q = state.p_WH + d[:, 3:6], state.q + d[:, 6:]
            values.append(evaluate(problem, moved)[0])
        numeric[:, c] = (values[0] - values[1]) / (2 * h)
    error = (gradient - numeric).abs().max(dim=1).values / numeric.abs().max(dim=1).values
    assert float(error.max()) < 1e-5


def test_search_lowers_the_energy_and_repeats(allegro, can_scene):
    settings = replace(SearchSettings(), iterations=40)
    first = search(allegro, can_scene, count=16, seed=3, settings=settings)
    again = search(allegro, can_scene, count=16, seed=3, settings=settings)
    start = search(allegro, can_scene, count=16, seed=3, settings=replace(settings, iterations=0))
    assert np.median(first.energy) < 0.2 * np.median(start.energy)
    assert np.all(np.diff(first.energy) >= 0.0)
    assert np.array_equal(first.qs, again.qs)
    assert np.all((first.qs >= allegro.limits[0] - 1e-6) & (first.qs <= allegro.limits[1] + 1e-6))
    assert first.fingers[:, 0].all()  # the thumb always touches
