"""Figures and pages of many hands."""

import dataclasses
import json
import re

import numpy as np
import pytest

from xdex_drake.errors import ConfigError
from xdex_drake.hand.library import list_hands, load_hand
from xdex_drake.jobs.hands import hand_row
from xdex_drake.visualization.hand_browser import browser_page
from xdex_drake.visualization.hand_sets import hands_sheet, statistics_figure
from xdex_drake.visualization.page import unfold
from xdex_drake.visualization.pictures import can_render


def test_statistics_show_both_kinds_of_hands() -> None:
    rows = [hand_row(load_hand(name)) for name in list_hands()]
    rows.append(dataclasses.replace(rows[0], base="human", size_m=0.19))
    image = statistics_figure(rows)
    assert image.shape == (804, 1040, 3)
    colors = {tuple(color) for color in image.reshape(-1, 3)[::3].tolist()}
    assert {(76, 128, 189), (222, 140, 72)} <= colors
    assert statistics_figure(rows[:1]).shape == image.shape
    with pytest.raises(ConfigError, match="no hand"):
        statistics_figure([])


@pytest.mark.skipif(not can_render(), reason="this machine cannot render")
def test_a_sheet_has_a_picture_of_each_hand() -> None:
    sheet = hands_sheet([load_hand("ability"), load_hand("inspire")], columns=2, size=(96, 96))
    assert sheet.shape == (96 + 16, 192, 3)
    for k in range(2):
        assert np.ptp(sheet[:96, 96 * k : 96 * (k + 1)].astype(int)) > 100


def test_a_page_holds_every_joint() -> None:
    hands = [load_hand("inspire"), load_hand("ability")]
    hands[1] = dataclasses.replace(hands[1], display_name="</script><b>Ability</b>")
    page = browser_page(hands, title="<Two> hands")
    assert "<title>&lt;Two&gt; hands</title>" in page
    scripts = "".join(data.decode() for kind, data in unfold(page) if kind == "script")
    assert "</script><b>" not in page + scripts
    found = re.search(r"const hands = (\[.*?\]);\n", scripts)
    assert found is not None
    facts = json.loads(found[1].replace("<\\/", "</"))
    assert [fact["name"] for fact in facts] == ["inspire", "ability"]
    for hand, fact in zip(hands, facts, strict=True):
        assert fact["names"] == list(hand.joint_names)
        assert len(fact["joints"]) == len(hand.joints)
        # Couplings as the page applies them.
        q = hand.q_rest
        values = [j["multiplier"] * q[j["master"]] + j["offset"] for j in fact["joints"]]
        assert values == pytest.approx(hand.q_full(q), abs=1e-9)
    # It asks for nothing from elsewhere.
    assert 'src="http' not in page
    with pytest.raises(ConfigError, match="1 to"):
        browser_page([])
