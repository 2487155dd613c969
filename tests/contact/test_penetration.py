"""Signed distance of primitives, and the depth of points in a hand."""

import numpy as np
import pytest

from xdex_drake.contact import (
    bounding_sphere,
    contact_frames,
    half_spaces,
    hand_depths,
    penetration_depth,
    signed_distance,
)
from xdex_drake.errors import ConfigError, HandFileError
from xdex_drake.hand.description import Box, Capsule, Convex, Hand, Link, Sphere


def make_hand(geometries):
    links = tuple(
        Link(f"link_{k}", (geometry,), 0.1, np.zeros(3), np.eye(3), np.zeros((0, 4)))
        for k, geometry in enumerate(geometries)
    )
    return Hand("toy", "Toy", "right", links, (), (), np.zeros(3), np.eye(3), np.zeros(0), {})


def corners(size):
    return np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size


def test_closed_forms():
    sphere = Sphere(np.array([0.0, 0.0, 0.1]), 0.02)
    capsule = Capsule(np.zeros(3), np.array([0.0, 0.0, 0.04]), 0.01)
    box = Box(np.array([0.02, 0.04, 0.06]), np.array([0.1, 0.0, 0.0]))
    assert signed_distance(sphere, [0.0, 0.0, 0.1]) == pytest.approx(-0.02)
    assert signed_distance(sphere, [0.0, 0.03, 0.1]) == pytest.approx(0.01)
    assert signed_distance(capsule, [[0.02, 0.0, 0.02], [0.0, 0.0, 0.06], [0.0, 0.005, 0.0]]) == pytest.approx(
        [0.01, 0.01, -0.005]
    )
    assert signed_distance(box, [[0.1, 0.0, 0.0], [0.1, 0.0, 0.025], [0.113, 0.024, 0.0]]) == pytest.approx(
        [-0.01, -0.005, 0.005]
    )


def test_convex_box_agrees_with_box():
    rng = np.random.default_rng(0)
    size = np.array([0.02, 0.04, 0.06])
    points = rng.uniform(-0.04, 0.04, (500, 3))
    convex, box = Convex(corners(size)), Box(size, np.zeros(3))
    assert half_spaces(convex).shape == (6, 4)
    exact, planes = signed_distance(box, points), signed_distance(convex, points)
    inside = exact < 0
    assert planes[inside] == pytest.approx(exact[inside], abs=1e-12)
    assert np.all(planes <= exact + 1e-12) and np.all(planes[~inside] >= -1e-12)


def test_degenerate_capsule_is_a_ball():
    assert signed_distance(Capsule(np.ones(3), np.ones(3), 0.5), np.ones(3)) == pytest.approx(-0.5)


def test_flat_convex_is_refused():
    with pytest.raises(HandFileError, match="volume"):
        half_spaces(Convex(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])))


@pytest.mark.parametrize("seed", range(3))
def test_depths_agree_with_no_culling(seed):
    rng = np.random.default_rng(seed)
    geometries = [
        Sphere(rng.normal(size=3) * 0.01, 0.02),
        Capsule(rng.normal(size=3) * 0.01, rng.normal(size=3) * 0.03, 0.01),
        Box(rng.uniform(0.02, 0.05, 3), rng.normal(size=3) * 0.01, contact_frames(rng.normal(size=3))),
        Convex(rng.normal(size=(30, 3)) * 0.02),
    ]
    hand = make_hand(geometries)
    R_WLs, p_WLs = contact_frames(rng.normal(size=(4, 3))), rng.uniform(-0.05, 0.05, (4, 3))
    points = rng.uniform(-0.08, 0.08, (2000, 3))
    distances = [signed_distance(g, (points - p) @ R) for g, R, p in zip(geometries, R_WLs, p_WLs, strict=True)]
    expected = np.maximum(0.0, -np.min(distances, axis=0))
    assert hand_depths(hand, R_WLs, p_WLs, points) == pytest.approx(expected, abs=1e-12)
    assert penetration_depth(hand, R_WLs, p_WLs, points) == pytest.approx(expected.max())
    for geometry in geometries:
        center, radius = bounding_sphere(geometry)
        shell = center + 1.0001 * radius * contact_frames(rng.normal(size=(200, 3)))[..., 2]
        assert signed_distance(geometry, shell).min() > 0


def test_no_points_no_depth():
    hand = make_hand([Sphere(np.zeros(3), 0.1)])
    assert penetration_depth(hand, np.eye(3)[None], np.zeros((1, 3)), np.zeros((0, 3))) == 0.0
    with pytest.raises(ConfigError, match="points_W"):
        penetration_depth(hand, np.eye(3), np.zeros((1, 3)), np.zeros((0, 3)))
