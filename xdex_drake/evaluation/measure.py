"""Consistency and diversity of a data set's lifted grasps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from xdex_drake.dataset.files import StoredGrasp, load_grasps
from xdex_drake.dataset.folder import read_manifest, shard_paths
from xdex_drake.evaluation.consistency import Consistency, all_pairs, consistency, diversity, keypoints, matched_pairs
from xdex_drake.evaluation.metrics import normalised_entropy


@dataclass(frozen=True)
class Measured:
    """What a data set's lifted grasps are like.

    Attributes:
        grasps: Lifted grasps that were measured.
        scenes: Scenes that they are of.
        matched: Differences of versions of one grasp by different hands.
        all: Differences of any two grasps of one scene by different hands.
        distinct: Mean number of distinct grasps in a scene, all hands together.
        coverage: Mean share of an object's surface near a contact, all hands together.
        entropy: Mean normalised entropy of joint values (32 bins), over hands weighted by their grasps.
    """

    grasps: int
    scenes: int
    matched: Consistency
    all: Consistency
    distinct: float
    coverage: float
    entropy: float


def measure(folder: str | Path, *, units: int = 50) -> Measured:
    """Measures the lifted grasps of a data set.

    Args:
        folder: Folder of the data set.
        units: Greatest number of units that are read, evenly spread over their names; a hand takes some 0.25 s to make.

    Returns:
        The measures; NaN where nothing lifted.

    Raises:
        DatasetError: The folder is no data set.
        GraspFileError: A shard is damaged, or names a hand or a mesh that has changed or cannot be found.
    """
    read_manifest(folder)
    paths = shard_paths(folder)
    chosen = np.unique(np.linspace(0, len(paths) - 1, min(units, len(paths))).round().astype(int))
    stored = [item for k in chosen for item in load_grasps(paths[k])]
    stored = [item for item in stored if item.grasp.lift is not None and item.grasp.lift.success]
    pairs = [(item.hand, item.grasp) for item in stored]
    points, grasps = keypoints(pairs), [grasp for _, grasp in pairs]
    scenes: dict[str, list[StoredGrasp]] = {}
    for item in stored:
        scenes.setdefault(item.facts.scene_id, []).append(item)
    ways = [diversity([(i.hand, i.grasp) for i in some], some[0].scene) for some in scenes.values()]
    return Measured(
        grasps=len(stored),
        scenes=len(scenes),
        matched=consistency(points, matched_pairs(grasps)),
        all=consistency(points, all_pairs(grasps, [item.facts.scene_id for item in stored])),
        distinct=_mean([way.distinct for way in ways]),
        coverage=_mean([way.coverage for way in ways]),
        entropy=_entropy(stored),
    )


def _entropy(stored: list[StoredGrasp]) -> float:
    by_hand: dict[str, list[StoredGrasp]] = {}
    for item in stored:
        by_hand.setdefault(item.hand.name, []).append(item)
    shares = [(normalised_entropy(i[0].hand, np.array([x.grasp.q for x in i]))[0], len(i)) for i in by_hand.values()]
    if not shares:
        return float("nan")
    entropies, weights = zip(*shares, strict=True)
    return float(np.average(entropies, weights=weights))


def _mean(values: list[float] | list[int]) -> float:
    return float(np.mean(values)) if values else float("nan")
