"""Grasps of other tools' files are judged as ours are; what cannot be judged is one line, and nothing runs."""

import json
import pickle

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from xdex_drake.cli import main
from xdex_drake.dataset.files import load_grasps
from xdex_drake.interchange.formats import FORMATS


@pytest.fixture(scope="module")
def grasps(tmp_path_factory):
    """A file of two grasps of the can by Allegro, and what is said of them."""
    folder = tmp_path_factory.mktemp("grasps")
    file = folder / "grasps.parquet"
    words = ["grasp", "--hand", "allegro", "--object", "can", "--count", "2", "--workers", "1", "--out", str(file)]
    assert main(words) == 0
    return file, judged(file, folder)


def judged(file, folder, *words):
    out = folder / "judged.parquet"
    status = main(["judge", str(file), *words, "--workers", "0", "--out", str(out)])
    assert status == 0, words
    return pq.read_table(out).to_pylist()


def exported(grasps, format, folder):
    out = folder / f"x{FORMATS[format].suffixes[0]}"
    assert main(["export", str(grasps[0]), "--format", format, "--out", str(out)]) == 0
    return out


def test_our_own_grasps_are_certified_and_lift(grasps):
    for row, item in zip(grasps[1], load_grasps(grasps[0]), strict=True):
        assert row["certified"] and row["lift-0.2/2tips"] and row["reason"] == "" and row["made"] == []
        assert {c.link for c in item.grasp.certificate.contacts} <= set(row["contacts"])
        assert row["penetration_mm"] < 0.5 and row["beyond_limits"] < 1e-9 and row["task_margin"] > 1.0


@pytest.mark.parametrize("format", ["isaac_grasp", "dexgraspbench", "arrays"])
def test_every_format_gets_the_same_verdict(grasps, format, tmp_path):
    rows = judged(exported(grasps, format, tmp_path), tmp_path, "--grasps", str(tmp_path / "ours.parquet"))
    for ours, theirs in zip(grasps[1], rows, strict=True):
        for name in ("task_margin", "ball_margin", "penetration_mm"):
            assert theirs[name] == pytest.approx(ours[name], abs=1e-4)
        assert {k: v for k, v in theirs.items() if isinstance(v, bool | list)} == {
            k: v for k, v in ours.items() if isinstance(v, bool | list)
        }
    for item, again in zip(load_grasps(grasps[0]), load_grasps(tmp_path / "ours.parquet"), strict=True):
        np.testing.assert_allclose(again.grasp.X_WH.GetAsMatrix4(), item.grasp.X_WH.GetAsMatrix4(), atol=1e-9)
        np.testing.assert_allclose(again.grasp.tau_squeeze, item.grasp.tau_squeeze, atol=1e-9)
        assert again.grasp.lift is not None and again.grasp.lift.success


def test_what_a_file_lacks_is_made_by_rule(grasps, tmp_path, capsys):
    file = exported(grasps, "isaac_grasp", tmp_path)
    content = yaml.safe_load(file.read_text())
    plain = {"confidence", "position", "orientation", "cspace_position"}
    content["grasps"] = {name: {k: v for k, v in one.items() if k in plain} for name, one in content["grasps"].items()}
    file.write_text(yaml.safe_dump(content))
    for row in judged(file, tmp_path, "--protocol", "bench-fc"):
        assert row["made"] == ["pregrasp", "squeeze"] and row["certified"]
    assert "made by rule" in capsys.readouterr().out
    del content["gripper_frame"], content["object_file"], content["object_frame"], content["hand"]
    file.write_text(yaml.safe_dump(content))
    for words, said in (
        ([], "names no hand; give it by --hand"),
        (["--hand", "allegro"], "names no frame; say which"),
        (["--hand", "allegro", "--frame", "base_link"], "names no object; give the mesh by --object"),
    ):
        refused(capsys, [str(file), *words], said)


def test_a_deep_grasp_is_told_by_its_depth(grasps, tmp_path):
    file = exported(grasps, "isaac_grasp", tmp_path)
    content = yaml.safe_load(file.read_text())
    one = next(iter(content["grasps"].values()))
    one["position"] = [0.9 * x for x in one["position"]]
    file.write_text(yaml.safe_dump(content))
    row = judged(file, tmp_path)[0]
    assert not row["certified"] and row["reason"].startswith("penetration: ") and row["penetration_mm"] > 2.0


def refused(capsys, words, *said):
    capsys.readouterr()
    assert main(["judge", *words, "--out", "never.parquet"]) == 2
    told = capsys.readouterr()
    assert told.out == "" and told.err.count("\n") == 1
    for words in said:
        assert words in told.err


def test_bad_input_is_one_line_and_nothing_runs(grasps, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = exported(grasps, "dexgraspbench", tmp_path)
    refused(capsys, [str(file), "--hand", "shadow"], "of another hand")
    refused(capsys, [str(file), "--hand", "no_such"], "no hand")
    refused(capsys, [str(file), "--object", "missing.obj"], "missing.obj")
    refused(capsys, [str(file), "--protocol", "bench-fx"], "bench-fc")
    refused(capsys, [str(file), "--frame", "palm"], "no such link")
    refused(capsys, [str(file), "--joint-order", "a", "b"], "16 joint values for 2")
    refused(capsys, ["absent.yaml"], "absent.yaml", "cannot be read")
    refused(capsys, [str(grasps[0]), "--frame", "palm"], "--frame")
    refused(capsys, [str(grasps[0]), "--hand", "shadow"], "by allegro")
    beside = json.loads(file.with_suffix(".json").read_text())
    for path in ("../can.obj", "/etc/passwd", "other.obj"):
        file.with_suffix(".json").write_text(json.dumps({**beside, "obj_path": [path, path]}))
        refused(capsys, [str(file)], "--object")
    np.save("x.npy", np.array({"grasp_qpos": pickle.Pickler}, dtype=object), allow_pickle=True)
    refused(capsys, ["x.npy", "--hand", "allegro", "--object", "can"], "pickle")
    assert not (tmp_path / "never.parquet").exists()
