"""What the model is told about hands and objects, and the training pack: all that training needs, in one file.

Plain arrays; NumPy and safetensors suffice to read them.

Everything of one kind lies in one array, one after the other: the links of all hands, the grasps hand by hand, the link
pose vectors grasp by grasp. Lengths that the networks see are in 16 bits, which errs by at most 0.12 mm at 0.5 m, and
normals in 8, by 0.3 degrees.
Grasps are relative to their object points, object points and clouds to the center of their object, axes of W (z up).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from xdex_drake.errors import DatasetError
from xdex_drake.learning.tensor_file import Description, FileType, describe, read_arrays, versions, write_tensor_file

FEATURE_SCHEMA = 2
"""Version of what the arrays mean that a model sees; a checkpoint or a pack of another version is refused."""
PACK_SCHEMA = 2
"""Version of the file's arrays."""
JOINT_FEATURES = 14
"""Numbers that say how a link's joint moves it; see `features.hand_features`."""
NORMAL = 127
"""Length of a unit normal in a pack."""
LIFTED = 0
"""Outcome of a grasp that lifted."""

_PACK = FileType(
    "training pack", "make one with `xdex dataset pack`", "pack the data set again, or get the file again", DatasetError
)


@dataclass(frozen=True)
class HandFeatures:
    """A hand as the model sees it: L tokens, links with frames G whose axes are those of H in the rest posture.

    Attributes:
        name: Name of the hand.
        links: Index of each token's link in the description, the base first, shape (L,), int64.
        link_names: Names of these links.
        link_points: Points on the surface of each link, in H at the rest posture [m], shape (L, N, 3).
        link_normals: Unit normals out of the links there, zero for a link without geometry, shape (L, N, 3).
        centers: Mean of each link's points, the origin of G, in H at the rest posture [m], shape (L, 3).
        joints: How each link's own joint moves it; see `features._joint_features`, shape (L, 14).
        spd: Number of joints on the path between two links, shape (L, L), int64.
        R_LGs: Rotations of G in the description's link frames, shape (L, 3, 3).
        p_LGs: Origins of G in the description's link frames [m], shape (L, 3).
        keypoint_names: `wrist`, then the fingers in the order of the description.
        keypoint_links: Token of each keypoint, shape (K,), int64.
        keypoint_offsets: From the origin of that token's G to the keypoint, axes of G [m], shape (K, 3).
        digest: Hexadecimal digest of what the model sees of it.
    """

    name: str
    links: np.ndarray
    link_names: tuple[str, ...]
    link_points: np.ndarray
    link_normals: np.ndarray
    centers: np.ndarray
    joints: np.ndarray
    spd: np.ndarray
    R_LGs: np.ndarray
    p_LGs: np.ndarray
    keypoint_names: tuple[str, ...]
    keypoint_links: np.ndarray
    keypoint_offsets: np.ndarray
    digest: str


@dataclass(frozen=True)
class ObjectFeatures:
    """An object in a scene as the model sees it.

    Attributes:
        points: Points on its surface relative to its center, axes of W (z up) [m], shape (N, 3).
        normals: Unit normals out of it, zero where unknown, shape (N, 3).
        p_WCenter: Its center, the center of mass or the mean of the points, in W [m], shape (3,).
        name: Name of the scene.
    """

    points: np.ndarray
    normals: np.ndarray
    p_WCenter: np.ndarray = field(default_factory=lambda: np.zeros(3))
    name: str = ""


@dataclass(frozen=True)
class Pack:
    """What to learn from.

    H hands with L links in all, N points on each link, K names of keypoints; S scenes of P points; M grasps, hand by
    hand, with V links in all.

    Attributes:
        hand_names: Names of the hands.
        keypoint_names: Names of the keypoints of all hands: `wrist` and the fingers.
        scene_names: Names of the scenes.
        reasons: What the numbers of `outcome` mean: the first is empty (it lifted), the others say why it did not.
        links: Number of tokens (links) of each hand, shape (H,), int32.
        link_points: Points on the links, in H at the rest posture [m], shape (L, N, 3), float16.
        link_normals: Normals out of the links there, of length 127, zero for a link without geometry, shape (L, N, 3),
            int8.
        link_centers: Origins of the links' frames G in H at the rest posture [m], shape (L, 3), float32.
        link_joints: How each link's own joint moves it, shape (L, 14), float16.
        spd: Number of joints between two links of a hand, hand by hand, shape (sum of links^2,), uint8.
        keypoint_links: Index of each keypoint's link in its hand, -1 where the hand has none, shape (H, K), int16.
        keypoint_offsets: From the origin of the link's G to the keypoint, axes of G [m], shape (H, K, 3), float32.
        clouds: Points on the objects' surfaces [m], shape (S, P, 3), float16.
        cloud_normals: Normals out of the objects there, of length 127, zero where unknown, shape (S, P, 3), int8.
        centers: Centers of the objects in W, the table at z = 0 [m], shape (S, 3), float32.
        hand: Hand of each grasp, ascending, shape (M,), int32.
        scene: Scene of each grasp, shape (M,), int32.
        pair: Grasps with one number are versions of one grasp of a scene; -1 for none, shape (M,), int32.
        outcome: Index of each grasp's outcome in `reasons`, shape (M,), int16.
        points: Object point that each grasp heads for (its source's, where it was retargeted) [m], shape (M, 3),
            float32.
        vectors: Link pose vectors: origins of G from the object point [m], then the first two columns of R_WG, shape
            (V, 9), float16.
        held_scenes: 1 for scenes that validate and are not trained on, shape (S,), uint8.
        held_hands: The same for hands, shape (H,), uint8.
        notes: What else the file says, as JSON.
    """

    hand_names: tuple[str, ...]
    keypoint_names: tuple[str, ...]
    scene_names: tuple[str, ...]
    reasons: tuple[str, ...]
    links: np.ndarray
    link_points: np.ndarray
    link_normals: np.ndarray
    link_centers: np.ndarray
    link_joints: np.ndarray
    spd: np.ndarray
    keypoint_links: np.ndarray
    keypoint_offsets: np.ndarray
    clouds: np.ndarray
    cloud_normals: np.ndarray
    centers: np.ndarray
    hand: np.ndarray
    scene: np.ndarray
    pair: np.ndarray
    outcome: np.ndarray
    points: np.ndarray
    vectors: np.ndarray
    held_scenes: np.ndarray
    held_hands: np.ndarray
    notes: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def first_links(self) -> np.ndarray:
        """Row of each hand's first link among all links, shape (H,), int64."""
        return np.cumsum(self.links, dtype=np.int64) - self.links

    @cached_property
    def first_vectors(self) -> np.ndarray:
        """Row of each grasp's first link among all vectors, shape (M,), int64."""
        counts = self.links[self.hand].astype(np.int64)
        return np.cumsum(counts) - counts


_NAMES = ("hand_names", "keypoint_names", "scene_names", "reasons")
_TYPES = {
    "links": "I32", "link_points": "F16", "link_normals": "I8", "link_centers": "F32", "link_joints": "F16",
    "spd": "U8",
    "keypoint_links": "I16", "keypoint_offsets": "F32", "clouds": "F16", "cloud_normals": "I8", "centers": "F32",
    "hand": "I32", "scene": "I32", "pair": "I32", "outcome": "I16", "points": "F32", "vectors": "F16",
    "held_scenes": "U8", "held_hands": "U8",
}  # fmt: skip


def pose_vectors(R_WGs: np.ndarray, p_WGs: np.ndarray) -> np.ndarray:
    """Link pose vectors of frames: their origins, then the first two columns of their rotations.

    Args:
        R_WGs: Rotations, shape (..., 3, 3).
        p_WGs: Origins [m], shape (..., 3).

    Returns:
        Vectors, shape (..., 9).
    """
    return np.concatenate([p_WGs, R_WGs[..., 0], R_WGs[..., 1]], axis=-1)


def write_pack(pack: Pack, path: str | Path) -> Path:
    """Writes a pack, whole or not at all; the same pack gives the same bytes.

    Args:
        pack: The pack.
        path: A file that ends in `.safetensors`.

    Returns:
        The file.

    Raises:
        DatasetError: The pack contradicts itself, or the file cannot be written.
    """
    file = Path(path)
    check_pack(pack, str(file))
    header = {
        "kind": "pack",
        "pack_schema": PACK_SCHEMA,
        "feature_schema": FEATURE_SCHEMA,
        "versions": versions(),
        **{name: getattr(pack, name) for name in _NAMES},
        "notes": dict(pack.notes),
    }
    try:
        write_tensor_file(file, {name: getattr(pack, name) for name in _TYPES}, header)
    except OSError as error:
        raise DatasetError(f"{file}: cannot be written: {error}; nothing was changed") from error
    return file


def read_pack(path: str | Path) -> Pack:
    """Reads a pack.

    Args:
        path: The file.

    Returns:
        The pack, every number in it within its bounds.

    Raises:
        DatasetError: There is no such file, or it is damaged, cut short, oversized, of another version or no pack.
    """
    file = Path(path)
    described = describe(file, _PACK)
    _check_header(file, described)
    arrays = read_arrays(file, _PACK)
    header = described.header
    entries: dict[str, Any] = {**arrays, **{name: tuple(header[name]) for name in _NAMES}, "notes": header["notes"]}
    pack = Pack(**entries)
    check_pack(pack, str(file))
    return pack


def _check_header(file: Path, described: Description) -> None:
    header = described.header
    if header.get("kind") != "pack":
        raise DatasetError(f"{file}: field 'kind' is {header.get('kind')!r}, not 'pack'; {_PACK.absent}")
    for name, known in (("pack_schema", PACK_SCHEMA), ("feature_schema", FEATURE_SCHEMA)):
        if header.get(name) != known:
            raise DatasetError(
                f"{file}: field '{name}' is {header.get(name)!r} but this version reads {known}; pack again"
            )
    if described.dtypes != _TYPES:
        wrong = sorted(k for k in described.dtypes.keys() | _TYPES if described.dtypes.get(k) != _TYPES.get(k))
        raise DatasetError(f"{file}: array '{wrong[0]}' is missing, unknown or of another type; {_PACK.remedy}")
    for name in _NAMES:
        if not isinstance(header.get(name), list) or not all(isinstance(entry, str) for entry in header[name]):
            raise DatasetError(f"{file}: field '{name}' must list names; {_PACK.remedy}")
    if not isinstance(header.get("notes"), dict):
        raise DatasetError(f"{file}: field 'notes' must be a mapping; {_PACK.remedy}")


def check_pack(pack: Pack, source: str = "training pack") -> None:
    """Refuses a pack whose arrays contradict each other, so that training needs no check of its own.

    Args:
        pack: The pack.
        source: Its file, for the message.

    Raises:
        DatasetError: It does; the message names the array.
    """
    # Ranges of what counts or points first: the shapes of the others follow from it.
    H, S, K, M = len(pack.hand_names), len(pack.scene_names), len(pack.keypoint_names), pack.hand.size
    _check_shape(pack, source, {"links": (H,), "hand": (M,), "scene": (M,), "pair": (M,), "outcome": (M,)})
    if min(H, S, M) == 0:
        raise DatasetError(f"{source}: no grasp to learn from; generate more, or keep other rows than successful ones")
    for name, low, high in (
        ("links", 1, 255),
        ("hand", 0, H - 1),
        ("scene", 0, S - 1),
        ("pair", -1, M - 1),
        ("outcome", 0, len(pack.reasons) - 1),
    ):
        _check_range(pack, source, name, low, high)
    if (np.diff(pack.hand) < 0).any():
        raise DatasetError(f"{source}: array 'hand' must ascend; {_PACK.remedy}")
    L, V = int(pack.links.sum()), int(pack.links[pack.hand].astype(np.int64).sum())
    N, P = pack.link_points.shape[1:2], pack.clouds.shape[1:2]
    if N < (1,) or P < (1,):
        raise DatasetError(f"{source}: arrays 'link_points' and 'clouds' must hold points; {_PACK.remedy}")
    _check_shape(
        pack,
        source,
        {
            "link_points": (L, *N, 3),
            "link_normals": (L, *N, 3),
            "link_centers": (L, 3),
            "link_joints": (L, JOINT_FEATURES),
            "spd": (int((pack.links.astype(np.int64) ** 2).sum()),),
            "keypoint_links": (H, K),
            "keypoint_offsets": (H, K, 3),
            "clouds": (S, *P, 3),
            "cloud_normals": (S, *P, 3),
            "centers": (S, 3),
            "points": (M, 3),
            "vectors": (V, 9),
            "held_scenes": (S,),
            "held_hands": (H,),
        },
    )
    if (pack.keypoint_links < -1).any() or (pack.keypoint_links >= pack.links[:, None]).any():
        raise DatasetError(f"{source}: array 'keypoint_links' names a link that its hand lacks; {_PACK.remedy}")
    for name, kind in _TYPES.items():
        if kind.startswith("F") and not (np.abs(getattr(pack, name)) < 100.0).all():  # what is no number is not below
            raise DatasetError(f"{source}: array '{name}' holds numbers that are no lengths in metres; {_PACK.remedy}")


def _check_shape(pack: Pack, source: str, shapes: Mapping[str, tuple[int, ...]]) -> None:
    for name, shape in shapes.items():
        found = getattr(pack, name).shape
        if found != shape:
            raise DatasetError(f"{source}: array '{name}' has shape {found} instead of {shape}; {_PACK.remedy}")


def _check_range(pack: Pack, source: str, name: str, low: int, high: int) -> None:
    array = getattr(pack, name)
    if int(array.min()) < low or int(array.max()) > high:
        raise DatasetError(f"{source}: array '{name}' holds numbers outside {low}..{high}; {_PACK.remedy}")


assert {entry.name for entry in fields(Pack)} == {*_NAMES, *_TYPES, "notes"}
