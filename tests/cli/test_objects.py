"""`xdex object`: list, show, import of a set, generate."""

import csv

import trimesh

from xdex_drake.cli import main


def test_list_tells_of_generated_shapes(capsys):
    assert main(["object", "list"]) == 0
    said = capsys.readouterr().out
    assert "mug" in said and "s0-0042" in said


def test_show_prints_poses_mass_and_walls(capsys):
    assert main(["object", "show", "can", "--density", "500"]) == 0
    said = capsys.readouterr().out
    assert "probability" in said and "density x volume" in said and "solid" in said
    assert main(["object", "show", "can", "--no-poses"]) == 0
    assert "probability" not in capsys.readouterr().out


def test_generate_writes_shapes_and_an_index(capsys, tmp_path):
    assert main(["object", "generate", "--count", "3", "--seed", "4", "--out", str(tmp_path)]) == 0
    rows = list(csv.DictReader((tmp_path / "index.csv").open()))
    assert [row["name"] for row in rows] == ["s4-0000", "s4-0001", "s4-0002"]
    for row in rows:
        assert trimesh.load_mesh(tmp_path / f"{row['name']}.obj").is_watertight
    assert "3 written" in capsys.readouterr().out
    assert main(["object", "generate", "--count", "0", "--out", str(tmp_path)]) == 2


def test_a_folder_is_imported_as_a_set_with_an_index(capsys, tmp_path):
    scans = tmp_path / "scans"
    (scans / "more").mkdir(parents=True)
    trimesh.creation.box((0.04, 0.05, 0.06)).export(scans / "part.obj")
    trimesh.creation.box((40.0, 50.0, 70.0)).export(scans / "more" / "part.stl")
    (scans / "broken.ply").write_text("this is no mesh")
    (scans / "notes.txt").write_text("not a mesh, and not to be read")
    assert main(["object", "import", str(scans), "--out", str(tmp_path / "set")]) == 2
    said = capsys.readouterr()
    assert "broken.ply" in said.err and "millimetres" in said.out
    rows = {row["name"]: row for row in csv.DictReader((tmp_path / "set" / "index.csv").open())}
    assert set(rows) == {"part", "part_2", "broken"}
    assert sorted(row["scale"] for row in rows.values()) == ["", "0.001", "1"]
    for name in ("part", "part_2"):
        assert rows[name]["parts"] == "1" and float(rows[name]["bulge_p99_mm"]) < 0.1
        assert (tmp_path / "set" / rows[name]["file"]).exists()
    assert "not a readable" in rows["broken"]["repairs"] and rows["broken"]["file"] == ""


def test_an_empty_folder_is_refused(capsys, tmp_path):
    assert main(["object", "import", str(tmp_path), "--out", str(tmp_path / "set")]) == 2
    assert "holds no mesh files" in capsys.readouterr().err
