"""The grasps of a data set that are most likely to hold, by the scores that ship."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from xdex_drake.dataset.files import StoredGrasp, load_grasps
from xdex_drake.dataset.folder import iter_shards
from xdex_drake.dataset.schema import grasp_from_row
from xdex_drake.grasp import Grasp
from xdex_drake.grasping.scores import hold_probability


@dataclass(frozen=True, eq=False)
class Ranked:
    """A grasp and its rank.

    Attributes:
        grasp: The grasp.
        unit: The unit whose shard it is in.
        scene: Name of its scene.
        hold: Probability that it lifts and holds.
    """

    grasp: Grasp
    unit: str
    scene: str
    hold: float

    def outcome(self) -> tuple[str, str]:
        """What its simulations showed of lifting and holding, for a table."""
        lift = self.grasp.lift
        lifted = "-" if lift is None else "yes" if lift.success else lift.failure_reason
        held = "-" if lift is None or lift.hold is None else "yes" if lift.hold.holds else lift.hold.reason
        return lifted, held


def best_grasps(folder: str | Path, *, count: int, hand: str | None = None) -> list[Ranked]:
    """The grasps most likely to hold, the best one of each hand and scene.

    Args:
        folder: Folder of the data set.
        count: Greatest number of grasps.
        hand: Name of the hand whose grasps alone are taken; all where None.

    Returns:
        The grasps, the most likely first; those without a certificate are left out.

    Raises:
        DatasetError: The folder is no data set.
        GraspFileError: A shard is damaged.
    """
    best: dict[tuple[str, str], Ranked] = {}
    for unit, table in iter_shards(folder):
        rows = [row for row in table.to_pylist() if row["contacts"] and hand in (None, row["hand"])]
        grasps = [grasp_from_row(row) for row in rows]
        for row, grasp, hold in zip(rows, grasps, hold_probability(grasps).tolist(), strict=True):
            key = row["hand"], row["scene_id"]
            if key not in best or hold > best[key].hold:
                best[key] = Ranked(grasp, unit, row["scene_id"], hold)
    return sorted(best.values(), key=lambda ranked: (-ranked.hold, ranked.grasp.grasp_id))[:count]


def stored_grasps(folder: str | Path, ranked: Sequence[Ranked]) -> list[StoredGrasp]:
    """Ranked grasps with their hands and scenes, in the same order.

    Args:
        folder: Folder of the data set.
        ranked: Some of its grasps.

    Returns:
        The grasps as `load_grasps` gives them.

    Raises:
        GraspFileError: A shard names a hand or a mesh that has changed or cannot be found.
    """
    found = {
        item.grasp.grasp_id: item
        for unit in dict.fromkeys(one.unit for one in ranked)
        for item in load_grasps(Path(folder) / "shards" / f"{unit}.parquet")
    }
    return [found[one.grasp.grasp_id] for one in ranked]
