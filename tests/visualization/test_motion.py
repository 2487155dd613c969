"""Pages that play a motion: every frame is there, where kinematics put it."""

from typing import Any

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

import xdex_drake as xd
from tests.visualization.test_replay import animation_of
from xdex_drake.errors import ConfigError
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.visualization.motion import MOST_FRAMES, motion_page
from xdex_drake.visualization.stage import PAUSE_FRAMES


def _position(animation, path, time):
    entry = next(entry for entry in animation["animations"] if entry["path"] == path)
    track = next(track for track in entry["clip"]["tracks"] if "position" in track["name"])
    return next(key["value"] for key in track["keys"] if key["time"] == time)


def test_a_page_holds_the_motion():
    clip = xd.reach_grasp_lift(seconds=0.3)
    hand = xd.load_hand("ability")
    found = list(xd.HandRetargeter(hand).follow(clip.points))
    qs, R, p = (np.array([getattr(item, name) for item in found]) for name in ("q", "R_WH", "p_WH"))
    page = motion_page(hand, qs, R, p, points=clip.points, title="<i>", rows=[("frames", "9")])
    assert "&lt;i&gt;" in page and "<dd>9</dd>" in page and page.count("</body>") == 1
    animation: Any = animation_of(page)
    for t in (0, 4, len(qs) - 1):
        k = Configuration.at(hand, RigidTransform(RotationMatrix.ProjectToRotationMatrix(R[t]), p[t]), qs[t])
        tip = hand.link_index["index_L2"]
        np.testing.assert_allclose(_position(animation, f"/drake/hand/{tip}", t), k.p_WLs[tip], atol=1e-6)
        np.testing.assert_allclose(_position(animation, "/drake/points/8", t), clip.points[t, 8], atol=1e-6)
    ends = {max(key["time"] for key in t["keys"]) for e in animation["animations"] for t in e["clip"]["tracks"]}
    assert ends == {len(qs) - 1 + PAUSE_FRAMES}


def test_too_long_a_motion_is_refused():
    hand = xd.load_hand("ability")
    qs = np.tile(hand.q_rest, (MOST_FRAMES + 1, 1))
    for count in (0, MOST_FRAMES + 1):
        with pytest.raises(ConfigError, match="frames"):
            motion_page(hand, qs[:count], np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))
