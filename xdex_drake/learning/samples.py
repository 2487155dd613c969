"""From a data set of grasps to what the model learns from."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform

from xdex_drake.arrays import Array
from xdex_drake.dataset.folder import read_dataset
from xdex_drake.dataset.schema import ObjectFacts, Row, grasp_from_row, object_facts_from_row
from xdex_drake.errors import DatasetError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.library import load_hand
from xdex_drake.learning.batches import Sample, TrainingSet
from xdex_drake.learning.features import HandFeatures, ObjectFeatures, hand_features, object_features, object_point
from xdex_drake.scene.object import ObjectModel, load_object

CLOUD = 4096
"""Points kept of each scene; a training step sees a part of them."""


def succeeded(row: Row) -> bool:
    """Whether a row's lift met the protocol's rule.

    Args:
        row: A row of a data set.

    Returns:
        False also where the grasp was never simulated.
    """
    return bool(row["success"])


def object_of_facts(facts: ObjectFacts) -> ObjectModel:
    """The object that a row names.

    Args:
        facts: What the row says about its object.

    Returns:
        The object.

    Raises:
        DatasetError: What is found under its name is another mesh.
        XdexError: Nothing is found, or it cannot be used.
    """
    found = load_object(facts.path, scale=facts.scale, mass=facts.mass, friction=facts.friction)
    if found.digest != facts.digest:
        raise DatasetError(f"object {facts.name}: {facts.path} is not the mesh of the grasps; restore that file")
    return found


def training_set_from_dataset(
    folder: str | Path,
    *,
    keep: Callable[[Row], bool] = succeeded,
    hands: Callable[[str], Hand] = load_hand,
    objects: Callable[[ObjectFacts], ObjectModel] = object_of_facts,
) -> TrainingSet:
    """The grasps of a data set, ready for `training.train`.

    Args:
        folder: Folder of the data set.
        keep: Which rows to learn from.
        hands: Finds a hand by the name that rows give it; generated hands need one of their own.
        objects: Finds an object by what rows say about it.

    Returns:
        The training set; scenes carry their `scene_id` as name.

    Raises:
        DatasetError: The folder is no data set, holds no grasp to learn from, or names other hands or
            objects than those found.
        XdexError: A shard, hand or object cannot be used.
    """
    rows = (row for row in read_dataset(folder).to_pylist() if keep(row))
    samples = training_set_from_rows(rows, hands=hands, objects=objects)
    if not samples.samples:
        raise DatasetError(f"{folder}: no grasp to learn from; generate more, or keep other rows than successful ones")
    return samples


def training_set_from_rows(
    rows: Iterable[Row],
    *,
    hands: Callable[[str], Hand] = load_hand,
    objects: Callable[[ObjectFacts], ObjectModel] = object_of_facts,
) -> TrainingSet:
    """The same from rows at hand.

    A grasp is conditioned on its source's object point, so that versions of one grasp share it; where the row has none,
    on its own, found by the heading rule where the row has none either.

    Args:
        rows: Rows of a data set.
        hands: Finds a hand by its name.
        objects: Finds an object by what a row says about it.

    Returns:
        The training set.

    Raises:
        DatasetError: A row does not fit its hand.
        XdexError: A row, hand or object cannot be used.
    """
    found_hands: dict[str, tuple[int, Hand, HandFeatures]] = {}
    found_scenes: dict[str, tuple[int, ObjectFeatures]] = {}
    pairs: dict[tuple[str, str], int] = {}
    clouds_O: dict[str, Array] = {}
    samples = []
    for row in rows:
        grasp = grasp_from_row(row)
        if grasp.hand not in found_hands:
            hand = hands(grasp.hand)
            found_hands[grasp.hand] = len(found_hands), hand, hand_features(hand)
        h, hand, _ = found_hands[grasp.hand]
        if tuple(row["joint_names"]) != hand.joint_names:
            raise DatasetError(
                f"grasp {grasp.grasp_id}: joint_names are not those of hand {grasp.hand}; restore its file"
            )
        if row["scene_id"] not in found_scenes:
            facts = object_facts_from_row(row)
            if facts.digest not in clouds_O:
                clouds_O[facts.digest] = objects(facts).surface_samples(CLOUD)[0]
            p_WPoints = _transform(grasp.X_WO, clouds_O[facts.digest])
            p_WCenter = _transform(grasp.X_WO, facts.p_OOcm[None])[0]
            features = object_features(p_WPoints, p_WCenter, count=CLOUD, name=row["scene_id"])
            found_scenes[row["scene_id"]] = len(found_scenes), features
        s, scene = found_scenes[row["scene_id"]]
        R_WLs, p_WLs = forward_kinematics(hand, grasp.X_WH, grasp.q)
        p_OPoint = row["source_object_point_O"] or row["object_point_O"]
        if p_OPoint is None:
            p_WPoints = scene.points + scene.p_WCenter
            p_WPoint = p_WPoints[object_point(hand, R_WLs, p_WLs, p_WPoints)]
        else:
            p_WPoint = _transform(grasp.X_WO, np.array([p_OPoint]))[0]
        pair = pairs.setdefault((row["scene_id"], grasp.source_grasp_id or grasp.grasp_id), len(pairs))
        samples.append(Sample(h, s, R_WLs, p_WLs, p_WPoint, pair))
    return TrainingSet(
        hands=tuple(features for _, _, features in found_hands.values()),
        scenes=tuple(scene for _, scene in found_scenes.values()),
        samples=tuple(samples),
    )


def _transform(X_WO: RigidTransform, p_OPs: Array) -> Array:
    """Points of O in W, shape (n, 3)."""
    return p_OPs @ X_WO.rotation().matrix().T + X_WO.translation()
