"""Contacts by the hand's shapes and the object's mesh."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.grasping.true_shapes import PATCH_RADIUS, clear, lowest_height, patch_normals, touch
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.programs.force_closure import polish_program
from xdex_drake.programs.search import SearchSettings, search
from xdex_drake.programs.solve import solve
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene


@pytest.fixture(scope="module")
def hand():
    return load_hand("allegro")


@pytest.fixture(scope="module")
def scene():
    return make_scene(load_object("can"))


@pytest.fixture(scope="module")
def bulging(hand):
    """The hand with spheres that stand 1.5 mm out of its shapes."""
    grown = np.array([0.0, 0.0, 0.0, 1.5e-3])
    return replace(hand, links=tuple(replace(link, spheres=link.spheres + grown) for link in hand.links))


def true_gap(hand, k, link, points_W):
    p_L = (points_W - k.p_WLs[link]) @ k.R_WLs[link]
    return np.min([geometry.signed_distance(p_L) for geometry in hand.links[link].geometry], axis=0).min()


def test_shapes_touch_where_spheres_did(bulging, scene):
    from pydrake.math import RotationMatrix

    found = search(bulging, scene, count=24, seed=0, settings=SearchSettings())
    points_W = (scene.X_WO @ scene.object.surface_samples(20_000)[0].T).T
    touched = 0
    for row in range(8):
        X_WH = RigidTransform(RotationMatrix.ProjectToRotationMatrix(found.R_WHs[row]), found.p_WHs[row])
        program = polish_program(bulging, scene, X_WH, found.qs[row], found.fingers[row])
        result = solve(program, solver="sequential", improvement=np.inf)
        if not result.success:
            continue
        before, after = result.point, touch(bulging, result.point)
        gaps = [true_gap(bulging, before.k, link, points_W) for link in before.contacts.links]
        assert np.median(gaps) > 1e-3
        assert np.abs(after.gaps).max() < 3e-4
        for link in before.contacts.links:
            # Samples lie up to a millimetre apart, so that the least of them is a little more than the gap.
            assert -2e-4 < true_gap(bulging, after.k, link, points_W) < 5e-4
        p_OCs = (after.p_WCs - scene.X_WO.translation()) @ scene.X_WO.rotation().matrix()
        assert np.abs(scene.object.mesh_distance.query(p_OCs).distance).max() < 1e-9
        assert np.all((after.k.q >= bulging.limits[0]) & (after.k.q <= bulging.limits[1]))
        touched += 1
    assert touched >= 2


def test_normals_are_those_of_faces_and_blend_on_edges():
    box = load_object("box")
    lower, upper = box.vertices.min(axis=0), box.vertices.max(axis=0)
    middle = 0.5 * (lower + upper)
    on_face = np.array([upper[0], middle[1], middle[2]])
    tilted = np.array([0.8, 0.6, 0.0])  # how the finger stands there does not matter
    np.testing.assert_allclose(patch_normals(box, on_face[None], tilted[None])[0], [1.0, 0.0, 0.0], atol=1e-6)
    on_edge = np.array([upper[0], upper[1], middle[2]])
    diagonal = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    np.testing.assert_allclose(patch_normals(box, on_edge[None], diagonal[None])[0], diagonal, atol=1e-6)
    beside = on_edge - np.array([0.0, 3.0 * PATCH_RADIUS, 0.0])
    np.testing.assert_allclose(patch_normals(box, beside[None], np.eye(3)[:1])[0], [1.0, 0.0, 0.0], atol=1e-6)


def test_height_and_clearance_are_those_of_shapes(hand):
    k = Configuration.at(hand, RigidTransform([0.0, 0.0, 0.3]), hand.q_rest)
    corners = np.concatenate(
        [
            geometry.sample(3000, np.random.default_rng(0))[0] @ R.T + p
            for link, R, p in zip(hand.links, k.R_WLs, k.p_WLs, strict=True)
            for geometry in link.geometry
        ]
    )
    assert lowest_height(hand, k) == pytest.approx(corners[:, 2].min(), abs=5e-4)
    assert lowest_height(hand, k) <= corners[:, 2].min() + 1e-9
    below = np.array([[*corners[np.argmin(corners[:, 2])][:2], lowest_height(hand, k) - 2e-3]])
    assert clear(hand, k, below, 1.5e-3)
    assert not clear(hand, k, below, 3e-3)
