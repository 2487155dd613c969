"""Files appear whole or not at all; damage is found; a data set resumes."""

import dataclasses
import errno
import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from xdex_drake import whole_file
from xdex_drake.dataset.assets import keep_hand
from xdex_drake.dataset.folder import (
    Manifest,
    completed_units,
    failed_units,
    open_dataset,
    read_dataset,
    read_manifest,
    write_failure,
    write_shard,
)
from xdex_drake.dataset.grasp_file import read_grasps, read_metadata, read_table, write_grasps
from xdex_drake.dataset.ranking import best_grasps
from xdex_drake.dataset.schema import SCHEMA, grasp_from_row
from xdex_drake.dataset.summary import Count, info
from xdex_drake.dataset.verify import verify
from xdex_drake.dataset.version_1 import SCHEMA_1
from xdex_drake.errors import DatasetError, GraspFileError

TINY_DIGEST = "342aa407305ff7832685fedcd8bae41109458daae04c56c1e21ec158f135b2f9"

MANIFEST = Manifest(
    config={"contacts": 4, "hands": ["tiny"]},
    seed=7,
    units=("mug-0", "mug-1", "mug-2"),
    versions={"drake": "1"},
    digests={"hand/tiny": TINY_DIGEST, "object/mug": "d" * 64},
)


@pytest.fixture
def rows(make_row):
    return [make_row(seed) for seed in range(5)]


@pytest.fixture
def dataset(tmp_path, make_row, make_hand):
    """Two of three units: a source and a grasp that was retargeted from it, and a failed lift."""
    folder = tmp_path / "data"
    open_dataset(folder, MANIFEST)
    keep_hand(folder, make_hand())
    write_shard(folder, "mug-0", [make_row(0), make_row(1, source="g0")])
    write_shard(folder, "mug-1", [make_row(2, success=False)])
    return folder


# Files of grasps ------------------------------------------------------------------------------------------------------


def test_equal_rows_give_equal_bytes(tmp_path, rows):
    first, second = tmp_path / "a.parquet", tmp_path / "new" / "b.parquet"
    write_grasps(first, rows)
    write_grasps(second, iter(rows))
    assert first.read_bytes() == second.read_bytes()
    assert read_grasps(first) == rows


def test_a_file_may_be_empty_and_may_say_more(tmp_path):
    path = tmp_path / "a.parquet"
    write_grasps(path, [], metadata={"xdex_seed": "7"})
    assert read_grasps(path) == []
    assert read_metadata(path)["xdex_seed"] == "7"
    assert read_metadata(path)["xdex_schema_version"] == "2"
    assert pq.read_schema(path).field("lambda_m").metadata[b"unit"] == b"m"


def test_some_columns_can_be_read_alone(tmp_path, rows):
    path = tmp_path / "a.parquet"
    write_grasps(path, rows)
    assert read_table(path, ["grasp_id", "success"]).column_names == ["grasp_id", "success"]
    with pytest.raises(GraspFileError, match="no column colour"):
        read_table(path, ["colour"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"colour": "red"}, r"row 0 has unknown columns \['colour'\]"),
        ({"q": "text"}, "does not fit the schema"),
        ({"X_WO": [0.0] * 6}, "does not fit the schema"),
        ({"X_WO": None}, "must have a value in every row: X_WO"),
    ],
)
def test_rows_that_do_not_fit_are_refused(tmp_path, rows, change, message):
    path = tmp_path / "a.parquet"
    with pytest.raises(GraspFileError, match=message):
        write_grasps(path, [{**rows[0], **change}])
    assert list(tmp_path.iterdir()) == []


def test_a_row_that_lacks_a_column_is_refused(tmp_path, rows):
    with pytest.raises(GraspFileError, match=r"lacks \['seconds'\]"):
        write_grasps(tmp_path / "a.parquet", [{k: v for k, v in rows[0].items() if k != "seconds"}])


def test_every_truncation_is_found(tmp_path, rows):
    path = tmp_path / "a.parquet"
    write_grasps(path, rows)
    whole = path.read_bytes()
    for length in np.linspace(0, len(whole) - 1, 40).astype(int):
        path.write_bytes(whole[:length])
        with pytest.raises(GraspFileError, match=r"a\.parquet: damaged"):
            read_grasps(path)


def test_a_changed_byte_is_found_or_changes_nothing(tmp_path, rows):
    """Pages carry check sums; a byte of the footer may be one that does not matter, but no number changes unseen."""
    path = tmp_path / "a.parquet"
    write_grasps(path, rows)
    whole = path.read_bytes()
    footer = int.from_bytes(whole[-8:-4], "little") + 8
    rng = np.random.default_rng(0)
    found = 0
    for position in rng.integers(0, len(whole) - footer, 60):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            assert read_grasps(path) == rows
        except GraspFileError:
            found += 1
    assert found > 40


def test_missing_and_foreign_files_are_refused(tmp_path):
    with pytest.raises(GraspFileError, match="no such file"):
        read_grasps(tmp_path / "none.parquet")
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"x": [1]}), path)
    with pytest.raises(GraspFileError, match="xdex_schema_version is missing"):
        read_grasps(path)
    path.write_text("grasp_id,hand\n1,tiny\n")
    with pytest.raises(GraspFileError, match="damaged, or no Parquet file"):
        read_metadata(path)
    with pytest.raises(GraspFileError, match="damaged, or no Parquet file"):
        read_grasps(tmp_path)


def test_other_columns_and_versions_are_refused(tmp_path, rows):
    path = tmp_path / "a.parquet"
    table = pa.Table.from_pylist(rows, schema=SCHEMA)
    pq.write_table(table.drop_columns(["mass_kg"]), path)
    with pytest.raises(GraspFileError, match="another type: mass_kg"):
        read_grasps(path)
    pq.write_table(table.set_column(table.schema.get_field_index("seconds"), "seconds", pa.array(["1"] * 5)), path)
    with pytest.raises(GraspFileError, match="another type: seconds"):
        read_grasps(path)
    pq.write_table(table.replace_schema_metadata({"xdex_schema_version": "99"}), path)
    with pytest.raises(
        GraspFileError, match="xdex_schema_version is 99, but this version of the library reads 1 and 2"
    ):
        read_grasps(path)


def as_version_1(rows, path):
    """Writes rows as version 1 of the schema did."""
    old = [{name: row[name] for name in SCHEMA_1.names} for row in rows]
    old = [{**row, "contacts": [{k: v for k, v in c.items() if k != "t_OC"} for c in row["contacts"]]} for row in old]
    metadata = {**SCHEMA.metadata, b"xdex_schema_version": b"1", b"xdex_seed": b"7"}
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.Table.from_pylist(old, schema=SCHEMA_1.with_metadata(metadata)), path)


def test_version_1_is_read_with_torques_and_tangents(tmp_path, rows):
    path = tmp_path / "a.parquet"
    rows[1]["gains"] = {"kp": 5.0, "kd": 0.1}
    rows[2]["q_squeeze"] = None
    as_version_1(rows, path)
    found = read_grasps(path)
    for row, now in zip(rows, found, strict=True):
        assert list(now) == SCHEMA.names
        assert {name: now[name] for name in SCHEMA_1.names} == {name: row[name] for name in SCHEMA_1.names}
        assert now["X_WB"] is None and now["holds"] is None and grasp_from_row(now).lift.hold is None
    step = np.subtract(rows[1]["q_squeeze"], rows[1]["q"])
    np.testing.assert_allclose(found[1]["tau_squeeze"], 5.0 * step, atol=1e-15)
    assert found[2]["tau_squeeze"] is None
    assert read_table(path, ["tau_squeeze", "q"]).column_names == ["tau_squeeze", "q"]
    assert read_metadata(path)["xdex_seed"] == "7"
    write_grasps(tmp_path / "b.parquet", found)
    assert read_grasps(tmp_path / "b.parquet") == found


def test_a_data_set_of_version_1_is_read_but_not_gone_on_with(tmp_path, rows):
    folder, old = tmp_path / "data", dataclasses.replace(MANIFEST, schema_version=1)
    open_dataset(folder, old)
    as_version_1(rows, folder / "shards" / "mug-0.parquet")
    assert read_dataset(folder).num_rows == len(rows) and completed_units(folder) == {"mug-0"}
    with pytest.raises(DatasetError, match="another schema_version"):
        open_dataset(folder, MANIFEST)


# Whole or not at all --------------------------------------------------------------------------------------------------


def test_a_full_disk_changes_nothing(tmp_path, rows, monkeypatch):
    path = tmp_path / "a.parquet"
    write_grasps(path, rows[:1])
    before = path.read_bytes()

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(whole_file.os, "fsync", full)
    with pytest.raises(GraspFileError, match="No space left on device"):
        write_grasps(path, rows)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_disk_that_fills_up_while_writing_changes_nothing(tmp_path, rows, monkeypatch):
    path = tmp_path / "a.parquet"
    write_grasps(path, rows[:1])
    before = path.read_bytes()
    opened = Path.open
    monkeypatch.setattr(Path, "open", lambda self, mode: opened(Path("/dev/full"), "wb"))
    with pytest.raises(GraspFileError, match="No space left on device"):
        write_grasps(path, rows)
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_cannot_be_made_is_an_error_of_ours(tmp_path, rows):
    (tmp_path / "file").touch()
    with pytest.raises(GraspFileError, match=r"cannot be written.*nothing was changed"):
        write_grasps(tmp_path / "file" / "a.parquet", rows)


KILLED_WRITER = """
    import sys, time
    from pathlib import Path
    from xdex_drake import whole_file
    from xdex_drake.dataset import grasp_file

    rows = grasp_file.read_grasps(sys.argv[1])
    if sys.argv[3] == "midway":
        whole_file.os.fsync = lambda descriptor: (print("writing", flush=True), time.sleep(60))
    print("writing", flush=True)
    while True:
        grasp_file.write_grasps(sys.argv[2], rows)
"""


@pytest.mark.parametrize("moment", ["midway", "0.00", "0.02", "0.07"])
def test_a_killed_writer_leaves_the_old_file_or_the_new_one(tmp_path, rows, moment):
    source, target = tmp_path / "source.parquet", tmp_path / "out" / "a.parquet"
    write_grasps(source, rows)
    write_grasps(target, rows[:1])
    script = tmp_path / "writer.py"
    script.write_text(textwrap.dedent(KILLED_WRITER))
    command = [sys.executable, str(script), str(source), str(target), moment]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        for _ in range(2 if moment == "midway" else 1):
            assert writer.stdout.readline() == "writing\n"
        time.sleep(0.0 if moment == "midway" else float(moment))
        writer.send_signal(signal.SIGKILL)
    after = read_grasps(target)
    assert after == rows[:1] if moment == "midway" else after in (rows[:1], rows)
    if moment == "midway":
        assert len(list(target.parent.glob(".*.partial"))) == 1
    write_grasps(target, rows)
    assert read_grasps(target) == rows
    assert list(target.parent.iterdir()) == [target]  # the next writer removes what the killed one left


# Data set folders -----------------------------------------------------------------------------------------------------


def test_a_data_set_resumes(dataset, make_row):
    assert completed_units(dataset) == {"mug-0", "mug-1"}
    open_dataset(dataset, MANIFEST)  # goes on with the same
    write_shard(dataset, "mug-2", [make_row(3)])
    assert completed_units(dataset) == set(MANIFEST.units)
    assert read_dataset(dataset, ["grasp_id"]).to_pydict() == {"grasp_id": ["g0", "g1", "g2", "g3"]}
    assert read_manifest(dataset) == dataclasses.replace(MANIFEST, config={"contacts": 4, "hands": ["tiny"]})


def test_an_empty_data_set_has_the_columns(tmp_path):
    open_dataset(tmp_path / "data", MANIFEST)
    assert read_dataset(tmp_path / "data").schema.equals(SCHEMA)
    assert read_dataset(tmp_path / "data", ["q", "hand"]).column_names == ["q", "hand"]
    assert completed_units(tmp_path / "none") == set()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"config": {"contacts": 5, "hands": ["tiny"]}}, "another config.contacts;"),
        ({"seed": 8}, "another seed;"),
        ({"units": ("mug-0",)}, "another units;"),
        ({"versions": {"drake": "2", "torch": "1"}}, r"another versions.drake, versions.torch;"),
        ({"digests": {}}, "another digests.hand/tiny, digests.object/mug;"),
    ],
)
def test_another_manifest_is_refused(dataset, change, message):
    with pytest.raises(DatasetError, match=message):
        open_dataset(dataset, dataclasses.replace(MANIFEST, **change))


def test_tuples_and_lists_in_a_configuration_are_the_same(dataset):
    open_dataset(dataset, dataclasses.replace(MANIFEST, config={"contacts": 4, "hands": ("tiny",)}))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "cannot be read"),
        ("[]", "must have exactly the fields"),
        (json.dumps({**dataclasses.asdict(MANIFEST), "schema_version": 3}), "schema_version is 3"),
        (json.dumps({**dataclasses.asdict(MANIFEST), "colour": 1}), "must have exactly the fields"),
    ],
)
def test_a_damaged_manifest_is_refused(dataset, text, message):
    (dataset / "manifest.json").write_text(text)
    with pytest.raises(DatasetError, match=message):
        read_manifest(dataset)


def test_a_folder_of_something_else_is_refused(tmp_path):
    with pytest.raises(DatasetError, match="no data set"):
        read_manifest(tmp_path)
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(DatasetError, match="something else"):
        open_dataset(tmp_path, MANIFEST)
    with pytest.raises(DatasetError, match="something else"):
        open_dataset(tmp_path / "thesis.tex", MANIFEST)


@pytest.mark.parametrize("units", [("a/b",), ("..",), ("",), (".a",), ("a", "A"), ("a" * 300,)])
def test_unit_names_must_be_file_names(tmp_path, units):
    with pytest.raises(DatasetError, match="unit names"):
        open_dataset(tmp_path / "data", dataclasses.replace(MANIFEST, units=units))
    if len(units) == 1:
        with pytest.raises(DatasetError, match="cannot be the name of a unit"):
            write_shard(tmp_path, units[0], [])


def test_what_json_cannot_hold_is_refused(tmp_path):
    with pytest.raises(DatasetError, match="only what JSON can"):
        open_dataset(tmp_path / "data", dataclasses.replace(MANIFEST, config={"x": np.zeros(3)}))


def test_a_failure_is_recorded_until_a_shard_takes_its_place(dataset, make_row):
    write_failure(dataset, "mug-2", "timeout: more than 9 s")
    assert failed_units(dataset) == {"mug-2": "timeout: more than 9 s"}
    assert completed_units(dataset) == {"mug-0", "mug-1"}
    write_shard(dataset, "mug-2", [make_row(3)])
    assert failed_units(dataset) == {}


def test_a_damaged_shard_is_made_again(dataset, caplog):
    path = dataset / "shards" / "mug-1.parquet"
    path.write_bytes(path.read_bytes()[:-20])
    assert completed_units(dataset) == {"mug-0"}
    assert "mug-1.parquet: damaged" in caplog.text


def test_a_partial_file_is_no_shard(dataset):
    (dataset / "shards" / ".mug-2.parquet.elsewhere.12.ab.partial").write_bytes(b"PAR1")
    assert completed_units(dataset) == {"mug-0", "mug-1"}
    assert verify(dataset).ok


def test_a_sound_data_set_is_verified(dataset):
    report = verify(dataset)
    assert report.ok
    assert (report.shards, report.rows, report.successes, report.certificates_checked) == (2, 3, 2, 2)
    assert report.missing_units == ("mug-2",)


def test_everything_that_is_wrong_is_found(dataset, make_row):
    bare = {name: None for name in ("contacts", "wrench_residual", "task_margin", "margin_lower", "margin_upper")}
    wrong = [
        make_row(0),
        make_row(10, source="nobody"),
        {**make_row(11), "hand_digest": "0" * 64, "object_digest": "0" * 64},
        {**make_row(12), **bare, "witness_forces": None, "witness_direction": None},
        {**make_row(13), "X_WH": [0.0] * 7},
    ]
    write_shard(dataset, "mug-2", wrong)
    write_shard(dataset, "unplanned", [])
    damaged = dataset / "shards" / "mug-1.parquet"
    damaged.write_bytes(damaged.read_bytes()[:100])
    weak = read_grasps(dataset / "shards" / "mug-0.parquet")
    weak[1]["contacts"][0]["f_C"][2] *= 1.01
    write_shard(dataset, "mug-0", weak)
    report = verify(dataset)
    assert not report.ok
    found = {(problem.unit, problem.grasp_id, problem.reason.split(":")[0]) for problem in report.problems}
    assert found == {
        ("mug-0", "g1", "its certificate does not hold"),
        ("mug-1", "", str(damaged)),
        ("mug-2", "g0", "the identifier is that of a grasp of mug-0, too"),
        ("mug-2", "g10", "its source grasp nobody is not in the data set"),
        ("mug-2", "g11", "hand tiny has another digest than in the manifest"),
        ("mug-2", "g11", "object mug has another digest than in the manifest"),
        ("mug-2", "g12", "its lift succeeded, but it has no certificate"),
        ("mug-2", "g13", "grasp 'g13'"),
        ("unplanned", "", "the manifest does not plan this unit"),
    }


def test_the_summary_counts(dataset, make_row):
    write_failure(dataset, "mug-2", "crashed: SIGABRT")
    summary = info(dataset)
    assert (summary.units_planned, summary.units_done) == (3, 2)
    assert (summary.rows, summary.successes, summary.sources) == (3, 2, 2)
    assert summary.by_hand == {"tiny": Count(3, 2)}
    assert summary.by_object == {"mug": Count(3, 2)}
    assert summary.failures == {"mug-2": "crashed: SIGABRT"}
    assert summary.failure_reasons == {"slipped": 1}
    assert summary.seconds == pytest.approx(3 * (2.0 + 1.5))
    assert summary.bytes == sum(path.stat().st_size for path in (dataset / "shards").iterdir())


def test_the_best_grasp_of_each_hand_and_scene_is_listed(dataset, make_row):
    # Of three certified rows of one hand and scene the one most likely to hold, whatever became of it.
    write_shard(dataset, "mug-2", [make_row(5) | {"foretold_motion": -3.0}, make_row(6) | {"scene_id": "mug/1"}])
    best = best_grasps(dataset, count=5)
    assert [(ranked.scene, ranked.unit) for ranked in sorted(best, key=lambda ranked: ranked.scene)] == [
        ("mug/0", "mug-2"),
        ("mug/1", "mug-2"),
    ]
    assert best[0].hold >= best[1].hold and best_grasps(dataset, count=1)[0].grasp.grasp_id == best[0].grasp.grasp_id
    assert best[0].outcome() == ("yes", "yes") and best_grasps(dataset, count=5, hand="nobody") == []
