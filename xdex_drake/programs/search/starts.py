"""Where candidates start: at random, from above or from a side, out of object and table."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from xdex_drake.arrays import Array, skew
from xdex_drake.errors import ConfigError
from xdex_drake.hand.description import Hand
from xdex_drake.programs.grasp_types import approach_axis, random_contact_sets
from xdex_drake.programs.search.candidates import State
from xdex_drake.programs.search.problem import SearchProblem
from xdex_drake.programs.search.settings import LOWEST_APPROACH
from xdex_drake.scene.region import Region
from xdex_drake.scene.tabletop import Scene


def random_rotations(rng: np.random.Generator, count: int) -> Array:
    """Uniformly random rotations, shape (count, 3, 3)."""
    q = rng.normal(size=(count, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        axis=1,
    )


def turned_towards(R_WHs: Array, axis_H: Array, directions_W: Array) -> Array:
    """Rotations turned, each by the least angle, until an axis of the hand points along a direction.

    Args:
        R_WHs: Rotations, shape (n, 3, 3).
        axis_H: Unit axis in H, shape (3,).
        directions_W: Unit directions, shape (n, 3).

    Returns:
        Rotations, shape (n, 3, 3).
    """
    a = R_WHs @ axis_H
    v, c = np.cross(a, directions_W), (a * directions_W).sum(1)
    S = skew(v)
    # Rodrigues; opposite vectors leave the least turn open, and uniformly random ones are never opposite.
    return (np.eye(3) + S + S @ S / (1.0 + c + 1e-12)[:, None, None]) @ R_WHs


def sample_starts(problem: SearchProblem, hand: Hand, scene: Scene, count: int, seed: int) -> State:
    """Random starts: the grasp center near the object's, the hand coming from above or from a side.

    More starts than asked for are drawn and those kept that lie least in object and table, spread over the octants of
    approach.

    Args:
        problem: The problem.
        hand: The hand.
        scene: The scene.
        count: Number of starts.
        seed: Seed.

    Returns:
        The starts.
    """
    rng = np.random.default_rng(seed)
    batched, settings = problem.batched, problem.settings
    places = None if settings.region is None else places_in(scene, settings.region)
    R_WHs, p_WHs, approach = random_wrists(hand, scene, rng, count * settings.oversample, settings.approach, places)
    limits, total = hand.limits, len(R_WHs)
    spread = 0.12 * (limits[1] - limits[0])
    qs = np.clip(hand.q_rest + spread * rng.normal(size=(total, len(hand.q_rest))), limits[0], limits[1])
    fingers = random_contact_sets(hand, rng, total, settings.contacts, settings.grasp_type)

    def tensor(values: Array) -> torch.Tensor:
        return torch.tensor(values, dtype=batched.dtype, device=batched.device)

    poses = batched.forward(tensor(R_WHs), tensor(p_WHs), tensor(qs))
    centers = problem.spheres.positions(poses)
    # Lift out of the table whatever reaches into it: cheaper than to descend.
    sunk = (problem.radii - (centers[:, 2] - problem.floor)).max(-1).values.clamp_min(0.0)
    distance, _ = problem.grid.nearest(problem.R_WO.T @ (centers - problem.p_WO[:, None]))
    inside = (problem.radii - distance).clamp_min(0.0).sum(-1)
    rows = best_of_octants(approach, (inside + 10.0 * sunk).cpu().numpy(), count)
    p_start = tensor(p_WHs[rows])
    p_start[:, 2] += sunk[torch.as_tensor(rows, device=batched.device)].clamp_max(0.05)
    mask = tensor(fingers[rows].astype(float))
    return State(
        R_WH=tensor(R_WHs[rows]),
        p_WH=p_start,
        q=tensor(qs[rows]),
        fingers=mask,
        forces=torch.zeros((*mask.shape, 3), dtype=batched.dtype, device=batched.device),
    )


def places_in(scene: Scene, region: Region) -> Array:
    """Points of the object's surface that lie in a region, in W [m], shape (n, 3).

    Raises:
        ConfigError: There are none.
    """
    points, _ = scene.object.surface_samples(4000)
    inside = points[region.distances(points)[0] < 0.0]
    if len(inside) == 0:
        low, high = scene.object.vertices.min(axis=0), scene.object.vertices.max(axis=0)
        raise ConfigError(
            f"no point of the surface of {scene.object.name} lies in the region; in its frame it reaches from "
            f"{low.round(3).tolist()} to {high.round(3).tolist()} m"
        )
    return (scene.X_WO @ inside.T).T


def random_wrists(
    hand: Hand,
    scene: Scene,
    rng: np.random.Generator,
    count: int,
    wish: tuple[float, float, float] | None,
    places: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Random wrist poses from which a hand at rest would hold the object, none of them from below a table.

    Args:
        hand: The hand.
        scene: The scene.
        rng: Source of randomness.
        count: Greatest number of poses.
        wish: Direction in W near which the palm shall come, of any length; any where None.
        places: Points about which the hand shall hold [m], shape (n, 3); the whole object where None.

    Returns:
        R_WHs, shape (n, 3, 3), p_WHs [m], shape (n, 3), and the palm's directions in W, shape (n, 3).
    """
    center_H, direction_H = approach_axis(hand)
    R_WHs = random_rotations(rng, 4 * count)
    if wish is not None:
        wanted = np.array(wish) / np.linalg.norm(wish)
        spread_out = wanted + 0.3 * rng.normal(size=(len(R_WHs), 3))
        spread_out /= np.linalg.norm(spread_out, axis=1, keepdims=True)
        R_WHs = turned_towards(R_WHs, direction_H, spread_out)
    # From below a table no hand comes; straight sideways is as far as it goes.
    approach = R_WHs @ direction_H
    keep = np.flatnonzero(approach[:, 2] < (LOWEST_APPROACH if scene.table is not None else np.inf))[:count]
    R_WHs, approach = R_WHs[keep], approach[keep]
    vertices = scene.X_WO @ scene.object.vertices.T  # (3, n)
    low, high = vertices.min(1), vertices.max(1)
    p_WOcm = scene.X_WO @ scene.object.p_OOcm
    if places is not None:
        p_WOcm, low, high = places.mean(axis=0), places.min(axis=0), places.max(axis=0)
    aim = p_WOcm + 0.3 * (high - low) * rng.uniform(-1.0, 1.0, size=(len(keep), 3))
    # Fingers come from the side that the palm is on: leave the palm outside the object.
    p_WHs = aim - np.einsum("nab,b->na", R_WHs, center_H) - approach * rng.uniform(0.0, 0.04, size=(len(keep), 1))
    return R_WHs, p_WHs, approach


def best_of_octants(directions: Array, cost: Array, count: int) -> NDArray[np.int64]:
    """The cheapest of each octant of directions in turn.

    Args:
        directions: Directions, shape (n, 3).
        cost: What each costs, shape (n,).
        count: How many are wanted.

    Returns:
        Their indices, shape (min(count, n),).
    """
    octant = (directions > 0.0) @ np.array([4, 2, 1])
    queues = [list(np.flatnonzero(octant == o)[np.argsort(cost[octant == o])]) for o in range(8)]
    chosen: list[int] = []
    while len(chosen) < min(count, len(cost)):
        for queue in queues:
            if queue and len(chosen) < count:
                chosen.append(int(queue.pop(0)))
    return np.array(chosen, dtype=np.int64)
