"""Why a hand cannot hold an object at all: necessary conditions that need no search.

Every check is a proof up to the density of its samples, in the favour of the hand: there may be any number of contacts,
any fingertip may touch wherever a ball of the smallest fingertip's radius has room, and fingers open as far as their
joints allow whether or not their pads then face each other. What passes here may still have no grasp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial import KDTree

from xdex_drake.arrays import Array, cross
from xdex_drake.contact.cones import cone_edges, contact_frames
from xdex_drake.hand.batched_kinematics import BatchedHand
from xdex_drake.hand.description import Hand
from xdex_drake.programs.force_closure import PolishSettings
from xdex_drake.programs.grasp_types import GraspType, Slot, contact_slots
from xdex_drake.scene.distance import sample_surface
from xdex_drake.scene.tabletop import Scene

SAMPLES = 1200
"""Places at which a fingertip might touch the object."""

EDGES = 6
"""Edges of the pyramids around friction cones."""

UNBALANCED = 0.03
"""What samples may leave unbalanced of gravity, in units of the weight."""

THICK = 1.25
"""Thickness of an object, in openings of the hand, from which on it is not even looked at."""

MM = 1e3


@dataclass(frozen=True)
class Obstacle:
    """Something that keeps a hand from holding an object.

    Attributes:
        name: "opening", "table" or "friction".
        constraints: Names of constraints of the grasp programs that cannot be met together.
        message: One sentence with its numbers, for people.
    """

    name: str
    constraints: tuple[str, ...]
    message: str


@dataclass(frozen=True)
class _Places:
    """Balls of a fingertip's radius that touch the object: centers in W [m] and unit normals into it, shape (m, 3)."""

    centers: Array
    normals: Array
    spacing: float

    def where(self, keep: NDArray[np.bool_]) -> _Places:
        return _Places(self.centers[keep], self.normals[keep], self.spacing)


def largest_opening(hand: Hand, slots: tuple[Slot, ...], *, radius: float, seed: int = 0) -> float:
    """How far apart two contact slots of a hand come, whatever the directions of their pads.

    Random postures, the best of which are then varied in ever smaller steps.

    Args:
        hand: The hand.
        slots: Parts of the hand that can touch.
        radius: Radius of the balls whose distance is meant; a larger fingertip counts its greater radius as reach [m].
        seed: Seed of the postures.

    Returns:
        Greatest distance of the centers [m].
    """
    if len(slots) < 2:
        return 0.0
    rng, batched = np.random.default_rng(seed), BatchedHand(hand)
    pairs = [(a, b) for a in range(len(slots)) for b in range(a + 1, len(slots))]
    rows = np.concatenate([slot.spheres for slot in slots])
    owner = np.repeat(np.arange(len(slots)), [len(slot.spheres) for slot in slots])
    map_ = batched.fixed_points(hand.sphere_links[rows], hand.spheres[rows, :3])
    extra = torch.as_tensor(hand.spheres[rows, 3] - radius, dtype=batched.dtype)
    low, high = hand.limits
    best = 0.0
    for a, b in pairs:
        in_a, in_b = np.flatnonzero(owner == a), np.flatnonzero(owner == b)
        center, spread = None, 0.0
        for spread in (np.inf, 0.3, 0.1, 0.03):
            if center is None:
                qs = rng.uniform(low, high, size=(512, len(low)))
            else:
                qs = np.clip(center + spread * (high - low) * rng.normal(size=(128, len(low))), low, high)
                qs[0] = center
            with torch.no_grad():
                q = torch.as_tensor(qs, dtype=batched.dtype)
                eye = torch.eye(3).expand(len(qs), 3, 3)
                p = map_.positions(batched.forward(eye, torch.zeros(len(qs), 3), q)).transpose(1, 2)
                far = torch.cdist(p[:, in_a], p[:, in_b]) + extra[in_a][:, None] + extra[in_b]
                reach = far.flatten(1).max(dim=1).values.numpy()
            center = qs[int(reach.argmax())]
            best = max(best, float(reach.max()))
    return best


def _places(scene: Scene, radius: float, seed: int = 0) -> _Places:
    """Balls of a radius that touch the object from outside, spread over its surface, edges and corners included."""
    obj = scene.object
    points, outward = obj.surface_samples(SAMPLES // 2, seed)
    rng = np.random.default_rng(seed)
    low, high = obj.exact.lower - radius, obj.exact.upper + radius
    centers = np.concatenate([points + radius * outward, rng.uniform(low, high, size=(SAMPLES // 2, 3))])
    for _ in range(6):
        found = obj.exact.query(centers)
        centers = centers - (found.distance - radius)[:, None] * found.gradient
    found = obj.exact.query(centers)
    touching = np.abs(found.distance - radius) < 2e-4
    R_WO, p_WO = scene.X_WO.rotation().matrix(), scene.X_WO.translation()
    centers = centers[touching] @ R_WO.T + p_WO
    spacing = float(np.median(KDTree(centers).query(centers, k=2)[0][:, 1])) if len(centers) > 1 else 0.0
    return _Places(centers, -found.gradient[touching] @ R_WO.T, spacing)


def _wrenches(places: _Places, scene: Scene, radius: float, mu: float) -> Array:
    """Wrenches of the edges of pyramids around the friction cones, torque over length first, shape (m, EDGES, 6)."""
    edges = cone_edges(mu / np.cos(np.pi / EDGES), EDGES)  # (1, 3, EDGES)
    forces = np.swapaxes(contact_frames(places.normals) @ edges, 1, 2)
    arms = places.centers + radius * places.normals - scene.X_WO @ scene.object.p_OOcm
    return np.concatenate([cross(arms[:, None], forces) / scene.object.length, forces], axis=2)


def _holds(wrenches: Array) -> bool:
    """Whether some nonnegative combination of wrenches balances gravity."""
    if len(wrenches) == 0:
        return False
    return nnls(wrenches.reshape(-1, 6).T, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))[1] < UNBALANCED


def _within(places: _Places, wrenches: Array, reach: float) -> bool:
    """Whether wrenches of places that are no further than `reach` from each other may hold the object.

    Such places lie in a ball of radius sqrt(3/8) reach (Jung 1901), whose center is tried at every point of a grid.
    """
    spacing = reach / 8.0
    radius = np.sqrt(3.0 / 8.0) * reach + 0.5 * np.sqrt(3.0) * spacing
    low, high = places.centers.min(axis=0), places.centers.max(axis=0)
    axes = [np.arange(a, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = KDTree(places.centers).query_ball_point(grid, radius)
    return any(len(rows) > 1 and _holds(wrenches[rows]) for rows in inside)


def find_obstacles(
    hand: Hand,
    scene: Scene,
    *,
    contacts: int = 4,
    grasp_type: GraspType = "any",
    settings: PolishSettings | None = None,
) -> tuple[Obstacle, ...]:
    """What keeps a hand from holding an object, whatever the search: friction, the table, or the hand's opening.

    Gravity must be balanced by forces within friction cones, at places where a fingertip touches the object without
    touching the table, all of them within the hand's opening of the thumb's. Takes less than a second or two.

    Args:
        hand: The hand.
        scene: The scene.
        contacts: Greatest number of fingers that touch.
        grasp_type: Type of grasp.
        settings: Numbers of the hard constraints; the defaults where None.

    Returns:
        The obstacles, the first that is proven; none where these checks find nothing.
    """
    settings, obj = settings or PolishSettings(), scene.object
    slots = contact_slots(hand)
    fingers = slots if grasp_type == "power" else slots[:-1]
    count = {"pinch": 2, "tripod": 3}.get(grasp_type, min(contacts, len(slots) - 1)) + (grasp_type == "power")
    radius = float(min(hand.spheres[slot.spheres, 3].min() for slot in fingers if len(slot.spheres)))
    mu = settings.friction_fraction * obj.friction
    everywhere = _places(scene, radius)
    # What solvers may violate is in favour of the hand, too: two tenths of a millimetre.
    floor = radius + settings.table_clearance - 2e-4
    places = everywhere.where(everywhere.centers[:, 2] - scene.floor >= floor)
    wrenches = _wrenches(places, scene, radius, mu)
    if not _holds(wrenches):
        tops = obj.surface[0] @ scene.X_WO.rotation().matrix()[2] + scene.X_WO.translation()[2]
        height = MM * float(tops.max() - scene.floor)
        if not _holds(_wrenches(everywhere, scene, radius, mu)):
            text = f"friction of {obj.friction:g} is too low: nowhere do forces within the friction cones point up"
            return (Obstacle("friction", ("wrench", "cone"), text),)
        text = (
            f"no space under the object: it is {height:.0f} mm high, and where a fingertip, {2 * MM * radius:.0f} mm "
            f"thick and {MM * settings.table_clearance:g} mm above the table, touches it, forces within friction "
            f"{mu:.2g} push it down only"
        )
        return (Obstacle("table", ("table", "contact", "object", "wrench", "cone"), text),)
    up = places.normals[:, 2]
    lift = count * settings.most_force * float((up + mu * np.sqrt(np.maximum(1.0 - up**2, 0.0))).max())
    if lift < 0.98:
        text = (
            f"friction of {obj.friction:g} is too low: {count} contacts that press with at most "
            f"{settings.most_force:g} times the object's weight each carry {100 * lift:.0f} % of it"
        )
        return (Obstacle("friction", ("wrench", "cone", "normal force"), text),)
    opening = largest_opening(hand, fingers, radius=radius)
    if _within(places, wrenches, opening + 2.0 * places.spacing):
        return ()
    text = (
        f"the object is too large for the hand: two contacts of {hand.name} come at most "
        f"{MM * opening - 2 * MM * radius:.0f} mm apart, and no contacts so near to each other hold it"
    )
    return (Obstacle("opening", ("contact", "object", "wrench", "cone"), text),)


def too_thick(hand: Hand, vertices: Array, faces: NDArray[np.int64]) -> Obstacle | None:
    """Whether an object is far thicker than a hand opens, wherever fingers could pinch it; needs no convex parts.

    The thickness at a point of the surface is the way straight through to the other side. No proof, unlike the other
    checks: such an object could at best be balanced on fingertips from below.

    Args:
        hand: The hand.
        vertices: Vertices of the object's mesh [m], shape (n, 3).
        faces: Its triangles, outward, shape (m, 3).

    Returns:
        The obstacle, None where a pinch is not excluded.
    """
    fingers = contact_slots(hand)[:-1]
    radius = float(min(hand.spheres[slot.spheres, 3].min() for slot in fingers if len(slot.spheres)))
    opening = largest_opening(hand, fingers, radius=radius) - 2.0 * radius
    thinnest = float(np.percentile(thicknesses(vertices, faces), 1.0))
    if thinnest < THICK * max(opening, 0.0):
        return None
    text = (
        f"the object is too large for the hand: it is {MM * thinnest:.0f} mm thick where it is thinnest, and two "
        f"fingertips of {hand.name} come at most {MM * opening:.0f} mm apart"
    )
    return Obstacle("opening", ("contact", "object", "wrench", "cone"), text)


def thicknesses(vertices: Array, faces: NDArray[np.int64], *, count: int = 300, seed: int = 0) -> Array:
    """Thickness of a closed surface at random points: the way along the inward normal to where it comes out.

    Args:
        vertices: Vertices [m], shape (n, 3).
        faces: Outward triangles, shape (m, 3).
        count: Number of points.
        seed: Seed of the points.

    Returns:
        Thicknesses [m], infinite where nothing is met, shape (count,).
    """
    points, start = sample_surface(vertices, faces, count, seed)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = cross(b - a, c - a)
    inward = -normals[start] / np.maximum(np.linalg.norm(normals[start], axis=1, keepdims=True), 1e-30)
    thin = np.full(count, np.inf)
    for k, (p, d) in enumerate(zip(points, inward, strict=True)):
        # Moeller and Trumbore (1997), all triangles at once.
        height = cross(np.broadcast_to(d, c.shape), c - a)
        volume = np.einsum("ij,ij->i", b - a, height)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ij,ij->i", p - a, height) / volume
            across = cross(p - a, b - a)
            v = across @ d / volume
            way = np.einsum("ij,ij->i", c - a, across) / volume
            hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (way > 1e-6)
        thin[k] = way[hit].min(initial=np.inf)
    return thin


def sizes(hand: Hand, scene: Scene) -> str:
    """The object's size as it lies and the hand's greatest opening, in one sentence."""
    fingers = contact_slots(hand)[:-1]
    radius = float(min(hand.spheres[slot.spheres, 3].min() for slot in fingers if len(slot.spheres)))
    opening = largest_opening(hand, fingers, radius=radius) - 2.0 * radius
    hull = scene.object.surface[0] @ scene.X_WO.rotation().matrix().T
    angles = np.linspace(0.0, np.pi, 36, endpoint=False)
    widths = np.ptp(hull[:, :2] @ np.array([np.cos(angles), np.sin(angles)]), axis=0)
    return (
        f"the object is {MM * widths.min():.0f} to {MM * widths.max():.0f} mm wide and "
        f"{MM * np.ptp(hull[:, 2]):.0f} mm high as it lies; two fingertips of {hand.name} come at most "
        f"{MM * opening:.0f} mm apart"
    )


CONSTRAINT_WORDS = {
    "contact": "the fingers that shall touch do not all reach the object",
    "object": "the hand does not fit around the object without running into it",
    "table": "the hand does not fit between object and table",
    "obstacle": "the hand does not fit beside what stands around the object",
    "self": "the hand's links run into each other",
    "limits": "joints would have to leave their limits",
    "pad": "fingers touch with their backs or sides, not with their pads",
    "wrench": "contact forces do not balance the object's weight",
    "cone": "friction is too low for the forces that would balance the object's weight",
    "palm direction": "the palm cannot come along the direction that was asked for",
    "region": "contacts cannot lie in the part of the object that was asked for",
    "reach": "the grasp would be farther from the prediction than is allowed",
    "normal force": "contacts would have to press harder, or more lightly, than allowed",
}
"""What it means that a constraint is left violated, for people."""
