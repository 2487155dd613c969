import json
import resource
import time

import numpy as np
import pytest
import trimesh

from xdex_drake.errors import ObjectFileError
from xdex_drake.scene import split_process
from xdex_drake.scene.mesh import MANY_TRIANGLES, WALL_M, clean_mesh, guess_scale, read_mesh
from xdex_drake.scene.object import load_object
from xdex_drake.scene.split_process import COARSELY, split_in_process
from xdex_drake.scene.splitting import split

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.fixture
def cube():
    return trimesh.creation.box((0.04, 0.05, 0.06))


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".off", ".glb"])
def test_every_format_gives_the_same_cube(tmp_path, cube, suffix):
    path = tmp_path / f"cube{suffix}"
    cube.export(path)
    mesh = read_mesh(path, scale=2.0)
    assert mesh.watertight
    assert mesh.vertices.shape == (8, 3)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.08, 0.10, 0.12], rtol=1e-6)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(8 * 1.2e-4, rel=1e-5)


def test_gltf_with_buffer_beside_it(tmp_path, cube):
    for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(cube)).items():
        (tmp_path / name).write_bytes(data)
    assert read_mesh(tmp_path / "model.gltf").watertight


@pytest.mark.parametrize("uri", ["../secret.bin", "/etc/hostname", "missing.bin"])
def test_gltf_buffer_outside_its_folder_or_missing(tmp_path, cube, uri):
    folder = tmp_path / "mesh"
    folder.mkdir()
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(cube))
    (tmp_path / "secret.bin").write_bytes(next(data for name, data in files.items() if name.endswith(".bin")))
    tree = json.loads(files["model.gltf"])
    for buffer in tree["buffers"]:
        buffer["uri"] = uri
    (folder / "model.gltf").write_text(json.dumps(tree))
    with pytest.raises(ObjectFileError, match=r"model\.gltf.*(outside its folder|missing)"):
        read_mesh(folder / "model.gltf")


def test_obj_material_outside_its_folder_is_not_read(tmp_path, cube):
    path = tmp_path / "cube.obj"
    path.write_text("mtllib ../../../etc/passwd\n" + cube.export(file_type="obj"))
    assert read_mesh(path).watertight


@pytest.mark.parametrize(
    ("name", "content", "wrong"),
    [
        ("empty.obj", "", "empty"),
        ("words.obj", "this is no mesh\n", "no triangles|not a readable"),
        ("words.ply", "this is no mesh\n", "not a readable"),
        ("words.stl", "this is no mesh\n", "not a readable|no triangles"),
        ("words.glb", "glTF", "not a readable"),
        ("words.gltf", "{", "not a readable"),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles|not a readable"),
        ("one.obj", TRIANGLE, "usable triangles"),
        ("range.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "does not exist|not a readable"),
        (
            "nan.obj",
            "v 0 0 nan\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n",
            "not a finite number",
        ),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\nf 1 2 4\nf 1 4 3\n", "flat"),
        ("degenerate.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\n" + "f 1 2 3\n" * 6, "usable triangles|flat"),
        ("hand.urdf", "<robot name='x'/>", "model description"),
        ("text.txt", "v 0 0 0\n", "unknown type"),
    ],
)
def test_hostile_files_say_what_is_wrong(tmp_path, name, content, wrong):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(ObjectFileError, match=wrong) as caught:
        read_mesh(path)
    message = str(caught.value)
    assert name in message
    assert "\n" not in message
    assert len(message) < 400


def test_missing_file_folder_and_bad_scale(tmp_path, cube):
    with pytest.raises(ObjectFileError, match="no such file"):
        read_mesh(tmp_path / "nothing.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(ObjectFileError, match="not a file"):
        read_mesh(tmp_path / "folder.obj")
    cube.export(tmp_path / "cube.obj")
    for scale in (0.0, -1.0, float("nan")):
        with pytest.raises(ObjectFileError, match="scale"):
            read_mesh(tmp_path / "cube.obj", scale=scale)
    with pytest.raises(ObjectFileError, match="set the scale"):
        read_mesh(tmp_path / "cube.obj", scale=1e9)


def test_too_many_triangles():
    faces = np.tile(np.array([[0, 1, 2]]), (2_000_001, 1))
    with pytest.raises(ObjectFileError, match="2000001 triangles"):
        clean_mesh(np.eye(3), faces)


def test_inside_out_and_split_vertices_are_repaired(cube):
    soup = cube.triangles[:, ::-1].reshape(-1, 3)
    mesh = clean_mesh(soup, np.arange(len(soup)).reshape(-1, 3))
    assert mesh.watertight
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(cube.volume)
    assert any("duplicate" in repair for repair in mesh.repairs)
    assert any("outwards" in repair for repair in mesh.repairs)


def test_small_hole_is_filled_and_mouth_of_a_bowl_is_left(cube):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    mesh = clean_mesh(ball.vertices, ball.faces[(ball.faces != 0).all(axis=1)])
    assert mesh.watertight
    bowl = ball.slice_plane([0, 0, 0], [0, 0, -1])
    mesh = clean_mesh(np.asarray(bowl.vertices), np.asarray(bowl.faces))
    assert mesh.watertight and mesh.shell
    assert any("shell" in repair and "2 mm" in repair for repair in mesh.repairs)
    area = 2.0 * np.pi * 0.03**2
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(WALL_M * area, rel=0.1)


def test_a_void_stays_a_void_and_a_second_body_is_a_body(cube):
    hole = trimesh.creation.box((0.01, 0.01, 0.01))
    hole.invert()
    mesh = clean_mesh(*_join(cube, hole))
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(cube.volume - 1e-6)
    beside = hole.copy()
    beside.apply_translation([0.1, 0.0, 0.0])
    mesh = clean_mesh(*_join(cube, beside))
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(cube.volume + 1e-6)


def _join(*meshes):
    joined = trimesh.util.concatenate(meshes)
    return np.asarray(joined.vertices), np.asarray(joined.faces)


@pytest.mark.parametrize(("extent", "scale"), [(0.08, 1.0), (1.9, 1.0), (8.0, 0.01), (80.0, 0.001), (2500.0, 0.001)])
def test_unit_is_guessed_by_the_size(extent, scale):
    factor, said = guess_scale(extent)
    assert factor == scale
    assert bool(said) == (scale != 1.0)


def test_guessed_unit_is_told_and_a_given_scale_wins(tmp_path, cube):
    cube.apply_scale(1000.0)
    cube.export(tmp_path / "mm.stl")
    mesh = read_mesh(tmp_path / "mm.stl")
    assert mesh.scale == 0.001 and "millimetres" in mesh.repairs[0]
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.04, 0.05, 0.06], rtol=1e-6)
    mesh = read_mesh(tmp_path / "mm.stl", scale=0.002)
    assert mesh.scale == 0.002 and not any("unit" in repair for repair in mesh.repairs)
    cube.apply_scale(1000.0)
    cube.export(tmp_path / "huge.stl")
    with pytest.raises(ObjectFileError, match=r"huge\.stl.*set the scale"):
        read_mesh(tmp_path / "huge.stl")


@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.95])
@pytest.mark.parametrize("suffix", [".stl", ".ply", ".glb", ".off", ".obj"])
def test_truncated_files_are_refused_or_mended(tmp_path, suffix, fraction):
    path = tmp_path / f"cut{suffix}"
    trimesh.creation.icosphere(subdivisions=2, radius=0.03).export(path)
    path.write_bytes(path.read_bytes()[: int(fraction * path.stat().st_size)])
    try:
        mesh = read_mesh(path)
    except ObjectFileError as error:
        assert path.name in str(error)
    else:
        assert mesh.repairs, "a part of a mesh was taken for a whole one"


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".off", ".gltf", ".glb", ".dae"])
def test_binary_junk_under_the_name_of_a_mesh(tmp_path, suffix):
    path = tmp_path / f"junk{suffix}"
    path.write_bytes(np.random.default_rng(0).bytes(50_000))
    with pytest.raises(ObjectFileError, match="junk"):
        read_mesh(path)


def test_gltf_whose_nodes_are_a_circle_or_whose_counts_are_huge(tmp_path, cube):
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(cube))
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    tree = json.loads(files["model.gltf"])
    tree["accessors"][0]["count"] = 10**12
    (tmp_path / "model.gltf").write_text(json.dumps(tree))
    with pytest.raises(ObjectFileError, match="model"):
        read_mesh(tmp_path / "model.gltf")


def test_stl_that_promises_more_triangles_than_it_has(tmp_path, cube):
    data = bytearray(cube.export(file_type="stl"))
    data[80:84] = (4_000_000_000).to_bytes(4, "little")
    (tmp_path / "long.stl").write_bytes(bytes(data))
    with pytest.raises(ObjectFileError, match="long"):
        read_mesh(tmp_path / "long.stl")


def test_duplicated_and_zero_area_triangles_are_removed(cube):
    faces = np.concatenate([cube.faces, cube.faces, [[0, 0, 1], [2, 2, 2]]])
    mesh = clean_mesh(np.asarray(cube.vertices), faces)
    assert mesh.watertight and len(mesh.faces) == 12
    assert any("degenerate or duplicate" in repair for repair in mesh.repairs)


def test_a_third_triangle_at_an_edge_is_told(cube):
    vertices = np.concatenate([cube.vertices, [[0.1, 0.1, 0.1]]])
    mesh = clean_mesh(vertices, np.concatenate([cube.faces, [[0, 1, 8]]]))
    assert mesh.repairs


def test_a_body_far_from_the_origin_keeps_its_shape(cube):
    cube.apply_translation([1e3, -2e3, 5e2])
    assert clean_mesh(np.asarray(cube.vertices), np.asarray(cube.faces)).watertight


def test_a_body_that_overlaps_itself_has_the_volume_of_the_union(tmp_path, cube):
    other = cube.copy()
    other.apply_translation([0.01, 0.0, 0.0])
    trimesh.util.concatenate([cube, other]).export(tmp_path / "twice.obj")
    model = load_object(tmp_path / "twice.obj")
    assert model.report.volume == pytest.approx(0.05 * 0.05 * 0.06, rel=0.01)
    assert any("overlaps itself" in repair for repair in model.report.repairs)


def test_a_soup_of_loose_triangles_is_refused():
    rng = np.random.default_rng(0)
    soup = rng.uniform(-0.05, 0.05, (12, 1, 3)) + rng.normal(scale=0.02, size=(12, 3, 3))
    with pytest.raises(ObjectFileError, match="12 loose triangles"):
        clean_mesh(soup.reshape(-1, 3), np.arange(36).reshape(-1, 3))


def test_two_million_triangles_are_simplified_and_the_error_is_told():
    torus = trimesh.creation.torus(0.05, 0.015, major_sections=1000, minor_sections=500)
    soup = np.asarray(torus.vertices)[torus.faces].reshape(-1, 3)  # As an STL file has it: nothing is shared.
    begin = time.process_time()
    mesh = clean_mesh(soup, np.arange(len(soup)).reshape(-1, 3))
    assert time.process_time() - begin < 30.0
    assert mesh.watertight and len(mesh.faces) <= MANY_TRIANGLES
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(torus.volume, rel=0.01)
    assert any("1000000 triangles" in repair and "error" in repair for repair in mesh.repairs)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 6e6


def test_a_split_that_takes_too_long_is_done_coarsely(cube, monkeypatch):
    angle = trimesh.boolean.difference([cube, cube.copy().apply_translation([0.01, 0.01, 0.0])], engine="manifold")
    vertices, faces = np.asarray(angle.vertices), np.asarray(angle.faces, dtype=np.int64)
    monkeypatch.setattr(split_process, "FINE_CPU_S", -2.0)
    parts, note = split_in_process(vertices, faces, likely=True)
    assert parts and note.startswith(COARSELY)
    monkeypatch.setattr(split_process, "COARSE_CPU_S", -2.0)
    with pytest.raises(ObjectFileError, match="cannot be split"):
        split_in_process(vertices, faces, likely=True)


def test_the_split_is_the_same_in_a_process_of_its_own(cube):
    angle = trimesh.boolean.difference([cube, cube.copy().apply_translation([0.01, 0.01, 0.0])], engine="manifold")
    vertices, faces = np.asarray(angle.vertices), np.asarray(angle.faces, dtype=np.int64)
    parts, note = split_in_process(vertices, faces, likely=True)
    assert note == ""
    for (v, f), (w, g) in zip(parts, split(vertices, faces), strict=True):
        np.testing.assert_array_equal(v, w)
        np.testing.assert_array_equal(f, g)
