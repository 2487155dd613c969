"""Key points of a person's hand: frames, lengths, files, and what is refused."""

import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from xdex_drake.errors import ConfigError
from xdex_drake.retargeting.clip import reach_grasp_lift
from xdex_drake.retargeting.keypoints import (
    FINGERS,
    check_points,
    finger_length,
    in_wrist_frame,
    read_points,
    wrist_frames,
)

CLIP = reach_grasp_lift(seconds=0.5, frames_per_second=20)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_wrist_frame_has_its_axes_where_a_person_has_them(side):
    clip = reach_grasp_lift(seconds=0.5, frames_per_second=20, side=side)
    R, p = wrist_frames(clip.points, side)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    p_H = in_wrist_frame(clip.points, R, p)
    # The middle knuckle lies on z; fingers close out of the palm; the thumb is on its side.
    np.testing.assert_allclose(p_H[:, 9, :2], 0.0, atol=1e-12)
    assert p_H[-1, 12, 0] - p_H[0, 12, 0] > 0.03
    assert (p_H[:, 4, 1] * (1.0 if side == "right" else -1.0) > 0.0).all()
    # The hand's own frame differs by how deep its knuckles lie in the palm, in every frame alike.
    own = np.swapaxes(R, 1, 2) @ clip.R_WH
    np.testing.assert_allclose(own, own[:1].repeat(len(own), 0), atol=1e-12)


def test_frames_move_with_the_points():
    R_VW, p_VW = Rotation.random(rng=np.random.default_rng(0)).as_matrix(), np.array([1.0, -2.0, 0.5])
    R, p = wrist_frames(CLIP.points, "right")
    R_moved, p_moved = wrist_frames(CLIP.points @ R_VW.T + p_VW, "right")
    np.testing.assert_allclose(R_moved, R_VW @ R, atol=1e-12)
    np.testing.assert_allclose(p_moved, p @ R_VW.T + p_VW, atol=1e-12)


@pytest.mark.parametrize("finger", FINGERS)
def test_no_posture_changes_a_finger_length(finger):
    lengths = finger_length(CLIP.points, finger)
    np.testing.assert_allclose(lengths, lengths[0], rtol=1e-12)


def test_a_palm_on_a_line_is_refused():
    points = CLIP.points[0].copy()
    points[5] = 0.5 * (points[0] + points[9])
    with pytest.raises(ConfigError, match="on a line"):
        wrist_frames(points, "right")


@pytest.mark.parametrize(
    ("points", "told"),
    [
        (np.zeros((3, 20, 3)), "shape"),
        (np.zeros((0, 21, 3)), "shape"),
        (np.full((2, 21, 3), "a"), "numbers"),
        (np.where(np.arange(63).reshape(21, 3) == 7, np.nan, CLIP.points[0]), "frame 0 .*not finite"),
        (1000.0 * CLIP.points, "metres"),
        (np.zeros((21, 3)), "metres"),
    ],
)
def test_what_is_no_hand_is_told_in_one_line(points, told):
    with pytest.raises(ConfigError, match=told) as caught:
        check_points(points)
    assert "\n" not in str(caught.value)


def test_files_are_read_and_pickles_are_not(tmp_path):
    np.save(tmp_path / "clip.npy", CLIP.points.astype(np.float32))
    np.testing.assert_allclose(read_points(tmp_path / "clip.npy"), CLIP.points, atol=1e-6)
    np.save(tmp_path / "one.npy", CLIP.points[0])
    assert read_points(tmp_path / "one.npy").shape == (1, 21, 3)
    ran = []

    class Bomb:
        def __reduce__(self):
            return (ran.append, (1,))

    np.save(tmp_path / "bomb.npy", np.array([Bomb()], dtype=object), allow_pickle=True)
    (tmp_path / "plain.npy").write_bytes(pickle.dumps([1, 2]))
    (tmp_path / "empty.npy").write_bytes(b"")
    (tmp_path / "cut.npy").write_bytes((tmp_path / "clip.npy").read_bytes()[:200])
    (tmp_path / "huge.npy").write_bytes(_header("(1000000000, 21, 3)"))
    np.save(tmp_path / "deep.npy", np.zeros((2, 2, 21, 3)) + CLIP.points[0])
    for name in ("bomb", "plain", "empty", "cut", "huge", "deep", "missing"):
        with pytest.raises(ConfigError, match=f"{name}.npy") as caught:
            read_points(tmp_path / f"{name}.npy")
        assert "\n" not in str(caught.value)
    assert not ran


def _header(shape: str) -> bytes:
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text
