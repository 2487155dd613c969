"""Contact forces hold the object: E_fc of Eq. (1) in two forms, and as constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from xdex_drake.arrays import Array, skew
from xdex_drake.arrays import cross as cross_rows
from xdex_drake.contact.cones import contact_frames
from xdex_drake.programs.arrays import cross
from xdex_drake.programs.block import Block
from xdex_drake.programs.contact_forces import wrench
from xdex_drake.programs.point import Point
from xdex_drake.programs.term import Pull, View

CONE_EDGES = 8
"""Edges of the pyramid that stands for a friction cone in the sequential solver's subproblems."""


def wrench_energy(p_WCs: Any, n_WCs: Any, f_Ws: Any, p_WOcm: Any, length: float) -> tuple[Any, Any, Any]:
    """Half the squared unbalanced wrench of given contact forces, with its gradient by the envelope theorem.

    E_fc = 1/2 |G f|^2

    With f = n this is half the paper's estimator |G n|^2 (Liu et al. 2021). With f the minimiser of the same energy
    over friction cones it is the value of a convex wrench program, and the gradient is exact although f is held
    (Danskin): forces keep their coordinates in the contact frame, so they turn with the normal, df = (n x dn) x f.

    Args:
        p_WCs: Contact points [m], shape (..., nc, 3).
        n_WCs: Unit contact normals into the object, shape (..., nc, 3).
        f_Ws: Forces on the object, in W [-], shape (..., nc, 3).
        p_WOcm: Center of mass [m], shape (3,).
        length: Length that divides torques [m].

    Returns:
        Value, shape (...), gradients with respect to `p_WCs` and `n_WCs`, shape (..., nc, 3).
    """
    residual = wrench(p_WCs, f_Ws, p_WOcm, length)
    torque, force = residual[..., None, :3] / length, residual[..., None, 3:]
    torque = torque + 0.0 * p_WCs  # (..., nc, 3)
    on_force = force + cross(torque, p_WCs - p_WOcm)
    value = 0.5 * (residual * residual).sum(-1)
    return value, cross(f_Ws, torque), cross(cross(f_Ws, on_force), n_WCs)


@dataclass(frozen=True)
class ForceClosure:
    """E_fc of Eq. (1) as the value of a convex wrench program: of forces in exact cones; see `wrench_energy`."""

    weight: float = 10.0
    name: str = "fc"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value and gradient; that of the envelope theorem, as good as the view's forces are near the best."""
        return _of_forces(view, view.forces_W)


@dataclass(frozen=True)
class NormalClosure:
    """E_fc of Eq. (1) by the paper's estimator |G n|^2: every contact presses along its normal, without friction."""

    weight: float = 10.0
    name: str = "fc"

    def evaluate(self, view: View) -> tuple[Any, Pull]:
        """Value and gradient."""
        return _of_forces(view, view.normals_W * view.touching[..., None])


def _of_forces(view: View, f_Ws: Any) -> tuple[Any, Pull]:
    value, on_points, on_normals = wrench_energy(view.contacts_W, view.normals_W, f_Ws, view.p_WOcm, view.length)
    return value, Pull(contacts_W=on_points, normals_W=on_normals)


def wrench_block(p_WOcm: Array, length: float) -> Block:
    """Contact forces hold the object against gravity: G f = (0, 0, 0, 0, 0, 1) in units of weight."""

    def evaluate(point: Point) -> tuple[Array, Array]:
        f = point.forces
        arms = point.contacts_W - p_WOcm
        torque = cross_rows(arms, f).sum(0) / length
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
