"""Files of grasps of schema version 1, read as if they were of this version.

Version 1 drove the joints by targets alone, q_squeeze = q + tau / kp, which might lie beyond the joint limits; the
torques are found from them. It named no contact tangents; they follow from the normals. What it did not know is null.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from xdex_drake.dataset.schema import SCHEMA, Row, tangent

KP = 1.0
"""Gain of targets that came without gains [N m/rad]."""

_NEW = (
    "joint_names_full",
    "X_WB",
    "tau_squeeze",
    "squeeze_margin",
    "stiffness_least",
    "foretold_motion",
    "holds",
    "hold_reason",
    "hold_slip_m",
    "hold_turn_rad",
)


def _old_field(field: pa.Field) -> pa.Field:
    if field.name != "contacts":
        return field
    parts = [field.type.value_field.type.field(k) for k in range(field.type.value_field.type.num_fields)]
    return field.with_type(pa.list_(pa.struct([part for part in parts if part.name != "t_OC"])))


SCHEMA_1 = pa.schema([_old_field(field) for field in SCHEMA if field.name not in _NEW])
"""Arrow schema of version 1."""


def upgraded(table: pa.Table) -> pa.Table:
    """A table of version 1 with the columns of this version.

    Args:
        table: A whole table of `SCHEMA_1`.

    Returns:
        The table, of `SCHEMA`.
    """
    return pa.Table.from_pylist([_upgraded(row) for row in table.to_pylist()], schema=SCHEMA)


def _upgraded(row: Row) -> Row:
    contacts = row["contacts"]
    if contacts is not None:
        contacts = [{**contact, "t_OC": tangent(contact["n_OC"])} for contact in contacts]
    tau = None
    if row["q_squeeze"] is not None:
        kp = KP if row["gains"] is None else row["gains"]["kp"]
        tau = (kp * (np.array(row["q_squeeze"]) - np.array(row["q"]))).tolist()
    return {**row, **dict.fromkeys(_NEW), "contacts": contacts, "tau_squeeze": tau}
