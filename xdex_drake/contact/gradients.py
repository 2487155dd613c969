"""Qualities of a grasp with their gradients in contact points and normals, for programs that raise them.

A quality is the optimal value of a convex program; by the envelope theorem its gradient is u . dw, summed with weights
over wrenches w, where weights and u are the program's solution and multipliers. Where the solution is not unique (ties
between facets, a degenerate linear program) the quality has a kink, and one of its subgradients is given.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_matrix

from xdex_drake.contact.cones import Array, cone_edges, contact_frames, grasp_matrix
from xdex_drake.contact.conic import cone_rows, conic, program_cones, solve_conic, torque_scaling, upper_matrix
from xdex_drake.contact.margins import _least_weight, _nearest_facet, _primitive_wrenches, ball_margin, support


@dataclass(frozen=True)
class Quality:
    """A quality with its gradient.

    Attributes:
        value: The quality.
        gradient_p: Its gradient with respect to the contact points [1/m], shape (n, 3).
        gradient_n: The same with respect to the unit normals, tangent to them, shape (n, 3).
    """

    value: float
    gradient_p: Array
    gradient_n: Array


def min_weight_gradient(
    p_WCs: ArrayLike, n_WCs: ArrayLike, mu: ArrayLike, p_WOcm: ArrayLike, *, length: float, edges: int = 4
) -> Quality:
    """`min_weight` with its gradient.

    Args:
        p_WCs: Contact points [m], shape (n, 3).
        n_WCs: Unit contact normals into the object, shape (n, 3).
        mu: Coefficient of friction, one or n.
        p_WOcm: Center of mass [m], shape (3,).
        length: Length that divides torques [m].
        edges: Number of edges of a pyramid.

    Returns:
        Value and gradient; the gradient is 0 where the value is -inf.

    Raises:
        ConfigError: Shapes do not match or a number is out of range.
    """
    p, R, G = _geometry(p_WCs, n_WCs, p_WOcm)
    value, u, weights = _least_weight(_primitive_wrenches(G, mu, length, edges))
    return _by_pyramids(value, u, weights, p, R, mu, length, edges)


def epsilon_gradient(
    p_WCs: ArrayLike, n_WCs: ArrayLike, mu: ArrayLike, p_WOcm: ArrayLike, *, length: float, edges: int = 8
) -> Quality:
    """`epsilon_linearized` with its gradient.

    Args:
        p_WCs: Contact points [m], shape (n, 3).
        n_WCs: Unit contact normals into the object, shape (n, 3).
        mu: Coefficient of friction, one or n.
        p_WOcm: Center of mass [m], shape (3,).
        length: Length that divides torques [m].
        edges: Number of edges of a pyramid.

    Returns:
        Value and gradient; both 0 where the origin is not inside.

    Raises:
        ConfigError: Shapes do not match or a number is out of range.
    """
    p, R, G = _geometry(p_WCs, n_WCs, p_WOcm)
    value, u, weights = _nearest_facet(_primitive_wrenches(G, mu, length, edges))
    return _by_pyramids(value, u, weights, p, R, mu, length, edges)


def ball_margin_gradient(
    p_WCs: ArrayLike, n_WCs: ArrayLike, mu: ArrayLike, p_WOcm: ArrayLike, *, length: float, tol: float = 1e-6
) -> Quality:
    """The upper bound of `ball_margin` with its gradient, in exact cones.

    At the worst direction u, margin u is the wrench of some forces with a unit sum of normal components: they, found by
    one conic program, are the weights of the gradient.

    Args:
        p_WCs: Contact points [m], shape (n, 3).
        n_WCs: Unit contact normals into the object, shape (n, 3).
        mu: Coefficient of friction, one or n.
        p_WOcm: Center of mass [m], shape (3,).
        length: Length that divides torques [m].
        tol: Width of the bracket to stop at; the gradient is about as good as its root.

    Returns:
        Value and gradient; both 0 where the margin is 0.

    Raises:
        ConfigError: Shapes do not match or a number is out of range.
    """
    p, R, G = _geometry(p_WCs, n_WCs, p_WOcm)
    n = len(p)
    margin = ball_margin(G, mu, length=length, tol=tol)
    if margin.lower <= 0.0:
        return Quality(0.0, np.zeros((n, 3)), np.zeros((n, 3)))
    u, G_n = margin.direction, torque_scaling(length)[:, None] * G
    mus = np.full(n, 1.0) * np.asarray(mu, dtype=float)
    # Forces whose wrench is nearest to margin u.
    identity = np.eye(3 * n)
    rows = csc_matrix(np.concatenate([[identity[2::3].sum(axis=0)], -cone_rows(mus, identity)]))
    right = np.append(1.0, np.zeros(3 * n))
    P = upper_matrix(G_n.T @ G_n + 1e-9 * identity)
    cones = [conic.ZeroConeT(1), *program_cones(0, n)]
    status, f, _ = solve_conic(P, -margin.upper * (u @ G_n), rows, right, cones, 1e-12)
    if status != "solved":
        f = support(G_n, mus, u[None])[1][0]
    F_Ws = np.einsum("nij,nj->ni", R, f.reshape(n, 3))
    gradient_p, pull = _pulls(F_Ws, u, p, length)
    return Quality(margin.upper, gradient_p, np.cross(np.cross(F_Ws, pull), R[..., 2]))


def _geometry(p_WCs: ArrayLike, n_WCs: ArrayLike, p_WOcm: ArrayLike) -> tuple[Array, Array, Array]:
    """Points relative to the center of mass, contact frames, grasp matrix."""
    p, R = np.asarray(p_WCs, dtype=float) - np.asarray(p_WOcm, dtype=float), contact_frames(n_WCs)
    return p, R, grasp_matrix(p, R, np.zeros(3))


def _pulls(F_Ws: Array, u: Array, p: Array, length: float) -> tuple[Array, Array]:
    """Derivatives of u . w with respect to points and forces, w = ((p x F) / length, F), shape (n, 3) each."""
    torque = np.broadcast_to(u[:3] / length, p.shape)
    return np.cross(F_Ws, torque), u[3:] + np.cross(torque, p)


def _by_pyramids(
    value: float, u: Array, weights: Array, p: Array, R: Array, mu: ArrayLike, length: float, edges: int
) -> Quality:
    """Quality whose change is u . sum_j weights_j dw_j over primitive wrenches.

    Pyramids, unlike cones, are not round: how frames spin about their normals counts, so frames are differentiated
    themselves, by differences (their error, 1e-10, is far below that of a solver).
    """
    n, h = len(p), 1e-6
    mus = np.full(n, 1.0) * np.asarray(mu, dtype=float)
    f = np.einsum("nik,nk->ni", cone_edges(mus, edges), weights.reshape(n, edges))
    gradient_p, pull = _pulls(np.einsum("nij,nj->ni", R, f), u, p, length)
    gradient_n = np.zeros((n, 3))
    for axis in (0, 1):
        tangent = R[..., axis]
        dR = (contact_frames(R[..., 2] + h * tangent) - contact_frames(R[..., 2] - h * tangent)) / (2.0 * h)
        gradient_n += np.einsum("nij,nj,ni->n", dR, f, pull)[:, None] * tangent
    return Quality(value, gradient_p, gradient_n)
