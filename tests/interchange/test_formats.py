"""Other tools' files of grasps: what is written is read again, what is bad is refused in one line."""

import io
import json
import os
import pickle
import zipfile
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from xdex_drake.errors import ConfigError, GraspFileError
from xdex_drake.grasp import Grasp
from xdex_drake.hand.kinematics import forward_kinematics
from xdex_drake.hand.library import load_hand
from xdex_drake.interchange.formats import FORMATS, format_of
from xdex_drake.interchange.naming import convention_of, parse_frame, parse_order, record_of, resolve
from xdex_drake.interchange.plain_pickle import read_plain_npy
from xdex_drake.interchange.records import GraspRecord, Stage, Touching, seven
from xdex_drake.scene.object import load_object
from xdex_drake.scene.tabletop import make_scene

FINGERS = ("thumb", "index", "middle", "ring")


def random_pose(rng: np.random.Generator) -> RigidTransform:
    return RigidTransform(RotationMatrix(Rotation.random(random_state=rng).as_matrix()), rng.normal(size=3) * 0.1)


def random_records(format: str, count: int = 3) -> list[GraspRecord]:
    """Records with everything that a record can hold."""
    rng, n = np.random.default_rng(4), 16

    def stage() -> Stage:
        return Stage(random_pose(rng), rng.normal(size=n))

    contacts = lambda: tuple(  # noqa: E731
        Touching(f, rng.normal(size=3) * 0.05, Rotation.random(random_state=rng).as_matrix()[0]) for f in FINGERS
    )
    return [
        GraspRecord(
            name=f"g-{k}",
            grasp=stage(),
            pregrasp=stage(),
            squeeze=stage(),
            torques=rng.normal(size=n),
            joint_names=tuple(f"joint_{j}.0" for j in range(n)),
            frame="base_link",
            hand="allegro",
            object="can",
            scale=0.5,
            X_WO=random_pose(rng),
            contacts=contacts(),
            scores={"confidence": float(k % 2), "epsilon_quality": 0.125, "volume_quality": 1e-5},
        )
        for k in range(count)
    ]


CARRIED = {
    "isaac_grasp": {"pregrasp", "squeeze", "torques", "scale"},
    "dexgraspbench": {"pregrasp", "squeeze", "torques", "scale"},
    "dexgraspdb": {"contacts"},
    "arrays": {"pregrasp", "squeeze", "torques", "scale"},
}
"""What each format carries besides grasp, names, frame and object."""


def file_of(format: str, folder: Path) -> Path:
    return folder / f"grasps{FORMATS[format].suffixes[0]}"


@pytest.mark.parametrize("format", FORMATS)
def test_what_is_written_is_read(format, tmp_path):
    records, path = random_records(format), file_of(format, tmp_path)
    FORMATS[format].write(path, records)
    assert format_of(path) == format
    again = FORMATS[format].read(path)
    assert len(again) == len(records)
    for one, other in zip(records, again, strict=True):
        for field in ("name", "joint_names", "frame", "hand", "object"):
            assert getattr(one, field) == getattr(other, field)
        for field in {"grasp", "X_WO", *CARRIED[format]}:
            assert_same(getattr(one, field), getattr(other, field))
        carried = {"grasp", "X_WO", "name", "joint_names", "frame", "hand", "object", "scores", *CARRIED[format]}
        for field in {f.name for f in fields(GraspRecord)} - carried:
            assert not getattr(other, field)  # Nothing is made up.
    if format != "arrays":
        key = "succ_flag" if format == "dexgraspbench" else "confidence"
        assert [r.scores[key] for r in again] == [0.0, 1.0, 0.0]


def assert_same(one, other):
    if isinstance(one, RigidTransform):
        np.testing.assert_allclose(one.GetAsMatrix4(), other.GetAsMatrix4(), atol=1e-9)
    elif isinstance(one, Stage):
        assert_same(one.X_OG, other.X_OG)
        np.testing.assert_allclose(one.values, other.values, atol=1e-9)
    elif isinstance(one, tuple):
        for a, b in zip(one, other, strict=True):
            assert a.finger == b.finger
            np.testing.assert_allclose([*a.p_OC, *a.n_OC], [*b.p_OC, *b.n_OC], atol=1e-9)
    else:
        np.testing.assert_allclose(one, other, atol=1e-9)


@pytest.mark.parametrize("name", ["allegro", "ability", "shadow", "inspire"])
@pytest.mark.parametrize("format", FORMATS)
def test_a_grasp_comes_back_by_names(format, name, tmp_path):
    if format == "dexgraspdb" and name != "allegro":
        pytest.skip("the format is for hands of 16 joints")
    hand, rng = load_hand(name), np.random.default_rng(1)
    scene = make_scene(load_object("can"))
    q = rng.uniform(*hand.limits, size=(3, len(hand.joint_names)))
    grasp = Grasp(hand.name, "can", scene.X_WO, random_pose(rng), q[0], grasp_id="a")
    grasp = replace(grasp, X_WH_pregrasp=random_pose(rng), q_pregrasp=q[1], q_squeeze=q[2], tau_squeeze=0.1 * q[2])
    record = record_of(grasp, hand, scene, all_joints=FORMATS[format].all_joints)
    if format == "dexgraspdb":
        record = replace(record, contacts=random_records(format)[0].contacts)
    path = file_of(format, tmp_path)
    FORMATS[format].write(path, [record])
    (read,) = FORMATS[format].read(path)
    found = resolve(read, hand, str(path))
    X_WO = read.X_WO
    assert X_WO is not None and found.grasp.off_coupling < 1e-9
    np.testing.assert_allclose((X_WO @ found.grasp.X_OH).GetAsMatrix4(), grasp.X_WH.GetAsMatrix4(), atol=1e-9)
    np.testing.assert_allclose(found.grasp.q, grasp.q, atol=1e-12)
    if format != "dexgraspdb":
        assert found.pregrasp is not None and found.squeeze is not None and found.tau is not None
        at = X_WO @ found.pregrasp.X_OH
        np.testing.assert_allclose(at.GetAsMatrix4(), grasp.X_WH_pregrasp.GetAsMatrix4(), atol=1e-9)
        np.testing.assert_allclose([*found.squeeze.q, *found.tau], [*q[2], *(0.1 * q[2])], atol=1e-12)


def test_frames_are_links_of_the_hand_and_names_may_have_a_prefix():
    hand = load_hand("allegro")
    rng = np.random.default_rng(2)
    q, X_OH = rng.uniform(*hand.limits), random_pose(rng)
    R, p = forward_kinematics(hand, X_OH, q)
    tip = hand.link_index["link_3.0"]
    X_LG = RigidTransform(RotationMatrix.MakeZRotation(0.3), [0.01, 0.0, 0.02])
    X_OG = RigidTransform(RotationMatrix.ProjectToRotationMatrix(R[tip]), p[tip]) @ X_LG
    order = rng.permutation(16)
    names = tuple(f"rh_{hand.joint_names[k]}" for k in order)
    record = GraspRecord("a", Stage(X_OG, q[order]), joint_names=names, frame="somewhere")
    words = ["link_3.0", *(str(v) for v in seven(X_LG))]
    found = resolve(record, hand, "file", frame=parse_frame(words, hand))
    np.testing.assert_allclose(found.grasp.q, q)
    np.testing.assert_allclose(found.grasp.X_OH.GetAsMatrix4(), X_OH.GetAsMatrix4(), atol=1e-9)
    with pytest.raises(GraspFileError, match=r"'somewhere' is no link of allegro; say which.*--frame"):
        resolve(record, hand, "file")
    nameless = replace(record, joint_names=None)
    with pytest.raises(GraspFileError, match="have no names; give their order by --joint-order"):
        resolve(nameless, hand, "file", frame=parse_frame(["wrist"], hand))
    plain = replace(nameless, grasp=Stage(X_OH, q))
    found = resolve(
        plain, hand, "file", frame=parse_frame(["wrist"], hand), joint_order=parse_order(["actuated"], hand)
    )
    np.testing.assert_allclose(found.grasp.X_OH.GetAsMatrix4(), X_OH.GetAsMatrix4(), atol=1e-12)
    for words in (["nowhere"], ["wrist", "1"], ["wrist", "x", "y", "z"], ["wrist", *"0000000"]):
        with pytest.raises(ConfigError, match="--frame"):
            parse_frame(words, hand)


def test_coupled_joints_that_leave_their_law_are_told():
    hand = load_hand("ability")
    names = tuple(joint.name for joint in hand.joints)
    values = hand.q_full(hand.q_rest)
    values[names.index("index_q2")] += 0.25
    record = GraspRecord("a", Stage(RigidTransform(), values), joint_names=names, frame="base_link")
    assert resolve(record, hand, "file").grasp.off_coupling == pytest.approx(0.25)


def test_conventions_are_for_the_librarys_own_hand():
    shadow = load_hand("shadow")
    known = convention_of("dexgraspbench", shadow)
    assert known is not None and known.joint_names == shadow.joint_names and known.frame.link == "palm"
    assert convention_of("dexgraspbench", replace(shadow, q_rest=shadow.q_rest + 0.01)) is None
    assert convention_of("isaac_grasp", shadow) is None
    qpos = np.concatenate([[0.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0], shadow.q_rest])
    record = GraspRecord("a", Stage(RigidTransform(qpos[:3]), qpos[7:]))
    # Their world frame lies 34 mm below the palm, where our wrist frame is.
    at = resolve(record, shadow, "file", convention=known).grasp.X_OH
    np.testing.assert_allclose(at.translation(), [0.0, 0.0, 0.234], atol=1e-9)


def pickled(content: object, protocol: int = 4) -> bytes:
    """The bytes of a `.npy` file that holds a pickled object."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "|O", "fortran_order": False, "shape": ()})
    pickle.dump(np.array(content, dtype=object), file, protocol=protocol)
    return file.getvalue()


class Bad:
    """What runs a command where it is unpickled."""

    def __reduce__(self):
        return os.system, ("touch it_ran",)


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_pickled_dictionaries_of_arrays_are_read(protocol, tmp_path):
    qpos = np.array([[0.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0, 0.3, 0.4]], dtype=np.float32)
    content = {
        "grasp_qpos": qpos,
        "pregrasp_qpos": np.repeat(qpos, 2, axis=0),
        "squeeze_qpos": np.asfortranarray(qpos),
        "obj_pose": np.array([0.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0]),
        "obj_scale": np.float64(0.08),
        "joint_names": ["FFJ1", "THJ1"],
        "obj_path": "assets/mug",
    }
    file = tmp_path / "grasp.npy"
    file.write_bytes(pickled(content, protocol))
    (record,) = FORMATS["dexgraspbench"].read(file)
    assert record.joint_names == ("FFJ1", "THJ1") and record.scale == pytest.approx(0.08)
    assert record.X_WO is not None and record.pregrasp is not None and record.squeeze is not None
    np.testing.assert_allclose((record.X_WO @ record.grasp.X_OG).translation(), [0.0, 0.0, 0.2], atol=1e-7)
    np.testing.assert_allclose(record.squeeze.values, [0.3, 0.4], atol=1e-7)


def test_bodex_rows_are_pregrasp_grasp_and_squeeze(tmp_path):
    rows = np.zeros((1, 2, 5, 9))
    rows[..., 3], rows[..., 7] = 1.0, np.arange(5)
    (tmp_path / "x.npy").write_bytes(pickled({"robot_pose": rows, "joint_names": ["a", "b"]}))
    for record in FORMATS["dexgraspbench"].read(tmp_path / "x.npy"):
        assert record.pregrasp is not None and record.squeeze is not None
        assert [s.values[0] for s in (record.pregrasp, record.grasp, record.squeeze)] == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    "content",
    [
        {"grasp_qpos": Bad()},
        {"grasp_qpos": np.array([Bad()], dtype=object)},
        np.random.default_rng(0),
        {"a": Path("x")},
        {"f": print},
        {"e": np.dtype([("x", "f8")])},
    ],
)
def test_a_pickle_of_anything_else_is_refused_and_nothing_runs(content, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.npy").write_bytes(pickled(content))
    with pytest.raises(GraspFileError, match=r"x\.npy: its pickle holds .*convert it") as error:
        read_plain_npy(tmp_path / "x.npy")
    assert "\n" not in str(error.value) and not (tmp_path / "it_ran").exists()


def test_pickles_that_claim_too_much_are_refused(tmp_path):
    # Calls of the class of arrays itself would reserve memory as asked for.
    for call in (
        b"cnumpy\nndarray\n(L100000000000L\ntR.",
        b"cnumpy.core.multiarray\n_reconstruct\n(L1L\nL9L\nL9L\ntR.",
    ):
        head = pickled({})[: 10 + int.from_bytes(pickled({})[8:10], "little")]
        (tmp_path / "x.npy").write_bytes(head + call)
        with pytest.raises(GraspFileError):
            FORMATS["dexgraspbench"].read(tmp_path / "x.npy")


def spoiled(format: str, folder: Path, change: str) -> Path:
    """A file with one thing wrong."""
    records, path = random_records(format), file_of(format, folder)
    if change == "nan":
        grasp = replace(records[1].grasp, values=np.append(np.nan, records[1].grasp.values[1:]))
        records[1] = replace(records[1], grasp=grasp)
    if change == "nan" and format == "dexgraspdb":
        with pytest.raises(ValueError, match="JSON"):
            FORMATS[format].write(path, records)
        FORMATS[format].write(path, random_records(format))
        content = json.loads(path.read_text())
        content["grasps"][1]["hand_dof_values"][0] = float("nan")
        path.write_text(json.dumps(content))
        return path
    FORMATS[format].write(path, records)
    data = path.read_bytes()
    if change == "cut":
        path.write_bytes(data[: len(data) // 2])
    elif change == "empty":
        path.write_bytes(b"")
    elif change == "noise":
        path.write_bytes(np.random.default_rng(0).bytes(1000))
    return path


@pytest.mark.parametrize("change", ["nan", "cut", "empty", "noise"])
@pytest.mark.parametrize("format", FORMATS)
def test_damaged_files_are_one_line(format, change, tmp_path):
    path = spoiled(format, tmp_path, change)
    with pytest.raises(GraspFileError) as error:
        FORMATS[format].read(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_bombs_are_refused(tmp_path):
    bomb = "format: isaac_grasp\na: &a [x, x]\nb: &b [*a, *a]\ngrasps: {g: *b}\n"
    (tmp_path / "x.yaml").write_text(bomb)
    with pytest.raises(GraspFileError, match="alias"):
        FORMATS["isaac_grasp"].read(tmp_path / "x.yaml")
    (tmp_path / "deep.json").write_text('{"grasps": ' + "[" * 100_000)
    with pytest.raises(GraspFileError, match="JSON"):
        FORMATS["dexgraspdb"].read(tmp_path / "deep.json")
    with zipfile.ZipFile(tmp_path / "x.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for k in range(3):
            archive.writestr(f"q{k}.npy", b"\0" * 100_000_000)
    assert (tmp_path / "x.npz").stat().st_size < 1_000_000
    with pytest.raises(GraspFileError, match="unfolds to 300 MB"):
        FORMATS["arrays"].read(tmp_path / "x.npz")
    np.savez(tmp_path / "y.npz", q=np.array([Bad()], dtype=object), X_OG=np.eye(4)[None])
    with pytest.raises(GraspFileError, match="plain arrays"):
        FORMATS["arrays"].read(tmp_path / "y.npz")


def test_texts_for_numbers_are_numbers(tmp_path):
    """YAML 1.1 takes 1e-05 for a text, and some writers put versions in quotes."""
    FORMATS["isaac_grasp"].write(tmp_path / "x.yaml", random_records("isaac_grasp", 1))
    content = yaml.safe_load((tmp_path / "x.yaml").read_text())
    content["format_version"] = "1.0"
    content["grasps"]["g-0"]["position"][0] = "1e-05"
    (tmp_path / "x.yaml").write_text(yaml.safe_dump(content))
    (record,) = FORMATS["isaac_grasp"].read(tmp_path / "x.yaml")
    assert record.grasp.X_OG.translation()[0] == 1e-05
