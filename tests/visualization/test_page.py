"""Pages in a browser: they unfold, play, switch, name what the pointer is over, and raise nothing."""

import numpy as np
import pytest

from tests.browser import browser
from xdex_drake.hand.human import human_hand
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.visualization.hand_browser import browser_page
from xdex_drake.visualization.page import fold, unfold
from xdex_drake.visualization.replay import record_lift

READY = "document.querySelector('#xdex-card') && viewer.scene_tree.find(['drake']).object.children.length > 0"
VISIBLE = "viewer.scene_tree.find({path}).object.visible"


def test_folding_keeps_scripts_and_commands_in_order() -> None:
    command = 'fetch("data:application/octet-binary;base64,AAEC")\n    .then(res => res.arrayBuffer())\n'
    command += "    .then(buffer => viewer.handle_command_bytearray(new Uint8Array(buffer)));"
    page = f"<html><body><script>one();</script><p>x</p><script>two();\n{command}</script></body></html>"
    folded = fold(page)
    assert [part for part in unfold(folded) if part[1].strip()] == [
        ("script", b"one();"),
        ("script", b"two();\n"),
        ("command", b"\x00\x01\x02"),
    ]
    assert "<p>x</p>" in folded and folded.count("</body>") == 1 and "octet-binary" not in folded
    with pytest.raises(ValueError, match="not folded"):
        unfold(page)


@pytest.fixture(scope="module")
def replay(grasp, hand, scene):
    return record_lift(grasp, hand, scene)


def test_a_replay_plays_in_a_browser(replay, hand, tmp_path) -> None:
    file = tmp_path / "replay.html"
    file.write_text(replay.html)
    with browser() as page:
        page.resize(900, 700)
        page.open(file)
        page.wait_for(READY)
        page.wait_for("document.getElementById('xdex-player').style.display === 'flex'")
        page.wait_for("viewer.animator.playing && viewer.animator.actions[0].time > 0.1")
        page.eval("document.getElementById('xdex-play').click()")
        assert not page.eval("viewer.animator.playing")
        page.eval(
            "(() => { const t = document.getElementById('xdex-time'); t.value = 0.5; "
            "t.dispatchEvent(new Event('input')); t.dispatchEvent(new Event('change')); })()"
        )
        assert page.eval("viewer.animator.actions[0].time") == pytest.approx(0.5, abs=0.01)
        page.eval(
            "(() => { const s = document.getElementById('xdex-speed'); s.value = '0.25'; "
            "s.dispatchEvent(new Event('change')); })()"
        )
        assert page.eval("viewer.animator.mixer.timeScale") == 0.25
        # Collision shapes are hidden until they are asked for.
        touch = VISIBLE.format(path=["drake", "scene", hand.name, hand.links[0].name, "touch"])
        page.wait_for(f"!({touch}) || 'hidden'")
        page.eval("document.querySelector('#xdex-card [data-switch]').click()")
        assert page.eval(touch)
        # The bar of Meshcat is gone.
        assert page.eval("getComputedStyle(document.querySelector('.dg.main')).display") == "none"
        assert not page.errors
        names = page.eval(
            "(() => { const out = []; for (let x = 20; x < innerWidth; x += 25) for (let y = 20; y < innerHeight; "
            "y += 25) { document.getElementById('meshcat-pane').dispatchEvent(new PointerEvent('pointermove', "
            "{clientX: x, clientY: y})); } return out; })()"
        )
        assert names == []
        assert len(page.screenshot()) > 20_000


def test_a_page_of_many_hands_is_light() -> None:
    hands = [*(load_hand(name) for name in list_hands()), human_hand()]
    page = browser_page(hands)
    base = len(browser_page(hands[:1]))
    # Thirty hands stay below 3 MB.
    each = (len(page) - base) / 5
    assert np.isfinite(each) and base + 29 * each < 3_000_000
