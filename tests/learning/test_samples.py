from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.dataset.folder import Manifest, open_dataset, write_shard
from xdex_drake.dataset.schema import ObjectFacts, row_from_grasp
from xdex_drake.errors import DatasetError
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.link_pose import link_poses_from_vectors
from xdex_drake.learning.features import hand_features, link_frames, object_point
from xdex_drake.learning.pack import read_pack, write_pack
from xdex_drake.learning.samples import Splits, make_pack, pack_dataset

X_WO = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.0, 0.1, 0.05])
X_WH = RigidTransform(RollPitchYaw(0.0, 2.0, 0.5), [0.0, 0.0, 0.2])
FACTS = ObjectFacts("ball", "ball", "d1", 1.0, 0.1, 0.6, np.array([0.001, 0.002, 0.003]), 0.03)
# Half a unit in the last place of 16 bits below 0.25 m, and the same of a rotation's entry at 0.1 m from its axis.
ROUNDING = 0.25 * 2.0**-12 + 1e-6


def _ball(facts):
    def surface_samples(n, seed=0):
        normals = np.random.default_rng(seed).normal(size=(n, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return 0.03 * normals + facts.p_OOcm, normals

    return SimpleNamespace(surface_samples=surface_samples)


def _row(hand, grasp_id, source="", success=True, point=None, source_point=None, lifted=True, shift=0.0):
    lift = Lift("lift-0.2/2tips", success, "" if success else "slipped", 0.25, ("thumb",), 1.0) if lifted else None
    X = RigidTransform(X_WH.rotation(), X_WH.translation() + np.array([0.0, 0.0, shift]))
    grasp = Grasp(hand.name, "ball", X_WO, X, hand.q_rest + shift, lift=lift, grasp_id=grasp_id, source_grasp_id=source)
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


@pytest.fixture
def packed(hands, tmp_path):
    """Packs a data set of some units of rows."""

    def packing(*units, **options):
        names = tuple(f"u{k}" for k in range(len(units)))
        open_dataset(tmp_path, Manifest(config={}, seed=0, units=names, versions={}, digests={}))
        for name, rows in zip(names, units, strict=True):
            write_shard(tmp_path, name, rows)
        return pack_dataset(tmp_path, **{"hands": hands.__getitem__, "objects": _ball, **options})

    return packing


def _poses(pack, k, hand):
    """Poses in W of the frames G of a grasp of a pack."""
    n = len(hand_features(hand).links)
    vectors = pack.vectors[pack.first_vectors[k] : pack.first_vectors[k] + n].astype(float)
    R, p = link_poses_from_vectors(vectors, np.eye(3))
    return R, p + pack.points[k] + pack.centers[pack.scene[k]]


def _heads(pack, k):
    return pack.points[k] + pack.centers[pack.scene[k]]


def test_rows_become_grasps(hands, packed):
    own, source = np.array([0.0, 0.0, 0.03]), np.array([0.0, 0.03, 0.0])
    pack = packed(
        [_row(hands["three"], "a", point=own), _row(hands["two"], "b", "a", point=own, source_point=source)],
        [_row(hands["two"], "c", shift=0.01)],
    )
    assert pack.hand_names == ("three", "two") and pack.scene_names == ("ball-0",)
    assert pack.hand.tolist() == [0, 1, 1]
    assert pack.pair[0] == pack.pair[1] != pack.pair[2]
    np.testing.assert_allclose(_heads(pack, 0), X_WO.multiply(own), atol=1e-7)
    np.testing.assert_allclose(_heads(pack, 1), X_WO.multiply(source), atol=1e-7)
    # Without a stored point, the heading rule finds one on the cloud.
    p_OPs, n_OPs = _ball(FACTS).surface_samples(2048)
    cloud = (X_WO @ p_OPs.T).T
    X = RigidTransform(X_WH.rotation(), X_WH.translation() + np.array([0.0, 0.0, 0.01]))
    R_WLs, p_WLs = forward_kinematics(hands["two"], X, hands["two"].q_rest + 0.01)
    np.testing.assert_allclose(_heads(pack, 2), cloud[object_point(hands["two"], R_WLs, p_WLs, cloud)], atol=1e-7)
    R, p = _poses(pack, 2, hands["two"])
    R_WGs, p_WGs = link_frames(hand_features(hands["two"]), R_WLs, p_WLs)
    np.testing.assert_allclose(R, R_WGs, atol=1e-3)
    np.testing.assert_allclose(p, p_WGs, atol=ROUNDING)
    # The cloud is centered at the center of mass.
    np.testing.assert_allclose(pack.centers[0], X_WO.multiply(FACTS.p_OOcm), atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(pack.clouds[0].astype(float), axis=1), 0.03, atol=2e-5)
    np.testing.assert_allclose(pack.cloud_normals[0] / 127, n_OPs @ X_WO.rotation().matrix().T, atol=4e-3)


def test_a_pack_keeps_what_hands_are(hands, packed):
    pack = packed([_row(hands["two"], "a"), _row(hands["three"], "b", "a")])
    for h, name in enumerate(pack.hand_names):
        features = hand_features(hands[name])
        rows = slice(pack.first_links[h], pack.first_links[h] + pack.links[h])
        np.testing.assert_allclose(pack.link_points[rows], features.link_points, atol=1e-4)
        np.testing.assert_allclose(pack.link_normals[rows] / 127, features.link_normals, atol=4e-3)
        np.testing.assert_allclose(pack.link_centers[rows], features.centers, atol=1e-7)
        np.testing.assert_allclose(pack.link_joints[rows], features.joints, atol=1e-3)
        begin = int((pack.links[:h] ** 2).sum())
        assert np.array_equal(pack.spd[begin : begin + pack.links[h] ** 2], features.spd.ravel())
        has = [pack.keypoint_names.index(k) for k in features.keypoint_names]
        assert pack.keypoint_links[h, has].tolist() == features.keypoint_links.tolist()
        assert (np.delete(pack.keypoint_links[h], has) == -1).all()


def test_failures_are_kept_with_their_reasons_and_thinned(hands, packed, tmp_path):
    rows = [_row(hands["three"], f"good{k}") for k in range(2)]
    rows += [_row(hands["two"], f"bad{k}", success=False, shift=0.001 * k) for k in range(5)]
    rows += [_row(hands["two"], "never lifted", lifted=False)]
    pack = packed(rows)
    assert pack.reasons == ("", "slipped") and pack.outcome.tolist() == [0, 0, 1, 1]
    again = pack_dataset(tmp_path, hands=hands.__getitem__, objects=_ball)
    assert np.array_equal(pack.vectors, again.vectors)
    every = pack_dataset(tmp_path, failures=10.0, hands=hands.__getitem__, objects=_ball)
    assert len(every.outcome) == 7
    none = pack_dataset(tmp_path, failures=0.0, hands=hands.__getitem__, objects=_ball)
    assert none.outcome.tolist() == [0, 0] and none.hand_names == ("three",)


def test_a_data_set_without_a_lifted_grasp_is_refused(hands, packed):
    with pytest.raises(DatasetError, match="no grasp to learn from"):
        packed([_row(hands["three"], "a", success=False)])


def test_splits_are_named(hands, packed):
    rows = [_row(hands["three"], "a"), _row(hands["two"], "b", "a")]
    pack = packed(rows, splits=Splits(("elsewhere",), ("two", "unheard of")))
    assert pack.held_hands.tolist() == [0, 1] and pack.held_scenes.tolist() == [0]


def test_another_hand_of_the_same_name_is_refused(hands, packed):
    with pytest.raises(DatasetError, match="joint_names"):
        packed([_row(hands["three"], "a")], hands=lambda name: hands["two"])


def test_a_written_pack_is_the_one_in_memory(hands, packed, tmp_path):
    pack = packed([_row(hands["three"], "a")])
    found = read_pack(write_pack(pack, tmp_path / "p.safetensors"))
    assert np.array_equal(found.vectors, pack.vectors) and found.hand_names == pack.hand_names


def test_grasps_that_do_not_fit_are_refused(training_set):
    import dataclasses

    good = training_set.grasps[0]
    for change in (
        {"scene": good.scene + 9},
        {"p_WGs": good.p_WGs[:, :-1]},
        {"p_WGs": np.full_like(good.p_WGs, np.nan)},
        {"p_WPoints": np.full_like(good.p_WPoints, 1e6)},
    ):
        with pytest.raises(DatasetError, match="training pack"):
            make_pack(training_set.scenes, [dataclasses.replace(good, **change)])
