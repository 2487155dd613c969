"""Squeeze: joint targets that apply the forces of a grasp."""

from __future__ import annotations

import numpy as np

from xdex_drake.contact.cones import contact_frames, effort_map
from xdex_drake.contact.grasp_map import Effort
from xdex_drake.contact.held_object import HeldObject
from xdex_drake.contact.wrench import balance, gravity_wrench
from xdex_drake.grasp import Certificate, Grasp
from xdex_drake.grasping.pregrasp import NO_CONTACTS
from xdex_drake.hand.description import Array, Hand
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


def squeeze_targets(hand: Hand, grasp: Grasp, scene: Scene, kp: float) -> Array:
    """Joint targets whose PD torque at the grasp applies the certificate's forces: q + tau / kp.

    Args:
        hand: The hand.
        grasp: A grasp with a certificate.
        scene: The scene.
        kp: Proportional gain of the joints [N m/rad].

    Returns:
        Targets [rad or m], shape (n,); torques are within the hand's effort limits.
    """
    assert grasp.certificate is not None
    k = Configuration.at(hand, grasp.X_WH, grasp.q)
    torques = np.clip(contact_torques(hand, k, scene, grasp.certificate), -hand.effort, hand.effort)
    return grasp.q + torques / kp


def squeeze_by_rule(hand: Hand, grasp: Grasp, scene: Scene, kp: float) -> Array:
    """Joint targets that squeeze a grasp without a certificate, by one rule for every method.

    Each link that is within 10 mm of the object is taken for a contact at its nearest point, and the balance program
    gives the forces. Where it finds none, each joint goes on by a tenth of its range in the sense in which it closed.

    Args:
        hand: The hand.
        grasp: A grasp with a pre-grasp.
        scene: The scene.
        kp: Proportional gain of the joints [N m/rad].

    Returns:
        Targets [rad or m], shape (n,).
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
                return grasp.q + np.clip(A @ forces.f, -hand.effort, hand.effort) / kp
    low, high = hand.limits
    return np.clip(grasp.q + RULE_CLOSING * (high - low) * np.sign(grasp.q - grasp.q_pregrasp), low, high)
