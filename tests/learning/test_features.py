import dataclasses
import subprocess
import sys

import numpy as np
import pytest
import torch
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from xdex_drake.hand.description import Box, Capsule, Convex, Sphere
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.mirror import mirror
from xdex_drake.learning.batches import _joint_signs
from xdex_drake.learning.features import (
    hand_features,
    heading,
    link_frames,
    object_features,
    object_point,
    sample_shapes,
    shortest_path_distances,
)


def _random_rotations(rng, n):
    Q, _ = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    return Q * np.linalg.det(Q)[:, None, None]


def test_spd_of_a_tree():
    spd = shortest_path_distances(np.array([-1, 0, 1, 0, 3]))
    assert spd.tolist() == [[0, 1, 2, 1, 2], [1, 0, 1, 2, 3], [2, 1, 0, 3, 4], [1, 2, 3, 0, 1], [2, 3, 4, 1, 0]]


def test_hand_features(toy_hand):
    features = hand_features(toy_hand, points=32)
    # The last link of one finger and one in the middle have no geometry: the tip is a token all the same.
    tips = {finger.tip_link for finger in toy_hand.fingers}
    expected = [link.name for k, link in enumerate(toy_hand.links) if not k or link.geometry or link.name in tips]
    assert list(features.link_names) == expected
    L = len(expected)
    assert features.link_points.shape == (L, 32, 3)
    assert features.link_normals.shape == (L, 32, 3)
    assert features.spd.shape == (L, L)
    assert features.keypoint_names == ("wrist", "thumb", "index", "middle")
    # The wrist keypoint stands at the origin of H.
    np.testing.assert_allclose(features.centers[0] + features.keypoint_offsets[0], 0.0, atol=1e-12)
    assert features.digest == hand_features(toy_hand, points=32).digest
    assert features.digest != hand_features(toy_hand, points=32, seed=1).digest


def test_links_without_geometry_are_no_tokens_but_their_joints_count(hand_maker):
    hand = hand_maker(1, 4)  # the last link has no geometry but is a tip
    bare = dataclasses.replace(
        hand, links=tuple(dataclasses.replace(x, geometry=()) if x.name == "thumb_1" else x for x in hand.links)
    )
    features = hand_features(bare)
    assert features.link_names == ("palm", "thumb_0", "thumb_2", "thumb_3")
    assert features.spd.tolist() == [[0, 1, 3, 4], [1, 0, 2, 3], [3, 2, 0, 1], [4, 3, 1, 0]]
    k = hand.link_index["thumb_3"]
    R, p = forward_kinematics(hand, RigidTransform(), hand.q_rest)
    np.testing.assert_allclose(features.link_points[3], np.tile(p[k] + R[k] @ hand.fingers[0].p_LTip, (64, 1)))


def _reframed(hand, rng):
    """The same hand by another author: other link frames, joint origins slid along their axes, other zeros."""
    turns = {link.name: R for link, R in zip(hand.links, _random_rotations(rng, len(hand.links)), strict=True)}
    shifts = {joint.name: rng.uniform(-0.5, 0.5) for joint in hand.joints}
    X = {hand.links[0].name: (turns[hand.links[0].name], np.zeros(3))}  # X_LN, the new link frame in the old one
    joints = []
    for joint in hand.joints:
        R_PN, p_PN = X[joint.parent]
        shift, slide = shifts[joint.name], rng.uniform(-0.03, 0.03)
        axis_turn = RotationMatrix(AngleAxis(shift, joint.axis)).matrix()
        R_new, p_new = axis_turn @ turns[joint.child], slide * joint.axis
        X[joint.child] = (turns[joint.child], p_new)
        R_PJ = R_PN.T @ joint.R_PJ @ R_new
        p_PJ = R_PN.T @ (joint.p_PJ + joint.R_PJ @ p_new - p_PN)
        coupling = joint.coupling
        if coupling is not None:
            offset = coupling.offset + coupling.multiplier * shifts[coupling.master] - shift
            coupling = dataclasses.replace(coupling, offset=offset)
        joints.append(
            dataclasses.replace(
                joint,
                R_PJ=R_PJ,
                p_PJ=p_PJ,
                axis=turns[joint.child].T @ joint.axis,
                lower=joint.lower - shift,
                upper=joint.upper - shift,
                coupling=coupling,
            )
        )
    moved = {name: (R.T, -R.T @ p) for name, (R, p) in X.items()}  # X_NL
    links = tuple(
        dataclasses.replace(part, geometry=tuple(g.moved(*moved[part.name]) for g in part.geometry))
        for part in hand.links
    )
    fingers = tuple(
        dataclasses.replace(f, p_LTip=moved[f.tip_link][0] @ f.p_LTip + moved[f.tip_link][1]) for f in hand.fingers
    )
    base = hand.links[0].name
    shift = np.array([shifts[name] for name in hand.joint_names])
    new = dataclasses.replace(
        hand,
        links=links,
        joints=tuple(joints),
        fingers=fingers,
        R_HB=hand.R_HB @ turns[base],
        q_rest=hand.q_rest - shift,
    )
    return new, shift


@pytest.mark.parametrize("name", ["toy", "allegro", "ability"])
def test_how_a_file_puts_frames_origins_and_zeros_does_not_matter(hand_maker, name):
    hand = hand_maker(4, 4) if name == "toy" else load_hand(name)
    rng = np.random.default_rng(1)
    new, shift = _reframed(hand, rng)
    one, other = hand_features(hand), hand_features(new)
    for field in ("link_points", "link_normals", "centers", "joints", "keypoint_offsets"):
        np.testing.assert_allclose(getattr(other, field), getattr(one, field), atol=1e-6, err_msg=field)
    assert np.array_equal(one.spd, other.spd)
    # The targets, too: poses of the frames G in a grasp.
    q, X_WH = rng.uniform(*hand.limits), RigidTransform(RollPitchYaw(0.3, -1.0, 2.0), [0.1, 0.2, 0.3])
    R_WGs, p_WGs = link_frames(one, *forward_kinematics(hand, X_WH, q))
    R_2, p_2 = link_frames(other, *forward_kinematics(new, X_WH, q - shift))
    np.testing.assert_allclose(R_2, R_WGs, atol=1e-6)
    np.testing.assert_allclose(p_2, p_WGs, atol=1e-6)
    # At rest every G has the axes of H and stands at its link's center.
    R_HGs, p_HGs = link_frames(one, *forward_kinematics(hand, RigidTransform(), hand.q_rest))
    np.testing.assert_allclose(R_HGs, np.broadcast_to(np.eye(3), R_HGs.shape), atol=1e-12)
    np.testing.assert_allclose(p_HGs, one.centers, atol=1e-12)


def test_features_of_a_joint_do_not_know_its_sign(toy_hand):
    joint = toy_hand.joints[0]
    flipped = dataclasses.replace(joint, axis=-joint.axis, lower=-joint.upper, upper=-joint.lower)
    masters = [j for j in toy_hand.joints if j.coupling is None]
    sign = np.where([j.name == joint.name for j in masters], -1.0, 1.0)
    joints = tuple(
        dataclasses.replace(j, coupling=dataclasses.replace(j.coupling, multiplier=-j.coupling.multiplier))
        if j.coupling is not None and j.coupling.master == joint.name
        else j
        for j in (flipped, *toy_hand.joints[1:])
    )
    new = dataclasses.replace(toy_hand, joints=joints, q_rest=sign * toy_hand.q_rest)
    np.testing.assert_allclose(hand_features(new).joints, hand_features(toy_hand).joints, atol=1e-9)


def test_a_mirrored_hand_has_the_mirrored_features_of_joints(toy_hand):
    """Points are drawn anew on the mirror image; where joints are and how far they go is exactly mirrored."""
    one, other = hand_features(toy_hand).joints, hand_features(mirror(toy_hand)).joints
    signs = _joint_signs(torch.as_tensor(one)).numpy()
    np.testing.assert_allclose(other[:, :4], (one * signs)[:, :4], atol=1e-9)
    np.testing.assert_allclose(other[:, 7:], (one * signs)[:, 7:], atol=1e-9)


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
    points, normals = sample_shapes((geometry,), 64, np.random.default_rng(0), np.zeros(3))
    np.testing.assert_allclose(distance(points), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    np.testing.assert_allclose(distance(points + 1e-4 * normals), 1e-4, atol=1e-9)
    spread = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.eye(64)
    assert spread.min() > 1e-3  # farthest points do not clump


def test_object_features_are_centered_and_refuse_nonsense():
    points = np.random.default_rng(0).normal(2.0, 1.0, (50, 3))
    features = object_features(points, count=20, n_WPoints=2.0 * points)
    assert features.points.shape == (20, 3)
    np.testing.assert_allclose(features.normals, 2.0 * (features.points + features.p_WCenter))  # they go together
    assert np.all(object_features(points).normals == 0.0)
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
