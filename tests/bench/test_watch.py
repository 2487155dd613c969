"""Benchmarks: what they time and count, their JSON and their picture."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest

from xdex_drake.bench.ik import bench_ik, reachable_poses, tip_errors
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
