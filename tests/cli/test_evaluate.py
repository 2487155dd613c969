"""`xdex evaluate`: a bench of one hand on one object, and the ladder on a data set of one grasp."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import torch
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.cli import main
from xdex_drake.dataset.folder import Manifest, open_dataset, write_shard
from xdex_drake.dataset.grasp_file import read_grasps
from xdex_drake.dataset.rows import rows_of
from xdex_drake.grasp import Lift
from xdex_drake.hand.library import load_hand
from xdex_drake.learning.checkpoint import save_checkpoint
from xdex_drake.learning.models.cvae import CVAE, CVAEConfig
from xdex_drake.learning.proposer import raw_grasp
from xdex_drake.programs.search import Candidates
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene

BENCH = "hands: {unseen: [inspire]}\nobjects: [can]\ndraws: 3\njudged: 2\n"


def _rows(folder):
    with (folder / "verdicts.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_bench_judges_every_draw_and_goes_on_where_it_stopped(tmp_path, capsys):
    config, out = tmp_path / "bench.yaml", tmp_path / "out"
    config.write_text(BENCH)
    words = ["evaluate", str(config), "--out", str(out), "--workers", "0"]
    assert main(words) == 0
    said = capsys.readouterr().out
    rows = _rows(out)
    assert [(row["stage"], row["sample"]) for row in rows if row["stage"] != "best"] == [
        ("raw", "0"), ("raw", "1"), ("refined", "0"), ("refined", "1"),
    ]  # fmt: skip
    assert sum(row["stage"] == "best" for row in rows) == 1 and "best" in said
    for row in rows:
        assert (row["lifted"] == "1") == (row["reason"] == "")
        assert row["found"] == "1" or row["lifted"] == "0"
    # What was certified lies near its draw, and is stored with its lift.
    near = [float(row["moved_cm"]) for row in rows if row["stage"] == "refined" and row["found"] == "1"]
    assert all(moved < 2.1 for moved in near)
    (cell,) = (out / "cells").glob("*.csv")
    grasps = read_grasps(cell.with_suffix(".parquet")) if any(row["found"] == "1" for row in rows) else []
    assert len(grasps) == sum(row["found"] == "1" for row in rows)
    # Nothing is done twice; what is missing is done again and comes out the same.
    kept = cell.read_text()
    changed = kept.replace("inspire", "inspire", 1)
    cell.write_text(changed)
    assert main(words) == 0 and cell.read_text() == changed
    capsys.readouterr()
    config.write_text(BENCH + "seed: 3\n")
    assert main(words) == 2 and "another bench" in capsys.readouterr().err


@pytest.fixture(scope="module")
def one_grasp(tmp_path_factory):
    """A data set of one grasp that is told to have lifted, and an untrained model."""
    folder = tmp_path_factory.mktemp("ladder")
    scene, hand = make_scene(load_object("can")), load_hand("inspire")
    X_WH = RigidTransform(RollPitchYaw(0.0, 1.6, 0.0), [-0.16, 0.0, 0.06])
    q = 0.5 * hand.q_rest + 0.5 * hand.limits.mean(axis=0)
    R, p = X_WH.rotation().matrix()[None], X_WH.translation()[None]
    found = raw_grasp(hand, scene, Candidates(R, p, q[None], np.ones((1, 5), dtype=bool), np.zeros(1), {}), 0)
    grasp = replace(found, grasp_id="a", lift=Lift("lift-0.2/2tips", True, "", 0.25, ("thumb", "index"), 0.1))
    open_dataset(folder / "data", Manifest(config={}, seed=0, units=("a",), versions={}, digests={}))
    write_shard(folder / "data", "a", rows_of([grasp], hand, scene))
    torch.manual_seed(0)
    model = CVAE(CVAEConfig(width=16, heads=2, latent=4, object_channels=(4, 4), decoder_layers=1))
    save_checkpoint(model, folder / "model")
    return folder


def test_the_ladder_says_where_grasps_get_lost(one_grasp, tmp_path, capsys):
    words = ["evaluate", "--ladder", "--data", str(one_grasp / "data"), "--model", str(one_grasp / "model")]
    assert main([*words, "--out", str(tmp_path), "--workers", "0", "--unseen", "inspire"]) == 0
    assert "posterior refined" in capsys.readouterr().out
    rows = {row["stage"]: row for row in _rows(tmp_path)}
    steps = [f"{step} {stage}" for step in ("poses", "posterior", "prior", "point") for stage in ("raw", "refined")]
    assert list(rows) == ["labels", *steps]
    assert {row["group"] for row in rows.values()} == {"unseen"}
    # Link poses say all there is to say of a grasp: inverse kinematics gives it back.
    assert float(rows["poses raw"]["tip_mm"]) < 0.1 and float(rows["poses raw"]["moved_cm"]) < 0.01
    # An untrained model gives the hand at rest at the object point, which is not the grasp.
    assert float(rows["posterior raw"]["tip_mm"]) > 10.0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["evaluate"], "no configuration file"),
        (["evaluate", "--ladder"], "--data"),
        (["evaluate", "--ladder", "--data", "none"], "no data set"),
        (["evaluate", "x.yaml", "--workers", "-1"], "--workers"),
    ],
)
def test_refusals(words, expected, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    said = capsys.readouterr().err
    assert expected in said and said.count("\n") == 1
