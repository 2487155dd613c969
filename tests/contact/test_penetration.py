"""The depth of points in a hand."""

import numpy as np
import pytest

from xdex_drake.contact import contact_frames, hand_depths, penetration_depth
from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Box, Capsule, Convex, Hand, Link, Sphere


def make_hand(geometries):
    links = tuple(
        Link(f"link_{k}", (geometry,), 0.1, np.zeros(3), np.eye(3), np.zeros((0, 4)))
        for k, geometry in enumerate(geometries)
    )
    return Hand("toy", "Toy", "right", links, (), (), np.zeros(3), np.eye(3), np.zeros(0), {})


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
    distances = [g.signed_distance((points - p) @ R) for g, R, p in zip(geometries, R_WLs, p_WLs, strict=True)]
    expected = np.maximum(0.0, -np.min(distances, axis=0))
    assert hand_depths(hand, R_WLs, p_WLs, points) == pytest.approx(expected, abs=1e-12)
    assert penetration_depth(hand, R_WLs, p_WLs, points) == pytest.approx(expected.max())
    for geometry in geometries:
        center, radius = geometry.bounding_sphere()
        shell = center + 1.0001 * radius * contact_frames(rng.normal(size=(200, 3)))[..., 2]
        assert geometry.signed_distance(shell).min() > 0


def test_no_points_no_depth():
    hand = make_hand([Sphere(np.zeros(3), 0.1)])
    assert penetration_depth(hand, np.eye(3)[None], np.zeros((1, 3)), np.zeros((0, 3))) == 0.0
    with pytest.raises(ConfigError, match="points_W"):
        penetration_depth(hand, np.eye(3), np.zeros((1, 3)), np.zeros((0, 3)))
