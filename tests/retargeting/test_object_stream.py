"""Following beside an object: outside of it, without jumps, in contact while the person presses."""

import time

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.cli import main
from xdex_drake.grasping.finish import penetrations
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand
from xdex_drake.retargeting.clip import reach_grasp_lift
from xdex_drake.retargeting.hand_retargeter import HandRetargeter
from xdex_drake.retargeting.object_stream import STEP, follow_beside
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import Scene


def depth(hand, ball, X_WH, q, X_WO):
    return max(penetrations(hand, Configuration.at(hand, X_WH, q), Scene(ball, X_WO, "")))


@pytest.fixture(scope="module", params=["allegro", "shadow", "ability"])
def followed(request):
    """A hand, a ball where its fingers would meet, and the frames of a clip beside it."""
    hand, ball, clip = load_hand(request.param), load_object("ball", scale=0.7), reach_grasp_lift(noise_m=5e-4)
    retargeter = HandRetargeter(hand, "vector").calibrated(clip.points[:10])
    closed = retargeter.scaled_points(clip.points)[62]
    X_WO = RigidTransform(0.5 * (closed[4] + closed[[8, 12]].mean(axis=0)))
    begin = time.process_time()
    frames = list(follow_beside(retargeter, clip.points, ball, X_WO))
    return hand, ball, frames, (time.process_time() - begin) / len(frames)


def test_the_hand_stays_out_of_what_it_would_go_through(followed):
    hand, ball, frames, _ = followed
    plain, ours = [], []
    for frame in frames[45::4]:
        X_WH = RigidTransform(RotationMatrix.ProjectToRotationMatrix(frame.wanted.R_WH), frame.wanted.p_WH)
        plain.append(depth(hand, ball, X_WH, frame.wanted.q, frame.X_WO))
        ours.append(depth(hand, ball, frame.X_WH, frame.q, frame.X_WO))
    assert max(plain) > 4e-3 and max(ours) < 1e-3
    assert min(frame.clearance for frame in frames) > -1e-3


def test_no_joint_jumps_and_limits_hold(followed):
    hand, _, frames, seconds = followed
    q = np.array([frame.q for frame in frames])
    assert np.abs(np.diff(q, axis=0)).max() <= STEP + 1e-9
    assert (q >= hand.limits[0] - 1e-9).all() and (q <= hand.limits[1] + 1e-9).all()
    # 3 to 14 ms of a quiet core; five times as much says that something is wrong.
    assert seconds < 0.07
    assert max(np.linalg.norm(f.X_WH.translation() - f.wanted.p_WH) for f in frames) < 0.02


def test_far_from_the_object_nothing_is_changed(followed):
    _, _, frames, _ = followed
    for frame in frames[5:30]:
        np.testing.assert_allclose(frame.q, frame.wanted.q, atol=1e-9)
        np.testing.assert_allclose(frame.X_WH.translation(), frame.wanted.p_WH, atol=1e-12)


def test_contact_is_kept_and_the_object_goes_along(followed):
    hand, _, frames, _ = followed
    touching = [bool(frame.touching) for frame in frames]
    first = touching.index(True)
    assert all(touching[first : first + 12])
    if hand.name == "shadow":
        assert frames[-1].X_WO.translation()[2] - frames[0].X_WO.translation()[2] > 0.1
        assert "thdistal" in frames[-1].touching


def test_the_command_writes_where_the_object_is(tmp_path, capsys):
    clip = reach_grasp_lift(seconds=1.0)
    np.save(tmp_path / "points.npy", clip.points)
    place = [str(x) for x in clip.points[20, 8]]
    words = ["follow", "allegro", str(tmp_path / "points.npy"), "--out", str(tmp_path / "q.npz"), "--object", "ball"]
    assert main([*words, "--object-scale", "0.5", "--at", *place]) == 0
    assert "nearest link" in capsys.readouterr().out
    with np.load(tmp_path / "q.npz") as arrays:
        assert arrays["X_WO"].shape == (30, 4, 4) and arrays["clearance"].min() > -1e-3
    assert main([*words, "--at", "1", "2"]) == 2
    assert main(words) == 2
