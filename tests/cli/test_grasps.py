"""Grasps by the command line: made, stored, lifted again, exported, retargeted."""

import json
import signal
import subprocess
import sys
import time
from collections import Counter

import numpy as np
import pytest
import trimesh

from xdex_drake.cli import main
from xdex_drake.cli.grasps import _other_sides
from xdex_drake.dataset.files import load_grasps
from xdex_drake.dataset.grasp_file import read_grasps, write_grasps
from xdex_drake.grasping.tally import Tally
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.mirror import mirror
from xdex_drake.interchange.formats import FORMATS
from xdex_drake.interchange.naming import resolve
from xdex_drake.jobs.grasps import BatchResult, GraspRequest, synthesize_batches
from xdex_drake.jobs.preparation import SceneRequest, prepare
from xdex_drake.programs.obstacles import thicknesses, too_thick
from xdex_drake.scene.facts import SceneFacts
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene


@pytest.fixture(scope="module")
def grasps(tmp_path_factory):
    """A file of two grasps of the can by Allegro."""
    file = tmp_path_factory.mktemp("grasps") / "grasps.parquet"
    words = ["grasp", "--hand", "allegro", "--object", "can", "--count", "2", "--workers", "1", "--out", str(file)]
    assert main([*words, "--time-limit", "250"]) == 0
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
    (item, _), package = load_grasps(grasps), content["execution"][0]
    names = [waypoint["name"] for waypoint in package["waypoints"]]
    assert names == ["approach", "pregrasp", "grasp", "squeeze", "lift"]
    times = [waypoint["time_s"] for waypoint in package["waypoints"]]
    assert times == sorted(times) and package["hand"]["joint_names"] == list(item.hand.joint_names)
    squeeze = package["waypoints"][3]
    np.testing.assert_allclose(squeeze["torque"], item.grasp.tau_squeeze)
    np.testing.assert_allclose(squeeze["X_WB"], item.row["X_WB"], atol=1e-9)
    assert package["waypoints"][4]["X_WB"][2] == pytest.approx(squeeze["X_WB"][2] + 0.25)


@pytest.mark.parametrize("format", ["isaac_grasp", "dexgraspbench", "arrays"])
def test_export_to_other_tools_names_what_it_holds(grasps, format, tmp_path, capsys):
    form = FORMATS[format]
    out = tmp_path / f"x{form.suffixes[0]}"
    assert main(["export", str(grasps), "--format", format, "--out", str(out)]) == 0
    for item, record in zip(load_grasps(grasps), form.read(out), strict=True):
        assert record.name == item.grasp.grasp_id and record.object == "can"
        np.testing.assert_allclose(resolve(record, item.hand, str(out)).grasp.q, item.grasp.q)
    assert main(["export", str(grasps), "--format", format, "--out", str(tmp_path / "x.txt")]) == 2


def test_export_as_urdf_is_a_folder_to_play_from(grasps, tmp_path):
    assert main(["export", str(grasps), "--format", "urdf", "--out", str(tmp_path / "robot")]) == 0
    assert (tmp_path / "robot/allegro/allegro.urdf").exists() and (tmp_path / "robot/can/can.urdf").exists()
    assert len(json.loads((tmp_path / "robot/execution.json").read_text())["grasps"]) == 2


def test_two_simulators_judge_the_same_grasps(grasps, tmp_path, capsys):
    pytest.importorskip("mujoco", reason="mujoco is not installed")
    out = tmp_path / "judged.parquet"
    words = ["lift", str(grasps), "--simulator", "mujoco", "--simulator", "drake", "--out", str(out), "--workers", "1"]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "mujoco and drake agree on" in said and said.count("allegro") == 2
    assert {row["protocol"] for row in read_grasps(out)} == {"mujoco:lift-0.2/2tips"}
    assert main(["lift", str(grasps), "--simulator", "bullet"]) == 2


def test_export_to_mujoco_is_a_scene_for_each_grasp(grasps, tmp_path, capsys):
    assert main(["export", str(grasps), "--format", "mujoco", "--out", str(tmp_path / "scenes")]) == 0
    files = sorted((tmp_path / "scenes").glob("*.xml"))
    assert len(files) == 2
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
    for file, item in zip(files, load_grasps(grasps), strict=True):
        model = mujoco.MjModel.from_xml_path(str(file))
        np.testing.assert_allclose(model.key("grasp").ctrl[3:], item.grasp.q)
        target = item.grasp.q + item.grasp.tau_squeeze / item.row["gains"]["kp"]
        np.testing.assert_allclose(model.key("squeeze").ctrl[3:], target)


def test_retargeted_grasps_name_their_source(grasps, tmp_path, capsys):
    out = tmp_path / "pairs.parquet"
    status = main(["retarget", str(grasps), "--to", "allegro", "--out", str(out), "--workers", "1", "--keep-failed"])
    said = capsys.readouterr().out
    assert "allegro" in said and "rejected by" in said
    assert status in (0, 1)
    if out.exists():
        sources = {row["grasp_id"] for row in read_grasps(grasps)}
        assert {row["source_grasp_id"] for row in read_grasps(out)} <= sources


def test_hands_of_the_other_side_are_told_of():
    allegro = load_hand("allegro")
    (said,) = _other_sides([allegro], {"left.yaml": mirror(allegro), "shadow": load_hand("shadow")})
    assert said.startswith("left.yaml is a left hand and allegro a right one") and "xdex hand mirror" in said


@pytest.mark.parametrize("column", ["object_digest", "hand_digest"])
def test_a_changed_mesh_or_hand_is_refused(grasps, tmp_path, capsys, column):
    file = tmp_path / "changed.parquet"
    write_grasps(file, [{**row, column: "0" * 64} for row in read_grasps(grasps)])
    assert main(["lift", str(file)]) == 2
    assert "restore" in capsys.readouterr().err


def test_nothing_found_is_status_1(tmp_path, capsys):
    out = tmp_path / "none.parquet"
    words = ["grasp", "--hand", "allegro", "--object", "can", "--friction", "0.01"]
    assert main([*words, "--workers", "1", "--out", str(out)]) == 1
    said = capsys.readouterr()
    assert not out.exists() and "friction of 0.01 is too low" in said.out + said.err


def test_a_time_limit_ends_the_preparation_too(tmp_path, capsys):
    file = tmp_path / "scan.stl"
    trimesh.creation.torus(major_radius=0.06, minor_radius=0.02, major_sections=200, minor_sections=200).export(file)
    words = ["grasp", "--hand", "allegro", "--object", str(file), "--out", str(tmp_path / "none.parquet")]
    begin = time.monotonic()
    assert main([*words, "--time-limit", "0.5"]) == 1
    assert time.monotonic() - begin < 30.0  # its convex parts take a minute of processor time
    assert "took more than --time-limit 0.5 s" in capsys.readouterr().out


@pytest.mark.parametrize("shape", ["ball", "ring"])
def test_a_huge_round_object_is_refused_by_its_size(tmp_path, shape):
    mesh = trimesh.creation.icosphere(3, 0.6) if shape == "ball" else trimesh.creation.torus(0.6, 0.25)
    file = tmp_path / f"{shape}.stl"
    mesh.export(file)
    ready = prepare(SceneRequest("allegro", str(file)))
    assert ready.scene is None and "too large for the hand" in ready.obstacle and "314 mm apart" in ready.obstacle


def test_thickness_is_the_way_through():
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    thin = thicknesses(np.asarray(box.vertices), np.asarray(box.faces))
    assert sorted({round(float(t), 6) for t in thin}) == [0.1, 0.2, 0.3]
    hand = load_hand("allegro")
    assert too_thick(hand, np.asarray(box.vertices), np.asarray(box.faces)) is None


def test_ctrl_c_keeps_what_is_finished(grasps, tmp_path, monkeypatch, capsys):
    finished = tuple(item.grasp for item in load_grasps(grasps))

    def interrupted(request, *, count, workers, time_limit_s, tally):
        result = BatchResult(finished[:1], Tally(5, 1, 1, Counter(cone=4)), 0.0)
        tally.merge(result.tally)
        yield result
        raise KeyboardInterrupt

    monkeypatch.setattr("xdex_drake.jobs.grasps.synthesize_batches", interrupted)
    out = tmp_path / "kept.parquet"
    assert main(["grasp", "--hand", "allegro", "--object", "can", "--out", str(out)]) == 130
    assert [row["grasp_id"] for row in read_grasps(out)] == [finished[0].grasp_id]
    assert "cone 4" in capsys.readouterr().out


def test_ctrl_c_before_anything_is_finished_leaves_nothing(tmp_path):
    words = ["grasp", "--hand", "allegro", "--object", "can", "--count", "40", "--out", str(tmp_path / "g.parquet")]
    command = [sys.executable, "-m", "xdex_drake", *words]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stderr is not None
    said = ""
    while "allegro can:" not in said:  # the progress bar: work has begun
        more = process.stderr.read(1)
        assert more, said
        said += more
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in said + err and "nothing" in out
    assert not list(tmp_path.iterdir())


def test_view_writes_pages(grasps, tmp_path):
    for name, words in (("one", ["--row", "1"]), ("all", ["--all"])):
        page = tmp_path / f"{name}.html"
        assert main(["view", str(grasps), *words, "--html", str(page)]) == 0
        assert "<html" in page.read_text()[:2000].lower()
    assert main(["view", str(grasps), "--row", "2"]) == 2


@pytest.mark.slow
def test_quick_demo(tmp_path, capsys):
    assert main(["demo", "--quick", "--workers", "1", "--out", str(tmp_path / "report")]) == 0
    text = (tmp_path / "report" / "index.html").read_text()
    assert "<html" in text[:2000].lower()
    assert '<article class="good pair">' in text  # a grasp beside the one that it comes from
    assert read_grasps(tmp_path / "report" / "grasps.parquet")


@pytest.mark.slow
def test_a_data_set_resumes_and_verifies(tmp_path, capsys):
    config, out = tmp_path / "pairs.yaml", tmp_path / "pairs"
    config.write_text(
        "hands: [allegro, shadow]\nsource_hands: [allegro]\nobjects: [can, box]\ncandidates: 12\nsources_per_unit: 2\n"
    )
    words = ["dataset", "generate", str(config), "--out", str(out), "--workers", "1"]
    assert main(words) == 0
    before = {path.name: path.read_bytes() for path in (out / "shards").iterdir()}
    (out / "shards" / sorted(before)[0]).unlink()
    assert main(words) == 0
    assert {path.name: path.read_bytes() for path in (out / "shards").iterdir()} == before
    assert main(["dataset", "verify", str(out)]) == 0
    assert "certificates checked" in capsys.readouterr().out
    config.write_text(config.read_text() + "seed: 1\n")
    assert main(words) == 2


@pytest.mark.slow
def test_two_workers_find_what_one_finds():
    request = GraspRequest("ability", SceneFacts.of(make_scene(load_object("can"))), seed=3)

    def found(workers: int) -> tuple[list, int]:
        tally = Tally()
        batches = synthesize_batches(request, count=3, workers=workers, time_limit_s=600.0, tally=tally)
        return [(g.grasp_id, g.q.tolist()) for batch in batches for g in batch.grasps], tally.tried

    assert found(0) == found(2)
