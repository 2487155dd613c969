"""Hand descriptions as YAML files: reading with checks, writing, and the digest of a hand.

A file reads like a data sheet (see `hands/allegro.yaml`). Rotations are fixed-axis roll, pitch, yaw (R = Rz Ry Rx);
spheres, centers of mass and inertias are computed from the geometry unless the file states them.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import math
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Box, Capsule, Convex, Coupling, Finger, Geometry, Hand, Joint, Link, Sphere
from xdex_drake.hand.inertia import link_inertia
from xdex_drake.hand.shapes import values_of
from xdex_drake.hand.spheres import fit_spheres
from xdex_drake.hand.surface import read_surfaces, write_surfaces
from xdex_drake.typed_yaml import YamlLoader, plain_yaml

MAX_BYTES = 5_000_000
MAX_LINKS = 500
UNIT_TOLERANCE = 1e-3
"""A direction's length may differ from one by this much, for the digits a person writes."""


def read_hand(path: str | Path) -> Hand:
    """Reads a hand description.

    Args:
        path: A `.yaml` file.

    Returns:
        The hand, checked: a hand that is returned can be built in Drake.

    Raises:
        HandFileError: The file cannot be read or does not describe a hand; the message names file, field and remedy.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise HandFileError(
                f"{path}: the file has {size} bytes, more than {MAX_BYTES}; leave out vertices or spheres"
            )
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise HandFileError(f"{path}: the file cannot be read ({error}); give a readable UTF-8 text file") from error
    return _with_surfaces(parse_hand(text, str(path)), surfaces_file(path))


def write_hand(hand: Hand, path: str | Path) -> None:
    """Writes a hand description that `read_hand` reads back equal, and beside it what it looks like (`surfaces_file`).

    Args:
        hand: The hand.
        path: The file to write; its folder must exist.

    Raises:
        HandFileError: The file cannot be written.
    """
    try:
        looks = surfaces_file(Path(path))
        if any(link.surfaces for link in hand.links):
            write_surfaces({link.name: link.surfaces for link in hand.links}, looks)
        else:
            # One of an earlier hand would be taken for this one's.
            looks.unlink(missing_ok=True)
        Path(path).write_text(hand_text(hand), encoding="utf-8")
    except OSError as error:
        raise HandFileError(f"{path}: the file cannot be written ({error}); give a writable path") from error


def surfaces_file(path: Path) -> Path:
    """The file beside a hand's file, NAME.looks.glb for NAME.yaml, that holds surfaces to draw; there may be none."""
    return path.with_suffix(".looks.glb")


def _with_surfaces(hand: Hand, file: Path) -> Hand:
    if not file.is_file():
        return hand
    surfaces = read_surfaces(file)
    return replace(hand, links=tuple(replace(link, surfaces=surfaces.get(link.name, ())) for link in hand.links))


def hand_text(hand: Hand) -> str:
    """The text of a hand's file.

    Args:
        hand: The hand.

    Returns:
        What `write_hand` writes.
    """
    return "\n".join(_lines(hand)) + "\n"


def hand_digest(hand: Hand) -> str:
    """SHA-256 of all that makes a hand what it is, without its display name and sources.

    Numbers are rounded to nine significant digits, so the digest survives a round trip and another machine's last bit.

    Args:
        hand: The hand.

    Returns:
        64 hexadecimal digits.
    """
    body = {
        "name": hand.name,
        "side": hand.side,
        "wrist": [hand.p_HB, hand.R_HB],
        "links": [
            [k.name, [values_of(g) for g in k.geometry], k.mass, k.p_LLcm, k.I_LLcm, k.spheres] for k in hand.links
        ],
        "joints": [
            [j.name, j.kind, j.parent, j.child, j.p_PJ, j.R_PJ, j.axis, j.lower, j.upper, j.effort]
            + ([] if j.coupling is None else [j.coupling.master, j.coupling.multiplier, j.coupling.offset])
            for j in hand.joints
        ],
        "fingers": [[f.name, list(f.links), f.tip_link, f.p_LTip, f.n_LPad] for f in hand.fingers],
        "rest": hand.q_rest,
    }
    if hand.ignored_contacts:
        body["ignored_contacts"] = [list(pair) for pair in hand.ignored_contacts]
    return hashlib.sha256(json.dumps(_canonical(body), sort_keys=True).encode()).hexdigest()


def _canonical(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _canonical(value.tolist())
    if isinstance(value, Mapping):
        return {k: _canonical(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_canonical(v) for v in value]
    if isinstance(value, float):
        return "0" if abs(value) < 1e-12 else f"{value:.9g}"
    return value


# ---- reading


class _Loader(YamlLoader):
    """The safe loader, which also refuses a key that is given twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        keys = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)  # type: ignore[no-untyped-call]
            if not isinstance(key, Hashable):
                raise yaml.constructor.ConstructorError(None, None, "a key is not a name", key_node.start_mark)
            if key in keys:
                raise yaml.constructor.ConstructorError(None, None, f"{key!r} is given twice", key_node.start_mark)
            keys.add(key)
        return super().construct_mapping(node, deep)


def _load(text: str, file: str) -> Any:
    """Plain data from a hand's text."""
    return plain_yaml(text, file, error=HandFileError, mend="use the layout of hands/*.yaml", loader=_Loader)


class _Field:
    """A value in the file together with its place, for messages."""

    def __init__(self, value: Any, file: str, place: str) -> None:
        self.value, self.file, self.place = value, file, place

    def fail(self, what: str, mend: str) -> HandFileError:
        return HandFileError(f"{self.file}: {self.place or 'the file'} {what}; {mend}")

    def table(self, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict[str, _Field]:
        """A mapping with known keys."""
        fields = self.mapping()
        for key in fields:
            if key not in required + optional:
                close = difflib.get_close_matches(key, required + optional, n=1)
                mend = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(required + optional)}"
                raise self.fail(f"has an unknown field {key!r}", mend)
        for key in required:
            if key not in fields:
                raise self.fail(f"lacks the field {key!r}", "add it")
        return fields

    def mapping(self) -> dict[str, _Field]:
        """A mapping whose keys are names of the user's."""
        if not isinstance(self.value, dict):
            raise self.fail(f"must be a mapping, not {self.value!r:.40}", "write `name: value` lines")
        out = {}
        for key, value in self.value.items():
            if not isinstance(key, str) or not key:
                raise self.fail(f"has the key {key!r}, which is not a text", "put it in quotes")
            out[key] = _Field(value, self.file, f"{self.place}.{key}" if self.place else key)
        return out

    def items(self) -> list[_Field]:
        if not isinstance(self.value, list):
            raise self.fail(f"must be a list, not {self.value!r:.40}", "write `[a, b]` or lines with dashes")
        return [_Field(v, self.file, f"{self.place}[{k}]") for k, v in enumerate(self.value)]

    def text(self) -> str:
        if not isinstance(self.value, str) or not self.value:
            raise self.fail(f"must be a text, not {self.value!r:.40}", "put it in quotes if it looks like a number")
        return self.value

    def number(self, *, above: float | None = None) -> float:
        value = self.value
        if isinstance(value, str):  # YAML 1.1 takes 1e-3 for a text.
            try:
                value = float(value)
            except ValueError:
                value = None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(f"must be a number, not {self.value!r:.40}", "write a decimal number")
        try:
            value = float(value)
        except OverflowError:
            value = math.inf
        if not math.isfinite(value) or abs(value) > 1e6:
            raise self.fail(f"is {value}", "give a finite number in SI units")
        if above is not None and value <= above:
            raise self.fail(f"is {value}", f"it must be greater than {above:g}")
        return value

    def vector(self, n: int) -> Array:
        values = self.items()
        if len(values) != n:
            raise self.fail(f"has {len(values)} numbers", f"give {n}")
        return np.array([v.number() for v in values])

    def unit_vector(self) -> Array:
        v = self.vector(3)
        length = float(np.linalg.norm(v))
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise self.fail(f"has length {length:.6g}", "divide it by its length: it must be a unit vector")
        return v if abs(length - 1.0) < 1e-14 else v / length

    def matrix(self, n: int) -> Array:
        rows = self.items()
        if len(rows) != n:
            raise self.fail(f"has {len(rows)} rows", f"give {n}")
        return np.array([row.vector(n) for row in rows])


def parse_hand(text: str, file: str) -> Hand:
    """Reads a hand description from its text.

    Args:
        text: The text, as `hand_text` gives it.
        file: Where it comes from, for messages.

    Returns:
        The hand, checked as by `read_hand`.

    Raises:
        HandFileError: It does not describe a hand.
    """
    root = _Field(_load(text, file), file, "")
    fields = root.table(
        ("name", "display_name", "side", "wrist", "links", "joints", "fingers", "rest", "sources"),
        ("ignored_contacts",),
    )
    side = fields["side"].text()
    if side not in ("right", "left"):
        raise fields["side"].fail(f"is {side!r}", "write right or left")
    p_HB, R_HB = _pose(fields["wrist"])
    links = _links(fields["links"])
    joints = _joints(fields["joints"], links)
    links, joints = _in_tree_order(fields["joints"], links, joints)
    return Hand(
        name=fields["name"].text(),
        display_name=fields["display_name"].text(),
        side=side,
        links=links,
        joints=joints,
        fingers=_fingers(fields["fingers"], links, joints),
        p_HB=p_HB,
        R_HB=R_HB,
        q_rest=_rest(fields["rest"], joints),
        sources={key: value.text() for key, value in fields["sources"].mapping().items()},
        ignored_contacts=_ignored_contacts(fields["ignored_contacts"], links) if "ignored_contacts" in fields else (),
    )


def _pose(place: _Field) -> tuple[Array, Array]:
    fields = place.table(("xyz",), ("rpy", "rotation"))
    return fields["xyz"].vector(3), _rotation(place, fields)


def _rotation(place: _Field, fields: dict[str, _Field]) -> Array:
    """Rotation from `rpy` or from the rows of `rotation`; the identity where neither is given."""
    if "rpy" in fields and "rotation" in fields:
        raise place.fail("has both 'rpy' and 'rotation'", "keep one")
    if "rotation" in fields:
        R = fields["rotation"].matrix(3)
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0:
            raise fields["rotation"].fail("is not a rotation matrix", "give orthonormal rows with determinant 1")
        return R
    return rpy_matrix(fields["rpy"].vector(3)) if "rpy" in fields else np.eye(3)


def rpy_matrix(rpy: Array) -> Array:
    """R = Rz(yaw) Ry(pitch) Rx(roll) of fixed-axis angles (roll, pitch, yaw) [rad], shape (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _links(place: _Field) -> tuple[Link, ...]:
    fields = place.mapping()
    if not fields:
        raise place.fail("is empty", "describe at least the base link")
    if len(fields) > MAX_LINKS:
        raise place.fail(f"has {len(fields)} links, more than {MAX_LINKS}", "merge links that do not move")
    return tuple(_link(name, field) for name, field in fields.items())


def _link(name: str, place: _Field) -> Link:
    fields = place.table((), ("geometry", "mass", "center_of_mass", "inertia", "spheres"))
    geometry = tuple(_geometry(item) for item in fields["geometry"].items()) if "geometry" in fields else ()
    mass = fields["mass"].number(above=0.0) if "mass" in fields else None
    mass, p_LLcm, I_LLcm = link_inertia(geometry, mass)
    if "center_of_mass" in fields:
        p_LLcm = fields["center_of_mass"].vector(3)
    if "inertia" in fields:
        I_LLcm = _inertia(fields["inertia"])
    spheres = _sphere_rows(fields["spheres"]) if "spheres" in fields else fit_spheres(geometry)
    return Link(name, geometry, mass, p_LLcm, I_LLcm, spheres)


def _inertia(place: _Field) -> Array:
    I = place.matrix(3)  # noqa: E741
    moments = np.linalg.eigvalsh(0.5 * (I + I.T))
    if np.abs(I - I.T).max() > 1e-9 * np.abs(I).max():
        raise place.fail("is not symmetric", "give the moments about the center of mass, in the axes of the link")
    if moments[0] <= 0.0 or moments[0] + moments[1] < moments[2] * (1.0 - 1e-9):
        raise place.fail(
            f"has the principal moments {moments.tolist()}, which no body has",
            "they must be positive, the greatest at most the sum of the others; or leave the field out",
        )
    return I


def _sphere_rows(place: _Field) -> Array:
    rows = np.array([row.vector(4) for row in place.items()]).reshape(-1, 4)
    if len(rows) > 1000:
        raise place.fail(f"has {len(rows)} spheres", "give at most 1000, about 10 are usual")
    if (rows[:, 3] <= 0.0).any():
        raise place.fail("has a radius that is not positive", "each row is x, y, z, radius")
    return rows


def _geometry(place: _Field) -> Geometry:
    fields = place.table((), ("sphere", "capsule", "box", "convex"))
    if len(fields) != 1:
        raise place.fail(f"has {len(fields)} shapes", "give one sphere, capsule, box or convex an item")
    kind, shape = next(iter(fields.items()))
    if kind == "sphere":
        values = shape.table(("center", "radius"))
        return Sphere(values["center"].vector(3), values["radius"].number(above=0.0))
    if kind == "capsule":
        values = shape.table(("from", "to", "radius"))
        return Capsule(values["from"].vector(3), values["to"].vector(3), values["radius"].number(above=0.0))
    if kind == "box":
        values = shape.table(("size", "xyz"), ("rpy", "rotation"))
        size = values["size"].vector(3)
        if (size <= 0.0).any():
            raise values["size"].fail("has an edge that is not positive", "give full edge lengths")
        return Box(size, values["xyz"].vector(3), _rotation(shape, values))
    return _convex(shape.table(("vertices",))["vertices"])


def _convex(place: _Field) -> Convex:
    rows = place.items()
    vertices = np.array([row.vector(3) for row in rows]).reshape(-1, 3)
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False) if len(vertices) >= 4 else np.zeros(3)
    if spread[2] < 1e-6:
        raise place.fail("do not span a solid", "give at least four points that do not lie in a plane")
    return Convex(vertices)


def _joints(place: _Field, links: tuple[Link, ...]) -> tuple[Joint, ...]:
    names = {link.name for link in links}
    joints = tuple(_joint(name, field, names) for name, field in place.mapping().items())
    by_name = {joint.name: joint for joint in joints}
    for joint in joints:
        if joint.coupling is None:
            continue
        where = _Field(None, place.file, f"{place.place}.{joint.name}.coupling")
        master = by_name.get(joint.coupling.master)
        if master is None:
            raise where.fail(f"names the master {joint.coupling.master!r}, which is no joint", "name an actuated joint")
        if master is joint:
            raise where.fail("couples the joint to itself", "name another, actuated joint")
        if master.coupling is not None:
            raise where.fail(
                f"names the master {master.name!r}, which is coupled itself",
                f"couple it to {master.coupling.master!r} directly, multiplying the laws out",
            )
    _check_reachable(place, joints)
    return joints


def _check_reachable(place: _Field, joints: tuple[Joint, ...]) -> None:
    """Refuses couplings that leave an actuated joint no value at which all joints keep their limits."""
    for master in joints:
        low, high = master.lower, master.upper
        for joint in joints:
            law = joint.coupling
            if law is None or law.master != master.name or law.multiplier == 0.0:
                continue
            ends = sorted([(joint.lower - law.offset) / law.multiplier, (joint.upper - law.offset) / law.multiplier])
            low, high = max(low, ends[0]), min(high, ends[1])
        if low > high:
            raise _Field(None, place.file, f"{place.place}.{master.name}.limits").fail(
                "leave no value at which every joint coupled to it keeps its own limits", "mend the limits or offsets"
            )


def _joint(name: str, place: _Field, links: set[str]) -> Joint:
    fields = place.table(
        ("type", "parent", "child", "xyz", "axis", "limits", "effort"), ("rpy", "rotation", "coupling")
    )
    kind = fields["type"].text()
    if kind not in ("revolute", "prismatic"):
        raise fields["type"].fail(f"is {kind!r}", "use revolute or prismatic; merge links whose joint is fixed")
    for end in ("parent", "child"):
        link = fields[end].text()
        if link not in links:
            close = difflib.get_close_matches(link, sorted(links), n=1)
            mend = f"did you mean {close[0]!r}?" if close else "add it to 'links'"
            raise fields[end].fail(f"is {link!r}, which is no link", mend)
    limits = fields["limits"].vector(2)
    if limits[0] > limits[1]:
        raise fields["limits"].fail(f"have the lower {limits[0]:g} above the upper {limits[1]:g}", "swap them")
    coupling = None
    if "coupling" in fields:
        law = fields["coupling"].table(("master", "multiplier"), ("offset",))
        offset = law["offset"].number() if "offset" in law else 0.0
        coupling = Coupling(law["master"].text(), law["multiplier"].number(), offset)
        if coupling.multiplier == 0.0 and not limits[0] <= offset <= limits[1]:
            raise law["multiplier"].fail("is 0 and the offset lies outside of the limits", "mend the coupling")
    return Joint(
        name=name,
        kind=kind,
        parent=fields["parent"].text(),
        child=fields["child"].text(),
        p_PJ=fields["xyz"].vector(3),
        R_PJ=_rotation(place, fields),
        axis=fields["axis"].unit_vector(),
        lower=float(limits[0]),
        upper=float(limits[1]),
        effort=fields["effort"].number(above=0.0),
        coupling=coupling,
    )


def _in_tree_order(
    place: _Field, links: tuple[Link, ...], joints: tuple[Joint, ...]
) -> tuple[tuple[Link, ...], tuple[Joint, ...]]:
    """The base first, and each joint after the one that carries its parent; the file's order otherwise."""
    carrier: dict[str, Joint] = {}
    for joint in joints:
        if joint.child in carrier:
            raise _Field(None, place.file, f"{place.place}.{joint.name}.child").fail(
                f"is {joint.child!r}, which {carrier[joint.child].name!r} moves already", "a link has one parent joint"
            )
        carrier[joint.child] = joint
    roots = [link.name for link in links if link.name not in carrier]
    if len(roots) > 1:
        raise place.fail(f"leave the links {', '.join(roots)} without a parent", "exactly one, the base, has none")
    done, ordered, left = set(roots), [], list(joints)
    while left:
        ready = next((joint for joint in left if joint.parent in done), None)
        if ready is None:
            raise place.fail(
                f"{', '.join(joint.name for joint in left)} form a cycle", "every chain must start at the base link"
            )
        left.remove(ready)
        ordered.append(ready)
        done.add(ready.child)
    by_name = {link.name: link for link in links}
    return (by_name[roots[0]], *(by_name[joint.child] for joint in ordered)), tuple(ordered)


def _fingers(place: _Field, links: tuple[Link, ...], joints: tuple[Joint, ...]) -> tuple[Finger, ...]:
    names = {link.name for link in links}
    parent = {joint.child: joint.parent for joint in joints}
    fingers = []
    for name, field in place.mapping().items():
        fields = field.table(("links", "tip_link", "tip", "pad"))
        chain = [item.text() for item in fields["links"].items()]
        if not chain:
            raise fields["links"].fail("is empty", "list the finger's links from root to tip")
        for k, link in enumerate(chain):
            if link not in names:
                raise fields["links"].fail(f"names {link!r}, which is no link", "name links of this file")
            if k and parent.get(link) != chain[k - 1]:
                raise fields["links"].fail(
                    f"has {link!r} after {chain[k - 1]!r}, which is not its parent", "list the links from root to tip"
                )
        if chain[0] not in parent:
            raise fields["links"].fail(f"starts at the base link {chain[0]!r}", "start at the first moving link")
        tip_link = fields["tip_link"].text()
        if tip_link != chain[-1]:
            raise fields["tip_link"].fail(
                f"is {tip_link!r}", f"it must be the last of the finger's links, {chain[-1]!r}"
            )
        fingers.append(Finger(name, tuple(chain), tip_link, fields["tip"].vector(3), fields["pad"].unit_vector()))
    if not fingers:
        raise place.fail("is empty", "name at least one finger with its links")
    return tuple(sorted(fingers, key=lambda finger: finger.name != "thumb"))


def _rest(place: _Field, joints: tuple[Joint, ...]) -> Array:
    actuated = [joint for joint in joints if joint.coupling is None]
    fields = place.table(tuple(joint.name for joint in actuated))
    for joint in joints:
        name = joint.name if joint.coupling is None else joint.coupling.master
        value = fields[name].number()
        if joint.coupling is not None:
            value = joint.coupling.multiplier * value + joint.coupling.offset
        if not joint.lower - 1e-9 <= value <= joint.upper + 1e-9:
            raise fields[name].fail(
                f"puts {joint.name!r} at {value:g}", f"keep it within its limits {joint.lower:g} to {joint.upper:g}"
            )
    return np.array([fields[joint.name].number() for joint in actuated])


def _ignored_contacts(place: _Field, links: tuple[Link, ...]) -> tuple[tuple[str, str], ...]:
    names = {link.name for link in links}
    pairs: list[tuple[str, str]] = []
    for item in place.items():
        pair = [end.text() for end in item.items()]
        if len(pair) != 2 or pair[0] == pair[1]:
            raise item.fail(f"names {len(set(pair))} links", "give two different links, as [palm, thumb_base]")
        for name in pair:
            if name not in names:
                close = difflib.get_close_matches(name, sorted(names), n=1)
                mend = f"did you mean {close[0]!r}?" if close else "name links of this file"
                raise item.fail(f"names {name!r}, which is no link", mend)
        if (pair[0], pair[1]) in pairs or (pair[1], pair[0]) in pairs:
            raise item.fail(f"repeats the pair {pair[0]!r} and {pair[1]!r}", "leave it out")
        pairs.append((pair[0], pair[1]))
    return tuple(pairs)


# ---- writing


def _lines(hand: Hand) -> Iterator[str]:
    yield f"name: {_text(hand.name)}"
    yield f"display_name: {_text(hand.display_name)}"
    yield f"side: {hand.side}"
    yield f"wrist: {{xyz: {_row(hand.p_HB)}{_rotation_text(hand.R_HB)}}}  # pose of the base link in the wrist frame H"
    yield ""
    yield "links:"
    for link in hand.links:
        yield from _link_lines(link)
    yield ""
    yield "joints:" if hand.joints else "joints: {}"
    for joint in hand.joints:
        yield f"  {_text(joint.name)}:"
        yield f"    type: {joint.kind}"
        yield f"    parent: {_text(joint.parent)}"
        yield f"    child: {_text(joint.child)}"
        yield f"    xyz: {_row(joint.p_PJ)}"
        rotation = _rotation_text(joint.R_PJ)
        if rotation:
            yield f"    {rotation[2:]}"
        yield f"    axis: {_row(joint.axis)}"
        yield f"    limits: [{_number(joint.lower)}, {_number(joint.upper)}]"
        yield f"    effort: {_number(joint.effort)}"
        if joint.coupling is not None:
            law = joint.coupling
            laws = f"multiplier: {_number(law.multiplier)}, offset: {_number(law.offset)}"
            yield f"    coupling: {{master: {_text(law.master)}, {laws}}}"
    yield ""
    yield "fingers:"
    for finger in hand.fingers:
        yield f"  {_text(finger.name)}:"
        yield f"    links: [{', '.join(_text(link) for link in finger.links)}]"
        yield f"    tip_link: {_text(finger.tip_link)}"
        yield f"    tip: {_row(finger.p_LTip)}"
        yield f"    pad: {_row(finger.n_LPad)}"
    yield ""
    yield "rest:" if hand.joint_names else "rest: {}"
    for name, value in zip(hand.joint_names, hand.q_rest, strict=True):
        yield f"  {_text(name)}: {_number(value)}"
    if hand.ignored_contacts:
        yield ""
        yield "ignored_contacts:"
        for first, second in hand.ignored_contacts:
            yield f"  - [{_text(first)}, {_text(second)}]"
    yield ""
    yield "sources:" if hand.sources else "sources: {}"
    for key, value in hand.sources.items():
        yield f"  {_text(key)}: {_text(value)}"


def _link_lines(link: Link) -> Iterator[str]:
    mass, p_LLcm, I_LLcm = link_inertia(link.geometry, link.mass)
    yield f"  {_text(link.name)}:"
    for k, shape in enumerate(link.geometry):
        if k == 0:
            yield "    geometry:"
        yield f"      - {_geometry_text(shape)}"
    yield f"    mass: {_number(mass)}"
    if not np.array_equal(p_LLcm, link.p_LLcm):
        yield f"    center_of_mass: {_row(link.p_LLcm)}"
    if not np.array_equal(I_LLcm, link.I_LLcm):
        yield f"    inertia: {_rows(link.I_LLcm)}"
    fitted = fit_spheres(link.geometry)
    if not np.array_equal(fitted, link.spheres):
        yield f"    spheres: {_rows(link.spheres)}"


def _geometry_text(shape: Geometry) -> str:
    if isinstance(shape, Sphere):
        return f"sphere: {{center: {_row(shape.center)}, radius: {_number(shape.radius)}}}"
    if isinstance(shape, Capsule):
        return f"capsule: {{from: {_row(shape.p0)}, to: {_row(shape.p1)}, radius: {_number(shape.radius)}}}"
    if isinstance(shape, Box):
        return f"box: {{size: {_row(shape.size)}, xyz: {_row(shape.p_LG)}{_rotation_text(shape.R_LG)}}}"
    return f"convex: {{vertices: {_rows(shape.vertices)}}}"


def _rotation_text(R: Array) -> str:
    """`, rpy: ...` where roll, pitch and yaw give the very same matrix, else `, rotation: ...`; empty for none."""
    if np.array_equal(R, np.eye(3)):
        return ""
    rpy = Rotation.from_matrix(R).as_euler("xyz") if abs(R[2, 0]) < 1.0 - 1e-12 else np.zeros(3)
    for digits in (12, 16):
        rounded = np.round(rpy, digits) + 0.0
        if np.array_equal(rpy_matrix(rounded), R):
            return f", rpy: {_row(rounded)}"
    return f", rotation: {_rows(R)}"


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


def _row(values: Array) -> str:
    return "[" + ", ".join(_number(v) for v in values) + "]"


def _rows(values: Array) -> str:
    return "[" + ", ".join(_row(row) for row in values) + "]"


@lru_cache(maxsize=4096)
def _text(value: str) -> str:
    """A text as YAML reads it back: bare where that is safe, else quoted as in JSON, which YAML contains."""
    plain = value.replace("_", "").replace(".", "").replace("-", "").isalnum() and value.isascii()
    if plain and yaml.safe_load(f"{value}") == value and not value.startswith("-"):
        return value
    return json.dumps(value)
