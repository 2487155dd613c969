"""Contact frames, grasp matrix, exact cones and pyramids."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xdex_drake.contact import (
    cone_edges,
    cone_violation,
    contact_frames,
    effort_map,
    grasp_matrix,
)
from xdex_drake.errors import ConfigError

finite = st.floats(-10.0, 10.0)
vectors = st.tuples(finite, finite, finite).map(np.array)


@given(vectors.filter(lambda v: np.linalg.norm(v) > 1e-6))
def test_frames_are_rotations_with_z_along_the_normal(n):
    R = contact_frames(n)
    assert R[:, 2] == pytest.approx(n / np.linalg.norm(n), abs=1e-14)
    assert pytest.approx(np.eye(3), abs=1e-14) == R.T @ R
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_frames_near_the_pole_and_batches():
    pole = np.array([-0.36, -0.48, -0.8])
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-16, 1e-12, 1e-8, 1e-3):
        R = contact_frames(pole + size * rng.normal(size=(2, 5, 3)))
        assert R.shape == (2, 5, 3, 3)
        assert np.swapaxes(R, -1, -2) @ R == pytest.approx(np.broadcast_to(np.eye(3), R.shape), abs=1e-14)


def test_frames_are_smooth_at_the_normals_of_a_box():
    rng = np.random.default_rng(1)
    normals = np.vstack([np.eye(3), -np.eye(3)])
    nearby = normals + 1e-6 * rng.normal(size=normals.shape)
    assert np.abs(contact_frames(nearby) - contact_frames(normals)).max() < 2e-5


def test_frames_refuse_a_zero_normal():
    with pytest.raises(ConfigError, match="zero length"):
        contact_frames(np.zeros((2, 3)))


def test_grasp_matrix_sums_forces_and_torques():
    rng = np.random.default_rng(2)
    p, n, c = rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 3))
    R = contact_frames(n)
    f = rng.normal(size=(4, 5, 3))
    G = grasp_matrix(p, R, c)
    assert G.shape == (4, 6, 15)
    F_W = (R @ f[..., None])[..., 0]
    expected = np.concatenate([np.cross(p - c[:, None], F_W).sum(axis=1), F_W.sum(axis=1)], axis=-1)
    assert (G @ f.reshape(4, 15, 1))[..., 0] == pytest.approx(expected)
    with pytest.raises(ConfigError, match="shapes"):
        grasp_matrix(p, R[:, :4], c)


def test_effort_map_is_virtual_work():
    rng = np.random.default_rng(3)
    J, R = rng.normal(size=(2, 3, 4)), contact_frames(rng.normal(size=(2, 3)))
    f, v = rng.normal(size=6), rng.normal(size=4)
    power = sum((R[i] @ f[3 * i : 3 * i + 3]) @ (J[i] @ v) for i in range(2))
    assert (effort_map(J, R) @ f) @ v == pytest.approx(power)


@settings(deadline=None)
@given(st.integers(3, 12), st.floats(0.0, 2.0), st.integers(0, 100))
def test_pyramids_are_inscribed(k, mu, seed):
    weights = np.random.default_rng(seed).uniform(size=k)
    assert cone_violation(cone_edges(mu, k) @ weights, mu) == pytest.approx(0.0, abs=1e-9)
    assert cone_edges(np.full(4, mu), k).shape == (4, 3, k)


def test_violation_counts_pulling():
    assert cone_violation([[0.0, 0.0, -1.0], [0.6, 0.0, 1.0], [1.0, 0.0, 1.0]], 0.6) == pytest.approx([1.0, 0.0, 0.4])
