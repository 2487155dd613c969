import numpy as np
import pytest
import torch
from pydrake.math import RigidTransform

from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.learning.batches import BatchSizes, make_batch, pack
from xdex_drake.learning.features import hand_features, link_pose_vectors
from xdex_drake.learning.losses import (
    embedding_loss,
    keypoint_loss,
    keypoints,
    kl_loss,
    point_loss,
    reconstruction_loss,
    rotations_from_columns,
)
from xdex_drake.learning.models.cvae import CVAE, CVAEConfig, HandBatch, denormalize_poses, normalize_poses
from xdex_drake.learning.models.layers import TopologyBias
from xdex_drake.learning.training import LossWeights, loss_terms

SMALL = CVAEConfig(width=32, heads=2, latent=8, object_channels=(8, 8), decoder_layers=2)


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    model = CVAE(SMALL).eval()
    with torch.no_grad():
        model.topology.table.mul_(50.0)  # far enough from zero for the topology to show
    return model


@pytest.fixture(scope="module")
def data(training_set):
    return pack(training_set, torch.device("cpu"))


@pytest.fixture(scope="module")
def batch(data):
    rng = np.random.default_rng(0)
    sizes = BatchSizes(16, 2, 128, 0.0, SMALL.latent)
    grasps = np.concatenate([np.flatnonzero(data.scene == 0)[:8], np.flatnonzero(data.scene == 1)[:8]])
    return make_batch(data, np.array([0, 1]), grasps, np.array([0.3, 2.0]), sizes, rng)


def _decode(model, hands, z, feature):
    links = model.link_features(hands)
    return links, model.decode(links, hands.mask, z, feature)


def _random(*shape, seed=0):
    return torch.as_tensor(np.random.default_rng(seed).normal(size=shape), dtype=torch.float32)


def test_padding_is_hidden(model, data):
    hands = data.hands
    padded = ~hands.mask
    assert not padded.any(), "the toy hands have equal numbers of links; padding is added below"
    extra = HandBatch(
        torch.cat([hands.points, torch.zeros_like(hands.points[:, :2])], dim=1),
        torch.cat([hands.origins, torch.zeros_like(hands.origins[:, :2])], dim=1),
        torch.nn.functional.pad(hands.spd, (0, 2, 0, 2)),
        torch.nn.functional.pad(hands.mask, (0, 2)),
    )
    L = hands.mask.shape[1]
    other = extra._replace(points=extra.points.clone(), origins=extra.origins.clone(), spd=extra.spd.clone())
    other.points[:, L:], other.origins[:, L:] = 7.0, -3.0
    other.spd[:, L:], other.spd[:, :, L:] = 4, 4
    z, feature = _random(2, SMALL.latent), _random(2, SMALL.width)
    with torch.no_grad():
        plain = _decode(model, hands, z, feature)
        for hand_batch in (extra, other):
            for a, b in zip(plain, _decode(model, hand_batch, z, feature), strict=True):
                torch.testing.assert_close(b[:, :L], a, rtol=0.0, atol=1e-5)
        poses = _random(2, L, 9)
        mean, log_sigma = model.encode(poses, hands.mask, feature)
        junk = torch.cat([poses, 9.0 * _random(2, 2, 9, seed=1)], dim=1)
        mean_2, log_sigma_2 = model.encode(junk, extra.mask, feature)
    torch.testing.assert_close(mean_2, mean, rtol=0.0, atol=1e-5)
    torch.testing.assert_close(log_sigma_2, log_sigma, rtol=0.0, atol=1e-5)


def test_permuting_links_permutes_outputs(model, data):
    hands = data.hands
    order = torch.as_tensor(np.random.default_rng(0).permutation(hands.mask.shape[1]))
    permuted = HandBatch(
        hands.points[:, order], hands.origins[:, order], hands.spd[:, order][:, :, order], hands.mask[:, order]
    )
    z, feature = _random(2, SMALL.latent), _random(2, SMALL.width)
    with torch.no_grad():
        _, poses = _decode(model, hands, z, feature)
        _, poses_2 = _decode(model, permuted, z, feature)
        mean, _ = model.encode(poses, hands.mask, feature)
        mean_2, _ = model.encode(poses[:, order], hands.mask, feature)
    torch.testing.assert_close(poses_2, poses[:, order], rtol=0.0, atol=1e-5)
    torch.testing.assert_close(mean_2, mean, rtol=0.0, atol=1e-5)


def test_topology_matters(model, data):
    hands = data.hands
    flat = hands._replace(spd=torch.ones_like(hands.spd))
    with torch.no_grad():
        difference = model.link_features(hands) - model.link_features(flat)
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
    p_point = batch.clouds[0, batch.point[0]]
    p = denormalize_poses(batch.poses[:1], p_point[None])[0]
    before = data.vectors[grasp]
    n = int(data.hands.mask[data.hand[grasp]].sum())
    torch.testing.assert_close(p[:n, 2], before[:n, 2], rtol=0.0, atol=1e-6)
    torch.testing.assert_close(p[:n, :3].norm(dim=1), before[:n, :3].norm(dim=1), rtol=0.0, atol=1e-6)
    torch.testing.assert_close((p[:n, 3:6] * p[:n, :3]).sum(1), (before[:n, 3:6] * before[:n, :3]).sum(1))
    # The conditioned point is the nearest of the cloud to the grasp's own.
    assert (p_point.norm() - data.points[grasp].norm()).abs() < 0.01


def test_losses_of_known_values():
    mask = torch.tensor([[True, True, False], [True, False, False]])
    poses = torch.zeros(2, 3, 9)
    predicted = poses.clone()
    predicted[0, 0, 0], predicted[1, 0, 1], predicted[:, 2] = 2.0, 1.0, 100.0
    assert float(reconstruction_loss(predicted, poses, mask)) == pytest.approx((4.0 / 2 + 1.0) / 2)
    assert float(kl_loss(torch.zeros(3, 4), torch.zeros(3, 4))) == 0.0
    assert float(kl_loss(torch.ones(3, 4), torch.zeros(3, 4))) == pytest.approx(2.0)
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
    vectors = torch.as_tensor(link_pose_vectors(R_HLs, p_HLs, features.R_HLs_zero))[None]
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


def test_options_add_terms_and_reach_every_parameter(model, data, batch):
    weights = LossWeights(retargeting=1.0, embedding=1.0, cross=1.0)
    terms = loss_terms(model, batch, data, weights)
    assert set(terms) == {"reconstruction", "kl", "point", "retargeting", "embedding", "cross"}
    assert set(loss_terms(model, batch, data, LossWeights())) == {"reconstruction", "kl", "point"}
    model.zero_grad()
    torch.stack(list(terms.values())).sum().backward()
    missing = [n for n, p in model.named_parameters() if p.grad is None or not bool(p.grad.abs().sum() > 0.0)]
    # The last embodiment and decoder blocks all feed the loss; keys' biases alone cannot matter to a softmax.
    assert missing == []


def test_one_batch_is_overfitted(data):
    torch.manual_seed(0)
    config = CVAEConfig(
        width=64, latent=16, embodiment_layers=1, encoder_layers=1, decoder_layers=2, object_channels=(8, 8)
    )
    model = CVAE(config)
    sizes = BatchSizes(8, 1, 64, 0.0, 16)
    batch = make_batch(data, np.array([0]), np.arange(8), np.zeros(1), sizes, np.random.default_rng(0))
    batch = batch._replace(noise=torch.zeros(8, 16))
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    losses = []
    for _ in range(300):
        loss = loss_terms(model, batch, data, LossWeights())["reconstruction"]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
        if losses[-1] < losses[0] / 60.0:
            break
    assert losses[-1] < losses[0] / 50.0
