"""Each shape agrees with itself: what is asked of it in one way follows from what is asked in another."""

import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from xdex_drake.errors import HandFileError
from xdex_drake.hand.importing.model import Cylinder, TriangleMesh
from xdex_drake.hand.shapes import Box, Capsule, Convex, Sphere, values_of

R = Rotation.from_rotvec([0.3, -0.7, 1.1]).as_matrix()
P = np.array([0.02, -0.05, 0.03])
SHAPES = {
    "sphere": Sphere(np.array([0.01, 0.02, -0.01]), 0.015),
    "capsule": Capsule(np.array([0.0, 0.01, 0.0]), np.array([0.02, 0.01, 0.05]), 0.008),
    "ball": Capsule(np.array([0.01, 0.0, 0.0]), np.array([0.01, 0.0, 0.0]), 0.012),
    "box": Box(
        np.array([0.02, 0.03, 0.05]), np.array([0.01, 0.0, -0.01]), Rotation.from_rotvec([0.2, 0.5, 0.1]).as_matrix()
    ),
    "convex": Convex(np.random.default_rng(3).normal(size=(20, 3)) * [0.02, 0.01, 0.03] + [0.0, 0.01, 0.0]),
}


@pytest.fixture(params=list(SHAPES))
def shape(request: pytest.FixtureRequest):
    return SHAPES[request.param]


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(400, 3)) * 0.04


def normals(shape, on_surface: np.ndarray) -> np.ndarray:
    """Gradient of the signed distance by differences, shape (n, 3)."""
    h = 1e-7
    return np.stack(
        [
            (shape.signed_distance(on_surface + h * e) - shape.signed_distance(on_surface - h * e)) / (2.0 * h)
            for e in np.eye(3)
        ],
        axis=-1,
    )


def test_a_moved_shape_is_as_far_from_moved_points(shape, points) -> None:
    moved = shape.moved(R, P)
    assert moved.signed_distance(points @ R.T + P) == pytest.approx(shape.signed_distance(points), abs=1e-12)
    assert moved.volume().p_LCenter == pytest.approx(R @ shape.volume().p_LCenter + P)
    assert moved.volume().moments == pytest.approx(R @ shape.volume().moments @ R.T, abs=1e-18)


def test_a_scaled_shape_grows_in_all(shape, points) -> None:
    scaled, before, after = shape.scaled(1.7), shape.volume(), shape.scaled(1.7).volume()
    assert scaled.signed_distance(1.7 * points) == pytest.approx(1.7 * shape.signed_distance(points), abs=1e-12)
    assert after.volume == pytest.approx(1.7**3 * before.volume)
    assert after.moments == pytest.approx(1.7**5 * before.moments, abs=1e-18)
    assert scaled.area() == pytest.approx(1.7**2 * shape.area())


def test_a_mirrored_shape_is_as_far_from_mirrored_points(shape, points) -> None:
    flip = np.array([1.0, -1.0, 1.0])
    mirrored = shape.mirrored()
    assert mirrored.signed_distance(points * flip) == pytest.approx(shape.signed_distance(points), abs=1e-12)
    for once, twice in zip(values_of(shape)[1:], values_of(mirrored.mirrored())[1:], strict=True):
        assert np.array_equal(once, twice)


def test_samples_lie_on_the_surface_and_bounds_hold_them(shape) -> None:
    sample = shape.sample(5000, np.random.default_rng(1))
    assert np.abs(shape.signed_distance(sample)).max() < 1e-12
    center, radius = shape.bounding_sphere()
    assert np.linalg.norm(sample - center, axis=1).max() <= radius + 1e-12
    low, high = shape.bounds()
    assert (sample >= low - 1e-12).all() and (sample <= high + 1e-12).all()
    assert np.abs(shape.signed_distance(shape.corners())).max() < 1e-12


def test_support_bounds_samples_and_is_the_bounds_along_axes(shape) -> None:
    sample = shape.sample(20000, np.random.default_rng(2))
    for d in Rotation.random(6, random_state=0).as_matrix()[:, 0]:
        gap = shape.support(d) - (sample @ d).max()
        assert -1e-12 < gap < 1e-3
    low, high = shape.bounds()
    assert [shape.support(e) for e in np.eye(3)] == pytest.approx(high)
    assert [-shape.support(-e) for e in np.eye(3)] == pytest.approx(low)


def test_volume_is_what_is_inside(shape) -> None:
    low, high = shape.bounds()
    inside = np.random.default_rng(4).uniform(low, high, size=(400_000, 3))
    inside = inside[shape.signed_distance(inside) < 0.0]
    found = shape.volume()
    assert found.volume == pytest.approx(len(inside) / 400_000 * np.prod(high - low), rel=0.01)
    d = inside - found.p_LCenter
    assert np.abs(d.mean(axis=0)).max() < 0.01 * np.ptp([low, high])
    second = d.T @ d / len(d) * found.volume
    assert found.moments == pytest.approx(np.trace(second) * np.eye(3) - second, abs=0.02 * np.trace(second))


def test_area_volume_and_samples_satisfy_the_divergence_theorem(shape) -> None:
    """3 V = integral of p . n over the surface: wrong areas, or samples that are not uniform, break it."""
    sample = shape.sample(60_000, np.random.default_rng(5))
    flux = shape.area() * np.einsum("na,na->n", sample - shape.volume().p_LCenter, normals(shape, sample))
    assert flux.mean() == pytest.approx(3.0 * shape.volume().volume, rel=0.02)
    # And the surface encloses: the integral of n alone is zero.
    assert np.abs(normals(shape, sample).mean(axis=0)).max() < 0.02


def test_signed_distances_in_closed_form() -> None:
    sphere = Sphere(np.array([0.0, 0.0, 0.1]), 0.02)
    capsule = Capsule(np.zeros(3), np.array([0.0, 0.0, 0.04]), 0.01)
    box = Box(np.array([0.02, 0.04, 0.06]), np.array([0.1, 0.0, 0.0]))
    assert sphere.signed_distance([0.0, 0.0, 0.1]) == pytest.approx(-0.02)
    assert sphere.signed_distance([0.0, 0.03, 0.1]) == pytest.approx(0.01)
    beside = [[0.02, 0.0, 0.02], [0.0, 0.0, 0.06], [0.0, 0.005, 0.0]]
    assert capsule.signed_distance(beside) == pytest.approx([0.01, 0.01, -0.005])
    near = [[0.1, 0.0, 0.0], [0.1, 0.0, 0.025], [0.113, 0.024, 0.0]]
    assert box.signed_distance(near) == pytest.approx([-0.01, -0.005, 0.005])


def test_a_hull_of_corners_agrees_with_its_box() -> None:
    box = Box(np.array([0.02, 0.04, 0.06]), np.array([0.01, 0.0, 0.0]), R)
    hull = Convex(box.corners())
    points = np.random.default_rng(0).uniform(-0.04, 0.04, (500, 3))
    exact, planes = box.signed_distance(points), hull.signed_distance(points)
    inside = exact < 0.0
    assert len(hull.half_spaces()[0]) == len(box.half_spaces()[0]) == 6
    assert planes[inside] == pytest.approx(exact[inside], abs=1e-12)
    assert (planes <= exact + 1e-12).all() and (planes[~inside] >= -1e-12).all()
    assert hull.volume().volume == pytest.approx(box.volume().volume)
    assert hull.volume().moments == pytest.approx(box.volume().moments, abs=1e-18)
    assert hull.area() == pytest.approx(box.area())


def test_balls_of_a_capsule_leave_grooves_no_deeper_than_asked() -> None:
    capsule = SHAPES["capsule"]
    balls = capsule.balls(4e-4, 100)
    surface = capsule.sample(4000, np.random.default_rng(0))
    gaps = np.linalg.norm(surface[:, None] - balls[None, :, :3], axis=-1) - balls[:, 3]
    assert 3e-4 < gaps.min(axis=1).max() <= 4e-4 + 1e-9
    assert len(capsule.balls(4e-4, 3)) == 3 and len(SHAPES["ball"].balls(4e-4, 9)) == 1


def test_a_flat_hull_is_refused() -> None:
    with pytest.raises(HandFileError, match="volume"):
        _ = Convex(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])).hull


def test_what_is_kept_about_a_hull_is_no_part_of_its_value() -> None:
    fresh, used = Convex(SHAPES["convex"].vertices), SHAPES["convex"]
    _ = used.hull
    assert [type(v) for v in values_of(used)] == [type(v) for v in values_of(fresh)]
    assert np.array_equal(pickle.loads(pickle.dumps(used)).vertices, fresh.vertices)


def test_shapes_of_files_move_and_scale_like_the_others() -> None:
    cylinder = Cylinder(np.array([0.0, 0.01, 0.0]), np.array([0.0, 0.01, 0.03]), 0.01)
    mesh = TriangleMesh(SHAPES["box"].corners(), np.array([[0, 1, 2], [1, 2, 3]]), "made.stl")
    for shape in (cylinder, mesh):
        reach = (shape.corners() @ R.T + P).max(axis=0)
        assert shape.moved(R, P).corners().max(axis=0) == pytest.approx(reach, abs=2e-3)
        assert np.ptp(shape.scaled(2.0).corners(), axis=0) == pytest.approx(2.0 * np.ptp(shape.corners(), axis=0))
    assert mesh.moved(R, P).source == mesh.scaled(2.0).source == "made.stl"
    assert np.array_equal(mesh.moved(R, P).faces, mesh.faces)
