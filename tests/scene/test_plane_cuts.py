import manifold3d
import numpy as np
import pytest
import trimesh

from xdex_drake.scene.distance import union_surface
from xdex_drake.scene.plane_cuts import Bulge, split_by_planes
from xdex_drake.scene.splitting import TARGET_BULGE, fit, refine


def arrays(solid):
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties, dtype=np.float64)[:, :3], np.array(mesh.tri_verts, dtype=np.int64)


def cylinder(radius, height, sides=40):
    return manifold3d.Manifold.cylinder(height, radius, circular_segments=sides)


@pytest.fixture(scope="module")
def cup():
    return cylinder(0.03, 0.08) - cylinder(0.027, 0.08).translate((0.0, 0.0, 0.004))


def test_a_cup_is_a_bottom_and_sectors_of_its_wall(cup):
    vertices, faces = arrays(cup)
    parts = split_by_planes(cup, Bulge(vertices, faces, TARGET_BULGE), share=0.008, most=128)
    assert 12 <= len(parts) <= 40  # A sector of 30 degrees bulges by 0.9 mm.
    bulge, gap = fit(vertices, faces, parts, union_surface(parts))
    assert bulge <= TARGET_BULGE and gap < 1e-5


def test_the_same_cup_gives_the_same_parts(cup):
    vertices, faces = arrays(cup)
    first, again = (split_by_planes(cup, Bulge(vertices, faces, 2e-3), share=0.01, most=64) for _ in range(2))
    for (v, f), (w, g) in zip(first, again, strict=True):
        np.testing.assert_array_equal(v, w)
        np.testing.assert_array_equal(f, g)


def test_the_number_of_pieces_is_bounded(cup):
    vertices, faces = arrays(cup)
    parts = split_by_planes(cup, Bulge(vertices, faces, 1e-4), share=0.0, most=12)
    assert len(parts) <= 18  # The last cut may give several.


def test_parts_that_fit_are_handed_back_as_they_are_and_others_are_cut(cup):
    box = trimesh.creation.box((0.04, 0.05, 0.06))
    mesh = np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int64)
    assert refine(*mesh, (mesh,)) == (mesh,)
    hull = arrays(cup.hull())
    refined = refine(*arrays(cup), (hull,))
    assert len(refined) > 10
    assert fit(*arrays(cup), refined, union_surface(refined))[0] <= TARGET_BULGE


def test_points_inside_of_the_mesh_do_not_bulge(cup):
    bulge = Bulge(*arrays(cup), 1e-3)
    height, closest = bulge.of(np.array([[0.0, 0.0, 0.002], [0.0, 0.0, 0.04], [0.05, 0.0, 0.04]]))
    np.testing.assert_allclose(height, [0.0, 0.027, 0.02], atol=2e-4)
    np.testing.assert_allclose(closest[2], [0.03, 0.0, 0.04], atol=2e-4)
