"""The force-closure program of Eq. (1) under hard constraints: it polishes one candidate of the batched search."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.programs import constraints
from xdex_drake.programs.costs import Cost, LeastSquares
from xdex_drake.programs.grasp_types import GraspType, contact_slots
from xdex_drake.programs.point import ContactSet, Point
from xdex_drake.programs.program import GraspProgram
from xdex_drake.programs.search import Candidates, SearchSettings, search
from xdex_drake.programs.spheres import sphere_pairs
from xdex_drake.programs.terms.spread import spread_cost
from xdex_drake.scene.tabletop import Scene


@dataclass(frozen=True)
class PolishSettings:
    """Numbers of the hard constraints.

    Attributes:
        clearance: Gap that spheres without contact keep from the object [m].
        table_clearance: Gap that all spheres keep from the table [m].
        self_clearance: Gap between spheres of links that must stay apart [m].
        friction_fraction: Fraction of the friction that the forces may use.
        least_force: Least normal force of a contact, in units of the object's weight.
        most_force: Greatest normal force of a contact, in units of the object's weight.
        pad_cosine: Least cosine between contact and pad normals.
        posture: Weight of staying near the start.
        effort: Weight of small contact forces.
    """

    clearance: float = 5e-4
    table_clearance: float = 2e-3
    self_clearance: float = 1e-3
    friction_fraction: float = 0.75
    least_force: float = 0.4
    most_force: float = 6.0
    pad_cosine: float = 0.1
    posture: float = 0.1
    effort: float = 0.05


def contact_set(hand: Hand, scene: Scene, k: Configuration, fingers: NDArray[np.bool_]) -> ContactSet:
    """For each slot that shall touch, the sphere of its link that is nearest to the object.

    Args:
        hand: The hand.
        scene: The scene.
        k: The configuration.
        fingers: Which fingers shall touch, in the order of `hand.fingers`, and where there is one more, the palm.

    Returns:
        The contact set.
    """
    slots, chosen = contact_slots(hand), np.flatnonzero(fingers)
    candidates = [slots[f].spheres for f in chosen]
    rows = np.concatenate([np.zeros(0, dtype=np.int64), *candidates])
    centers = k.points(hand.sphere_links[rows], hand.spheres[rows, :3])
    gaps = scene.object.exact.query(_to_object(scene, centers)).distance - hand.spheres[rows, 3]
    parts = np.split(gaps, np.cumsum([len(some) for some in candidates])[:-1])
    spheres = [some[int(np.argmin(part))] for some, part in zip(candidates, parts, strict=True)]
    links = [slots[f].link for f in chosen]
    return ContactSet(np.array(spheres, dtype=np.int64), np.array(links, dtype=np.int64), chosen)


def _to_object(scene: Scene, p_WPs: Array) -> Array:
    return (p_WPs - scene.X_WO.translation()) @ scene.X_WO.rotation().matrix()


def near_self_pairs(hand: Hand, k: Configuration, reach: float = 0.03) -> NDArray[np.int64]:
    """Pairs of spheres of different links that are near enough to matter during a polish.

    Args:
        hand: The hand.
        k: The configuration.
        reach: Greatest gap of a pair that is kept [m].

    Returns:
        Indices among `hand.spheres`, shape (m, 2).
    """
    pairs = sphere_pairs(hand)
    centers = k.points(hand.sphere_links, hand.spheres[:, :3])
    a, b = pairs[:, 0], pairs[:, 1]
    between = centers[a] - centers[b]
    gap = np.sqrt(np.einsum("ka,ka->k", between, between)) - hand.spheres[a, 3] - hand.spheres[b, 3]
    return pairs[gap < reach]


def _short(gaps: Array, least: float | Array) -> float:
    """By how much the smallest gap falls short [mm]."""
    return constraints.MM * float(np.max(least - gaps, initial=0.0))


def _depth_in_object(point: Point, clearance: float) -> float:
    """By how much spheres that are no contacts come too near to the object [mm]."""
    near, gaps, _ = point.object_distances
    rows = ~np.isin(near, point.contacts.spheres)
    touching = np.isin(point.k.hand.sphere_links[near[rows]], point.contacts.links)
    return _short(gaps[rows], np.where(touching, 0.0, clearance))


def _self_gaps(point: Point) -> Array:
    """Gaps of all pairs of spheres of links that must stay apart [m]."""
    pairs, radii = sphere_pairs(point.k.hand), point.k.hand.spheres[:, 3]
    between = point.centers_W[pairs[:, 0]] - point.centers_W[pairs[:, 1]]
    return np.sqrt(np.einsum("ka,ka->k", between, between)) - radii[pairs[:, 0]] - radii[pairs[:, 1]]


def feasibility_blocks(start: Point, settings: PolishSettings) -> tuple[constraints.Block, ...]:
    """The constraints that every grasp program shares: contact, clearances, joint limits, pads.

    Args:
        start: Initial guess with its contact set.
        settings: Numbers.

    Returns:
        The blocks.
    """
    hand, contacts = start.k.hand, start.contacts
    near, gaps, _ = start.object_distances
    others = np.setdiff1d(near[gaps < 0.03], contacts.spheres)
    # The rest of a touching link may come as near as its contact does.
    touching = np.isin(hand.sphere_links[others], contacts.links)
    low = np.flatnonzero(start.heights < 0.04)
    slots = contact_slots(hand)
    pads = np.array([slots[f].n_LPad for f in contacts.fingers])
    return (
        constraints.contact_block(len(contacts.spheres)),
        replace(
            constraints.object_block(others, np.where(touching, 0.0, settings.clearance)),
            whole=lambda point: _depth_in_object(point, settings.clearance),
        ),
        replace(
            constraints.table_block(low, settings.table_clearance),
            whole=lambda point: _short(point.heights, settings.table_clearance),
        ),
        *constraints.obstacle_blocks(start, settings.clearance),
        replace(
            constraints.self_block(near_self_pairs(hand, start.k), settings.self_clearance),
            whole=lambda point: _short(_self_gaps(point), settings.self_clearance),
        ),
        constraints.limit_block(hand.limits),
        constraints.pad_block(pads, settings.pad_cosine),
    )


def wrench_blocks(start: Point, settings: PolishSettings) -> tuple[constraints.Block, ...]:
    """The constraints that make contact forces hold the object with a margin.

    Args:
        start: Initial guess with its contact set.
        settings: Numbers.

    Returns:
        The blocks.
    """
    scene, nc = start.scene, len(start.contacts.spheres)
    return (
        constraints.wrench_block(scene.X_WO @ scene.object.p_OOcm, scene.object.length),
        constraints.cone_block(nc, settings.friction_fraction * scene.object.friction),
        constraints.normal_force_block(nc, settings.least_force, settings.most_force),
    )


def posture_cost(
    start: Point, weight: float, *, rotation: float = 0.1, translation: float = 0.01, joint: float = 0.2
) -> LeastSquares:
    """Stays near the start: 1/2 w (|turn|^2 / rotation^2 + |p - p0|^2 / translation^2 + |q - q0|^2 / joint^2).

    Args:
        start: The start.
        weight: Weight.
        rotation: Turn of the wrist that costs half the weight [rad].
        translation: Displacement of the wrist that costs the same [m].
        joint: Change of a joint that costs the same [rad].

    Returns:
        The cost.
    """
    n = len(start.k.q)
    scale = np.concatenate([np.full(3, 1.0 / rotation), np.full(3, 1.0 / translation), np.full(n, 1.0 / joint)])
    R0, p0, q0 = start.k.X_WH.rotation().matrix(), start.k.X_WH.translation(), start.k.q
    template = np.zeros((6 + n, start.size))
    template[:, : 6 + n] = np.diag(scale)

    def evaluate(point: Point) -> tuple[Array, Array]:
        turn = point.k.X_WH.rotation().matrix() @ R0.T
        # Twice the sine of small angles; exact at the start, where it matters.
        w = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        r = scale * np.concatenate([w, point.k.X_WH.translation() - p0, point.k.q - q0])
        J = template.copy()
        J[:3, :3] = scale[0] * 0.5 * (np.trace(turn) * np.eye(3) - turn)
        return r, J

    return LeastSquares("posture", weight, evaluate, "distance from the start")


def effort_cost(weight: float) -> LeastSquares:
    """Small contact forces: 1/2 w |f|^2 in units of the object's weight."""

    def evaluate(point: Point) -> tuple[Array, Array]:
        J = np.zeros((point.forces.size, point.size))
        J[:, point.size - point.forces.size :] = np.eye(point.forces.size)
        return point.forces.ravel(), J

    return LeastSquares("effort", weight, evaluate, "squared contact forces")


def polish_program(
    hand: Hand,
    scene: Scene,
    X_WH: RigidTransform,
    q: Array,
    fingers: NDArray[np.bool_],
    *,
    settings: PolishSettings | None = None,
    extra_costs: tuple[Cost, ...] = (),
    extra_constraints: tuple[constraints.Block, ...] = (),
    name: str = "force closure",
) -> GraspProgram:
    """The force-closure program from a given start.

    Args:
        hand: The hand.
        scene: The scene.
        X_WH: Wrist pose of the start.
        q: Joint values of the start, shape (n,).
        fingers: Which fingers shall touch, in the order of `hand.fingers`, and where there is one more, the palm.
        settings: Numbers; the defaults where None.
        extra_costs: Costs beside posture and effort.
        extra_constraints: Constraints beside those of every force-closure program.
        name: Name of the program.

    Returns:
        The program.
    """
    settings = settings or PolishSettings()
    k = Configuration.at(hand, X_WH, q)
    contacts = contact_set(hand, scene, k, fingers)
    start = Point(k, scene, contacts, np.zeros((len(contacts.spheres), 3)))
    start = Point(k, scene, contacts, start.normals_W * settings.least_force)
    costs = (posture_cost(start, settings.posture), effort_cost(settings.effort), *extra_costs)
    blocks = (*feasibility_blocks(start, settings), *wrench_blocks(start, settings), *extra_constraints)
    return GraspProgram(name, start, costs, blocks)


def force_closure_program(
    hand: Hand,
    scene: Scene,
    *,
    contacts: int = 4,
    grasp_type: GraspType = "any",
    approach: tuple[float, float, float] | None = None,
    seed: int = 0,
    starts: int = 16,
    search_settings: SearchSettings | None = None,
    settings: PolishSettings | None = None,
) -> GraspProgram:
    """The force-closure program from the best of a small batched search.

    Args:
        hand: The hand.
        scene: The scene.
        contacts: Greatest number of fingers that touch.
        grasp_type: Type of grasp.
        approach: Direction that the palm comes along, in W, within the cone of the search's settings; any where None.
        seed: Seed of the search.
        starts: Number of candidates of the search.
        search_settings: Settings of the search; the defaults where None.
        settings: Numbers of the hard constraints; the defaults where None.

    Returns:
        The program, open to more costs and constraints.
    """
    chosen = replace(search_settings or SearchSettings(), contacts=contacts, grasp_type=grasp_type, approach=approach)
    found = search(hand, scene, count=starts, seed=seed, settings=chosen)
    return program_of_candidate(hand, scene, found, 0, settings=settings, asked=chosen)


def wishes(settings: SearchSettings) -> tuple[Cost, ...]:
    """Costs of a polish whose search was asked for more than a grasp: spread, as far as it goes."""
    return (spread_cost(settings.spread),) if settings.spread > 0.0 else ()


def conditions(settings: SearchSettings, count: int) -> tuple[constraints.Block, ...]:
    """Constraints of a polish whose search was asked for more than a grasp: palm's direction and region are kept.

    Args:
        settings: Settings of the search.
        count: Number of contacts.

    Returns:
        The blocks.
    """
    blocks = []
    if settings.approach is not None:
        blocks.append(constraints.approach_block(settings.approach, least=settings.approach_cosine))
    if settings.region is not None:
        blocks.append(constraints.region_block(settings.region, count))
    return tuple(blocks)


def program_of_candidate(
    hand: Hand,
    scene: Scene,
    found: Candidates,
    row: int,
    *,
    settings: PolishSettings | None = None,
    asked: SearchSettings | None = None,
) -> GraspProgram:
    """The force-closure program that polishes one candidate of a search.

    Args:
        hand: The hand.
        scene: The scene.
        found: Candidates.
        row: Which one.
        settings: Numbers; the defaults where None.
        asked: Settings of the search, whose `wishes` and `conditions` the program takes over; none where None.

    Returns:
        The program.
    """
    X_WH = RigidTransform(RotationMatrix.ProjectToRotationMatrix(found.R_WHs[row]), found.p_WHs[row])
    asked = asked or SearchSettings()
    return polish_program(
        hand,
        scene,
        X_WH,
        found.qs[row],
        found.fingers[row],
        settings=settings,
        extra_costs=wishes(asked),
        extra_constraints=conditions(asked, int(found.fingers[row].sum())),
    )
