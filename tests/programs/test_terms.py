"""Every term's gradient agrees with central differences, in NumPy and in torch, in contact and away from it."""

import numpy as np
import pytest
import torch

from xdex_drake.programs import contact_forces
from xdex_drake.programs.terms.approach import approach
from xdex_drake.programs.terms.center import off_center
from xdex_drake.programs.terms.contact import contact_distance
from xdex_drake.programs.terms.force_closure import wrench_energy
from xdex_drake.programs.terms.joint_limits import joint_limits
from xdex_drake.programs.terms.keypoints import keypoints
from xdex_drake.programs.terms.pads import alignment
from xdex_drake.programs.terms.penetration import penetration
from xdex_drake.programs.terms.self_collision import self_collision
from xdex_drake.programs.terms.spread import finger_spread

CASES = range(6)


def numeric(function, x, h=1e-6):
    gradient = np.zeros_like(x)
    for index in np.ndindex(x.shape):
        step = np.zeros_like(x)
        step[index] = h
        gradient[index] = (function(x + step) - function(x - step)) / (2.0 * h)
    return gradient


def close(analytic, differences):
    scale = max(1.0, float(np.abs(differences).max()))
    assert np.abs(analytic - differences).max() <= 1e-5 * scale


def unit(rng, *shape):
    v = rng.normal(size=(*shape, 3))
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.mark.parametrize("seed", CASES)
@pytest.mark.parametrize("offset", [-0.02, 0.0, 0.05])
def test_penetration(seed, offset):
    rng = np.random.default_rng(seed)
    d, r = rng.normal(size=12) * 0.01 + offset, rng.uniform(0.005, 0.02, 12)
    value, gradient = penetration(d, r)
    close(gradient, numeric(lambda x: penetration(x, r)[0], d))
    assert value == pytest.approx(sum(max(0.0, ri - di) for ri, di in zip(r, d, strict=True)))


@pytest.mark.parametrize("seed", CASES)
def test_contact_distance(seed):
    rng = np.random.default_rng(seed)
    d, r, w = rng.normal(size=5) * 0.01, rng.uniform(0.005, 0.02, 5), np.array([1.0, 0.0, 1.0, 1.0, 1.0])
    _, gradient = contact_distance(d, r, w)
    close(gradient, numeric(lambda x: contact_distance(x, r, w)[0], d))


@pytest.mark.parametrize("seed", CASES)
def test_joint_limits(seed):
    rng = np.random.default_rng(seed)
    limits = np.stack([-np.ones(8), np.ones(8)])
    q = rng.normal(size=8) * 1.5
    _, gradient = joint_limits(q, limits)
    close(gradient, numeric(lambda x: joint_limits(x, limits)[0], q))


@pytest.mark.parametrize("seed", CASES)
@pytest.mark.parametrize("spread", [0.005, 0.05])
def test_self_collision(seed, spread):
    rng = np.random.default_rng(seed)
    between, reach = rng.normal(size=(6, 3)) * spread, rng.uniform(0.01, 0.03, 6)
    _, gradient = self_collision(between, reach)
    close(gradient, numeric(lambda x: self_collision(x, reach)[0], between, h=1e-8))


def turned(n, f, dn):
    """Forces that turn with their normals by the smallest rotation."""
    axis = np.cross(n, dn)
    return f + np.cross(axis, f)


@pytest.mark.parametrize("seed", CASES)
def test_grasp_map_is_the_matrix_of_the_wrench(seed):
    rng = np.random.default_rng(seed)
    p, f, center = rng.normal(size=(2, 5, 3)), rng.normal(size=(2, 5, 3)), rng.normal(size=3)
    by_matrix = (contact_forces.grasp_map(p, center, 0.3) @ f.reshape(2, -1, 1))[..., 0]
    assert np.abs(by_matrix - contact_forces.wrench(p, f, center, 0.3)).max() < 1e-12


@pytest.mark.parametrize("seed", CASES)
def test_wrench_energy(seed):
    rng = np.random.default_rng(seed)
    p, n, f = rng.normal(size=(4, 3)) * 0.04, unit(rng, 4), rng.normal(size=(4, 3))
    com, length = rng.normal(size=3) * 0.01, 0.05
    _, gp, gn = wrench_energy(p, n, f, com, length)
    close(gp, numeric(lambda x: wrench_energy(x, n, f, com, length)[0], p))
    # A change of the normal, kept to the sphere, turns the force with it.
    h = 1e-6
    for k in range(4):
        for direction in unit(rng, 3):
            dn = np.zeros_like(n)
            dn[k] = direction - (direction @ n[k]) * n[k]
            plus = wrench_energy(p, n, turned(n, f, h * dn), com, length)[0]
            minus = wrench_energy(p, n, turned(n, f, -h * dn), com, length)[0]
            assert (gn * dn).sum() == pytest.approx((plus - minus) / (2 * h), rel=1e-5, abs=1e-6)


def test_the_papers_estimator_is_its_square_norm():
    rng = np.random.default_rng(0)
    p, n = rng.normal(size=(4, 3)), unit(rng, 4)
    value, _, _ = wrench_energy(p, n, n, np.zeros(3), 1.0)
    w = np.concatenate([np.cross(p, n).sum(0), n.sum(0)])
    assert value == pytest.approx(0.5 * w @ w)


@pytest.mark.parametrize("seed", CASES)
def test_off_center(seed):
    rng = np.random.default_rng(seed)
    p, com, w = rng.normal(size=(5, 3)), rng.normal(size=3), np.array([1.0, 0.0, 1.0, 1.0, 0.0])
    value, gradient = off_center(p, com, 0.3, w)
    assert value == pytest.approx(0.5 * np.sum((p[w > 0.0].mean(axis=0) - com) ** 2) / 0.3**2)
    close(gradient, numeric(lambda x: off_center(x, com, 0.3, w)[0], p))
    assert off_center(p, com, 0.3, np.zeros(5))[0] == 0.0


@pytest.mark.parametrize("seed", CASES)
def test_alignment(seed):
    rng = np.random.default_rng(seed)
    a, b, w = unit(rng, 5), unit(rng, 5), np.array([1.0, 0.0, 1.0, 1.0, 1.0])
    _, ga, gb = alignment(a, b, 0.6, w)
    close(ga, numeric(lambda x: alignment(x, b, 0.6, w)[0], a))
    close(gb, numeric(lambda x: alignment(a, x, 0.6, w)[0], b))


@pytest.mark.parametrize("seed", CASES)
@pytest.mark.parametrize("least", [-0.5, 0.9])
def test_approach(seed, least):
    rng = np.random.default_rng(seed)
    a, d = unit(rng), unit(rng)
    value, gradient = approach(a, d, least)
    close(gradient, numeric(lambda x: approach(x, d, least)[0], a))
    assert value == pytest.approx(max(0.0, least - a @ d))
    there = approach(torch.as_tensor(a[None]), torch.as_tensor(d), least)
    assert np.abs(there[1].numpy()[0] - gradient).max() < 1e-12


@pytest.mark.parametrize("seed", CASES)
@pytest.mark.parametrize("least", [0.5, 2.0])
def test_finger_spread(seed, least):
    rng = np.random.default_rng(seed)
    p, w = rng.normal(size=(4, 3)), np.array([1.0, 0.0, 1.0, 1.0])
    value, gradient = finger_spread(p, least, w)
    close(gradient, numeric(lambda x: finger_spread(x, least, w)[0], p))
    pairs = [(0, 2), (0, 3), (2, 3)]
    assert value == pytest.approx(sum(max(0.0, least - np.linalg.norm(p[i] - p[j])) for i, j in pairs))
    there = finger_spread(torch.as_tensor(p[None]), least, torch.as_tensor(w[None]))
    assert np.abs(there[1].numpy()[0] - gradient).max() < 1e-12


@pytest.mark.parametrize("seed", CASES)
def test_keypoints(seed):
    rng = np.random.default_rng(seed)
    p, goal, w = rng.normal(size=(5, 3)), rng.normal(size=(5, 3)), rng.uniform(size=5)
    _, gradient = keypoints(p, goal, w)
    close(gradient, numeric(lambda x: keypoints(x, goal, w)[0], p))


@pytest.mark.parametrize("mu", [0.2, 0.6, 1.0])
def test_projected_forces_lie_in_the_cone_and_within_bounds(mu):
    rng = np.random.default_rng(0)
    f, n = rng.normal(size=(50, 3)) * 2.0, unit(rng, 50)
    g = contact_forces.project_forces(f, n, mu, 0.3, 1.5)
    normal = (g * n).sum(-1)
    assert np.all((normal >= 0.3 - 1e-12) & (normal <= 1.5 + 1e-12))
    assert np.all(np.linalg.norm(g - normal[:, None] * n, axis=1) <= mu * normal + 1e-9)
    # What is in the set already stays.
    assert np.abs(contact_forces.project_forces(g, n, mu, 0.3, 1.5) - g).max() < 1e-9


def test_numpy_and_torch_give_the_same():
    rng = np.random.default_rng(0)
    p, n, f = rng.normal(size=(3, 4, 3)), unit(rng, 3, 4), rng.normal(size=(3, 4, 3))
    com, length = np.zeros(3), 0.1
    here = wrench_energy(p, n, f, com, length)
    tp, tn, tf, tcom = (torch.as_tensor(x) for x in (p, n, f, com))
    there = wrench_energy(tp, tn, tf, tcom, length)
    for a, b in zip(here, there, strict=True):
        assert np.abs(a - b.numpy()).max() < 1e-12
    d, r = rng.normal(size=(3, 7)), rng.uniform(size=7)
    for a, b in zip(penetration(d, r), penetration(torch.as_tensor(d), torch.as_tensor(r)), strict=True):
        assert np.abs(a - b.numpy()).max() < 1e-12
