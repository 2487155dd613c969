"""A grasp becomes a row and comes back equal."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.contact.cones import contact_frames
from xdex_drake.dataset.grasp_file import read_grasps, write_grasps
from xdex_drake.dataset.schema import (
    SCHEMA,
    grasp_from_row,
    lift_columns,
    object_facts_from_row,
    pose_from_list,
    pose_to_list,
    row_from_grasp,
)
from xdex_drake.errors import GraspFileError
from xdex_drake.grasp import Certificate, Contact, Grasp, Hold, Lift

ROUNDING = 1e-15  # a rotation travels as a quaternion, a penetration in centimetres


def assert_same(a, b, name="grasp"):
    """Equal to the last bit, but for the rounding that the schema names."""
    assert type(a) is type(b), name
    if dataclasses.is_dataclass(a):
        for entry in dataclasses.fields(a):
            assert_same(getattr(a, entry.name), getattr(b, entry.name), f"{name}.{entry.name}")
    elif isinstance(a, RigidTransform):
        np.testing.assert_array_equal(a.translation(), b.translation(), err_msg=name)
        np.testing.assert_allclose(a.rotation().matrix(), b.rotation().matrix(), atol=ROUNDING, rtol=0, err_msg=name)
    elif name.endswith("R_WO"):
        np.testing.assert_allclose(a, b, atol=ROUNDING, rtol=0, err_msg=name)
    elif isinstance(a, np.ndarray):
        assert a.shape == b.shape, name
        np.testing.assert_array_equal(a, b, err_msg=name)
    elif isinstance(a, tuple):
        assert len(a) == len(b), name
        for k, (left, right) in enumerate(zip(a, b, strict=True)):
            assert_same(left, right, f"{name}[{k}]")
    elif "penetration" in name and not math.isnan(a):
        assert b == pytest.approx(a, rel=1e-15, abs=0.0), name
    else:
        assert a == b or (math.isnan(a) and math.isnan(b)), name


REAL = st.floats(-1e6, 1e6, allow_subnormal=False)
TEXT = st.text(st.characters(blacklist_categories=("Cs",)), max_size=8)


def arrays(*shape):
    size = int(np.prod(shape))
    return st.lists(REAL, min_size=size, max_size=size).map(lambda values: np.array(values).reshape(shape))


@st.composite
def poses(draw):
    wxyz = draw(arrays(4).filter(lambda v: np.linalg.norm(v) > 1e-3))
    return RigidTransform(RotationMatrix(Quaternion(wxyz=wxyz / np.linalg.norm(wxyz))), draw(arrays(3)))


def normals():
    return arrays(3).filter(lambda v: np.linalg.norm(v) > 1e-3)


@st.composite
def holds(draw):
    number = REAL | st.just(float("nan"))
    return Hold(draw(st.booleans()), draw(TEXT), draw(number), draw(number))


@st.composite
def grasps(draw, facts):
    X_WO = draw(poses())
    certificate = None
    if draw(st.booleans()):
        count = draw(st.integers(0, 4))
        contacts = tuple(
            Contact(draw(TEXT), draw(arrays(3)), draw(normals()), draw(REAL), draw(arrays(3))) for _ in range(count)
        )
        certificate = Certificate(
            contacts,
            X_WO.rotation().matrix(),
            facts.p_OOcm,
            facts.mass,
            facts.length,
            *(draw(REAL) for _ in range(4)),
            witness_forces=draw(arrays(12, 3 * count)),
            witness_direction=draw(arrays(6)),
        )
    tips = tuple(draw(st.lists(TEXT, max_size=3)))
    lift = Lift(draw(TEXT), draw(st.booleans()), draw(TEXT), draw(REAL), tips, 1.0, draw(st.none() | holds()))
    return Grasp(
        hand="tiny",
        object="mug",
        X_WO=X_WO,
        X_WH=draw(poses()),
        q=draw(arrays(2)),
        certificate=certificate,
        X_WH_pregrasp=draw(st.none() | poses()),
        q_pregrasp=draw(st.none() | arrays(2)),
        q_squeeze=draw(st.none() | arrays(2)),
        tau_squeeze=draw(st.none() | arrays(2)),
        lift=draw(st.sampled_from([None, lift])),
        grasp_id=draw(TEXT),
        source_grasp_id=draw(TEXT),
        penetration_parts_m=draw(REAL | st.just(float("nan"))),
        penetration_mesh_m=draw(REAL | st.just(float("nan"))),
        squeeze_margin=draw(REAL | st.just(float("nan"))),
        stiffness_least=draw(REAL | st.just(float("nan"))),
        foretold_motion=draw(REAL | st.just(float("nan"))),
        seconds=draw(REAL),
    )


def test_grasp_survives_a_row_and_a_file(tmp_path_factory, tiny_hand, facts):
    path = tmp_path_factory.mktemp("round") / "grasps.parquet"

    @settings(max_examples=30, deadline=None, derandomize=True)
    @given(grasps(facts))
    def check(grasp):
        row = row_from_grasp(grasp, scene_id="s", hand=tiny_hand, hand_digest="h", object=facts)
        assert list(row) == SCHEMA.names
        assert_same(grasp_from_row(row), grasp)
        write_grasps(path, [row])
        (stored,) = read_grasps(path)
        assert stored == row
        assert_same(grasp_from_row(stored), grasp)

    check()


def test_writing_again_changes_no_more(make_row, tiny_hand, facts):
    """Rounding happens once: the second round trip is exact for poses."""
    row = make_row(0)
    again = row_from_grasp(grasp_from_row(row), scene_id="mug/0", hand=tiny_hand, hand_digest="h", object=facts)
    for name in ("X_WO", "X_WH", "X_WH_pregrasp"):
        np.testing.assert_allclose(again[name], row[name], atol=ROUNDING, rtol=0)


def test_each_column_says_its_meaning_and_the_joint_values_follow_the_coupling(make_row):
    for column in SCHEMA:
        assert column.metadata is not None
        assert set(column.metadata) == {b"unit", b"meaning"}
        assert column.metadata[b"meaning"]
    row = make_row(0)
    assert row["joint_names"] == ["joint0", "joint1"]
    assert row["q_full"] == pytest.approx([*row["q"], 0.5 * row["q"][1] + 0.1], abs=1e-15)
    assert json.loads(json.dumps(row)) == row  # plain values only


def test_a_row_tells_another_tool_where_the_base_is_and_how_the_forces_act(make_row, make_grasp, tiny_hand, facts):
    hand = dataclasses.replace(
        tiny_hand, p_HB=np.array([0.0, 0.1, 0.0]), R_HB=RotationMatrix.MakeXRotation(0.4).matrix()
    )
    grasp = make_grasp(np.random.default_rng(1))
    row = row_from_grasp(grasp, scene_id="s", hand=hand, hand_digest="h", object=facts)
    assert row["joint_names_full"] == ["joint0", "joint1", "joint2"] and len(row["q_full"]) == 3
    X_BH = RigidTransform(RotationMatrix(hand.R_HB), hand.p_HB).inverse()
    assert (pose_from_list(row["X_WB"]) @ X_BH).IsNearlyEqualTo(grasp.X_WH, 1e-14)
    # Forces by the columns alone, as another tool finds them, and by this library.
    n, t, f = (np.array([contact[name] for contact in row["contacts"]]) for name in ("n_OC", "t_OC", "f_C"))
    forces_O = f[:, :1] * t + f[:, 1:2] * np.cross(n, t) + f[:, 2:] * n
    np.testing.assert_allclose(forces_O, np.einsum("kab,kb->ka", contact_frames(n), f), atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pose_is_position_then_quaternion_with_w_first(sign):
    wxyz = sign * np.array([0.5, 0.1, -0.7, 0.5]) / np.linalg.norm([0.5, 0.1, -0.7, 0.5])
    X = RigidTransform(RotationMatrix(Quaternion(wxyz=wxyz)), [1.0, 2.0, 3.0])
    stored = pose_to_list(X)
    np.testing.assert_allclose(stored, [1.0, 2.0, 3.0, *(sign * wxyz)], atol=1e-15)
    assert pose_from_list(stored).IsNearlyEqualTo(X, 1e-15)


@pytest.mark.parametrize(
    "values", [[0.0] * 7, [0.0] * 6, [0.0, 0.0, float("nan"), 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.1, 0.0, 0.0, 0.0]]
)
def test_what_is_no_pose_is_refused(values):
    with pytest.raises(GraspFileError, match="not a pose"):
        pose_from_list(values)


def test_object_facts_and_lift_columns_come_back(make_row, facts):
    row = make_row(0)
    back = object_facts_from_row(row)
    np.testing.assert_array_equal(back.p_OOcm, facts.p_OOcm)
    assert dataclasses.replace(back, p_OOcm=facts.p_OOcm) == facts
    lift = Lift("grav-6-all", False, "slipped", 0.01, (), 0.5)
    assert grasp_from_row({**row, **lift_columns(lift)}).lift == lift
    assert grasp_from_row({**row, **lift_columns(None)}).lift is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hand": "other"}, "hand 'other'"),
        ({"object": "other"}, "object 'other'"),
        ({"q": np.zeros(3)}, "must have 2 values"),
        ({"q_squeeze": np.zeros(1)}, "must have 2 values"),
        ({"tau_squeeze": np.zeros(3)}, "must have 2 values"),
        ({"X_WO": RigidTransform(RotationMatrix.MakeXRotation(0.1))}, "another R_WO"),
    ],
)
def test_a_grasp_that_contradicts_its_scene_is_refused(make_grasp, tiny_hand, facts, change, message):
    grasp = dataclasses.replace(make_grasp(np.random.default_rng(0)), **change)
    with pytest.raises(GraspFileError, match=message):
        row_from_grasp(grasp, scene_id="s", hand=tiny_hand, hand_digest="h", object=facts)


def test_a_certificate_of_another_mass_is_refused(make_grasp, tiny_hand, facts):
    grasp = make_grasp(np.random.default_rng(0))
    with pytest.raises(GraspFileError, match="another mass, length"):
        row_from_grasp(
            grasp,
            scene_id="s",
            hand=tiny_hand,
            hand_digest="h",
            object=dataclasses.replace(facts, mass=0.2, length=0.1),
        )


def test_a_row_that_lacks_a_column_or_a_value_is_refused(make_row):
    row = make_row(0)
    with pytest.raises(GraspFileError, match=r"'g0'.*no column 'q_squeeze'"):
        grasp_from_row({name: value for name, value in row.items() if name != "q_squeeze"})
    with pytest.raises(GraspFileError, match=r"'g0'.*contacts"):
        grasp_from_row({**row, "witness_forces": [1.0]})
    with pytest.raises(GraspFileError, match=r"'g0'.*X_WH"):
        grasp_from_row({**row, "X_WH": [0.0] * 7})
