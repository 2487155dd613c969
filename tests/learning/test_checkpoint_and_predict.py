import dataclasses
import json
import struct

import numpy as np
import pytest
import torch

from xdex_drake.errors import CheckpointError
from xdex_drake.learning.checkpoint import checkpoint_header, load_checkpoint, save_checkpoint
from xdex_drake.learning.models.cvae import CVAE, CVAEConfig
from xdex_drake.learning.predict import encode, neural_retarget, sample

SMALL = CVAEConfig(width=16, heads=2, latent=4, object_channels=(4, 6), decoder_layers=1)


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    model = CVAE(SMALL).eval()
    with torch.no_grad():  # heads start at zero, and then nothing that is drawn shows
        for head in (model.wrist_head, model.link_head):
            head.weight.normal_(std=0.1)
    return model


@pytest.fixture
def file(model, tmp_path):
    return save_checkpoint(model, tmp_path / "run", {"seed": 3})


def _header(file):
    raw = file.read_bytes()
    (length,) = struct.unpack("<Q", raw[:8])
    return json.loads(raw[8 : 8 + length]), raw[8 + length :]


def _rewrite(file, table, body):
    header = json.dumps(table).encode()
    file.write_bytes(struct.pack("<Q", len(header)) + header + body)


def test_round_trip(model, file):
    for path in (file, file.parent):
        loaded = load_checkpoint(path)
        assert loaded.config == SMALL and not loaded.training
        for name, tensor in model.state_dict().items():
            assert torch.equal(loaded.state_dict()[name], tensor.half().float())
    sizes = sum(tensor.numel() for tensor in model.state_dict().values())
    assert file.stat().st_size < 2 * sizes + 20_000
    assert checkpoint_header(file)["notes"] == {"seed": 3}
    assert checkpoint_header(file)["versions"]["torch"] == torch.__version__


def test_missing_and_empty(tmp_path):
    with pytest.raises(CheckpointError, match="no such checkpoint"):
        load_checkpoint(tmp_path)
    (tmp_path / "model.safetensors").write_bytes(b"")
    with pytest.raises(CheckpointError, match="cut short"):
        load_checkpoint(tmp_path)


@pytest.mark.parametrize("kept", [4, 8, 100, 2000, -1])
def test_cut_short(file, kept):
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(CheckpointError):
        load_checkpoint(file)


def test_header_of_absurd_length(file):
    raw = file.read_bytes()
    file.write_bytes(struct.pack("<Q", 2**62) + raw[8:])
    with pytest.raises(CheckpointError, match="cut short"):
        load_checkpoint(file)


def test_random_damage_never_ends_in_another_error(file):
    raw = file.read_bytes()
    rng = np.random.default_rng(0)
    (length,) = struct.unpack("<Q", raw[:8])
    for _ in range(100):
        damaged = bytearray(raw)
        for position in rng.integers(0, 8 + length, 3):
            damaged[position] = rng.integers(256)
        file.write_bytes(damaged)
        try:
            load_checkpoint(file)
        except CheckpointError as error:
            assert str(file) in str(error)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda h: h.update(feature_schema=99), "feature_schema"),
        (lambda h: h.update(kind="other"), "'kind' is 'other'; known are cvae"),
        (lambda h: h.update(kind=["cvae"]), "kind"),
        (lambda h: h["config"].update(width=10**9), "config.width"),
        (lambda h: h["config"].update(width=32), "does not fit"),
        (lambda h: h["config"].update(heads=3), "multiple"),
        (lambda h: h["config"].update(surprise=1), "config"),
        (lambda h: h["config"].update(object_channels="no"), "object_channels"),
        (lambda h: h["config"].update(voxel_size=0.0), "voxel_size"),
        (lambda h: h.pop("config"), "config"),
    ],
)
def test_wrong_headers(file, change, message):
    table, body = _header(file)
    header = json.loads(table["__metadata__"]["xdex_drake"])
    change(header)
    table["__metadata__"]["xdex_drake"] = json.dumps(header)
    _rewrite(file, table, body)
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(file)


def test_foreign_safetensors_and_pickles(file):
    table, body = _header(file)
    del table["__metadata__"]
    _rewrite(file, table, body)
    with pytest.raises(CheckpointError, match="xdex_drake"):
        load_checkpoint(file)
    torch.save({"a": torch.zeros(3)}, file)
    with pytest.raises(CheckpointError):
        load_checkpoint(file)


def test_numbers_that_are_not_finite(file, model):
    broken = CVAE(SMALL)
    broken.load_state_dict(model.state_dict())
    with torch.no_grad():
        broken.pose_token.weight[0, 0] = torch.nan
    save_checkpoint(broken, file)
    with pytest.raises(CheckpointError, match="not finite"):
        load_checkpoint(file)


def test_sixteen_bits_change_predictions_little(model, file, training_set):
    hand, scene = training_set.hands[0], training_set.scenes[0]
    exact, read = (
        sample(m, hand, scene, 4, seed=1, point_indices=np.arange(4)) for m in (model, load_checkpoint(file))
    )
    np.testing.assert_allclose(read.p_WGs, exact.p_WGs, atol=2e-4)


def test_an_untrained_model_gives_the_hand_at_rest(training_set):
    hand, scene = training_set.hands[1], training_set.scenes[0]
    grasps = sample(CVAE(SMALL), hand, scene, 3, seed=0)
    np.testing.assert_allclose(grasps.R_WGs, np.broadcast_to(np.eye(3), grasps.R_WGs.shape), atol=1e-6)
    np.testing.assert_allclose(grasps.p_WGs, grasps.p_WPoints[:, None] + hand.centers, atol=1e-6)


def test_sample(model, training_set):
    hand, scene = training_set.hands[0], training_set.scenes[2]
    grasps = sample(model, hand, scene, 5, seed=1)
    L = len(hand.link_names)
    assert grasps.R_WGs.shape == (5, L, 3, 3) and grasps.p_WGs.shape == (5, L, 3)
    identity = np.broadcast_to(np.eye(3), (5, L, 3, 3))
    np.testing.assert_allclose(grasps.R_WGs @ np.swapaxes(grasps.R_WGs, -1, -2), identity, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(grasps.R_WGs), 1.0, atol=1e-6)
    np.testing.assert_allclose(grasps.p_WPoints, scene.points[grasps.point_indices] + scene.p_WCenter)
    again = sample(model, hand, scene, 5, seed=1)
    np.testing.assert_array_equal(grasps.p_WGs, again.p_WGs)
    assert not np.array_equal(grasps.latents, sample(model, hand, scene, 5, seed=2).latents)
    assert np.all(sample(model, hand, scene, 3, temperature=0.0).latents == 0.0)


def test_hands_share_points_and_latents(model, training_set):
    first, second = (sample(model, hand, training_set.scenes[0], 4, seed=7) for hand in training_set.hands)
    np.testing.assert_array_equal(first.point_indices, second.point_indices)
    np.testing.assert_array_equal(first.latents, second.latents)


def test_moving_the_scene_moves_the_prediction(model, training_set):
    scene = training_set.scenes[0]
    moved = dataclasses.replace(scene, p_WCenter=scene.p_WCenter + np.array([0.3, -0.2, 0.0]))
    one, other = (sample(model, training_set.hands[0], s, 4, seed=0) for s in (scene, moved))
    np.testing.assert_allclose(other.p_WGs - one.p_WGs, np.broadcast_to([0.3, -0.2, 0.0], one.p_WGs.shape), atol=1e-6)
    np.testing.assert_allclose(other.R_WGs, one.R_WGs, atol=1e-6)


def test_neural_retargeting(model, training_set):
    grasps = training_set.grasps[0]
    source, target = training_set.hands
    scene = training_set.scenes[grasps.scene[0]]
    arguments = scene, grasps.R_WGs[:1], grasps.p_WGs[:1], grasps.p_WPoints[:1]
    carried = neural_retarget(model, source, target, *arguments)
    assert carried.R_WGs.shape == (1, len(target.link_names), 3, 3)
    mean, index = encode(model, source, *arguments)
    np.testing.assert_allclose(carried.latents, mean, atol=1e-6)
    np.testing.assert_allclose(scene.points[index] + scene.p_WCenter, grasps.p_WPoints[:1], atol=5e-3)
    # The decoder sees the mean, not a draw: the same call repeats, and a prediction re-encodes to the same point.
    np.testing.assert_array_equal(neural_retarget(model, source, target, *arguments).p_WGs, carried.p_WGs)
