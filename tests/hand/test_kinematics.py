"""Our kinematics against Drake's, and its derivatives against differences."""

import numpy as np
import pytest
import torch
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.hand.kinematics import BatchedHand, Configuration, rotation_step
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.scene.plant import build_plant


def random_configuration(hand, rng):
    X_WH = RigidTransform(RollPitchYaw(rng.uniform(-3, 3, 3)), rng.normal(size=3) * 0.2)
    return X_WH, rng.uniform(hand.limits[0], hand.limits[1])


@pytest.mark.parametrize("name", list_hands())
def test_link_poses_agree_with_drake(name):
    hand, rng = load_hand(name), np.random.default_rng(0)
    bench = build_plant(hand)
    context = bench.plant.GetMyMutableContextFromRoot(bench.diagram.CreateDefaultContext())
    batched = BatchedHand(hand, dtype=torch.float64)
    for _ in range(5):
        X_WH, q = random_configuration(hand, rng)
        bench.set_wrist(context, X_WH)
        bench.set_joints(context, q)
        k = Configuration.at(hand, X_WH, q)
        poses = batched.forward(
            torch.as_tensor(X_WH.rotation().matrix())[None],
            torch.as_tensor(X_WH.translation())[None],
            torch.as_tensor(q)[None],
        )
        for link, body in enumerate(bench.links):
            X_WL = bench.plant.EvalBodyPoseInWorld(context, body)
            assert np.abs(k.R_WLs[link] - X_WL.rotation().matrix()).max() < 1e-9
            assert np.abs(k.p_WLs[link] - X_WL.translation()).max() < 1e-9
            assert np.abs(poses.R_WLs[0, link].numpy() - X_WL.rotation().matrix()).max() < 1e-9
            assert np.abs(poses.p_WLs[0, link].numpy() - X_WL.translation()).max() < 1e-9


@pytest.mark.parametrize("name", ["allegro", "ability", "schunk_svh"])
def test_jacobians_agree_with_differences(name):
    hand, rng = load_hand(name), np.random.default_rng(1)
    X_WH, q = random_configuration(hand, rng)
    k = Configuration.at(hand, X_WH, q)
    links = rng.integers(0, len(hand.links), 7)
    local = rng.normal(size=(7, 3)) * 0.02
    J = k.jacobian(links, k.points(links, local))
    Jw = k.angular_jacobian(links)
    h, n = 1e-6, 6 + len(q)
    for c in range(n):
        step = np.zeros(n)
        step[c] = h
        plus, minus = k.moved(step), k.moved(-step)
        assert np.abs((plus.points(links, local) - minus.points(links, local)) / (2 * h) - J[:, :, c]).max() < 1e-7
        v = k.vectors(links, local)
        dv = (plus.vectors(links, local) - minus.vectors(links, local)) / (2 * h)
        assert np.abs(dv - np.cross(Jw[:, :, c], v)).max() < 1e-7


@pytest.mark.parametrize("name", ["allegro", "ability"])
def test_batched_adjoint_and_jacobian_agree(name):
    hand, rng = load_hand(name), np.random.default_rng(2)
    batched, B, m = BatchedHand(hand, dtype=torch.float64), 4, 9
    configurations = [random_configuration(hand, rng) for _ in range(B)]
    R = torch.as_tensor(np.array([X.rotation().matrix() for X, _ in configurations]))
    p = torch.as_tensor(np.array([X.translation() for X, _ in configurations]))
    q = torch.as_tensor(np.array([q for _, q in configurations]))
    poses = batched.forward(R, p, q)
    links = torch.as_tensor(rng.integers(0, len(hand.links), m))
    local = torch.as_tensor(rng.normal(size=(m, 3)) * 0.02)
    points = batched.points(poses, links, local)
    force = torch.as_tensor(rng.normal(size=(B, m, 3)))
    J = batched.jacobian(poses, links, points)
    by_jacobian = torch.einsum("bma,bmac->bc", force, J)
    assert (batched.pull_back(poses, links, points, force) - by_jacobian).abs().max() < 1e-12
    for b, (X_WH, qb) in enumerate(configurations):
        k = Configuration.at(hand, X_WH, qb)
        assert np.abs(k.jacobian(links.numpy(), points[b].numpy()) - J[b].numpy()).max() < 1e-12


def test_rotation_steps_stay_rotations():
    rng = np.random.default_rng(0)
    R = torch.eye(3, dtype=torch.float64).repeat(8, 1, 1)
    for _ in range(200):
        R = rotation_step(R, torch.as_tensor(rng.normal(size=(8, 3))))
    assert (R @ R.transpose(1, 2) - torch.eye(3)).abs().max() < 1e-12
    assert (torch.linalg.det(R) - 1.0).abs().max() < 1e-12
