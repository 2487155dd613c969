"""Consistency and diversity, held against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.dataset.folder import Manifest, open_dataset, write_shard
from xdex_drake.dataset.rows import rows_of
from xdex_drake.evaluation.consistency import (
    Consistency,
    all_pairs,
    consistency,
    coverage,
    differences,
    distinct_grasps,
    diversity,
    keypoints,
    matched_pairs,
)
from xdex_drake.evaluation.measure import measure
from xdex_drake.evaluation.metrics import position_difference, vector_difference
from xdex_drake.grasp import Certificate, Contact, Grasp, Lift
from xdex_drake.hand.library import load_hand
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene

LIFTED = Lift("lift-0.2/2tips", True, "", 0.25, ("thumb", "index"), 0.1)


@pytest.fixture(scope="module")
def hands():
    return {name: load_hand(name) for name in ("allegro", "shadow")}


def at(hand, x=0.0, **facts):
    return Grasp(hand.name, "ball", RigidTransform(), RigidTransform([x, 0.0, 0.0]), hand.q_rest, **facts)


def test_differences_are_those_of_pairs_one_by_one(hands):
    rng = np.random.default_rng(0)
    grasps = []
    for hand in hands.values():
        for _ in range(3):
            X_WH = RigidTransform(RollPitchYaw(rng.uniform(-1.0, 1.0, 3)), rng.normal(size=3))
            grasps.append((hand, replace(at(hand), X_WH=X_WH, q=rng.uniform(*hand.limits))))
    pairs = np.array([(i, j) for i in range(6) for j in range(6)])
    position, vector = differences(keypoints(grasps), pairs)
    for (i, j), p, v in zip(pairs, position, vector, strict=True):
        assert p == pytest.approx(position_difference(*grasps[i], *grasps[j]), abs=1e-9)
        assert v == pytest.approx(vector_difference(*grasps[i], *grasps[j]), abs=1e-9)


def test_matched_pairs_are_versions_of_one_grasp_and_all_pairs_those_of_one_scene(hands):
    a, s = hands.values()
    grasps = [
        at(a, grasp_id="1"),
        at(s, grasp_id="1>s", source_grasp_id="1"),
        at(a, grasp_id="2"),
        at(s, grasp_id="2>s", source_grasp_id="2"),
        at(a, grasp_id="3"),
    ]
    assert matched_pairs(grasps).tolist() == [[0, 1], [2, 3]]
    assert all_pairs(grasps, ["x", "x", "x", "x", "y"]).tolist() == [[0, 1], [0, 3], [1, 2], [2, 3]]
    assert matched_pairs(grasps[:1]).shape == (0, 2)


def test_shifted_versions_differ_by_their_shift(hands):
    # One hand under two names: every fingertip and the wrist are 3 cm apart in one pair, 5 cm in the other.
    a = hands["allegro"]
    b = replace(a, name="twin")
    grasps = [(a, at(a)), (b, at(b, 0.03)), (a, at(a, 1.0)), (b, at(b, 1.05))]
    points = keypoints(grasps)
    matched = consistency(points, np.array([(0, 1), (2, 3)]))
    assert matched.pairs == 2 and matched.position_cm == pytest.approx(4.0)
    assert matched.vector_cm == pytest.approx(0.0, abs=1e-9)
    every = consistency(points, all_pairs([g for _, g in grasps], ["x"] * 4))
    assert every.pairs == 4 and every.position_cm == pytest.approx((3 + 105 + 97 + 5) / 4)
    assert repr(consistency(points, np.zeros((0, 2)))) == repr(Consistency(0, float("nan"), float("nan")))


def test_hands_without_a_common_finger_compare_by_their_wrists(hands):
    a = hands["allegro"]
    b = replace(a, name="other", fingers=tuple(replace(f, name=f"{f.name}2") for f in a.fingers))
    position, vector = differences(keypoints([(a, at(a)), (b, at(b, 0.07))]), np.array([(0, 1)]))
    assert position == pytest.approx(7.0) and np.isnan(vector[0])


def test_distinct_grasps_keep_their_distance(hands):
    a = hands["allegro"]
    points = keypoints([(a, at(a, x)) for x in (0.0, 0.01, 0.019, 0.021, 0.03, 0.1)])
    assert distinct_grasps(points) == [0, 3, 5]
    assert distinct_grasps(points, apart_cm=0.5) == [0, 1, 2, 4, 5]
    assert distinct_grasps(points, apart_cm=50.0) == [0]


def proof_of(*points):
    contacts = tuple(Contact("l", np.array(p), np.array([0.0, 0.0, 1.0]), 0.6, np.ones(3)) for p in points)
    return Certificate(contacts, np.eye(3), np.zeros(3), 0.1, 0.04, 0.0, 1.0, 0.1, 0.1)


def test_coverage_of_a_ball_is_that_of_caps(hands):
    scene, a = make_scene(load_object("ball")), hands["allegro"]
    points, _ = scene.object.surface_samples(2048)
    radius = float(np.linalg.norm(points - points.mean(axis=0), axis=1).mean())
    top = scene.object.p_OOcm + np.array([0.0, 0.0, radius])
    bottom = scene.object.p_OOcm - np.array([0.0, 0.0, radius])
    # The cap of a sphere within a distance d of a point on it has the area pi d^2, of 4 pi r^2.
    one = coverage([at(a, certificate=proof_of(top))], scene, reach_m=0.02)
    assert one == pytest.approx(0.02**2 / (4.0 * radius**2), rel=0.15)
    both = coverage([at(a, certificate=proof_of(top, bottom, top))], scene, reach_m=0.02, samples=2048)
    assert both == pytest.approx(2.0 * one, rel=0.3)
    assert coverage([at(a)], scene) == 0.0
    told = diversity(
        [(a, at(a, lift=LIFTED, certificate=proof_of(top))), (a, at(a, 0.001, lift=LIFTED)), (a, at(a))], scene
    )
    assert (told.lifted, told.distinct) == (2, 1) and told.coverage > 0.0
    assert diversity([(a, at(a))], scene).lifted == 0


def test_a_data_set_is_measured_scene_by_scene(hands, tmp_path):
    scene = make_scene(load_object("ball"))
    a, s = hands.values()
    X_WO = scene.X_WO
    source = replace(at(a, grasp_id="1", lift=LIFTED), X_WO=X_WO)
    version = replace(at(s, 0.02, grasp_id="1>s", source_grasp_id="1", lift=LIFTED), X_WO=X_WO)
    failed = replace(at(s, 0.5, grasp_id="2", lift=replace(LIFTED, success=False)), X_WO=X_WO)
    open_dataset(tmp_path, Manifest({}, 0, ("u",), {}, {}))
    write_shard(tmp_path, "u", [*rows_of([source], a, scene), *rows_of([version, failed], s, scene)])
    measured = measure(tmp_path)
    points = keypoints([(a, source), (s, version)])
    assert measured.matched == measured.all == consistency(points, np.array([(0, 1)]))
    assert (measured.grasps, measured.scenes) == (2, 1) and measured.distinct == len(distinct_grasps(points))
    assert measured.entropy == pytest.approx(0.0) and measured.coverage == 0.0
