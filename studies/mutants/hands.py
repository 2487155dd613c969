"""Hand files broken in many ways, from a claw of three fingers in URDF and MJCF and from files that `export` writes."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from xdex_drake.hand.importing.files import import_hand
from xdex_drake.hand.library import load_hand
from xdex_drake.interchange.mjcf import export_mjcf
from xdex_drake.interchange.urdf import export_urdf

Text = bytes
Mutator = Callable[[Text, np.random.Generator], Text]

CUBE = "\n".join(
    [
        f"v {x} {y} {z}"
        for z in (0.0, 0.04)
        for x, y in ((-0.006, -0.006), (0.006, -0.006), (0.006, 0.006), (-0.006, 0.006))
    ]
    + ["f 1 3 2", "f 1 4 3", "f 5 6 7", "f 5 7 8", "f 1 2 6", "f 1 6 5"]
    + ["f 2 3 7", "f 2 7 6", "f 3 4 8", "f 3 8 7", "f 4 1 5", "f 4 5 8"]
)
STRANGE = (
    b"nan",
    b"-nan",
    b"inf",
    b"-inf",
    b"1e308",
    b"-1e308",
    b"1e-320",
    b"0",
    b"-1",
    b"1e9",
    b"-0.0",
    b"0x1F",
    b"1,5",
)
STRANGE += (b"", b"..", b"one", "\u0661".encode(), b"1e5000", b"9" * 400)
NAMES = (
    b"",
    b" ",
    b"../../etc/passwd",
    b"a/b",
    b"-o",
    b"palm",
    "ß𝄞".encode(),
    b"x" * 5000,
    b"%s%n",
    b"$(pwd)",
    b"&lt;b&gt;",
)
FILES = (
    b"gone.obj",
    b"/etc/passwd",
    b"../../../../etc/hostname",
    b"package://x/../../y.obj",
    b"http://a.b/c.obj",
    b"hand.urdf",
)
FILES += (b"f.exe", b".", b"/dev/zero", b"file:///proc/self/environ", b"C:\\f.obj", b"\\\\server\\f.obj")


def claw_urdf() -> str:
    """Three fingers of two links; meshes, a mimic law, an inertia, a fixed frame."""
    mesh = '<geometry><mesh filename="f.obj" scale="1 1 1"/></geometry>'
    moments = 'ixx="2e-05" iyy="2e-05" izz="2e-05" ixy="0" ixz="0" iyz="0"'
    inertia = f'<inertial><mass value="0.05"/><inertia {moments}/></inertial>'
    link = f"""<link name="{{0}}">{inertia}<visual>{mesh}</visual><collision>{mesh}</collision></link>\n"""
    text = '<link name="palm"><collision><geometry><box size="0.06 0.06 0.03"/></geometry></collision></link>\n'
    turns = '<axis xyz="0 -1 0"/><limit lower="-0.2" upper="1.2" effort="1" velocity="1"/>'
    for k, turn in enumerate(np.deg2rad([0.0, 120.0, 240.0])):
        at = f"{0.025 * np.cos(turn):.6f} {0.025 * np.sin(turn):.6f} 0.015"
        text += link.format(f"a{k}") + link.format(f"b{k}")
        text += f'<joint name="a{k}_j" type="revolute"><parent link="palm"/><child link="a{k}"/>'
        text += f'<origin xyz="{at}" rpy="0 0 {turn:.6f}"/>{turns}</joint>\n'
        law = f'<mimic joint="a{k}_j" multiplier="0.8" offset="0"/>' if k else ""
        text += f'<joint name="b{k}_j" type="revolute"><parent link="a{k}"/><child link="b{k}"/>'
        text += f'<origin xyz="0 0 0.04"/>{turns}{law}</joint>\n'
    text += '<link name="tip"/><joint name="tip_j" type="fixed"><parent link="b0"/><child link="tip"/>'
    return f'<?xml version="1.0"?>\n<robot name="claw">\n{text}<origin xyz="0 0 0.04"/></joint>\n</robot>\n'


def claw_mjcf() -> str:
    """The same claw with classes, an included file, a mesh, a tendon, couplings, a closed loop and actuators."""
    fingers = ""
    for k, turn in enumerate((0, 120, 240)):
        x, y = 0.025 * np.cos(np.deg2rad(turn)), 0.025 * np.sin(np.deg2rad(turn))
        fingers += f'<body name="a{k}" pos="{x:.6f} {y:.6f} 0.015" euler="0 0 {turn}" childclass="finger">\n'
        fingers += f'<joint name="a{k}_j"/><geom type="mesh" mesh="f"/><site name="s{k}" pos="0 0 0.02"/>\n'
        fingers += f'<body name="b{k}" pos="0 0 0.04"><joint name="b{k}_j" ref="0"/>\n'
        fingers += (
            '<geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.006" contype="1" conaffinity="1"/></body></body>\n'
        )
    return f"""<mujoco model="claw">
<compiler angle="degree" autolimits="true" meshdir="."/>
<include file="part.xml"/>
<default><default class="finger"><joint axis="0 -1 0" range="-10 70" damping="0.1"/></default></default>
<asset><mesh name="f" file="f.obj" scale="1 1 1"/></asset>
<worldbody><body name="palm"><inertial pos="0 0 0" mass="0.3" diaginertia="1e-4 1e-4 1e-4"/>
<geom type="box" size="0.03 0.03 0.015"/>
{fingers}<body name="bar" pos="0.02 0 0.015"><joint name="bar_j" axis="0 -1 0" range="-90 90"/>
<geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.003"/></body></body></worldbody>
<tendon><fixed name="t"><joint joint="a1_j" coef="0.8"/><joint joint="b1_j" coef="-1"/></fixed></tendon>
<equality><tendon tendon1="t"/><joint joint1="b2_j" joint2="a2_j" polycoef="0 0.8 0 0 0"/>
<connect body1="b0" body2="bar" anchor="-0.005 0 0"/></equality>
<actuator><position name="m0" joint="a0_j" kp="2" forcerange="-1 1"/><position name="m1" joint="a1_j"/></actuator>
<contact><exclude body1="palm" body2="b1"/></contact>
</mujoco>
"""


def bases(folder: Path) -> list[Path]:
    """The sound files that are broken, with what they refer to, in folders of their own."""
    files = []
    for name, text in (("urdf", claw_urdf()), ("xml", claw_mjcf())):
        place = folder / f"claw_{name}"
        place.mkdir(parents=True, exist_ok=True)
        (place / "f.obj").write_text(CUBE)
        (place / "part.xml").write_text('<mujocoinclude><default><geom density="900"/></default></mujocoinclude>')
        files.append(place / f"hand.{name}")
        files[-1].write_text(text)
    files.append(export_urdf(load_hand("inspire"), folder / "inspire"))
    files.append(export_mjcf(load_hand("allegro"), folder / "allegro"))
    return files


# ---- ways to break a file


def _pick(spans: list[tuple[int, int]], rng: np.random.Generator) -> tuple[int, int]:
    return spans[int(rng.integers(len(spans)))] if spans else (0, 0)


def _replaced(text: Text, pattern: bytes, rng: np.random.Generator, values: tuple[bytes, ...], group: int = 1) -> Text:
    spans = [match.span(group) for match in re.finditer(pattern, text)]
    start, stop = _pick(spans, rng)
    return text[:start] + values[int(rng.integers(len(values)))] + text[stop:]


def flipped_bytes(text: Text, rng: np.random.Generator) -> Text:
    """Some bytes are others."""
    data = bytearray(text)
    for k in rng.integers(len(data), size=int(rng.integers(1, 20))):
        data[k] = int(rng.integers(256))
    return bytes(data)


def truncated(text: Text, rng: np.random.Generator) -> Text:
    """Cut off, or with a piece cut out."""
    a, b = np.sort(rng.integers(len(text), size=2))
    return text[:a] if rng.random() < 0.5 else text[:a] + text[b:]


def dropped_tag(text: Text, rng: np.random.Generator) -> Text:
    """A tag is gone."""
    start, stop = _pick([match.span() for match in re.finditer(rb"<[^>]*>", text)], rng)
    return text[:start] + text[stop:]


def dropped_element(text: Text, rng: np.random.Generator) -> Text:
    """An element without children is gone, and the file still XML."""
    start, stop = _pick([match.span() for match in re.finditer(rb"<[\w:]+ [^<>]*/>", text)], rng)
    return text[:start] + text[stop:]


def dropped_attribute(text: Text, rng: np.random.Generator) -> Text:
    """An attribute is gone."""
    return _replaced(text, rb'( [\w:]+="[^"]*")', rng, (b"",))


def doubled_element(text: Text, rng: np.random.Generator) -> Text:
    """A piece of the file stands there twice, or a thousand times."""
    spans = [match.span() for match in re.finditer(rb"<(\w+)[^<>]*/>|<(link|joint|geom)\b.*?</\2>", text, re.DOTALL)]
    start, stop = _pick(spans, rng)
    return text[:stop] + text[start:stop] * (1000 if rng.random() < 0.2 else 1) + text[stop:]


def strange_number(text: Text, rng: np.random.Generator) -> Text:
    """A number is none, huge, negative or zero."""
    return _replaced(text, rb'[" ](-?\d[\d.e+-]*)(?=[" ])', rng, STRANGE)


def strange_numbers(text: Text, rng: np.random.Generator) -> Text:
    """Many numbers are others, of any size and sign."""
    share = rng.uniform(0.02, 0.5)

    def other(match: re.Match[bytes]) -> bytes:
        if rng.random() > share:
            return match[0]
        return b"%s%.6g" % (match[1], float(rng.normal() * 10.0 ** rng.integers(-6, 7)))

    return re.sub(rb'([" ])-?\d[\d.e+-]*(?=[" ])', other, text)


def wrong_count(text: Text, rng: np.random.Generator) -> Text:
    """A list of numbers has one more or less."""
    values = (b"0 0", b"0 0 0 0", b"1 0 0 0 0 0 0", b"0 " * 5000)
    return _replaced(text, rb'="(-?[\d.]+ -?[\d.]+ -?[\d.]+)"', rng, values)


def renamed(text: Text, rng: np.random.Generator) -> Text:
    """A name is empty, odd, or another's: links that do not exist, twins and loops."""
    names = tuple(re.findall(rb'name="([^"]*)"', text))
    pattern = rb'(?:name|link|joint\d?|body\d?|mesh|class|tendon\d?|model)="([^"]*)"'
    return _replaced(text, pattern, rng, NAMES if rng.random() < 0.4 else names)


def looped(text: Text, rng: np.random.Generator) -> Text:
    """Links, laws or bodies lead in a circle."""
    spans = [
        m.span(1)
        for m in re.finditer(rb'<(?:parent|child) link="([^"]*)"|(?:joint1|joint2|mimic joint)="([^"]*)"', text)
    ]
    spans = [span for span in spans if span[0] >= 0]
    if len(spans) < 2:
        return renamed(text, rng)
    (a, b), (c, d) = sorted(spans[k] for k in rng.choice(len(spans), 2, replace=False))
    return text[:a] + text[c:d] + text[b:c] + text[a:b] + text[d:]


def other_file(text: Text, rng: np.random.Generator) -> Text:
    """A mesh or an included file is missing, elsewhere, or no such thing."""
    return _replaced(text, rb'(?:filename|file|meshdir)="([^"]*)"', rng, FILES)


def other_kind(text: Text, rng: np.random.Generator) -> Text:
    """A type, unit or switch is another one."""
    values = (
        b"fixed",
        b"floating",
        b"ball",
        b"planar",
        b"free",
        b"mesh",
        b"box",
        b"plane",
        b"hfield",
        b"true",
        b"radian",
    )
    return _replaced(text, rb'(?:type|angle|limited|autolimits|eulerseq|coordinate)="([^"]*)"', rng, values)


def other_tag(text: Text, rng: np.random.Generator) -> Text:
    """An element is another one."""
    tags = (
        b"link",
        b"joint",
        b"body",
        b"geom",
        b"robot",
        b"mujoco",
        b"include",
        b"default",
        b"frame",
        b"replicate",
        b"x:y",
    )
    return _replaced(text, rb"</?([a-z]\w*)", rng, tags)


def deep(text: Text, rng: np.random.Generator) -> Text:
    """Elements within elements within elements."""
    start, _ = _pick([match.span() for match in re.finditer(rb"<(?:body|link|worldbody|default)\b", text)], rng)
    count = int(rng.choice([50, 150, 5000]))
    tag = (b"body", b"default", b"frame", b"x")[int(rng.integers(4))]
    return text[:start] + b"<%s>" % tag * count + b"</%s>" % tag * count + text[start:]


def declared(text: Text, rng: np.random.Generator) -> Text:
    """Entities, other encodings, other markup."""
    heads = (
        b'<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>',
        b'<!DOCTYPE r SYSTEM "file:///etc/passwd">',
        b'<?xml version="1.0" encoding="utf-16"?>',
        b'<?xml version="1.0" encoding="no-such"?>',
        b"\xff\xfe\x00",
        b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n",
        b"<!-- -- -->",
        b"<xi:include href='x'/>",
    )
    body = re.sub(rb"^<\?xml[^>]*>\s*", b"", text)
    return heads[int(rng.integers(len(heads)))] + body


def glued(text: Text, rng: np.random.Generator) -> Text:
    """Two pieces of the file changed places."""
    a, b, c = np.sort(rng.integers(len(text), size=3))
    return text[:a] + text[b:c] + text[a:b] + text[c:]


MUTATORS: dict[str, Mutator] = {
    mutator.__name__: mutator
    for mutator in (
        flipped_bytes,
        truncated,
        dropped_tag,
        dropped_element,
        dropped_attribute,
        doubled_element,
        strange_number,
        strange_numbers,
        wrong_count,
        renamed,
        looped,
        other_file,
        other_kind,
        other_tag,
        deep,
        declared,
        glued,
    )
}


def mutants(folder: Path, count: int, seed: int) -> Iterator[tuple[str, Path]]:
    """Broken files, the ways to break them and the sound files in turn; each is written when it is asked for.

    Args:
        folder: Where they are written.
        count: Number of files.
        seed: Seed; the same one gives the same files.

    Yields:
        The way in which a file was broken, and the file.
    """
    sound = bases(folder)
    names = list(MUTATORS)
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        base = sound[int(rng.choice(len(sound), p=[0.4, 0.4, 0.1, 0.1]))]
        name = names[k % len(names)]
        path = base.with_name(f"mutant_{k:04d}{base.suffix}")
        path.write_bytes(MUTATORS[name](base.read_bytes(), rng))
        yield name, path


def read(path: Path) -> None:
    """Imports a file as `xdex hand import` does."""
    import_hand(path)
