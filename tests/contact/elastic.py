"""Hands whose fingertips hold nothing in particular, as elastic systems."""

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from xdex_drake.contact.cones import contact_frames
from xdex_drake.contact.stiffness import GraspStiffness, grasp_stiffness
from xdex_drake.contact.wrench import gravity_wrench
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.hand.library import load_hand

HANDS = ("allegro", "inspire", "schunk_svh")


def some_grasp(name: str, nc: int = 4, seed: int = 0) -> tuple[Configuration, np.ndarray, np.ndarray, np.ndarray]:
    """A hand at its rest posture with contacts on its fingertips: configuration, links, points and normals in W."""
    hand, rng = load_hand(name), np.random.default_rng(seed)
    X_WH = RigidTransform(RollPitchYaw(rng.uniform(-1, 1, 3)), rng.uniform(-0.1, 0.1, 3))
    k = Configuration.at(hand, X_WH, hand.q_rest + 0.1)
    fingers = hand.fingers[:nc]
    links = np.array([hand.link_index[finger.tip_link] for finger in fingers])
    p_WCs = k.points(links, np.array([finger.p_LTip for finger in fingers]))
    n_WCs = p_WCs.mean(axis=0) - p_WCs
    return k, links, p_WCs, n_WCs / np.linalg.norm(n_WCs, axis=1, keepdims=True)


def stiffness_of(k, links, p_WCs, n_WCs, p_WOcm, radius=8e-3) -> GraspStiffness:
    R_WCs = contact_frames(n_WCs)
    round_tips = (np.eye(3) - n_WCs[:, :, None] * n_WCs[:, None, :]) / radius
    return grasp_stiffness(k, links, p_WCs, R_WCs, p_WOcm, kp=1.0, tip_curvatures=round_tips)


def balanced(stiffness: GraspStiffness, mass: float = 0.1) -> np.ndarray:
    """Forces that balance gravity, large ones within."""
    G, n = stiffness.G, stiffness.G.shape[1]
    f = np.tile([0.0, 0.0, 2.0], n // 3)
    return f - np.linalg.pinv(G) @ (G @ f + gravity_wrench(mass))
