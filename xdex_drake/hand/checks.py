"""What makes a description a hand that can grasp: checks with reasons, and simple repairs.

The checks are ordered so that nothing which would end Drake's process (limits the wrong way round, an inertia that no
body has) reaches Drake. `check_hand` looks at the description alone; `check_in_drake` builds the plant and lets it
rest.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import QueryObject, SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from scipy.spatial.distance import cdist

from xdex_drake.arrays import Array, skew
from xdex_drake.hand.collision import OVERLAP_MARGIN, ignored_indices
from xdex_drake.hand.description import Hand
from xdex_drake.hand.plant import ShapeOf, add_hand, contact_shape, drake_shape

LINKS = (6, 40)
"""Least and greatest number of links, hubs included."""

ACTUATED = (3, 30)
"""Least and greatest number of actuated joints."""

SIZE = (0.08, 0.30)
"""Least and greatest distance from the wrist to a fingertip of the straight hand [m]."""

LEAST_RANGE = {"revolute": 0.05, "prismatic": 0.002}
"""Least effective range of an actuated joint [rad or m]."""

PINCH = 0.05
"""Opposable tips come this near to each other with their pads face to face [m]."""

FACING = 0.5
"""Least cosine between a pad's normal and the line to the other tip."""

CLOSED = 0.05
"""A finger closes if its tip comes this near to the thumb's or to the palm, in front of the palm [m]."""

DRIFT = 1e-3
"""Greatest joint motion of a hand that is held at rest for a second without gravity [rad or m]."""

FACET_GAP = 5e-4
"""Facets of two round shapes add less than this to each other's reach [m], up to a radius of 13 cm."""

NEAR_REST = 0.15
"""Postures near rest are within this share of each joint's range."""

NEAR_POSTURES = 20
"""Number of postures near rest, in half of which at least no links may overlap; the robot hands manage 12 to 20."""

_POSTURES = 256


# ---- the description alone


def check_hand(hand: Hand) -> tuple[str, ...]:
    """Why a hand is no good, judged without Drake.

    Checked are, in this order, and no further once something is wrong: sizes of the tree; masses and inertias; limits
    and the rest posture; numbers that are not finite; the size of the hand; links that overlap at rest though no joint
    connects them; that the hand can move around its rest without overlaps; that two fingertips oppose each other; that
    each finger closes. The last two are judged by 256 postures drawn uniformly within the limits (always the same).

    Args:
        hand: The hand.

    Returns:
        Reasons, each a word, a colon and what is wrong; empty for a good hand.
    """
    checks = (_tree_reasons, _inertia_reasons, _limit_reasons, _size_reasons, _overlap_reasons, _freedom_reasons)
    for check in (*checks, _grasp_reasons):
        reasons = tuple(check(hand))
        if reasons:
            return reasons
    return ()


def _tree_reasons(hand: Hand) -> Iterator[str]:
    if not LINKS[0] <= len(hand.links) <= LINKS[1]:
        yield f"links: there are {len(hand.links)}, not {LINKS[0]} to {LINKS[1]}"
    if not ACTUATED[0] <= len(hand.joint_names) <= ACTUATED[1]:
        yield f"joints: {len(hand.joint_names)} are actuated, not {ACTUATED[0]} to {ACTUATED[1]}"
    if len(hand.fingers) < 2:
        yield f"fingers: there is {len(hand.fingers)}, and nothing to oppose it"


def _inertia_reasons(hand: Hand) -> Iterator[str]:
    for link in hand.links:
        numbers = np.concatenate([[link.mass], link.p_LLcm, link.I_LLcm.ravel(), link.spheres.ravel()])
        if not np.isfinite(numbers).all():
            yield f"numbers: link {link.name!r} has one that is not finite"
            continue
        moments = np.linalg.eigvalsh(link.I_LLcm)
        if link.mass <= 0.0 or moments[0] <= 0.0 or moments[0] + moments[1] < moments[2] * (1.0 - 1e-9):
            yield f"inertia: no body has the mass and moments of link {link.name!r}"


def _limit_reasons(hand: Hand) -> Iterator[str]:
    for joint in hand.joints:
        numbers = np.concatenate([joint.p_PJ, joint.R_PJ.ravel(), joint.axis, [joint.lower, joint.upper, joint.effort]])
        if not np.isfinite(numbers).all() or joint.effort <= 0.0:
            yield f"numbers: joint {joint.name!r} has one that is not finite, or no effort"
        elif joint.lower >= joint.upper:
            yield f"limits: joint {joint.name!r} has no range"
    kinds = {joint.name: joint.kind for joint in hand.joints}
    for name, low, high, rest in zip(hand.joint_names, *hand.limits, hand.q_rest, strict=True):
        if not high - low >= LEAST_RANGE[kinds[name]]:
            yield f"limits: joint {name!r} and those coupled to it share no range"
        elif not low - 1e-9 <= rest <= high + 1e-9:
            yield f"rest: joint {name!r} rests outside of its limits"


def _size_reasons(hand: Hand) -> Iterator[str]:
    size = hand_size(hand)
    if not SIZE[0] <= size <= SIZE[1]:
        yield f"size: the hand measures {size:.3f} m, not {SIZE[0]} to {SIZE[1]}"


def hand_size(hand: Hand) -> float:
    """Greatest distance from the wrist to a fingertip of the straight hand (all joints at zero or their limit) [m]."""
    poses = _poses(hand, np.clip(np.zeros((1, len(hand.joint_names))), *hand.limits))
    return max(float(np.linalg.norm(poses.tip(hand, k)[0][0])) for k in range(len(hand.fingers)))


def _overlap_reasons(hand: Hand) -> Iterator[str]:
    pairs = _OverlapTest(hand).pairs(_poses(hand, hand.q_rest[None]), 0)
    for i, j in pairs[:3]:
        yield f"overlap: links {hand.links[i].name!r} and {hand.links[j].name!r} at rest"


def _freedom_reasons(hand: Hand) -> Iterator[str]:
    low, high = hand.limits
    around = np.random.default_rng(0).uniform(-NEAR_REST, NEAR_REST, (NEAR_POSTURES, len(low)))
    poses = _poses(hand, np.clip(hand.q_rest + around * (high - low), low, high))
    test, free = _OverlapTest(hand), 0
    for k in range(NEAR_POSTURES):
        free += not test.pairs(poses, k)
        if 2 * free >= NEAR_POSTURES:
            return
    yield f"freedom: links overlap in {NEAR_POSTURES - free} of {NEAR_POSTURES} postures near rest"


def _grasp_reasons(hand: Hand) -> Iterator[str]:
    poses = _poses(hand, _sample(hand, _POSTURES))
    tips = [poses.tip(hand, k) for k in range(len(hand.fingers))]
    first = [0] if hand.fingers[0].name == "thumb" else range(len(hand.fingers))
    pairs = [(a, b) for a in first for b in range(len(hand.fingers)) if a < b]
    if not any(_can_pinch(hand, poses, tips, a, b) for a, b in pairs):
        yield "opposition: no two fingertips come together with their pads face to face"
        return
    palm = hand.links[0].spheres
    palm_H = palm[:, :3] @ hand.R_HB.T + hand.p_HB
    for k, finger in enumerate(hand.fingers):
        p = tips[k][0]
        ahead = p[:, 0] > 0.0
        others = tips[0][0] if k else np.concatenate([tip for tip, _ in tips[1:]])
        gap = np.inf
        if ahead.any():
            gap = float(cdist(p[ahead], others).min())
            if len(palm):
                gap = min(gap, float((cdist(p[ahead], palm_H) - palm[:, 3]).min()))
        if gap > CLOSED:
            yield f"closing: finger {finger.name!r} comes near neither palm nor thumb"


def _can_pinch(hand: Hand, poses: "_Poses", tips: list[tuple[Array, Array]], a: int, b: int) -> bool:
    """Whether two tips can face each other: tried with a posture of one finger and another one of the other."""
    (p_a, n_a), (p_b, n_b) = tips[a], tips[b]
    length = cdist(p_a, p_b)
    good = (length < PINCH) & (p_a[:, None, 0] > 0.0) & (p_b[None, :, 0] > 0.0)
    # n_a . (p_b - p_a) and n_b . (p_a - p_b)
    good &= n_a @ p_b.T - (n_a * p_a).sum(1)[:, None] > FACING * length
    good &= p_a @ n_b.T - (n_b * p_b).sum(1)[None] > FACING * length
    first, second = np.nonzero(good)
    if not len(first):
        return False
    moves = np.abs(hand.coupling_matrix).T @ hand.ancestors > 0.0
    on_a = moves[:, hand.link_index[hand.fingers[a].tip_link]]
    on_b = moves[:, hand.link_index[hand.fingers[b].tip_link]]
    if not (on_a & on_b).any():
        return True
    # Joints that move both fingers: the postures do not combine, so see what becomes of the best of them.
    order = np.argsort(length[first, second], kind="stable")[:50]
    q = np.where(on_b, poses.q[second[order]], poses.q[first[order]])
    both = _poses(hand, q)
    (p_a, n_a), (p_b, n_b) = both.tip(hand, a), both.tip(hand, b)
    d = p_b - p_a
    length = np.linalg.norm(d, axis=1)
    facing = ((n_a * d).sum(1) > FACING * length) & ((n_b * -d).sum(1) > FACING * length)
    return bool((facing & (length < PINCH)).any())


# ---- repair


def repaired_rest(hand: Hand) -> Hand | None:
    """A hand with a rest posture in which no links overlap, as near to its own as can be found.

    Tried are its own posture within the limits, steps from there toward the straight hand, and 200 postures around it.

    Args:
        hand: The hand; its limits must be in order.

    Returns:
        The hand, itself where nothing is wrong with its posture; None where no posture was found.
    """
    low, high = hand.limits
    rest = np.minimum(np.maximum(hand.q_rest, low), high)
    test = _OverlapTest(hand)
    if not test.pairs(_poses(hand, rest[None]), 0):
        return hand if np.array_equal(rest, hand.q_rest) else replace(hand, q_rest=rest)
    straight = np.clip(np.zeros_like(rest), low, high)
    toward = [rest + s * (straight - rest) for s in (0.25, 0.5, 0.75, 1.0)]
    around = np.random.default_rng(0).normal(size=(200, len(rest))) * np.linspace(0.04, 0.4, 200)[:, None]
    q = np.clip(np.round(np.concatenate([toward, rest + around]), 6), low, high)
    poses = _poses(hand, q)
    for k in range(len(q)):
        if not test.pairs(poses, k):
            return replace(hand, q_rest=q[k])
    return None


# ---- many postures


@dataclass(frozen=True)
class _Poses:
    """Links at many postures, in H.

    Attributes:
        q: Postures, shape (M, n).
        R: Rotations, shape (n_links, M, 3, 3).
        p: Origins [m], shape (n_links, M, 3).
    """

    q: Array
    R: Array
    p: Array

    def tip(self, hand: Hand, k: int) -> tuple[Array, Array]:
        """Tip points [m] and pad normals of finger k, shapes (M, 3)."""
        finger = hand.fingers[k]
        link = hand.link_index[finger.tip_link]
        return self.p[link] + self.R[link] @ finger.p_LTip, self.R[link] @ finger.n_LPad


def _sample(hand: Hand, count: int) -> Array:
    low, high = hand.limits
    return low + np.random.default_rng(0).random((count, len(low))) * (high - low)


def _poses(hand: Hand, q: Array) -> _Poses:
    """As `forward_kinematics`, for many postures at once, the wrist at the origin."""
    q_full = hand.q_full(q)
    M = len(q)
    R = np.empty((len(hand.links), M, 3, 3))
    p = np.empty((len(hand.links), M, 3))
    R[0], p[0] = hand.R_HB, hand.p_HB
    for k, joint in enumerate(hand.joints):
        parent = int(hand.parents[k + 1])
        p[k + 1] = p[parent] + R[parent] @ joint.p_PJ
        if joint.kind == "revolute":
            K = skew(joint.axis)
            s, c = np.sin(q_full[:, k]), 1.0 - np.cos(q_full[:, k])
            turn = joint.R_PJ @ (np.eye(3) + s[:, None, None] * K + c[:, None, None] * (K @ K))
            R[k + 1] = R[parent] @ turn
        else:
            R[k + 1] = R[parent] @ joint.R_PJ
            p[k + 1] += q_full[:, k, None] * (R[k + 1] @ joint.axis)
    return _Poses(q, R, p)


class _OverlapTest:
    """Which links of a hand overlap that no joint connects, by their spheres."""

    def __init__(self, hand: Hand) -> None:
        self.hand = hand
        n = len(hand.links)
        apart = ~np.eye(n, dtype=bool)
        for k in range(1, n):
            above = int(hand.parents[k])
            while above > 0 and not hand.links[above].geometry:
                above = int(hand.parents[above])
            apart[k, above] = apart[above, k] = False
        for i, j in ignored_indices(hand):
            apart[i, j] = apart[j, i] = False
        links: NDArray[np.int64] = hand.sphere_links
        self._links, self._centers, self._radii = links, hand.spheres[:, :3], hand.spheres[:, 3]
        self._counted = np.triu(apart[np.ix_(links, links)])
        self._reach = self._radii[:, None] + self._radii[None] + OVERLAP_MARGIN

    def pairs(self, poses: _Poses, k: int) -> list[tuple[int, int]]:
        """Pairs of links that overlap at posture k."""
        p = poses.p[self._links, k] + np.einsum("nab,nb->na", poses.R[self._links, k], self._centers)
        square = (p**2).sum(1)
        gaps = square[:, None] + square[None] - 2.0 * p @ p.T
        i, j = np.nonzero((gaps <= self._reach**2) & self._counted)
        return sorted({(int(a), int(b)) for a, b in zip(self._links[i], self._links[j], strict=True)})


# ---- Drake


def check_in_drake(hand: Hand, *, seconds: float = 1.0, time_step: float = 0.005) -> tuple[str, ...]:
    """Why a hand is no good, judged by building it in Drake and letting it rest.

    The wrist is welded, gravity is off, and PD control (1 N m/rad, 0.1 N m s/rad) holds the rest posture, as in a lift.
    Round shapes get their facets only where some shapes come as near at rest as facets could matter: to build them
    takes ten times as long as all the rest.

    Args:
        hand: The hand; `check_hand` must have passed.
        seconds: Time to simulate [s]; 0 builds only.
        time_step: Length of a discrete step [s].

    Returns:
        Reasons, as in `check_hand`: what Drake says, links in contact at rest, or joints that move more than `DRIFT`.
    """
    try:
        rest = _at_rest(hand, time_step, drake_shape)
        if rest.has_links_within(FACET_GAP):
            rest = _at_rest(hand, time_step, contact_shape)
        drift = rest.drift(seconds) if seconds > 0.0 else 0.0
    except RuntimeError as error:
        return (f"drake: {' '.join(str(error).split())}",)
    if not drift <= DRIFT:
        return (f"drift: a joint moves by {drift:.2g} within {seconds:g} s at rest",)
    return ()


@dataclass(frozen=True)
class _AtRest:
    """A hand held at rest in Drake: its plant and instance there, the scene graph, the diagram and a context of it."""

    plant: MultibodyPlant
    instance: ModelInstanceIndex
    scene_graph: SceneGraph
    diagram: Diagram
    context: Context

    def has_links_within(self, distance: float) -> bool:
        """Whether two shapes that may collide are nearer to each other than a distance [m]."""
        context = self.scene_graph.GetMyContextFromRoot(self.context)
        query = cast(QueryObject, self.scene_graph.get_query_output_port().Eval(context))
        return bool(query.ComputeSignedDistancePairwiseClosestPoints(distance))

    def drift(self, seconds: float) -> float:
        """Greatest motion of a joint within some time [rad or m]."""
        context = self.plant.GetMyContextFromRoot(self.context)
        start = self.plant.GetPositions(context, self.instance).copy()
        simulator = Simulator(self.diagram, self.context)
        simulator.Initialize()
        simulator.AdvanceTo(seconds)
        return float(np.abs(self.plant.GetPositions(context, self.instance) - start).max())


def _at_rest(hand: Hand, time_step: float, shape_of: ShapeOf) -> _AtRest:
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    instance = add_hand(plant, hand, pd_gains=(1.0, 0.1), point_stiffness=1e5, shape_of=shape_of)
    base = plant.GetBodyByName(hand.links[0].name, instance).body_frame()
    plant.WeldFrames(plant.world_frame(), base, RigidTransform(RotationMatrix(hand.R_HB), hand.p_HB))
    plant.set_gravity_enabled(instance, False)
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    desired = np.concatenate([hand.q_rest, np.zeros_like(hand.q_rest)])
    plant.get_desired_state_input_port(instance).FixValue(plant.GetMyContextFromRoot(context), desired)
    return _AtRest(plant, instance, scene_graph, diagram, context)
