import dataclasses

import numpy as np
import pytest
import torch
from pydrake.math import RigidTransform

from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.learning.batches import BatchSizes, Views, grasps_of_scenes, hand_batch, load_pack, make_batch
from xdex_drake.learning.features import hand_features, link_frames
from xdex_drake.learning.losses import (
    embedding_loss,
    keypoint_loss,
    keypoints,
    kl_loss,
    point_loss,
    reconstruction_loss,
    rotations_from_columns,
)
from xdex_drake.learning.models.cvae import CVAE, CVAEConfig, compose
from xdex_drake.learning.models.layers import TopologyBias
from xdex_drake.learning.pack import pose_vectors
from xdex_drake.learning.protocol import HandBatch, denormalize_poses, normalize_poses
from xdex_drake.learning.training import pose_errors

SMALL = CVAEConfig(
    width=32, heads=2, latent=8, object_channels=(8, 8), embodiment_layers=2, encoder_layers=2, decoder_layers=2
)


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    model = CVAE(SMALL).eval()
    with torch.no_grad():
        model.topology.table.mul_(50.0)  # far enough from zero for the topology to show
        for head in (model.wrist_head, model.link_head):  # which start at zero
            head.weight.normal_(std=0.1)
    return model


@pytest.fixture(scope="module")
def data(training_set):
    return load_pack(training_set.pack, torch.device("cpu"))


@pytest.fixture(scope="module")
def hands(data):
    return hand_batch(data, torch.tensor([0, 1]))


@pytest.fixture(scope="module")
def batch(data):
    pool = grasps_of_scenes(data.scene, np.flatnonzero(data.scene < 2))
    couples = [grasps.reshape(2, -1).T[:4].ravel() for grasps in pool.values()]  # a hand's grasps, then the other's
    sizes = BatchSizes(16, 2, 128, 0.0)
    rng = np.random.default_rng(0)
    views = Views(np.array([0.3, 2.0]), np.zeros(2, dtype=bool))
    return make_batch(data, pool, np.concatenate(couples), views, sizes, rng)


def _terms(model, batch, names):
    return model.loss(batch, names, np.random.default_rng(0))


def _decode(model, hands, z, feature):
    """Decodes for every hand of a batch once."""
    links = model.links(hands)
    return links.sets.pad(links.features), model.decode(links, z, feature)


def _random(*shape, seed=0):
    return torch.as_tensor(np.random.default_rng(seed).normal(size=shape), dtype=torch.float32)


def test_a_hand_alone_and_beside_a_larger_one(model, tiny):
    """Padding is hidden: what is said of a hand does not depend on its company."""
    data = load_pack(tiny(shapes=((2, 2), (4 - 1, 4))), torch.device("cpu"))
    alone, mixed = hand_batch(data, torch.tensor([0])), hand_batch(data, torch.tensor([1, 0]))
    L = alone.mask.shape[1]
    assert mixed.mask.shape[1] > L
    z, feature, poses = _random(2, SMALL.latent), _random(2, SMALL.width), _random(2, mixed.mask.shape[1], 9)
    with torch.no_grad():
        for a, b in zip(_decode(model, alone, z[1:], feature[1:]), _decode(model, mixed, z, feature), strict=True):
            torch.testing.assert_close(b[1:, :L], a, rtol=0.0, atol=1e-5)
        one = model.encode(poses[1:, :L], alone.mask, feature[1:])
        two = model.encode(poses, mixed.mask, feature)
    for a, b in zip(one, two, strict=True):
        torch.testing.assert_close(b[1:], a, rtol=0.0, atol=1e-5)


def test_what_padding_holds_takes_no_part_in_learning(model, tiny):
    data = load_pack(tiny(shapes=((2, 2), (3, 4))), torch.device("cpu"))
    sizes, pool = BatchSizes(8, 1, 64, 0.0), {0: np.flatnonzero(data.scene == 0)}
    batch = make_batch(data, pool, pool[0][[0, 8, 1, 9, 2, 10, 3, 11]], Views.plain(1), sizes, np.random.default_rng(0))
    junk = batch._replace(poses=torch.where(batch.mask[..., None], batch.poses, 7.0))
    grads = []
    for b in (batch, junk):
        model.zero_grad()
        torch.stack(list(_terms(model, b, CVAE.weights).values())).sum().backward()
        grads.append({name: p.grad.clone() for name, p in model.named_parameters()})
    for name, grad in grads[0].items():
        torch.testing.assert_close(grads[1][name], grad, rtol=1e-4, atol=1e-5, msg=name)


def test_permuting_links_permutes_outputs(model, hands):
    L = hands.mask.shape[1]
    order = torch.as_tensor(np.append(0, 1 + np.random.default_rng(0).permutation(L - 1)))  # the base stays the first
    rows = torch.cat([order, L + order])
    permuted = HandBatch(
        *(entry[rows] for entry in (hands.points, hands.normals, hands.centers, hands.joints)),
        hands.spd[:, order][:, :, order],
        hands.mask[:, order],
    )
    z, feature = _random(2, SMALL.latent), _random(2, SMALL.width)
    with torch.no_grad():
        _, poses = _decode(model, hands, z, feature)
        _, poses_2 = _decode(model, permuted, z, feature)
        mean, _ = model.encode(poses, hands.mask, feature)
        mean_2, _ = model.encode(poses[:, order], hands.mask, feature)
    torch.testing.assert_close(poses_2, poses[:, order], rtol=0.0, atol=1e-5)
    torch.testing.assert_close(mean_2, mean, rtol=0.0, atol=1e-5)


def test_topology_matters(model, hands):
    flat = hands._replace(spd=torch.ones_like(hands.spd))
    with torch.no_grad():
        difference = model.links(hands).features - model.links(flat).features
    assert difference.abs().max() > 1e-2


def test_topology_bias_reads_its_table():
    bias = TopologyBias(heads=2, max_distance=3)
    spd = torch.tensor([[[0, 1], [1, 9]]])
    out = bias(spd)
    assert out.shape == (1, 2, 2, 2)
    torch.testing.assert_close(out[0, 1, 0, 1], bias.table[1, 1])
    torch.testing.assert_close(out[0, 0, 1, 1], bias.table[3, 0])  # beyond the table: its last entry


def test_normalised_poses_round_trip():
    vectors, points = _random(4, 5, 9), _random(4, 3, seed=1)
    torch.testing.assert_close(denormalize_poses(normalize_poses(vectors, points), points), vectors)


def test_batch_turns_the_scene_as_a_whole(data, batch):
    # Distances between link origins and cloud survive the turn; heights, too.
    grasp = int(np.flatnonzero(data.scene == 0)[0])
    p_point = batch.clouds.points[0, batch.point[0]]
    p = denormalize_poses(batch.poses[:1], p_point[None])[0]
    n = int(data.links[data.hand[grasp]])
    before = data.vectors[:n].float()  # the first grasp's
    before[:, :3] += data.points[grasp]
    torch.testing.assert_close(p[:n, 2], before[:n, 2], rtol=0.0, atol=1e-6)
    torch.testing.assert_close(p[:n, :3].norm(dim=1), before[:n, :3].norm(dim=1), rtol=0.0, atol=1e-6)
    torch.testing.assert_close(
        (p[:n, 3:6] * p[:n, :3]).sum(1), (before[:n, 3:6] * before[:n, :3]).sum(1), rtol=0.0, atol=1e-6
    )
    # The conditioned point is the nearest of the cloud to the grasp's own.
    assert (p_point.norm() - data.points[grasp].norm()).abs() < 0.01


def test_turning_and_mirroring_a_scene_turns_and_mirrors_its_grasps(data):
    """Cloud, points, hands and link poses of a mirrored, turned scene are those of the scene, mirrored and turned."""
    pool = {1: np.flatnonzero(data.scene == 1)}
    grasps, sizes = pool[1][[0, 8, 3, 11]], BatchSizes(4, 1, 128, 0.0)
    plain = make_batch(data, pool, grasps, Views.plain(1), sizes, np.random.default_rng(0))
    views = Views(np.array([0.7]), np.array([True]))
    seen = make_batch(data, pool, grasps, views, sizes, np.random.default_rng(0))
    A, S = views.matrices(torch.device("cpu"))[0], torch.diag(torch.tensor([1.0, -1.0, 1.0]))
    assert torch.linalg.det(A) == pytest.approx(-1.0)
    close = {"rtol": 0.0, "atol": 2e-6}
    torch.testing.assert_close(seen.clouds.points, plain.clouds.points @ A.T, **close)
    torch.testing.assert_close(seen.clouds.normals, plain.clouds.normals @ A.T, **close)
    assert torch.equal(seen.point, plain.point) and torch.equal(seen.clouds.tables, plain.clouds.tables)
    torch.testing.assert_close(seen.point_weights, plain.point_weights, rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(seen.hands.points, plain.hands.points @ S, **close)
    torch.testing.assert_close(seen.hands.normals, plain.hands.normals @ S, **close)
    torch.testing.assert_close(seen.hands.centers, plain.hands.centers @ S, **close)
    R, R_seen = (rotations_from_columns(b.poses[..., 3:]) for b in (plain, seen))
    torch.testing.assert_close(seen.poses[..., :3], plain.poses[..., :3] @ A.T, **close)
    torch.testing.assert_close(R_seen, A @ R @ S, **close)
    # Every surface point of every link is where the mirror shows it: pose and hand fit together.
    tips, tips_seen = (keypoints(b.poses, *(entry[b.hand] for entry in b.keypoints[:2])) for b in (plain, seen))
    torch.testing.assert_close(tips_seen, tips @ A.T, **close)
    # A hand met plain and mirrored in one batch is two.
    both = {1: pool[1], 2: np.flatnonzero(data.scene == 2)}
    mixed = make_batch(
        data,
        both,
        np.concatenate([grasps, both[2][[0, 8]]]),
        Views(np.zeros(2), np.array([True, False])),
        BatchSizes(6, 2, 128, 0.0),
        np.random.default_rng(0),
    )
    assert len(mixed.hands.mask) == 4


def test_composing_follows_the_wrist_and_a_mirror():
    """Turning the wrist turns all links; the mirror image of what the heads say is the mirror image of the hand."""
    wrist, moved, centers = 0.3 * _random(3, 9), 0.3 * _random(3, 4, 9, seed=1), _random(3, 4, 3, seed=2)
    identity = torch.tensor([1.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    poses = compose(wrist, moved, centers)
    R = rotations_from_columns(_random(1, 6, seed=3))[0]
    turned = torch.cat([wrist[:, :3] @ R.T, *((c @ R.T) for c in (wrist[:, 3:] + identity).split(3, 1))], dim=1)
    turned[:, 3:] -= identity
    close = {"rtol": 0.0, "atol": 1e-5}
    expected = (poses.unflatten(-1, (3, 3)) @ R.T).flatten(-2)
    torch.testing.assert_close(compose(turned, moved, centers), expected, **close)
    signs = torch.tensor([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # S p, S R S's columns: S x, -S y
    mirrored = compose(wrist * signs, moved * signs, centers * signs[:3])
    torch.testing.assert_close(mirrored, poses * signs, **close)
    # At rest, all turn as the wrist does.
    rest = compose(wrist, torch.zeros_like(moved), centers)
    torch.testing.assert_close(rest[..., 3:], rest[:, :1, 3:].expand(-1, 4, -1), **close)


def test_swapped_couples_decode_each_other(model, batch):
    whole = dataclasses.replace(SMALL, swap=1.0)
    swapping = CVAE(whole).eval()
    swapping.load_state_dict(model.state_dict())
    with torch.no_grad():
        swapped, crossed = _terms(swapping, batch, CVAE.weights), _terms(model, batch, CVAE.weights)
    assert bool(batch.paired.all())
    torch.testing.assert_close(swapped["kl"], crossed["kl"])
    assert float(swapped["reconstruction"]) != pytest.approx(float(crossed["reconstruction"]), rel=1e-6)


def test_losses_of_known_values():
    mask = torch.tensor([[True, True, False], [True, False, False]])
    poses = torch.zeros(2, 3, 9)
    predicted = poses.clone()
    predicted[0, 0, 0], predicted[1, 0, 1], predicted[:, 2] = 2.0, 1.0, 100.0
    assert float(reconstruction_loss(predicted, poses, mask)) == pytest.approx((4.0 / 2 + 1.0) / 2)
    assert float(kl_loss(torch.zeros(3, 4), torch.zeros(3, 4))) == 0.0
    assert float(kl_loss(torch.ones(3, 4), torch.zeros(3, 4))) == pytest.approx(2.0)
    assert float(kl_loss(torch.ones(3, 4), torch.zeros(3, 4), 0.7)) == pytest.approx(2.8)
    assert float(point_loss(torch.zeros(2, 8), torch.rand(2, 8) + 0.1)) == pytest.approx(np.log(8.0))
    assert float(embedding_loss(torch.ones(2, 3), torch.zeros(2, 3))) == pytest.approx(3.0)
    shared = torch.tensor([[True, False], [False, False]])
    assert float(keypoint_loss(torch.ones(2, 2, 3), torch.zeros(2, 2, 3), shared)) == pytest.approx(3.0)


def test_kl_agrees_with_torch():
    mean, log_sigma = _random(5, 4), 0.5 * _random(5, 4, seed=1)
    normal = torch.distributions.Normal(mean, log_sigma.exp())
    expected = torch.distributions.kl_divergence(normal, torch.distributions.Normal(0.0, 1.0)).sum(1).mean()
    torch.testing.assert_close(kl_loss(mean, log_sigma), expected)


def test_keypoints_are_tips_and_wrist(hand_maker):
    hand = hand_maker(3, 3)
    features = hand_features(hand, points=8)
    R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), np.full(len(hand.joint_names), 0.6))
    vectors = torch.as_tensor(pose_vectors(*link_frames(features, R_HLs, p_HLs)))[None]
    found = keypoints(
        vectors, torch.as_tensor(features.keypoint_links)[None], torch.as_tensor(features.keypoint_offsets)[None]
    )[0]
    tips = [hand.link_index[f.tip_link] for f in hand.fingers]
    expected = [np.zeros(3), *(R_HLs[k] @ f.p_LTip + p_HLs[k] for k, f in zip(tips, hand.fingers, strict=True))]
    np.testing.assert_allclose(found.numpy(), np.array(expected), atol=1e-12)


def test_rotations_from_columns_are_rotations():
    R = rotations_from_columns(_random(20, 6))
    torch.testing.assert_close(R @ R.transpose(-1, -2), torch.eye(3).expand(20, 3, 3), rtol=0.0, atol=1e-5)
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(20))


def test_options_add_terms_and_reach_every_parameter(model, batch):
    terms = _terms(model, batch, CVAE.weights)
    assert set(terms) == {"reconstruction", "tips", "kl", "point", "retargeting", "embedding", "cross"}
    assert set(_terms(model, batch, {"reconstruction", "kl"})) == {"reconstruction", "kl"}
    model.zero_grad()
    torch.stack(list(terms.values())).sum().backward()
    missing = [n for n, p in model.named_parameters() if p.grad is None or not bool(p.grad.abs().sum() > 0.0)]
    # The last embodiment and decoder blocks all feed the loss; keys' biases alone cannot matter to a softmax.
    assert missing == []


def test_a_batch_without_pairs_has_no_terms_of_pairs(model, batch):
    alone = batch._replace(paired=torch.zeros_like(batch.paired))
    assert set(_terms(model, alone, CVAE.weights)) == {"reconstruction", "tips", "kl", "point"}
    with torch.no_grad():
        made = model.reconstruct(alone, np.random.default_rng(0))
    assert bool(made["cross"].isnan().all()) and not bool(made["prior"].isnan().any())


@torch.no_grad()
def test_reconstruction_repeats_and_is_measured_in_millimetres(model, batch):
    one, other = (model.reconstruct(batch, np.random.default_rng(5)) for _ in range(2))
    assert set(one) == {"posterior", "prior", "cross"}
    assert all(torch.equal(one[name], other[name]) for name in one)
    origins, tips = pose_errors(torch.stack([batch.poses + 1.0, batch.poses]), batch)
    torch.testing.assert_close(origins, torch.zeros(16))  # the best of two tries
    moved = batch.poses.clone()
    moved[..., 0] += 0.05  # of 0.1 m
    origins, tips = pose_errors(moved[None], batch)
    torch.testing.assert_close(origins, torch.full((16,), 5.0))
    torch.testing.assert_close(tips, torch.full((16,), 5.0))


@torch.no_grad()
def test_tips_feel_a_turn_of_the_links_and_the_wrist_does_not_count(batch):
    turned, angle = batch.poses.clone(), 0.1
    c, s = np.cos(angle), np.sin(angle)
    R = torch.tensor([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]], dtype=torch.float32)
    turned[..., 3:6], turned[..., 6:] = turned[..., 3:6] @ R.T, turned[..., 6:] @ R.T
    origins, errors = pose_errors(turned[None], batch)
    torch.testing.assert_close(origins, torch.zeros(16))
    # Tips are some 20 mm from the centers of their links; nothing else moves.
    assert bool((errors > 0.1).all()) and bool((errors <= 48.0 * angle).all())


def test_one_batch_is_overfitted(data):
    torch.manual_seed(0)
    config = CVAEConfig(
        width=64, heads=4, latent=16, embodiment_layers=1, encoder_layers=1, decoder_layers=2, object_channels=(8, 8)
    )
    model = CVAE(config)
    pool = {0: np.flatnonzero(data.scene == 0)}
    batch = make_batch(data, pool, pool[0][:8], Views.plain(1), BatchSizes(8, 1, 64, 0.0), np.random.default_rng(0))
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    losses = []
    for _ in range(300):
        f = model(batch)
        loss = reconstruction_loss(model.decode(f.links, f.mean, f.feature), batch.poses, batch.mask)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
        if losses[-1] < losses[0] / 60.0:
            break
    assert losses[-1] < losses[0] / 50.0
