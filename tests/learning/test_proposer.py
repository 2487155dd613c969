"""Draws become grasps: raw by inverse kinematics, refined near the draw."""

import numpy as np
import pytest

from xdex_drake.grasping.finish import finish
from xdex_drake.hand.library import load_hand
from xdex_drake.learning.proposer import (
    REACH,
    _pose,
    default_checkpoint,
    draw_raw,
    load_model,
    raw_grasp,
    refined_candidates,
    refined_starts,
)
from xdex_drake.programs.force_closure import polish_program
from xdex_drake.programs.link_pose_ik import reach_block
from xdex_drake.programs.solve import solve
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene


@pytest.fixture(scope="module")
def drawn():
    hand, scene = load_hand("inspire"), make_scene(load_object("can"))
    return hand, scene, draw_raw(load_model(str(default_checkpoint())), hand, scene, count=6, seed=0)


def test_refined_grasps_stay_near_their_draws(drawn):
    hand, scene, raw = drawn
    starts = refined_starts(hand, scene, raw, seed=0)
    for k, some in enumerate(starts):
        np.testing.assert_array_equal(some.qs[0], raw.qs[k])  # the draw itself comes first
        assert (np.linalg.norm(some.p_WHs - raw.p_WHs[k], axis=1) <= REACH).all()
    outcomes = [finish(candidate) for candidate in refined_candidates(hand, scene, starts)]
    moved = [
        np.linalg.norm(outcome.grasp.X_WH.translation() - raw.p_WHs[k])
        for k, outcome in enumerate(outcomes)
        if outcome.grasp is not None
    ]
    assert moved and max(moved) < REACH + 1e-3
    # What is drawn about a draw depends on the seed alone.
    again = refined_starts(hand, scene, raw, seed=0)
    assert all(np.array_equal(a.qs, b.qs) for a, b in zip(starts, again, strict=True))


def test_the_wrist_is_held_near_a_given_point(drawn):
    hand, scene, raw = drawn
    point = _program(hand, scene, raw, 0, ()).start
    block = reach_block(point.k.X_WH.translation() + np.array([0.004, -0.01, 0.002]), 0.015)
    g, J = block.evaluate(point)
    assert g[0] == pytest.approx(1e3 * (0.004**2 + 0.01**2 + 0.002**2) / 0.015)
    rng = np.random.default_rng(0)
    for _ in range(3):
        step = 1e-6 * rng.normal(size=J.shape[1])
        numeric = (block.evaluate(point.moved(step))[0] - block.evaluate(point.moved(-step))[0]) / 2.0
        np.testing.assert_allclose(J @ step, numeric, rtol=1e-4, atol=1e-9)
    # A program keeps to it, whatever else it can meet.
    held = solve(_program(hand, scene, raw, 0, (reach_block(raw.p_WHs[0], 0.003),)))
    apart = np.linalg.norm(held.point.k.X_WH.translation() - raw.p_WHs[0])
    assert apart < 0.0035 or not held.success


def test_a_raw_grasp_is_what_inverse_kinematics_gives(drawn):
    hand, scene, raw = drawn
    k = int(np.argmin(raw.energy))
    kept = raw_grasp(hand, scene, raw, k)
    if raw.energy[k] > 0.01:
        assert kept.name == "inverse kinematics"
        raw = type(raw)(raw.R_WHs, raw.p_WHs, raw.qs, raw.fingers, np.zeros_like(raw.energy), {})
        kept = raw_grasp(hand, scene, raw, k)
    np.testing.assert_allclose(kept.q, np.clip(raw.qs[k], *hand.limits))
    assert kept.certificate is None and kept.tau_squeeze is not None and kept.penetration_mesh_m >= 0.0


def _program(hand, scene, raw, k, extra):
    X_WH = _pose(raw.R_WHs[k], raw.p_WHs[k])
    return polish_program(hand, scene, X_WH, raw.qs[k], raw.fingers[k], extra_constraints=extra)
