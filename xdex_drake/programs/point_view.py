"""The view that energy terms have of one point of a program: NumPy arrays, exact distances."""

# What the properties give is written in `View`.
# ruff: noqa: D102

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array, cross
from xdex_drake.hand.description import Hand
from xdex_drake.programs.arrays import rotation_pull
from xdex_drake.programs.contact_forces import FORCE_FRICTION, relaxed_forces
from xdex_drake.programs.grasp_types import approach_axis, contact_slots, finger_tips
from xdex_drake.programs.point import Point
from xdex_drake.programs.spheres import PAIR_SPACING, search_spheres, sphere_pairs
from xdex_drake.programs.term import Pulls, carried

FORCE_STEPS = 50
"""Steps towards the forces of least unbalanced wrench, from the normals at every point anew; a thousand lower the
energy of four contacts by another 7 %."""


@dataclass(frozen=True)
class PointView:
    """A `View` of a point; contacts are those of the point's contact set, all of which shall touch.

    Attributes:
        point: The point.
    """

    point: Point

    @staticmethod
    def of(point: Point) -> PointView:
        """The view of a point, made once for all terms."""
        if "view" not in point.memo:
            point.memo["view"] = PointView(point)
        return point.memo["view"]

    @property
    def hand(self) -> Hand:
        return self.point.k.hand

    @property
    def p_WOcm(self) -> Array:
        return self.point.scene.X_WO @ self.point.scene.object.p_OOcm

    @property
    def length(self) -> float:
        return self.point.scene.object.length

    @property
    def limits(self) -> Array:
        return self.hand.limits

    @cached_property
    def _spheres(self) -> NDArray[np.int64]:
        return search_spheres(self.hand, palm=bool((self.point.contacts.fingers == len(self.hand.fingers)).any()))

    @cached_property
    def _pairs(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        a, b = sphere_pairs(self.hand, spacing=PAIR_SPACING, base=False).T
        return a, b

    @property
    def radii(self) -> Array:
        return self.hand.spheres[self._spheres, 3]

    @property
    def reach(self) -> Array:
        a, b = self._pairs
        return self.hand.spheres[a, 3] + self.hand.spheres[b, 3]

    @property
    def contact_radii(self) -> Array:
        return self.hand.spheres[self.point.contacts.spheres, 3]

    @property
    def touching(self) -> Array:
        return np.ones(len(self.point.contacts.spheres))

    @cached_property
    def forces_W(self) -> Array:
        return relaxed_forces(
            self.normals_W,
            self.contacts_W,
            self.normals_W,
            self.touching,
            p_WOcm=self.p_WOcm,
            length=self.length,
            mu=FORCE_FRICTION * self.point.scene.object.friction,
            steps=FORCE_STEPS,
        )

    @property
    def R_WH(self) -> Array:
        return self.point.k.X_WH.rotation().matrix()

    @property
    def p_WH(self) -> Array:
        return self.point.k.X_WH.translation()

    @property
    def q(self) -> Array:
        return self.point.k.q

    @property
    def R_WLs(self) -> Array:
        return self.point.k.R_WLs

    @property
    def p_WLs(self) -> Array:
        return self.point.k.p_WLs

    @property
    def palm_W(self) -> Array:
        return self.point.k.X_WH.rotation() @ approach_axis(self.hand)[1]

    @property
    def tips_W(self) -> Array:
        return self.point.k.points(*finger_tips(self.hand))

    @property
    def centers_W(self) -> Array:
        return self.point.centers_W[self._spheres]

    @cached_property
    def _query(self) -> tuple[Array, Array]:
        """Exact distances [m] and unit gradients in W, of all spheres however far."""
        found = self.point.scene.object.exact.query(self.point.to_object(self.centers_W))
        return found.distance, found.gradient @ self.point.scene.X_WO.rotation().matrix().T

    @property
    def distances(self) -> Array:
        return self._query[0]

    @property
    def heights(self) -> Array:
        return self.centers_W[:, 2] - self.point.scene.floor

    @property
    def between_W(self) -> Array:
        a, b = self._pairs
        return self.point.centers_W[a] - self.point.centers_W[b]

    @property
    def contact_distances(self) -> Array:
        return self.point.contact_gaps + self.contact_radii

    @property
    def contacts_W(self) -> Array:
        return self.point.contacts_W

    @property
    def normals_W(self) -> Array:
        return self.point.normals_W

    @property
    def pads_W(self) -> Array:
        slots, contacts = contact_slots(self.hand), self.point.contacts
        pads = np.array([slots[f].n_LPad for f in contacts.fingers])
        return self.point.k.vectors(contacts.links, pads)

    def pull_back(self, pulls: Pulls) -> Array:
        """Gradient with respect to the configuration from gradients with respect to what the view offers.

        Args:
            pulls: The gradients by name.

        Returns:
            Gradient with respect to (w_WH, v_WH, qdot), shape (6 + n,).
        """
        gradient = self._of_points(pulls) + self._of_contacts(pulls) + self._of_links(pulls)
        for name, rows, through in (
            ("palm_W", slice(3), lambda g: cross(self.palm_W, g)),
            ("R_WH", slice(3), lambda g: rotation_pull(self.R_WH, g)),
            ("p_WH", slice(3, 6), lambda g: g),
            ("q", slice(6, None), lambda g: g),
        ):
            total = carried(pulls, name, through)
            if total is not None:
                gradient[rows] += total
        return gradient

    def _of_points(self, pulls: Pulls) -> Array:
        """Of sphere centers and tips."""
        gradient = np.zeros(self.point.moving)
        on_centers = carried(pulls, "centers_W")
        on_distances = carried(pulls, "distances", lambda g: g[:, None] * self._query[1])
        on_heights = carried(pulls, "heights", lambda g: g[:, None] * np.array([0.0, 0.0, 1.0]))
        for total in (on_centers, on_distances, on_heights):
            if total is not None:
                gradient += self.point.pull_back_spheres(self._spheres, total).sum(0)
        on_pairs = carried(pulls, "between_W")
        if on_pairs is not None:
            rows = np.concatenate(self._pairs)
            gradient += self.point.pull_back_spheres(rows, np.concatenate([on_pairs, -on_pairs])).sum(0)
        on_tips = carried(pulls, "tips_W")
        if on_tips is not None:
            gradient += self.point.k.pull_back_each(finger_tips(self.hand)[0], self.tips_W, on_tips).sum(0)
        return gradient

    def _of_contacts(self, pulls: Pulls) -> Array:
        """Of contact points, normals, distances and pads."""
        point, gradient = self.point, np.zeros(self.point.moving)
        on_points = carried(pulls, "contacts_W")
        if on_points is not None:
            gradient += np.einsum("ka,kab->b", on_points, point.surface_jacobian)
        on_normals = carried(pulls, "normals_W")
        if on_normals is not None:
            gradient += np.einsum("ka,kab->b", on_normals, point.normal_jacobian)
        on_distances = carried(pulls, "contact_distances", lambda g: g[:, None] * point.gap_gradients)
        if on_distances is not None:
            gradient += np.einsum("ka,kab->b", on_distances, point.contact_jacobian)
        on_pads = carried(pulls, "pads_W", lambda g: cross(self.pads_W, g))
        if on_pads is not None:
            gradient += np.einsum("ka,kab->b", on_pads, point.k.angular_jacobian(point.contacts.links))
        return gradient

    def _of_links(self, pulls: Pulls) -> Array:
        """Of the links' poses."""
        k, gradient = self.point.k, np.zeros(self.point.moving)
        links = np.arange(len(self.hand.links))
        on_rotations = carried(pulls, "R_WLs", lambda g: rotation_pull(k.R_WLs, g))
        if on_rotations is not None:
            gradient += np.einsum("ka,kab->b", on_rotations, k.angular_jacobian(links))
        on_origins = carried(pulls, "p_WLs")
        if on_origins is not None:
            gradient += k.pull_back_each(links, k.p_WLs, on_origins).sum(0)
        return gradient
