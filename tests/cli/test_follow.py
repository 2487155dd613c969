"""`xdex follow`: joint values and a page from key points, and what is refused in one line."""

import numpy as np
import pytest

import xdex_drake as xd
from tests.cli.test_command_line import refusal
from xdex_drake.cli import main


@pytest.fixture(scope="module")
def points(tmp_path_factory):
    path = tmp_path_factory.mktemp("points") / "clip.npy"
    np.save(path, xd.reach_grasp_lift(seconds=0.4).points)
    return path


def test_joints_are_written_with_their_names(points, tmp_path, capsys):
    out, page = tmp_path / "new" / "joints.npz", tmp_path / "page.html"
    assert main(["follow", "inspire", str(points), "--out", str(out), "--html", str(page)]) == 0
    said = capsys.readouterr().out
    assert "frames" in said and "12" in said and "none" in said
    hand = xd.load_hand("inspire")
    with np.load(out, allow_pickle=False) as file:
        assert tuple(file["joint_names"]) == hand.joint_names
        assert file["q"].shape == (12, len(hand.joint_names))
        np.testing.assert_array_equal(file["q_full"], hand.q_full(file["q"]))
        assert [*file["all_joint_names"]] == [joint.name for joint in hand.joints]
        np.testing.assert_allclose(file["X_WH"][:, :3, 3], np.load(points)[:, 0])
        followed = list(xd.HandRetargeter(hand, scale=float(file["scale"])).follow(np.load(points)))
        np.testing.assert_allclose(file["q"], [item.q for item in followed], atol=1e-9)
    assert page.stat().st_size > 1e6


def test_a_lacking_finger_is_told(points, tmp_path, capsys):
    assert main(["follow", "allegro", str(points), "--out", str(tmp_path / "a.npz"), "--scale", "1.4"]) == 0
    assert "little" in capsys.readouterr().out


def test_refusals(points, tmp_path, capsys):
    pickled = tmp_path / "pickled.npy"
    np.save(pickled, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    out = ["--out", tmp_path / "no.npz"]
    assert "pickled.npy" in refusal(capsys, "follow", "allegro", pickled, *out)
    assert "missing.npy" in refusal(capsys, "follow", "allegro", tmp_path / "missing.npy", *out)
    assert ".npz" in refusal(capsys, "follow", "allegro", points, "--out", tmp_path / "no.csv")
    assert "rate" in refusal(capsys, "follow", "allegro", points, *out, "--rate", "0")
    assert "scale" in refusal(capsys, "follow", "allegro", points, *out, "--scale", "-1")
    assert "dexpilot" in refusal(capsys, "follow", "allegro", points, *out, "--objective", "dexpilot", "--middles")
    assert not list(tmp_path.glob("no.*"))
