"""Judges grasps of any origin: what a certificate, a ruler and simulated protocols say of each, as it is given.

Nothing is moved or mended. Contacts are where the hand's shapes are near the mesh; what a file does not carry, a
pre-grasp or a squeeze, is made by the same rule for every method.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from xdex_drake.arrays import Array
from xdex_drake.contact.certificate import CertificateResult, certify
from xdex_drake.contact.cones import contact_frames, effort_map
from xdex_drake.contact.grasp_map import Effort
from xdex_drake.contact.held_object import HeldObject
from xdex_drake.errors import GraspFileError
from xdex_drake.grasp import Grasp, Lift
from xdex_drake.grasping.finish import penetrations
from xdex_drake.grasping.pregrasp import NO_CONTACTS, pregrasp
from xdex_drake.grasping.squeeze import squeeze_by_rule, squeezed
from xdex_drake.grasping.true_shapes import lowest_height, nearest_points, patch_normals
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.interchange.naming import HandRecord
from xdex_drake.jobs.ordered import in_order
from xdex_drake.jobs.stored import SIMULATORS, LiftUnit, lost_lift
from xdex_drake.jobs.workbench import hand_of, scene_of
from xdex_drake.programs.point import Point
from xdex_drake.scene.facts import SceneFacts
from xdex_drake.scene.object import ObjectModel
from xdex_drake.scene.tabletop import OFF_TABLE, Scene, make_scene, stable_poses
from xdex_drake.simulation.protocol import find_protocol
from xdex_drake.whole_file import whole_file

TOUCH = 2e-3
"""Gap up to which a link counts as touching, and depth up to which it may be inside [m]."""

PENETRATION = 2e-3
"""Greatest depth of a certified grasp [m]."""

LIMITS = 2e-3
"""How far a joint of a certified grasp may be beyond its limits, or off its coupling law [rad or m]."""

SAFETY = (0.55, 0.7, 0.85, 0.95)
"""Fractions of the friction that a certificate's forces try in turn."""


@dataclass(frozen=True)
class Judgement:
    """What was found of one grasp.

    Attributes:
        name: Its name.
        certified: Whether forces at its contacts hold the object, within limits and without deep penetration.
        reason: Why it is not certified; empty where it is.
        contacts: Links that touch.
        task_margin: Multiple of pushes of the object's weight that it resists, NaN where it is not held.
        ball_margin: Lower bound of the ball margin, NaN where it is not held.
        penetration_m: Depth of the deepest object point in the hand, against parts and mesh [m].
        beyond_limits: How far a joint is beyond its limits, or off its coupling law [rad or m].
        made: What the file lacked and was made by rule: `pregrasp`, `squeeze`.
        verdicts: What each protocol in each simulator showed, in the order in which they were asked.
    """

    name: str
    certified: bool
    reason: str
    contacts: tuple[str, ...]
    task_margin: float
    ball_margin: float
    penetration_m: float
    beyond_limits: float
    made: tuple[str, ...]
    verdicts: tuple[Lift, ...]


@dataclass(frozen=True)
class JudgeUnit:
    """A grasp to be judged, by plain facts.

    Attributes:
        index: Its place in the file.
        grasp: The grasp in its scene; pre-grasp and squeeze may be missing.
        scene: The scene.
        hand: Name or path of the hand.
        off_coupling: How far the file's coupled joints are off their laws [rad or m].
        protocols: Names of protocols.
        simulators: Names of simulators.
    """

    index: int
    grasp: Grasp
    scene: SceneFacts
    hand: str
    off_coupling: float
    protocols: tuple[str, ...]
    simulators: tuple[str, ...]


def judge_all(units: Sequence[JudgeUnit], *, workers: int = 2) -> Iterator[tuple[JudgeUnit, Judgement, Grasp]]:
    """Judges grasps.

    Args:
        units: The grasps.
        workers: Number of processes; 0 works in this one.

    Yields:
        Each unit in order, what was found, and the grasp as it was simulated; one whose process crashed has failed.
    """
    for done in in_order(units, judge, workers=min(workers, len(units))):
        if done.value is not None:
            yield done.unit, *done.value
            continue
        assert done.failure is not None
        lost = tuple(lost_lift(lift_unit, done.failure) for lift_unit in _lifts(done.unit))
        nan = float("nan")
        found = Judgement(done.unit.grasp.grasp_id, False, str(done.failure), (), nan, nan, nan, nan, (), lost)
        yield done.unit, found, done.unit.grasp


def _lifts(unit: JudgeUnit) -> list[LiftUnit]:
    return [
        LiftUnit(unit.index, unit.grasp, unit.scene, unit.hand, protocol, simulator=simulator)
        for protocol in unit.protocols
        for simulator in unit.simulators
    ]


def judge(unit: JudgeUnit) -> tuple[Judgement, Grasp]:
    """Judges one grasp.

    Args:
        unit: The grasp.

    Returns:
        What was found, and the grasp with certificate, pre-grasp and squeeze.
    """
    hand, scene = hand_of(unit.hand), scene_of(unit.scene)
    grasp, found = certified_as_given(hand, scene, unit.grasp)
    depths = (grasp.penetration_parts_m, grasp.penetration_mesh_m)
    low, high = hand.limits
    beyond = max(float(np.maximum(low - grasp.q, grasp.q - high).max(initial=0.0)), unit.off_coupling)
    reason = f"penetration: {1e3 * max(depths):.1f} mm" if max(depths) > PENETRATION else found.reason
    if not reason and beyond > LIMITS:
        reason = f"limits: a joint is {beyond:.3f} beyond them, or off its coupling law"
    prepared, made = completed(hand, scene, grasp)
    verdicts = []
    for lift in _lifts(unit):
        play = importlib.import_module(SIMULATORS[lift.simulator]).lift
        verdicts.append(play(prepared, hand, scene, protocol=find_protocol(lift.protocol)))
    proof = found.certificate
    nan = float("nan")
    judgement = Judgement(
        name=unit.grasp.grasp_id,
        certified=not reason,
        reason=reason,
        contacts=touching_links(hand, scene, grasp)[0],
        task_margin=nan if proof is None else proof.task_margin,
        ball_margin=nan if proof is None else proof.margin_lower,
        penetration_m=max(depths),
        beyond_limits=beyond,
        made=made,
        verdicts=tuple(verdicts),
    )
    first = verdicts[0] if verdicts else None
    return judgement, replace(prepared, certificate=None if reason else proof, lift=first)


def touching_links(hand: Hand, scene: Scene, grasp: Grasp) -> tuple[tuple[str, ...], Array, Array]:
    """Links that are near the mesh where a grasp has them.

    Args:
        hand: The hand.
        scene: The scene.
        grasp: The grasp.

    Returns:
        Names of the links, their contact points on the mesh in O [m], shape (n, 3), and unit normals into the object,
        averaged over a fingertip's patch, in O, shape (n, 3).
    """
    k = Configuration.at(hand, grasp.X_WH, grasp.q)
    near, gaps, outward = Point(k, scene, NO_CONTACTS, np.zeros((0, 3))).object_distances
    links = hand.sphere_links[near]
    order = np.lexsort((gaps, links))
    nearest = order[np.flatnonzero(np.diff(links[order], prepend=-1))]  # of each link the nearest sphere
    # Spheres bulge out of shapes, or lie inside of them, by some millimetres.
    rows = np.array([row for row in nearest if gaps[row] < 3.0 * TOUCH and hand.links[links[row]].geometry], dtype=int)
    if not len(rows):
        return (), np.zeros((0, 3)), np.zeros((0, 3))
    centers = k.points(hand.sphere_links, hand.spheres[:, :3])[near[rows]]
    starts = centers - (gaps[rows] + hand.spheres[near[rows], 3])[:, None] * outward[rows]
    p_WCs, clearances, away = nearest_points(hand, k, scene, links[rows], starts)
    touch = np.abs(clearances) < TOUCH
    R_WO = scene.X_WO.rotation().matrix()
    p_OCs = (p_WCs[touch] - scene.X_WO.translation()) @ R_WO
    names = tuple(hand.links[link].name for link in links[rows][touch])
    if not names:
        return (), np.zeros((0, 3)), np.zeros((0, 3))
    return names, p_OCs, -patch_normals(scene.object, p_OCs, -away[touch] @ R_WO)


def certified_as_given(hand: Hand, scene: Scene, grasp: Grasp) -> tuple[Grasp, CertificateResult]:
    """Looks for forces at the contacts of a grasp that hold its object.

    Args:
        hand: The hand.
        scene: The scene.
        grasp: The grasp.

    Returns:
        The grasp with penetration and, where there are such forces, certificate; and the certificate or the reason.
    """
    k = Configuration.at(hand, grasp.X_WH, grasp.q)
    parts, mesh = penetrations(hand, k, scene)
    grasp = replace(grasp, penetration_parts_m=parts, penetration_mesh_m=mesh)
    names, p_OCs, n_OCs = touching_links(hand, scene, grasp)
    if not names:
        return grasp, CertificateResult(None, f"contact: no link is within {1e3 * TOUCH:.0f} mm of the object", 0.0)
    held = HeldObject.of(scene)
    p_WCs = (scene.X_WO @ p_OCs.T).T
    J = k.jacobian(np.array([hand.link_index[name] for name in names]), p_WCs)[:, :, 6:]
    effort = Effort(effort_map(J, held.R_WO @ contact_frames(n_OCs)), hand.effort)
    result = CertificateResult(None, "there is no contact", 0.0)
    for safety in SAFETY:
        result = certify(p_OCs, n_OCs, list(names), held, effort=effort, safety=safety)
        if result.certificate is not None:
            break
    return replace(grasp, certificate=result.certificate), result


def completed(hand: Hand, scene: Scene, grasp: Grasp) -> tuple[Grasp, tuple[str, ...]]:
    """A grasp with what its file lacked, by rule: an open hand before, and a squeeze.

    Args:
        hand: The hand.
        scene: The scene.
        grasp: The grasp.

    Returns:
        The grasp, and what was made.
    """
    made = []
    if grasp.q_pregrasp is None or grasp.X_WH_pregrasp is None:
        opened = pregrasp(hand, scene, grasp.X_WH, grasp.q)
        grasp, made = replace(grasp, X_WH_pregrasp=opened.X_WH, q_pregrasp=opened.q), [*made, "pregrasp"]
    if grasp.tau_squeeze is None:
        grasp, made = squeeze_by_rule(hand, grasp, scene, 1.0), [*made, "squeeze"]
    return grasp, tuple(made)


def placed(record: HandRecord, hand: Hand, scene: Scene, kp: float) -> Grasp:
    """A record as a grasp in a scene.

    Args:
        record: The record, resolved for the hand.
        hand: The hand.
        scene: The scene.
        kp: Gain that a squeeze by positions is for [N m/rad].

    Returns:
        The grasp; pre-grasp and squeeze are None where the file has none.
    """
    X_WO, before = scene.X_WO, record.pregrasp
    grasp = Grasp(
        hand=hand.name,
        object=scene.object.name,
        X_WO=X_WO,
        X_WH=X_WO @ record.grasp.X_OH,
        q=record.grasp.q,
        X_WH_pregrasp=None if before is None else X_WO @ before.X_OH,
        q_pregrasp=None if before is None else before.q,
        grasp_id=record.record.name,
    )
    tau = record.tau
    if tau is None and record.squeeze is not None:
        tau = kp * (record.squeeze.q - record.grasp.q)
    return grasp if tau is None else squeezed(hand, grasp, tau, 1.0)


def scene_for(record: HandRecord, hand: Hand, model: ObjectModel) -> tuple[Scene, str]:
    """How the object lies: as the file has it, or else so that the hand is above the table.

    Args:
        record: The record, resolved for the hand.
        hand: The hand.
        model: The object.

    Returns:
        The scene, and in a word where its pose is from: `file`, or `pose N` of the object's stable poses, the most
        probable one at which no shape of the hand is in the table, or the most probable one of all where none is.
    """
    X_WO = record.record.X_WO
    if X_WO is not None:
        lowest = float((X_WO @ model.vertices.T)[2].min())
        if abs(lowest) <= OFF_TABLE and np.abs((X_WO @ model.p_OOcm)[:2]).max() < 0.9:
            return make_scene(model, pose=X_WO), "file"
    poses = stable_poses(model)
    for number, pose in enumerate(poses):
        X_WH = pose.X_WO @ record.grasp.X_OH
        if lowest_height(hand, Configuration.at(hand, X_WH, record.grasp.q)) > 0.0:
            return make_scene(model, pose=pose.X_WO), f"pose {number}"
    return make_scene(model, pose=poses[0].X_WO), "pose 0"


def row_of(judgement: Judgement) -> dict[str, Any]:
    """A judgement as a row of plain values: `PROTOCOL` and `PROTOCOL reason` for each verdict."""
    row: dict[str, Any] = {
        "grasp": judgement.name,
        "certified": judgement.certified,
        "reason": judgement.reason,
        "contacts": list(judgement.contacts),
        "task_margin": judgement.task_margin,
        "ball_margin": judgement.ball_margin,
        "penetration_mm": 1e3 * judgement.penetration_m,
        "beyond_limits": judgement.beyond_limits,
        "made": list(judgement.made),
    }
    for verdict in judgement.verdicts:
        reason = verdict.failure_reason
        if verdict.success and verdict.hold is not None:
            reason = verdict.hold.reason
        row |= {verdict.protocol: verdict.passed, f"{verdict.protocol} reason": reason}
    return row


def write_judgements(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Writes rows of judgements as Parquet, whole or not at all.

    Args:
        path: The file.
        rows: Rows of `row_of`, all with the same columns, and more columns of texts before them.

    Raises:
        GraspFileError: It cannot be written.
    """
    kinds = {bool: pa.bool_(), float: pa.float64(), str: pa.string(), list: pa.list_(pa.string())}
    schema = pa.schema([(name, kinds[type(value)]) for name, value in rows[0].items()])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as unfinished, unfinished.open("xb") as sink:
            pq.write_table(pa.Table.from_pylist(list(rows), schema=schema), sink, compression="zstd")
    except OSError as error:
        raise GraspFileError(f"{path}: cannot be written: {error.strerror}; choose another path") from None
