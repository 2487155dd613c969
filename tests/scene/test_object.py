import concurrent.futures
import pickle

import numpy as np
import pytest
import trimesh

from xdex_drake.cache import cache_folder
from xdex_drake.errors import ObjectFileError, UnknownObject
from xdex_drake.scene.distance import sample_surface
from xdex_drake.scene.object import load_object
from xdex_drake.scene.procedural import list_objects, procedural_mesh

FAST = ("box", "can", "hammer", "cross")


@pytest.fixture(scope="module")
def objects():
    return {name: load_object(name) for name in FAST}


def test_library_shapes_are_closed_and_graspable():
    assert len(list_objects()) >= 16
    for name in list_objects():
        mesh = trimesh.Trimesh(*procedural_mesh(name), process=False)
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0, name
        width = np.sort(mesh.bounding_box_oriented.primitive.extents)
        assert width[0] >= 0.02 and width[1] <= 0.14 and width[2] <= 0.2, (name, width)
        assert mesh.bounds[0, 2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("name", FAST)
def test_parts_cover_the_mesh_and_fit_it(objects, name):
    model = objects[name]
    assert trimesh.Trimesh(*model.surface, process=False).is_volume
    points = sample_surface(model.vertices, model.faces, 3000, 1)[0]
    assert model.exact.query(points).distance.max() < 1e-3
    assert model.report.bulge_p99_m < 1.5e-3
    assert model.report.gap_p99_m < 1e-3
    for vertices, faces in model.parts:
        part = trimesh.Trimesh(vertices, faces, process=False)
        assert part.is_watertight and part.volume > 0.0
        assert len(vertices) <= 256
        assert (vertices @ part.face_normals.T - (part.triangles[:, 0] * part.face_normals).sum(axis=1)).max() < 1e-7


def test_mass_and_inertia_of_a_box(objects):
    box = load_object("box", mass=0.2)
    size = np.ptp(box.vertices, axis=0)
    np.testing.assert_allclose(box.p_OOcm, [0.0, 0.0, size[2] / 2], atol=1e-12)
    expected = 0.2 / 12.0 * ((size**2).sum() - size**2)
    np.testing.assert_allclose(box.I_OcmO, np.diag(expected), atol=1e-12)
    assert objects["box"].mass == 0.1
    assert box.report.inertia_source == "mesh"
    points = sample_surface(*box.surface, 200_000, 0)[0]
    assert box.length == pytest.approx(np.sqrt(((points - box.p_OOcm) ** 2).sum(axis=1).mean()), rel=5e-3)


def test_unsound_mesh_takes_its_inertia_from_the_parts(tmp_path):
    box = trimesh.creation.box((0.04, 0.05, 0.06))
    wall = np.vstack((box.faces, [[0, 3, 7]]))
    trimesh.Trimesh(box.vertices, wall, process=False).export(tmp_path / "walled.obj")
    model = load_object(tmp_path / "walled.obj")
    assert not model.report.watertight
    assert model.report.inertia_source == "parts"
    np.testing.assert_allclose(model.p_OOcm, 0.0, atol=1e-6)


def test_scale_digest_and_path(tmp_path, objects):
    again = load_object("hammer")
    assert again.digest == objects["hammer"].digest
    assert again.report.cached
    assert len({model.digest for model in objects.values()}) == len(objects)
    trimesh.creation.box((40, 50, 60)).export(tmp_path / "Brick.stl")
    model = load_object(tmp_path / "Brick.stl", scale=1e-3, friction=0.3)
    assert (model.name, model.friction, model.scale) == ("Brick", 0.3, 1e-3)
    np.testing.assert_allclose(np.ptp(model.vertices, axis=0), [0.04, 0.05, 0.06], rtol=1e-6)
    assert load_object(tmp_path / "Brick.stl", scale=2e-3).digest != model.digest


def test_surface_samples_lie_on_the_surface_and_point_out(objects):
    points, normals = objects["cross"].surface_samples(500, 3)
    np.testing.assert_array_equal(points, objects["cross"].surface_samples(500, 3)[0])
    assert (points != objects["cross"].surface_samples(500, 4)[0]).any()
    outside = objects["cross"].exact.query(points + 1e-4 * normals).distance
    np.testing.assert_allclose(outside, 1e-4, atol=2e-5)


def test_object_travels_to_another_process(objects):
    model = objects["cross"]
    points = np.random.default_rng(0).normal(0.0, 0.03, (50, 3))
    expected = model.exact.query(points).distance
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(model)).exact.query(points).distance, expected)


def test_grid_is_kept_and_a_damaged_one_is_made_again(objects):
    first = load_object("cross").grid
    for file in cache_folder().glob("grid-*.npz"):
        file.write_bytes(file.read_bytes()[:200])
    again = load_object("cross").grid
    np.testing.assert_array_equal(first.values, again.values)
    np.testing.assert_array_equal(load_object("cross").grid.gradients, first.gradients)


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 nonsense", None])
def test_damaged_parts_in_the_cache_are_made_again(tmp_path, monkeypatch, damage):
    monkeypatch.setenv("XDEX_CACHE", str(tmp_path / "cache"))
    first = load_object("prism")
    (file,) = (tmp_path / "cache").glob("parts-*.npz")
    if damage is None:
        np.savez(file, counts=np.zeros(3))
    else:
        file.write_bytes(damage)
    again = load_object("prism")
    assert not again.report.cached
    np.testing.assert_array_equal(first.parts[0][0], again.parts[0][0])
    assert load_object("prism").report.cached


def test_a_cache_that_cannot_be_written_costs_only_time(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDEX_CACHE", str(tmp_path / "file" / "cache"))
    assert load_object("prism").report.parts == 1


def test_many_readers_and_writers_at_once(tmp_path, monkeypatch):
    monkeypatch.setenv("XDEX_CACHE", str(tmp_path))
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        models = list(pool.map(load_object, ["hexagon"] * 16))
    assert len({model.parts[0][0].tobytes() for model in models}) == 1
    assert [file.name[:6] for file in tmp_path.iterdir()] == ["parts-"]


def test_unknown_names_and_bad_numbers(tmp_path):
    with pytest.raises(UnknownObject, match="hammer"):
        load_object("hamer")
    with pytest.raises(UnknownObject, match="known: angle"):
        load_object("zzzz")
    with pytest.raises(ObjectFileError, match="no such file"):
        load_object("missing/zzzz.obj")
    for options in ({"scale": 0.0}, {"mass": -1.0}, {"mass": float("nan")}, {"friction": -0.1}):
        with pytest.raises(ObjectFileError, match=next(iter(options))):
            load_object("box", **options)


@pytest.mark.parametrize("name", ["robosuite_lemon", "rgb_r56", "robosuite_milk"])
def test_reference_meshes(reference, name):
    model = load_object(reference / "objects" / "meshes" / f"{name}.obj")
    assert model.report.bulge_p99_m < 1.5e-3
    assert model.report.gap_p99_m < 1e-3
    points = model.surface_samples(1000, 0)[0] + np.random.default_rng(0).normal(0.0, 0.008, (1000, 3))
    error = np.abs(model.grid.interpolate(points)[0] - model.exact.query(points).distance)
    assert np.percentile(error, 99) < 1.6e-3
