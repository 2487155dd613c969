import numpy as np
import pytest
import trimesh

from xdex_drake.scene.distance import ExactDistance, build_grid, sample_surface, union_surface
from xdex_drake.scene.hulls import convex_hull, grow

HALF = np.array([0.03, 0.02, 0.04])


def box_distance(points, half):
    q = np.abs(points) - half
    return np.linalg.norm(q.clip(0.0), axis=1) + q.max(axis=1).clip(max=0.0)


@pytest.fixture(scope="module")
def box_part():
    return convex_hull(trimesh.creation.box(2.0 * HALF).vertices)


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(-0.07, 0.07, (2000, 3))


def test_box_is_exact(box_part, points):
    for exact in (ExactDistance(*box_part, parts=[box_part]), ExactDistance(*box_part)):
        result = exact.query(points)
        np.testing.assert_allclose(result.distance, box_distance(points, HALF), atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(result.gradient, axis=1), 1.0, atol=1e-9)
        np.testing.assert_allclose(points - result.distance[:, None] * result.gradient, result.closest, atol=1e-12)
        assert (exact.contains(points) == (np.abs(points) < HALF).all(axis=1)).all()


def test_gradient_is_the_slope(box_part, points):
    exact, step = ExactDistance(*box_part, parts=[box_part]), 1e-6
    slope = np.column_stack(
        [exact.query(points + step * e).distance - exact.query(points - step * e).distance for e in np.eye(3)]
    ) / (2 * step)
    error = np.abs(slope - exact.query(points).gradient).max(axis=1)
    assert np.percentile(error, 99) < 1e-6  # Kinks at the medial axis are the rest.


def test_on_the_surface_the_gradient_is_the_normal(box_part):
    exact = ExactDistance(*box_part, parts=[box_part])
    result = exact.query(np.array([[HALF[0], 0.003, 0.004]]))
    np.testing.assert_allclose(result.gradient, [[1.0, 0.0, 0.0]], atol=1e-9)
    assert abs(result.distance[0]) < 1e-12


def test_sphere():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    part = convex_hull(ball.vertices, limit=10_000, tolerance=0.0)
    points = np.random.default_rng(1).normal(size=(1000, 3)) * 0.03
    exact = ExactDistance(*part, parts=[part])
    np.testing.assert_allclose(exact.query(points).distance, np.linalg.norm(points, axis=1) - 0.03, atol=1e-4)


def test_no_points():
    part = convex_hull(trimesh.creation.box(2.0 * HALF).vertices)
    assert ExactDistance(*part).query(np.zeros((0, 3))).distance.shape == (0,)


def test_union_of_grown_halves_has_no_wall_inside():
    left = trimesh.creation.box(bounds=[[-0.03, -0.02, -0.02], [1e-9, 0.02, 0.02]])
    right = trimesh.creation.box(bounds=[[1e-5, -0.02, -0.02], [0.03, 0.02, 0.02]])
    parts = [grow(*convex_hull(half.vertices), 5e-5) for half in (left, right)]
    exact = ExactDistance(*union_surface(parts), parts=parts)
    assert exact.query(np.zeros((1, 3))).distance[0] == pytest.approx(-0.02, abs=2e-4)


def test_union_of_disjoint_parts_has_both():
    one, two = trimesh.creation.box((0.02, 0.02, 0.02)), trimesh.creation.box((0.02, 0.02, 0.02))
    two.apply_translation([0.05, 0.0, 0.0])
    parts = [convex_hull(one.vertices), convex_hull(two.vertices)]
    exact = ExactDistance(*union_surface(parts), parts=parts)
    points = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.025, 0.0, 0.0]])
    np.testing.assert_allclose(exact.query(points).distance, [-0.01, -0.01, 0.015], atol=1e-12)


def test_hull_keeps_within_its_tolerance_and_limit():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03).vertices
    for limit, tolerance in ((64, 0.0), (500, 1e-3)):
        part = convex_hull(ball, limit=limit, tolerance=tolerance)
        assert len(part[0]) <= limit
        worst = ExactDistance(*part, parts=[part]).query(np.asarray(ball)).distance.max()
        assert worst <= (tolerance or 4e-3) + 1e-9
        assert trimesh.Trimesh(*part).volume > 0.0


def test_bounds_grow_beyond_the_grid_and_never_exceed_the_distance(box_part):
    exact = ExactDistance(*box_part, parts=[box_part])
    grid = build_grid(exact)
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (4000, 3))
    bound, truth = grid.lower_bounds(points), box_distance(points, HALF)
    assert (bound <= truth + 0.15 * grid.spacing).all()
    assert (bound >= 0.7 * truth - grid.spacing).all(), "a bound that stays at the border is no use far off"
    inside = ((points > grid.origin) & (points < grid.upper)).all(axis=1)
    np.testing.assert_allclose(bound[inside], grid.interpolate(points[inside])[0], atol=1e-6)


def test_grid_follows_the_exact_distance(box_part):
    exact = ExactDistance(*box_part, parts=[box_part])
    grid = build_grid(exact)
    assert grid.values.dtype == np.float32
    assert max(grid.values.shape) <= 72
    assert (grid.origin <= exact.vertices.min(axis=0) - 0.03 + 1e-9).all()
    nodes = grid.origin + grid.spacing * np.argwhere(np.ones(grid.values.shape))
    truth = exact.query(nodes)
    assert np.abs(grid.values.ravel() - truth.distance).max() < 0.15 * grid.spacing
    rng = np.random.default_rng(2)
    near = sample_surface(*box_part, 4000, 3)[0] + rng.normal(0.0, 0.008, (4000, 3))
    distance, gradient = grid.interpolate(near)
    assert np.percentile(np.abs(distance - exact.query(near).distance), 99) < 8e-4
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0, atol=1e-6)
    far = rng.uniform(-0.4, 0.4, (2000, 3))
    distance, gradient = grid.interpolate(far)
    truth = exact.query(far)
    assert np.percentile(np.abs(distance - truth.distance), 99) < 2e-3
    assert np.percentile(np.einsum("ij,ij->i", gradient, truth.gradient), 1) > 0.97


def test_surface_samples_are_even_and_seeded(box_part):
    points, face = sample_surface(*box_part, 20_000, 5)
    assert (points == sample_surface(*box_part, 20_000, 5)[0]).all()
    assert np.abs(ExactDistance(*box_part).query(points).distance).max() < 1e-12
    top = np.mean(points[:, 2] > HALF[2] - 1e-9)
    area = 4.0 * (HALF[0] * HALF[1] + HALF[1] * HALF[2] + HALF[2] * HALF[0]) * 2.0
    assert top == pytest.approx(4.0 * HALF[0] * HALF[1] / area, rel=0.05)
    assert face.shape == (20_000,)
