"""Configurations for dex-retargeting: links of the written URDF, in the frame that the tool compares in."""

import numpy as np
import pytest
import yaml
import yourdfpy
from pydrake.math import RigidTransform

from xdex_drake.cli import main
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.variation import remove_finger
from xdex_drake.retargeting.dex_retargeting import export_dex_retargeting


@pytest.mark.parametrize("name", ["allegro", "ability"])
def test_configurations_name_links_where_the_hand_has_them(name, tmp_path):
    hand = load_hand(name)
    files = export_dex_retargeting(hand, tmp_path)
    assert [file.stem.split("_")[-1] for file in files] == ["position", "vector", "dexpilot"]
    told = [yaml.safe_load(file.read_text())["retargeting"] for file in files]
    robot = yourdfpy.URDF.load(str(tmp_path / told[0]["urdf_path"]), load_meshes=False)
    assert robot.base_link == "wrist"
    robot.update_cfg(dict(zip(hand.joint_names, hand.q_rest, strict=True)))
    R, p = forward_kinematics(hand, RigidTransform(), hand.q_rest)
    for finger, link in zip(hand.fingers, told[0]["target_link_names"], strict=True):
        k = hand.link_index[finger.tip_link]
        tip = robot.get_transform(link, "wrist")[:3, 3]
        np.testing.assert_allclose(tip, p[k] + R[k] @ finger.p_LTip, atol=1e-9)
    for content in told:
        assert content["target_joint_names"] == list(hand.joint_names)
    tips = [4, 8, 12, 16, 20][: len(hand.fingers)]
    assert told[0]["target_link_human_indices"] == tips
    assert told[1]["target_link_human_indices"] == [[0] * len(tips), tips]
    # What a human hand's size is to Allegro's, the tool's own file has as 1.6.
    assert 0.7 < told[1]["scaling_factor"] < 1.8 and told[2]["wrist_link_name"] == "wrist"
    assert "target_link_human_indices" not in told[2]


def test_fingers_that_are_not_the_first_ones_are_told(tmp_path):
    hand = remove_finger(load_hand("allegro"), "index")
    told = yaml.safe_load(export_dex_retargeting(hand, tmp_path)[2].read_text())["retargeting"]
    origins, tasks = told["target_link_human_indices"]
    assert origins == [12, 16, 16, 0, 0, 0] and tasks == [4, 4, 12, 4, 12, 16]


def test_by_the_command_line(tmp_path, capsys):
    words = ["hand", "export", "inspire", "--format", "dex_retargeting", "--out", str(tmp_path / "dr")]
    assert main(words) == 0
    assert "inspire_vector.yml" in capsys.readouterr().out and (tmp_path / "dr/inspire.urdf").exists()
