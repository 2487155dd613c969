import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from pydrake.math import RigidTransform

from xdex_drake.hand.description import Box, Capsule, Convex, Link, Sphere
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.learning.features import (
    hand_features,
    heading,
    link_pose_vectors,
    link_poses_from_vectors,
    object_features,
    object_point,
    sample_link,
    shortest_path_distances,
)


def _random_rotations(rng, n):
    Q, _ = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    return Q * np.linalg.det(Q)[:, None, None]


def test_spd_of_a_tree():
    spd = shortest_path_distances(np.array([-1, 0, 1, 0, 3]))
    assert spd.tolist() == [[0, 1, 2, 1, 2], [1, 0, 1, 2, 3], [2, 1, 0, 3, 4], [1, 2, 3, 0, 1], [2, 3, 4, 1, 0]]


def test_pose_vectors_round_trip():
    rng = np.random.default_rng(0)
    R, R0, p = _random_rotations(rng, 6), _random_rotations(rng, 6), rng.normal(size=(6, 3))
    vectors = link_pose_vectors(R, p, R0)
    assert vectors.shape == (6, 9)
    np.testing.assert_allclose(vectors[:, :3], p)
    vectors[:, 3:6] *= 1.7  # Gram-Schmidt takes out scale and skew
    vectors[:, 6:] += 0.3 * vectors[:, 3:6]
    R_back, p_back = link_poses_from_vectors(vectors, R0)
    np.testing.assert_allclose(R_back, R, atol=1e-12)
    np.testing.assert_allclose(p_back, p, atol=1e-12)


def test_choice_of_link_axes_drops_out(toy_hand):
    # Turn the axes of a link: its pose vector must not notice.
    rng = np.random.default_rng(1)
    R_WH = _random_rotations(rng, 1)[0]
    R_HLs, p_HLs = forward_kinematics(toy_hand, RigidTransform(), np.full(len(toy_hand.joint_names), 0.7))
    R_HLs_zero = hand_features(toy_hand).R_HLs_zero
    turn = _random_rotations(rng, len(R_HLs))
    one = link_pose_vectors(R_WH @ R_HLs, p_HLs @ R_WH.T, R_HLs_zero)
    other = link_pose_vectors(R_WH @ R_HLs @ turn, p_HLs @ R_WH.T, R_HLs_zero @ turn)
    np.testing.assert_allclose(one, other, atol=1e-12)


def test_hand_features(toy_hand):
    features = hand_features(toy_hand, points=32)
    L = len(toy_hand.links)
    assert features.link_points.shape == (L, 32, 3)
    assert features.spd.shape == (L, L)
    assert features.keypoint_names == ("wrist", "thumb", "index", "middle")
    # The wrist keypoint stands at the origin of H.
    np.testing.assert_allclose(features.p_HLs_zero[0] + features.keypoint_offsets[0], 0.0, atol=1e-12)
    assert features.digest == hand_features(toy_hand, points=32).digest
    assert features.digest != hand_features(toy_hand, points=32, seed=1).digest
    # The coupled joint stands at its offset in the zero configuration, not at zero.
    k = toy_hand.link_index["thumb_1"]
    R_PL = features.R_HLs_zero[toy_hand.parents[k]].T @ features.R_HLs_zero[k]
    assert np.arccos((np.trace(R_PL) - 1.0) / 2.0) == pytest.approx(0.1)


def test_link_without_geometry_has_its_origin():
    link = Link("hub", (), 0.01, np.zeros(3), np.eye(3), np.zeros((0, 4)))
    assert np.all(sample_link(link, 5, np.random.default_rng(0)) == 0.0)


@pytest.mark.parametrize(
    ("geometry", "distance"),
    [
        (Sphere(np.array([0.1, 0.0, 0.0]), 0.02), lambda p: np.linalg.norm(p - [0.1, 0.0, 0.0], axis=1) - 0.02),
        (
            Capsule(np.zeros(3), np.array([0.0, 0.0, 0.05]), 0.01),
            lambda p: np.linalg.norm(p - np.clip(p[:, 2:], 0.0, 0.05) * [0.0, 0.0, 1.0], axis=1) - 0.01,
        ),
        (
            Box(np.array([0.02, 0.04, 0.06]), np.array([0.1, 0.0, 0.0])),
            lambda p: np.max(np.abs(p - [0.1, 0.0, 0.0]) - [0.01, 0.02, 0.03], axis=1),
        ),
        (
            Convex(0.01 * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T),
            lambda p: np.max(np.abs(p), axis=1) - 0.01,
        ),
    ],
)
def test_samples_lie_on_the_surface(geometry, distance):
    link = Link("link", (geometry,), 0.01, np.zeros(3), np.eye(3), np.zeros((0, 4)))
    points = sample_link(link, 64, np.random.default_rng(0))
    np.testing.assert_allclose(distance(points), 0.0, atol=1e-9)
    spread = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.eye(64)
    assert spread.min() > 1e-3  # farthest points do not clump


def test_object_features_are_centered_and_refuse_nonsense():
    points = np.random.default_rng(0).normal(2.0, 1.0, (50, 3))
    features = object_features(points, count=20)
    assert features.points.shape == (20, 3)
    np.testing.assert_allclose(features.p_WCenter, points.mean(axis=0))
    for bad in (np.zeros((0, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan)):
        with pytest.raises(ValueError, match="object points"):
            object_features(bad)


def test_object_point_lies_ahead_of_the_palm(toy_hand):
    R_HLs, p_HLs = forward_kinematics(toy_hand, RigidTransform(), np.full(len(toy_hand.joint_names), 0.5))
    rng = np.random.default_rng(0)
    sphere = rng.normal(size=(4000, 3))
    sphere = 0.03 * sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    # Put the ball on the heading itself: the nearest point of the ball is the answer.
    palm, direction = heading(toy_hand, R_HLs, p_HLs)
    ball = sphere + palm + 0.1 * direction
    chosen = ball[object_point(toy_hand, R_HLs, p_HLs, ball)]
    np.testing.assert_allclose(chosen, palm + 0.07 * direction, atol=3e-3)
    # The rule moves with hand and object.
    R = _random_rotations(rng, 1)[0]
    moved = object_point(toy_hand, R @ R_HLs, p_HLs @ R.T + 0.3, ball @ R.T + 0.3)
    assert moved == object_point(toy_hand, R_HLs, p_HLs, ball)
    # Nothing ahead: still an answer.
    behind = sphere + palm - 0.1 * direction
    assert 0 <= object_point(toy_hand, R_HLs, p_HLs, behind) < len(behind)


def test_object_point_of_a_hand_without_thumb(toy_hand):
    hand = dataclasses.replace(toy_hand, fingers=toy_hand.fingers[1:])
    R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), hand.q_rest)
    assert 0 <= object_point(hand, R_HLs, p_HLs, np.random.default_rng(0).normal(size=(10, 3))) < 10


def test_features_do_not_import_torch():
    code = "import sys, xdex_drake, xdex_drake.learning.features; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
