import os
import re
import struct
import sys
from dataclasses import replace

import pytest

from xdex_drake.errors import ConfigError
from xdex_drake.simulation.drake import lift_rig, simulate_lift
from xdex_drake.visualization.page import unfold
from xdex_drake.visualization.replay import grasp_page, record_lift, replay_lift, view_live
from xdex_drake.visualization.stage import PAUSE_FRAMES


def commands(page):
    """Messages that a static page of Meshcat replays, as bytes."""
    return [data for kind, data in unfold(page) if kind == "command"]


def unpack(data, at=0):
    """The value that starts at a place of MessagePack data, and the place after it."""
    byte = data[at]
    if byte <= 0x7F:
        return byte, at + 1
    if byte >= 0xE0:
        return byte - 256, at + 1
    if byte in (0xC0, 0xC2, 0xC3):
        return {0xC0: None, 0xC2: False, 0xC3: True}[byte], at + 1
    numbers = {0xCA: ">f", 0xCB: ">d", 0xCC: ">B", 0xCD: ">H", 0xCE: ">I", 0xCF: ">Q"}
    numbers |= {0xD0: ">b", 0xD1: ">h", 0xD2: ">i", 0xD3: ">q"}
    if byte in numbers:
        return struct.unpack_from(numbers[byte], data, at + 1)[0], at + 1 + struct.calcsize(numbers[byte])
    lengths = {0xD9: ">B", 0xDA: ">H", 0xDC: ">H", 0xDD: ">I", 0xDE: ">H", 0xDF: ">I"}
    if byte in lengths:
        n, start = struct.unpack_from(lengths[byte], data, at + 1)[0], at + 1 + struct.calcsize(lengths[byte])
        kind = "text" if byte < 0xDC else "list" if byte < 0xDE else "map"
    else:
        n, start = byte & (0x1F if byte >= 0xA0 else 0x0F), at + 1
        kind = "text" if byte >= 0xA0 else "list" if byte >= 0x90 else "map"
    if kind == "text":
        return data[start : start + n].decode(), start + n
    items = []
    for _ in range(n * (2 if kind == "map" else 1)):
        item, start = unpack(data, start)
        items.append(item)
    return (dict(zip(items[::2], items[1::2], strict=True)) if kind == "map" else items), start


def animation_of(page):
    found = [command for command in commands(page) if b"set_animation" in command[:60]]
    assert len(found) == 1
    return unpack(found[0])[0]


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
    paths = [entry["path"] for entry in animation["animations"]]
    assert len(set(paths)) == len(paths)  # two tracks of one body would show the mean of both
    for link in hand.links:
        assert f"/drake/scene/allegro/{link.name}" in paths
    for entry in animation["animations"]:
        for track in entry["clip"]["tracks"]:
            times = [key["time"] for key in track["keys"]]
            assert times == sorted(times)
            # All end together, after the pause: otherwise the loop falls out of step.
            if "drake/scene" in entry["path"]:
                assert times[0] == 0
                assert times == [*range(replay.frames), replay.frames - 1 + PAUSE_FRAMES]
            assert entry["clip"]["tracks"] and max(times) <= replay.frames - 1 + PAUSE_FRAMES
        assert max(k["time"] for t in entry["clip"]["tracks"] for k in t["keys"]) == replay.frames - 1 + PAUSE_FRAMES
    assert animation["options"]["play"]
    assert animation["options"]["repetitions"] > 100
    assert 5e5 < len(replay.html) < 3e6


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
    assert f"/drake/scene/allegro/{hand.links[-1].name}" in [
        entry["path"] for entry in animation_of(replay.html)["animations"]
    ]


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
    assert b"/drake/grasp_0/table" not in text
    assert b"/drake/grasp_1/table" not in text
    assert b"/drake/table" in text
    assert "<title>A &amp; B</title>" in page


def test_live_view_listens_on_this_computer_only(grasp, hand, scene):
    meshcat = view_live([replace(grasp, certificate=None)], [hand], [scene])
    assert meshcat.web_url() == f"http://localhost:{meshcat.port()}"
    assert meshcat.HasPath("/drake/table")


def test_bad_input_is_told(grasp, hand, scene):
    with pytest.raises(ConfigError, match="as many of each"):
        grasp_page([grasp], [hand, hand], [scene])
    with pytest.raises(ConfigError, match="as many of each"):
        grasp_page([], [], [])
    with pytest.raises(ConfigError, match="no pre-grasp or squeeze"):
        replay_lift(replace(grasp, tau_squeeze=None), hand, scene)
    with pytest.raises(ConfigError, match="no grasp"):
        view_live([], [], [], replay=True)
