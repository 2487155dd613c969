"""The value of a convex wrench program as an energy of contact points and normals."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_matrix

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import contact_frames, grasp_matrix
from xdex_drake.contact.conic import (
    check_grasp,
    cone_rows,
    program_cones,
    solve_conic,
    torque_scaling,
    upper_matrix,
)


@dataclass(frozen=True)
class WrenchEnergy:
    """Least unbalanced wrench, with its gradient.

    Attributes:
        value: E [N^2].
        f: Forces that attain it [N], shape (3 n,).
        gradient_p: dE/dp_WCs [N^2/m], shape (n, 3).
        gradient_n: dE/dn_WCs, tangent to the unit normals, shape (n, 3).
        solved: Whether the solver converged; the other fields hold NaN otherwise.
    """

    value: float
    f: Array
    gradient_p: Array
    gradient_n: Array
    solved: bool


def wrench_energy(
    p_WCs: ArrayLike,
    n_WCs: ArrayLike,
    mu: ArrayLike,
    F_ext: ArrayLike,
    p_WOcm: ArrayLike,
    *,
    length: float,
    normal_bounds: tuple[float, float] = (0.0, math.inf),
    regularization: float = 1e-3,
) -> WrenchEnergy:
    """The least unbalanced wrench that contact forces leave, with its gradient in contact points and normals.

    E = min over f of 1/2 |G f + F_ext|^2 + regularization / 2 |f|^2,  f in the exact cones,  lo <= f_n <= hi

    with torques divided by `length`. The gradient is that of the envelope theorem (Danskin): f is held, forces move
    with their points and turn rigidly with their normals (dF = omega x F, omega = n x dn). The regularization makes the
    best forces unique, hence E differentiable. With lo > 0 and F_ext = 0 it measures force closure.

    Args:
        p_WCs: Contact points [m], shape (n, 3).
        n_WCs: Unit contact normals into the object, shape (n, 3).
        mu: Coefficient of friction, one or n.
        F_ext: External wrench, torque first [N m, N], shape (6,).
        p_WOcm: Center of mass [m], shape (3,).
        length: Length that divides torques [m].
        normal_bounds: Bounds of each normal force [N].
        regularization: Weight of the squared forces, positive.

    Returns:
        Value, forces, gradients.

    Raises:
        ConfigError: Shapes do not match or a number is out of range.
    """
    p, c = np.asarray(p_WCs, dtype=float), np.asarray(p_WOcm, dtype=float)
    R = contact_frames(n_WCs)
    scaling = torque_scaling(length)
    G, mus, n = check_grasp(scaling[:, None] * grasp_matrix(p, R, c), mu, length)
    F = scaling * np.asarray(F_ext, dtype=float)
    lo, hi = normal_bounds
    P = G.T @ G + regularization * np.eye(3 * n)
    identity = np.eye(3 * n)
    rows, right = [-identity[2::3], -cone_rows(mus, identity)], [np.full(n, -lo), np.zeros(3 * n)]
    if math.isfinite(hi):
        rows.insert(0, identity[2::3])
        right.insert(0, np.full(n, hi))
    M, b = csc_matrix(np.concatenate(rows)), np.concatenate(right)
    cones = list(program_cones(len(b) - 3 * n, n))
    # The regularization is weak: forces, hence gradients, are only as good as the root of the gap over it.
    status, f, _ = solve_conic(upper_matrix(P), G.T @ F, M, b, cones, 1e-13)
    if status != "solved":
        nan = np.full((n, 3), np.nan)
        return WrenchEnergy(math.nan, nan.ravel(), nan, nan, False)
    residual = G @ f + F
    value = 0.5 * float(residual @ residual) + 0.5 * regularization * float(f @ f)
    F_Cs = (R @ f.reshape(n, 3, 1))[..., 0]  # forces in W
    torque, force = residual[:3] / length, residual[3:]
    gradient_p = np.cross(F_Cs, torque)  # r . ((p - c) x F) = p . (F x r)
    pull = force + np.cross(torque, p - c)  # dE/dF
    gradient_n = np.cross(np.cross(F_Cs, pull), R[..., :, 2])
    return WrenchEnergy(value, f, gradient_p, gradient_n, True)
