"""The view that energy terms have of a batch of candidates: torch tensors, distances from the grid."""

# What the properties give is written in `View`.
# ruff: noqa: D102

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch

from xdex_drake.hand.batched_kinematics import LinkPoses
from xdex_drake.hand.description import Hand
from xdex_drake.programs.arrays import cross, rotation_pull
from xdex_drake.programs.contact_forces import relaxed_forces
from xdex_drake.programs.search.candidates import State
from xdex_drake.programs.search.problem import SearchProblem
from xdex_drake.programs.term import Pulls, add_pull, carried, evaluate_term


@dataclass(frozen=True)
class BatchView:
    """A `View` of a batch; what is computed is computed once, and what no term asks for is not.

    Attributes:
        problem: The problem.
        state: The candidates.
    """

    problem: SearchProblem
    state: State

    @property
    def hand(self) -> Hand:
        return self.problem.batched.hand

    @property
    def p_WOcm(self) -> torch.Tensor:
        return self.problem.p_WOcm

    @property
    def length(self) -> float:
        return self.problem.length

    @property
    def limits(self) -> torch.Tensor:
        return self.problem.batched.limits

    @property
    def radii(self) -> torch.Tensor:
        return self.problem.radii

    @property
    def reach(self) -> torch.Tensor:
        return self.problem.reach

    @property
    def touching(self) -> torch.Tensor:
        return self.state.fingers

    @property
    def R_WH(self) -> torch.Tensor:
        return self.state.R_WH

    @property
    def p_WH(self) -> torch.Tensor:
        return self.state.p_WH

    @property
    def q(self) -> torch.Tensor:
        return self.state.q

    @cached_property
    def poses(self) -> LinkPoses:
        """Poses of the links."""
        return self.problem.batched.forward(self.state.R_WH, self.state.p_WH, self.state.q)

    @property
    def R_WLs(self) -> torch.Tensor:
        return self.poses.R_WLs

    @property
    def p_WLs(self) -> torch.Tensor:
        return self.poses.p_WLs

    @cached_property
    def palm_W(self) -> torch.Tensor:
        return self.state.R_WH @ self.problem.approach

    @cached_property
    def tips_W(self) -> torch.Tensor:
        return self.problem.tip_points.positions(self.poses).transpose(1, 2)

    @cached_property
    def _centers(self) -> torch.Tensor:
        """Components of the spheres' centers, shape (B, 3, m)."""
        return self.problem.spheres.positions(self.poses)

    @property
    def centers_W(self) -> torch.Tensor:
        return self._centers.transpose(1, 2)

    @cached_property
    def _nearest(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Distances by the nearest grid point, and components of their gradients in O, shape (B, 3, m)."""
        return self.problem.grid.nearest(self.problem.R_WO.T @ (self._centers - self.problem.p_WO[:, None]))

    @property
    def distances(self) -> torch.Tensor:
        return self._nearest[0]

    @property
    def heights(self) -> torch.Tensor:
        return self._centers[:, 2] - self.problem.floor

    @cached_property
    def between_W(self) -> torch.Tensor:
        return self.problem.pairs.positions(self.poses).transpose(1, 2)

    @cached_property
    def _contact_spheres(self) -> torch.Tensor:
        """Of each slot the sphere that is nearest to the surface, shape (B, nc)."""
        rows = self.problem.tip_spheres
        choice = (self.distances - self.problem.radii)[:, rows].argmin(-1)
        return torch.gather(rows.expand(len(choice), -1, -1), 2, choice[..., None])[..., 0]

    @property
    def contact_radii(self) -> torch.Tensor:
        return self.problem.radii[self._contact_spheres]

    @cached_property
    def _contact_centers(self) -> torch.Tensor:
        """Centers of the contacts' spheres, shape (B, nc, 3)."""
        return torch.gather(self._centers, 2, self._contact_spheres[:, None].expand(-1, 3, -1)).transpose(1, 2)

    @cached_property
    def _smooth(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Distance of the contacts' spheres, unit outward normal in W and its derivative."""
        R_WO = self.problem.R_WO
        d, n_O, H_O = self.problem.grid.smooth((self._contact_centers - self.problem.p_WO) @ R_WO)
        return d, n_O @ R_WO.T, R_WO @ H_O @ R_WO.T

    @property
    def contact_distances(self) -> torch.Tensor:
        return self._smooth[0]

    @cached_property
    def contacts_W(self) -> torch.Tensor:
        d, outward, _ = self._smooth
        return self._contact_centers - d[..., None] * outward

    @cached_property
    def normals_W(self) -> torch.Tensor:
        return -self._smooth[1]

    @cached_property
    def pads_W(self) -> torch.Tensor:
        return (self.R_WLs[:, self.problem.tip_links] @ self.problem.pads[:, :, None])[..., 0]

    @cached_property
    def forces_W(self) -> torch.Tensor:
        settings = self.problem.settings
        return relaxed_forces(
            self.state.forces,
            self.contacts_W,
            self.normals_W,
            self.touching,
            p_WOcm=self.p_WOcm,
            length=self.length,
            mu=settings.friction_fraction * self.problem.friction,
            steps=settings.force_steps,
        )

    def pull_back(self, pulls: Pulls) -> torch.Tensor:
        """Gradient with respect to the candidates from gradients with respect to what the view offers.

        Args:
            pulls: The gradients by name.

        Returns:
            Gradient with respect to (w_WH, v_WH, qdot), shape (B, 6 + n).
        """
        parts = [*self._on_points(pulls), *self._on_contacts(pulls), *self._on_link_poses(pulls)]
        B, n = self.q.shape
        if parts:
            gradient = self.problem.batched.to_tangent(self.poses, sum(parts[1:], parts[0]))
        else:
            gradient = self.q.new_zeros((B, 6 + n))
        for name, columns, through in (
            ("q", slice(6, None), lambda g: g),
            ("palm_W", slice(3), lambda g: cross(self.palm_W, g)),
            ("R_WH", slice(3), lambda g: rotation_pull(self.R_WH, g)),
            ("p_WH", slice(3, 6), lambda g: g),
        ):
            total = carried(pulls, name, through)
            if total is not None:
                gradient[:, columns] += total
        return gradient

    def _on_points(self, pulls: Pulls) -> list[torch.Tensor]:
        """Wrenches on the links by what pulls sphere centers, pairs of them, and tips."""
        found = []
        on_centers = self._on_centers(pulls)
        if on_centers is not None:
            found.append(self.problem.spheres.wrenches(self.poses, on_centers))
        for name, points in (("between_W", self.problem.pairs), ("tips_W", self.problem.tip_points)):
            total = carried(pulls, name)
            if total is not None:
                found.append(points.wrenches(self.poses, total.transpose(1, 2)))
        return found

    def _on_centers(self, pulls: Pulls) -> torch.Tensor | None:
        """Components of the gradient with respect to the spheres' centers, shape (B, 3, m)."""
        R_WO = self.problem.R_WO
        total = carried(pulls, "distances", lambda g: R_WO @ (g[:, None] * self._nearest[1]))
        if "centers_W" in pulls:
            on_centers = pulls["centers_W"].transpose(1, 2)
            total = on_centers.clone() if total is None else total + on_centers
        if "heights" in pulls:
            total = torch.zeros_like(self._centers) if total is None else total
            total[:, 2] += pulls["heights"]
        return total

    def _on_contacts(self, pulls: Pulls) -> list[torch.Tensor]:
        """Wrenches on the links by what pulls contact points, normals, distances and pads."""
        on_points, on_normals = carried(pulls, "contacts_W"), carried(pulls, "normals_W")
        on_distances = carried(pulls, "contact_distances")
        torque = carried(pulls, "pads_W", lambda g: cross(self.pads_W, g))
        if on_points is None and on_normals is None and on_distances is None and torque is None:
            return []
        d, outward, H = self._smooth
        Ht = H.transpose(-1, -2)
        # A contact is the surface point nearest to its sphere: dp = (1 - n n^T - d H) dc, dn_in = -H dc.
        parts = []
        if on_points is not None:
            parts.append(on_points - outward * (outward * on_points).sum(-1, keepdim=True))
            parts.append(-d[..., None] * (Ht @ on_points[..., None])[..., 0])
        if on_normals is not None:
            parts.append(-(Ht @ on_normals[..., None])[..., 0])
        if on_distances is not None:
            parts.append(on_distances[..., None] * outward)
        on_centers = sum(parts[1:], parts[0]) if parts else torch.zeros_like(outward)
        batched, links = self.problem.batched, self.problem.tip_links
        return [batched.wrenches(links, self._contact_centers, on_centers, torque=torque)]

    def _on_link_poses(self, pulls: Pulls) -> list[torch.Tensor]:
        """Wrenches on the links by what pulls their poses."""
        torque = carried(pulls, "R_WLs", lambda g: rotation_pull(self.R_WLs, g))
        force = carried(pulls, "p_WLs")
        if torque is None and force is None:
            return []
        links = torch.arange(self.p_WLs.shape[1], device=self.p_WLs.device)
        force = torch.zeros_like(self.p_WLs) if force is None else force
        return [self.problem.batched.wrenches(links, self.p_WLs, force, torque=torque)]


def evaluate(problem: SearchProblem, state: State) -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
    """The energy of each candidate, that of Eq. (1) where settings say nothing else, with its gradient.

    Updates `state.forces` by some projected-gradient steps first, so that the gradient is the envelope's.

    Args:
        problem: The problem.
        state: The candidates.

    Returns:
        Energy, shape (B,), gradient with respect to (w_WH, v_WH, qdot), shape (B, 6 + n), and the unweighted terms.

    Raises:
        ConfigError: A term gives something of a wrong shape.
    """
    view = BatchView(problem, state)
    state.forces = view.forces_W
    values, pulls, energy = {}, dict[str, torch.Tensor](), torch.zeros_like(state.q[:, 0])
    for weight, term in problem.terms:
        values[term.name], gradients = evaluate_term(term, view)
        add_pull(pulls, weight, gradients)
        energy = energy + weight * values[term.name]
    return energy, view.pull_back(pulls), values
