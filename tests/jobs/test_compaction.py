"""Compact tables: few bytes, whole grasps again; appended, never rewritten; damage is found and made again."""

import errno
import os
from dataclasses import replace

import numpy as np
import pytest

from xdex_drake.cli import main
from xdex_drake.dataset import tables
from xdex_drake.dataset.compact import compact_unit, digest_of, from_bytes, lift_of_row, pose_of_row, to_bytes
from xdex_drake.dataset.folder import Rejected, iter_rejected, read_dataset
from xdex_drake.dataset.tables import Damage, append_unit, read_records, read_units, table_files
from xdex_drake.dataset.verify import verify
from xdex_drake.errors import DatasetError
from xdex_drake.grasp import Certificate, Contact, Grasp, Hold, Lift
from xdex_drake.hand.library import load_hand
from xdex_drake.jobs.pairs import DatasetConfig, generate
from xdex_drake.learning.samples import pack_dataset
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene

CONFIG = DatasetConfig(
    hands=("inspire", "ability"), source_hands=("inspire",), objects=("can", "box"), candidates=16, sources_per_unit=2
)
NAN = float("nan")


@pytest.fixture(scope="module")
def scene():
    return make_scene(load_object("can"))


@pytest.fixture(scope="module")
def hand():
    return load_hand("allegro")


def random_grasp(rng, hand, scene, name, source=""):
    """A grasp that is none: its pose is anywhere in the box, and its certificate says that two tips touch."""
    from pydrake.math import RigidTransform, RollPitchYaw

    tips = [finger.tip_link for finger in hand.fingers]
    contacts = tuple(Contact(tips[k], np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.6, np.zeros(3)) for k in (0, 2))
    certificate = Certificate(contacts, np.eye(3), np.zeros(3), 0.1, 0.05, 0.0, 1.0, 0.0, 0.0)
    lift = Lift("hold", True, "", 0.2512, ("thumb",), 3.0, Hold(False, "slipped:+x", 0.031, NAN))
    X_WH = RigidTransform(RollPitchYaw(rng.uniform(-3.1, 3.1, 3)), rng.uniform(-0.4, 0.4, 3))
    q = rng.uniform(*hand.limits)
    grasp = Grasp(hand.name, "can", scene.X_WO, X_WH, q, certificate, lift=lift, grasp_id=name, source_grasp_id=source)
    return grasp


def unit_of(hand, scene, name="u", count=20):
    rng = np.random.default_rng(3)
    grasps = [random_grasp(rng, hand, scene, f"{name}-{k}") for k in range(count)]
    return grasps, compact_unit(
        name, scene, [(hand, hand.name, "d", grasps)], rejected=[Rejected("x", f"{name}-1", "cone")]
    )


def test_poses_and_lifts_come_back_within_the_steps_of_16_bits(hand, scene):
    grasps, unit = unit_of(hand, scene)
    assert unit.rows[0].dtype.itemsize == 28 + 2 * len(hand.q_rest)
    low, high = hand.limits
    for row, grasp in zip(unit.rows[0], grasps, strict=True):
        X_WH, q, slots = pose_of_row(row, hand, scene)
        assert np.abs(X_WH.translation() - grasp.X_WH.translation()).max() < 0.51 / 65535
        np.testing.assert_allclose(X_WH.rotation().matrix(), grasp.X_WH.rotation().matrix(), atol=1e-4)
        assert (np.abs(q - grasp.q) <= 0.5001 * (high - low) / 65535).all()
        assert slots.tolist() == [True, False, True, False, False]
        lift, stored = lift_of_row(row, hand, unit.header), grasp.lift
        assert stored is not None and lift.hold is not None
        assert (lift.success, lift.fingertips, lift.protocol) == (True, ("thumb",), "hold")
        assert lift.lift_height_m == pytest.approx(stored.lift_height_m, abs=1e-4)
        assert not lift.hold.holds and lift.hold.reason == "slipped:+x" and np.isnan(lift.hold.turn_rad)
        assert lift.hold.slip_m == pytest.approx(0.031, abs=1e-4)


def test_a_rounded_pose_is_rounded_to_itself(hand, scene):
    grasps, unit = unit_of(hand, scene)
    poses = [pose_of_row(row, hand, scene) for row in unit.rows[0]]
    again = [replace(g, X_WH=X_WH, q=q) for g, (X_WH, q, _) in zip(grasps, poses, strict=True)]
    second = compact_unit("u", scene, [(hand, hand.name, "d", again)], rejected=[Rejected("x", "u-1", "cone")])
    assert digest_of(second) == digest_of(unit)


def test_bytes_come_back_and_what_is_no_unit_is_refused(hand, scene):
    _, unit = unit_of(hand, scene)
    data = to_bytes(unit)
    assert to_bytes(from_bytes(data, "here")) == data
    rng = np.random.default_rng(0)
    for cut in (0, 3, 40, len(data) - 1):
        with pytest.raises(DatasetError, match="here"):
            from_bytes(data[:cut], "here")
    for _ in range(40):  # whatever is changed is refused, or is a unit still
        changed = bytearray(data)
        changed[rng.integers(len(data))] ^= 1 << rng.integers(8)
        try:
            from_bytes(bytes(changed), "here")
        except DatasetError as error:
            assert "here" in str(error)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lift": None}, "certified and lifted"),
        ({"certificate": None}, "certified and lifted"),
        ({"source_grasp_id": "gone"}, "identifier"),
        ({"source_grasp_id": "gone", "grasp_id": "gone>allegro"}, "not in its unit"),
    ],
)
def test_what_cannot_be_kept_is_refused(hand, scene, change, message):
    grasp = replace(random_grasp(np.random.default_rng(0), hand, scene, "a"), **change)
    with pytest.raises(DatasetError, match=message):
        compact_unit("u", scene, [(hand, hand.name, "d", [grasp])])


def test_files_are_appended_to_and_never_rewritten(hand, scene, tmp_path, monkeypatch):
    units = [unit_of(hand, scene, f"u{k}", 5)[1] for k in range(4)]
    monkeypatch.setattr(tables, "LARGEST", 2 * len(to_bytes(units[0])) + 200)
    before = b""
    for number, unit in enumerate(units):
        append_unit(tmp_path, unit)
        now = b"".join(path.read_bytes() for path in table_files(tmp_path))
        assert now.startswith(before)
        before = now
        assert [u.header.unit for u in read_units(tmp_path)] == [f"u{k}" for k in range(number + 1)]
    assert [path.name for path in table_files(tmp_path)] == ["0000.rows", "0001.rows"]
    append_unit(tmp_path, units[0])
    assert [u.header.unit for u in read_units(tmp_path)] == ["u0", "u1", "u2", "u3"]


def test_a_cut_or_changed_record_is_named_and_costs_only_itself(hand, scene, tmp_path):
    units = [unit_of(hand, scene, f"u{k}", 5)[1] for k in range(3)]
    for unit in units:
        append_unit(tmp_path, unit)
    (path,) = table_files(tmp_path)
    whole = path.read_bytes()
    size = len(whole) // 3
    path.write_bytes(whole[: size + 60] + bytes([whole[size + 60] ^ 1]) + whole[size + 61 :])
    found = [record if isinstance(record, Damage) else record.header.unit for record in read_records(tmp_path)]
    assert found[0] == "u0" and isinstance(found[1], Damage) and found[2] == "u2"
    assert "0000.rows" in str(found[1]) and "damaged" in str(found[1])
    path.write_bytes(whole[: 2 * size + 30])
    assert [isinstance(record, Damage) for record in read_records(tmp_path)] == [False, False, True]
    append_unit(tmp_path, units[2])
    assert path.read_bytes() == whole


def test_a_full_disk_leaves_what_was_there(hand, scene, tmp_path, monkeypatch):
    _, unit = unit_of(hand, scene, count=3)
    append_unit(tmp_path, unit)

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(tables.os, "fsync", full)
        with pytest.raises(DatasetError, match="No space left"):
            append_unit(tmp_path, unit_of(hand, scene, "v", 3)[1])
    assert "u" in [record.header.unit for record in read_units(tmp_path)]


def test_a_data_set_goes_through_a_table_and_a_run_resumes_from_it(tmp_path, capsys):
    folder, table = tmp_path / "pairs", tmp_path / "table"
    assert generate(CONFIG, folder, workers=0, shard=(1, 2), table=table) == (1, 0)
    assert main(["dataset", "compact", str(folder), "--out", str(table)]) == 0  # nothing is missing
    # A machine is lost; the table is not.
    assert generate(CONFIG, tmp_path / "other", workers=0, table=table) == (1, 0)
    units = list(read_units(table))
    assert [unit.header.unit for unit in units] == ["can-0-inspire", "box-0-inspire"]
    assert all(unit.header.notes["xdex_commit"] for unit in units)
    assert main(["dataset", "expand", str(table), "--out", str(tmp_path / "again"), "--workers", "0"]) == 0
    report = verify(tmp_path / "again")
    assert report.ok and not report.missing_units
    rows = read_dataset(folder).to_pylist()
    again = {row["grasp_id"]: row for row in read_dataset(tmp_path / "again").to_pylist()}
    for row in rows:
        other = again[row["grasp_id"]]
        for name in ("hand", "scene_id", "source_grasp_id", "success", "failure_reason", "holds", "fingertips"):
            assert other[name] == row[name]
        assert [c["link"] for c in other["contacts"]] == [c["link"] for c in row["contacts"]]
        np.testing.assert_allclose(other["q"], row["q"], atol=2e-3)
        np.testing.assert_allclose(other["X_WH"], row["X_WH"], atol=1e-3)
    assert dict(iter_rejected(tmp_path / "again"))["can-0-inspire"] == dict(iter_rejected(folder))["can-0-inspire"]
    # A training pack comes from the table as from the data set, without certificates.
    one, other = pack_dataset(tmp_path / "again"), pack_dataset(table)
    assert sorted(one.scene_names) == sorted(other.scene_names)
    assert sorted(one.hand_names[h] for h in one.hand) == sorted(other.hand_names[h] for h in other.hand)
    assert len(np.unique(one.pair)) == len(np.unique(other.pair))
    key = [np.sort(np.linalg.norm(pack.points[:, :2], axis=1)) for pack in (one, other)]
    np.testing.assert_allclose(*key, atol=0.02)
    assert abs(float(np.abs(one.vectors).mean()) - float(np.abs(other.vectors).mean())) < 5e-3
