from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.dataset.folder import Manifest, open_dataset, write_shard
from xdex_drake.dataset.schema import ObjectFacts, row_from_grasp
from xdex_drake.errors import DatasetError
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.learning.features import object_point
from xdex_drake.learning.samples import succeeded, training_set_from_dataset, training_set_from_rows

X_WO = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.0, 0.1, 0.05])
FACTS = ObjectFacts("ball", "ball", "d1", 1.0, 0.1, 0.6, np.array([0.001, 0.002, 0.003]), 0.03)


def _ball(facts):
    def surface_samples(n, seed=0):
        normals = np.random.default_rng(seed).normal(size=(n, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return 0.03 * normals + facts.p_OOcm, normals

    return SimpleNamespace(surface_samples=surface_samples)


def _row(hand, grasp_id, source="", success=True, point=None, source_point=None):
    X_WH = RigidTransform(RollPitchYaw(0.0, 2.0, 0.5), [0.0, 0.0, 0.2])
    lift = Lift("lift-0.2/2tips", success, "" if success else "slipped", 0.25, ("thumb",), 1.0)
    grasp = Grasp(hand.name, "ball", X_WO, X_WH, hand.q_rest, lift=lift, grasp_id=grasp_id, source_grasp_id=source)
    return row_from_grasp(
        grasp,
        scene_id="ball-0",
        hand=hand,
        hand_digest="h",
        object=FACTS,
        object_point_O=point,
        source_object_point_O=source_point,
    )


@pytest.fixture(scope="module")
def hands(hand_maker):
    return {name: hand_maker(fingers, name=name) for name, fingers in (("three", 3), ("two", 2))}


def test_rows_become_samples(hands):
    own, source = np.array([0.0, 0.0, 0.03]), np.array([0.0, 0.03, 0.0])
    rows = [
        _row(hands["three"], "a", point=own),
        _row(hands["two"], "b", source="a", point=own, source_point=source),
        _row(hands["two"], "c"),
    ]
    made = training_set_from_rows(rows, hands=hands.__getitem__, objects=_ball)
    assert [hand.name for hand in made.hands] == ["three", "two"]
    assert [scene.name for scene in made.scenes] == ["ball-0"]
    a, b, c = made.samples
    assert (a.hand, b.hand, c.hand) == (0, 1, 1)
    assert a.pair == b.pair != c.pair
    np.testing.assert_allclose(a.p_WPoint, X_WO.multiply(own))
    np.testing.assert_allclose(b.p_WPoint, X_WO.multiply(source))
    # Without a stored point, the heading rule finds one on the cloud.
    scene = made.scenes[0]
    cloud = scene.points + scene.p_WCenter
    X_WH = RigidTransform(RollPitchYaw(0.0, 2.0, 0.5), [0.0, 0.0, 0.2])
    R_WLs, p_WLs = forward_kinematics(hands["two"], X_WH, hands["two"].q_rest)
    np.testing.assert_allclose(c.R_WLs, R_WLs, atol=1e-12)
    np.testing.assert_allclose(c.p_WLs, p_WLs, atol=1e-12)
    np.testing.assert_allclose(c.p_WPoint, cloud[object_point(hands["two"], R_WLs, p_WLs, cloud)], atol=1e-12)
    # The cloud is centered at the center of mass.
    np.testing.assert_allclose(scene.p_WCenter, X_WO.multiply(FACTS.p_OOcm))
    np.testing.assert_allclose(np.linalg.norm(scene.points, axis=1), 0.03)


def test_a_folder_gives_its_successes(hands, tmp_path):
    rows = [_row(hands["three"], "a"), _row(hands["three"], "b", success=False)]
    open_dataset(tmp_path, Manifest(config={}, seed=0, units=("u", "v"), versions={}, digests={}))
    with pytest.raises(DatasetError, match="no grasp to learn from"):
        training_set_from_dataset(tmp_path, hands=hands.__getitem__, objects=_ball)
    write_shard(tmp_path, "u", rows)
    made = training_set_from_dataset(tmp_path, hands=hands.__getitem__, objects=_ball)
    assert len(made.samples) == 1 and succeeded(rows[0]) and not succeeded(rows[1])
    every = training_set_from_dataset(tmp_path, keep=lambda row: True, hands=hands.__getitem__, objects=_ball)
    assert len(every.samples) == 2


def test_another_hand_of_the_same_name_is_refused(hands):
    rows = [_row(hands["three"], "a")]
    with pytest.raises(DatasetError, match="joint_names"):
        training_set_from_rows(rows, hands=lambda name: hands["two"], objects=_ball)
