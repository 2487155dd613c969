"""Hands and meshes in a data set's folder: found by digest, never outside of it."""

import dataclasses
import shutil

import pytest
import trimesh

from xdex_drake.dataset.assets import (
    asset,
    copy_assets,
    hand_finder,
    keep_hand,
    keep_mesh,
    mesh_path,
    object_finder,
    with_kept_mesh,
)
from xdex_drake.dataset.card import licences
from xdex_drake.dataset.files import scene_facts
from xdex_drake.dataset.folder import Manifest, open_dataset, write_shard
from xdex_drake.dataset.rows import object_facts
from xdex_drake.dataset.schema import object_facts_from_row
from xdex_drake.dataset.verify import verify
from xdex_drake.errors import DatasetError
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.yaml_file import hand_digest
from xdex_drake.scene.object import load_object


@pytest.fixture
def brick(tmp_path):
    """A mesh in a folder of its own, with a licence and something else beside it."""
    home = tmp_path / "meshes"
    home.mkdir()
    trimesh.creation.box([0.04, 0.05, 0.09]).export(home / "brick.stl")
    (home / "LICENSE.txt").write_text("For everybody.")
    (home / "notes.txt").write_text("Nothing.")
    return load_object(str(home / "brick.stl"))


def opened(folder, **digests):
    open_dataset(folder, Manifest({}, 0, ("u",), {}, {key.replace("_", "/"): value for key, value in digests.items()}))
    return folder


def test_a_mesh_is_copied_with_its_licence_and_found_by_its_digest(tmp_path, brick):
    folder = opened(tmp_path / "data")
    keep_mesh(folder, brick)
    keep_mesh(folder, brick)
    home = folder / "assets" / brick.digest
    assert sorted(path.name for path in home.iterdir()) == ["LICENSE.txt", "brick.stl"]
    assert asset(folder, brick.digest) == home / "brick.stl"
    shutil.rmtree(tmp_path / "meshes")
    found = object_finder(folder)(object_facts(brick))
    assert (found.name, found.digest) == ("brick", brick.digest)
    copy_assets(folder, tmp_path / "table")
    assert sorted(path.name for path in (tmp_path / "table" / "assets" / brick.digest).iterdir()) == [
        "LICENSE.txt",
        "brick.stl",
    ]


def test_licences_are_told_as_far_as_files_state_them(tmp_path, brick):
    folder = opened(tmp_path / "data")
    keep_mesh(folder, brick)
    claw = dataclasses.replace(load_hand("inspire"), name="claw")
    keep_hand(folder, claw)
    told = dict(licences(folder))
    assert told["brick.stl"] == f"[LICENSE.txt](assets/{brick.digest}/LICENSE.txt)"
    assert told["claw.yaml"].startswith("not stated")


def test_rows_name_the_copy_relative_to_the_folder(tmp_path, brick, make_row):
    folder = opened(tmp_path / "data")
    keep_mesh(folder, brick)
    inside, outside = make_row(0) | {"object_digest": brick.digest, "object_path": "x/brick.stl#1"}, make_row(1)
    named = with_kept_mesh(folder, [inside, outside])
    assert named == [inside | {"object_path": f"assets/{brick.digest}/brick.stl#1"}, outside]
    assert with_kept_mesh(folder, named) == named
    shard = folder / "shards" / "u.parquet"
    assert scene_facts(named[0], shard).object_path == f"{folder}/assets/{brick.digest}/brick.stl#1"
    assert scene_facts(outside, shard).object_path == outside["object_path"]


def test_what_the_library_has_is_not_copied(tmp_path):
    keep_hand(tmp_path, load_hand("inspire"))
    keep_hand(tmp_path, load_hand("g0-0005"))
    keep_mesh(tmp_path, load_object("can"))
    assert list(tmp_path.iterdir()) == []


def test_a_hand_is_copied_and_found_by_its_name(tmp_path):
    claw = dataclasses.replace(load_hand("inspire"), name="claw")
    folder = opened(tmp_path / "data", hand_claw=hand_digest(claw))
    with pytest.raises(DatasetError, match="hand claw cannot be found"):
        hand_finder(folder)("claw")
    keep_hand(folder, claw)
    assert hand_digest(hand_finder(folder)("claw")) == hand_digest(claw)
    file = asset(folder, hand_digest(claw))
    assert file is not None
    file.write_text(file.read_text().replace("Inspire", "Inspired").replace("side: right", "side: left"))
    assert [fault.reason.split(":")[1] for fault in verify(folder).problems] == [
        " hand claw is not the one of the data; restore its file"
    ]


def test_nothing_leads_out_of_the_folder(tmp_path, brick):
    folder = opened(tmp_path / "data")
    (folder / "assets" / brick.digest).mkdir(parents=True)
    (folder / "assets" / brick.digest / "brick.stl").symlink_to(tmp_path / "meshes" / "brick.stl")
    with pytest.raises(DatasetError, match="leads out of the data set's folder"):
        asset(folder, brick.digest)
    for digest in ("../../meshes", "..", "", "A" * 64, f"{brick.digest}/.."):
        assert asset(folder, digest) is None
        assert mesh_path(folder, "can", digest) == "can"


def test_a_second_file_and_a_format_of_several_files_are_refused(tmp_path, brick):
    folder = opened(tmp_path / "data")
    keep_mesh(folder, brick)
    (folder / "assets" / brick.digest / "other.stl").write_text("")
    with pytest.raises(DatasetError, match=r"several files, brick.stl and other.stl"):
        asset(folder, brick.digest)
    with pytest.raises(DatasetError, match=r"convert it to \.glb"):
        keep_mesh(folder, dataclasses.replace(brick, path=tmp_path / "meshes" / "a.gltf"))


def test_a_damaged_mesh_is_found(tmp_path, brick, make_row):
    folder = opened(tmp_path / "data")
    keep_mesh(folder, brick)
    (folder / "assets" / brick.digest / "brick.stl").write_bytes(b"")
    row = make_row(0) | {"object_digest": brick.digest}
    write_shard(folder, "u", with_kept_mesh(folder, [row]))
    (fault,) = verify(folder).problems
    assert fault.reason.startswith("object mug: ") and "brick.stl" in fault.reason
    assert object_facts_from_row(row).digest == brick.digest
