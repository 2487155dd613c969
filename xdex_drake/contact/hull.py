"""An incremental convex hull for cutting planes in a few dimensions, in NumPy.

Qhull's incremental mode gives up (and can end the process) on the nearly coplanar points that friction cones produce.
Here a point on the plane of a facet, to rounding, simply does not see it.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from xdex_drake.arrays import Array

_EPSILON = 1e-11


@lru_cache(maxsize=8)
def _labels(capacity: int) -> NDArray[np.int64]:
    """A random number for each point: their sum over a ridge's points is the ridge's key."""
    return np.random.default_rng(0).integers(2**62, size=capacity)


@lru_cache(maxsize=8)
def _others(k: int) -> NDArray[np.int64]:
    """Row j: 0 .. k - 1 without j, shape (k, k - 1)."""
    columns = np.arange(k - 1)
    return columns + (columns >= np.arange(k)[:, None])


class GrowingHull:
    """Convex hull of points that are added one after the other (beneath-beyond, simplicial facets).

    Attributes:
        points: The points, shape (capacity, d); the first `count` are valid.
        count: Number of points.
        planes: Facets n . x = b as rows (n, -b), |n| = 1, n outward, shape (capacity, d + 1).
        offsets: Distances b of the facets' planes from 0, negative where 0 is outside; inf for dead facets.
        vertices: Indices of each facet's points, ascending, shape (capacity, d).
        size: Number of facet rows in use, dead ones among them.
    """

    def __init__(self, points: Array) -> None:
        """Start with the d + 1 most independent of the given points.

        Args:
            points: Candidates, shape (m, d).

        Raises:
            ValueError: The points do not span d dimensions.
        """
        d = points.shape[1]
        first = int(np.argmax((points * points).sum(axis=1)))
        _, R, order = qr((points - points[first]).T, mode="economic", pivoting=True)  # pyright: ignore
        if len(points) <= d or abs(R[d - 1, d - 1]) < 1e-9 * abs(R[0, 0]):
            raise ValueError("the points do not span the space")
        self.start = np.concatenate([[first], order[:d]])
        capacity = 512
        self.points = np.zeros((256, d))
        self.points[: d + 1] = points[self.start]
        self.count, self.size = d + 1, d + 1
        self.planes = np.zeros((capacity, d + 1))
        self.offsets = np.full(capacity, np.inf)
        self.vertices = np.zeros((capacity, d), dtype=np.int64)
        self._dead = np.append(np.zeros(d), -1.0)  # a plane that no point sees
        self.neighbors = np.zeros((capacity, d), dtype=np.int64)  # facet beyond the ridge opposite vertex j
        # On facet i the barycentric coordinate of point i, affine in x, is zero; beyond it is negative.
        barycentric = np.linalg.inv(np.vstack([self.points[: d + 1].T, np.ones(d + 1)]))
        planes = -barycentric / np.sqrt((barycentric[:, :d] ** 2).sum(axis=1))[:, None]
        self.planes[: d + 1], self.offsets[: d + 1] = planes, -planes[:, d]
        self.vertices[: d + 1] = self.neighbors[: d + 1] = _others(d + 1)

    def add(self, point: Array) -> bool:
        """Add a point.

        Args:
            point: The point, shape (d,).

        Returns:
            Whether the hull grew; False where the point is inside, or on a facet to rounding.
        """
        d, size = len(point), self.size
        height = self.planes[:size, :d] @ point + self.planes[:size, d]
        seen = np.flatnonzero(height > _EPSILON)
        if len(seen) == 0:
            return False
        # Horizon ridges: between a visible facet and a hidden one.
        beyond = self.neighbors[seen]
        row, slot = np.nonzero(height[beyond] <= _EPSILON)
        inner, outer = seen[row], beyond[row, slot]
        m = len(row)
        ridges = self.vertices[inner[:, None], _others(d)[slot]]  # (m, d - 1)
        # Pair up the new facets over the ridges that contain the new point: d - 1 keys each, each key twice. Two ridges
        # with the same key by chance would be noticed, and have a probability of 1e-14.
        labels = _labels(len(self.points))[ridges]
        keys = (labels.sum(axis=1)[:, None] - labels).ravel()
        order = keys.argsort()
        ranked = keys[order]
        if len(ranked) % 2 or (ranked[::2] != ranked[1::2]).any() or (ranked[2::2] == ranked[:-2:2]).any():
            return False  # rounding broke the horizon: leave the point out, the hull stays a valid inner one
        self._reserve(m)
        new = np.arange(size, size + m)
        # The plane through ridge and point is a nonnegative combination of the ridge's two planes.
        up, down = height[inner][:, None], np.minimum(height[outer], 0.0)[:, None]
        planes = up * self.planes[outer] - down * self.planes[inner]
        planes /= np.sqrt((planes[:, :d] ** 2).sum(axis=1))[:, None]
        self.planes[new], self.offsets[new] = planes, -planes[:, d]
        self.vertices[new, : d - 1], self.vertices[new, d - 1] = ridges, self.count
        self.neighbors[new, d - 1] = outer
        first, second = order[0::2], order[1::2]
        self.neighbors[size + first // (d - 1), first % (d - 1)] = size + second // (d - 1)
        self.neighbors[size + second // (d - 1), second % (d - 1)] = size + first // (d - 1)
        self.neighbors[outer, (self.neighbors[outer] == inner[:, None]).argmax(axis=1)] = new
        self.planes[seen], self.offsets[seen] = self._dead, np.inf
        self.points[self.count] = point
        self.count, self.size = self.count + 1, size + m
        return True

    def nearest(self) -> int:
        """Index of the facet whose plane has the least offset from 0."""
        return int(self.offsets[: self.size].argmin())

    def reach(self, directions: Array) -> Array:
        """Distance along rays from 0, which is inside, to each facet's plane; inf where a ray does not cross it.

        Args:
            directions: Directions of the rays, shape (k, d).

        Returns:
            Distances in units of the directions' lengths, shape (k, size).
        """
        along = directions @ self.planes[: self.size, :-1].T
        return np.where(along > 1e-12, self.offsets[: self.size] / np.maximum(along, 1e-12), np.inf)

    def _reserve(self, m: int) -> None:
        """Make room for m facets and one point."""
        if self.size + m > len(self.planes):
            extra = max(len(self.planes), m)
            d = self.vertices.shape[1]
            self.planes = np.vstack([self.planes, np.zeros((extra, d + 1))])
            self.offsets = np.append(self.offsets, np.full(extra, np.inf))
            self.vertices = np.vstack([self.vertices, np.zeros((extra, d), dtype=np.int64)])
            self.neighbors = np.vstack([self.neighbors, np.zeros((extra, d), dtype=np.int64)])
        if self.count == len(self.points):
            self.points = np.vstack([self.points, np.zeros_like(self.points)])
