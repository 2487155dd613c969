"""Objectives and Newton's method: derivatives against finite differences, bounds, the published values."""

import numpy as np
import pytest

import xdex_drake as xd
from xdex_drake.retargeting.chains import Chains
from xdex_drake.retargeting.clip import reach_grasp_lift
from xdex_drake.retargeting.descent import Problem, bounded_step, look, slopes
from xdex_drake.retargeting.keypoints import in_wrist_frame, wrist_frames
from xdex_drake.retargeting.objectives import OBJECTIVES, make_objective, make_targets, start_pinches

CLIP = reach_grasp_lift(seconds=1.0, frames_per_second=10)
P_H = in_wrist_frame(CLIP.points, *wrist_frames(CLIP.points, "right"))


def _problem(name, objective, middles=False, smoothing=0.0):
    hand = xd.load_hand(name)
    aim = make_objective(hand, objective, middles=middles)
    return Problem(Chains.of(hand, aim.links, aim.p_LPs), aim, smoothing, 20, 1e-3)


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("name", ["schunk_svh", "allegro"])
def test_derivatives_are_those_of_finite_differences(name, objective):
    problem = _problem(name, objective, middles=objective == "vector", smoothing=1e-3)
    low, high = problem.chains.hand.limits
    rng = np.random.default_rng(0)
    q = low + rng.uniform(0.2, 0.8, (len(P_H), len(low))) * (high - low)
    before = np.tile(problem.chains.hand.q_rest, (len(P_H), 1))
    targets, _ = make_targets(problem.objective, P_H, 1.2, start_pinches(problem.objective, len(P_H)))
    exact = np.ones(len(q))
    g, H = slopes(problem, q, before, targets, look(problem, q, before, targets), exact)
    h = 1e-6
    for k in range(q.shape[1]):
        step = h * np.eye(q.shape[1])[k]
        there, back = (look(problem, q + s * step, before, targets) for s in (1.0, -1.0))
        np.testing.assert_allclose(g[:, k], (there.cost - back.cost) / (2.0 * h), atol=1e-8)
        g_there, _ = slopes(problem, q + step, before, targets, there, exact)
        g_back, _ = slopes(problem, q - step, before, targets, back, exact)
        error = np.abs(H[:, :, k] - (g_there - g_back) / (2.0 * h)).max(axis=1)
        # Where a residual passes beta in between, the second derivative jumps.
        assert np.median(error) < 1e-7 and np.sort(error)[-2] < 1e-6


def test_the_safe_matrix_is_never_indefinite():
    problem = _problem("shadow", "dexpilot")
    low, high = problem.chains.hand.limits
    q = low + np.random.default_rng(1).random((len(P_H), len(low))) * (high - low)
    targets, _ = make_targets(problem.objective, P_H, 1.2, start_pinches(problem.objective, len(P_H)))
    _, H = slopes(problem, q, q, targets, look(problem, q, q, targets), np.zeros(len(q)))
    assert np.linalg.eigvalsh(H).min() > -1e-10


@pytest.mark.parametrize(("objective", "beta"), [("position", 0.02), ("vector", 0.02), ("dexpilot", 0.03)])
def test_costs_are_the_published_ones(objective, beta):
    problem = _problem("allegro", objective)
    q = problem.chains.hand.q_rest[None]
    targets, _ = make_targets(problem.objective, P_H[:1], 1.3, start_pinches(problem.objective, 1))
    seen = look(problem, q, q, targets)
    tips = problem.chains.place(q).points[0]
    human = 1.3 * P_H[0, [4, 8, 12, 16]]

    def smooth(x):
        return np.where(np.abs(x) < beta, x * x / (2.0 * beta), np.abs(x) - 0.5 * beta)

    if objective == "position":
        value = smooth(tips - human).mean()
    elif objective == "vector":
        value = smooth(np.linalg.norm(tips - human, axis=1)).mean()
    else:
        # Thumb pairs first, then the others; the open hand does not pinch. Wrist vectors weigh 6 + 4.
        pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
        between = [np.linalg.norm((tips[a] - tips[b]) - (human[a] - human[b])) for a, b in pairs]
        value = (smooth(np.array(between)).sum() + 10.0 * smooth(np.linalg.norm(tips - human, axis=1)).sum()) / 10.0
    np.testing.assert_allclose(seen.cost[0], value, rtol=1e-12)


def test_pinches_switch_with_hysteresis():
    aim = make_objective(xd.load_hand("allegro"), "dexpilot", middles=False)
    tips = np.zeros((1, 21, 3))
    tips[0, [8, 12, 16]] = [[0.0, 0.04, 0.1], [0.0, 0.0, 0.2], [0.0, 0.2, 0.0]]
    pinches = start_pinches(aim, 1)

    def move(thumb_to_index, middle):
        nonlocal pinches
        tips[0, 4] = tips[0, 8] + [thumb_to_index, 0.0, 0.0]
        tips[0, 12] = tips[0, 8] + middle
        targets, pinches = make_targets(aim, tips, 2.0, pinches)
        return targets

    far = np.array([0.0, 0.1, 0.0])
    move(0.04, far)
    assert not pinches.any()
    targets = move(0.029, far)
    assert pinches[0].tolist() == [True, False, False, False, False, False]
    # The target is a hair along the person's direction, unscaled, and weighs 200 of the 10 vectors.
    np.testing.assert_allclose(targets.vectors[0, 0], [1e-4, 0.0, 0.0], atol=1e-8)
    assert targets.weights[0, 0] == 20.0 and targets.weights[0, 6] == 1.0
    move(0.049, far)
    assert pinches[0, 0]
    targets = move(0.02, np.array([0.0, 0.02, 0.0]))
    assert pinches[0].tolist() == [True, True, False, True, False, False]
    np.testing.assert_allclose(np.linalg.norm(targets.vectors[0, 3]), 0.03, rtol=1e-3)
    assert targets.weights[0, 3] == 40.0
    move(0.051, far)
    assert not pinches.any()


def test_bounded_steps_stay_within_and_descend():
    rng = np.random.default_rng(2)
    A = rng.normal(size=(50, 6, 6))
    H, g = A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(6), rng.normal(size=(50, 6))
    least, most = -rng.uniform(0.0, 0.3, (50, 6)), rng.uniform(0.0, 0.3, (50, 6))
    least[:, 0], most[:, 1] = 0.0, 0.0
    step = bounded_step(H, g, least, most)
    assert (step >= least).all() and (step <= most).all()
    model = (g * step).sum(axis=1) + 0.5 * (step * (H @ step[..., None])[..., 0]).sum(axis=1)
    assert (model < 0.0).mean() > 0.95
    free = bounded_step(H, g, np.full_like(g, -np.inf), np.full_like(g, np.inf))
    np.testing.assert_allclose((H @ free[..., None])[..., 0], -g, atol=1e-9)
