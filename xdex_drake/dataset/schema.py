"""One row a grasp: the columns of a file of grasps, and the way between a row and a `Grasp`.

SI units and radians, but for penetration, which is in centimetres as its columns' names say. A pose is
(x, y, z, qw, qx, qy, qz). Contact normals point into the object. Each column's unit and meaning stand in the file.

A grasp that is written and read again is equal but for rounding: poses to 1e-15 in each element of their matrix, since
a rotation travels as a quaternion, and penetrations to one part in 1e15; all other numbers are equal to the last bit.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import contact_frames
from xdex_drake.errors import GraspFileError
from xdex_drake.grasp import Certificate, Contact, Grasp, Hold, Lift
from xdex_drake.hand.description import Hand

Row = dict[str, Any]

SCHEMA_VERSION = 2

_CM_PER_M = 100.0
_AGREEMENT = 1e-9


@dataclass(frozen=True)
class ObjectFacts:
    """What a row says about its object.

    Attributes:
        name: Name of the object; equals `grasp.object`.
        path: Library name or path by which the mesh is found again, as the user gave it.
        digest: Digest of the mesh.
        scale: Factor from the mesh file's lengths to metres.
        mass: Mass [kg].
        friction: Coefficient of friction of the scene.
        p_OOcm: Center of mass in the object frame [m], shape (3,).
        length: Length that divides torques, lambda [m].
    """

    name: str
    path: str
    digest: str
    scale: float
    mass: float
    friction: float
    p_OOcm: Array
    length: float


def _column(name: str, kind: pa.DataType, unit: str, meaning: str, *, nullable: bool = False) -> pa.Field:
    return pa.field(name, kind, nullable=nullable, metadata={"unit": unit, "meaning": meaning})


_TEXT = pa.string()
_REAL = pa.float64()
_REALS = pa.list_(pa.float64())
_TEXTS = pa.list_(pa.string())
_VECTOR = pa.list_(pa.float64(), 3)
_POSE = pa.list_(pa.float64(), 7)
_CONTACTS = pa.list_(
    pa.struct(
        [("link", _TEXT), ("p_OC", _VECTOR), ("n_OC", _VECTOR), ("t_OC", _VECTOR), ("mu", _REAL), ("f_C", _VECTOR)]
    )
)
_GAINS = pa.struct([("kp", _REAL), ("kd", _REAL)])

_POSE_UNIT = "m, m, m, 1, 1, 1, 1"
_JOINT_UNIT = "rad or m"

SCHEMA = pa.schema(
    [
        _column("grasp_id", _TEXT, "", "identifier, unique in a data set"),
        _column("hand", _TEXT, "", "name of the hand"),
        _column("hand_digest", _TEXT, "", "digest of the hand's description"),
        _column("object", _TEXT, "", "name of the object"),
        _column("object_path", _TEXT, "", "library name or path by which the mesh is found again"),
        _column("object_digest", _TEXT, "", "digest of the mesh"),
        _column("object_scale", _REAL, "1", "factor from the mesh file's lengths to metres"),
        _column("mass_kg", _REAL, "kg", "mass of the object"),
        _column("friction", _REAL, "1", "coefficient of friction of the scene"),
        _column("p_OOcm", _VECTOR, "m", "center of mass in the object frame O"),
        _column("lambda_m", _REAL, "m", "length that divides torques"),
        _column("scene_id", _TEXT, "", "identifier of the scene: an object at a stable pose on the table"),
        _column("X_WO", _POSE, _POSE_UNIT, "pose of the object in the world: x, y, z, qw, qx, qy, qz"),
        _column("X_WH", _POSE, _POSE_UNIT, "pose of the wrist frame in the world: x, y, z, qw, qx, qy, qz"),
        _column("q", _REALS, _JOINT_UNIT, "actuated joint values, in the order of joint_names"),
        _column(
            "q_full", _REALS, _JOINT_UNIT, "values of all joints, coupled ones too, in the order of the description"
        ),
        _column("joint_names", _TEXTS, "", "names of the actuated joints: the order of q"),
        _column(
            "joint_names_full", _TEXTS, "", "names of all joints, coupled ones too: the order of q_full", nullable=True
        ),
        _column("X_WB", _POSE, _POSE_UNIT, "pose of the hand's base link in the world at the grasp", nullable=True),
        _column("X_WH_pregrasp", _POSE, _POSE_UNIT, "wrist pose of the pre-grasp", nullable=True),
        _column("q_pregrasp", _REALS, _JOINT_UNIT, "joint values of the pre-grasp", nullable=True),
        _column(
            "tau_squeeze",
            _REALS,
            "N m or N",
            "torques of the squeeze, in the order of joint_names: joints are driven by kp (q - q_now) + tau_squeeze",
            nullable=True,
        ),
        _column(
            "q_squeeze",
            _REALS,
            _JOINT_UNIT,
            "targets of a squeeze without feed-forward: q + tau_squeeze / kp within the joint limits",
            nullable=True,
        ),
        _column("gains", _GAINS, "N m/rad, N m s/rad", "joint gains that q_squeeze was computed for", nullable=True),
        _column("source_grasp_id", _TEXT, "", "grasp that this one was retargeted from, empty for a source grasp"),
        _column("object_point_O", _VECTOR, "m", "object point that the hand heads for, in O", nullable=True),
        _column("source_object_point_O", _VECTOR, "m", "the same of the source grasp", nullable=True),
        _column(
            "contacts",
            _CONTACTS,
            "link: name, p_OC: m, n_OC: 1, t_OC: 1, mu: 1, f_C: N",
            "certificate: contact points, normals into the object and tangents, in O, and forces on the object in the "
            "contact frame, whose axes are the tangent, normal x tangent, and the normal",
            nullable=True,
        ),
        _column("wrench_residual", _REAL, "1", "certificate: norm of the unbalanced wrench over m g", nullable=True),
        _column("task_margin", _REAL, "1", "certificate: multiple of the disturbances that is resisted", nullable=True),
        _column("margin_lower", _REAL, "1", "certificate: lower bound of the ball margin", nullable=True),
        _column("margin_upper", _REAL, "1", "certificate: upper bound of the ball margin", nullable=True),
        _column(
            "witness_forces",
            _REALS,
            "1",
            "certificate: forces that attain margin_lower, 12 rows (a direction each) of 3 numbers a contact",
            nullable=True,
        ),
        _column(
            "witness_direction",
            _REALS,
            "1",
            "certificate: unit wrench direction that attains margin_upper, torque first, 6 numbers",
            nullable=True,
        ),
        _column(
            "squeeze_margin",
            _REAL,
            "1",
            "multiple of the pushes that constant targets resist without sliding",
            nullable=True,
        ),
        _column(
            "stiffness_least",
            _REAL,
            "N/m",
            "least eigenvalue of the stiffness with which the hand holds the object, turns times lambda_m",
            nullable=True,
        ),
        _column(
            "foretold_motion",
            _REAL,
            "1",
            "natural logarithm of the foretold motion under pushes of m g, over the bounds of the protocol hold",
            nullable=True,
        ),
        _column(
            "penetration_parts_cm",
            _REAL,
            "cm",
            "depth of the deepest object point in the hand, against the object's convex parts",
            nullable=True,
        ),
        _column("penetration_mesh_cm", _REAL, "cm", "the same against the object's mesh", nullable=True),
        _column("protocol", _TEXT, "", "protocol of the lift", nullable=True),
        _column("success", pa.bool_(), "", "whether the lift met the protocol's rule", nullable=True),
        _column("failure_reason", _TEXT, "", "first reason that matches, empty where it succeeded", nullable=True),
        _column("lift_height_m", _REAL, "m", "final rise of the object's center of mass", nullable=True),
        _column("fingertips", _TEXTS, "", "names of the fingers whose tip touched at the end", nullable=True),
        _column("lift_seconds", _REAL, "s", "wall time of the lift's simulation", nullable=True),
        _column(
            "holds", pa.bool_(), "", "whether the lifted object stayed in the hand under six pushes", nullable=True
        ),
        _column("hold_reason", _TEXT, "", "what went wrong and when, empty where it holds", nullable=True),
        _column("hold_slip_m", _REAL, "m", "greatest slip in the hand since the end of the squeeze", nullable=True),
        _column("hold_turn_rad", _REAL, "rad", "greatest turn in the hand since then", nullable=True),
        _column("seconds", _REAL, "s", "wall time spent on this grasp, without the lift"),
    ],
    metadata={
        "xdex_schema_version": str(SCHEMA_VERSION),
        "xdex_conventions": "SI units, radians; quaternions w, x, y, z; wrenches torque first; contact normals into "
        "the object; W is the world with z up, O the frame of the mesh file, H the wrist: +z to the fingers, +x out of "
        "the palm; a column of a missing certificate, pre-grasp or lift is null",
    },
)
"""Arrow schema of a file of grasps."""


def pose_to_list(X: RigidTransform) -> list[float]:
    """Pose as it is stored.

    Args:
        X: Pose.

    Returns:
        x, y, z [m], qw, qx, qy, qz, with qw >= 0.
    """
    quaternion = X.rotation().ToQuaternion().wxyz()
    return [*X.translation().tolist(), *(quaternion if quaternion[0] >= 0.0 else -quaternion).tolist()]


def pose_from_list(values: Any) -> RigidTransform:
    """Pose from its stored form.

    Args:
        values: x, y, z [m], qw, qx, qy, qz; shape (7,).

    Returns:
        The pose; the quaternion is normalised.

    Raises:
        GraspFileError: A value is missing or not finite, or the quaternion's norm differs from 1 by more than 1e-6.
    """
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.shape != (7,) or not np.isfinite(numbers).all() or abs(np.linalg.norm(numbers[3:]) - 1.0) > 1e-6:
        raise GraspFileError(f"not a pose x, y, z, qw, qx, qy, qz with a unit quaternion: {values}")
    return RigidTransform(RotationMatrix(Quaternion(wxyz=numbers[3:] / np.linalg.norm(numbers[3:]))), numbers[:3])


def row_from_grasp(
    grasp: Grasp,
    *,
    scene_id: str,
    hand: Hand,
    hand_digest: str,
    object: ObjectFacts,
    gains: tuple[float, float] | None = None,
    object_point_O: Array | None = None,
    source_object_point_O: Array | None = None,
) -> Row:
    """Row that holds a grasp, with all that is needed to replay and to re-check it.

    Args:
        grasp: The grasp.
        scene_id: Identifier of its scene.
        hand: Description of its hand.
        hand_digest: Digest of that description.
        object: What the row says about its object.
        gains: Joint gains (K_p [N m/rad], K_d [N m s/rad]) that `grasp.q_squeeze` was computed for.
        object_point_O: Object point that the hand heads for [m], shape (3,).
        source_object_point_O: The same of the source grasp [m], shape (3,).

    Returns:
        A value for every column of `SCHEMA`, None where the grasp lacks it.

    Raises:
        GraspFileError: The grasp contradicts the hand or the object: their names, the number of joints, or the mass,
            length, center of mass or rotation of the certificate.
    """
    _check_agreement(grasp, hand, object)
    kp_kd = None if gains is None else {"kp": float(gains[0]), "kd": float(gains[1])}
    return {
        "grasp_id": grasp.grasp_id,
        "hand": grasp.hand,
        "hand_digest": hand_digest,
        "object": grasp.object,
        "object_path": object.path,
        "object_digest": object.digest,
        "object_scale": float(object.scale),
        "mass_kg": float(object.mass),
        "friction": float(object.friction),
        "p_OOcm": _floats(object.p_OOcm),
        "lambda_m": float(object.length),
        "scene_id": scene_id,
        "X_WO": pose_to_list(grasp.X_WO),
        "X_WH": pose_to_list(grasp.X_WH),
        "q": _floats(grasp.q),
        "q_full": _floats(hand.q_full(np.asarray(grasp.q))),
        "joint_names": list(hand.joint_names),
        "joint_names_full": [joint.name for joint in hand.joints],
        "X_WB": pose_to_list(grasp.X_WH @ RigidTransform(RotationMatrix(hand.R_HB), hand.p_HB)),
        "X_WH_pregrasp": None if grasp.X_WH_pregrasp is None else pose_to_list(grasp.X_WH_pregrasp),
        "q_pregrasp": _floats(grasp.q_pregrasp),
        "tau_squeeze": _floats(grasp.tau_squeeze),
        "q_squeeze": _floats(grasp.q_squeeze),
        "gains": kp_kd,
        "source_grasp_id": grasp.source_grasp_id,
        "object_point_O": _floats(object_point_O),
        "source_object_point_O": _floats(source_object_point_O),
        **_certificate_columns(grasp.certificate),
        "squeeze_margin": _number(grasp.squeeze_margin),
        "stiffness_least": _number(grasp.stiffness_least),
        "foretold_motion": _number(grasp.foretold_motion),
        "penetration_parts_cm": _to_cm(grasp.penetration_parts_m),
        "penetration_mesh_cm": _to_cm(grasp.penetration_mesh_m),
        **lift_columns(grasp.lift),
        "seconds": float(grasp.seconds),
    }


def grasp_from_row(row: Mapping[str, Any]) -> Grasp:
    """Grasp that a row holds.

    Args:
        row: A row, as `row_from_grasp` gives it or a file holds it.

    Returns:
        The grasp, equal to the one that was stored but for the rounding that this module names.

    Raises:
        GraspFileError: A column is missing or holds what it cannot; the message names it.
    """
    column = ""
    try:
        X = {}
        for column in ("X_WO", "X_WH", "X_WH_pregrasp"):
            X[column] = None if row[column] is None else pose_from_list(row[column])
        q = {column: _array(row[column]) for column in ("q", "q_pregrasp", "q_squeeze", "tau_squeeze")}
        if X["X_WO"] is None or X["X_WH"] is None or q["q"] is None:
            raise GraspFileError("X_WO, X_WH or q is null")
        column = "contacts"
        certificate = _certificate_from_row(row, X["X_WO"])
        column = ""
        return Grasp(
            hand=row["hand"],
            object=row["object"],
            X_WO=X["X_WO"],
            X_WH=X["X_WH"],
            q=q["q"],
            certificate=certificate,
            X_WH_pregrasp=X["X_WH_pregrasp"],
            q_pregrasp=q["q_pregrasp"],
            q_squeeze=q["q_squeeze"],
            tau_squeeze=q["tau_squeeze"],
            lift=_lift_from_row(row),
            grasp_id=row["grasp_id"],
            source_grasp_id=row["source_grasp_id"],
            penetration_parts_m=_from_cm(row["penetration_parts_cm"]),
            penetration_mesh_m=_from_cm(row["penetration_mesh_cm"]),
            squeeze_margin=_or_nan(row["squeeze_margin"]),
            stiffness_least=_or_nan(row["stiffness_least"]),
            foretold_motion=_or_nan(row["foretold_motion"]),
            seconds=row["seconds"],
        )
    except KeyError as error:
        raise GraspFileError(f"grasp {row.get('grasp_id')!r}: there is no column {error}") from error
    except (GraspFileError, TypeError, ValueError) as error:
        where = f" column {column}:" if column else ""
        raise GraspFileError(f"grasp {row.get('grasp_id')!r}:{where} {error}") from error


def object_facts_from_row(row: Mapping[str, Any]) -> ObjectFacts:
    """What a row says about its object.

    Args:
        row: A row.

    Returns:
        The facts by which the scene can be built again.

    Raises:
        GraspFileError: A column is missing.
    """
    try:
        return ObjectFacts(
            name=row["object"],
            path=row["object_path"],
            digest=row["object_digest"],
            scale=row["object_scale"],
            mass=row["mass_kg"],
            friction=row["friction"],
            p_OOcm=np.array(row["p_OOcm"], dtype=np.float64),
            length=row["lambda_m"],
        )
    except KeyError as error:
        raise GraspFileError(f"grasp {row.get('grasp_id')!r}: there is no column {error}") from error


def lift_columns(lift: Lift | None) -> Row:
    """The columns of a lift: `{**row, **lift_columns(lift)}` is the row of a grasp that was lifted again.

    Args:
        lift: The lift, None where the grasp has not been simulated.

    Returns:
        A value for each column of the lift, None throughout without one.
    """
    if lift is None:
        names = ("protocol", "success", "failure_reason", "lift_height_m", "fingertips", "lift_seconds")
        return {**dict.fromkeys(names), **_hold_columns(None)}
    return {
        "protocol": lift.protocol,
        "success": bool(lift.success),
        "failure_reason": lift.failure_reason,
        "lift_height_m": float(lift.lift_height_m),
        "fingertips": list(lift.fingertips),
        "lift_seconds": float(lift.seconds),
        **_hold_columns(lift.hold),
    }


def _hold_columns(hold: Hold | None) -> Row:
    """The columns of a hold, None throughout without one."""
    if hold is None:
        return dict.fromkeys(("holds", "hold_reason", "hold_slip_m", "hold_turn_rad"))
    return {
        "holds": bool(hold.holds),
        "hold_reason": hold.reason,
        "hold_slip_m": _number(hold.slip_m),
        "hold_turn_rad": _number(hold.turn_rad),
    }


def _check_agreement(grasp: Grasp, hand: Hand, object: ObjectFacts) -> None:
    """Raises where a grasp contradicts what its row would say about its hand and object."""
    certificate = grasp.certificate
    problem = ""
    if grasp.hand != hand.name:
        problem = f"it is of hand {grasp.hand!r}, but the description is of {hand.name!r}"
    elif grasp.object != object.name:
        problem = f"it is of object {grasp.object!r}, but the facts are of {object.name!r}"
    elif any(
        q is not None and np.shape(q) != np.shape(hand.q_rest)
        for q in (grasp.q, grasp.q_pregrasp, grasp.q_squeeze, grasp.tau_squeeze)
    ):
        names = "q, q_pregrasp, q_squeeze and tau_squeeze"
        problem = f"{names} must have {len(hand.q_rest)} values, one for each actuated joint"
    elif certificate is not None:
        pairs = {
            "mass": (certificate.mass, object.mass),
            "length": (certificate.length, object.length),
            "p_OOcm": (certificate.p_OOcm, object.p_OOcm),
            "R_WO": (certificate.R_WO, grasp.X_WO.rotation().matrix()),
        }
        wrong = [name for name, (a, b) in pairs.items() if not np.allclose(a, b, rtol=_AGREEMENT, atol=_AGREEMENT)]
        if wrong:
            problem = f"its certificate has another {', '.join(wrong)} than the grasp's scene; certify it in that scene"
    if problem:
        raise GraspFileError(f"grasp {grasp.grasp_id!r} cannot be stored: {problem}")


def _certificate_columns(certificate: Certificate | None) -> Row:
    """The columns of a certificate."""
    if certificate is None:
        return dict.fromkeys(
            (
                "contacts",
                "wrench_residual",
                "task_margin",
                "margin_lower",
                "margin_upper",
                "witness_forces",
                "witness_direction",
            )
        )
    contacts = [
        {
            "link": contact.link,
            "p_OC": _floats(contact.p_OC),
            "n_OC": _floats(contact.n_OC),
            "t_OC": tangent(contact.n_OC),
            "mu": float(contact.mu),
            "f_C": _floats(contact.f_C),
        }
        for contact in certificate.contacts
    ]
    return {
        "contacts": contacts,
        "wrench_residual": float(certificate.wrench_residual),
        "task_margin": float(certificate.task_margin),
        "margin_lower": float(certificate.margin_lower),
        "margin_upper": float(certificate.margin_upper),
        "witness_forces": _floats(certificate.witness_forces),
        "witness_direction": _floats(certificate.witness_direction),
    }


def tangent(n_OC: Any) -> list[float]:
    """First axis of the contact frame of a normal in O, shape (3,); the second one is n x t."""
    return contact_frames(np.asarray(n_OC, dtype=np.float64))[:, 0].tolist()


def _certificate_from_row(row: Mapping[str, Any], X_WO: RigidTransform) -> Certificate | None:
    """Certificate of a row, None where its columns are null."""
    if row["contacts"] is None:
        return None
    contacts = tuple(
        Contact(
            link=contact["link"],
            p_OC=np.array(contact["p_OC"], dtype=np.float64),
            n_OC=np.array(contact["n_OC"], dtype=np.float64),
            mu=contact["mu"],
            f_C=np.array(contact["f_C"], dtype=np.float64),
        )
        for contact in row["contacts"]
    )
    return Certificate(
        contacts=contacts,
        R_WO=X_WO.rotation().matrix(),
        p_OOcm=np.array(row["p_OOcm"], dtype=np.float64),
        mass=row["mass_kg"],
        length=row["lambda_m"],
        wrench_residual=row["wrench_residual"],
        task_margin=row["task_margin"],
        margin_lower=row["margin_lower"],
        margin_upper=row["margin_upper"],
        witness_forces=np.array(row["witness_forces"], dtype=np.float64).reshape(12, -1),
        witness_direction=np.array(row["witness_direction"], dtype=np.float64),
    )


def _lift_from_row(row: Mapping[str, Any]) -> Lift | None:
    """Lift of a row, None where its columns are null."""
    if row["success"] is None:
        return None
    return Lift(
        protocol=row["protocol"],
        success=row["success"],
        failure_reason=row["failure_reason"],
        lift_height_m=row["lift_height_m"],
        fingertips=tuple(row["fingertips"]),
        seconds=row["lift_seconds"],
        hold=_hold_from_row(row),
    )


def _hold_from_row(row: Mapping[str, Any]) -> Hold | None:
    """Hold of a row, None where its columns are null."""
    if row["holds"] is None:
        return None
    return Hold(row["holds"], row["hold_reason"], _or_nan(row["hold_slip_m"]), _or_nan(row["hold_turn_rad"]))


def _floats(values: Array | None) -> list[float] | None:
    """Numbers of an array, row by row."""
    return None if values is None else np.asarray(values, dtype=np.float64).ravel().tolist()


def _array(values: Any) -> Array | None:
    """Array of a list of numbers."""
    return None if values is None else np.array(values, dtype=np.float64)


def _number(value: float) -> float | None:
    """A number, None where it is not known: a missing number is null in the file, so that means leave it out."""
    return None if np.isnan(value) else float(value)


def _or_nan(value: float | None) -> float:
    """A number, NaN where it is not known."""
    return float("nan") if value is None else value


def _to_cm(metres: float) -> float | None:
    """Length in cm, None where it is not known."""
    return _number(metres * _CM_PER_M)


def _from_cm(centimetres: float | None) -> float:
    """Length in m, NaN where it is not known."""
    return _or_nan(centimetres) / _CM_PER_M
