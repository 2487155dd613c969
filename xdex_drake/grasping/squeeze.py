"""Squeeze: joint targets that apply the forces of a grasp."""

from __future__ import annotations

import numpy as np

from xdex_drake.contact.certificate import contact_geometry
from xdex_drake.contact.cones import effort_map
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
    R_WCs, _ = contact_geometry(p_OCs, n_OCs, scene.X_WO.rotation().matrix(), certificate.p_OOcm)
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
    k, model = Configuration.at(hand, grasp.X_WH, grasp.q), scene.object
    point = Point(k, scene, NO_CONTACTS, np.zeros((0, 3)))
    near, gaps, outward = point.object_distances
    links = hand.sphere_links[near]
    first = np.lexsort((gaps, links))
    rows = first[np.flatnonzero(np.diff(links[first], prepend=-1))]  # of each link the nearest sphere
    rows = rows[gaps[rows] < RULE_GAP]
    if len(rows):
        n_WCs = -outward[rows]
        p_WCs = point.centers_W[near[rows]] + (gaps[rows] + hand.spheres[near[rows], 3])[:, None] * n_WCs
        X_OW, R_WO = scene.X_WO.inverse(), scene.X_WO.rotation().matrix()
        R_WCs, G = contact_geometry((X_OW @ p_WCs.T).T, n_WCs @ R_WO, R_WO, model.p_OOcm)
        J = k.jacobian(links[rows], p_WCs)[:, :, 6:]
        A = effort_map(J, R_WCs)
        for safety in RULE_FRICTION:
            forces = balance(
                G,
                model.friction,
                gravity_wrench(model.mass),
                A=A,
                effort=hand.effort,
                length=model.length,
                safety=safety,
            )
            if forces.solved:
                return grasp.q + np.clip(A @ forces.f, -hand.effort, hand.effort) / kp
    low, high = hand.limits
    return np.clip(grasp.q + RULE_CLOSING * (high - low) * np.sign(grasp.q - grasp.q_pregrasp), low, high)
