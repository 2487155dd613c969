"""Hand files: what is accepted, what is refused, and that each refusal names file, field and remedy."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from xdex_drake.errors import HandFileError
from xdex_drake.hand import yaml_file
from xdex_drake.hand.collision import ignored_pairs, self_collision_pairs
from xdex_drake.hand.description import Convex
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.yaml_file import hand_digest, hand_text, read_hand, write_hand


def small_hand() -> dict:
    """A hand of one finger with two actuated joints and a coupled one, as plain data."""
    joint = {"type": "revolute", "xyz": [0.0, 0.0, 0.03], "axis": [0.0, 1.0, 0.0], "limits": [0.0, 1.5], "effort": 1.0}
    capsule = {"capsule": {"from": [0.0, 0.0, 0.0], "to": [0.0, 0.0, 0.03], "radius": 0.008}}
    return {
        "name": "small",
        "display_name": "A small hand",
        "side": "right",
        "wrist": {"xyz": [0.0, 0.0, 0.0], "rpy": [0.0, 0.1, 0.0]},
        "links": {
            "palm": {"geometry": [{"box": {"size": [0.02, 0.06, 0.05], "xyz": [0.0, 0.0, 0.0]}}], "mass": 0.2},
            "one": {"geometry": [capsule]},
            "two": {"geometry": [capsule]},
            "three": {"geometry": [capsule]},
        },
        "joints": {
            "a": {**joint, "parent": "palm", "child": "one"},
            "b": {**joint, "parent": "one", "child": "two"},
            "c": {
                **joint,
                "parent": "two",
                "child": "three",
                "coupling": {"master": "b", "multiplier": 0.8, "offset": 0.1},
            },
        },
        "fingers": {
            "index": {
                "links": ["one", "two", "three"],
                "tip_link": "three",
                "tip": [0.0, 0.0, 0.038],
                "pad": [1.0, 0.0, 0.0],
            }
        },
        "rest": {"a": 0.4, "b": 0.5},
        "sources": {"kinematics": "made up"},
    }


def written(folder: Path, data: dict) -> Path:
    path = folder / "small.yaml"
    dumper = yaml.SafeDumper
    dumper.ignore_aliases = lambda self, data: True  # type: ignore[method-assign]
    path.write_text(yaml.dump(data, Dumper=dumper, sort_keys=False))
    return path


def refusal(folder: Path, edit: Callable[[dict], object]) -> str:
    data = small_hand()
    edit(data)
    with pytest.raises(HandFileError) as error:
        read_hand(written(folder, data))
    message = str(error.value)
    assert "small.yaml" in message
    assert "\n" not in message
    return message


def test_a_small_hand_is_read(tmp_path) -> None:
    hand = read_hand(written(tmp_path, small_hand()))
    assert hand.joint_names == ("a", "b")
    assert hand.q_full(hand.q_rest) == pytest.approx([0.4, 0.5, 0.5])
    assert hand.limits[1] == pytest.approx([1.5, 1.5])
    assert hand.links[1].mass > 0.0


def test_order_in_the_file_does_not_matter(tmp_path) -> None:
    data = small_hand()
    data["joints"] = dict(reversed(list(data["joints"].items())))
    data["links"] = dict(reversed(list(data["links"].items())))
    hand = read_hand(written(tmp_path, data))
    assert [link.name for link in hand.links] == ["palm", "one", "two", "three"]
    assert hand_digest(hand) == hand_digest(read_hand(written(tmp_path, small_hand())))


def set_at(*path: str, value: object) -> Callable[[dict], None]:
    def edit(data: dict) -> None:
        for key in path[:-1]:
            data = data[key]
        data[path[-1]] = value

    return edit


REFUSED = {
    "unknown field": (set_at("colour", value="red"), ["unknown field 'colour'", "known are"]),
    "misspelt field": (set_at("joints", "a", "limit", value=[0, 1]), ["joints.a", "did you mean 'limits'"]),
    "missing field": (lambda d: d["joints"]["a"].pop("effort"), ["joints.a", "lacks the field 'effort'"]),
    "missing section": (lambda d: d.pop("fingers"), ["lacks the field 'fingers'"]),
    "not a mapping": (set_at("links", value=[1]), ["links", "must be a mapping"]),
    "not a list": (set_at("joints", "a", "xyz", value=3), ["joints.a.xyz", "must be a list"]),
    "too few numbers": (set_at("joints", "a", "xyz", value=[0.0, 1.0]), ["joints.a.xyz", "2 numbers", "give 3"]),
    "not a number": (set_at("joints", "a", "xyz", value=["x", 0, 0]), ["joints.a.xyz[0]", "must be a number"]),
    "boolean": (set_at("joints", "a", "effort", value=True), ["joints.a.effort", "must be a number"]),
    "NaN": (set_at("joints", "a", "xyz", value=[float("nan"), 0, 0]), ["joints.a.xyz[0]", "finite"]),
    "NaN limit": (set_at("joints", "a", "limits", value=[0, float("nan")]), ["joints.a.limits[1]", "finite"]),
    "infinity": (set_at("joints", "a", "effort", value=float("inf")), ["joints.a.effort", "finite"]),
    "huge number": (set_at("joints", "a", "effort", value=10**400), ["joints.a.effort", "finite"]),
    "limits crossed": (set_at("joints", "a", "limits", value=[1.0, 0.0]), ["joints.a.limits", "swap"]),
    "axis length": (set_at("joints", "a", "axis", value=[0, 2, 0]), ["joints.a.axis", "unit vector"]),
    "axis zero": (set_at("joints", "a", "axis", value=[0, 0, 0]), ["joints.a.axis", "unit vector"]),
    "pad length": (set_at("fingers", "index", "pad", value=[0, 0, 3]), ["fingers.index.pad", "unit vector"]),
    "effort zero": (set_at("joints", "a", "effort", value=0), ["joints.a.effort", "greater than 0"]),
    "joint kind": (set_at("joints", "a", "type", value="fixed"), ["joints.a.type", "merge"]),
    "unknown parent": (set_at("joints", "a", "parent", value="plam"), ["joints.a.parent", "did you mean 'palm'"]),
    "unknown child": (set_at("joints", "a", "child", value="zz"), ["joints.a.child", "no link"]),
    "two parents": (set_at("joints", "c", "child", value="two"), ["joints.c.child", "one parent"]),
    "two bases": (lambda d: d["links"].update(spare={}), ["joints", "palm, spare", "exactly one"]),
    "cycle": (set_at("joints", "a", "parent", value="three"), ["joints", "cycle"]),
    "self loop": (set_at("joints", "a", "parent", value="one"), ["joints", "cycle"]),
    "no links": (set_at("links", value={}), ["links", "empty"]),
    "unknown master": (set_at("joints", "c", "coupling", "master", value="z"), ["joints.c.coupling", "no joint"]),
    "coupled to itself": (set_at("joints", "c", "coupling", "master", value="c"), ["joints.c.coupling", "itself"]),
    "chained coupling": (
        set_at("joints", "b", "coupling", value={"master": "a", "multiplier": 1.0}),
        ["joints.c.coupling", "coupled itself", "'a'"],
    ),
    "coupling out of reach": (set_at("joints", "c", "coupling", "offset", value=9.0), ["joints.b.limits", "no value"]),
    "no fingers": (set_at("fingers", value={}), ["fingers", "empty"]),
    "finger without links": (set_at("fingers", "index", "links", value=[]), ["fingers.index.links", "empty"]),
    "finger skips a link": (
        set_at("fingers", "index", "links", value=["one", "three"]),
        ["fingers.index.links", "not its parent"],
    ),
    "finger of the palm": (
        set_at("fingers", "index", "links", value=["palm", "one", "two", "three"]),
        ["fingers.index.links", "base link"],
    ),
    "finger of no link": (set_at("fingers", "index", "links", value=["x"]), ["fingers.index.links", "no link"]),
    "tip link not last": (set_at("fingers", "index", "tip_link", value="two"), ["fingers.index.tip_link", "last"]),
    "rest outside": (set_at("rest", "a", value=2.0), ["rest.a", "limits"]),
    "rest outside by coupling": (set_at("joints", "c", "limits", value=[0.0, 0.45]), ["rest.b", "'c'"]),
    "rest incomplete": (lambda d: d["rest"].pop("b"), ["rest", "lacks the field 'b'"]),
    "rest of a coupled joint": (set_at("rest", "c", value=0.0), ["rest", "unknown field 'c'"]),
    "mass": (set_at("links", "palm", "mass", value=-1.0), ["links.palm.mass", "greater than 0"]),
    "radius": (set_at("links", "one", "geometry", value=[{"sphere": {"center": [0, 0, 0], "radius": 0}}]), ["radius"]),
    "two shapes in one": (set_at("links", "one", "geometry", value=[{}]), ["links.one.geometry[0]", "0 shapes"]),
    "flat hull": (
        set_at(
            "links", "one", "geometry", value=[{"convex": {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}}]
        ),
        ["links.one.geometry[0].convex.vertices", "plane"],
    ),
    "flat box": (
        set_at("links", "one", "geometry", value=[{"box": {"size": [1, 0, 1], "xyz": [0, 0, 0]}}]),
        ["links.one.geometry[0].box.size", "positive"],
    ),
    "inertia": (
        set_at("links", "one", "inertia", value=[[1, 0, 0], [0, 1, 0], [0, 0, 3]]),
        ["links.one.inertia", "no body has"],
    ),
    "sphere radius": (set_at("links", "one", "spheres", value=[[0, 0, 0, -1]]), ["links.one.spheres", "radius"]),
    "side": (set_at("side", value="both"), ["side", "right or left"]),
    "not a rotation": (
        set_at("wrist", value={"xyz": [0, 0, 0], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}),
        ["wrist.rotation", "rotation matrix"],
    ),
    "two rotations": (
        set_at("wrist", value={"xyz": [0, 0, 0], "rpy": [0, 0, 0], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}),
        ["wrist", "keep one"],
    ),
    "key is a number": (lambda d: d["links"].update({7: {}}), ["links", "quotes"]),
    "name is a number": (set_at("name", value=5), ["name", "quotes"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals_name_field_and_remedy(tmp_path, case) -> None:
    edit, parts = REFUSED[case]
    message = refusal(tmp_path, edit)
    for part in parts:
        assert part in message, message


def test_numbers_as_people_write_them(tmp_path) -> None:
    # YAML 1.1 takes 1e-2 for a text.
    path = written(tmp_path, small_hand())
    path.write_text(path.read_text().replace("radius: 0.008", "radius: 8e-3"))
    assert read_hand(path).links[1].geometry[0].radius == 0.008


def refusal_of_text(folder: Path, text: str) -> str:
    path = folder / "text.yaml"
    path.write_text(text)
    with pytest.raises(HandFileError) as error:
        read_hand(path)
    assert "text.yaml" in str(error.value)
    return str(error.value)


def test_broken_syntax(tmp_path) -> None:
    assert "not valid YAML" in refusal_of_text(tmp_path, "name: [1, 2")
    assert "must be a mapping" in refusal_of_text(tmp_path, "")
    assert "must be a mapping" in refusal_of_text(tmp_path, "- 1\n- 2\n")


def test_a_name_given_twice(tmp_path) -> None:
    assert "given twice" in refusal_of_text(tmp_path, "name: a\nlinks: {x: {}, x: {}}\n")


def test_code_is_not_run(tmp_path) -> None:
    assert "not valid YAML" in refusal_of_text(tmp_path, "name: !!python/object/apply:os.getcwd []\n")


def test_alias_bombs_are_refused_at_once(tmp_path) -> None:
    lines = ["a0: &a0 [0, 0, 0, 0, 0, 0, 0, 0, 0, 0]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    assert "alias" in refusal_of_text(tmp_path, "\n".join(lines))


def test_deep_nesting_is_refused(tmp_path) -> None:
    assert "nested deeper" in refusal_of_text(tmp_path, "name: " + "[" * 20000 + "]" * 20000)


def test_huge_files_are_refused(tmp_path) -> None:
    assert "bytes" in refusal_of_text(tmp_path, "#" * (yaml_file.MAX_BYTES + 1))
    data = small_hand()
    data["links"].update({f"l{k}": {} for k in range(yaml_file.MAX_LINKS + 1)})
    with pytest.raises(HandFileError, match="merge links"):
        read_hand(written(tmp_path, data))


def test_unreadable_files(tmp_path) -> None:
    with pytest.raises(HandFileError, match="cannot be read"):
        read_hand(tmp_path / "absent.yaml")
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(HandFileError, match=r"binary\.yaml"):
        read_hand(binary)
    hand = read_hand(written(tmp_path, small_hand()))
    with pytest.raises(HandFileError, match="cannot be written"):
        write_hand(hand, tmp_path / "no" / "such" / "folder.yaml")


def test_everything_survives_a_round_trip(tmp_path) -> None:
    data = small_hand()
    rng = np.random.default_rng(0)
    data["display_name"] = 'Quotes ", colons: and #, ünïcode'
    data["sources"] = {"a key: odd": "text", "yes": "no"}
    data["wrist"]["rpy"] = rng.uniform(-3.0, 3.0, 3).tolist()
    data["joints"]["a"]["rpy"] = [0.3, np.pi / 2, 0.2]  # gimbal lock
    data["joints"]["a"]["type"] = "prismatic"
    hull = rng.normal(scale=0.01, size=(12, 3))
    data["links"]["one"]["geometry"] += [
        {"convex": {"vertices": hull.tolist()}},
        {"sphere": {"center": [0.001, 0.002, 0.003], "radius": 0.01}},
        {"box": {"size": [0.01, 0.02, 0.03], "xyz": [0, 0, 0], "rpy": [0.1, 0.2, 0.3]}},
    ]
    data["links"]["two"]["inertia"] = [[3e-6, 1e-7, 0.0], [1e-7, 3e-6, 0.0], [0.0, 0.0, 2.5e-6]]
    data["links"]["two"]["center_of_mass"] = [0.001, 0.0, 0.01]
    data["links"]["three"]["spheres"] = [[0.0, 0.0, 0.01, 0.008], [0.0, 0.0, 0.02, 0.007]]
    hand = read_hand(written(tmp_path, data))
    write_hand(hand, tmp_path / "again.yaml")
    again = read_hand(tmp_path / "again.yaml")
    assert hand_digest(again) == hand_digest(hand)
    assert (again.display_name, again.sources) == (hand.display_name, hand.sources)
    for a, b in zip(hand.links, again.links, strict=True):
        assert np.array_equal(a.spheres, b.spheres)
        assert np.array_equal(a.I_LLcm, b.I_LLcm)
        assert np.array_equal(a.p_LLcm, b.p_LLcm)
        assert len(a.geometry) == len(b.geometry)
    assert np.array_equal(hand.R_HB, again.R_HB)
    assert all(np.array_equal(a.R_PJ, b.R_PJ) for a, b in zip(hand.joints, again.joints, strict=True))
    assert isinstance(again.links[1].geometry[1], Convex)
    assert "inertia" in (tmp_path / "again.yaml").read_text()


def test_ignored_contacts_survive_and_leave_other_digests_alone(tmp_path) -> None:
    hand = load_hand("allegro")
    assert "ignored_contacts" not in hand_text(hand)
    pairs = tuple((hand.links[i].name, hand.links[j].name) for i, j in ((0, 3), (16, 8)))
    told = replace(hand, ignored_contacts=pairs)
    write_hand(told, tmp_path / "told.yaml")
    back = read_hand(tmp_path / "told.yaml")
    assert back.ignored_contacts == pairs
    assert hand_digest(back) == hand_digest(told) != hand_digest(hand)
    kept = {(int(i), int(j)) for i, j in self_collision_pairs(hand)}
    assert kept - {(int(i), int(j)) for i, j in self_collision_pairs(back)} == {(0, 3), (8, 16)} & kept
    assert {(0, 3), (8, 16)} <= {(int(i), int(j)) for i, j in ignored_pairs(back)}


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ("[[BASE]]", "names 1 links"),
        ("[[BASE, BASE]]", "two different links"),
        ("[[BASE, nowhere]]", "'nowhere', which is no link"),
        ("[[BASE, TIP], [TIP, BASE]]", "repeats the pair"),
        ("none", "must be a list"),
    ],
)
def test_bad_ignored_contacts_are_refused(tmp_path, pairs, message) -> None:
    hand = load_hand("allegro")
    pairs = pairs.replace("BASE", hand.links[0].name).replace("TIP", hand.links[4].name)
    (tmp_path / "hand.yaml").write_text(hand_text(hand) + f"ignored_contacts: {pairs}\n")
    with pytest.raises(HandFileError, match=message):
        read_hand(tmp_path / "hand.yaml")
