"""What a batch of candidates descends: hand, object and table as tensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from xdex_drake.hand.batched_kinematics import BatchedHand, FixedPoints
from xdex_drake.hand.description import Hand
from xdex_drake.programs.grasp_types import approach_axis, contact_slots, finger_tips
from xdex_drake.programs.search.settings import SearchSettings, check_approach
from xdex_drake.programs.spheres import PAIR_SPACING, search_spheres, sphere_pairs
from xdex_drake.programs.term import Term
from xdex_drake.programs.terms.region import InRegion
from xdex_drake.programs.terms.surroundings import Surroundings
from xdex_drake.scene.grid_torch import TorchGrid
from xdex_drake.scene.tabletop import Scene


@dataclass(frozen=True)
class SearchProblem:
    """What a batch of candidates descends: hand, object and table as tensors.

    Attributes:
        batched: The hand.
        grid: The object's distances.
        R_WO: Rotation of the object, shape (3, 3).
        p_WO: Origin of the object [m], shape (3,).
        p_WOcm: Center of mass [m], shape (3,).
        floor: Height of the table's top, minus infinity where there is none [m].
        length: Length that divides torques [m].
        friction: Coefficient of friction.
        spheres: The spheres that the search keeps apart from object and table.
        radii: Their radii [m], shape (n_spheres,).
        tip_spheres: Indices of each slot's spheres (`contact_slots`), padded by repetition, shape (n_slots, k).
        tip_links: Index of each slot's link, shape (n_slots,).
        pads: Pad normal of each slot in its link, shape (n_slots, 3).
        pairs: Differences between the centers of spheres that must not overlap.
        reach: Sum of the two radii of each pair [m], shape (n_pairs,).
        approach: Axis of the hand along which the palm approaches, in H, shape (3,).
        tip_points: Tips of the fingers.
        terms: Weights and terms of the energy.
        settings: Settings.
    """

    batched: BatchedHand
    grid: TorchGrid
    R_WO: torch.Tensor
    p_WO: torch.Tensor
    p_WOcm: torch.Tensor
    floor: float
    length: float
    friction: float
    spheres: FixedPoints
    radii: torch.Tensor
    tip_spheres: torch.Tensor
    tip_links: torch.Tensor
    pads: torch.Tensor
    pairs: FixedPoints
    reach: torch.Tensor
    approach: torch.Tensor
    tip_points: FixedPoints
    terms: tuple[tuple[float, Term], ...]
    settings: SearchSettings


def search_problem(
    hand: Hand,
    scene: Scene,
    settings: SearchSettings | None = None,
    *,
    dtype: torch.dtype = torch.float32,
    device: str = "cpu",
) -> SearchProblem:
    """Puts hand and scene into tensors.

    Args:
        hand: The hand.
        scene: The scene.
        settings: Settings; the defaults where None.
        dtype: Floating-point type.
        device: Torch device.

    Returns:
        The problem.

    Raises:
        ConfigError: Two terms of the settings have one name, or the approach comes from below the table.
    """

    def tensor(values: object) -> torch.Tensor:
        return torch.tensor(np.asarray(values, dtype=float), dtype=dtype, device=device)

    settings = settings or SearchSettings()
    if scene.table is not None:
        check_approach(settings.approach)
    slots = contact_slots(hand)
    slots = slots if settings.grasp_type == "power" else slots[:-1]
    chosen = search_spheres(hand, palm=settings.grasp_type == "power")
    rows = [np.searchsorted(chosen, slot.spheres) for slot in slots]
    width = max(len(r) for r in rows)
    padded = np.array([np.resize(r, width) for r in rows])
    a, b = sphere_pairs(hand, spacing=PAIR_SPACING, base=False).T
    batched = BatchedHand(hand, dtype=dtype, device=device)
    return SearchProblem(
        batched=batched,
        grid=TorchGrid(scene.object.grid, dtype=dtype, device=device),
        R_WO=tensor(scene.X_WO.rotation().matrix()),
        p_WO=tensor(scene.X_WO.translation()),
        p_WOcm=tensor(scene.X_WO @ scene.object.p_OOcm),
        floor=scene.floor,
        length=scene.object.length,
        friction=scene.object.friction,
        spheres=batched.spheres.subset(torch.as_tensor(chosen, device=device)),
        radii=tensor(hand.spheres[chosen, 3]),
        tip_spheres=torch.as_tensor(padded, device=device),
        tip_links=torch.as_tensor(np.array([slot.link for slot in slots]), device=device),
        pads=tensor([slot.n_LPad for slot in slots]),
        pairs=batched.spheres.subset(torch.as_tensor(a, device=device)).minus(
            batched.spheres.subset(torch.as_tensor(b, device=device))
        ),
        reach=tensor(hand.spheres[a, 3] + hand.spheres[b, 3]),
        approach=tensor(approach_axis(hand)[1]),
        tip_points=batched.fixed_points(*finger_tips(hand)),
        terms=(*settings.energy(), *((term.weight, term) for term in _of_scene(scene, settings))),
        settings=settings,
    )


def _of_scene(scene: Scene, settings: SearchSettings) -> tuple[Term, ...]:
    """Terms that hold a scene: its obstacles, and the region of its object that was asked for."""
    region = () if settings.region is None else (InRegion(settings.region, scene),)
    return (*Surroundings.of(scene), *region)
