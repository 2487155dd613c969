"""Friction cones, grasp matrix, wrench programs, certificates, penetration, grasp quality."""

from xdex_drake.contact.certificate import CertificateResult, Residuals, certify, check_certificate, contact_geometry
from xdex_drake.contact.cones import (
    cone_edges,
    cone_violation,
    contact_frames,
    effort_map,
    grasp_matrix,
    in_cone,
    project_onto_cone,
)
from xdex_drake.contact.energy import WrenchEnergy, wrench_energy
from xdex_drake.contact.gradients import Quality, ball_margin_gradient, epsilon_gradient, min_weight_gradient
from xdex_drake.contact.margins import (
    BallMargin,
    TaskMargin,
    ball_margin,
    epsilon_linearized,
    min_weight,
    support,
    task_margin,
)
from xdex_drake.contact.penetration import hand_depths, penetration_depth
from xdex_drake.contact.wrench import (
    GRAVITY,
    Balance,
    balance,
    balance_linearized,
    balance_program,
    gravity_wrench,
    push_wrenches,
    squeeze_forces,
)

__all__ = [
    "GRAVITY",
    "Balance",
    "BallMargin",
    "CertificateResult",
    "Quality",
    "Residuals",
    "TaskMargin",
    "WrenchEnergy",
    "balance",
    "balance_linearized",
    "balance_program",
    "ball_margin",
    "ball_margin_gradient",
    "certify",
    "check_certificate",
    "cone_edges",
    "cone_violation",
    "contact_frames",
    "contact_geometry",
    "effort_map",
    "epsilon_gradient",
    "epsilon_linearized",
    "grasp_matrix",
    "gravity_wrench",
    "hand_depths",
    "in_cone",
    "min_weight",
    "min_weight_gradient",
    "penetration_depth",
    "project_onto_cone",
    "push_wrenches",
    "squeeze_forces",
    "support",
    "task_margin",
    "wrench_energy",
]
