"""Margins of a grasp with their gradients in contact points and normals, for programs that raise them.

A margin is the value of a convex program over contact forces. By the envelope theorem (Danskin) its derivative is
u . d(G f), with the best forces f held and u the multipliers of their wrench: forces move with their points and turn
with their normals, dF = (n x dn) x F. Cones being round, how a contact frame spins about its normal does not count.
Where the best forces or the multipliers are not unique the margin has a kink, and one of its subgradients is given.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix

from xdex_drake.contact.cones import contact_frames, grasp_matrix
from xdex_drake.contact.conic import cone_rows, conic, conic_solution, program_cones, solver_status
from xdex_drake.contact.grasp_map import GraspMap
from xdex_drake.contact.wrench import GRAVITY, push_wrenches
from xdex_drake.grasp import Array
from xdex_drake.hand.kinematics import cross


@dataclass(frozen=True)
class PushMargins:
    """Margins against the six pushes with their gradients; all 0 where gravity itself is not held.

    Attributes:
        values: Margins, shape (6,).
        by_points: Their gradients with respect to the contact points [1/m], shape (6, n, 3).
        by_normals: The same with respect to the unit normals, tangent to them, shape (6, n, 3).
    """

    values: Array
    by_points: Array
    by_normals: Array


def push_margins(p_OcmCs: Array, n_WCs: Array, mu: float | Array, length: float, *, most_force: float) -> PushMargins:
    """`task_margin` against each of the six pushes, no contact pressing with more than `most_force`, with gradients.

    For each push d: maximise s  subject to  G f + gravity + s d = 0,  f in the cones,  f_n <= most_force,  s >= 0, with
    forces, gravity and pushes in units of the object's weight, which therefore does not matter.

    Args:
        p_OcmCs: Contact points from the center of mass, in W [m], shape (n, 3).
        n_WCs: Unit contact normals into the object, shape (n, 3).
        mu: Coefficient of friction, one or n.
        length: Length that divides torques [m].
        most_force: Greatest normal force of a contact, in units of the object's weight.

    Returns:
        The margins with their gradients.

    Raises:
        ConfigError: Shapes do not match or a number is out of range.
    """
    R_WCs = contact_frames(n_WCs)
    grasp_map = GraspMap(grasp_matrix(p_OcmCs, R_WCs, np.zeros(3)), mu, length)
    n, identity = grasp_map.contacts, np.eye(3 * grasp_map.contacts)
    # Variables (f, s). Rows: balance, s >= 0, f_n <= most_force, cones.
    rows = np.zeros((7 + 4 * n, 3 * n + 1))
    rows[:6, :-1], rows[6, -1] = grasp_map.scaled, -1.0
    rows[7 : 7 + n, :-1], rows[7 + n :, :-1] = identity[2::3], -cone_rows(grasp_map.mus, identity)
    right = np.concatenate([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0], np.full(n, most_force), np.zeros(3 * n)])
    cones = [conic.ZeroConeT(6), *program_cones(1 + n, n)]
    P, q = csc_matrix((3 * n + 1, 3 * n + 1)), np.append(np.zeros(3 * n), -1.0)
    values, u, f = np.zeros(6), np.zeros((6, 1, 6)), np.zeros((6, n, 3))
    for k, push in enumerate(push_wrenches(1.0 / GRAVITY)):
        rows[:6, -1] = push
        solution = conic_solution(P, q, csc_matrix(rows), right, cones)
        if solver_status(solution) != "solved":  # not even s = 0 is held
            return PushMargins(np.zeros(6), np.zeros((6, n, 3)), np.zeros((6, n, 3)))
        x = np.asarray(solution.x)
        values[k], f[k], u[k] = x[-1], x[:-1].reshape(n, 3), -np.asarray(solution.z)[:6]
    # u . dw, of the wrench w = (sum p x F / length, sum F).
    F_Ws = np.einsum("nij,knj->kni", R_WCs, f)
    torque = np.repeat(u[..., :3] / length, n, axis=1)
    on_force = u[..., 3:] + cross(torque, p_OcmCs[None])
    return PushMargins(values, cross(F_Ws, torque), cross(cross(F_Ws, on_force), n_WCs[None]))
