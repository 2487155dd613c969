"""Constraints of the grasp programs; each lives beside the energy term that wishes the same."""

from xdex_drake.programs.block import MM, TOLERANCES, Block
from xdex_drake.programs.terms.approach import approach_block
from xdex_drake.programs.terms.contact import contact_block
from xdex_drake.programs.terms.force_closure import cone_block, normal_force_block, wrench_block
from xdex_drake.programs.terms.joint_limits import limit_block
from xdex_drake.programs.terms.pads import pad_block
from xdex_drake.programs.terms.penetration import object_block, table_block
from xdex_drake.programs.terms.region import region_block
from xdex_drake.programs.terms.self_collision import self_block
from xdex_drake.programs.terms.surroundings import obstacle_blocks

__all__ = [
    "MM",
    "TOLERANCES",
    "Block",
    "approach_block",
    "cone_block",
    "contact_block",
    "limit_block",
    "normal_force_block",
    "object_block",
    "obstacle_blocks",
    "pad_block",
    "region_block",
    "self_block",
    "table_block",
    "wrench_block",
]
