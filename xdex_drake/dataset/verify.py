"""Checks a whole data set: shards, rows, certificates, sources."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from xdex_drake.contact.certificate import check_certificate
from xdex_drake.dataset.assets import ASSETS, hand_finder, object_finder
from xdex_drake.dataset.folder import Manifest, read_manifest, shard_paths
from xdex_drake.dataset.grasp_file import read_grasps
from xdex_drake.dataset.schema import Row, grasp_from_row, object_facts_from_row
from xdex_drake.errors import GraspFileError, XdexError


@dataclass(frozen=True)
class Fault:
    """Something wrong with a data set.

    Attributes:
        unit: The unit whose shard it is in, empty where it is in none.
        grasp_id: The grasp, empty where the whole shard is meant.
        reason: What is wrong.
    """

    unit: str
    grasp_id: str
    reason: str


@dataclass(frozen=True)
class VerifyReport:
    """What a check of a whole data set showed.

    Attributes:
        shards: Number of shards that were found.
        rows: Number of rows that could be read.
        successes: Number of rows whose lift succeeded.
        certificates_checked: Number of certificates that were checked again.
        missing_units: Planned units that have no shard yet.
        problems: Everything that is wrong.
    """

    shards: int
    rows: int
    successes: int
    certificates_checked: int
    missing_units: tuple[str, ...]
    problems: tuple[Fault, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong; units that are still to be made are not wrong."""
        return not self.problems


def verify(folder: str | Path) -> VerifyReport:
    """Checks a whole data set: its shards, its rows, their certificates and where they come from.

    Every shard can be read to its last byte and has the schema; no grasp has the identifier of another; every row is a
    grasp; a grasp whose lift succeeded has a certificate that holds, checked in plain NumPy without a solver; every
    source grasp is there; hands and objects are those of the manifest, and the copies of their files those of the rows.

    Args:
        folder: Folder of the data set.

    Returns:
        What was found; nothing wrong with the data is raised as an error.

    Raises:
        DatasetError: The folder is no data set.
    """
    manifest = read_manifest(folder)
    faults: list[Fault] = []
    unit_of: dict[str, str] = {}
    source_of: list[tuple[str, str, str]] = []
    shards = rows = successes = checked = 0
    seen_units = set()
    objects: dict[str, Row] = {}
    for path in shard_paths(folder):
        unit = path.name.removesuffix(".parquet")
        seen_units.add(unit)
        shards += 1
        if unit not in manifest.units:
            faults.append(Fault(unit, "", "the manifest does not plan this unit"))
        try:
            shard_rows = read_grasps(path)
        except GraspFileError as error:
            faults.append(Fault(unit, "", str(error)))
            continue
        for row in shard_rows:
            rows += 1
            objects.setdefault(row["object_digest"], row)
            grasp_id = row["grasp_id"]
            if grasp_id in unit_of:
                faults.append(Fault(unit, grasp_id, f"the identifier is that of a grasp of {unit_of[grasp_id]}, too"))
            unit_of.setdefault(grasp_id, unit)
            if row["source_grasp_id"]:
                source_of.append((unit, grasp_id, row["source_grasp_id"]))
            successes += row["success"] is True
            reasons, was_checked = _row_faults(row, manifest)
            checked += was_checked
            faults.extend(Fault(unit, grasp_id, reason) for reason in reasons)
    faults.extend(
        Fault(unit, grasp_id, f"its source grasp {source} is not in the data set")
        for unit, grasp_id, source in source_of
        if source not in unit_of
    )
    faults.extend(Fault("", "", reason) for reason in _asset_faults(folder, manifest, objects.values()))
    missing = tuple(unit for unit in manifest.units if unit not in seen_units)
    return VerifyReport(shards, rows, successes, checked, missing, tuple(faults))


def _row_faults(row: Row, manifest: Manifest) -> tuple[list[str], bool]:
    """What is wrong with a row, and whether its certificate was checked again."""
    reasons = []
    for kind in ("hand", "object"):
        expected = manifest.digests.get(f"{kind}/{row[kind]}")
        if expected is not None and expected != row[f"{kind}_digest"]:
            reasons.append(f"{kind} {row[kind]} has another digest than in the manifest")
    try:
        grasp = grasp_from_row(row)
    except GraspFileError as error:
        return [*reasons, str(error)], False
    if grasp.lift is None or not grasp.lift.success:
        return reasons, False
    if grasp.certificate is None:
        return [*reasons, "its lift succeeded, but it has no certificate"], False
    residuals = check_certificate(grasp.certificate)
    return reasons if residuals.passes() else [*reasons, f"its certificate does not hold: {residuals}"], True


def _asset_faults(folder: str | Path, manifest: Manifest, rows: Iterable[Row]) -> Iterator[str]:
    """What is wrong with the hands and meshes in the folder; a row for each mesh."""
    find_hand, find_object = hand_finder(folder), object_finder(folder)
    for name in (key.removeprefix("hand/") for key in manifest.digests if key.startswith("hand/")):
        try:
            find_hand(name)
        except XdexError as error:
            yield str(error)
    for row in rows:
        if row["object_path"].startswith(f"{ASSETS}/"):
            try:
                find_object(object_facts_from_row(row))
            except XdexError as error:
                yield f"object {row['object']}: {error}"
