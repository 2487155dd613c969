"""Objects from meshes in memory, and objects whose mass lies otherwise than in their volume."""

import numpy as np
import pytest
import trimesh

from xdex_drake.dataset.files import load_grasps, save_grasps
from xdex_drake.errors import GraspFileError, ObjectFileError
from xdex_drake.grasp import Grasp
from xdex_drake.hand.library import load_hand
from xdex_drake.scene.facts import SceneFacts
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene

SIDES = (0.04, 0.05, 0.1)


def grasp_in(scene):
    """A grasp without a certificate; where it is does not matter."""
    return Grasp("allegro", scene.object.name, scene.X_WO, scene.X_WO, load_hand("allegro").q_rest, grasp_id="g")


def test_arrays_a_trimesh_and_a_file_are_the_same_object(tmp_path):
    mesh = trimesh.creation.box(SIDES)
    mesh.export(tmp_path / "part.obj")
    kept = load_object(tmp_path / "part.obj")
    for source in (mesh, (mesh.vertices, mesh.faces)):
        model = load_object(source, name="part")
        assert (model.name, model.path, len(model.parts)) == ("part", None, 1)
        np.testing.assert_allclose(model.I_OcmO, kept.I_OcmO, rtol=1e-6)
    assert np.ptp(load_object(mesh, scale=0.5).vertices, axis=0) == pytest.approx([0.02, 0.025, 0.05])


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ((np.zeros((4, 2)), np.zeros((2, 3), int)), "part: vertices have shape"),
        ((np.zeros((4, 3)), np.zeros((2, 3))), "part: faces are of type float64"),
        ((np.zeros((4, 3)), np.full((2, 3), 9)), "part: a triangle refers to a vertex"),
        ((np.full((4, 3), np.nan), np.array([[0, 1, 2]])), "part: has a vertex coordinate"),
    ],
)
def test_arrays_that_are_no_mesh_are_told(source, said):
    with pytest.raises(ObjectFileError, match=said):
        load_object(source, name="part")


def test_a_mesh_in_memory_is_not_stored_without_a_file(tmp_path):
    scene = make_scene(load_object(trimesh.creation.box(SIDES), name="part"))
    for store in (
        lambda: SceneFacts.of(scene),
        lambda: save_grasps(tmp_path / "g.parquet", [grasp_in(scene)], load_hand("allegro"), scene),
    ):
        with pytest.raises(GraspFileError, match="write the mesh to a file"):
            store()
    assert not list(tmp_path.iterdir())


def test_a_given_center_of_mass_and_inertia_count_and_are_stored(tmp_path):
    inertia = np.diag([2e-4, 2e-4, 1e-4])
    model = load_object("can", mass=0.4, p_OOcm=(0.0, 0.01, 0.02), I_OcmO=inertia)
    np.testing.assert_array_equal(model.p_OOcm, [0.0, 0.01, 0.02])
    scene = make_scene(model, seed=0)
    assert scene.scene_id != make_scene(load_object("can", mass=0.4)).scene_id
    assert (scene.X_WO @ model.p_OOcm)[:2] == pytest.approx([0.0, 0.0], abs=1e-9)  # it rests with that over the origin
    save_grasps(tmp_path / "g.parquet", [grasp_in(scene)], load_hand("allegro"), scene)
    (stored,) = load_grasps(tmp_path / "g.parquet")
    np.testing.assert_array_equal(stored.scene.object.I_OcmO, inertia)
    np.testing.assert_array_equal(stored.scene.object.p_OOcm, model.p_OOcm)


@pytest.mark.parametrize(
    "wrong", [np.diag([1.0, 1.0, 3.0]), np.diag([1.0, 1.0, -1.0]), np.ones((2, 2)), np.full((3, 3), np.nan)]
)
def test_an_inertia_of_no_body_is_refused(wrong):
    with pytest.raises(ObjectFileError, match="inertia of no body"):
        load_object("can", I_OcmO=wrong)
    with pytest.raises(ObjectFileError, match="three finite numbers"):
        load_object("can", p_OOcm=(0.0, 1.0, np.inf))
