import dataclasses
import json
import multiprocessing
import os
import signal

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from xdex_drake import whole_file
from xdex_drake.errors import CheckpointError, ConfigError
from xdex_drake.learning import run_state, tensor_file, training
from xdex_drake.learning.batches import Views, draw_batch, draw_couples, load_pack
from xdex_drake.learning.checkpoint import load_checkpoint
from xdex_drake.learning.training import TrainConfig, batch_sizes, read_train_config, resolve, split_grasps, train

CONFIG = TrainConfig(
    steps=6,
    batch=8,
    scenes_per_batch=2,
    points=64,
    log_every=2,
    validate_every=3,
    save_every=2,
    ema=0.5,
    model={
        "width": 16,
        "heads": 2,
        "latent": 4,
        "object_channels": [4, 4],
        "embodiment_layers": 1,
        "encoder_layers": 1,
        "decoder_layers": 1,
    },
)


@pytest.fixture(scope="module")
def pack(tiny):
    return tiny()


def _weights(folder):
    """All that a run goes on from, in full precision."""
    return load_file(folder / "state.safetensors")


def _same(a, b):
    return all(torch.equal(a[name], b[name]) for name in a)


def test_training_repeats_exactly(pack, tmp_path):
    whole = train(CONFIG, pack, tmp_path / "whole", progress=False)
    assert (whole.stopped, whole.steps) == ("finished", 6)
    again = train(CONFIG, pack, tmp_path / "again", progress=False)
    assert _same(_weights(tmp_path / "whole"), _weights(tmp_path / "again"))
    assert whole.validation == pytest.approx(again.validation, nan_ok=True)
    # A finished run that is asked for again has nothing to do, and forgets nothing.
    before = (tmp_path / "again" / "model.safetensors").read_bytes()
    assert train(CONFIG, pack, tmp_path / "again", progress=False).steps == 6
    assert (tmp_path / "again" / "model.safetensors").read_bytes() == before


def test_an_interrupted_run_ends_as_an_unbroken_one(pack, tmp_path, monkeypatch):
    train(CONFIG, pack, tmp_path / "whole", progress=False)

    calls = []
    real = training.draw_batch

    def interrupting(*args):
        calls.append(0)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)  # in the middle of the third step
        return real(*args)

    monkeypatch.setattr(training, "draw_batch", interrupting)
    broken = train(CONFIG, pack, tmp_path / "broken", progress=False)
    assert (broken.stopped, broken.steps) == ("interrupted", 3)
    rest = train(CONFIG, pack, tmp_path / "broken", progress=False)
    assert (rest.stopped, rest.steps) == ("finished", 6)
    assert _same(_weights(tmp_path / "whole"), _weights(tmp_path / "broken"))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def _train_until_killed(pack, out, owner, name, number):
    """Trains, and dies of SIGKILL as it calls a function for a given time."""
    torch.set_num_threads(1)
    real, calls = getattr(owner, name), []

    def deadly(*args):
        calls.append(0)
        if len(calls) == number:
            os.kill(os.getpid(), signal.SIGKILL)
        return real(*args)

    setattr(owner, name, deadly)
    train(CONFIG, pack, out, progress=False)


def test_three_kills_end_as_an_unbroken_run(pack, tmp_path):
    train(CONFIG, pack, tmp_path / "whole", progress=False)
    out = tmp_path / "killed"
    context = multiprocessing.get_context("fork")
    moments = [
        (training, "draw_batch", 4),  # in the fourth step: two are saved
        (training, "save_state", 1),  # the model is saved, the state is not
        (whole_file, "_sync", 5),  # the log is cut, the model saved, the state written but not renamed
    ]
    reached = []
    for moment in moments:
        process = context.Process(target=_train_until_killed, args=(pack, out, *moment))
        process.start()
        process.join(250)
        assert process.exitcode == -signal.SIGKILL, moment
        reached.append(json.loads((out / "log.jsonl").read_text().splitlines()[-1])["step"])
    assert len(list(out.glob(".state.safetensors.*.partial"))) == 1
    assert reached[0] == 3
    train(CONFIG, pack, out, progress=False)
    assert (out / "model.safetensors").read_bytes() == (tmp_path / "whole" / "model.safetensors").read_bytes()
    logs = [
        [
            {k: v for k, v in json.loads(line).items() if k not in ("seconds", "grasps_per_second")}
            for line in (f / "log.jsonl").read_text().splitlines()
        ]
        for f in (out, tmp_path / "whole")
    ]
    assert logs[0] == logs[1]
    assert not list(out.glob(".*.partial"))


def test_a_leg_starts_from_the_weights_of_another(pack, tmp_path):
    train(CONFIG, pack, tmp_path / "one", progress=False)
    start = tmp_path / "one" / "model.safetensors"
    still = dataclasses.replace(CONFIG, steps=1, learning_rate=0.0, ema=0.0)
    train(still, pack, tmp_path / "two", start=start, progress=False)
    one, two = (load_checkpoint(tmp_path / name).state_dict() for name in ("one", "two"))
    assert all(torch.equal(one[name], two[name]) for name in one)
    # It goes on only as the leg that it is, and only from a model of the same make.
    with pytest.raises(ConfigError, match="'start'"):
        train(dataclasses.replace(still, steps=2), pack, tmp_path / "two", progress=False)
    other = dataclasses.replace(still, model={**CONFIG.model, "latent": 5})
    with pytest.raises(ConfigError, match="latent"):
        train(other, pack, tmp_path / "three", start=start, progress=False)
    taught_otherwise = dataclasses.replace(still, model={**CONFIG.model, "swap": 0.5})
    assert train(taught_otherwise, pack, tmp_path / "four", start=start, progress=False).steps == 1


def test_the_kept_model_is_the_mean_of_the_weights(pack, tmp_path):
    train(dataclasses.replace(CONFIG, steps=3), pack, tmp_path, progress=False)
    state, kept = _weights(tmp_path), load_checkpoint(tmp_path).state_dict()
    name = "pose_token.weight"
    assert torch.equal(kept[name], state[f"average/{name}"].half().float())
    assert not torch.equal(state[f"average/{name}"], state[f"model/{name}"])


def test_sixteen_bit_products_learn_alike_and_repeat(pack, tmp_path):
    config = dataclasses.replace(CONFIG, precision="bfloat16")
    reports = [train(config, pack, tmp_path / name, progress=False) for name in ("a", "b")]
    assert _same(_weights(tmp_path / "a"), _weights(tmp_path / "b"))
    exact = train(CONFIG, pack, tmp_path / "c", progress=False)
    for name in ("reconstruction", "tips", "posterior_tip_mm"):
        assert reports[0].validation[name] == pytest.approx(exact.validation[name], rel=0.05)


def test_a_seed_changes_the_run(pack, tmp_path):
    train(CONFIG, pack, tmp_path / "a", progress=False)
    train(dataclasses.replace(CONFIG, seed=1), pack, tmp_path / "b", progress=False)
    assert not _same(_weights(tmp_path / "a"), _weights(tmp_path / "b"))


def test_training_leaves_the_global_generator_alone(pack, tmp_path):
    before = torch.get_rng_state()
    train(dataclasses.replace(CONFIG, steps=1), pack, tmp_path, progress=False)
    assert torch.equal(before, torch.get_rng_state())


def test_log_is_json_lines(pack, tmp_path):
    train(CONFIG, pack, tmp_path, progress=False)
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines if "loss" in line] == [2, 4, 6]
    assert [line["step"] for line in lines if "validation" in line] == [3, 6]
    figures = {f"{made}_{what}" for made in ("posterior", "prior", "cross") for what in ("mm", "tip_mm")}
    assert figures | {"reconstruction", "tips", "kl", "point"} == lines[-1]["validation"].keys()
    assert all(lines[-1]["validation"][name] > 0.0 for name in figures)


def test_learning_lowers_the_error_of_the_fingertips(pack, tmp_path):
    config = dataclasses.replace(CONFIG, learning_rate=1e-2, warm_up=5, validate_every=100, ema=0.0)
    before, after = (
        train(dataclasses.replace(config, steps=n), pack, tmp_path / str(n), progress=False).validation for n in (1, 40)
    )
    assert after["reconstruction"] < 0.5 * before["reconstruction"]
    assert after["posterior_tip_mm"] < 0.85 * before["posterior_tip_mm"]


def test_time_limit(pack, tmp_path):
    config = dataclasses.replace(CONFIG, steps=10**6, minutes=0.01)
    report = train(config, pack, tmp_path, progress=False)
    assert report.stopped == "time"
    assert 0 < report.steps < 10**6
    assert load_checkpoint(report.checkpoint).config.width == 16


def test_state_of_another_config_or_data_is_refused(pack, tiny, tmp_path):
    train(dataclasses.replace(CONFIG, steps=1), pack, tmp_path, progress=False)
    with pytest.raises(ConfigError, match="learning_rate"):
        train(dataclasses.replace(CONFIG, learning_rate=2e-3), pack, tmp_path, progress=False)
    with pytest.raises(ConfigError, match="another data"):
        train(CONFIG, tiny(grasps=7), tmp_path, progress=False)
    report = train(dataclasses.replace(CONFIG, seed=3), pack, tmp_path, resume=False, progress=False)
    assert report.steps == 6


@pytest.mark.parametrize("content", [b"", b"junk", b"\x80\x02cos\nsystem\n(S'true'\ntR."])
def test_damaged_state_is_refused(pack, tmp_path, content):
    (tmp_path / "state.safetensors").write_bytes(content)
    with pytest.raises(CheckpointError, match="delete it"):
        train(CONFIG, pack, tmp_path, progress=False)


def test_a_state_that_lacks_a_part_is_refused(pack, tmp_path):
    train(CONFIG, pack, tmp_path, progress=False)
    file = tmp_path / "state.safetensors"
    header = tensor_file.describe(file, run_state._STATE).header
    arrays = tensor_file.read_arrays(file, run_state._STATE)
    whole = file.read_bytes()
    file.write_bytes(whole[:-100])
    with pytest.raises(CheckpointError, match="delete it"):
        train(CONFIG, pack, tmp_path, progress=False)
    for broken in (
        {name: array for name, array in arrays.items() if not name.startswith("model/wrist_head")},
        {**arrays, "optimizer/x": arrays["optimizer/0/step"]},
    ):
        tensor_file.write_tensor_file(file, broken, header)
        with pytest.raises(CheckpointError, match="delete it"):
            train(CONFIG, pack, tmp_path, progress=False)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"batch": 7}, "'batch'"),
        ({"scenes_per_batch": 5}, "'batch'"),
        ({"steps": 0}, "'steps'"),
        ({"ema": 1.0}, "'ema'"),
        ({"mirror": -0.1}, "'mirror'"),
        ({"device": "nonsense"}, "'device'"),
        ({"validation_fraction": 1.0}, "no grasp is left"),
        ({"kind": "gan"}, "no model of kind 'gan'; known are cvae"),
        ({"model": {"width": 10}}, "width"),
        ({"model": {"depth": 10}}, "unknown key 'depth'"),
        ({"weights": {"likelihood": 1.0}}, "unknown term 'likelihood'"),
        ({"warm_ups": {"likelihood": 1}}, "unknown term 'likelihood'"),
    ],
)
def test_bad_configs_are_refused(pack, tmp_path, change, message):
    with pytest.raises(ConfigError, match=message):
        train(dataclasses.replace(CONFIG, **change), pack, tmp_path, progress=False)


def test_a_configuration_spells_out_what_it_leaves_to_the_model(tmp_path):
    file = tmp_path / "train.yaml"
    file.write_text("model: {width: 32}\nweights: {cross: 0.5}\n")
    config = read_train_config(file, steps=7, minutes=None)
    assert config.model["width"] == 32 and config.model["latent"] == 32 and config.steps == 7
    assert config.weights["cross"] == 0.5 and config.weights["reconstruction"] == 1.0
    assert resolve(config) == config


def test_held_out_scenes_are_not_trained_on(pack):
    split = split_grasps(pack, CONFIG)
    assert len(split.scenes) == 1 and split.scenes.keys() | split.train.keys() == set(range(6))
    named = dataclasses.replace(pack, held_scenes=np.array([1, 0, 0, 0, 0, 1], dtype=np.uint8))
    split = split_grasps(named, CONFIG)
    assert list(split.scenes) == [0, 5] and list(split.train) == [1, 2, 3, 4] and not split.hands


def test_held_out_hands_and_failures_are_not_trained_on(pack, tmp_path):
    outcome = np.zeros_like(pack.outcome)
    outcome[::3] = 1
    held = dataclasses.replace(pack, held_hands=np.array([0, 1], dtype=np.uint8), outcome=outcome)
    split = split_grasps(held, CONFIG)
    trained = np.concatenate(list(split.train.values()))
    assert (pack.hand[trained] == 0).all() and (outcome[trained] == 0).all()
    new = np.concatenate(list(split.hands.values()))
    assert (pack.hand[new] == 1).all() and (outcome[new] == 0).all()
    report = train(dataclasses.replace(CONFIG, steps=2), held, tmp_path, progress=False)
    assert {"posterior_tip_mm", "hands_posterior_tip_mm"} <= report.validation.keys()


def test_couples_are_pairs_of_two_hands(pack):
    data = load_pack(pack, torch.device("cpu"))
    pool = split_grasps(pack, dataclasses.replace(CONFIG, validation_fraction=0.0)).train
    batch = draw_batch(data, pool, batch_sizes(CONFIG), np.random.default_rng(0))
    assert batch.poses.shape[0] == 8
    assert bool(batch.paired.all())
    assert bool((batch.hand[::2] != batch.hand[1::2]).all())
    assert bool((batch.cloud[::2] == batch.cloud[1::2]).all())
    # A pair shares its object point, and so the feature that conditions it.
    assert bool((batch.point[::2] == batch.point[1::2]).all())


def test_a_scene_draws_from_as_many_hands_as_are_asked_for(tiny):
    pack = tiny(grasps=4, shapes=((3, 2), (2, 2), (2, 3), (3, 3), (1, 4)))
    data = load_pack(pack, torch.device("cpu"))
    here = np.flatnonzero(pack.scene == 1)
    grasps = draw_couples(data, here, 20, np.random.default_rng(0), hands=2)
    assert len(np.unique(pack.hand[grasps])) == 2
    # Couples are still of one source.
    assert (pack.pair[grasps[::2]] == pack.pair[grasps[1::2]]).all()
    assert len(np.unique(pack.hand[draw_couples(data, here, 20, np.random.default_rng(0))])) == 5


def test_a_grasp_is_the_same_alone_and_padded(pack):
    """Hands of unequal numbers of links: what the batch says of the smaller does not depend on its company."""
    data = load_pack(pack, torch.device("cpu"))
    sizes = batch_sizes(CONFIG)
    small = np.flatnonzero((pack.scene == 0) & (pack.hand == 1))[:2]
    large = np.flatnonzero((pack.scene == 0) & (pack.hand == 0))[:2]
    pool = {0: np.flatnonzero(pack.scene == 0)}
    alone, mixed = (
        training.make_batch(data, pool, grasps, Views.plain(1), sizes, np.random.default_rng(0))
        for grasps in (small, np.concatenate([large, small]))
    )
    n = int(pack.links[1])
    assert alone.mask.shape == (2, n) and mixed.mask.shape == (4, int(pack.links[0]))
    assert mixed.mask[2:].sum(dim=1).tolist() == [n, n]
    torch.testing.assert_close(mixed.poses[2:, :n], alone.poses)
    torch.testing.assert_close(mixed.hands.spd[1, :n, :n], alone.hands.spd[0])
    torch.testing.assert_close(mixed.hands.points[-n:], alone.hands.points)
