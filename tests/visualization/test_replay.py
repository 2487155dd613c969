import base64
import os
import re
import sys
from dataclasses import replace

import pytest

from xdex_drake.errors import ConfigError
from xdex_drake.simulation.lift import lift_rig, simulate_lift
from xdex_drake.visualization.replay import grasp_page, record_lift, replay_lift, view_live


def commands(page):
    """Messages that a static page of Meshcat replays, as bytes."""
    return [base64.b64decode(text) for text in re.findall(r'base64,([A-Za-z0-9+/=]+)"\)', page)]


def animation_of(page):
    found = [command for command in commands(page) if b"set_animation" in command[:60]]
    assert len(found) == 1
    return found[0]


@pytest.fixture(scope="module")
def replay(grasp, hand, scene):
    return record_lift(replace(grasp, grasp_id="<b>x</b>&amp;"), hand, scene)


def test_replay_shows_what_the_lift_shows(replay, grasp, hand, scene):
    lift = simulate_lift(lift_rig(hand, scene), grasp)
    assert (replay.lift.success, replay.lift.failure_reason) == (lift.success, lift.failure_reason)
    assert not lift.success
    assert replay.lift.lift_height_m == pytest.approx(lift.lift_height_m, abs=1e-9)
    assert lift.failure_reason.replace("_", " ") in replay.html
    assert "Wonik Allegro" in replay.html
    assert "not lifted" in replay.html


def test_replay_holds_every_frame(replay, hand):
    # The lift is given up once the object stays behind, well after closing and squeezing.
    assert 30 <= replay.frames <= 60
    animation = animation_of(replay.html)
    for link in hand.links:
        assert link.name.encode() in animation
    # Positions and quaternions of each link, at each frame.
    assert animation.count(b"\xa4time") >= 2 * replay.frames * len(hand.links)
    assert 1e6 < len(replay.html) < 6e6


def test_page_needs_nothing_else(replay):
    head = re.sub(r"<script.*?</script>", "", replay.html, flags=re.S)
    assert not re.search(r"(src|href)\s*=\s*[\"']?http", head)
    assert replay.html.count("</body>") == 1
    assert "<b>x</b>" not in replay.html
    assert "&lt;b&gt;x&lt;/b&gt;&amp;amp;" in replay.html


def test_camera_is_set(replay):
    assert any(b"/Cameras/default/rotated/<object>" in c and b"position" in c for c in commands(replay.html))


def test_lift_that_fails_before_it_starts_is_shown(grasp, hand, scene):
    # The hand in the table.
    down = grasp.X_WH.translation() - [0.0, 0.0, 0.2]
    sunk = type(grasp.X_WH)(grasp.X_WH.rotation(), down)
    replay = record_lift(replace(grasp, X_WH=sunk, X_WH_pregrasp=sunk), hand, scene)
    assert replay.lift.failure_reason == "table_collision"
    assert replay.frames == 1
    assert b"link_0" in animation_of(replay.html)


@pytest.mark.skipif(sys.platform != "linux", reason="counts threads by /proc")
def test_pages_leave_no_server_behind(grasp, hand, scene):
    replay_lift(grasp, hand, scene)
    grasp_page([grasp], [hand], [scene])
    threads = len(os.listdir("/proc/self/task"))
    for _ in range(2):
        replay_lift(grasp, hand, scene)
        grasp_page([grasp], [hand], [scene])
    assert len(os.listdir("/proc/self/task")) == threads


def test_still_page_holds_hands_contacts_and_one_table(grasp, hand, scene):
    page = grasp_page([grasp, grasp], [hand, hand], [scene, scene], title="A & B")
    text = b"\n".join(commands(page))
    for k in range(2):
        assert f"/drake/grasp_{k}/allegro/{hand.fingers[0].tip_link}".encode() in text
        assert f"/drake/grasp_{k}/certificate/cones/1".encode() in text
        assert f"/drake/grasp_{k}/certificate/forces/1/shaft".encode() in text
    assert text.count(b"set_object") and b"/drake/grasp_1/table" not in text
    assert "<title>A &amp; B</title>" in page


def test_live_view_listens_on_this_computer_only(grasp, hand, scene):
    meshcat = view_live([replace(grasp, certificate=None)], [hand], [scene])
    assert meshcat.web_url() == f"http://localhost:{meshcat.port()}"
    assert meshcat.HasPath("/drake/grasp_0/table")


def test_bad_input_is_told(grasp, hand, scene):
    with pytest.raises(ConfigError, match="as many of each"):
        grasp_page([grasp], [hand, hand], [scene])
    with pytest.raises(ConfigError, match="as many of each"):
        grasp_page([], [], [])
    with pytest.raises(ConfigError, match="no pre-grasp or squeeze"):
        replay_lift(replace(grasp, q_squeeze=None), hand, scene)
    with pytest.raises(ConfigError, match="no grasp"):
        view_live([], [], [], replay=True)
