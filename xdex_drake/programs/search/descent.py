"""The descent: Adam on the tangent, from random starts or from given ones."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import torch

from xdex_drake.arrays import Array
from xdex_drake.errors import ConfigError
from xdex_drake.hand.batched_kinematics import rotation_step
from xdex_drake.hand.description import Hand
from xdex_drake.programs.search.candidates import Candidates, State, candidates_of_state
from xdex_drake.programs.search.problem import SearchProblem, search_problem
from xdex_drake.programs.search.settings import SearchSettings
from xdex_drake.programs.search.starts import sample_starts
from xdex_drake.programs.search.view import evaluate
from xdex_drake.scene.tabletop import Scene


def descend(problem: SearchProblem, state: State) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """Adam on the tangent, in place; joints are clipped to their limits.

    Part of the way down, candidates of high energy are dropped: hardly one of them is ever certified.

    Args:
        problem: The problem.
        state: The candidates, moved in place; `settings.survivors` of them are left, in their order.

    Returns:
        Energy at the end, shape (B,), and its unweighted terms.
    """
    settings = problem.settings
    n = state.q.shape[1]
    first = torch.tensor(
        [settings.rotation_step] * 3 + [settings.translation_step] * 3 + [settings.joint_step] * n,
        dtype=state.q.dtype,
        device=state.q.device,
    )
    m = torch.zeros((state.q.shape[0], 6 + n), dtype=state.q.dtype, device=state.q.device)
    v = torch.zeros_like(m)
    low, high = problem.batched.limits
    halfway = round(settings.halfway * settings.iterations)
    for k in range(settings.iterations):
        energy, gradient, _ = evaluate(problem, state)
        if k == halfway and settings.survivors < 1.0:
            rows = torch.argsort(energy)[: max(1, round(settings.survivors * len(energy)))].sort().values
            state.keep(rows)
            gradient, m, v = gradient[rows], m[rows], v[rows]
        m = 0.9 * m + 0.1 * gradient
        v = 0.98 * v + 0.02 * gradient * gradient
        rate = first * (0.03 + 0.97 * 0.5 * (1.0 + np.cos(np.pi * k / settings.iterations)))
        step = -rate * (m / (1.0 - 0.9 ** (k + 1))) / ((v / (1.0 - 0.98 ** (k + 1))).sqrt() + 1e-6)
        state.R_WH = rotation_step(state.R_WH, step[:, :3])
        state.p_WH = state.p_WH + step[:, 3:6]
        state.q = torch.minimum(torch.maximum(state.q + step[:, 6:], low), high)
    energy, _, values = evaluate(problem, state)
    return energy, values


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread for torch: tensors of this size gain nothing from more, and on a busy machine lose much by waiting."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def search(
    hand: Hand,
    scene: Scene,
    *,
    count: int = 64,
    seed: int = 0,
    settings: SearchSettings | None = None,
    device: str = "cpu",
) -> Candidates:
    """Descends a batch of random starts.

    Args:
        hand: The hand.
        scene: The scene.
        count: Number of starts.
        seed: Seed.
        settings: Settings; the defaults where None.
        device: Torch device.

    Returns:
        The candidates that are left of them (`settings.survivors`), lowest energy first.

    Raises:
        ConfigError: `count` is less than 1.
    """
    if count < 1:
        raise ConfigError(f"a search of {count} starts finds nothing; give 1 or more")
    problem = search_problem(hand, scene, settings, device=device)
    with torch.no_grad(), _one_thread():
        state = sample_starts(problem, hand, scene, count, seed)
        energy, values = descend(problem, state)
    order = torch.argsort(energy)
    return candidates_of_state(state, energy, values, order)


def refine(
    hand: Hand, scene: Scene, starts: Candidates, *, settings: SearchSettings, device: str = "cpu"
) -> Candidates:
    """Descends given starts, such as a model's predictions.

    Args:
        hand: The hand.
        scene: The scene.
        starts: Where to start, with the fingers that shall touch.
        settings: Settings.
        device: Torch device.

    Returns:
        The candidates, in the order of the starts.
    """
    problem = search_problem(hand, scene, replace(settings, survivors=1.0), device=device)

    def tensor(values: Array) -> torch.Tensor:
        return torch.tensor(values, dtype=problem.batched.dtype, device=device)

    fingers = tensor(starts.fingers.astype(float))
    forces = torch.zeros((*fingers.shape, 3), dtype=fingers.dtype, device=device)
    with torch.no_grad(), _one_thread():
        state = State(tensor(starts.R_WHs), tensor(starts.p_WHs), tensor(starts.qs), fingers, forces)
        energy, values = descend(problem, state)
    return candidates_of_state(state, energy, values, torch.arange(len(energy), device=device))
