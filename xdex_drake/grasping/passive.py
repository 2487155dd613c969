"""The squeeze of a grasp that is to hold while it is pushed, and how well it is foretold to hold.

What foretells it was measured on 225 lifted grasps of five hands and twelve meshes, none of which it chose. The area
under the ROC curve for surviving two seconds and six pushes of the weight is .63 for the task margin, .50 for the
friction left, .55 for the ball margin and .59 for the multiple of the pushes under which nothing slides. It is .83 for
the motion that `contact.sliding` steps through, and .87 for that motion with the friction reduced by a quarter of the
spread of normals about the contacts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.contact.cones import contact_frames, effort_map
from xdex_drake.contact.grasp_map import Effort
from xdex_drake.contact.held_object import HeldObject
from xdex_drake.contact.passive import Loads, PassiveSqueeze, SqueezeSettings, assessed, passive_squeeze
from xdex_drake.contact.patches import normal_spread
from xdex_drake.contact.sliding import pushed_motion
from xdex_drake.contact.stiffness import GraspStiffness, grasp_stiffness, stops, tip_curvatures
from xdex_drake.contact.wrench import gravity_wrench, push_wrenches
from xdex_drake.grasp import Certificate
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.scene.tabletop import Scene
from xdex_drake.simulation.protocol import HoldTest

MULTIPLES = (0.8, 1.0, 1.2)
"""Multiples of the pushes whose motions are averaged: one alone jumps where a contact begins to slide."""

SPREAD_SHARE = 0.25
"""Share of the spread of normals by which the angle of friction is reduced."""

SURE = -0.7
"""Logarithm of the foretold motion, half of what is allowed, below which no other squeeze is looked for."""

LOST = 5.0
"""Times the bound beyond which one motion is as bad as another."""

SQUEEZES = (SqueezeSettings(), SqueezeSettings(joint_stiffness=0.05, object_stiffness=10.0, greatest=7.0))
"""Demands that are tried, beside the certificate's own forces. Those for stiffness hold forces down where a finger
nearly buckles by itself, although the object may steady it."""


@dataclass(frozen=True)
class ElasticGrasp:
    """A grasp as an elastic system with its loads.

    Attributes:
        stiffness: Its stiffness.
        loads: What it has to do: gravity, and six pushes of the weight.
        inertia: The object's inertia about the center of mass in W [kg m^2], shape (3, 3).
        mass: Mass of the object [kg].
        spread: Mean angle of the normals about each contact [rad], shape (nc,).
    """

    stiffness: GraspStiffness
    loads: Loads
    inertia: Array
    mass: float
    spread: Array


@dataclass(frozen=True)
class HoldingSqueeze:
    """The squeeze of a grasp, and how well it is foretold to hold.

    Attributes:
        squeeze: Forces, torques, margins and eigenvalues.
        foretold: How far the object is foretold to move under pushes; see `foretold_motion`.
        spread: Mean angle of the normals about each contact [rad], shape (nc,).
    """

    squeeze: PassiveSqueeze
    foretold: float
    spread: Array


def elastic_grasp(hand: Hand, k: Configuration, scene: Scene, certificate: Certificate, kp: float) -> ElasticGrasp:
    """The elastic system of a grasp with the contacts of a certificate.

    Tips are as round as the hand's shapes; the object is locally flat, as the faces of its parts are. Joints that stand
    at a limit are taken to press on it.

    Args:
        hand: The hand.
        k: The grasp's configuration.
        scene: The scene.
        certificate: Contacts on the object.
        kp: Proportional gain of the joints [N m/rad].

    Returns:
        The system.
    """
    held, contacts = HeldObject.of(scene), certificate.contacts
    p_OCs, n_OCs = np.array([c.p_OC for c in contacts]), np.array([c.n_OC for c in contacts])
    links = np.array([hand.link_index[c.link] for c in contacts])
    p_WCs, R_WO = (scene.X_WO @ p_OCs.T).T, scene.X_WO.rotation().matrix()
    R_WCs = R_WO @ contact_frames(n_OCs)
    A = effort_map(k.jacobian(links, p_WCs)[:, :, 6:], R_WCs)
    at_stop = stops(hand, k.q) * (np.abs(A).max(axis=1) > 1e-9)
    stiffness = grasp_stiffness(
        k,
        links,
        p_WCs,
        R_WCs,
        scene.X_WO @ held.p_OOcm,
        kp=kp,
        tip_curvatures=tip_curvatures(hand, k, links, p_WCs, R_WCs[:, :, 2]),
        locked=np.flatnonzero(at_stop),
    )
    loads = Loads(
        map=held.grasp_map(p_OCs, n_OCs),
        effort=Effort(A, hand.effort),
        gravity=gravity_wrench(held.mass),
        pushes=push_wrenches(held.mass),
        at_stop=at_stop,
    )
    inertia = R_WO @ scene.object.I_OcmO @ R_WO.T
    return ElasticGrasp(stiffness, loads, inertia, held.mass, normal_spread(scene.object, p_OCs, n_OCs))


def holding_squeeze(
    hand: Hand,
    k: Configuration,
    scene: Scene,
    certificate: Certificate,
    *,
    kp: float = 1.0,
    squeezes: Sequence[SqueezeSettings] = SQUEEZES,
) -> HoldingSqueeze:
    """The squeeze of a grasp that is foretold to move least under pushes.

    Args:
        hand: The hand.
        k: The grasp's configuration.
        scene: The scene.
        certificate: The certificate: its contacts, and its forces to begin with.
        kp: Proportional gain of the joints [N m/rad].
        squeezes: Demands whose passive squeezes are tried in turn, and then the certificate's own forces, until one is
            sure to hold.

    Returns:
        The squeeze; its `margin` is 0 where it applies the certificate's own forces.
    """
    grasp = elastic_grasp(hand, k, scene, certificate, kp)
    start = np.array([c.f_C for c in certificate.contacts]).ravel()
    best = None
    for squeeze in _squeezes(grasp, start, squeezes):
        foretold = foretold_motion(grasp, squeeze.f)
        if best is None or foretold < best.foretold:
            best = HoldingSqueeze(squeeze, foretold, grasp.spread)
        if foretold <= SURE:
            break
    assert best is not None
    return best


def _squeezes(grasp: ElasticGrasp, start: Array, squeezes: Sequence[SqueezeSettings]) -> Iterator[PassiveSqueeze]:
    """Squeezes to choose from, the one that is most often the best first, the certificate's own forces last."""
    for settings in squeezes:
        found = passive_squeeze(grasp.stiffness, grasp.loads, start, settings)
        if found.status == "solved":
            yield found
    no_slips = np.zeros((len(grasp.loads.pushes), len(grasp.loads.map.mus), 2))
    yield assessed(grasp.stiffness, grasp.loads, start, 0.0, no_slips, SqueezeSettings())


def foretold_motion(grasp: ElasticGrasp, f: Array, test: HoldTest | None = None) -> float:
    """How far the object is foretold to move under the pushes of a hold.

    The motion is that of the worst push: the greater of shift and turn, each divided by its bound in the protocol, as a
    logarithm, averaged over multiples of the pushes.

    Args:
        grasp: The elastic grasp.
        f: Forces of the squeeze [N], shape (3 nc,).
        test: The bounds; those of `hold` where None.

    Returns:
        The mean logarithm: below zero where it stays within the bounds.
    """
    test = test or HoldTest()
    pushes = np.concatenate([multiple * grasp.loads.pushes for multiple in MULTIPLES])
    angle = np.maximum(np.arctan(grasp.loads.map.mus) - SPREAD_SHARE * grasp.spread, 0.03)
    moved = pushed_motion(grasp.stiffness, f, np.tan(angle), pushes, mass=grasp.mass, inertia=grasp.inertia)
    worst = np.maximum(moved.shift / test.max_slip_m, moved.turn / test.max_turn_rad).reshape(len(MULTIPLES), -1)
    return float(np.log(np.clip(worst.max(axis=1), 1e-3, LOST)).mean())
