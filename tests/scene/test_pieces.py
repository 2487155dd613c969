"""What users' mesh files hold beside one closed body near its origin."""

import numpy as np
import pytest
import trimesh

from xdex_drake.cli import main
from xdex_drake.errors import ObjectFileError
from xdex_drake.scene.mesh import clean_mesh, read_mesh
from xdex_drake.scene.object import load_object


def box(x, y, z, at=(0.0, 0.0, 0.0)):
    return trimesh.creation.box((x, y, z), transform=trimesh.transformations.translation_matrix(at))


def written(path, *meshes):
    trimesh.util.concatenate(meshes).export(path)
    return path


def extents(mesh):
    return np.ptp(mesh.vertices, axis=0)


@pytest.mark.parametrize("shake_um", [2.0, 20.0])
@pytest.mark.parametrize("shape", ["can", "box"])
def test_a_soup_of_nearly_equal_corners_is_closed(shake_um, shape):
    whole = trimesh.creation.cylinder(0.033, 0.12, sections=24) if shape == "can" else box(0.05, 0.04, 0.1)
    rng = np.random.default_rng(0)
    corners = whole.triangles.reshape(-1, 3) + 1e-6 * shake_um * rng.uniform(-1.0, 1.0, (3 * len(whole.faces), 3))
    mesh = clean_mesh(corners, np.arange(len(corners)).reshape(-1, 3))
    assert mesh.watertight and mesh.bodies == 1 and any("near vertices" in repair for repair in mesh.repairs)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(whole.volume, rel=2e-3)


def test_triangles_that_do_not_meet_are_refused():
    rng = np.random.default_rng(1)
    corners = (rng.uniform(-0.05, 0.05, (60, 1, 3)) + rng.uniform(-0.005, 0.005, (60, 3, 3))).reshape(-1, 3)
    with pytest.raises(ObjectFileError, match="60 loose triangles"):
        clean_mesh(corners, np.arange(180).reshape(-1, 3))


def test_detail_and_mouths_are_not_merged_away():
    bowl = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    half = bowl.submesh([np.flatnonzero(bowl.triangles_center[:, 2] < 0.0)], append=True)
    assert not any("near" in repair for repair in clean_mesh(half.vertices, half.faces).repairs)


def test_debris_is_left_out_and_told():
    rng, main_body = np.random.default_rng(2), box(0.05, 0.05, 0.12)
    specks = [box(*rng.uniform(1e-3, 2e-3, 3), at=0.15 * direction) for direction in rng.normal(size=(25, 3))]
    specks = [s for s in specks if np.abs(s.centroid).max() > 0.08]
    scan = trimesh.util.concatenate([main_body, *specks])
    mesh = clean_mesh(scan.vertices, scan.faces)
    assert extents(mesh) == pytest.approx([0.05, 0.05, 0.12]) and mesh.bodies == 1
    assert any(repair.startswith(f"left out {len(specks)} loose bits") for repair in mesh.repairs)
    # A small part that sits on the body stays.
    button = trimesh.util.concatenate([main_body, box(2e-3, 2e-3, 2e-3, at=(0.0, 0.026, 0.0))])
    assert clean_mesh(button.vertices, button.faces).bodies == 2


def test_several_bodies_are_told_and_one_can_be_chosen(tmp_path):
    file = written(tmp_path / "two.obj", box(0.05, 0.05, 0.1), box(0.05, 0.05, 0.04, at=(0.4, 0.0, 0.0)))
    told = read_mesh(file).repairs[-1]
    assert "2 bodies, up to 0.35 m apart" in told and "FILE#0" in told
    whole, second = load_object(file), load_object(f"{file}#1")
    assert extents(second) == pytest.approx([0.05, 0.05, 0.04]) and not second.report.repairs
    assert whole.p_OOcm[0] == pytest.approx(0.4 * 0.04 / 0.14) and second.p_OOcm[0] == pytest.approx(0.4)
    assert second.name == "two_1" and second.digest != whole.digest
    with pytest.raises(ObjectFileError, match="no #2"):
        load_object(f"{file}#2")


def test_the_ground_is_told(tmp_path, capsys):
    file = written(
        tmp_path / "scene.obj", box(1.0, 1.0, 2e-3, at=(0.0, 0.0, -1e-3)), box(0.05, 0.05, 0.1, (0, 0, 0.05))
    )
    assert "a sheet of 1 x 1 m touches the rest" in read_mesh(file).repairs[-1]
    assert main(["object", "show", f"{file}#1", "--no-poses"]) == 0
    assert "5.0 x 5.0 x 10.0" in capsys.readouterr().out
    # Parts that touch each other are one object, and nothing is said.
    assert not read_mesh(
        written(tmp_path / "tee.obj", box(0.02, 0.02, 0.1), box(0.1, 0.02, 0.02, (0, 0, 0.06)))
    ).repairs


def test_far_from_the_origin_is_the_same_body(tmp_path):
    here, there = box(0.05, 0.05, 0.12), np.array([20e3, 40e3, 2e3])
    model = load_object(written(tmp_path / "far.obj", box(0.05, 0.05, 0.12, at=there)))
    assert model.report.volume == pytest.approx(here.volume, rel=1e-4)
    assert model.p_OOcm == pytest.approx(there, abs=1e-5)
    assert np.diag(model.I_OcmO) == pytest.approx(0.1 / 12.0 * np.array([0.0169, 0.0169, 0.005]), rel=1e-3)
    assert model.exact.query(there[None] + [0.0, 0.0, 0.1]).distance[0] == pytest.approx(0.04, abs=2e-4)
