"""Hands that follow a person's hand: what is recovered, what holds exactly, and what is refused."""

import numpy as np
import pytest

import xdex_drake as xd
from xdex_drake.errors import ConfigError
from xdex_drake.hand.variation import remove_finger
from xdex_drake.retargeting.clip import reach_grasp_lift
from xdex_drake.retargeting.hand_retargeter import HandRetargeter, hand_lengths
from xdex_drake.retargeting.keypoints import finger_length, in_wrist_frame
from xdex_drake.retargeting.objectives import OBJECTIVES

CLIP = reach_grasp_lift(seconds=1.5, frames_per_second=20)
WRISTS = (CLIP.R_WH, CLIP.p_WH)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_a_hand_recovers_its_own_key_points(objective):
    found = HandRetargeter(CLIP.hand, objective).batch(CLIP.points, X_WH=WRISTS)
    # A pinch is no target of the person's own: it draws tips together.
    plain = found.error[:12] if objective == "dexpilot" else found.error
    assert plain.max() < 1e-3


def test_with_middles_the_joints_are_recovered():
    found = HandRetargeter(CLIP.hand, "position", middles=True).batch(CLIP.points, X_WH=WRISTS)
    assert found.error.max() < 1e-3
    # A straight finger may bend a little either way; a closed one has one posture.
    assert np.abs(found.q - CLIP.qs)[22:].max() < 5e-3


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("name", ["ability", "allegro", "schunk_svh", "shadow", "g0-0007"])
def test_a_stream_stays_within_limits_and_does_not_jump(name, objective):
    hand = xd.load_hand(name)
    low, high = hand.limits
    found = list(HandRetargeter(hand, objective).calibrated(CLIP.points).follow(CLIP.points))
    q = np.array([item.q for item in found])
    assert (q >= low).all() and (q <= high).all()
    q_full = hand.q_full(q)
    for k, joint in enumerate(hand.joints):
        assert (q_full[:, k] >= joint.lower - 1e-9).all() and (q_full[:, k] <= joint.upper + 1e-9).all()
        if joint.coupling is not None:
            master = q[:, hand.joint_names.index(joint.coupling.master)]
            np.testing.assert_array_equal(q_full[:, k], joint.coupling.multiplier * master + joint.coupling.offset)
    np.testing.assert_allclose(found[-1].p_WH, CLIP.points[-1, 0])


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_a_batch_is_its_frames(objective):
    retargeter = HandRetargeter(xd.load_hand("allegro"), objective, scale=1.4)
    batch = retargeter.batch(CLIP.points)
    for k in (0, 13, len(CLIP.points) - 1):
        single = retargeter.frame(CLIP.points[k])
        np.testing.assert_allclose(single.q, batch.q[k], atol=1e-6)
        np.testing.assert_allclose(single.cost, batch.cost[k], rtol=1e-6)


@pytest.mark.parametrize("name", ["inspire", "shadow"])
def test_a_stream_is_no_worse_than_each_frame_by_itself(name):
    retargeter = HandRetargeter(xd.load_hand(name), "vector").calibrated(CLIP.points)
    stream = np.array([item.cost for item in retargeter.follow(CLIP.points)])
    assert stream.mean() < 1.02 * retargeter.batch(CLIP.points).cost.mean()


def test_a_left_hand_mirrors_a_right_one():
    left = reach_grasp_lift(seconds=1.5, frames_per_second=20, side="left")
    hand = xd.load_hand("shadow")
    right = HandRetargeter(hand).batch(CLIP.points)
    both_left = HandRetargeter(xd.mirror(hand)).batch(left.points)
    crossed = HandRetargeter(hand, side="left").batch(left.points)
    np.testing.assert_allclose(both_left.q, right.q, atol=1e-6)
    np.testing.assert_allclose(crossed.q, right.q, atol=1e-6)
    # The palms of the left hand and of the right robot hand at its wrist look the same way.
    np.testing.assert_allclose(crossed.R_WH, both_left.R_WH)


def test_the_frame_of_the_points_does_not_matter():
    retargeter = HandRetargeter(xd.load_hand("allegro"))
    R, p = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), np.array([3.0, 1.0, -2.0])
    a, b = retargeter.frame(CLIP.points[20]), retargeter.frame(CLIP.points[20] @ R.T + p)
    np.testing.assert_allclose(a.q, b.q, atol=1e-9)
    np.testing.assert_allclose(b.p_WH, R @ a.p_WH + p)


def test_calibration_is_the_ratio_of_lengths_in_any_posture():
    hand = CLIP.hand
    own = HandRetargeter(hand).calibrated(CLIP.points[20:23])
    np.testing.assert_allclose(own.scale, 1.0, rtol=1e-9)
    grown = HandRetargeter(hand).calibrated(1.25 * CLIP.points[:2])
    np.testing.assert_allclose(grown.scale, 0.8, rtol=1e-9)
    for name, length in hand_lengths(hand).items():
        np.testing.assert_allclose(finger_length(CLIP.points[0], name), length, rtol=1e-9)


def test_fingers_that_a_hand_lacks_are_told():
    assert HandRetargeter(xd.load_hand("allegro")).missing == ("little",)
    without = remove_finger(xd.load_hand("shadow"), "ring")
    retargeter = HandRetargeter(without, "dexpilot")
    assert retargeter.missing == ("ring",) and retargeter.unused == ()
    assert np.isfinite(retargeter.batch(CLIP.points).cost).all()


def test_smoothing_is_part_of_the_cost_and_slows_the_hand():
    hand = xd.load_hand("allegro")
    noisy = reach_grasp_lift(seconds=1.0, frames_per_second=30, noise_m=3e-3).points

    def travel(smoothing):
        q = np.array([item.q for item in HandRetargeter(hand, smoothing=smoothing).follow(noisy)])
        return np.abs(np.diff(q, axis=0)).sum()

    assert travel(4e-2) < 0.6 * travel(0.0)
    with pytest.raises(ConfigError, match="stream"):
        HandRetargeter(hand, smoothing=4e-3).batch(noisy)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"objective": "best"}, "position, vector, dexpilot"),
        ({"side": "both"}, "right or left"),
        ({"scale": float("nan")}, "scale"),
        ({"smoothing": -1.0}, "smoothing"),
        ({"objective": "dexpilot", "middles": True}, "dexpilot"),
    ],
)
def test_bad_arguments_are_told(arguments, told):
    with pytest.raises(ConfigError, match=told):
        HandRetargeter(xd.load_hand("allegro"), **arguments)


def test_bad_frames_leave_a_stream_as_it_was():
    stream = HandRetargeter(xd.load_hand("allegro")).stream()
    q = stream.follow(CLIP.points[0]).q
    for bad in (np.full((21, 3), np.nan), CLIP.points[:2], np.zeros((21, 3))):
        with pytest.raises(ConfigError):
            stream.follow(bad)
    np.testing.assert_array_equal(stream.q, q)
    with pytest.raises(ConfigError, match="X_WH"):
        stream.follow(CLIP.points[0], X_WH=(np.eye(3)[None], np.zeros(3)))
    with pytest.raises(ConfigError, match="q_start"):
        HandRetargeter(xd.load_hand("allegro")).stream(q_start=np.zeros(3))


def test_points_in_the_wrist_frame_mirror():
    p_H = in_wrist_frame(CLIP.points, *WRISTS)
    np.testing.assert_allclose(in_wrist_frame(CLIP.points, *WRISTS, mirrored=True), p_H * [1.0, -1.0, 1.0])
