"""Stiffness of a grasp under load: joints, contacts and object as one elastic system.

The wrist is held, the joints follow constant targets by springs K_p, and no contact slides. A displacement is
z = (dq, x): actuated joints, then the object's twist (rotation vector about its center of mass and motion of it, in W).
Contact i joins a point p_h of a link and a point p_o of the object. Its force f on the object, in W, is the multiplier
of p_h = p_o, so that the energy, up to second order in z, is

    1/2 dq' K_p dq  +  1/2 e' C_s^-1 e  +  sum_i f_i . (p_h - p_o + 1/2 phi x S phi),    e = J dq - G' x,

C_s being the compliance of the contacts themselves. Four terms make its Hessian H(f), which is linear in the forces:

* joints: K_q(f) = K_p + d(J' f)/dq at fixed f: the arms of the forces change as the fingers move. Chen and Kao (2000)
  call C_s = J' K J + d(J' f)/dq the conservative congruence transformation; a finger that pushes along itself buckles.
* contacts: C_s in series with the joints. Eliminating the joints gives the contact stiffness
  K_c = (J K_q^-1 J' + C_s)^-1 (Hanafusa and Asada, 1977; Cutkosky and Kao, 1989).
* object: its contact points turn with it, which adds sum_i (f_i . r_i) I - r_i f_i' to the rotations, r_i being the arm
  of contact i: forces that press destabilise. It is symmetric where the torques balance, and only there.
* rolling: link and object turn by phi = J_w dq - x_w with respect to one another, and the contact wanders on both
  surfaces by S phi = kappa^-1 (n x phi), kappa being the sum of the two curvatures (Montana, 1988). The points that
  touched at first so move apart by -1/2 phi x S phi, which adds -[f]x S to the rotations phi. A normal force f_n on a
  ball of radius rho adds rho f_n to both rolling directions: blunt tips are stabler than sharp ones (Howard and Kumar,
  1996). A tangential force adds -rho n f_t', which is not symmetric: rolling and then spinning about the normal does
  not lead where spinning and then rolling does. Of this part, which is no energy, the symmetric half is taken: the work
  along a straight twist.

Eliminating the joints from H leaves the object's stiffness K_x = G K_c G' + K_geo, and a small wrench w on the object
changes the forces by the linear law df = C_s^-1 (J dq - G' x) with H z = (0, w); without rolling links that is
-K_c G' K_x^-1 w (Prattichizzo and Trinkle, 2016, section 38.4). The grasp is stable where H is positive definite.

References:
    H. Hanafusa, H. Asada, Stable prehension by a robot hand with elastic fingers, ISIR 1977.
    M. Cutkosky, I. Kao, Computing and controlling the compliance of a robotic hand, IEEE T-RA 5(2), 1989.
    D. Montana, The kinematics of contact and grasp, IJRR 7(3), 1988.
    W. Howard, V. Kumar, On the stability of grasped objects, IEEE T-RA 12(6), 1996.
    S.-F. Chen, I. Kao, Conservative congruence transformation for joint and Cartesian stiffness matrices, IJRR 19(9),
    2000.
    D. Prattichizzo, J. Trinkle, Grasping, Springer Handbook of Robotics, 2nd edition, chapter 38, 2016.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xdex_drake.arrays import Array, skew
from xdex_drake.contact.cones import grasp_matrix
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.shapes import Capsule, Geometry, Sphere

NORMAL_COMPLIANCE = 2e-5
"""Compliance of a contact along its normal [m/N]: two surfaces of 1e5 N/m in series, as the lifts have them."""

TANGENTIAL_COMPLIANCE = 2e-5
"""The same along a tangent [m/N]. Drake's friction has none, it creeps; this is as small against the fingers' own."""

FLATTEST = 0.02
"""Contacts of surfaces that are flatter together than this radius count as that round [m]: no face is endless."""


@dataclass(frozen=True)
class GraspStiffness:
    """The Hessian of the module's docstring as a linear function of the contact forces.

    Forces f are stacked in the contact frames, shape (3 nc,). Joints that move no contact, and
    joints that press on a stop, are left out: m of the n actuated ones remain.

    Attributes:
        G: Grasp matrix in W about the center of mass, torque first, shape (6, 3 nc).
        J: Velocities of the hand's contact points in the contact frames, shape (3 nc, m).
        joints: Indices of the joints that remain among the actuated ones, shape (m,).
        kp: Gains of these joints [N m/rad or N/m], shape (m,).
        compliance: C_s, the compliance of the contacts in their frames [m/N], shape (3 nc,).
        slopes: Derivative of each row of J with respect to the joints, shape (3 nc, m, m).
        geometric: What a unit of each force adds to H, shape (3 nc, m + 6, m + 6).
        turning: Turn of contact normals in W per unit of z, shape (nc, 3, m + 6); see `response`.
        R_WCs: Contact frames, shape (nc, 3, 3).
    """

    G: Array
    J: Array
    joints: NDArray[np.int64]
    kp: Array
    compliance: Array
    slopes: Array
    geometric: Array
    turning: Array
    R_WCs: Array

    @cached_property
    def elastic(self) -> Array:
        """H without load [N m/rad ...], shape (m + 6, m + 6)."""
        m = len(self.kp)
        E = np.concatenate([self.J, -self.G.T], axis=1)
        H = E.T @ (E / self.compliance[:, None])
        H[np.arange(m), np.arange(m)] += self.kp
        return H

    def hessian(self, f: ArrayLike) -> Array:
        """H(f) at forces f, shape (m + 6, m + 6): symmetric where f balances a force at the center of mass."""
        return self.elastic + np.tensordot(np.asarray(f, dtype=float), self.geometric, 1)

    def joint_stiffness(self, f: ArrayLike) -> Array:
        """K_q = K_p + d(J' f)/dq at fixed forces [N m/rad], shape (m, m)."""
        return np.diag(self.kp) + np.tensordot(np.asarray(f, dtype=float), self.slopes, 1)

    def contact_compliance(self, f: ArrayLike) -> Array:
        """C = J K_q^-1 J' + C_s in the contact frames [m/N], shape (3 nc, 3 nc)."""
        return self.J @ np.linalg.solve(self.joint_stiffness(f), self.J.T) + np.diag(self.compliance)

    def object_stiffness(self, f: ArrayLike) -> Array:
        """K_x, what remains of H(f) without the joints, torque first [N m/rad, N, N/m], shape (6, 6)."""
        H, m = self.hessian(f), len(self.kp)
        return H[m:, m:] - H[m:, :m] @ np.linalg.solve(H[:m, :m], H[:m, m:])


@dataclass(frozen=True)
class Response:
    """What small wrenches on the object change, one column a wrench.

    Attributes:
        dq: Change of the joints of `GraspStiffness.joints` [rad or m], shape (m, k).
        x: Twist of the object, rotation first [rad, m], shape (6, k).
        df: Change of the forces in their contact frames, which turn with the object's surface [N], shape (3 nc, k).
    """

    dq: Array
    x: Array
    df: Array


def response(stiffness: GraspStiffness, f: ArrayLike, wrenches: ArrayLike) -> Response:
    """The linear law: what wrenches change while nothing slides.

    Forces are given in frames that turn with the surface, as their friction cones do: by d n = x_w x n - kappa_o S phi.

    Args:
        stiffness: The grasp's stiffness.
        f: Forces in contact frames, shape (3 nc,).
        wrenches: Wrenches on the object about its center of mass, torque first, shape (k, 6).

    Returns:
        The changes.
    """
    f, m = np.asarray(f, dtype=float), len(stiffness.kp)
    loads = np.concatenate([np.zeros((m, len(np.atleast_2d(wrenches)))), np.atleast_2d(wrenches).T])
    z = np.asarray(np.linalg.solve(stiffness.hessian(f), loads), dtype=float)
    df = (stiffness.J @ z[:m] - stiffness.G.T @ z[m:]) / stiffness.compliance[:, None]
    f_Ws = np.einsum("cab,cb->ca", stiffness.R_WCs, f.reshape(-1, 3))
    turns = np.einsum("cab,cbz->caz", skew(f_Ws), stiffness.turning)  # f x turn: minus the turn of f's frame
    df += np.einsum("cba,cbz->caz", stiffness.R_WCs, turns).reshape(len(f), -1) @ z
    return Response(z[:m], z[m:], df)


def grasp_stiffness(
    k: Configuration,
    links: NDArray[np.int64],
    p_WCs: Array,
    R_WCs: Array,
    p_WOcm: Array,
    *,
    kp: float,
    tip_curvatures: Array,
    object_curvatures: Array | None = None,
    locked: NDArray[np.int64] | None = None,
    compliance: tuple[float, float] = (NORMAL_COMPLIANCE, TANGENTIAL_COMPLIANCE),
) -> GraspStiffness:
    """The stiffness of a grasp, as a function of its forces.

    Args:
        k: The hand's configuration.
        links: Index of each contact's link, shape (nc,).
        p_WCs: Contact points [m], shape (nc, 3).
        R_WCs: Contact frames, z into the object, shape (nc, 3, 3).
        p_WOcm: The object's center of mass [m], shape (3,).
        kp: Proportional gain of every joint [N m/rad].
        tip_curvatures: Curvature of the link at each contact, a symmetric matrix in W on the tangent plane, positive
            where it is convex [1/m], shape (nc, 3, 3); see `tip_curvatures`.
        object_curvatures: The same of the object; flat where None, as the faces of its parts are.
        locked: Actuated joints that press on a stop and do not give way, by index; none where None. See `stops`.
        compliance: Compliance of each contact along its normal and its tangents [m/N].

    Returns:
        The stiffness.
    """
    nc = len(links)
    J_W = k.jacobian(links, p_WCs)[:, :, 6:]
    free = np.abs(J_W).max(axis=(0, 1), initial=0.0) > 1e-12
    if locked is not None:
        free[locked] = False
    joints = np.flatnonzero(free)
    m = len(joints)
    J = np.einsum("cba,cbj->caj", R_WCs, J_W[:, :, joints]).reshape(3 * nc, m)
    slopes_W = k.jacobian_slopes(links, p_WCs)[:, :, joints[:, None], joints]
    slopes = np.einsum("cba,cbij->caij", R_WCs, slopes_W).reshape(3 * nc, m, m)
    flat = np.zeros((nc, 3, 3)) if object_curvatures is None else object_curvatures
    # Relative rotation phi of link and object, and what the contact wanders by it, per unit of z.
    phi = np.concatenate([k.angular_jacobian(links)[:, :, 6:][:, :, joints], np.zeros((nc, 3, 6))], axis=2)
    phi[:, :, m : m + 3] = -np.eye(3)
    S = _wander(tip_curvatures + flat, R_WCs[:, :, 2])
    units = skew(np.swapaxes(R_WCs, 1, 2))  # [f]x of a unit of each force, (nc, 3 forces, 3, 3)
    rolling = -units @ S[:, None]
    rolling = 0.5 * (rolling + np.swapaxes(rolling, -1, -2))
    geometric = (np.swapaxes(phi, 1, 2)[:, None] @ rolling @ phi[:, None]).reshape(3 * nc, m + 6, m + 6)
    geometric[:, :m, :m] += slopes
    arms, directions = p_WCs - p_WOcm, np.swapaxes(R_WCs, 1, 2)
    press = np.einsum("ca,cka->ck", arms, directions)[..., None, None] * np.eye(3)
    geometric[:, m : m + 3, m : m + 3] += (press - arms[:, None, :, None] * directions[:, :, None, :]).reshape(
        3 * nc, 3, 3
    )
    turning = np.zeros((nc, 3, m + 6))
    turning[:, :, m : m + 3] += np.eye(3)
    if object_curvatures is not None:
        # d n = -kappa_o S phi, a turn by n x d n.
        turning -= skew(R_WCs[:, :, 2]) @ flat @ S @ phi
    return GraspStiffness(
        G=grasp_matrix(p_WCs, R_WCs, p_WOcm),
        J=J,
        joints=joints,
        kp=np.full(m, float(kp)),
        compliance=np.tile([compliance[1], compliance[1], compliance[0]], nc),
        slopes=slopes,
        geometric=geometric,
        turning=turning,
        R_WCs=R_WCs,
    )


def _wander(curvatures: Array, n_WCs: Array) -> Array:
    """S of S phi = kappa^-1 (n x phi), the wandering of contacts, shape (nc, 3, 3); kappa at least 1 / `FLATTEST`."""
    values, vectors = np.linalg.eigh(curvatures + 1e9 * n_WCs[:, :, None] * n_WCs[:, None, :])
    radii = 1.0 / np.maximum(values, 1.0 / FLATTEST)
    radii[:, 2] = 0.0  # along the normal nothing wanders
    return (vectors * radii[:, None, :]) @ np.swapaxes(vectors, 1, 2) @ skew(n_WCs)


def stops(hand: Hand, q: Array, tolerance: float = 2e-3) -> NDArray[np.int64]:
    """Which actuated joints stand at a limit.

    Args:
        hand: The hand.
        q: Actuated joint values [rad or m], shape (n,).
        tolerance: Distance from the limit that still counts as there [rad or m].

    Returns:
        1 at the upper limit, -1 at the lower one, else 0, shape (n,).
    """
    low, high = hand.limits
    return np.where(q > high - tolerance, 1, 0) - np.where(q < low + tolerance, 1, 0)


def tip_curvatures(hand: Hand, k: Configuration, links: NDArray[np.int64], p_WCs: Array, n_WCs: Array) -> Array:
    """Curvature of the hand's own shapes at contacts: of each link's primitive whose surface is nearest.

    Balls and the caps of capsules are round, sides of capsules are round across and flat along, boxes and convex hulls
    are flat.

    Args:
        hand: The hand.
        k: Its configuration.
        links: Index of each contact's link, shape (nc,).
        p_WCs: Contact points [m], shape (nc, 3).
        n_WCs: Unit normals into the object, shape (nc, 3).

    Returns:
        Symmetric matrices in W on the tangent planes [1/m], shape (nc, 3, 3).
    """
    curvatures = np.zeros((len(links), 3, 3))
    for i, link in enumerate(links.tolist()):
        shapes, R_WL = hand.links[link].geometry, k.R_WLs[link]
        p_LC = (p_WCs[i] - k.p_WLs[link]) @ R_WL
        nearest = min(shapes, key=lambda shape: abs(float(shape.signed_distance(p_LC))), default=None)
        if nearest is not None:
            tangent = np.eye(3) - np.outer(n_WCs[i], n_WCs[i])
            curvatures[i] = tangent @ R_WL @ _curvature(nearest, p_LC) @ R_WL.T @ tangent
    return curvatures


def _curvature(shape: Geometry, p_LC: Array) -> Array:
    """Curvature of a primitive at a point of its surface, the direction of the normal not yet taken out, (3, 3)."""
    if isinstance(shape, Sphere):
        return np.eye(3) / shape.radius
    if not isinstance(shape, Capsule):
        return np.zeros((3, 3))
    along = np.asarray(shape.p1, dtype=float) - shape.p0
    length = float(np.linalg.norm(along))
    t = float((p_LC - shape.p0) @ along) / max(length, 1e-12) ** 2
    if length < 1e-9 or not 0.0 <= t <= 1.0:
        return np.eye(3) / shape.radius
    return (np.eye(3) - np.outer(along, along) / length**2) / shape.radius
