"""Grasps in some 60 bytes each: what cannot be computed again, unit by unit, in 16-bit numbers.

A unit of a data set becomes one record: a header (scene, hands, names of its source grasps, what was rejected) and a
row a grasp: wrist position in a box about the object, the rotation's three smallest quaternion parts, joint values over
their limits, which slots touch, which grasp it came from, and how its lifts ended. Certificate, pre-grasp, approach and
squeeze are computed again by `grasping.restore`.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.dataset.folder import Rejected
from xdex_drake.errors import DatasetError, XdexError
from xdex_drake.grasp import Certificate, Grasp, Hold, Lift
from xdex_drake.hand.description import Hand
from xdex_drake.programs.grasp_types import contact_slots
from xdex_drake.scene.facts import SceneFacts
from xdex_drake.scene.tabletop import Scene
from xdex_drake.typed_yaml import from_plain

BOX = 0.5
"""Half the side of the box about the object's center of mass in which wrists are stored [m]; steps of 15 um."""

FULL = 65535
"""Greatest number of 16 bits; among lengths and angles it stands for none."""

_HALF = 2.0**-0.5
_NO_HOLD = 255


@dataclass(frozen=True)
class CompactHand:
    """A hand of a compact unit, and what its rows hold.

    Attributes:
        name: Name.
        path: Name or path by which it is loaded.
        digest: Digest of its description.
        joints: Number of actuated joints.
        rows: Number of its grasps.
    """

    name: str
    path: str
    digest: str
    joints: int
    rows: int


@dataclass(frozen=True)
class CompactHeader:
    """What the rows of a compact unit share.

    Attributes:
        unit: Name of the unit.
        scene: The scene.
        hands: The hands, in the order of their rows.
        source_ids: Identifiers of the grasps that come from no other, in the order of their rows.
        protocols: Names of protocols; rows hold their numbers.
        reasons: Reasons of failed lifts and holds, the first empty; rows hold their numbers.
        rejected: Hand, number of the source among `source_ids` and reason of what found nothing.
        notes: What else the unit's shard says about itself.
    """

    unit: str
    scene: SceneFacts
    hands: tuple[CompactHand, ...]
    source_ids: tuple[str, ...]
    protocols: tuple[str, ...]
    reasons: tuple[str, ...]
    rejected: tuple[Any, ...]
    notes: dict[str, str]


@dataclass(frozen=True, eq=False)
class CompactUnit:
    """A unit of work as it is stored: a header, and for each hand an array of `row_type`."""

    header: CompactHeader
    rows: tuple[NDArray[Any], ...]


def row_type(joints: int) -> np.dtype[Any]:
    """What is stored of a grasp by a hand with some actuated joints: 28 bytes and two for each joint."""
    return np.dtype(
        [
            ("p", "<u2", 3),
            ("largest", "u1"),
            ("quaternion", "<u2", 3),
            ("q", "<u2", joints),
            ("slots", "<u2"),
            ("source", "<u2"),
            ("protocol", "u1"),
            ("reason", "u1"),
            ("rise", "<u2"),
            ("tips", "<u2"),
            ("hold", "u1"),
            ("slip", "<u2"),
            ("turn", "<u2"),
        ]
    )


# Grasps to rows -------------------------------------------------------------------------------------------------------


def compact_unit(
    unit: str,
    scene: Scene,
    grasps: Sequence[tuple[Hand, str, str, Sequence[Grasp]]],
    *,
    rejected: Iterable[Rejected] = (),
    notes: Mapping[str, str] | None = None,
) -> CompactUnit:
    """A unit's grasps in few bytes.

    Args:
        unit: Name of the unit.
        scene: Its scene.
        grasps: Each hand with its path and digest, and its grasps, all lifted; sources before what came from them.
        rejected: What found nothing.
        notes: What else to keep about the unit.

    Returns:
        The unit; equal grasps give equal bytes.

    Raises:
        DatasetError: A grasp was not certified and lifted, lies outside the box, comes from a grasp that is not in the
            unit, or has an identifier that is not formed from its source's.
    """
    everything = [grasp for *_, some in grasps for grasp in some]
    sources = tuple(grasp.grasp_id for grasp in everything if not grasp.source_grasp_id)
    lifts = [_lift_of(grasp) for grasp in everything]
    failures = {lift.failure_reason for lift in lifts} | {lift.hold.reason for lift in lifts if lift.hold is not None}
    protocols = tuple(sorted({lift.protocol for lift in lifts}))
    reasons = ("", *sorted(failures - {""}))
    number = {name: k for k, name in enumerate(sources)}
    header = CompactHeader(
        unit=unit,
        scene=SceneFacts.of(scene),
        hands=tuple(CompactHand(h.name, path, digest, len(h.q_rest), len(some)) for h, path, digest, some in grasps),
        source_ids=sources,
        protocols=protocols,
        reasons=reasons,
        rejected=tuple([r.hand, _source_number(r.source_grasp_id, number), r.reason] for r in rejected),
        notes=dict(notes or {}),
    )
    rows = []
    for hand, *_, some in grasps:
        table = np.zeros(len(some), row_type(len(hand.q_rest)))
        for row, grasp in zip(table, some, strict=True):
            _fill(row, grasp, hand, _center(scene), header, number)
        rows.append(table)
    return CompactUnit(header, tuple(rows))


def _fill(row: Any, grasp: Grasp, hand: Hand, center: Array, header: CompactHeader, number: Mapping[str, int]) -> None:
    """Writes a grasp into its row."""
    if grasp.source_grasp_id and grasp.grasp_id != f"{grasp.source_grasp_id}>{hand.name}":
        raise DatasetError(f"grasp {grasp.grasp_id}: the identifier is not its source's and the hand's")
    low, high = hand.limits
    row["p"] = _to_16_bits(grasp.X_WH.translation(), center - BOX, center + BOX, f"grasp {grasp.grasp_id}: the wrist")
    quaternion = grasp.X_WH.rotation().ToQuaternion().wxyz()
    largest = int(np.argmax(np.abs(quaternion)))
    rest = np.delete(quaternion, largest) * (1.0 if quaternion[largest] >= 0.0 else -1.0)
    row["largest"], row["quaternion"] = largest, _to_16_bits(rest, -_HALF, _HALF, "a quaternion")
    row["q"] = _to_16_bits(np.clip(grasp.q, low, high), low, high, "a joint")
    row["slots"] = _touching_slots(grasp, hand)
    row["source"] = (
        number[grasp.grasp_id] if not grasp.source_grasp_id else _source_number(grasp.source_grasp_id, number)
    )
    lift = _lift_of(grasp)
    names = [finger.name for finger in hand.fingers]
    row["protocol"], row["reason"] = header.protocols.index(lift.protocol), header.reasons.index(lift.failure_reason)
    row["rise"], row["tips"] = _length(lift.lift_height_m + 1.0), sum(1 << names.index(tip) for tip in lift.fingertips)
    row["hold"], row["slip"], row["turn"] = _NO_HOLD, FULL, FULL
    if lift.hold is not None:
        row["hold"] = header.reasons.index(lift.hold.reason)
        row["slip"], row["turn"] = _length(lift.hold.slip_m), _length(lift.hold.turn_rad)


def _lift_of(grasp: Grasp) -> Lift:
    if grasp.lift is None or grasp.certificate is None:
        raise DatasetError(
            f"grasp {grasp.grasp_id}: it was not certified and lifted; only such grasps can be compacted"
        )
    return grasp.lift


def _source_number(name: str, number: Mapping[str, int]) -> int:
    if name not in number:
        raise DatasetError(f"grasp {name}: is the source of another grasp, but is not in its unit")
    return number[name]


def _touching_slots(grasp: Grasp, hand: Hand) -> int:
    """The slots that touch by the certificate, a bit each."""
    assert isinstance(grasp.certificate, Certificate)
    links = {hand.link_index[contact.link] for contact in grasp.certificate.contacts}
    return sum(1 << k for k, slot in enumerate(contact_slots(hand)) if slot.link in links)


def _center(scene: Scene) -> Array:
    return scene.X_WO @ scene.object.p_OOcm


def _to_16_bits(values: Array, low: Array | float, high: Array | float, what: str) -> NDArray[np.uint16]:
    """Values as fractions of a range."""
    width = np.maximum(np.asarray(high) - low, 1e-12)
    fractions = (values - low) / width
    if not (np.all(fractions >= -1e-9) and np.all(fractions <= 1.0 + 1e-9)):
        raise DatasetError(f"{what} is out of the range in which it is stored")
    return np.round(FULL * np.clip(fractions, 0.0, 1.0)).astype(np.uint16)


def _from_16_bits(numbers: NDArray[Any], low: Array | float, high: Array | float) -> Array:
    return low + (np.asarray(high) - low) * (numbers.astype(float) / FULL)


def _length(value: float) -> int:
    """A length or an angle in steps of 1e-4, up to 6.5534; `FULL` where it is not known."""
    return FULL if np.isnan(value) else int(np.clip(round(1e4 * value), 0, FULL - 1))


def _from_length(number: int) -> float:
    return float("nan") if number == FULL else 1e-4 * int(number)


# Rows to grasps -------------------------------------------------------------------------------------------------------


def pose_of_row(row: Any, hand: Hand, scene: Scene) -> tuple[RigidTransform, Array, NDArray[np.bool_]]:
    """Wrist pose, joint values and touching slots of a row.

    Args:
        row: The row.
        hand: Its hand.
        scene: Its scene.

    Returns:
        X_WH, q of shape (n,), and which slots touch, shape (n_fingers + 1,), the palm last.
    """
    center = _center(scene)
    p_WH = _from_16_bits(row["p"], center - BOX, center + BOX)
    rest = _from_16_bits(row["quaternion"], -_HALF, _HALF)
    wxyz = np.insert(rest, int(row["largest"]) % 4, np.sqrt(max(0.0, 1.0 - float(rest @ rest))))
    X_WH = RigidTransform(RotationMatrix(Quaternion(wxyz=wxyz / np.linalg.norm(wxyz))), p_WH)
    slots = np.array([int(row["slots"]) >> k & 1 for k in range(len(hand.fingers) + 1)], dtype=bool)
    return X_WH, _from_16_bits(row["q"], *hand.limits), slots


def lift_of_row(row: Any, hand: Hand, header: CompactHeader) -> Lift:
    """How the lift of a row ended; its seconds are 0."""
    hold = None
    if row["hold"] != _NO_HOLD:
        reason = header.reasons[row["hold"]]
        hold = Hold(not reason, reason, _from_length(row["slip"]), _from_length(row["turn"]))
    reason = header.reasons[row["reason"]]
    tips = tuple(finger.name for k, finger in enumerate(hand.fingers) if int(row["tips"]) >> k & 1)
    return Lift(header.protocols[row["protocol"]], not reason, reason, _from_length(row["rise"]) - 1.0, tips, 0.0, hold)


def ids_of_row(row: Any, hand: CompactHand, header: CompactHeader, *, is_source: bool) -> tuple[str, str]:
    """Identifier of a row's grasp and of its source, empty where it is one itself."""
    source = header.source_ids[row["source"]]
    return (source, "") if is_source else (f"{source}>{hand.name}", source)


def is_source_row(header: CompactHeader) -> tuple[NDArray[np.bool_], ...]:
    """For each hand, which of its rows come from no other grasp: the first rows of the unit, as many as sources."""
    left, found = len(header.source_ids), []
    for hand in header.hands:
        found.append(np.arange(hand.rows) < left)
        left -= min(left, hand.rows)
    return tuple(found)


def rejected_of(header: CompactHeader) -> tuple[Rejected, ...]:
    """What the unit tried without finding a grasp."""
    return tuple(
        Rejected(str(hand), header.source_ids[source], str(reason)) for hand, source, reason in header.rejected
    )


# Units to bytes -------------------------------------------------------------------------------------------------------


def to_bytes(unit: CompactUnit) -> bytes:
    """A unit as it is stored; its digest is over these bytes."""
    text = json.dumps(asdict(unit.header), sort_keys=True, separators=(",", ":"), allow_nan=False)
    header = zlib.compress(text.encode(), 9)
    return struct.pack("<I", len(header)) + header + b"".join(rows.tobytes() for rows in unit.rows)


def from_bytes(data: bytes, where: str) -> CompactUnit:
    """A unit from its bytes.

    Args:
        data: What `to_bytes` gave.
        where: Where they come from, for the message.

    Returns:
        The unit.

    Raises:
        DatasetError: The bytes are not those of a unit.
    """
    try:
        (length,) = struct.unpack_from("<I", data)
        text = zlib.decompressobj().decompress(data[4 : 4 + length], 1 << 24)
        header = from_plain(json.loads(text), CompactHeader, where, error=DatasetError)
        rows, position = [], 4 + length
        for hand in header.hands:
            kind = row_type(hand.joints)
            rows.append(np.frombuffer(data, kind, hand.rows, position))
            position += hand.rows * kind.itemsize
        if position != len(data):
            raise ValueError("its length is wrong")
        _check(CompactUnit(header, tuple(rows)))
    except XdexError:
        raise
    except (struct.error, zlib.error, ValueError, TypeError, IndexError) as error:
        raise DatasetError(f"{where}: is no unit of grasps: {error}") from error
    return CompactUnit(header, tuple(rows))


def digest_of(unit: CompactUnit) -> str:
    """SHA-256 of a unit's bytes."""
    return hashlib.sha256(to_bytes(unit)).hexdigest()


def _check(unit: CompactUnit) -> None:
    """Raises where a number of a row points beyond its list."""
    header = unit.header
    for rows in unit.rows:
        beyond = (
            (rows["source"] >= len(header.source_ids)).any()
            or (rows["protocol"] >= len(header.protocols)).any()
            or (rows["reason"] >= len(header.reasons)).any()
            or ((rows["hold"] >= len(header.reasons)) & (rows["hold"] != _NO_HOLD)).any()
        )
        if beyond:
            raise ValueError("a row names what its header does not")
    for entry in header.rejected:
        if len(entry) != 3 or not 0 <= int(entry[1]) < len(header.source_ids):
            raise ValueError("what was rejected names a source that the header does not")
