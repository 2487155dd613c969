"""The link pose vector goes both ways, and a vendor's choice of link axes drops out of it."""

import subprocess
import sys

import numpy as np
from pydrake.math import RigidTransform
from scipy.spatial.transform import Rotation

from xdex_drake.hand.kinematics import forward_kinematics, zero_configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.link_pose import link_pose_vectors, link_poses_from_vectors, rotations_since_zero


def rotations(rng, count):
    return Rotation.random(count, random_state=rng).as_matrix()


def test_there_and_back():
    rng = np.random.default_rng(0)
    R, R0, p = rotations(rng, 6), rotations(rng, 6), rng.normal(size=(6, 3))
    vectors = link_pose_vectors(R, p, R0)
    assert vectors.shape == (6, 9)
    np.testing.assert_allclose(vectors[:, :3], p)
    vectors[:, 3:6] *= 1.7  # Gram-Schmidt takes out scale and skew
    vectors[:, 6:] += 0.3 * vectors[:, 3:6]
    R_back, p_back = link_poses_from_vectors(vectors, R0)
    np.testing.assert_allclose(R_back, R, atol=1e-12)
    np.testing.assert_allclose(p_back, p, atol=1e-12)


def test_choice_of_link_axes_drops_out():
    # Turn the axes of each link: its pose vector must not notice.
    hand, rng = load_hand("ability"), np.random.default_rng(1)
    R_WH = rotations(rng, 1)[0]
    R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), hand.q_rest)
    R_HLs_zero, _ = zero_configuration(hand)
    turn = rotations(rng, len(R_HLs))
    one = link_pose_vectors(R_WH @ R_HLs, p_HLs @ R_WH.T, R_HLs_zero)
    other = link_pose_vectors(R_WH @ R_HLs @ turn, p_HLs @ R_WH.T, R_HLs_zero @ turn)
    np.testing.assert_allclose(one, other, atol=1e-12)


def test_at_zero_all_links_have_turned_as_the_wrist_has():
    hand, R_WH = load_hand("allegro"), rotations(np.random.default_rng(2), 1)[0]
    R_HLs_zero, _ = zero_configuration(hand)
    turned = rotations_since_zero(R_WH @ R_HLs_zero, R_HLs_zero)
    np.testing.assert_allclose(turned, np.broadcast_to(R_WH, turned.shape), atol=1e-12)


def test_link_poses_need_numpy_alone():
    code = (
        "import sys, xdex_drake.hand.link_pose; print([m for m in ('pydrake', 'torch', 'scipy') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
