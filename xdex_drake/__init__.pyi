"""The public names of the library, in one list: what `xdex_drake.NAME` finds, type checkers and editors read here."""

from .contact.certificate import Residuals as Residuals
from .contact.certificate import certify as certify
from .contact.certificate import check_certificate as check_certificate
from .contact.grasp_map import Effort as Effort
from .contact.grasp_map import GraspMap as GraspMap
from .contact.held_object import HeldObject as HeldObject
from .contact.margins import ball_margin as ball_margin
from .contact.margins import task_margin as task_margin
from .contact.wrench import balance as balance
from .dataset.files import StoredGrasp as StoredGrasp
from .dataset.files import load_grasps as load_grasps
from .dataset.files import save_grasps as save_grasps
from .errors import XdexError as XdexError
from .grasp import Certificate as Certificate
from .grasp import Contact as Contact
from .grasp import Grasp as Grasp
from .grasp import Lift as Lift
from .grasping.approach import straight_approach as straight_approach
from .grasping.execution import execution_package as execution_package
from .grasping.finish import finish_grasp as finish_grasp
from .grasping.retarget import retarget as retarget
from .grasping.synthesis import synthesize as synthesize
from .grasping.tally import Tally as Tally
from .hand.batched_kinematics import BatchedHand as BatchedHand
from .hand.batched_kinematics import PaddedHands as PaddedHands
from .hand.checks import check_hand as check_hand
from .hand.description import Capsule as Capsule
from .hand.description import Hand as Hand
from .hand.fingertip import replace_tip as replace_tip
from .hand.generation import generated_hand as generated_hand
from .hand.human import human_hand as human_hand
from .hand.human import sample_shape as sample_shape
from .hand.importing.files import hand_from_plant as hand_from_plant
from .hand.importing.files import import_hand as import_hand
from .hand.kinematics import Configuration as Configuration
from .hand.library import list_hands as list_hands
from .hand.library import load_hand as load_hand
from .hand.mirror import mirror as mirror
from .hand.plant import add_hand as add_hand
from .hand.variation import (
    apply_operations as apply_operations,
)
from .hand.variation import (
    remove_finger as remove_finger,
)
from .hand.variation import (
    scale_hand as scale_hand,
)
from .interchange.mjcf import export_mjcf as export_mjcf
from .interchange.urdf import export_urdf as export_urdf
from .problems.files import list_problems as list_problems
from .problems.files import load_problem as load_problem
from .problems.solve import solve_problem as solve_problem
from .programs.force_closure import force_closure_program as force_closure_program
from .programs.force_closure import polish_program as polish_program
from .programs.link_pose_ik import link_pose_ik as link_pose_ik
from .programs.link_pose_ik import link_pose_ik_program as link_pose_ik_program
from .programs.program import GraspProgram as GraspProgram
from .programs.retargeting import retargeting_program as retargeting_program
from .programs.solve import ProgramResult as ProgramResult
from .programs.solve import solve as solve
from .retargeting.clip import reach_grasp_lift as reach_grasp_lift
from .retargeting.hand_retargeter import Following as Following
from .retargeting.hand_retargeter import HandRetargeter as HandRetargeter
from .retargeting.keypoints import read_points as read_points
from .retargeting.object_stream import Guarded as Guarded
from .retargeting.object_stream import ObjectStream as ObjectStream
from .retargeting.object_stream import follow_beside as follow_beside
from .scene.bodies import add_object as add_object
from .scene.bodies import add_table as add_table
from .scene.camera import camera_poses as camera_poses
from .scene.camera import can_see as can_see
from .scene.camera import depth_cloud as depth_cloud
from .scene.fixtures import Fixture as Fixture
from .scene.object import ObjectModel as ObjectModel
from .scene.object import load_object as load_object
from .scene.plant import add_carriage as add_carriage
from .scene.plant import build_plant as build_plant
from .scene.procedural import list_objects as list_objects
from .scene.region import Region as Region
from .scene.tabletop import (
    Scene as Scene,
)
from .scene.tabletop import (
    make_scene as make_scene,
)
from .scene.tabletop import (
    point_cloud as point_cloud,
)
from .scene.tabletop import (
    random_scene as random_scene,
)
from .scene.tabletop import (
    stable_poses as stable_poses,
)
from .simulation.drake import lift as lift
from .simulation.own_diagram import GraspPlayer as GraspPlayer
from .simulation.own_diagram import apply_grasp as apply_grasp
from .simulation.protocol import (
    LIFT as LIFT,
)
from .simulation.protocol import (
    LiftProtocol as LiftProtocol,
)
from .simulation.protocol import (
    find_protocol as find_protocol,
)
from .simulation.protocol import (
    with_physics as with_physics,
)
from .simulation.robust import RobustLift as RobustLift
from .simulation.robust import robust_lift as robust_lift
from .simulation.scenes import export_scenes as export_scenes
from .visualization.dress import dress as dress
from .visualization.film import film_lift as film_lift
from .visualization.hand_browser import browser_page as browser_page
from .visualization.hand_sets import hands_sheet as hands_sheet
from .visualization.import_page import import_page as import_page
from .visualization.motion import motion_page as motion_page
from .visualization.pictures import render_grasp as render_grasp
from .visualization.replay import films_page as films_page
from .visualization.replay import grasp_page as grasp_page
from .visualization.replay import replay_lift as replay_lift
from .visualization.replay import view_live as view_live

__version__: str
