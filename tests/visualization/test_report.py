import base64
import io
import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Lift
from xdex_drake.grasping.tally import Tally
from xdex_drake.visualization import report
from xdex_drake.visualization.report import ReportGrasp, ReportRow, ReportSection, show_grasp, write_report

HOSTILE = "<script>alert('x')</script>\"&../../etc"


class Page(HTMLParser):
    """Checks that tags nest, and collects them."""

    VOID = ("meta", "img", "br", "link")

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.text = [], [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture
def sections(grasp):
    picture = np.random.default_rng(0).integers(0, 255, (30, 40, 3), dtype=np.uint8)
    lifted = replace(grasp, lift=Lift("lift-0.2/2tips", True, "", 0.2481, ("thumb", "index"), 0.4))
    failed = replace(grasp, lift=Lift("lift-0.2/2tips", False, "not_grasped", float("nan"), (), 0.4), certificate=None)
    hostile = replace(grasp, hand=HOSTILE, object=HOSTILE, grasp_id=HOSTILE, source_grasp_id=HOSTILE)
    return [
        ReportSection(
            "Found",
            "Grasps.",
            [
                ReportRow("allegro", "can", Tally(40, 12, 9, Counter(cone=28), Counter(not_grasped=3), seconds=31.25)),
                ReportRow(HOSTILE, HOSTILE, Tally(1, rejected=Counter({HOSTILE: 1}), seconds=0.5)),
            ],
            [
                ReportGrasp(lifted, "Allegro", picture, "<html>one</html>"),
                ReportGrasp(failed, "Allegro", picture, "<html>two</html>"),
            ],
        ),
        ReportSection(HOSTILE, HOSTILE, (), [ReportGrasp(hostile, HOSTILE, None, "<html>three</html>", HOSTILE)]),
    ]


def test_report_is_well_formed_and_says_what_happened(tmp_path, sections):
    index = write_report(
        tmp_path / "report", sections, title="Demo", intro="What is shown.", seed=7, command="xdex demo"
    )
    page = Page(index.read_text())
    text = " ".join(" ".join(page.text).split())
    for words in (
        "What is shown.",
        "lift-0.2/2tips",
        "0.25 m",
        "not grasped 3",
        "24.8 cm",
        "0.1250 to 0.1260",
        "0.25 mm",
    ):
        assert words in text, words
    for words in ("xdex demo", "1.0e-09", "1.25", "31.2 s", "cone 28", "thumb, index", "drake", "nan"):
        assert (words in text) == (words != "nan"), words


def test_links_and_pictures_resolve(tmp_path, sections):
    index = write_report(tmp_path, sections)
    page = Page(index.read_text())
    links = [attributes["href"] for tag, attributes in page.tags if tag == "a"]
    assert len(set(links)) == 3
    contents = [(tmp_path / link).read_text() for link in links]
    assert contents == ["<html>one</html>", "<html>two</html>", "<html>three</html>"]
    for tag, attributes in page.tags:
        if tag == "img":
            data = base64.b64decode(attributes["src"].removeprefix("data:image/jpeg;base64,"))
            assert Image.open(io.BytesIO(data)).size == (40, 30)
            assert (attributes["width"], attributes["height"]) == ("40", "30")
    # Nothing but the report: no file of a half-done write, nothing outside the folder.
    found = sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file())
    assert found == sorted(["index.html", *links])


def test_hostile_names_stay_text(tmp_path, sections):
    text = write_report(tmp_path, sections, title=HOSTILE, intro=HOSTILE, command=HOSTILE).read_text()
    page = Page(text)
    assert not [tag for tag, _ in page.tags if tag == "script"]
    assert "<script" not in text
    assert HOSTILE in "".join(page.text)
    assert all(re.fullmatch(r"replays/[\w-]+\.html", a["href"]) for tag, a in page.tags if tag == "a")


def test_names_of_replays_never_collide(tmp_path, grasp):
    ids = ["a b", "a/b", "A-B", "", "..", "/"]
    shown = [ReportGrasp(replace(grasp, grasp_id=name), replay=f"page {k}") for k, name in enumerate(ids)]
    write_report(tmp_path, [ReportSection("all", grasps=shown)])
    files = list((tmp_path / "replays").iterdir())
    assert len({file.name.lower() for file in files}) == len(ids)
    assert sorted(file.read_text() for file in files) == [f"page {k}" for k in range(len(ids))]


def test_report_replaces_an_earlier_one(tmp_path, sections):
    write_report(tmp_path, sections, title="first")
    index = write_report(tmp_path, sections[:1], title="second")
    assert "<title>second</title>" in index.read_text()


def test_folder_that_cannot_be_written_is_told(tmp_path, sections):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="choose another folder"):
        write_report(tmp_path / "file", sections)


def test_grasp_is_shown_without_pictures_where_none_can_be_made(monkeypatch, grasp, hand, scene, tmp_path):
    monkeypatch.setattr(report, "can_render", lambda: False)
    shown = show_grasp(replace(grasp, tau_squeeze=None), hand, scene, note="as it is")
    assert shown.picture is None
    assert shown.replay == ""
    text = write_report(tmp_path, [ReportSection("one", grasps=[shown])]).read_text()
    assert "no picture" in text
    assert "as it is" in text
    assert "<a " not in text


def test_a_pair_stands_side_by_side_and_facts_are_folded(tmp_path, grasp):
    picture = np.zeros((30, 40, 3), dtype=np.uint8)
    lifted = replace(grasp, lift=Lift("lift-0.2/2tips", True, "", 0.25, ("thumb", "index"), 0.4))
    source = ReportGrasp(replace(lifted, grasp_id="one"), "Allegro", picture, "source")
    other = ReportGrasp(replace(lifted, grasp_id="two", source_grasp_id="one"), "Shadow", picture, "other")
    alone = ReportGrasp(replace(lifted, grasp_id="three", source_grasp_id="elsewhere"), "Ability", picture, "alone")
    text = write_report(
        tmp_path, [ReportSection("a", grasps=[source]), ReportSection("b", grasps=[other, alone])]
    ).read_text()
    cards = re.findall(r"<article.*?</article>", text, flags=re.S)
    assert ["pair" in card.split(">")[0] for card in cards] == [False, True, False]
    assert re.findall(r'href="(.*?)"', cards[1]) == ["replays/one.html", "replays/two.html"]
    for card in cards:
        before, _, folded = card.partition("<details>")
        assert before.count("<dt>") == 3 and folded.count("<dt>") >= 5
