"""Benchmarks: what they time and count, their JSON and their picture."""

import importlib.util
import itertools
import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from xdex_drake.bench.ik import bench_ik, reachable_poses, tip_errors
from xdex_drake.bench.svg import FONT, duration
from xdex_drake.bench.watch import Stage, Watch, content, picture
from xdex_drake.bench.wrench import bench_wrench
from xdex_drake.hand.library import load_hand


def test_a_watch_keeps_order_shares_and_targets():
    watch = Watch()
    assert watch.time("b", lambda: 7, share=2, target_ms=1.5) == 7
    watch.time("a", lambda: None)
    watch.time("b", lambda: None, share=2)
    watch.count("seen")
    watch.count("seen", 2)
    b, a = watch.stages()
    assert (b.name, b.count, b.target_ms, a.name, a.target_ms) == ("b", 2, 1.5, "a", None)
    assert 0.0 <= b.median_ms <= b.p90_ms and watch.facts == {"seen": 3}


def test_the_wrench_benchmark_says_what_it_is():
    watch, ticks = Watch(), []
    bench_wrench(watch, repeats=2, seed=3, tick=lambda: ticks.append(1))
    assert len(ticks) == 6
    names = [stage.name for stage in watch.stages()]
    assert {"balance, 4 contacts, solver alone", "ball margin to 1e-3, 4", "certificate, 4"} <= set(names)
    assert watch.facts["worst residual"] < 1e-6 and watch.facts["widest bracket"] <= 1e-3
    told = json.loads(json.dumps(content("wrench", watch, seed=3, conditions={"repeats": 2})))
    assert told["seed"] == 3 and {"clarabel", "drake"} <= set(told["versions"]) and told["processor"] is not None
    assert [stage["name"] for stage in told["stages"]] == names


def test_inverse_kinematics_is_timed_by_pose_and_judged_by_tips():
    hand = load_hand("ability")
    R, p, R_WHs, qs = reachable_poses(hand, 3, 0)
    assert R.shape == (3, len(hand.links), 3, 3) and np.all((qs >= hand.limits[0]) & (qs <= hand.limits[1]))
    from pydrake.math import RigidTransform, RotationMatrix

    X_WHs = [
        RigidTransform(RotationMatrix.ProjectToRotationMatrix(R_WH), p_WL[0] - R_WH @ hand.p_HB)
        for R_WH, p_WL in zip(R_WHs, p, strict=True)
    ]
    assert tip_errors(hand, p, R, X_WHs, qs).max() < 1e-12  # the truth itself has no error
    watch = Watch()
    bench_ik(watch, (hand,), repeats=1, batch=16, seed=0, tick=lambda: None)
    assert watch.facts["ability: poses with tips within 1 mm"] >= 0.9
    assert watch.stages()[0].name == "ability, a pose of 16"


@pytest.mark.parametrize(
    "stages",
    [(), (Stage("a < b & c", 3, 0.2, 0.5, 0.2, 0.3), Stage("d", 1, 40.0, 90.0, 39.0)), (Stage("z", 1, 0, 0, 0),)],
)
def test_pictures_are_valid_svg(stages):
    root = ElementTree.fromstring(picture("title & more", stages))
    texts = [element.text for element in root.iter() if element.tag.endswith("text")]
    assert "title & more" in texts and all(stage.name in texts for stage in stages)


@pytest.mark.parametrize(
    ("ms", "said"),
    [(0.0, "0 ms"), (0.0729, "72.9 µs"), (0.1, "0.1 ms"), (1.716, "1.72 ms"), (142.3, "142 ms"), (2367.0, "2.37 s")],
)
def test_times_have_units(ms, said):
    assert duration(ms) == said


def _boxes(root):
    """Rectangles that the texts of a picture take, wide letters assumed."""
    for text in (element for element in root.iter() if element.tag.endswith("text")):
        size = float(text.get("font-size", FONT))
        width = 0.55 * size * len(text.text)
        x = float(text.get("x")) - width * {"end": 1.0, "middle": 0.5}.get(text.get("text-anchor"), 0.0)
        y = float(text.get("y"))
        yield text.text, (x, x + width, y - 0.7 * size, y + 0.2 * size)


def test_committed_pictures_are_those_of_their_figures_and_no_texts_overlap():
    folder = Path(__file__).parents[2] / "studies" / "bench"
    spec = importlib.util.spec_from_file_location("draw", folder / "draw.py")
    assert spec is not None and spec.loader is not None
    draw = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(draw)
    drawn = draw.pictures()
    assert len(drawn) >= 6
    for path, text in drawn.items():
        assert path.read_text(encoding="utf-8") == text, "run `python studies/bench/draw.py`"
        root = ElementTree.fromstring(text)
        panel = float(root.get("width", "0")), float(root.get("height", "0"))
        for (one, a), (other, b) in itertools.combinations(_boxes(root), 2):
            apart = a[1] < b[0] or b[1] < a[0] or a[3] < b[2] or b[3] < a[2]
            assert apart, f"{path.name}: {one!r} lies over {other!r}"
        for one, box in _boxes(root):
            assert box[0] > 0 and box[1] < panel[0] and box[3] < panel[1], f"{path.name}: {one!r} leaves the panel"
