import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.visualization.views import (
    Blobs,
    best_direction,
    best_view,
    frame_blobs,
    hand_blobs,
    look_at,
    object_points,
)


def project(X_WC, p_WPs, fov_y, aspect):
    """Picture coordinates, from -1 to 1 inside the picture."""
    p_CPs = (p_WPs - X_WC.translation()) @ X_WC.rotation().matrix()
    assert (p_CPs[:, 2] > 0.0).all()
    return p_CPs[:, :2] / p_CPs[:, 2:] / np.tan(0.5 * fov_y) / [aspect, 1.0]


def test_camera_looks_at_its_target_upright():
    X_WC = look_at(np.array([1.0, 2.0, 0.5]), np.array([0.1, -0.2, 0.3]))
    p_CT = X_WC.inverse() @ np.array([0.1, -0.2, 0.3])
    assert np.abs(p_CT[:2]).max() < 1e-12
    assert p_CT[2] > 0.0
    R_WC = X_WC.rotation().matrix()
    assert abs(R_WC[2, 0]) < 1e-12  # the picture's horizontal is level
    assert R_WC[2, 1] < 0.0  # and down is down


@pytest.mark.parametrize("aspect", [0.6, 1.0, 1.8])
@pytest.mark.parametrize("seed", range(3))
def test_framing_holds_everything_and_wastes_no_room(aspect, seed):
    rng = np.random.default_rng(seed)
    blobs = Blobs(rng.normal(size=(40, 3)) * 0.1 + rng.normal(size=3), rng.uniform(0.0, 0.03, 40))
    direction = np.array([*rng.normal(size=2), 0.5])
    X_WC = frame_blobs(blobs, direction, fov_y=0.7, aspect=aspect, margin=1.0)
    forward = X_WC.rotation().matrix()[:, 2]
    np.testing.assert_allclose(forward, -direction / np.linalg.norm(direction), atol=1e-12)
    u = rng.normal(size=(4000, 3))
    surface = (blobs.centers_W[:, None] + blobs.radii[:, None, None] * u / np.linalg.norm(u, axis=1)[:, None]).reshape(
        -1, 3
    )
    seen = project(X_WC, surface, 0.7, aspect)
    reach = np.array([seen.min(axis=0), seen.max(axis=0)])
    assert np.abs(reach).max() <= 1.0 + 1e-9
    # Both sides of the tighter axis touch the picture's edge.
    assert np.abs(reach).min(axis=0).max() > 0.97


def test_view_of_a_grasp_holds_hand_and_object_and_their_rise(grasp, hand, scene):
    X_WC = best_view(grasp, hand, scene, fov_y=0.6, aspect=4 / 3, rise_m=0.25)
    points = np.concatenate([hand_blobs(hand, grasp.X_WH, grasp.q).centers_W, object_points(scene)[0]])
    points = np.concatenate([points, points + np.array([0.0, 0.0, 0.25])])
    assert np.abs(project(X_WC, points, 0.6, 4 / 3)).max() < 1.0
    assert X_WC.translation()[2] > 0.0


def test_view_turns_with_the_grasp_that_hides_the_object(grasp, hand, scene):
    """The hand hangs on the -x side of the can: from there the can is hidden."""
    direction = best_direction(grasp, hand, scene)
    assert direction[2] > 0.0
    assert direction[0] > -0.9
    np.testing.assert_array_equal(direction, best_direction(grasp, hand, scene))


def test_object_points_move_with_the_object(scene):
    points, normals, gap = object_points(scene, RigidTransform())
    moved, _, _ = object_points(scene, RigidTransform([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(moved - points, np.tile([1.0, 2.0, 3.0], (len(points), 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert 0.003 < gap < 0.03
