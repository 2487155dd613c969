"""A data set of a hand and a mesh from files is sent elsewhere, and is all there."""

import os
from pathlib import Path

import pytest
import trimesh

from xdex_drake.cli import main
from xdex_drake.dataset.folder import read_dataset
from xdex_drake.hand.library import load_hand
from xdex_drake.interchange.urdf import export_urdf

CONFIG = """
hands: [inspire, files/hands/claw/claw.urdf]
source_hands: [inspire]
objects: [files/brick.obj]
targets: 1
candidates: 16
sources_per_unit: 2
hold_every: 0
"""
TRAINING = Path(__file__).parents[1] / "learning" / "tiny.yaml"


@pytest.fixture(scope="module")
def sent(tmp_path_factory):
    """The folder of a data set, after it was moved and everything that it was made from was deleted."""
    home, before = tmp_path_factory.mktemp("home"), os.getcwd()
    os.chdir(home)
    try:
        (home / "files").mkdir()
        trimesh.creation.box([0.045, 0.055, 0.09]).export("files/brick.obj")
        urdf = export_urdf(load_hand("inspire"), home / "files" / "hands" / "claw")
        urdf.rename(urdf.with_name("claw.urdf"))
        (home / "pairs.yaml").write_text(CONFIG)
        assert main(["dataset", "generate", "pairs.yaml", "--out", "pairs", "--workers", "1", "--table", "table"]) == 0
        moved = tmp_path_factory.mktemp("elsewhere") / "sent"
        (home / "pairs").rename(moved)
        (home / "table").rename(moved.with_name("table"))
        (home / "files").rename(home / "gone")
    finally:
        os.chdir(before)
    return moved


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_it_holds_all_that_its_rows_name(sent, elsewhere, capsys):
    rows = read_dataset(sent).to_pylist()
    assert len({row["hand"] for row in rows}) == 2
    assert {row["object_path"] for row in rows} == {f"assets/{rows[0]['object_digest']}/brick.obj"}
    text = (sent / "manifest.json").read_text() + "".join(
        path.read_bytes().decode(errors="ignore") for path in (sent / "shards").iterdir()
    )
    assert str(sent.parent) not in text
    assert main(["dataset", "verify", str(sent)]) == 0
    assert "problems" in capsys.readouterr().out


def test_it_trains(sent, elsewhere, tmp_path):
    assert main(["train", str(TRAINING), "--data", str(sent), "--out", "model"]) == 0
    assert (tmp_path / "model" / "model.safetensors").exists()


def test_its_shards_are_shown_and_lifted_again(sent, elsewhere, tmp_path):
    (shard,) = (sent / "shards").iterdir()
    last = len(read_dataset(sent)) - 1
    assert main(["view", str(shard), "--all", "--html", "all.html"]) == 0
    assert main(["lift", str(shard), "--workers", "1", "--out", "again.parquet"]) == 0
    # What was made of it names its hands and meshes, wherever they are.
    assert main(["view", "again.parquet", "--row", str(last), "--html", "last.html"]) == 0


def test_its_compact_table_gives_it_back(sent, elsewhere):
    assert main(["dataset", "expand", str(sent.with_name("table")), "--out", "again", "--workers", "1"]) == 0
    assert main(["dataset", "verify", "again"]) == 0
    keys = ("grasp_id", "hand", "hand_digest", "object_path", "object_digest")
    same = [[{key: row[key] for key in keys} for row in read_dataset(folder).to_pylist()] for folder in (sent, "again")]
    assert same[0] == same[1]
