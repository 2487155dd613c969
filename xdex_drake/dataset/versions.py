"""Source grasps of a data set, each with its versions by other hands."""

from __future__ import annotations

from pathlib import Path

from xdex_drake.dataset.files import StoredGrasp, load_grasps
from xdex_drake.dataset.folder import iter_shards


def most_carried(folder: str | Path, *, sources: int = 4, versions: int = 5) -> list[list[StoredGrasp]]:
    """The source grasps that lift by most other hands, one of each scene.

    Args:
        folder: Folder of a data set.
        sources: Greatest number of source grasps.
        versions: Greatest number of versions of each.

    Returns:
        For each source grasp, best first, itself and its versions, all of which lifted; none where none was carried.

    Raises:
        DatasetError: The folder is no data set.
        GraspFileError: A shard is damaged, or names a hand or a mesh that has changed or cannot be found.
    """
    best: dict[str, tuple[int, str, list[str]]] = {}
    for unit, table in iter_shards(folder, ("grasp_id", "source_grasp_id", "scene_id", "success")):
        lifted = [row for row in table.to_pylist() if row["success"]]
        carried: dict[str, list[str]] = {row["grasp_id"]: [] for row in lifted if not row["source_grasp_id"]}
        scene_of = {row["grasp_id"]: row["scene_id"] for row in lifted}
        for row in lifted:
            if row["source_grasp_id"] in carried:
                carried[row["source_grasp_id"]].append(row["grasp_id"])
        for source, others in carried.items():
            if others and len(others) > best.get(scene_of[source], (0,))[0]:
                best[scene_of[source]] = len(others), unit, [source, *others[:versions]]
    found = sorted(best.values(), key=lambda entry: (-entry[0], entry[1]))[:sources]
    groups = []
    for _, unit, ids in found:
        stored = {item.grasp.grasp_id: item for item in load_grasps(Path(folder) / "shards" / f"{unit}.parquet")}
        groups.append([stored[grasp_id] for grasp_id in ids])
    return groups
