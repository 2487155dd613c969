import dataclasses
import json
import struct

import numpy as np
import pytest
import torch

from xdex_drake.errors import DatasetError
from xdex_drake.learning.pack import _TYPES, Pack, read_pack, write_pack


@pytest.fixture(scope="module")
def pack(tiny):
    return tiny(scenes=3, grasps=4)


@pytest.fixture
def file(pack, tmp_path):
    return write_pack(dataclasses.replace(pack, notes={"from": "nothing"}), tmp_path / "new" / "pack.safetensors")


def _equal(a: Pack, b: Pack):
    return all(
        np.array_equal(x, y) if isinstance(x, np.ndarray) else x == y
        for x, y in ((getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(Pack))
    )


def _rewrite(file, change_header=None, change_table=None):
    raw = file.read_bytes()
    (length,) = struct.unpack("<Q", raw[:8])
    table, body = json.loads(raw[8 : 8 + length]), raw[8 + length :]
    if change_header:
        header = json.loads(table["__metadata__"]["xdex_drake"])
        change_header(header)
        table["__metadata__"]["xdex_drake"] = json.dumps(header)
    if change_table:
        change_table(table)
    text = json.dumps(table).encode()
    file.write_bytes(struct.pack("<Q", len(text)) + text + body)


def test_round_trip(pack, file):
    found = read_pack(file)
    assert _equal(found, dataclasses.replace(pack, notes={"from": "nothing"}))
    again = write_pack(found, file.parent / "again.safetensors")
    assert again.read_bytes() == file.read_bytes()


def test_missing_cut_short_and_foreign(file, tmp_path):
    with pytest.raises(DatasetError, match="no such training pack"):
        read_pack(tmp_path / "none.safetensors")
    raw = file.read_bytes()
    for kept in (0, 4, 8, 100, 5000, len(raw) - 1):
        file.write_bytes(raw[:kept])
        with pytest.raises(DatasetError, match="again"):
            read_pack(file)
    file.write_bytes(struct.pack("<Q", 2**62) + raw[8:])
    with pytest.raises(DatasetError, match="cut short"):
        read_pack(file)
    torch.save({"a": torch.zeros(3)}, file)
    with pytest.raises(DatasetError):
        read_pack(file)


def test_random_damage_never_ends_in_another_error(file):
    raw = file.read_bytes()
    rng = np.random.default_rng(0)
    (length,) = struct.unpack("<Q", raw[:8])
    for k in range(200):
        damaged = bytearray(raw)
        for position in rng.integers(0, 8 + length if k % 2 else len(raw), 3):
            damaged[position] = rng.integers(256)
        file.write_bytes(damaged)
        try:
            read_pack(file)
        except DatasetError as error:
            assert str(file) in str(error)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda h: h.update(kind="cvae"), "'kind'"),
        (lambda h: h.update(pack_schema=99), "'pack_schema' is 99"),
        (lambda h: h.update(feature_schema=99), "'feature_schema' is 99"),
        (lambda h: h.update(hand_names="three"), "'hand_names'"),
        (lambda h: h.update(reasons=[0]), "'reasons'"),
        (lambda h: h.pop("scene_names"), "'scene_names'"),
        (lambda h: h.update(notes=[]), "'notes'"),
        (lambda h: h["hand_names"].append("more"), "'links' has shape"),
        (lambda h: h["scene_names"].pop(), "'scene' holds numbers outside"),
        (lambda h: h["keypoint_names"].pop(), "'keypoint_links' has shape"),
        (lambda h: h.update(reasons=[]), "'outcome' holds numbers outside"),
    ],
)
def test_wrong_headers(file, change, message):
    _rewrite(file, change)
    with pytest.raises(DatasetError, match=message):
        read_pack(file)


def test_missing_and_mistyped_arrays(file):
    raw = file.read_bytes()
    _rewrite(file, change_table=lambda t: t.update(surprise=t.pop("points")))
    with pytest.raises(DatasetError, match="'points' is missing"):
        read_pack(file)
    file.write_bytes(raw)
    _rewrite(file, change_table=lambda t: t["hand"].update(dtype="F32"))
    with pytest.raises(DatasetError, match="'hand' is missing, unknown or of another type"):
        read_pack(file)


@pytest.mark.parametrize("name", sorted(_TYPES))
def test_an_array_cut_by_one_is_refused(pack, tmp_path, name):
    with pytest.raises(DatasetError, match="array '"):
        write_pack(dataclasses.replace(pack, **{name: getattr(pack, name)[:-1]}), tmp_path / "p.safetensors")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("links", 0),
        ("hand", 7),
        ("scene", -1),
        ("pair", 10**6),
        ("pair", -2),
        ("outcome", 2),
        ("keypoint_links", 40),
        ("vectors", np.nan),
        ("vectors", np.inf),
        ("clouds", 1000.0),
    ],
)
def test_numbers_out_of_bounds_are_refused(pack, tmp_path, name, value):
    array = getattr(pack, name).copy()
    array.flat[-1] = value
    with pytest.raises(DatasetError, match=f"array '{'hand' if name == 'links' else name}'|array '{name}'"):
        write_pack(dataclasses.replace(pack, **{name: array}), tmp_path / "p.safetensors")


def test_hands_must_follow_each_other(pack, tmp_path):
    with pytest.raises(DatasetError, match="'hand' must ascend"):
        write_pack(dataclasses.replace(pack, hand=pack.hand[::-1].copy()), tmp_path / "p.safetensors")
