"""Squeeze: joint torques that apply the forces of a grasp.

Joints are driven by kp (q - q_now) + tau, a feed-forward torque beside a spring toward the grasp. The same drive
without feed-forward has its targets at q + tau / kp, which may lie beyond the joint limits. Where a tool takes targets
alone, and keeps them within the limits, what is cut off is torque that it does not command.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import contact_frames, effort_map
from xdex_drake.contact.grasp_map import Effort
from xdex_drake.contact.held_object import HeldObject
from xdex_drake.contact.wrench import balance, gravity_wrench
from xdex_drake.grasp import Certificate, Grasp
from xdex_drake.grasping.pregrasp import NO_CONTACTS
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.point import Point
from xdex_drake.scene.tabletop import Scene

RULE_GAP = 0.01
"""Gap up to which `squeeze_by_rule` takes a link for a contact [m]."""


RULE_FRICTION = (0.55, 0.85)
"""Fractions of the friction that its forces try in turn."""


RULE_CLOSING = 0.1
"""Fraction of its range by which a joint closes where no forces are found."""


def contact_torques(hand: Hand, k: Configuration, scene: Scene, certificate: Certificate) -> Array:
    """Torques of the actuated joints that apply a certificate's forces: tau = C^T J^T f.

    Args:
        hand: The hand.
        k: The grasp's configuration.
        scene: The scene.
        certificate: The certificate.

    Returns:
        Torques [N m], shape (n,).
    """
    p_OCs = np.array([c.p_OC for c in certificate.contacts])
    n_OCs = np.array([c.n_OC for c in certificate.contacts])
    R_WCs = scene.X_WO.rotation().matrix() @ contact_frames(n_OCs)
    f_Ws = np.einsum("kab,kb->ka", R_WCs, np.array([c.f_C for c in certificate.contacts]))
    links = np.array([hand.link_index[c.link] for c in certificate.contacts])
    J = k.jacobian(links, (scene.X_WO @ p_OCs.T).T)[:, :, 6:]
    return np.einsum("ka,kab->b", f_Ws, J)


def squeezed(hand: Hand, grasp: Grasp, tau: Array, kp: float) -> Grasp:
    """The grasp with a squeeze.

    Args:
        hand: The hand.
        grasp: The grasp.
        tau: Torques of the squeeze [N m or N], shape (n,); cut at the hand's effort limits.
        kp: Proportional gain of the joints that `q_squeeze` is for [N m/rad].

    Returns:
        The grasp with `tau_squeeze`, and with `q_squeeze`, q + tau / kp cut at the joint limits.
    """
    tau = np.clip(tau, -hand.effort, hand.effort)
    return replace(grasp, tau_squeeze=tau, q_squeeze=np.clip(grasp.q + tau / kp, *hand.limits))


def squeeze(hand: Hand, grasp: Grasp, scene: Scene, kp: float) -> Grasp:
    """The grasp with a squeeze that applies its certificate's forces.

    Args:
        hand: The hand.
        grasp: A grasp with a certificate.
        scene: The scene.
        kp: Proportional gain of the joints that `q_squeeze` is for [N m/rad].

    Returns:
        The grasp with `tau_squeeze` and `q_squeeze`.
    """
    assert grasp.certificate is not None
    k = Configuration.at(hand, grasp.X_WH, grasp.q)
    return squeezed(hand, grasp, contact_torques(hand, k, scene, grasp.certificate), kp)


def squeeze_by_rule(hand: Hand, grasp: Grasp, scene: Scene, kp: float) -> Grasp:
    """The grasp with a squeeze by one rule for every method, for grasps without a certificate.

    Each link that is within 10 mm of the object is taken for a contact at its nearest point, and the balance program
    gives the forces. Where it finds none, the targets go on by a tenth of each joint's range in the sense in which it
    closed.

    Args:
        hand: The hand.
        grasp: A grasp with a pre-grasp.
        scene: The scene.
        kp: Proportional gain of the joints [N m/rad].

    Returns:
        The grasp with `tau_squeeze` and `q_squeeze`.
    """
    assert grasp.q_pregrasp is not None
    k = Configuration.at(hand, grasp.X_WH, grasp.q)
    point = Point(k, scene, NO_CONTACTS, np.zeros((0, 3)))
    near, gaps, outward = point.object_distances
    links = hand.sphere_links[near]
    first = np.lexsort((gaps, links))
    rows = first[np.flatnonzero(np.diff(links[first], prepend=-1))]  # of each link the nearest sphere
    rows = rows[gaps[rows] < RULE_GAP]
    if len(rows):
        n_WCs = -outward[rows]
        p_WCs = point.centers_W[near[rows]] + (gaps[rows] + hand.spheres[near[rows], 3])[:, None] * n_WCs
        held = HeldObject.of(scene)
        n_OCs = n_WCs @ held.R_WO
        grasp_map = held.grasp_map((scene.X_WO.inverse() @ p_WCs.T).T, n_OCs)
        A = effort_map(k.jacobian(links[rows], p_WCs)[:, :, 6:], held.R_WO @ contact_frames(n_OCs))
        for safety in RULE_FRICTION:
            forces = balance(grasp_map, gravity_wrench(held.mass), effort=Effort(A, hand.effort), safety=safety)
            if forces.solved:
                return squeezed(hand, grasp, A @ forces.f, kp)
    low, high = hand.limits
    closed = np.clip(grasp.q + RULE_CLOSING * (high - low) * np.sign(grasp.q - grasp.q_pregrasp), low, high)
    return squeezed(hand, grasp, kp * (closed - grasp.q), kp)
