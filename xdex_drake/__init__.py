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
    from xdex_drake.hand.description import Hand
    from xdex_drake.hand.kinematics import Configuration
    from xdex_drake.hand.library import list_hands, load_hand
    from xdex_drake.programs.force_closure import force_closure_program, polish_program
    from xdex_drake.programs.link_pose_ik import link_pose_ik, link_pose_ik_program
    from xdex_drake.programs.problems import list_problems, load_problem
    from xdex_drake.programs.program import GraspProgram
    from xdex_drake.programs.retargeting import retargeting_program
    from xdex_drake.programs.solve import ProgramResult, solve
    from xdex_drake.scene.object import ObjectModel, load_object
    from xdex_drake.scene.plant import build_plant
    from xdex_drake.scene.procedural import list_objects
    from xdex_drake.scene.tabletop import Scene, make_scene, point_cloud
    from xdex_drake.simulation.lift import lift
    from xdex_drake.simulation.protocol import LIFT, LiftProtocol
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
    "hand.description": ("Hand",),
    "hand.kinematics": ("Configuration",),
    "hand.library": ("list_hands", "load_hand"),
    "programs.force_closure": ("force_closure_program", "polish_program"),
    "programs.link_pose_ik": ("link_pose_ik", "link_pose_ik_program"),
    "programs.problems": ("list_problems", "load_problem"),
    "programs.program": ("GraspProgram",),
    "programs.retargeting": ("retargeting_program",),
    "programs.solve": ("ProgramResult", "solve"),
    "scene.object": ("ObjectModel", "load_object"),
    "scene.plant": ("build_plant",),
    "scene.procedural": ("list_objects",),
    "scene.tabletop": ("Scene", "make_scene", "point_cloud"),
    "simulation.lift": ("lift",),
    "simulation.protocol": ("LIFT", "LiftProtocol"),
    "visualization.pictures": ("render_grasp",),
    "visualization.replay": ("grasp_page", "replay_lift", "view_live"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [  # noqa: PLE0604, RUF100 - names that are found when asked for
    "LIFT",
    "Certificate",
    "Configuration",
    "Contact",
    "Grasp",
    "GraspProgram",
    "Hand",
    "Lift",
    "LiftProtocol",
    "ObjectModel",
    "ProgramResult",
    "Residuals",
    "Scene",
    "StoredGrasp",
    "Tally",
    "XdexError",
    "__version__",
    "balance",
    "ball_margin",
    "build_plant",
    "certify",
    "check_certificate",
    "finish_grasp",
    "force_closure_program",
    "grasp_page",
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
    "point_cloud",
    "polish_program",
    "render_grasp",
    "replay_lift",
    "retarget",
    "retargeting_program",
    "save_grasps",
    "solve",
    "solve_problem",
    "synthesize",
    "task_margin",
    "view_live",
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
