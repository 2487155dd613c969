"""Constraints of the grasp programs as named blocks of rows, each with its Jacobian, in comparable units.

Distances are in millimetres, wrenches and forces in units of the object's weight, so that one tolerance suits all rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import cross, skew
from xdex_drake.contact.cones import contact_frames
from xdex_drake.hand.description import Array
from xdex_drake.programs.point import CLOSE, Point

MM = 1e3
"""Millimetres in a metre: the unit of distance rows."""

TOLERANCES = {"mm": 0.2, "m g": 2e-2, "rad": 1e-3, "-": 2e-2}
"""Greatest violation that counts as satisfied, by the unit of a block; forces are balanced exactly afterwards."""

CONE_EDGES = 8
"""Edges of the pyramid that stands for a friction cone in the sequential solver's subproblems."""


@dataclass(frozen=True)
class Block:
    """Rows lower <= g(point) <= upper.

    Attributes:
        name: Name in tables and results.
        evaluate: Gives g, shape (m,), and its Jacobian with respect to the point's tangent, shape (m, size).
        lower: Lower bounds, shape (m,).
        upper: Upper bounds, shape (m,).
        unit: Unit of the rows, for tables.
        meaning: One line for tables.
        inner: Rows g >= 0 that imply this block and that a linearisation sees better, for the sequential solver; None
            where `evaluate` serves.
        whole: Greatest violation of all rows there could be, where the block holds only those that matter near the
            start: a solver that goes far must not pass through what it left out. None where it holds all.
    """

    name: str
    evaluate: Callable[[Point], tuple[Array, Array]]
    lower: Array
    upper: Array
    unit: str
    meaning: str
    inner: Callable[[Point], tuple[Array, Array]] | None = None
    whole: Callable[[Point], float] | None = None

    def at(self, point: Point) -> tuple[Array, Array]:
        """What `evaluate` gives, computed once for a point: solvers ask for values first and for derivatives later."""
        if self.name not in point.memo:
            point.memo[self.name] = self.evaluate(point)
        return point.memo[self.name]

    def rows(self, point: Point) -> tuple[Array, Array, Array, Array]:
        """What the sequential solver linearises: g, its Jacobian, lower and upper bounds."""
        if self.inner is None:
            return (*self.at(point), self.lower, self.upper)
        key = f"{self.name} inner"
        if key not in point.memo:
            point.memo[key] = self.inner(point)
        g, J = point.memo[key]
        return g, J, np.zeros(len(g)), np.full(len(g), np.inf)

    def violation(self, point: Point) -> float:
        """Greatest violation of a row at a point, in the block's unit; of the whole block, where it is part of one."""
        if self.whole is not None:
            return self.whole(point)
        g, _ = self.at(point)
        return float(np.max(np.maximum(self.lower - g, g - self.upper), initial=0.0))


def _pad(point: Point, J: Array) -> Array:
    """Appends zero columns for the forces."""
    return np.concatenate([J, np.zeros((*J.shape[:-1], point.forces.size))], axis=-1)


def contact_block(contacts: int) -> Block:
    """Contact spheres lie on the surface: SDF(c_k) - r_k = 0."""

    def evaluate(point: Point) -> tuple[Array, Array]:
        J = np.einsum("ka,kab->kb", point.gap_gradients, point.contact_jacobian)
        return MM * point.contact_gaps, MM * _pad(point, J)

    zero = np.zeros(contacts)
    return Block("contact", evaluate, zero, zero, "mm", "gap of each contact sphere is zero")


def object_block(spheres: NDArray[np.int64], clearance: Array) -> Block:
    """Other spheres stay out of the object: SDF(c_i) - r_i >= clearance_i.

    Args:
        spheres: Indices among `hand.spheres`, shape (m,).
        clearance: Least gap of each [m], shape (m,).

    Returns:
        The block.
    """
    far = 2.0 * MM * 0.05

    def evaluate(point: Point) -> tuple[Array, Array]:
        near, gaps, gradient = point.object_distances
        position = np.full(len(point.k.hand.spheres), -1)
        position[near] = np.arange(len(near))
        rows = position[spheres]
        known = np.flatnonzero(rows >= 0)
        g = np.full(len(spheres), far)
        J = np.zeros((len(spheres), point.size))
        g[known] = MM * gaps[rows[known]]
        # Rows that are far from active need no derivative.
        close = known[g[known] < MM * CLOSE]
        chosen = spheres[close]
        J[close, : point.moving] = MM * point.pull_back_spheres(chosen, gradient[rows[close]])
        return g, J

    return Block(
        "object", evaluate, MM * clearance, np.full(len(spheres), np.inf), "mm", "gap between sphere and object"
    )


def table_block(spheres: NDArray[np.int64], clearance: float) -> Block:
    """Spheres stay above the table: z(c_i) - r_i >= clearance.

    Args:
        spheres: Indices among `hand.spheres`, shape (m,).
        clearance: Least gap [m].

    Returns:
        The block.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        up = np.tile([0.0, 0.0, MM], (len(spheres), 1))
        heights = point.centers_W[spheres, 2] - point.k.hand.spheres[spheres, 3]
        return MM * heights, _pad(point, point.pull_back_spheres(spheres, up))

    low = np.full(len(spheres), MM * clearance)
    return Block("table", evaluate, low, np.full(len(spheres), np.inf), "mm", "gap between sphere and table")


def self_block(pairs: NDArray[np.int64], clearance: float) -> Block:
    """Spheres of different links stay apart: |c_i - c_j| - r_i - r_j >= clearance.

    Args:
        pairs: Indices among `hand.spheres`, shape (m, 2).
        clearance: Least gap [m].

    Returns:
        The block.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        hand = point.k.hand
        a, b = pairs[:, 0], pairs[:, 1]
        between = point.centers_W[a] - point.centers_W[b]
        distance = np.sqrt(np.einsum("ka,ka->k", between, between) + 1e-18)
        g = MM * (distance - hand.spheres[a, 3] - hand.spheres[b, 3])
        J = np.zeros((len(pairs), point.size))
        close = np.flatnonzero(g < MM * CLOSE)
        if len(close):
            direction = MM * between[close] / distance[close, None]
            rows = point.pull_back_spheres(
                np.concatenate([a[close], b[close]]), np.concatenate([direction, -direction])
            )
            J[close, : point.moving] = rows[: len(close)] + rows[len(close) :]
        return g, J

    low = np.full(len(pairs), MM * clearance)
    return Block("self", evaluate, low, np.full(len(pairs), np.inf), "mm", "gap between spheres of two links")


def limit_block(limits: Array) -> Block:
    """Joint limits: lower <= q <= upper.

    Args:
        limits: Rows (lower, upper) [rad or m], shape (2, n).

    Returns:
        The block.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        J = np.zeros((len(point.k.q), point.size))
        J[:, 6 : 6 + len(point.k.q)] = np.eye(len(point.k.q))
        return point.k.q, J

    return Block("limits", evaluate, limits[0], limits[1], "rad", "joint values")


def wrench_block(p_WOcm: Array, length: float) -> Block:
    """Contact forces hold the object against gravity: G f = (0, 0, 0, 0, 0, 1) in units of weight."""

    def evaluate(point: Point) -> tuple[Array, Array]:
        f = point.forces
        arms = point.contacts_W - p_WOcm
        torque = cross(arms, f).sum(0) / length
        g = np.concatenate([torque, f.sum(0) - np.array([0.0, 0.0, 1.0])])
        n = 6 + len(point.k.q)
        J = np.zeros((6, point.size))
        across = np.swapaxes(skew(np.stack([f, arms])) / length, 1, 2).reshape(2, 3, -1)
        J[:3, :n] = -across[0] @ point.surface_jacobian.reshape(-1, n)
        J[:3, n:] = across[1]
        J[3:, n:] = np.tile(np.eye(3), len(f))
        return g, J

    return Block("wrench", evaluate, np.zeros(6), np.zeros(6), "m g", "unbalanced wrench, torque over length")


def cone_block(contacts: int, mu: float) -> Block:
    """Forces lie in exact friction cones: mu f_n - |f_t| >= 0."""

    def evaluate(point: Point) -> tuple[Array, Array]:
        f, n = point.forces, point.normals_W
        normal = (f * n).sum(1)
        tangent = f - normal[:, None] * n
        # Smoothed at the axis of the cone, by less than a thousandth of the object's weight.
        size = np.sqrt((tangent**2).sum(1) + 1e-6)
        direction = tangent / size[:, None]
        g = mu * normal - size
        # d|f_t| = direction . (df - f_n dn - (f . dn) n), and direction is normal to n.
        on_force = mu * n - direction
        on_normal = mu * f + normal[:, None] * direction
        k = 6 + len(point.k.q)
        J = np.zeros((contacts, point.size))
        J[:, :k] = np.einsum("ka,kab->kb", on_normal, point.normal_jacobian)
        for row in range(contacts):
            J[row, k + 3 * row : k + 3 * row + 3] = on_force[row]
        return g, J

    angles = 2.0 * np.pi * np.arange(CONE_EDGES) / CONE_EDGES
    inscribed = mu * np.cos(np.pi / CONE_EDGES)

    def inner(point: Point) -> tuple[Array, Array]:
        # A pyramid inside the cone. Its edges turn with the normal: d = -n (dn . d).
        f, n = point.forces, point.normals_W
        R = contact_frames(n)
        d = np.cos(angles)[:, None] * R[:, None, :, 0] + np.sin(angles)[:, None] * R[:, None, :, 1]  # (nc, edges, 3)
        normal = (f * n).sum(1)
        g = inscribed * normal[:, None] - (d @ f[:, :, None])[..., 0]
        on_force = inscribed * n[:, None] - d
        on_normal = inscribed * f[:, None] + normal[:, None, None] * d
        k = 6 + len(point.k.q)
        J = np.zeros((contacts, CONE_EDGES, point.size))
        J[:, :, :k] = on_normal @ point.normal_jacobian
        for row in range(contacts):
            J[row, :, k + 3 * row : k + 3 * row + 3] = on_force[row]
        return g.ravel(), J.reshape(-1, point.size)

    return Block("cone", evaluate, np.zeros(contacts), np.full(contacts, np.inf), "m g", "mu f_n - |f_t|", inner)


def normal_force_block(contacts: int, least: float, most: float) -> Block:
    """Every contact presses: least <= f_n <= most, in units of weight."""

    def evaluate(point: Point) -> tuple[Array, Array]:
        f, n = point.forces, point.normals_W
        k = 6 + len(point.k.q)
        J = np.zeros((contacts, point.size))
        J[:, :k] = np.einsum("ka,kab->kb", f, point.normal_jacobian)
        for row in range(contacts):
            J[row, k + 3 * row : k + 3 * row + 3] = n[row]
        return (f * n).sum(1), J

    return Block(
        "normal force", evaluate, np.full(contacts, least), np.full(contacts, most), "m g", "normal force of a contact"
    )


def pad_block(pads_L: Array, least: float) -> Block:
    """Contacts lie on the pads: n_pad . n_contact >= least.

    Args:
        pads_L: Pad normal of each contact's finger in its tip link, shape (nc, 3).
        least: Least cosine.

    Returns:
        The block.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        pads = point.k.vectors(point.contacts.links, pads_L)
        n = point.normals_W
        J_turn = point.k.angular_jacobian(point.contacts.links)
        J = np.einsum("ka,kab->kb", cross(pads, n), J_turn) + np.einsum("ka,kab->kb", pads, point.normal_jacobian)
        return (pads * n).sum(1), _pad(point, J)

    m = len(pads_L)
    return Block("pad", evaluate, np.full(m, least), np.full(m, np.inf), "-", "cosine of contact and pad normals")
