"""Pre-grasp and squeeze: what a hand does before and after a grasp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from scipy.ndimage import map_coordinates

from xdex_drake.contact.certificate import contact_geometry
from xdex_drake.contact.cones import effort_map
from xdex_drake.contact.wrench import balance, gravity_wrench
from xdex_drake.grasp import Certificate, Grasp
from xdex_drake.hand.description import Array, Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs import constraints
from xdex_drake.programs.force_closure import near_self_pairs, posture_cost
from xdex_drake.programs.point import ContactSet, Point
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.sequential import solve_sequential
from xdex_drake.scene.tabletop import Scene

CLEARANCE = 5e-3
"""Gap that a pre-grasp keeps from the object, everywhere [m]."""

RULE_GAP = 0.01
"""Gap up to which `squeeze_by_rule` takes a link for a contact [m]."""

RULE_FRICTION = (0.55, 0.85)
"""Fractions of the friction that its forces try in turn."""

RULE_CLOSING = 0.1
"""Fraction of its range by which a joint closes where no forces are found."""

NO_CONTACTS = ContactSet(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64))


@dataclass(frozen=True)
class Pregrasp:
    """A configuration before the grasp.

    Attributes:
        X_WH: Wrist pose; its rotation is the grasp's.
        q: Joint values, shape (n,).
        clearance: Least gap between a sphere of the hand and the object [m].
    """

    X_WH: RigidTransform
    q: Array
    clearance: float


def pregrasp_program(hand: Hand, scene: Scene, X_WH: RigidTransform, q: Array, clearance: float) -> GraspProgram:
    """The nearest configuration that clears the object everywhere: joints open first, the wrist moves back if it must.

    Args:
        hand: The hand.
        scene: The scene.
        X_WH: Wrist pose of the grasp.
        q: Joint values of the grasp, shape (n,).
        clearance: Gap to keep from the object [m].

    Returns:
        The program.
    """
    start = Point(Configuration.at(hand, X_WH, q), scene, NO_CONTACTS, np.zeros((0, 3)))
    near, gaps, _ = start.object_distances
    heights = start.centers_W[:, 2] - hand.spheres[:, 3]
    blocks = (
        constraints.object_block(near[gaps < 0.04], np.full(int((gaps < 0.04).sum()), clearance)),
        constraints.table_block(np.flatnonzero(heights < 0.05), 2e-3),
        constraints.self_block(near_self_pairs(hand, start.k), 1e-3),
        constraints.limit_block(hand.limits),
    )
    # The carriage of a lift does not turn, so the wrist's rotation is all but fixed.
    cost = posture_cost(start, 1.0, rotation=1e-3, translation=0.005, joint=0.3)
    return GraspProgram("pre-grasp", start, (cost,), blocks)


def pregrasp(hand: Hand, scene: Scene, X_WH: RigidTransform, q: Array, *, clearance: float = CLEARANCE) -> Pregrasp:
    """Opens the hand until it clears the object.

    Args:
        hand: The hand.
        scene: The scene.
        X_WH: Wrist pose of the grasp.
        q: Joint values of the grasp, shape (n,).
        clearance: Gap to reach [m].

    Returns:
        The pre-grasp with the clearance that was reached, which may be less than asked for.
    """
    # A little more than asked for: the solver stops at its own tolerance.
    program = pregrasp_program(hand, scene, X_WH, q, clearance + 5e-4)
    point, _ = solve_sequential(program, iterations=12, trust=0.3, improvement=np.inf)
    q_open = np.clip(point.k.q, hand.limits[0], hand.limits[1])
    X_open = RigidTransform(X_WH.rotation(), point.k.X_WH.translation())
    end = Point(Configuration.at(hand, X_open, q_open), scene, NO_CONTACTS, np.zeros((0, 3)))
    return Pregrasp(X_open, q_open, float(np.min(end.object_distances[1], initial=np.inf)))


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


@dataclass(frozen=True)
class Approach:
    """A straight way of the open hand to its pre-grasp.

    Attributes:
        direction_W: Unit vector from the pre-grasp to where the hand comes from, in W, shape (3,).
        clearance: Least gap between a sphere of the hand and the object on the way [m].
        height: Least height of a sphere of the hand above the table on the way [m].
    """

    direction_W: Array
    clearance: float
    height: float


def straight_approach(
    hand: Hand, scene: Scene, X_WH: RigidTransform, q: Array, *, length: float = 0.1, clearance: float = 2e-3
) -> Approach | None:
    """Finds a straight way to a pre-grasp, clear of object and table.

    Tried are the directions against the palm's normal, against the fingers, up, and those half way between them. Gaps
    are taken from the object's grid of distances, in steps of 5 mm: two milliseconds where the first direction is
    clear.

    Args:
        hand: The hand.
        scene: The scene.
        X_WH: Wrist pose of the pre-grasp.
        q: Its joint values, shape (n,).
        length: Length of the way [m].
        clearance: Gap to keep from the object [m]; the table may be touched no deeper than at the pre-grasp itself.

    Returns:
        The first clear way, None where there is none among those tried.
    """
    R_WH = X_WH.rotation().matrix()
    away, back, up = -R_WH[:, 0], -R_WH[:, 2], np.array([0.0, 0.0, 1.0])
    start = Point(Configuration.at(hand, X_WH, q), scene, NO_CONTACTS, np.zeros((0, 3)))
    radii = hand.spheres[:, 3]
    p_OSs = (scene.X_WO.inverse() @ start.centers_W.T).T
    R_OW = scene.X_WO.rotation().matrix().T
    lowest = float((start.centers_W[:, 2] - radii).min())
    floor = min(lowest, 0.0)
    grid, steps = scene.object.grid, np.linspace(0.0, length, max(2, round(length / 5e-3) + 1))
    for direction in (away, away + up, up, away + back, back + up, back, away + back + up):
        if (norm := float(np.linalg.norm(direction))) < 1e-3:
            continue
        unit = direction / norm
        height = lowest + min(0.0, length * float(unit[2]))
        if height < floor - 1e-9:
            continue
        centers = p_OSs[None] + steps[:, None, None] * (R_OW @ unit)
        # Beyond the grid the value at its boundary is taken, which no true distance falls short of.
        cells = ((centers - grid.origin) / grid.spacing).reshape(-1, 3).T
        gaps = map_coordinates(grid.values, cells, order=1, mode="nearest").reshape(len(steps), -1) - radii
        if (least := float(gaps.min())) >= clearance:
            return Approach(unit, least, height)
    return None


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
