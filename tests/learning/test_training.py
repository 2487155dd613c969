import dataclasses
import json
import signal

import numpy as np
import pytest
import torch

from xdex_drake.errors import CheckpointError, ConfigError
from xdex_drake.learning import training
from xdex_drake.learning.batches import TrainingSet, draw_batch, pack
from xdex_drake.learning.checkpoint import load_checkpoint
from xdex_drake.learning.models.cvae import CVAEConfig
from xdex_drake.learning.training import TrainConfig, batch_sizes, split_scenes, train

CONFIG = TrainConfig(
    steps=6,
    batch=8,
    scenes_per_batch=2,
    points=64,
    log_every=2,
    validate_every=3,
    save_every=2,
    model=CVAEConfig(width=16, heads=2, latent=4, object_channels=(4, 4), decoder_layers=1),
)


def _weights(folder):
    return {name: tensor.clone() for name, tensor in load_checkpoint(folder).state_dict().items()}


def _same(a, b):
    return all(torch.equal(a[name], b[name]) for name in a)


def test_training_repeats_and_resumes_exactly(training_set, tmp_path):
    whole = train(CONFIG, training_set, tmp_path / "whole", progress=False)
    assert (whole.stopped, whole.steps) == ("finished", 6)
    again = train(CONFIG, training_set, tmp_path / "again", progress=False)
    assert _same(_weights(tmp_path / "whole"), _weights(tmp_path / "again"))
    assert whole.validation == pytest.approx(again.validation, nan_ok=True)


def test_an_interrupted_run_ends_as_an_unbroken_one(training_set, tmp_path, monkeypatch):
    train(CONFIG, training_set, tmp_path / "whole", progress=False)

    calls = []
    real = training.draw_batch

    def interrupting(*args):
        calls.append(0)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)  # in the middle of the third step
        return real(*args)

    monkeypatch.setattr(training, "draw_batch", interrupting)
    broken = train(CONFIG, training_set, tmp_path / "broken", progress=False)
    assert (broken.stopped, broken.steps) == ("interrupted", 3)
    rest = train(CONFIG, training_set, tmp_path / "broken", progress=False)
    assert (rest.stopped, rest.steps) == ("finished", 6)
    assert _same(_weights(tmp_path / "whole"), _weights(tmp_path / "broken"))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_seed_changes_the_run(training_set, tmp_path):
    train(CONFIG, training_set, tmp_path / "a", progress=False)
    train(dataclasses.replace(CONFIG, seed=1), training_set, tmp_path / "b", progress=False)
    assert not _same(_weights(tmp_path / "a"), _weights(tmp_path / "b"))


def test_training_leaves_the_global_generator_alone(training_set, tmp_path):
    before = torch.get_rng_state()
    train(dataclasses.replace(CONFIG, steps=1), training_set, tmp_path, progress=False)
    assert torch.equal(before, torch.get_rng_state())


def test_log_is_json_lines(training_set, tmp_path):
    train(CONFIG, training_set, tmp_path, progress=False)
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines if "loss" in line] == [2, 4, 6]
    assert [line["step"] for line in lines if "validation" in line] == [3, 6]
    assert {"position_mm", "prior_mm", "cross_mm", "point_gain"} <= lines[-1]["validation"].keys()


def test_time_limit(training_set, tmp_path):
    config = dataclasses.replace(CONFIG, steps=10**6, minutes=0.01)
    report = train(config, training_set, tmp_path, progress=False)
    assert report.stopped == "time"
    assert 0 < report.steps < 10**6
    assert load_checkpoint(report.checkpoint).config == CONFIG.model


def test_state_of_another_config_or_data_is_refused(training_set, tmp_path):
    train(dataclasses.replace(CONFIG, steps=1), training_set, tmp_path, progress=False)
    with pytest.raises(ConfigError, match="learning_rate"):
        train(dataclasses.replace(CONFIG, learning_rate=2e-3), training_set, tmp_path, progress=False)
    fewer = TrainingSet(training_set.hands, training_set.scenes, training_set.samples[:-2])
    with pytest.raises(ConfigError, match="another data"):
        train(CONFIG, fewer, tmp_path, progress=False)
    report = train(dataclasses.replace(CONFIG, seed=3), training_set, tmp_path, resume=False, progress=False)
    assert report.steps == 6


@pytest.mark.parametrize("content", [b"", b"junk", b"\x80\x02cos\nsystem\n(S'true'\ntR."])
def test_damaged_state_is_refused(training_set, tmp_path, content):
    (tmp_path / "state.pt").write_bytes(content)
    with pytest.raises(CheckpointError, match="delete it"):
        train(CONFIG, training_set, tmp_path, progress=False)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"batch": 7}, "'batch'"),
        ({"scenes_per_batch": 5}, "'batch'"),
        ({"steps": 0}, "'steps'"),
        ({"device": "nonsense"}, "'device'"),
        ({"validation_fraction": 1.0}, "no scene is left"),
    ],
)
def test_bad_configs_are_refused(training_set, tmp_path, change, message):
    with pytest.raises(ConfigError, match=message):
        train(dataclasses.replace(CONFIG, **change), training_set, tmp_path, progress=False)


def test_bad_grasps_are_refused(training_set, tmp_path):
    good = training_set.samples[0]
    for bad in (
        dataclasses.replace(good, hand=9),
        dataclasses.replace(good, p_WLs=good.p_WLs[:-1]),
        dataclasses.replace(good, p_WLs=np.full_like(good.p_WLs, np.nan)),
    ):
        with pytest.raises(ConfigError):
            train(CONFIG, dataclasses.replace(training_set, samples=(bad,)), tmp_path, progress=False)


def test_held_out_scenes_are_not_trained_on(training_set):
    data = pack(training_set, torch.device("cpu"))
    kept, held = split_scenes(data, CONFIG, None)
    assert len(held) == 1 and set(kept) | set(held) == set(range(6))
    kept, held = split_scenes(data, CONFIG, [0, 5])
    assert held.tolist() == [0, 5] and kept.tolist() == [1, 2, 3, 4]


def test_couples_are_pairs_of_two_hands(training_set):
    data = pack(training_set, torch.device("cpu"))
    batch = draw_batch(data, np.arange(6), batch_sizes(CONFIG), np.random.default_rng(0))
    assert batch.poses.shape[0] == 8
    assert bool(batch.paired.all())
    assert bool((batch.hand[::2] != batch.hand[1::2]).all())
    assert bool((batch.cloud[::2] == batch.cloud[1::2]).all())
    # A pair shares its object point, and so the feature that conditions it.
    assert bool((batch.point[::2] == batch.point[1::2]).all())
