"""From a data set of grasps to the training pack. Rows are read by columns: never as one Python object each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pydrake.math import RigidTransform
from scipy.spatial.transform import Rotation

from xdex_drake.arrays import Array
from xdex_drake.dataset.assets import hand_finder, object_finder
from xdex_drake.dataset.folder import read_dataset
from xdex_drake.dataset.schema import SCHEMA, ObjectFacts, object_facts_from_row
from xdex_drake.dataset.tables import read_units, table_files
from xdex_drake.errors import DatasetError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.jobs.compaction import plain_rows
from xdex_drake.learning.features import hand_features, link_frames, object_features, object_point
from xdex_drake.learning.pack import NORMAL, HandFeatures, ObjectFeatures, Pack, check_pack, pose_vectors
from xdex_drake.scene.object import ObjectModel

CLOUD = 2048
"""Points kept of each scene; a training step sees a part of them."""

_OBJECT = ("object", "object_path", "object_digest", "object_scale", "mass_kg", "friction", "p_OOcm", "lambda_m")
_COLUMNS = (
    *("grasp_id", "source_grasp_id", "hand", "joint_names", "scene_id", *_OBJECT, "X_WO", "X_WH", "q"),
    *("object_point_O", "source_object_point_O", "success", "failure_reason"),
)


@dataclass(frozen=True)
class Splits:
    """What validates and is not trained on; names that the data set does not hold are passed over.

    Attributes:
        validation_scenes: Names of scenes.
        validation_hands: Names of hands.
    """

    validation_scenes: tuple[str, ...] = ()
    validation_hands: tuple[str, ...] = ()


@dataclass(frozen=True)
class HandGrasps:
    """Grasps of one hand.

    Attributes:
        hand: The hand.
        scene: Index of the scene of each, shape (n,).
        R_WGs: Rotations of the links' frames G in W, shape (n, L, 3, 3).
        p_WGs: Origins of the links' frames G in W [m], shape (n, L, 3).
        p_WPoints: Object points that they head for (their sources', where they were retargeted) in W [m], shape (n, 3).
        pair: Grasps of one scene with one number are versions of one grasp; -1 for none, shape (n,).
        outcome: Index of what became of each among the reasons, 0 for a grasp that lifted, shape (n,).
    """

    hand: HandFeatures
    scene: np.ndarray
    R_WGs: Array
    p_WGs: Array
    p_WPoints: Array
    pair: np.ndarray
    outcome: np.ndarray


def pack_dataset(
    folder: str | Path,
    *,
    splits: Splits | None = None,
    failures: float = 1.0,
    seed: int = 0,
    hands: Callable[[str], Hand] | None = None,
    objects: Callable[[ObjectFacts], ObjectModel] | None = None,
) -> Pack:
    """The grasps of a data set, ready for `training.train`.

    A grasp is conditioned on its source's object point, so that versions of one grasp share it; where the row has none,
    on its own, found by the heading rule where the row has none either. Grasps that were never simulated are left out.

    Args:
        folder: Folder of the data set, or of its compact table.
        splits: What validates; None leaves the choice to training.
        failures: Grasps that did not lift to keep, at most this many for each that did.
        seed: Seed of their choice.
        hands: Finds a hand by the name that rows give it; in the folder, then in the library, where None.
        objects: Finds an object by what rows say about it; in the folder, then by its path, where None.

    Returns:
        The pack.

    Raises:
        DatasetError: The folder is no data set, holds no grasp to learn from, or names other hands or objects than
            those found.
        XdexError: A shard, hand or object cannot be used.
    """
    table = _table_of(folder) if table_files(folder) else read_dataset(folder, _COLUMNS)
    kept = _rows_to_keep(table, failures, np.random.default_rng(seed))
    table = table.take(pa.array(kept)).combine_chunks()
    if len(table) == 0:
        raise DatasetError(f"{folder}: no grasp to learn from; generate more grasps that lift")
    scene, rows = _codes(table["scene_id"])
    scenes = _scenes(table, rows, objects or object_finder(folder))
    outcome, reasons = _outcomes(table)
    pair = _pairs(table, scene, len(scenes))
    grasps = list(_grasps_by_hand(table, hands or hand_finder(folder), scenes, scene, pair, outcome))
    return make_pack(scenes, grasps, reasons, splits=splits, notes={"rows": len(table)})


def make_pack(
    scenes: Sequence[ObjectFeatures],
    grasps: Sequence[HandGrasps],
    reasons: Sequence[str] = ("",),
    *,
    splits: Splits | None = None,
    notes: dict[str, Any] | None = None,
) -> Pack:
    """A pack of features and link poses.

    Args:
        scenes: The scenes, of one number of points.
        grasps: The grasps, hand by hand, each with at least one.
        reasons: What the numbers of `outcome` mean, the first "".
        splits: What validates.
        notes: What else the pack says, as JSON.

    Returns:
        The pack.

    Raises:
        DatasetError: The arrays contradict each other, or hold numbers that are not finite.
    """
    if not grasps or not scenes:
        raise DatasetError("training pack: no grasp to learn from")
    hands, splits = [part.hand for part in grasps], splits or Splits()
    names = tuple(sorted({name for hand in hands for name in hand.keypoint_names}))
    links, offsets = np.full((len(hands), len(names)), -1), np.zeros((len(hands), len(names), 3))
    for h, hand in enumerate(hands):
        columns = [names.index(name) for name in hand.keypoint_names]
        links[h, columns], offsets[h, columns] = hand.keypoint_links, hand.keypoint_offsets
    centers = np.array([scene.p_WCenter for scene in scenes])
    scene = np.concatenate([part.scene for part in grasps])
    points = np.concatenate([part.p_WPoints for part in grasps])
    if min(scene.min(), len(scenes) - 1 - scene.max()) < 0:
        raise DatasetError("training pack: a grasp names a scene that is not there")

    def vectors(part: HandGrasps) -> Array:
        shape = (len(part.scene), *part.hand.R_LGs.shape)
        if part.R_WGs.shape != shape or part.p_WGs.shape != shape[:-1]:
            raise DatasetError(f"training pack: grasps of {part.hand.name} do not have its {shape[1]} links")
        return pose_vectors(part.R_WGs, part.p_WGs - part.p_WPoints[:, None]).reshape(-1, 9)

    def joined(arrays: Sequence[np.ndarray], kind: type[np.generic]) -> np.ndarray:
        with np.errstate(over="ignore"):  # what is too large becomes infinite, and is refused below
            return np.concatenate([array.astype(kind) for array in arrays])

    pack = Pack(
        hand_names=tuple(hand.name for hand in hands),
        keypoint_names=names,
        scene_names=tuple(scene.name for scene in scenes),
        reasons=tuple(reasons),
        links=np.array([len(hand.link_names) for hand in hands], dtype=np.int32),
        link_points=joined([hand.link_points for hand in hands], np.float16),
        link_normals=joined([np.rint(NORMAL * hand.link_normals) for hand in hands], np.int8),
        link_centers=joined([hand.centers for hand in hands], np.float32),
        link_joints=joined([hand.joints for hand in hands], np.float16),
        spd=joined([hand.spd.ravel() for hand in hands], np.uint8),
        keypoint_links=links.astype(np.int16),
        keypoint_offsets=offsets.astype(np.float32),
        clouds=joined([scene.points[None] for scene in scenes], np.float16),
        cloud_normals=joined([np.rint(NORMAL * scene.normals[None]) for scene in scenes], np.int8),
        centers=centers.astype(np.float32),
        hand=np.repeat(np.arange(len(hands), dtype=np.int32), [len(part.scene) for part in grasps]),
        scene=scene.astype(np.int32),
        pair=joined([part.pair for part in grasps], np.int32),
        outcome=joined([part.outcome for part in grasps], np.int16),
        points=(points - centers[scene]).astype(np.float32),
        vectors=joined([vectors(part) for part in grasps], np.float16),
        held_scenes=np.array([scene.name in splits.validation_scenes for scene in scenes], dtype=np.uint8),
        held_hands=np.array([hand.name in splits.validation_hands for hand in hands], dtype=np.uint8),
        notes=notes or {},
    )
    check_pack(pack)
    return pack


def _table_of(folder: str | Path) -> pa.Table:
    """The columns of a compact table's grasps; certificates are not needed, and not computed."""
    schema = pa.schema([SCHEMA.field(name) for name in _COLUMNS])
    units = [
        pa.Table.from_pylist([{name: row[name] for name in _COLUMNS} for row in plain_rows(unit, folder)], schema)
        for unit in read_units(folder)
    ]
    return pa.concat_tables([schema.empty_table(), *units])


def _rows_to_keep(table: pa.Table, failures: float, rng: np.random.Generator) -> np.ndarray:
    """Rows of grasps that lifted and, thinned by chance, of grasps that did not."""
    success = table["success"].to_numpy(zero_copy_only=False).astype(object)
    lifted = np.flatnonzero(success == True)  # noqa: E712 - None where it was never simulated
    failed = np.flatnonzero(success == False)  # noqa: E712
    return np.sort(np.concatenate([lifted, rng.permutation(failed)[: int(failures * len(lifted))]]))


def _codes(column: pa.ChunkedArray) -> tuple[np.ndarray, np.ndarray]:
    """Number of each row's text in the order of first appearance, and the row in which each text appears first."""
    codes = column.combine_chunks().dictionary_encode().indices.to_numpy()
    _, rows = np.unique(codes, return_index=True)
    return codes, rows


def _scenes(table: pa.Table, rows: np.ndarray, objects: Callable[[ObjectFacts], ObjectModel]) -> list[ObjectFeatures]:
    """Features of the scenes that begin at some rows."""
    samples_O: dict[str, tuple[Array, Array]] = {}
    scenes = []
    for row in table.select(["grasp_id", "scene_id", "X_WO", *_OBJECT]).take(pa.array(rows)).to_pylist():
        facts = object_facts_from_row(row)
        if facts.digest not in samples_O:
            samples_O[facts.digest] = objects(facts).surface_samples(CLOUD)
        p_OPs, n_OPs = samples_O[facts.digest]
        R, p = _poses(np.array([row["X_WO"]]), [row["grasp_id"]])
        p_WCenter = R[0] @ facts.p_OOcm + p[0]
        points, normals = p_OPs @ R[0].T + p[0], n_OPs @ R[0].T
        scenes.append(object_features(points, p_WCenter, count=CLOUD, name=row["scene_id"], n_WPoints=normals))
    return scenes


def _outcomes(table: pa.Table) -> tuple[np.ndarray, tuple[str, ...]]:
    """Index of each row's outcome, and what the indices mean; the first is that of grasps that lifted."""
    why = table["failure_reason"].fill_null("not told").to_numpy()
    found, index = np.unique(np.where(table["success"].to_numpy(), "", why).astype(str), return_inverse=True)
    return index, tuple(str(reason) for reason in found)


def _pairs(table: pa.Table, scene: np.ndarray, scenes: int) -> np.ndarray:
    """Number of the grasp of its scene that each row is a version of."""
    source, own = table["source_grasp_id"].to_numpy(), table["grasp_id"].to_numpy()
    _, codes = np.unique(np.where(source == "", own, source).astype(str), return_inverse=True)
    return np.unique(codes * scenes + scene, return_inverse=True)[1]


def _grasps_by_hand(
    table: pa.Table,
    hands: Callable[[str], Hand],
    scenes: Sequence[ObjectFeatures],
    scene: np.ndarray,
    pair: np.ndarray,
    outcome: np.ndarray,
) -> Iterator[HandGrasps]:
    """The grasps of each hand, in the order of its first appearance."""
    of_hand, firsts = _codes(table["hand"])
    names = [str(table["hand"][int(row)]) for row in firsts]
    order = np.argsort(of_hand, kind="stable")
    for name, rows in zip(names, np.split(order, np.flatnonzero(np.diff(of_hand[order])) + 1), strict=True):
        hand, part = hands(name), table.take(pa.array(rows)).combine_chunks()
        R_WLs, p_WLs = _link_poses(hand, part)
        p_WPoints = _object_points(part)
        for k in np.flatnonzero(np.isnan(p_WPoints[:, 0])):
            cloud = scenes[int(scene[rows[k]])]
            p_WCloud = cloud.points + cloud.p_WCenter
            p_WPoints[k] = p_WCloud[object_point(hand, R_WLs[k], p_WLs[k], p_WCloud)]
        features = hand_features(hand)
        R_WGs, p_WGs = link_frames(features, R_WLs, p_WLs)
        yield HandGrasps(features, scene[rows], R_WGs, p_WGs, p_WPoints, pair[rows], outcome[rows])


def _link_poses(hand: Hand, table: pa.Table) -> tuple[Array, Array]:
    """Link poses of the rows of one hand, shapes (n, L, 3, 3) and (n, L, 3)."""
    n, first = len(hand.joint_names), table["grasp_id"][0]
    joints = _flat(table["joint_names"]).dictionary_encode()
    number = {name: k for k, name in enumerate(hand.joint_names)}
    named = np.array([number.get(name, -1) for name in joints.dictionary.to_pylist()])[joints.indices.to_numpy()]
    if not np.array_equal(named, np.tile(np.arange(n), len(table))):
        raise DatasetError(
            f"grasps of hand {hand.name}, {first} among them: joint_names are not those of the hand; restore its file"
        )
    q = _flat(table["q"]).to_numpy()
    if len(q) != len(table) * n or not np.isfinite(q).all():
        raise DatasetError(f"grasps of hand {hand.name}, {first} among them: q must have {n} finite numbers")
    R_WH, p_WH = _poses(_rows_of_numbers(table["X_WH"], 7), table["grasp_id"])
    R_HLs, p_HLs = forward_kinematics(hand, RigidTransform(), q.reshape(-1, n))
    return R_WH[:, None] @ R_HLs, p_HLs @ R_WH.transpose(0, 2, 1) + p_WH[:, None]


def _object_points(table: pa.Table) -> Array:
    """Object points that rows store, their sources' where they have one, in W [m], shape (n, 3); nan for none."""
    R, p = _poses(_rows_of_numbers(table["X_WO"], 7), table["grasp_id"])
    p_OPoints = np.full((len(table), 3), np.nan)
    for name in ("object_point_O", "source_object_point_O"):
        column = table[name]
        p_OPoints[column.is_valid().to_numpy()] = _rows_of_numbers(column.drop_null(), 3)
    return np.einsum("nij,nj->ni", R, p_OPoints) + p


def _poses(numbers: Array, ids: Sequence[Any] | pa.ChunkedArray) -> tuple[Array, Array]:
    """Rotations and origins of stored poses (x, y, z, qw, qx, qy, qz), shape (n, 7)."""
    wrong = ~np.isfinite(numbers).all(axis=1) | ~(np.abs(np.linalg.norm(numbers[:, 3:], axis=1) - 1.0) < 1e-6)
    if wrong.any():
        raise DatasetError(
            f"grasp {ids[int(np.argmax(wrong))]}: a pose is not one, with a unit quaternion; make it again"
        )
    return Rotation.from_quat(numbers[:, [4, 5, 6, 3]]).as_matrix(), numbers[:, :3]


def _flat(column: pa.ChunkedArray) -> pa.Array:
    """All entries of a column of lists, one after the other."""
    return column.combine_chunks().flatten()


def _rows_of_numbers(column: pa.ChunkedArray, width: int) -> Array:
    """A column of lists of one length as an array."""
    return _flat(column).to_numpy(zero_copy_only=False).reshape(-1, width)
