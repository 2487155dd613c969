"""What a hand is: links, joints, fingers, a wrist frame; plain data, with no plant and no solver.

Conventions: SI units, radians. Links are in topological order: `links[0]` is the base (its frame is B, the base of the
vendor's file) and `links[k]`, k >= 1, is the child of `joints[k - 1]`. The frame L of a link is at its parent joint and
moves with it: X_PL(q) = X_PJ * exp(axis * q). Links that are rigidly attached in a vendor's file are merged into one.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.hand.shapes import Box, Capsule, Convex, Geometry, Sphere
from xdex_drake.hand.surface import Surface

if TYPE_CHECKING:
    from pydrake.math import RigidTransform

__all__ = [
    "Array",
    "Box",
    "Capsule",
    "Convex",
    "Coupling",
    "Finger",
    "Geometry",
    "Hand",
    "Joint",
    "Link",
    "Sphere",
]


@dataclass(frozen=True)
class Link:
    """A rigid body of a hand.

    Attributes:
        name: Name, unique in the hand.
        geometry: Collision and visual geometry, in L; may be empty (a small hub without shape).
        mass: Mass [kg], positive.
        p_LLcm: Center of mass in L [m], shape (3,).
        I_LLcm: Rotational inertia about the center of mass, axes of L [kg m^2], shape (3, 3).
        spheres: Spheres that approximate the geometry, rows (x, y, z, radius) in L [m], shape (n, 4).
        surfaces: Surfaces of the hand's own file to draw, in L; empty where it brought none. No part of the digest.
    """

    name: str
    geometry: tuple[Geometry, ...]
    mass: float
    p_LLcm: Array
    I_LLcm: Array
    spheres: Array
    surfaces: tuple[Surface, ...] = ()


@dataclass(frozen=True)
class Coupling:
    """An affine law that ties a joint to an actuated one: q = multiplier * q_master + offset."""

    master: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Joint:
    """A revolute or prismatic joint.

    Attributes:
        name: Name, unique in the hand.
        kind: "revolute" or "prismatic".
        parent: Name of the parent link.
        child: Name of the child link.
        p_PJ: Origin of the joint in the parent link's frame [m], shape (3,).
        R_PJ: Rotation of the joint frame in the parent link's frame at q = 0, shape (3, 3).
        axis: Unit axis in the joint frame, shape (3,).
        lower: Lower limit [rad or m].
        upper: Upper limit [rad or m], not below `lower`.
        effort: Greatest torque or force of the actuator, at this joint [N m or N].
        coupling: Law of a coupled joint; None where the joint is actuated.
    """

    name: str
    kind: str
    parent: str
    child: str
    p_PJ: Array
    R_PJ: Array
    axis: Array
    lower: float
    upper: float
    effort: float
    coupling: Coupling | None = None


@dataclass(frozen=True)
class Finger:
    """A finger, named so that hands can correspond.

    Attributes:
        name: `thumb`, `index`, `middle`, `ring` or `little` (other names are kept, and correspond to themselves).
        links: Names of its links from root to tip.
        tip_link: Name of its last moving link.
        p_LTip: Tip point in the frame of `tip_link` [m], shape (3,); the keypoint of this finger.
        n_LPad: Unit vector in the frame of `tip_link` out of the pad, the side that touches an object, shape (3,).
    """

    name: str
    links: tuple[str, ...]
    tip_link: str
    p_LTip: Array
    n_LPad: Array


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand's description; two hands are equal where they are the same object (compare `hand_digest` otherwise).

    Attributes:
        name: Library name, or the id of a generated hand.
        display_name: Name to show a person.
        side: "right" or "left".
        links: Links in topological order, the base first.
        joints: `joints[k]` moves `links[k + 1]`.
        fingers: Fingers, the thumb first where there is one.
        p_HB: Origin of the base link in the wrist frame H [m], shape (3,).
        R_HB: Rotation of the base link in H, shape (3, 3).
        q_rest: Actuated joint values of a relaxed, half-open hand whose thumb opposes the fingers, shape (n,).
        sources: For each kind of fact, where it was taken from.
        ignored_contacts: Pairs of names of links whose contact is ignored, besides neighbors and those that overlap at
            the rest posture: parts that are nested by construction.
    """

    name: str
    display_name: str
    side: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    fingers: tuple[Finger, ...]
    p_HB: Array
    R_HB: Array
    q_rest: Array
    sources: dict[str, str]
    ignored_contacts: tuple[tuple[str, str], ...] = ()

    @property
    def X_HB(self) -> "RigidTransform":
        """Pose of the base link in the wrist frame, as Drake has it: welds a hand to a frame of one's own."""
        from pydrake.math import RigidTransform, RotationMatrix

        return RigidTransform(RotationMatrix(self.R_HB), self.p_HB)

    def __repr__(self) -> str:
        """One line."""
        fingers = ", ".join(finger.name for finger in self.fingers)
        return f"Hand({self.name!r}, {self.side}, {len(self.q_rest)} actuated of {len(self.joints)} joints, {fingers})"

    @cached_property
    def link_index(self) -> dict[str, int]:
        """Index of each link by its name."""
        return {link.name: k for k, link in enumerate(self.links)}

    @cached_property
    def parents(self) -> NDArray[np.int64]:
        """Index of each link's parent link, -1 for the base, shape (n_links,)."""
        return np.array([-1, *(self.link_index[joint.parent] for joint in self.joints)], dtype=np.int64)

    @cached_property
    def ancestors(self) -> NDArray[np.bool_]:
        """Entry (j, l) is true where joint j lies between the base and link l, shape (n_joints, n_links)."""
        ancestors = np.zeros((len(self.joints), len(self.links)), dtype=bool)
        for link in range(1, len(self.links)):
            ancestors[:, link] = ancestors[:, self.parents[link]]
            ancestors[link - 1, link] = True
        return ancestors

    @cached_property
    def prismatic(self) -> NDArray[np.bool_]:
        """Which joints slide, shape (n_joints,)."""
        return np.array([joint.kind == "prismatic" for joint in self.joints], dtype=bool)

    @cached_property
    def sphere_links(self) -> NDArray[np.int64]:
        """Index of the link of each sphere of the hand, shape (n_spheres,)."""
        return np.repeat(np.arange(len(self.links)), [len(link.spheres) for link in self.links])

    @cached_property
    def spheres(self) -> Array:
        """All spheres of the hand, rows (x, y, z, radius) in their links' frames [m], shape (n_spheres, 4)."""
        return np.concatenate([link.spheres.reshape(-1, 4) for link in self.links])

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the actuated joints: the order of `q`."""
        return tuple(joint.name for joint in self.joints if joint.coupling is None)

    @cached_property
    def coupling_matrix(self) -> Array:
        """C of q_full = C q + c, shape (n_joints, n_actuated); q_full is in the order of `joints`."""
        column = {name: k for k, name in enumerate(self.joint_names)}
        C = np.zeros((len(self.joints), len(self.joint_names)))
        for row, joint in enumerate(self.joints):
            if joint.coupling is None:
                C[row, column[joint.name]] = 1.0
            else:
                C[row, column[joint.coupling.master]] = joint.coupling.multiplier
        return C

    @cached_property
    def coupling_offset(self) -> Array:
        """The offset c of q_full = C q + c [rad or m], shape (n_joints,)."""
        return np.array([0.0 if joint.coupling is None else joint.coupling.offset for joint in self.joints])

    @cached_property
    def limits(self) -> Array:
        """Effective limits of `q` [rad or m], rows (lower, upper), shape (2, n_actuated).

        The limits of an actuated joint are narrowed so that every joint coupled to it stays within its own limits.
        """
        names = {name: k for k, name in enumerate(self.joint_names)}
        limits = np.array([[j.lower, j.upper] for j in self.joints if j.coupling is None]).T.copy()
        for joint in self.joints:
            if joint.coupling is None or joint.coupling.multiplier == 0.0:
                continue
            k = names[joint.coupling.master]
            ends = (np.array([joint.lower, joint.upper]) - joint.coupling.offset) / joint.coupling.multiplier
            limits[0, k] = max(limits[0, k], ends.min())
            limits[1, k] = min(limits[1, k], ends.max())
        return limits

    @cached_property
    def effort(self) -> Array:
        """Effort limits of the actuated joints [N m or N], shape (n_actuated,)."""
        return np.array([joint.effort for joint in self.joints if joint.coupling is None])

    def q_full(self, q: Array) -> Array:
        """All joint values from the actuated ones.

        Args:
            q: Actuated joint values [rad or m], shape (..., n_actuated).

        Returns:
            Values in the order of `joints`, shape (..., n_joints).
        """
        return q @ self.coupling_matrix.T + self.coupling_offset
