"""Our kinematics against Drake's, and its derivatives against differences."""

import numpy as np
import pytest
import torch
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.hand.batched_kinematics import BatchedHand, PaddedHands, rotation_step
from xdex_drake.hand.importing.bodies import link_poses
from xdex_drake.hand.kinematics import Configuration, forward_kinematics
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.scene.plant import build_plant


def random_configuration(hand, rng):
    X_WH = RigidTransform(RollPitchYaw(rng.uniform(-3, 3, 3)), rng.normal(size=3) * 0.2)
    return X_WH, rng.uniform(hand.limits[0], hand.limits[1])


@pytest.mark.parametrize("name", list_hands())
def test_link_poses_agree_with_drake(name):
    hand, rng = load_hand(name), np.random.default_rng(0)
    scene_plant = build_plant(hand)
    context = scene_plant.plant.GetMyMutableContextFromRoot(scene_plant.diagram.CreateDefaultContext())
    batched = BatchedHand(hand, dtype=torch.float64)
    for _ in range(5):
        X_WH, q = random_configuration(hand, rng)
        scene_plant.set_wrist(context, X_WH)
        scene_plant.set_joints(context, q)
        k = Configuration.at(hand, X_WH, q)
        poses = batched.forward(
            torch.as_tensor(X_WH.rotation().matrix())[None],
            torch.as_tensor(X_WH.translation())[None],
            torch.as_tensor(q)[None],
        )
        for link, body in enumerate(scene_plant.links):
            X_WL = scene_plant.plant.EvalBodyPoseInWorld(context, body)
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


@pytest.mark.parametrize("name", ["allegro", "schunk_svh"])
def test_fixed_points_agree_with_points(name):
    hand, rng = load_hand(name), np.random.default_rng(4)
    batched, B = BatchedHand(hand, dtype=torch.float64), 3
    configurations = [random_configuration(hand, rng) for _ in range(B)]
    R = torch.as_tensor(np.array([X.rotation().matrix() for X, _ in configurations]))
    p = torch.as_tensor(np.array([X.translation() for X, _ in configurations]))
    q = torch.as_tensor(np.array([q for _, q in configurations]))
    poses = batched.forward(R, p, q)
    links = torch.as_tensor(hand.sphere_links)
    points = batched.points(poses, links, torch.as_tensor(hand.spheres[:, :3]))
    assert (batched.spheres.positions(poses).transpose(1, 2) - points).abs().max() < 1e-14
    force = torch.as_tensor(rng.normal(size=points.shape))
    wrenches = batched.spheres.wrenches(poses, force.transpose(1, 2))
    assert (wrenches - batched.wrenches(links, points, force)).abs().max() < 1e-12
    a, b = torch.arange(5), torch.arange(5, 10)
    between = batched.spheres.subset(a).minus(batched.spheres.subset(b))
    assert (between.positions(poses).transpose(1, 2) - (points[:, a] - points[:, b])).abs().max() < 1e-14


def test_padded_hands_agree_with_each_hand_alone():
    hands = [load_hand(name) for name in ("allegro", "inspire", "shadow")]
    rng = np.random.default_rng(5)
    padded = PaddedHands(hands, dtype=torch.float64)
    rows = torch.tensor([0, 1, 2, 1, 0])
    configurations = [random_configuration(hands[row], rng) for row in rows]
    R = torch.as_tensor(np.array([X.rotation().matrix() for X, _ in configurations]))
    p = torch.as_tensor(np.array([X.translation() for X, _ in configurations]))
    q = torch.zeros((5, padded.n_actuated), dtype=torch.float64)
    for b, (_, value) in enumerate(configurations):
        q[b, : len(value)] = torch.as_tensor(value)
    q.requires_grad_()
    poses = padded.forward(rows, R, p, q)
    spheres, there = padded.pad([hand.spheres for hand in hands])
    links, _ = padded.pad([hand.sphere_links for hand in hands])
    centers = padded.points(poses, links[rows], spheres[rows][..., :3])
    value = (centers**2).sum(-1)[there[rows]].sum()
    (by_torch,) = torch.autograd.grad(value, q)
    for b, row in enumerate(rows):
        hand = hands[row]
        alone = BatchedHand(hand, dtype=torch.float64)
        n, one = len(hand.joint_names), alone.forward(R[b : b + 1], p[b : b + 1], q[b : b + 1, : len(hand.joint_names)])
        x = alone.spheres.positions(one)
        assert (centers[b][there[row]] - x[0].T).abs().max() < 1e-12
        gradient = alone.to_tangent(one, alone.spheres.wrenches(one, 2.0 * x))
        assert (gradient[0, 6:] - by_torch[b, :n]).abs().max() < 1e-10
        assert (by_torch[b, n:] == 0.0).all()
        assert int(padded.links[row].sum()) == len(hand.links)
        assert int(padded.actuated[row].sum()) == n


def test_rotation_steps_stay_rotations():
    rng = np.random.default_rng(0)
    R = torch.eye(3, dtype=torch.float64).repeat(8, 1, 1)
    for _ in range(200):
        R = rotation_step(R, torch.as_tensor(rng.normal(size=(8, 3))))
    assert (R @ R.transpose(1, 2) - torch.eye(3)).abs().max() < 1e-12
    assert (torch.linalg.det(R) - 1.0).abs().max() < 1e-12


@pytest.mark.parametrize("name", ["allegro", "ability", "schunk_svh"])
def test_directional_derivatives_agree_with_the_jacobian(name):
    hand, rng = load_hand(name), np.random.default_rng(6)
    k = Configuration.at(hand, *random_configuration(hand, rng))
    links = rng.integers(0, len(hand.links), 9)
    points, along = k.points(links, rng.normal(size=(9, 3)) * 0.02), rng.normal(size=(9, 3))
    rows = np.einsum("ka,kab->kb", along, k.jacobian(links, points))
    assert np.abs(k.pull_back_each(links, points, along) - rows).max() < 1e-13


@pytest.mark.parametrize("name", ["ability", "allegro"])
def test_many_postures_give_what_each_gives(name):
    hand, rng = load_hand(name), np.random.default_rng(5)
    X_WH, _ = random_configuration(hand, rng)
    qs = rng.uniform(*hand.limits, size=(3, 4, len(hand.joint_names)))
    R_WLs, p_WLs = forward_kinematics(hand, X_WH, qs)
    assert R_WLs.shape == (3, 4, len(hand.links), 3, 3) and p_WLs.shape == (3, 4, len(hand.links), 3)
    for index in np.ndindex(3, 4):
        R, p = forward_kinematics(hand, X_WH, qs[index])
        assert np.array_equal(R_WLs[index], R) and np.array_equal(p_WLs[index], p)


def test_poses_for_the_importer_are_those_in_the_base():
    hand, rng = load_hand("shadow"), np.random.default_rng(6)
    qs = rng.uniform(*hand.limits, size=(5, len(hand.joint_names)))
    R_BLs, p_BLs = link_poses(hand, qs)
    assert R_BLs[:, 0] == pytest.approx(np.broadcast_to(np.eye(3), (5, 3, 3)), abs=1e-15)
    R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), qs)
    assert hand.R_HB @ R_BLs == pytest.approx(R_HLs, abs=1e-14)
    assert p_BLs @ hand.R_HB.T + hand.p_HB == pytest.approx(p_HLs, abs=1e-14)
