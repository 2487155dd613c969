"""Friction cones, grasp matrix, wrench programs, certificates, penetration, grasp quality."""

from xdex_drake.contact.certificate import CertificateResult, Residuals, certified_map, certify, check_certificate
from xdex_drake.contact.cones import cone_edges, cone_violation, contact_frames, effort_map, grasp_matrix, in_cone
from xdex_drake.contact.gradients import PushMargins, push_margins
from xdex_drake.contact.grasp_map import Effort, GraspMap
from xdex_drake.contact.held_object import HeldObject
from xdex_drake.contact.margins import BallMargin, TaskMargin, ball_margin, support, task_margin
from xdex_drake.contact.penetration import hand_depths, penetration_depth
from xdex_drake.contact.pyramids import balance_linearized, epsilon_linearized, min_weight
from xdex_drake.contact.wrench import (
    GRAVITY,
    Balance,
    balance,
    balance_program,
    gravity_wrench,
    push_wrenches,
)

__all__ = [
    "GRAVITY",
    "Balance",
    "BallMargin",
    "CertificateResult",
    "Effort",
    "GraspMap",
    "HeldObject",
    "PushMargins",
    "Residuals",
    "TaskMargin",
    "balance",
    "balance_linearized",
    "balance_program",
    "ball_margin",
    "certified_map",
    "certify",
    "check_certificate",
    "cone_edges",
    "cone_violation",
    "contact_frames",
    "effort_map",
    "epsilon_linearized",
    "grasp_matrix",
    "gravity_wrench",
    "hand_depths",
    "in_cone",
    "min_weight",
    "penetration_depth",
    "push_margins",
    "push_wrenches",
    "support",
    "task_margin",
]
