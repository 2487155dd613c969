"""Link-pose inverse kinematics, Eq. (6): a configuration for predicted link poses, then a grasp near it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs.block import MM, Block, without_forces
from xdex_drake.programs.force_closure import PolishSettings, polish_program
from xdex_drake.programs.inverse_kinematics import IkResult, link_pose_targets, solve_points
from xdex_drake.programs.point import Point
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.retargeting import keypoint_cost
from xdex_drake.scene.tabletop import Scene


def link_pose_ik(hand: Hand, R_WLs: Array, p_WLs: Array, *, iterations: int = 30) -> IkResult:
    """Least squares on link poses within joint limits and couplings, for many grasps at once.

    Args:
        hand: The hand.
        R_WLs: R_WL R_HL(0)^T of each link, as in the link pose vector, shape (B, n_links, 3, 3).
        p_WLs: Origins of the links [m], shape (B, n_links, 3).
        iterations: Number of steps.

    Returns:
        The configurations; the base link's own pose starts the wrist, the rest posture the joints.
    """
    # R_HL(0) of the base is R_HB, so what the vector holds for the base is the wrist's own rotation.
    R_WHs = np.array([RotationMatrix.ProjectToRotationMatrix(R).matrix() for R in R_WLs[:, 0]])
    p_WHs = p_WLs[:, 0] - R_WHs @ hand.p_HB
    qs = np.tile(hand.q_rest, (len(R_WHs), 1))
    return solve_points(hand, link_pose_targets(hand, R_WLs, p_WLs), R_WHs, p_WHs, qs, iterations=iterations)


def touching_fingers(hand: Hand, scene: Scene, X_WH: RigidTransform, q: Array, *, least: int = 3) -> NDArray[np.bool_]:
    """Which fingers of a predicted grasp are meant to touch: the thumb, and those whose tips are nearest to the object.

    Args:
        hand: The hand.
        scene: The scene.
        X_WH: Wrist pose.
        q: Joint values, shape (n,).
        least: Number of fingers that touch at least; others touch if within 2 cm.

    Returns:
        In the order of `hand.fingers`.
    """
    k = Configuration.at(hand, X_WH, q)
    gaps = np.empty(len(hand.fingers))
    for row, finger in enumerate(hand.fingers):
        spheres = hand.links[hand.link_index[finger.tip_link]].spheres
        links = np.full(len(spheres), hand.link_index[finger.tip_link])
        p_OCs = (k.points(links, spheres[:, :3]) - scene.X_WO.translation()) @ scene.X_WO.rotation().matrix()
        gaps[row] = (scene.object.exact.query(p_OCs).distance - spheres[:, 3]).min()
    thumb = np.array([finger.name == "thumb" for finger in hand.fingers])
    order = np.argsort(np.where(thumb, -np.inf, gaps))
    chosen = (gaps < 0.02) | thumb
    chosen[order[: min(least, len(order))]] = True
    if chosen.sum() > 4:
        chosen[order[4:]] = False
    return chosen


def reach_block(p_WH: Array, reach: float) -> Block:
    """Keeps the wrist near a predicted one: a program that goes farther finds another grasp, not the one it was given.

    Args:
        p_WH: Origin of the predicted wrist in W [m], shape (3,).
        reach: Greatest distance from it [m].

    Returns:
        The block; its row is the squared distance over `reach`, which is smooth.
    """

    def evaluate(point: Point) -> tuple[Array, Array]:
        apart = point.k.X_WH.translation() - p_WH
        J = np.zeros((1, 6 + len(point.k.q)))
        J[0, 3:6] = 2.0 * MM * apart / reach
        return np.array([MM * float(apart @ apart) / reach]), without_forces(point, J)

    upper = np.array([MM * reach])
    meaning = f"the wrist stays within {100.0 * reach:.0f} cm of the prediction"
    return Block("reach", evaluate, np.array([-np.inf]), upper, "mm", meaning)


def link_pose_ik_program(
    hand: Hand, scene: Scene, R_WLs: Array, p_WLs: Array, *, settings: PolishSettings | None = None
) -> GraspProgram:
    """The program that refines one predicted grasp: link poses under contact, clearance and force closure.

    Args:
        hand: The hand.
        scene: The scene.
        R_WLs: R_WL R_HL(0)^T of each link, shape (n_links, 3, 3).
        p_WLs: Origins of the links [m], shape (n_links, 3).
        settings: Numbers of the hard constraints; the defaults where None.

    Returns:
        The program, from the inverse kinematics' solution.
    """
    found = link_pose_ik(hand, R_WLs[None], p_WLs[None])
    X_WH = RigidTransform(RotationMatrix.ProjectToRotationMatrix(found.R_WHs[0]), found.p_WHs[0])
    fingers = touching_fingers(hand, scene, X_WH, found.qs[0])
    cost = keypoint_cost(link_pose_targets(hand, R_WLs[None], p_WLs[None]), weight=0.02)
    return polish_program(
        hand, scene, X_WH, found.qs[0], fingers, settings=settings, extra_costs=(cost,), name="link-pose IK"
    )
