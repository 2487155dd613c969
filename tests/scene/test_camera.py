import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.errors import ConfigError, MissingExtra
from xdex_drake.scene import camera as camera_module
from xdex_drake.scene.camera import NO_NOISE, NOISE, camera_poses, can_see, depth_cloud, look_at
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene, point_cloud


@pytest.fixture(scope="module")
def scenes():
    if not can_see():
        pytest.skip("this machine cannot render depth")
    return {name: make_scene(load_object(name), seed=1) for name in ("box", "hammer")}


@pytest.mark.parametrize("name", ["box", "hammer"])
def test_points_lie_on_the_visible_side_of_the_mesh(scenes, name):
    scene = scenes[name]
    for X_WC in camera_poses(scene, 3, np.random.default_rng(0)):
        p_OPs = depth_cloud(scene, X_WC, noise=NO_NOISE, in_world=False)
        exact = scene.object.mesh_distance
        assert len(p_OPs) > 300
        assert np.abs(exact.query(p_OPs).distance).max() < 1e-5
        p_OC = scene.X_WO.inverse() @ X_WC.translation()
        for share in np.linspace(0.5, 0.99, 30):  # Nothing lies between the camera and a point.
            assert exact.query(p_OC + share * (p_OPs - p_OC)).distance.min() > -1e-5
        p_WPs = depth_cloud(scene, X_WC, noise=NO_NOISE)
        np.testing.assert_allclose((scene.X_WO @ p_OPs.T).T, p_WPs, atol=1e-12)
        assert p_WPs[:, 2].min() > -1e-3


def test_faces_turned_away_are_not_seen(scenes):
    scene = scenes["box"]
    X_WC = camera_poses(scene, 1, np.random.default_rng(4))[0]
    seen = depth_cloud(scene, X_WC, noise=NO_NOISE)
    full, normals = point_cloud(scene, 2000, 0)
    toward = np.einsum("ij,ij->i", normals, X_WC.translation() - full) > 0.0
    distance = np.linalg.norm(full[:, None] - seen, axis=2).min(axis=1)
    assert np.percentile(distance[toward], 99) < 8e-3  # A wall that is all but edge-on has few pixels.
    assert np.median(distance[~toward]) > 1e-2


def test_noise_has_the_size_that_it_says_and_repeats(scenes):
    scene = scenes["box"]
    X_WC = look_at(scene.X_WO.translation() + np.array([0.0, 0.0, 0.6]), scene.X_WO.translation())
    noisy = depth_cloud(scene, X_WC, in_world=False, rng=np.random.default_rng(1))
    np.testing.assert_array_equal(noisy, depth_cloud(scene, X_WC, in_world=False, rng=np.random.default_rng(1)))
    clean = depth_cloud(scene, X_WC, noise=NO_NOISE, in_world=False)
    assert 0.8 * len(clean) < len(noisy) < len(clean)
    height = (scene.X_WO @ noisy.T).T[:, 2]
    depth = 0.6 + scene.X_WO.translation()[2] - np.median(height)
    height = height[height > np.median(height) - 8e-3]  # The top, without the walls.
    assert np.std(height) == pytest.approx(NOISE.constant_m + NOISE.square * depth**2, rel=0.15)


def test_nothing_is_seen_from_behind_and_a_camera_needs_a_direction(scenes):
    scene = scenes["box"]
    away = RigidTransform(scene.X_WO.translation() + np.array([0.0, 0.0, 0.5]))  # z of the camera points up.
    assert depth_cloud(scene, away).shape == (0, 3)
    with pytest.raises(ConfigError, match="move it away"):
        look_at(np.zeros(3), np.zeros(3))


def test_a_machine_without_graphics_is_told_what_to_install(monkeypatch):
    monkeypatch.setattr(camera_module, "can_see", lambda: False)
    scene = make_scene(load_object("box"), pose=RigidTransform([0.0, 0.0, 0.0]))
    with pytest.raises(MissingExtra, match="libegl1"):
        depth_cloud(scene, RigidTransform())
