"""A model by the command line: a data set packed, a model trained on it, grasps predicted by it."""

import re
from pathlib import Path

import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.cli import main
from xdex_drake.dataset.folder import Manifest, open_dataset, write_shard
from xdex_drake.dataset.grasp_file import read_grasps
from xdex_drake.dataset.rows import object_facts
from xdex_drake.dataset.schema import row_from_grasp
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.library import load_hand
from xdex_drake.learning.checkpoint import checkpoint_header
from xdex_drake.learning.pack import read_pack
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene

TINY = Path(__file__).parents[1] / "learning" / "tiny.yaml"


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """A data set whose grasps hover above the can: what training reads, without hours of lifts."""
    folder = tmp_path_factory.mktemp("learning") / "pairs"
    scene = make_scene(load_object("can"))
    facts = object_facts(scene.object)
    open_dataset(folder, Manifest(config={}, seed=0, units=("a",), versions={}, digests={}))
    rows = []
    for k in range(4):
        X_WH = RigidTransform(RollPitchYaw(3.14, 0.1 * k, 0.0), [0.02 * k, 0.0, 0.25])
        for hand in (load_hand("inspire"), load_hand("ability")):
            lift = Lift("lift-0.2/2tips", k < 3, "" if k < 3 else "slipped", 0.25, ("thumb", "index"), 0.1)
            name, source = f"{hand.name}-{k}", "" if hand.name == "inspire" else f"inspire-{k}"
            grasp = Grasp(
                hand.name, "can", scene.X_WO, X_WH, hand.q_rest, lift=lift, grasp_id=name, source_grasp_id=source
            )
            rows.append(row_from_grasp(grasp, scene_id=scene.scene_id, hand=hand, hand_digest="", object=facts))
    write_shard(folder, "a", rows)
    return folder


def test_a_model_learns_from_a_data_set_as_from_its_pack(pairs, tmp_path, capsys):
    pack, one, other = tmp_path / "pairs.safetensors", tmp_path / "one", tmp_path / "other"
    assert main(["dataset", "pack", str(pairs), "--out", str(pack)]) == 0
    said = capsys.readouterr().out
    assert re.search(r"grasps that lifted\s+6", said) and re.search(r"grasps that did not\s+2", said)
    assert read_pack(pack).hand_names == ("inspire", "ability")
    assert main(["train", str(TINY), "--pack", str(pack), "--out", str(one)]) == 0
    assert re.search(r"stopped\s+finished", capsys.readouterr().out)
    assert main(["train", str(TINY), "--data", str(pairs), "--out", str(other), "--steps", "4"]) == 0
    assert (one / "model.safetensors").read_bytes() == (other / "model.safetensors").read_bytes()
    assert checkpoint_header(one)["notes"]["hands"] == ["inspire", "ability"]
    assert main(["train", str(TINY), "--pack", str(pack), "--from", str(one), "--out", str(tmp_path / "leg")]) == 0
    assert (tmp_path / "leg" / "model.safetensors").read_bytes() != (one / "model.safetensors").read_bytes()
    capsys.readouterr()
    # What the weights of four steps predict is no grasp, but the command says so.
    words = ["predict", "--model", str(one), "--hand", "inspire", "--object", "can", "--count", "1", "--no-lift"]
    assert main([*words, "--out", str(tmp_path / "p.parquet")]) in (0, 1)
    assert "rejected by" in capsys.readouterr().out


def test_splits_hold_hands_out(pairs, tmp_path, capsys):
    splits, pack = tmp_path / "splits.yaml", tmp_path / "p.safetensors"
    splits.write_text("validation_hands: [ability]\n")
    assert main(["dataset", "pack", str(pairs), "--out", str(pack), "--splits", str(splits), "--failures", "0"]) == 0
    assert read_pack(pack).held_hands.tolist() == [0, 1]
    assert main(["train", str(TINY), "--pack", str(pack), "--out", str(tmp_path / "m"), "--steps", "1"]) == 0
    assert "validation hands_posterior_tip_mm" in capsys.readouterr().out


def test_a_printed_configuration_can_be_given_again(tmp_path, capsys):
    assert main(["train", str(TINY), "--print-config"]) == 0
    printed = capsys.readouterr().out
    (tmp_path / "t.yaml").write_text(printed)
    assert main(["train", str(tmp_path / "t.yaml"), "--print-config"]) == 0
    assert capsys.readouterr().out == printed and "decoder_layers: 1" in printed and "cross: 0.0" in printed


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["train", "--data", "a", "--pack", "b"], "--data and --pack"),
        (["train", "--pack", "none.safetensors"], "no such training pack"),
        (["train", "--data", "none"], "is no data set"),
        (["dataset", "pack", "none"], "is no data set"),
        (["dataset", "pack", "none", "--out", "pack.parquet"], ".safetensors"),
        (["dataset", "pack", "none", "--failures", "-1"], "--failures"),
        (["predict", "--model", "none", "--hand", "inspire", "--object", "can"], "no such checkpoint"),
    ],
)
def test_refusals(words, expected, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    said = capsys.readouterr().err
    assert expected in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_predictions_are_certified_grasps(tmp_path, capsys):
    out = tmp_path / "predicted.parquet"
    words = ["predict", "--hand", "inspire", "--object", "can", "--count", "6", "--seed", "0", "--no-lift"]
    status = main([*words, "--out", str(out)])
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("inspire"))
    drawn, certified = (int(n) for n in line.split()[1:3])
    assert drawn == 6 and status == (0 if certified else 1)
    rows = read_grasps(out) if certified else []
    assert len(rows) == certified
    assert all(row["wrench_residual"] < 1e-6 and row["success"] is None for row in rows)
