"""Batched multi-start: many candidates descend the energy of Eq. (1) together.

Every candidate has its own approach, posture and contact set (which fingers shall touch). Gradients are analytic: terms
give gradients with respect to points, the kinematics' adjoint carries them to wrist and joints, and Adam steps on the
tangent. Distances come from the object's grid; the polish that follows uses exact ones.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray

from xdex_drake.arrays import skew
from xdex_drake.hand.batched_kinematics import BatchedHand, FixedPoints, rotation_step
from xdex_drake.hand.collision import self_collision_pairs
from xdex_drake.hand.description import Array, Hand
from xdex_drake.programs import terms
from xdex_drake.programs.grasp_types import GraspType, approach_axis, contact_slots, random_contact_sets
from xdex_drake.scene.distance import DistanceGrid
from xdex_drake.scene.tabletop import Scene

SPACING = 1.0
"""Distance between neighbouring spheres of a link in the search, in radii; the polish takes all of them."""

PAIR_SPACING = 2.0
"""The same for spheres of links that must stay apart."""


@dataclass(frozen=True)
class EnergyWeights:
    """Weights of Eq. (1).

    Attributes:
        fc: Force closure.
        dis: Contact distance.
        sdf: Penetration of object and table.
        j: Joint limits.
        s: Self-collision.
        pad: Alignment of contact normals with the pads of the fingers.
        approach: The palm's direction, where one is asked for.
        spread: Distance between contacts, where one is asked for.
    """

    fc: float = 10.0
    dis: float = 100.0
    sdf: float = 100.0
    j: float = 1.0
    s: float = 50.0
    pad: float = 3.0
    approach: float = 10.0
    spread: float = 100.0


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the batched search.

    Attributes:
        weights: Weights of the energy.
        iterations: Number of Adam steps.
        halfway: Fraction of the steps after which the candidates of highest energy are dropped.
        survivors: Fraction of the candidates that go on from there.
        translation_step: First step of the wrist [m].
        rotation_step: First step of the wrist [rad].
        joint_step: First step of the joints, as a fraction of one radian.
        oversample: How many starts are looked at for each one that descends.
        contacts: Greatest number of fingers that touch.
        friction_fraction: Fraction of the friction that the search's forces may use, so that a margin is left.
        force_steps: Projected-gradient steps on the contact forces for each step of the search.
        estimator: "wrench" for forces in exact cones, "normals" for the paper's estimator |G n|^2.
        pad_cosine: Cosine between contact normal and pad normal that is enough.
        clearance: Distance from the object that spheres without contact keep in the search [m].
        grasp_type: Type of grasp: which fingers, and whether the palm, carry contact.
        approach: Direction that the palm shall come along, in W, of any length; any where None.
        approach_cosine: Cosine between the palm's direction and that one that is enough.
        spread: Distance that contact points shall keep from each other [m]; any where 0.
    """

    weights: EnergyWeights = field(default_factory=EnergyWeights)
    iterations: int = 100
    halfway: float = 0.3
    survivors: float = 0.5
    translation_step: float = 0.004
    rotation_step: float = 0.04
    joint_step: float = 0.04
    oversample: int = 8
    contacts: int = 4
    friction_fraction: float = 0.4
    force_steps: int = 3
    estimator: str = "wrench"
    pad_cosine: float = 0.6
    clearance: float = 0.001
    grasp_type: GraspType = "any"
    approach: tuple[float, float, float] | None = None
    approach_cosine: float = 0.9
    spread: float = 0.0


@dataclass(frozen=True)
class Candidates:
    """Results of a search, best first.

    Attributes:
        R_WHs: Wrist rotations, shape (B, 3, 3).
        p_WHs: Wrist origins [m], shape (B, 3).
        qs: Actuated joint values [rad or m], shape (B, n).
        fingers: Which slots shall touch: the fingers, in the order of `hand.fingers`, and for a power grasp the
            palm, shape (B, n_slots).
        energy: Total energy, shape (B,).
        terms: Unweighted value of each term, each of shape (B,).
    """

    R_WHs: Array
    p_WHs: Array
    qs: Array
    fingers: NDArray[np.bool_]
    energy: Array
    terms: dict[str, Array]


class TorchGrid:
    """A distance grid as tensors, looked up in batches."""

    def __init__(self, grid: DistanceGrid, *, dtype: torch.dtype = torch.float32, device: str = "cpu") -> None:
        """Copies the grid.

        Args:
            grid: The grid of an object.
            dtype: Floating-point type.
            device: Torch device.
        """
        self.shape = torch.tensor(grid.values.shape, device=device)
        table = np.concatenate([grid.values[..., None], grid.gradients], axis=-1).reshape(-1, 4)
        self.table = torch.as_tensor(table, dtype=dtype, device=device)
        self.origin = torch.as_tensor(np.asarray(grid.origin), dtype=dtype, device=device)
        self.spacing = float(grid.spacing)
        self.last = (self.shape - 1).to(dtype)
        strides = np.array([grid.values.shape[1] * grid.values.shape[2], grid.values.shape[2], 1])
        self.strides = torch.as_tensor(strides, device=device)
        # The eight corners of a cell: their rows in the table from its first, and their weights sign * t + offset.
        bits = np.array([[c >> 2 & 1, c >> 1 & 1, c & 1] for c in range(8)])
        self.corner_rows = torch.as_tensor(bits @ strides, device=device)
        self.corner_signs = torch.as_tensor(2 * bits - 1, dtype=dtype, device=device)
        self.corner_offsets = torch.as_tensor(1 - bits, dtype=dtype, device=device)

    def nearest(self, x_O: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Distance by a first-order expansion about the nearest grid point: one look-up for each point.

        Args:
            x_O: Components of points in O [m], shape (B, 3, m).

        Returns:
            Signed distance [m], shape (B, m), and components of its gradient, shape (B, 3, m).
        """
        cell = ((x_O - self.origin[:, None]) * (1.0 / self.spacing)).round()
        cell = torch.minimum(cell.clamp_min(0.0), self.last[:, None])
        row = self.table.index_select(0, (cell.long() * self.strides[:, None]).sum(1).flatten())
        row = row.view(*x_O.shape[::2], 4)
        gradient = row[..., 1:].transpose(1, 2)
        away = x_O - self.origin[:, None] - cell * self.spacing
        return row[..., 0] + (gradient * away).sum(1), gradient

    def smooth(self, p_OPs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Trilinear distance and gradient, with the derivative of the gradient, for the few points that are contacts.

        Args:
            p_OPs: Points in O [m], shape (..., 3).

        Returns:
            Signed distance [m], shape (...), unit gradient, shape (..., 3), and its Jacobian, shape (..., 3, 3).
        """
        x = (p_OPs - self.origin) / self.spacing
        x = torch.minimum(x.clamp_min(0.0), self.last - 1e-3)
        cell = x.floor()
        t = (x - cell)[..., None, :]
        corner = (cell.long() * self.strides).sum(-1, keepdim=True) + self.corner_rows
        row = self.table[corner]  # (..., 8, 4)
        w = self.corner_signs * t + self.corner_offsets  # (..., 8, 3): t or 1 - t
        wx, wy, wz = w.unbind(-1)
        slope = self.corner_signs * torch.stack([wy * wz, wx * wz, wx * wy], dim=-1)
        mean = ((wx * wy * wz)[..., None] * row).sum(-2)
        value, gradient = mean[..., 0], mean[..., 1:]
        hessian = row[..., 1:].transpose(-1, -2) @ slope / self.spacing
        size = gradient.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        unit = gradient / size
        hessian = (hessian - unit[..., None] * (unit[..., None, :] @ hessian)) / size[..., None]
        return value, unit, hessian


@dataclass(frozen=True)
class SearchProblem:
    """What a batch of candidates descends: hand, object and table as tensors.

    Attributes:
        batched: The hand.
        grid: The object's distances.
        R_WO: Rotation of the object, shape (3, 3).
        p_WO: Origin of the object [m], shape (3,).
        p_WOcm: Center of mass [m], shape (3,).
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
        settings: Settings.
    """

    batched: BatchedHand
    grid: TorchGrid
    R_WO: torch.Tensor
    p_WO: torch.Tensor
    p_WOcm: torch.Tensor
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
    settings: SearchSettings


def spread_spheres(hand: Hand, *, spacing: float, whole: Collection[int] = ()) -> NDArray[np.int64]:
    """Fewer spheres that still stand for the hand.

    Spheres overlap along a link, so not all are needed everywhere: each link keeps those that lie at least some radii
    from the ones kept before them, and its last.

    Args:
        hand: The hand.
        spacing: Distance between neighbours that are kept, in radii.
        whole: Links that keep all.

    Returns:
        Indices into `hand.spheres`, rising, shape (m,).
    """
    keep: list[int] = []
    for link in range(len(hand.links)):
        rows = np.flatnonzero(hand.sphere_links == link)
        kept: list[int] = []
        for row in rows:
            center, radius = hand.spheres[row, :3], hand.spheres[row, 3]
            apart = np.linalg.norm(hand.spheres[kept, :3] - center, axis=1) > spacing * radius
            if link in whole or row == rows[-1] or apart.all():
                kept.append(int(row))
        keep += kept
    return np.array(keep, dtype=np.int64)


@lru_cache(maxsize=64)
def sphere_pairs(hand: Hand, *, spacing: float = 0.8, base: bool = True) -> NDArray[np.int64]:
    """Pairs of spheres on links that must stay apart.

    Args:
        hand: The hand.
        spacing: Distance between neighbouring spheres that are kept, in radii; see `spread_spheres`.
        base: Whether the base link takes part.

    Returns:
        Indices into `hand.spheres`, shape (m, 2).
    """
    coarse = spread_spheres(hand, spacing=spacing)
    link_of = hand.sphere_links[coarse]
    apart = np.zeros((len(hand.links), len(hand.links)), dtype=bool)
    for a, b in self_collision_pairs(hand):
        apart[a, b] = apart[b, a] = base or (a > 0 and b > 0)
    i, j = np.triu_indices(len(coarse), 1)
    kept = apart[link_of[i], link_of[j]]
    return np.stack([coarse[i[kept]], coarse[j[kept]]], axis=1)


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
    """

    def tensor(values: object) -> torch.Tensor:
        return torch.tensor(np.asarray(values, dtype=float), dtype=dtype, device=device)

    settings = settings or SearchSettings()
    slots = contact_slots(hand)
    slots = slots if settings.grasp_type == "power" else slots[:-1]
    chosen = spread_spheres(hand, spacing=SPACING, whole=[slot.link for slot in slots])
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
        settings=settings,
    )


@dataclass
class State:
    """Candidates on their way down; updated in place by `descend`.

    Attributes:
        R_WH: Wrist rotations, shape (B, 3, 3).
        p_WH: Wrist origins [m], shape (B, 3).
        q: Joint values, shape (B, n).
        fingers: 1 where a slot shall touch, shape (B, n_slots).
        forces: Contact forces in W, warm-started from step to step, shape (B, n_slots, 3).
    """

    R_WH: torch.Tensor
    p_WH: torch.Tensor
    q: torch.Tensor
    fingers: torch.Tensor
    forces: torch.Tensor

    def keep(self, rows: torch.Tensor) -> None:
        """Drops all candidates but some, given by their indices."""
        for name in ("R_WH", "p_WH", "q", "fingers", "forces"):
            setattr(self, name, getattr(self, name)[rows])


def evaluate(problem: SearchProblem, state: State) -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
    """Energy of Eq. (1) for each candidate, with its gradient.

    Updates `state.forces` by some projected-gradient steps first, so that the gradient is the envelope's.

    Args:
        problem: The problem.
        state: The candidates.

    Returns:
        Energy, shape (B,), gradient with respect to (w_WH, v_WH, qdot), shape (B, 6 + n), and the unweighted terms.
    """
    batched, settings, weights = problem.batched, problem.settings, problem.settings.weights
    B = state.q.shape[0]
    poses = batched.forward(state.R_WH, state.p_WH, state.q)
    centers = problem.spheres.positions(poses)  # (B, 3, n_spheres)
    R_OW = problem.R_WO.T
    distance, slope_O = problem.grid.nearest(R_OW @ (centers - problem.p_WO[:, None]))
    radii = problem.radii

    # Contacts: of each finger the tip sphere that is nearest to the surface.
    gaps = (distance - radii)[:, problem.tip_spheres]  # (B, n_fingers, k)
    choice = gaps.argmin(-1)
    sphere = torch.gather(problem.tip_spheres.expand(B, -1, -1), 2, choice[..., None])[..., 0]  # (B, n_fingers)
    contact_centers = torch.gather(centers, 2, sphere[:, None].expand(-1, 3, -1)).transpose(1, 2)
    contact_radii = radii[sphere]
    d, n_O, H_O = problem.grid.smooth((contact_centers - problem.p_WO) @ problem.R_WO)
    outward = n_O @ problem.R_WO.T
    H = problem.R_WO @ H_O @ problem.R_WO.T
    normals = -outward
    points = contact_centers - d[..., None] * outward
    mask = state.fingers

    value_dis, g_dis = terms.contact_distance(d, contact_radii, mask)

    # Penetration: the fingers that touch keep no clearance.
    keep_off = radii + settings.clearance
    value_sdf, g_sdf = terms.penetration(distance, keep_off)
    height = centers[:, 2]
    value_table, g_table = terms.penetration(height, keep_off)

    force = state.forces * mask[..., None]
    mu = settings.friction_fraction * problem.friction
    if settings.estimator == "normals":
        force = normals * mask[..., None]
    else:
        step = 1.0 / (2.0 * mask.sum(-1).clamp_min(1.0))[:, None, None]
        G = terms.grasp_map(points, problem.p_WOcm, problem.length)
        Gt = G.transpose(1, 2)
        for _ in range(settings.force_steps):
            descent = (Gt @ (G @ force.flatten(1)[..., None])).view_as(force)
            force = terms.project_forces(force - step * descent, normals, mu, 0.3, 1.5) * mask[..., None]
        state.forces = force
    value_fc, g_point, g_normal = terms.wrench_energy(points, normals, force, problem.p_WOcm, problem.length)

    pad_W = (poses.R_WLs[:, problem.tip_links] @ problem.pads[:, :, None])[..., 0]
    value_pad, g_pad_normal, g_pad = terms.alignment(normals, pad_W, settings.pad_cosine, mask)

    value_s, g_between = terms.self_collision(problem.pairs.positions(poses).transpose(1, 2), problem.reach)
    value_j, g_j = terms.joint_limits(state.q, batched.limits)

    # Gradients with respect to sphere centers.
    g_centers = weights.sdf * (problem.R_WO @ (g_sdf[:, None] * slope_O))
    g_centers[:, 2] += weights.sdf * g_table
    on_normal = weights.fc * g_normal + weights.pad * g_pad_normal
    on_point = weights.fc * g_point
    wishes = {}
    if settings.spread > 0.0:
        wishes["spread"], g_spread = terms.finger_spread(points, settings.spread, mask)
        on_point = on_point + weights.spread * g_spread
    # A contact is the surface point nearest to its sphere: dp = (1 - n n^T - d H) dc, dn_in = -H dc.
    Ht = H.transpose(-1, -2)
    g_contact = (
        on_point
        - outward * (outward * on_point).sum(-1, keepdim=True)
        - d[..., None] * (Ht @ on_point[..., None])[..., 0]
        - (Ht @ on_normal[..., None])[..., 0]
        + weights.dis * g_dis[..., None] * outward
    )
    on_links = (
        problem.spheres.wrenches(poses, g_centers)
        + problem.pairs.wrenches(poses, weights.s * g_between.transpose(1, 2))
        + batched.wrenches(
            problem.tip_links, contact_centers, g_contact, torque=weights.pad * terms.cross(pad_W, g_pad)
        )
    )
    gradient = batched.to_tangent(poses, on_links)
    gradient[:, 6:] += weights.j * g_j
    if settings.approach is not None:
        a_W = state.R_WH @ problem.approach
        wanted = torch.as_tensor(settings.approach, dtype=a_W.dtype, device=a_W.device)
        wishes["approach"], g_a = terms.approach(a_W, wanted / wanted.norm(), settings.approach_cosine)
        gradient[:, :3] += weights.approach * terms.cross(a_W, g_a)
    values = {
        "fc": value_fc,
        "dis": value_dis,
        "sdf": value_sdf + value_table,
        "j": value_j,
        "s": value_s,
        "pad": value_pad,
        **wishes,
    }
    energy = sum(getattr(weights, name) * value for name, value in values.items())
    return energy, gradient, values  # type: ignore[return-value]


def descend(problem: SearchProblem, state: State) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """Adam on the tangent, in place; joints are clipped to their limits.

    Part of the way down, candidates of high energy are dropped: hardly one of them is ever certified.

    Args:
        problem: The problem.
        state: The candidates, moved in place; `settings.survivors` of them are left, in their order.

    Returns:
        Energy at the end, shape (B,), and its unweighted terms.
    """
    settings = problem.settings
    n = state.q.shape[1]
    first = torch.tensor(
        [settings.rotation_step] * 3 + [settings.translation_step] * 3 + [settings.joint_step] * n,
        dtype=state.q.dtype,
        device=state.q.device,
    )
    m = torch.zeros((state.q.shape[0], 6 + n), dtype=state.q.dtype, device=state.q.device)
    v = torch.zeros_like(m)
    low, high = problem.batched.limits
    halfway = round(settings.halfway * settings.iterations)
    for k in range(settings.iterations):
        energy, gradient, _ = evaluate(problem, state)
        if k == halfway and settings.survivors < 1.0:
            rows = torch.argsort(energy)[: max(1, round(settings.survivors * len(energy)))].sort().values
            state.keep(rows)
            gradient, m, v = gradient[rows], m[rows], v[rows]
        m = 0.9 * m + 0.1 * gradient
        v = 0.98 * v + 0.02 * gradient * gradient
        rate = first * (0.03 + 0.97 * 0.5 * (1.0 + np.cos(np.pi * k / settings.iterations)))
        step = -rate * (m / (1.0 - 0.9 ** (k + 1))) / ((v / (1.0 - 0.98 ** (k + 1))).sqrt() + 1e-6)
        state.R_WH = rotation_step(state.R_WH, step[:, :3])
        state.p_WH = state.p_WH + step[:, 3:6]
        state.q = torch.minimum(torch.maximum(state.q + step[:, 6:], low), high)
    energy, _, values = evaluate(problem, state)
    return energy, values


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
    total = count * settings.oversample
    center_H, direction_H = approach_axis(hand)
    R_WHs = random_rotations(rng, 4 * total)
    if settings.approach is not None:
        wanted = np.array(settings.approach) / np.linalg.norm(settings.approach)
        spread_out = wanted + 0.3 * rng.normal(size=(len(R_WHs), 3))
        spread_out /= np.linalg.norm(spread_out, axis=1, keepdims=True)
        R_WHs = turned_towards(R_WHs, direction_H, spread_out)
    # From below the table no hand comes; straight sideways is as far as it goes.
    approach = R_WHs @ direction_H
    keep = np.flatnonzero(approach[:, 2] < 0.35)[:total]
    R_WHs, approach = R_WHs[keep], approach[keep]
    total = len(keep)
    vertices = scene.X_WO @ scene.object.vertices.T  # (3, n)
    low, high = vertices.min(1), vertices.max(1)
    p_WOcm = scene.X_WO @ scene.object.p_OOcm
    aim = p_WOcm + 0.3 * (high - low) * rng.uniform(-1.0, 1.0, size=(total, 3))
    # Fingers come from the side that the palm is on: leave the palm outside the object.
    p_WHs = aim - np.einsum("nab,b->na", R_WHs, center_H) - approach * rng.uniform(0.0, 0.04, size=(total, 1))
    limits = hand.limits
    spread = 0.12 * (limits[1] - limits[0])
    qs = np.clip(hand.q_rest + spread * rng.normal(size=(total, len(hand.q_rest))), limits[0], limits[1])
    fingers = random_contact_sets(hand, rng, total, settings.contacts, settings.grasp_type)

    def tensor(values: Array) -> torch.Tensor:
        return torch.tensor(values, dtype=batched.dtype, device=batched.device)

    poses = batched.forward(tensor(R_WHs), tensor(p_WHs), tensor(qs))
    centers = problem.spheres.positions(poses)
    # Lift out of the table whatever reaches into it: cheaper than to descend.
    sunk = (problem.radii - centers[:, 2]).max(-1).values.clamp_min(0.0)
    distance, _ = problem.grid.nearest(problem.R_WO.T @ (centers - problem.p_WO[:, None]))
    inside = (problem.radii - distance).clamp_min(0.0).sum(-1)
    cost = (inside + 10.0 * sunk).cpu().numpy()
    octant = (approach > 0.0) @ np.array([4, 2, 1])
    chosen: list[int] = []
    queues = [list(np.flatnonzero(octant == o)[np.argsort(cost[octant == o])]) for o in range(8)]
    while len(chosen) < min(count, total):
        for queue in queues:
            if queue and len(chosen) < count:
                chosen.append(int(queue.pop(0)))
    rows = np.array(chosen)
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


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread for torch: tensors of this size gain nothing from more, and on a busy machine lose much by waiting."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def search(
    hand: Hand,
    scene: Scene,
    *,
    count: int = 64,
    seed: int = 0,
    settings: SearchSettings | None = None,
    device: str = "cpu",
) -> Candidates:
    """Descends a batch of random starts.

    Args:
        hand: The hand.
        scene: The scene.
        count: Number of starts.
        seed: Seed.
        settings: Settings; the defaults where None.
        device: Torch device.

    Returns:
        The candidates that are left of them (`settings.survivors`), lowest energy first.
    """
    problem = search_problem(hand, scene, settings, device=device)
    with torch.no_grad(), _one_thread():
        state = sample_starts(problem, hand, scene, count, seed)
        energy, values = descend(problem, state)
    order = torch.argsort(energy)
    return _candidates(state, energy, values, order)


def refine(
    hand: Hand, scene: Scene, starts: Candidates, *, settings: SearchSettings, device: str = "cpu"
) -> Candidates:
    """Descends given starts, such as a model's predictions.

    Args:
        hand: The hand.
        scene: The scene.
        starts: Where to start, with the fingers that shall touch.
        settings: Settings.
        device: Torch device.

    Returns:
        The candidates, in the order of the starts.
    """
    problem = search_problem(hand, scene, replace(settings, survivors=1.0), device=device)

    def tensor(values: Array) -> torch.Tensor:
        return torch.tensor(values, dtype=problem.batched.dtype, device=device)

    fingers = tensor(starts.fingers.astype(float))
    forces = torch.zeros((*fingers.shape, 3), dtype=fingers.dtype, device=device)
    with torch.no_grad(), _one_thread():
        state = State(tensor(starts.R_WHs), tensor(starts.p_WHs), tensor(starts.qs), fingers, forces)
        energy, values = descend(problem, state)
    return _candidates(state, energy, values, torch.arange(len(energy), device=device))


def _candidates(state: State, energy: torch.Tensor, values: dict[str, torch.Tensor], order: torch.Tensor) -> Candidates:
    """Candidates in NumPy, in the given order."""

    def array(t: torch.Tensor) -> Array:
        return t[order].cpu().numpy().astype(float)

    return Candidates(
        R_WHs=array(state.R_WH),
        p_WHs=array(state.p_WH),
        qs=array(state.q),
        fingers=array(state.fingers) > 0.5,
        energy=array(energy),
        terms={name: array(value) for name, value in values.items()},
    )
