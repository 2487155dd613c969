"""Grasps by the command line: made, stored, lifted again, exported, retargeted."""

import json

import pytest

from xdex_drake.cli import main
from xdex_drake.dataset.files import load_grasps
from xdex_drake.dataset.parallel import GraspRequest, RequestTally, synthesize_batches
from xdex_drake.dataset.store import read_grasps, write_grasps


@pytest.fixture(scope="module")
def grasps(tmp_path_factory):
    """A file of two grasps of the can by Allegro."""
    file = tmp_path_factory.mktemp("grasps") / "grasps.parquet"
    words = ["grasp", "--hand", "allegro", "--object", "can", "--count", "2", "--workers", "1", "--out", str(file)]
    assert main(words) == 0
    return file


def test_the_file_holds_lifted_and_certified_grasps(grasps):
    stored = load_grasps(grasps)
    assert len(stored) == 2
    for item in stored:
        assert item.grasp.lift is not None and item.grasp.lift.success and item.grasp.certificate is not None
        assert item.hand.name == "allegro" and item.scene.object.name == "can"
    assert len({item.grasp.grasp_id for item in stored}) == 2


def test_lifts_repeat(grasps, tmp_path, capsys):
    out = tmp_path / "again.parquet"
    assert main(["lift", str(grasps), "--out", str(out), "--workers", "1"]) == 0
    before, after = read_grasps(grasps), read_grasps(out)
    for old, new in zip(before, after, strict=True):
        # A pose is rounded when it is stored, by 1e-15.
        assert new["lift_height_m"] == pytest.approx(old["lift_height_m"], abs=1e-6)
        told = dict.fromkeys(("lift_seconds", "lift_height_m"))
        assert {**old, **told} == {**new, **told}


def test_export_is_plain_json(grasps, tmp_path):
    out = tmp_path / "grasps.json"
    assert main(["export", str(grasps), "--out", str(out)]) == 0
    content = json.loads(out.read_text())
    assert len(content["grasps"]) == 2 and content["columns"]["mass_kg"]["unit"] == "kg"
    assert content["grasps"][0]["q"] == read_grasps(grasps)[0]["q"]


def test_retargeted_grasps_name_their_source(grasps, tmp_path, capsys):
    out = tmp_path / "pairs.parquet"
    status = main(["retarget", str(grasps), "--to", "allegro", "--out", str(out), "--workers", "1", "--keep-failed"])
    said = capsys.readouterr().out
    assert "allegro" in said and "rejected by" in said
    assert status in (0, 1)
    if out.exists():
        sources = {row["grasp_id"] for row in read_grasps(grasps)}
        assert {row["source_grasp_id"] for row in read_grasps(out)} <= sources


@pytest.mark.parametrize("column", ["object_digest", "hand_digest"])
def test_a_changed_mesh_or_hand_is_refused(grasps, tmp_path, capsys, column):
    file = tmp_path / "changed.parquet"
    write_grasps(file, [{**row, column: "0" * 64} for row in read_grasps(grasps)])
    assert main(["lift", str(file)]) == 2
    assert "restore" in capsys.readouterr().err


def test_nothing_found_is_status_1(tmp_path, capsys):
    out = tmp_path / "none.parquet"
    words = ["grasp", "--hand", "allegro", "--object", "can", "--friction", "0.01", "--time-limit", "3"]
    assert main([*words, "--workers", "1", "--out", str(out)]) == 1
    assert not out.exists() and "rejected by" in capsys.readouterr().out


@pytest.mark.slow
def test_two_workers_find_what_one_finds():
    request = GraspRequest("ability", "can", seed=3)

    def found(workers: int) -> tuple[list, int]:
        tally = RequestTally()
        batches = synthesize_batches(request, count=3, workers=workers, time_limit_s=600.0, tally=tally)
        return [(g.grasp_id, g.q.tolist()) for batch in batches for g in batch.grasps], tally.tried

    assert found(0) == found(2)
