"""Human hands: people's hands as hinge mechanisms, drawn from published anthropometry.

They play the role of MANO (Romero, Tzionas and Black 2017), whose files may not be shipped: the same tree of sixteen
frames (the wrist, and three for each of five digits), and a shape that a few numbers describe. MANO's ball joints
become hinges: two at each knuckle and at the base of the thumb, one at every other joint, twenty in all. Distal joints
are free, as in MANO: that they follow the middle ones at two thirds (Rijpkema and Girard 1991) is a habit of people, no
linkage.

All lengths in this module are in meters and refer to a right hand: x out of the palm, y to the thumb's side, z to the
fingertips, the origin at the wrist (frame H).
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Capsule, Convex, Finger, Geometry, Hand, Joint, Link
from xdex_drake.hand.inertia import link_inertia
from xdex_drake.hand.kinematics import rotation_about
from xdex_drake.hand.spheres import fit_spheres

FINGERS = ("index", "middle", "ring", "little")

DIMENSIONS = ("hand_length", "palm_length", "hand_breadth", "hand_circumference", "wrist_circumference")
"""The measured dimensions of a hand, in the order of `SURVEY`."""

SURVEY = {
    "man": (
        (193.28, 116.46, 88.26, 212.28, 175.92),
        (
            (98.93, 49.26, 25.39, 60.16, 48.51),
            (49.26, 38.85, 13.04, 31.95, 26.15),
            (25.39, 13.04, 19.25, 41.43, 28.00),
            (60.16, 31.95, 41.43, 104.92, 70.83),
            (48.51, 26.15, 28.00, 70.83, 80.19),
        ),
    ),
    "woman": (
        (181.08, 108.70, 78.15, 186.55, 154.79),
        (
            (101.13, 50.10, 22.02, 49.87, 42.32),
            (50.10, 35.29, 11.37, 26.49, 23.15),
            (22.02, 11.37, 14.77, 30.28, 20.12),
            (49.87, 26.49, 30.28, 77.79, 50.92),
            (42.32, 23.15, 20.12, 50.92, 61.27),
        ),
    ),
}
"""Mean [mm] and covariance [mm^2] of `DIMENSIONS` for 4082 men and 1986 women (ANSUR II, U.S. Army 2010-2012)."""

NINETY_EIGHT = 2.326
"""Standard deviations from the mean to the 1st and 99th percentile of a normal distribution."""

SEGMENTS = {
    "thumb": (0.251, 0.196, 0.158),
    "index": (0.2649, 0.143, 0.097),
    "middle": (0.2773, 0.170, 0.108),
    "ring": (0.2591, 0.165, 0.107),
    "little": (0.2059, 0.117, 0.093),
}
"""Lengths between joint centers over hand length: metacarpal, proximal, distal for the thumb; proximal, middle, distal
for the fingers (Buchholz, Armstrong and Goldstein 1992; An et al. 1979). The last reaches the tip."""

SEGMENT_SPREAD = {
    "thumb": (0.085, 0.099, 0.074),
    "index": (0.124, 0.112, 0.143),
    "middle": (0.085, 0.114, 0.106),
    "ring": (0.094, 0.128, 0.128),
    "little": (0.085, 0.140, 0.154),
}
"""Standard deviation over mean of the bones on X-rays of 66 adults (Buryanov and Kotiuk 2010), in the same order."""

BREADTHS = {
    "thumb": (0.438, 0.229, 0.212),
    "index": (0.229, 0.198, 0.1755),
    "middle": (0.216, 0.1965, 0.1795),
    "ring": (0.203, 0.182, 0.1675),
    "little": (0.183, 0.1645, 0.149),
}
"""Breadth of each segment over hand breadth (measurements of the Sancho-Bru group)."""

KNUCKLES = {
    "index": (0.447, 0.252, -0.129),
    "middle": (0.446, 0.0, -0.135),
    "ring": (0.409, -0.206, -0.067),
    "little": (0.368, -0.393, 0.040),
}
"""Knuckle centers: along z over hand length and along y over hand breadth (Buchholz et al. 1992), and along x over hand
breadth (the arch of the MyoHand model, an average hand)."""

FAN = {"index": (5.5, -3.0), "middle": (1.0, 2.0), "ring": (-4.0, 7.0), "little": (-9.5, 14.0)}
"""How a finger lies at zero: turned about x (spread) and about z (so that bent fingers head for the thumb) [deg].

A third to a half of the MyoHand model's, whose neighbouring fingers, at 90 degrees, pass through each other."""

THUMB_BASE = (0.102, 0.25, 0.124)
"""Base of the thumb: z over hand length, y and x over hand breadth (between Buchholz et al. 1992 and MyoHand)."""

# Directions in H, from MyoHand (radial, distal, palmar there are y, z, x here). Positive values flex or oppose.
THUMB_DIRECTION = (0.340, 0.447, 0.829)
THUMB_OPPOSITION = (0.745, 0.042, -0.665)
THUMB_ABDUCTION = (-0.468, 0.496, -0.732)
THUMB_MCP_FLEXION = (0.975, 0.084, -0.203)
THUMB_IP_FLEXION = (0.876, 0.050, -0.480)

RANGES = {
    "thumb": ((-44.7, 28.6), (-44.7, 40.1), (-10.0, 55.0), (-15.0, 80.0)),
    "index": ((-13.0, 20.0), (-20.0, 90.0), (0.0, 100.0), (0.0, 80.0)),
    "middle": ((-8.0, 12.0), (-20.0, 90.0), (0.0, 100.0), (0.0, 80.0)),
    "ring": ((-14.0, 12.0), (-20.0, 90.0), (0.0, 100.0), (0.0, 80.0)),
    "little": ((-25.0, 15.0), (-20.0, 90.0), (0.0, 100.0), (0.0, 80.0)),
}
"""Limits [deg] from the base of each digit to its tip; for fingers abduction to the thumb's side comes first.

Flexion from clinical norms (Eaton), extension of the knuckles at 20 of their passive 45 degrees; abduction from
Sancho-Bru et al. 2011, narrowed where their limits exceed the 20 degrees of textbooks; thumb base from MyoHand."""

REST = {
    "thumb": (8.0, 37.0, 8.0, 22.0),
    "index": (1.0, 45.0, 25.0, 16.0),
    "middle": (0.0, 45.0, 25.0, 16.0),
    "ring": (-1.0, 45.0, 25.0, 16.0),
    "little": (-2.0, 44.0, 25.0, 16.0),
}
"""Rest posture [deg], in the order of `RANGES`."""

FINGERTIP_FORCE = {"thumb": 60.0, "index": 40.0, "middle": 40.0, "ring": 28.0, "little": 20.0}
"""Fingertip forces [N] from which efforts are estimated: about two thirds of an adult's pinch strength."""

SOFTNESS = 0.92
"""Radii are this fraction of half the breadth: neighbouring fingers touch in life, and skin yields."""

CLEARANCE = 3e-3
"""Least gap between the bases of neighbouring fingers [m]: less, and they would hardly move without touching."""

_JOINTS = {"thumb": ("cmc_opposition", "cmc_abduction", "mcp", "ip")}
_FINGER_JOINTS = ("mcp_abduction", "mcp", "pip", "dip")
_SEGMENT_NAMES = {"thumb": ("metacarpal", "proximal", "distal")}
_FINGER_SEGMENTS = ("proximal", "middle", "distal")

SOURCES = {
    "kinematics": "MANO's tree of joints as hinges; joint centers from hand length and breadth (Buchholz, Armstrong, "
    "Goldstein 1992; An et al. 1979), axes after MyoHand (MyoSuite), ranges from clinical norms (Eaton) and "
    "Sancho-Bru et al. 2011.",
    "shape": "Drawn from ANSUR II (4082 men, 1986 women) with the spread of single bones on X-rays (Buryanov, Kotiuk "
    "2010).",
    "efforts": "Estimate: the torque about each joint of a force of 20 N (little) to 60 N (thumb) at the fingertip, "
    "about two thirds of pinch strength; a third of it for abduction.",
    "masses": "Volume at 1100 kg/m3, the density of a hand.",
    "geometry": "Tapered capsules of measured segment breadths (Sancho-Bru group); the palm is a hull over wrist and "
    "knuckles.",
    "wrist": "By construction: the origin is at the center of the wrist, z along the middle metacarpal.",
}


@dataclass(frozen=True)
class HumanShape:
    """What tells one person's hand from another's.

    Attributes:
        hand_length: Wrist crease to tip of the middle finger [m].
        palm_length: Wrist crease to the crease at the base of the middle finger [m].
        hand_breadth: Breadth over the knuckles [m].
        hand_circumference: Circumference over the knuckles [m].
        wrist_circumference: Circumference of the wrist [m].
        thickness: Factor on the breadth of the fingers.
        segments: Factor on the length of each segment, rows thumb, index, middle, ring, little, three segments from the
            base to the tip, as tuples of tuples.
    """

    hand_length: float
    palm_length: float
    hand_breadth: float
    hand_circumference: float
    wrist_circumference: float
    thickness: float = 1.0
    segments: tuple[tuple[float, float, float], ...] = ((1.0, 1.0, 1.0),) * 5


MEAN_SHAPE = HumanShape(0.1893, 0.1139, 0.0850, 0.2039, 0.1690)
"""Mean of all 6068 people of the survey."""


def sample_shape(rng: np.random.Generator) -> HumanShape:
    """Draws a person's hand, a man's or a woman's with equal chance.

    The five dimensions follow the survey's covariance; people beyond the 1st or 99th percentile of any are left out.
    Single segments vary by 40 % of the spread on X-rays that overall size does not explain, thickness by 7 %.

    Args:
        rng: Generator.

    Returns:
        The shape.
    """
    mean, covariance = (np.array(a) for a in SURVEY["man" if rng.random() < 0.5 else "woman"])
    spread = NINETY_EIGHT * np.sqrt(np.diag(covariance))
    while True:
        dimensions = rng.multivariate_normal(mean, covariance, method="cholesky")
        if (np.abs(dimensions - mean) < spread).all():
            break
    residual = 0.4 * np.sqrt(np.array(list(SEGMENT_SPREAD.values())) ** 2 - 0.055**2)
    segments = np.exp(np.clip(rng.normal(size=(5, 3)), -2.5, 2.5) * residual)
    thickness = math.exp(0.07 * float(np.clip(rng.normal(), -2.5, 2.5)))
    # Tenths of a millimeter and of a percent: nobody is measured more finely, and the numbers are readable.
    HL, palm, HB, circumference, wrist = (round(1e-3 * float(value), 4) for value in dimensions)
    rows = tuple((round(float(a), 3), round(float(b), 3), round(float(c), 3)) for a, b, c in segments)
    return HumanShape(HL, palm, HB, circumference, wrist, round(thickness, 3), rows)


def human_hand(shape: HumanShape = MEAN_SHAPE, *, name: str = "human") -> Hand:
    """The right hand of a person.

    Twenty actuated hinges move twenty links: for each digit a hub without geometry and three segments.

    Args:
        shape: The person's shape.
        name: Name of the hand.

    Returns:
        The hand; its middle finger ends exactly at `shape.hand_length`.
    """
    lengths = _segment_lengths(shape)
    radii = _segment_radii(shape, lengths)
    links = [_link("palm", _palm(shape, lengths))]
    joints: list[Joint] = []
    fingers: list[Finger] = []
    for digit in ("thumb", *FINGERS):
        frames = _thumb_joints(shape) if digit == "thumb" else _finger_joints(digit, shape, lengths)
        segment_names = _SEGMENT_NAMES.get(digit, _FINGER_SEGMENTS)
        names = [f"{digit}_base", *(f"{digit}_{segment}" for segment in segment_names)]
        reach = [sum(lengths[digit][k:]) for k in (0, 0, 1, 2)]
        origins = [frames.origin, np.zeros(3), *(np.array([0.0, 0.0, s]) for s in lengths[digit][:2])]
        for k, joint_name in enumerate(_JOINTS.get(digit, _FINGER_JOINTS)):
            lower, upper = np.radians(RANGES[digit][k])
            strength = FINGERTIP_FORCE[digit] * reach[k] * (1.0 if k or digit == "thumb" else 1.0 / 3.0)
            joints.append(
                Joint(
                    f"{digit}_{joint_name}",
                    "revolute",
                    names[k - 1] if k else "palm",
                    names[k],
                    origins[k],
                    frames.R if k == 0 else np.eye(3),
                    frames.axes[k],
                    float(lower),
                    float(upper),
                    round(float(strength), 3),
                )
            )
        links.append(_link(names[0], ()))
        for k in range(3):
            geometry = _segment(digit, k, lengths[digit][k], radii[digit])
            links.append(_link(names[k + 1], geometry))
        tip = np.array([0.0, 0.0, lengths[digit][2]])
        fingers.append(Finger(digit, tuple(names), names[3], tip, frames.pad))
    rest = np.radians([angle for digit in ("thumb", *FINGERS) for angle in REST[digit]])
    return Hand(
        name=name,
        display_name="Human hand",
        side="right",
        links=tuple(links),
        joints=tuple(joints),
        fingers=tuple(fingers),
        p_HB=np.zeros(3),
        R_HB=np.eye(3),
        q_rest=rest,
        sources={"base": "human", **SOURCES},
    )


# ---- sizes


def _segment_lengths(shape: HumanShape) -> dict[str, tuple[float, float, float]]:
    """Lengths of the segments of each digit [m]."""
    HL = shape.hand_length
    middle = sum(SEGMENTS["middle"])
    # The crease at the base of the middle finger lies beyond its knuckle by a fixed part of the hand's length: on
    # average, fingers are 0.398 of the hand from the crease and 0.555 from the knuckle.
    fingers = ((HL - shape.palm_length) / HL + (middle - 0.398)) / middle
    lengths = {}
    for digit, factors in zip(("thumb", *FINGERS), shape.segments, strict=True):
        scale = HL * (1.0 if digit == "thumb" else fingers)
        lengths[digit] = scale * np.array(SEGMENTS[digit]) * np.array(factors)
    # The hand's length is measured to the tip of the middle finger, whose segments share it out.
    lengths["middle"] *= HL * fingers * middle / lengths["middle"].sum()
    return {digit: (float(v[0]), float(v[1]), float(v[2])) for digit, v in lengths.items()}


def _segment_radii(shape: HumanShape, lengths: dict[str, tuple[float, float, float]]) -> dict[str, Array]:
    """Radii at both ends of each segment, four a digit from the base to the tip [m], shape (4,)."""
    girth = shape.hand_circumference / shape.hand_breadth / (MEAN_SHAPE.hand_circumference / MEAN_SHAPE.hand_breadth)
    scale = 0.5 * SOFTNESS * shape.hand_breadth * girth * shape.thickness
    radii = {}
    for digit, breadths in BREADTHS.items():
        a, b, c = breadths
        # A breadth is the mean of a near and a far value; segments share the value at their joint.
        ends = (0.30, 0.255, 0.215, 0.185) if digit == "thumb" else (1.03 * a, 0.5 * (a + b), 0.5 * (b + c), 0.88 * c)
        radii[digit] = scale * np.array(ends)
    # Thick fingers flatten where they touch; here they become as thin as the knuckles leave them room.
    for a, b in pairwise(FINGERS):
        gap = np.linalg.norm(_knuckle(a, shape, lengths) - _knuckle(b, shape, lengths)) - CLEARANCE
        share = min(1.0, float(gap / (radii[a][0] + radii[b][0])))
        radii[a], radii[b] = np.minimum(radii[a], share * radii[a][0]), np.minimum(radii[b], share * radii[b][0])
    return radii


def _knuckle(digit: str, shape: HumanShape, lengths: dict[str, tuple[float, float, float]]) -> Array:
    """Center of a finger's knuckle in H [m], shape (3,)."""
    along, across, depth = KNUCKLES[digit]
    # The palm takes what the middle finger leaves of the hand's length.
    palm = (shape.hand_length - sum(lengths["middle"])) / KNUCKLES["middle"][0]
    return np.array([depth * shape.hand_breadth, across * shape.hand_breadth, along * palm])


# ---- joints


@dataclass(frozen=True)
class _Digit:
    """How a digit is mounted: all its links share one orientation at zero, z along the digit.

    Attributes:
        origin: Base joint in H [m], shape (3,).
        R: Rotation of the digit's links in H at zero, shape (3, 3).
        axes: Joint axes in the links' frame, four.
        pad: Normal of the pad in the links' frame, shape (3,).
    """

    origin: Array
    R: Array
    axes: tuple[Array, Array, Array, Array]
    pad: Array


def _finger_joints(digit: str, shape: HumanShape, lengths: dict[str, tuple[float, float, float]]) -> _Digit:
    spread, roll = np.radians(FAN[digit])
    x, y, z = np.eye(3)
    # Positive spread is to the thumb's side, +y: a negative turn about x. Positive roll turns the pad toward the thumb.
    R = rotation_about(x, -float(spread)) @ rotation_about(z, float(roll))
    return _Digit(_knuckle(digit, shape, lengths), R, (-x, y, y, y), x)


def _thumb_joints(shape: HumanShape) -> _Digit:
    along, across, depth = THUMB_BASE
    origin = np.array([depth * shape.hand_breadth, across * shape.hand_breadth, along * shape.hand_length])
    z = _unit(np.array(THUMB_DIRECTION))
    flexion = np.array(THUMB_IP_FLEXION)
    y = _unit(flexion - (flexion @ z) * z)  # the pad lies where the tip goes when it flexes
    x = np.cross(y, z)
    R = np.column_stack([x, y, z])
    axes = (THUMB_OPPOSITION, THUMB_ABDUCTION, THUMB_MCP_FLEXION, THUMB_IP_FLEXION)
    a, b, c, d = (_unit(R.T @ np.array(axis)) for axis in axes)
    return _Digit(origin, R, (a, b, c, d), np.array([1.0, 0.0, 0.0]))


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v)


# ---- geometry


def _link(name: str, geometry: tuple[Geometry, ...]) -> Link:
    mass, p_LLcm, I_LLcm = link_inertia(geometry)
    return Link(name, geometry, mass, p_LLcm, I_LLcm, fit_spheres(geometry))


def _segment(digit: str, k: int, length: float, radii: Array) -> tuple[Geometry, ...]:
    """A tapered segment along z: two capsules, or, at the tip, two and the ball of the pad."""
    near, far = float(radii[k]), float(radii[k + 1])
    z = np.array([0.0, 0.0, 1.0])
    middle = 0.5 * (near + far)
    if digit == "thumb" and k == 0:
        # The thenar muscles: thick at the middle, on the palmar side of the bone.
        belly = np.array([0.10 * length, 0.0, 0.42 * length])
        return (
            Capsule(0.10 * length * z, belly, 1.12 * near),
            Capsule(belly, 0.75 * length * z, 1.02 * near),
            Capsule(0.6 * length * z, length * z, 1.04 * far),
        )
    if k < 2:
        return (Capsule(0.0 * z, 0.55 * length * z, 0.5 * (near + middle)), Capsule(0.55 * length * z, length * z, far))
    pad = np.array([0.10 * near, 0.0, length - far])
    return (Capsule(0.0 * z, 0.45 * length * z, middle), Capsule(0.35 * length * z, pad, far))


def _palm(shape: HumanShape, lengths: dict[str, tuple[float, float, float]]) -> tuple[Geometry, ...]:
    """A hull over wrist and knuckles, the heads of the metacarpals, and the heel below the little finger."""
    HB = shape.hand_breadth
    # A section with straight front and back and round sides has this depth.
    depth = (shape.hand_circumference - 2.0 * HB) / (math.pi - 2.0)
    knuckles = np.array([_knuckle(digit, shape, lengths) for digit in FINGERS])
    # An ellipse 1.35 times as broad as deep has about 3.76 times its depth around it.
    wrist_depth = shape.wrist_circumference / 3.76
    wrist_breadth = 1.35 * wrist_depth
    radius = 0.42 * depth
    angles = np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    wrist = np.array([0.5 * wrist_depth, 0.5 * wrist_breadth, 0.0]) * ring * 0.92
    base = np.array([0.50 * wrist_depth, 0.54 * wrist_breadth, 0.0]) * ring + [
        -0.02 * HB,
        -0.02 * HB,
        0.16 * knuckles[1, 2],
    ]
    inward = np.array([[0.0, -0.02, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.03, 0.0]]) * HB
    heads = [
        np.array([r, r, 0.0]) * ring + knuckle + shift - [0.0, 0.0, 0.10 * knuckle[2]]
        for r, knuckle, shift in zip(radius * np.array([0.92, 1.0, 0.95, 0.82]), knuckles, inward, strict=True)
    ]
    hull = np.concatenate([wrist, base, *heads])
    ball = 0.5 * SOFTNESS * HB * np.array([BREADTHS[digit][0] for digit in FINGERS]) * 1.04
    back = [
        Capsule(k - [0.0, 0.0, 0.16 * k[2]], k - [0.0, 0.0, 0.02 * k[2]], float(r))
        for k, r in zip(knuckles, ball, strict=True)
    ]
    heel = Capsule(
        np.array([0.06 * HB, -0.24 * HB, 0.22 * knuckles[3, 2]]),
        np.array([knuckles[3, 0], -0.36 * HB, 0.78 * knuckles[3, 2]]),
        0.40 * depth,
    )
    return (Convex(np.round(hull, 6)), *back, heel)
