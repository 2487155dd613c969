import json

import numpy as np
import pytest
import trimesh

from xdex_drake.errors import ObjectFileError
from xdex_drake.scene.mesh import clean_mesh, read_mesh

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
    assert not mesh.watertight
    assert any("left open" in repair for repair in mesh.repairs)


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
