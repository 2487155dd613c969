"""One trial point of a grasp program: a configuration of the hand, contact forces, and what terms read from them.

Everything is computed once for a point and in double precision: link poses, sphere centers, exact distances to the
object, Jacobians with respect to the tangent. The tangent of a point is (w_WH, v_WH, qdot, df), of dimension 6 + n + 3
nc; forces are in W.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdex_drake.arrays import Array
from xdex_drake.hand.kinematics import Configuration
from xdex_drake.scene.tabletop import Scene

FAR = 0.03
"""Spheres further than this from the object's bounding box are not asked for exact distances [m]."""

CLOSE = 0.02
"""Rows of larger gaps have no derivative, and spheres known to be so far off are not asked for distances [m]."""


@dataclass(frozen=True)
class ContactSet:
    """Which spheres of the hand are to touch the object.

    Attributes:
        spheres: Index of each contact's sphere among `hand.spheres`, shape (nc,).
        links: Index of each contact's link, shape (nc,).
        fingers: Index of each contact's finger among `hand.fingers`, shape (nc,).
    """

    spheres: NDArray[np.int64]
    links: NDArray[np.int64]
    fingers: NDArray[np.int64]


@dataclass(frozen=True)
class Point:
    """A trial point.

    Attributes:
        k: The hand's configuration.
        scene: The scene.
        contacts: The contact set.
        forces: Forces on the object, in W, in units of the object's weight, shape (nc, 3).
        memo: What was computed at this point, by name or by the function that did: values and Jacobians of costs and
            constraint blocks, its view.
        known: Centers of all spheres [m], shape (n_spheres, 3), and lower bounds of their gaps [m], shape (n_spheres,),
            at the point from which this one was moved; None where there is none.
    """

    k: Configuration
    scene: Scene
    contacts: ContactSet
    forces: Array
    memo: dict[Any, Any] = field(default_factory=dict, compare=False, repr=False)
    known: tuple[Array, Array] | None = field(default=None, compare=False, repr=False)

    @property
    def size(self) -> int:
        """Dimension of the tangent."""
        return 6 + len(self.k.q) + self.forces.size

    @property
    def moving(self) -> int:
        """Dimension of the part of the tangent that moves the hand: 6 + n."""
        return 6 + len(self.k.q)

    @cached_property
    def centers_W(self) -> Array:
        """Centers of all spheres [m], shape (n_spheres, 3)."""
        hand = self.k.hand
        return self.k.points(hand.sphere_links, hand.spheres[:, :3])

    @cached_property
    def heights(self) -> Array:
        """Gap of each sphere above the table, infinite where there is none [m], shape (n_spheres,)."""
        return self.centers_W[:, 2] - self.k.hand.spheres[:, 3] - self.scene.floor

    def pull_back_spheres(self, spheres: NDArray[np.int64], v_Ws: Array) -> Array:
        """Derivatives of sphere centers along given directions.

        Args:
            spheres: Indices among `hand.spheres`, shape (m,).
            v_Ws: A vector for each, in W, shape (m, 3).

        Returns:
            Rows v_k . (Jacobian of center k), shape (m, 6 + n).
        """
        return self.k.pull_back_each(self.k.hand.sphere_links[spheres], self.centers_W[spheres], v_Ws)

    @cached_property
    def _near(self) -> NDArray[np.int64]:
        centers_O = self.to_object(self.centers_W)
        low, high = self.scene.object.exact.lower, self.scene.object.exact.upper
        reach = FAR + self.k.hand.spheres[:, 3][:, None]
        near = np.all((centers_O > low - reach) & (centers_O < high + reach), axis=1)
        near &= self._foreseen_gaps < CLOSE
        near[self.contacts.spheres] = True
        return np.flatnonzero(near)

    @cached_property
    def _foreseen_gaps(self) -> Array:
        """Lower bounds of all gaps [m]: no distance changes by more than its sphere's center moves."""
        if self.known is None:
            return np.full(len(self.centers_W), -np.inf)
        centers, gaps = self.known
        moved = self.centers_W - centers
        return gaps - np.sqrt(np.einsum("ka,ka->k", moved, moved))

    def _least_gaps(self) -> Array:
        """The same with what is known exactly, for points that come from this one."""
        near, gaps, _ = self.object_distances
        least = np.full(len(self.centers_W), FAR) if self.known is None else self._foreseen_gaps.copy()
        least[near] = gaps
        return least

    def to_object(self, p_WPs: Array) -> Array:
        """Points in the frame of the object [m], shape (m, 3)."""
        return (p_WPs - self.scene.X_WO.translation()) @ self.scene.X_WO.rotation().matrix()

    @cached_property
    def _near_query(self) -> tuple[Array, Array]:
        """Exact distance [m] of the near spheres' centers, and its unit gradient in W."""
        result = self.scene.object.exact.query(self.to_object(self.centers_W[self._near]))
        return result.distance, result.gradient @ self.scene.X_WO.rotation().matrix().T

    @cached_property
    def object_distances(self) -> tuple[NDArray[np.int64], Array, Array]:
        """Spheres near the object: their indices, gaps [m] (center distance less radius), and unit gradients in W."""
        distance, gradient = self._near_query
        return self._near, distance - self.k.hand.spheres[self._near, 3], gradient

    @cached_property
    def contact_centers_W(self) -> Array:
        """Centers of the contact spheres [m], shape (nc, 3)."""
        return self.centers_W[self.contacts.spheres]

    @cached_property
    def _contact_query(self) -> tuple[Array, Array]:
        distance, gradient = self._near_query
        rows = np.searchsorted(self._near, self.contacts.spheres)
        return distance[rows], gradient[rows]

    @property
    def contact_gaps(self) -> Array:
        """Gap of each contact sphere [m], exact, shape (nc,)."""
        return self._contact_query[0] - self.k.hand.spheres[self.contacts.spheres, 3]

    @property
    def gap_gradients(self) -> Array:
        """Exact gradient of each gap with respect to its sphere's center, in W, shape (nc, 3)."""
        return self._contact_query[1]

    @cached_property
    def _smooth_normals(self) -> tuple[Array, Array, Array]:
        """Distance [m], unit normal into the object and its derivative [1/m], by the grid, in W.

        The exact normal of a triangulated surface jumps in its derivative from facet to facet; the grid's, taken a
        finger's radius off the surface, is nearly the same and has a derivative that a solver can use. Certificates use
        the exact one.
        """
        R_WO = self.scene.X_WO.rotation().matrix()
        distance, gradient, slope = self.scene.object.grid.smooth(self.to_object(self.contact_centers_W))
        return distance, -gradient @ R_WO.T, -R_WO @ slope @ R_WO.T

    @property
    def normals_W(self) -> Array:
        """Unit contact normals into the object, shape (nc, 3)."""
        return self._smooth_normals[1]

    @property
    def normal_slopes(self) -> Array:
        """Derivative of each normal with respect to its sphere's center [1/m], shape (nc, 3, 3)."""
        return self._smooth_normals[2]

    @cached_property
    def contacts_W(self) -> Array:
        """Contact points: the surface points nearest to the contact spheres [m], shape (nc, 3)."""
        return self.contact_centers_W + self._smooth_normals[0][:, None] * self.normals_W

    def exact_contacts(self) -> tuple[Array, Array]:
        """Contact points [m] and unit normals into the object by exact distances, in W, each of shape (nc, 3)."""
        distance, gradient = self._contact_query
        return self.contact_centers_W - distance[:, None] * gradient, -gradient

    @cached_property
    def contact_jacobian(self) -> Array:
        """Jacobian of the contact spheres' centers with respect to the configuration, shape (nc, 3, 6 + n)."""
        return self.k.jacobian(self.contacts.links, self.contact_centers_W)

    @cached_property
    def surface_jacobian(self) -> Array:
        """Jacobian of the contact points on the surface, shape (nc, 3, 6 + n)."""
        n = self.normals_W
        distance = self._smooth_normals[0]
        along = np.eye(3) - n[:, :, None] * n[:, None, :] + distance[:, None, None] * self.normal_slopes
        return along @ self.contact_jacobian

    @cached_property
    def normal_jacobian(self) -> Array:
        """Jacobian of the contact normals, shape (nc, 3, 6 + n)."""
        return self.normal_slopes @ self.contact_jacobian

    def moved(self, step: Array) -> Point:
        """The point after a step along its tangent, shape (size,)."""
        n = 6 + len(self.k.q)
        forces = self.forces + step[n:].reshape(-1, 3)
        known = (self.centers_W, self._least_gaps()) if "_near_query" in vars(self) else None
        return Point(self.k.moved(step[:n]), self.scene, self.contacts, forces, known=known)
