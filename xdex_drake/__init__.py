"""Dexterous grasps by optimisation, for any hand and any mesh, on Drake.

Every public name is at hand as `xdex_drake.NAME` and is imported when it is first used: `import xdex_drake` alone loads
neither Drake nor torch.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from xdex_drake.contact.certificate import Residuals, certify, check_certificate
    from xdex_drake.contact.margins import ball_margin, task_margin
    from xdex_drake.contact.wrench import balance
    from xdex_drake.dataset.files import StoredGrasp, load_grasps, save_grasps
    from xdex_drake.dataset.problem_runs import solve_problem
    from xdex_drake.dataset.retarget import retarget
    from xdex_drake.dataset.synthesis import Tally, finish_grasp, synthesize
    from xdex_drake.errors import XdexError
    from xdex_drake.grasp import Certificate, Contact, Grasp, Lift
    from xdex_drake.hand.batched_kinematics import BatchedHand, PaddedHands
    from xdex_drake.hand.checks import check_hand
    from xdex_drake.hand.description import Hand
    from xdex_drake.hand.export import export_urdf
    from xdex_drake.hand.fingertip import replace_tip
    from xdex_drake.hand.generation import generated_hand
    from xdex_drake.hand.human import human_hand, sample_shape
    from xdex_drake.hand.importing.files import hand_from_plant, import_hand
    from xdex_drake.hand.kinematics import Configuration
    from xdex_drake.hand.library import list_hands, load_hand
    from xdex_drake.hand.mirror import mirror
    from xdex_drake.hand.shapes import Capsule
    from xdex_drake.hand.variation import apply_operations, remove_finger, scale_hand
    from xdex_drake.programs.force_closure import force_closure_program, polish_program
    from xdex_drake.programs.link_pose_ik import link_pose_ik, link_pose_ik_program
    from xdex_drake.programs.problems import list_problems, load_problem
    from xdex_drake.programs.program import GraspProgram
    from xdex_drake.programs.retargeting import retargeting_program
    from xdex_drake.programs.solve import ProgramResult, solve
    from xdex_drake.scene.camera import camera_poses, can_see, depth_cloud
    from xdex_drake.scene.object import ObjectModel, load_object
    from xdex_drake.scene.plant import build_plant
    from xdex_drake.scene.procedural import list_objects
    from xdex_drake.scene.tabletop import Scene, make_scene, point_cloud, random_scene, stable_poses
    from xdex_drake.simulation.lift import lift
    from xdex_drake.simulation.pregrasp import straight_approach
    from xdex_drake.simulation.protocol import LIFT, LiftProtocol, find_protocol, with_physics
    from xdex_drake.simulation.robust import RobustLift, robust_lift
    from xdex_drake.visualization.hand_browser import browser_page
    from xdex_drake.visualization.hand_sets import hands_sheet
    from xdex_drake.visualization.import_page import import_page
    from xdex_drake.visualization.pictures import render_grasp
    from xdex_drake.visualization.replay import grasp_page, replay_lift, view_live

    __version__: str

_MODULES = {
    "contact.certificate": ("Residuals", "certify", "check_certificate"),
    "contact.margins": ("ball_margin", "task_margin"),
    "contact.wrench": ("balance",),
    "dataset.files": ("StoredGrasp", "load_grasps", "save_grasps"),
    "dataset.problem_runs": ("solve_problem",),
    "dataset.retarget": ("retarget",),
    "dataset.synthesis": ("Tally", "finish_grasp", "synthesize"),
    "errors": ("XdexError",),
    "grasp": ("Certificate", "Contact", "Grasp", "Lift"),
    "hand.batched_kinematics": ("BatchedHand", "PaddedHands"),
    "hand.checks": ("check_hand",),
    "hand.description": ("Hand",),
    "hand.export": ("export_urdf",),
    "hand.fingertip": ("replace_tip",),
    "hand.generation": ("generated_hand",),
    "hand.human": ("human_hand", "sample_shape"),
    "hand.importing.files": ("hand_from_plant", "import_hand"),
    "hand.kinematics": ("Configuration",),
    "hand.library": ("list_hands", "load_hand"),
    "hand.mirror": ("mirror",),
    "hand.shapes": ("Capsule",),
    "hand.variation": ("apply_operations", "remove_finger", "scale_hand"),
    "programs.force_closure": ("force_closure_program", "polish_program"),
    "programs.link_pose_ik": ("link_pose_ik", "link_pose_ik_program"),
    "programs.problems": ("list_problems", "load_problem"),
    "programs.program": ("GraspProgram",),
    "programs.retargeting": ("retargeting_program",),
    "programs.solve": ("ProgramResult", "solve"),
    "scene.camera": ("camera_poses", "can_see", "depth_cloud"),
    "scene.object": ("ObjectModel", "load_object"),
    "scene.plant": ("build_plant",),
    "scene.procedural": ("list_objects",),
    "scene.tabletop": ("Scene", "make_scene", "point_cloud", "random_scene", "stable_poses"),
    "simulation.lift": ("lift",),
    "simulation.pregrasp": ("straight_approach",),
    "simulation.protocol": ("LIFT", "LiftProtocol", "find_protocol", "with_physics"),
    "simulation.robust": ("RobustLift", "robust_lift"),
    "visualization.hand_browser": ("browser_page",),
    "visualization.hand_sets": ("hands_sheet",),
    "visualization.import_page": ("import_page",),
    "visualization.pictures": ("render_grasp",),
    "visualization.replay": ("grasp_page", "replay_lift", "view_live"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [  # noqa: PLE0604, RUF100 - names that are found when asked for
    "LIFT",
    "BatchedHand",
    "Capsule",
    "Certificate",
    "Configuration",
    "Contact",
    "Grasp",
    "GraspProgram",
    "Hand",
    "Lift",
    "LiftProtocol",
    "ObjectModel",
    "PaddedHands",
    "ProgramResult",
    "Residuals",
    "RobustLift",
    "Scene",
    "StoredGrasp",
    "Tally",
    "XdexError",
    "__version__",
    "apply_operations",
    "balance",
    "ball_margin",
    "browser_page",
    "build_plant",
    "camera_poses",
    "can_see",
    "certify",
    "check_certificate",
    "check_hand",
    "depth_cloud",
    "export_urdf",
    "find_protocol",
    "finish_grasp",
    "force_closure_program",
    "generated_hand",
    "grasp_page",
    "hand_from_plant",
    "hands_sheet",
    "human_hand",
    "import_hand",
    "import_page",
    "lift",
    "link_pose_ik",
    "link_pose_ik_program",
    "list_hands",
    "list_objects",
    "list_problems",
    "load_grasps",
    "load_hand",
    "load_object",
    "load_problem",
    "make_scene",
    "mirror",
    "point_cloud",
    "polish_program",
    "random_scene",
    "remove_finger",
    "render_grasp",
    "replace_tip",
    "replay_lift",
    "retarget",
    "retargeting_program",
    "robust_lift",
    "sample_shape",
    "save_grasps",
    "scale_hand",
    "solve",
    "solve_problem",
    "stable_poses",
    "straight_approach",
    "synthesize",
    "task_margin",
    "view_live",
    "with_physics",
]


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first used (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("xdex_drake")
    elif name in _MODULE_OF:
        value = getattr(importlib.import_module(f"xdex_drake.{_MODULE_OF[name]}"), name)
    else:
        raise AttributeError(f"module 'xdex_drake' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names."""
    return sorted(__all__)
