"""What the trainer and the predictor know of a model, and what a model is given.

Poses are normalised link pose vectors: the origin of a link's frame G from the object point p in units of 0.1 m, then
the first two columns of its rotation R_WG; axes of W. G has the axes of H in the hand's rest posture and its origin at
the mean of the link's points (see `features`). A model that predicts other coordinates turns them into these.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

LENGTH_UNIT = 0.1
"""Metres that make one unit inside the networks."""


class HandBatch(NamedTuple):
    """Some hands: T links in all, hand by hand, in the row-major order of `mask`. The base is a hand's first link.

    Attributes:
        points: Link clouds in H at the rest posture [m], shape (T, N, 3).
        normals: Unit normals out of the links there, zero for a link without geometry, shape (T, N, 3).
        centers: Origins of the links' frames G in H at the rest posture [m], shape (T, 3).
        joints: How each link's own joint moves it; see `features`, shape (T, 14).
        spd: Shortest-path distances between links, padded, shape (H, L, L), int64.
        mask: True where a link is real, shape (H, L).
    """

    points: Tensor
    normals: Tensor
    centers: Tensor
    joints: Tensor
    spd: Tensor
    mask: Tensor


class Keypoints(NamedTuple):
    """Wrist and fingertips of some hands; keypoint k of two hands has one name.

    Attributes:
        links: Link of each keypoint, shape (H, K), int64.
        offsets: From the origin of the link's G to the keypoint, axes of G, in units of 0.1 m, shape (H, K, 3).
        mask: True where the hand has the keypoint, shape (H, K).
    """

    links: Tensor
    offsets: Tensor
    mask: Tensor


class Clouds(NamedTuple):
    """Some objects.

    Attributes:
        points: Points on their surfaces relative to their centers, axes of W [m], shape (S, N, 3).
        normals: Unit normals out of the objects, zero where unknown, shape (S, N, 3).
        tables: Height of the table over the center, negative as a rule [m], shape (S,).
    """

    points: Tensor
    normals: Tensor
    tables: Tensor


class Batch(NamedTuple):
    """A step's data. Grasps 2 i and 2 i + 1 are a couple, where possible two versions of one grasp.

    Attributes:
        hands: The hands of the step.
        keypoints: Their keypoints.
        hand: Hand of each grasp among them, shape (B,).
        clouds: The scenes.
        cloud: Scene of each grasp among them, shape (B,).
        point: Conditioned point of each grasp in its cloud, shape (B,).
        point_weights: How much each point is headed for by all grasps of its scene, shape (S, N).
        poses: Normalised link pose vectors, shape (B, L, 9); rows of padded links mean nothing.
        paired: True where a couple is a pair, shape (B / 2,).
    """

    hands: HandBatch
    keypoints: Keypoints
    hand: Tensor
    clouds: Clouds
    cloud: Tensor
    point: Tensor
    point_weights: Tensor
    poses: Tensor
    paired: Tensor

    @property
    def mask(self) -> Tensor:
        """True where a link of a grasp is real, shape (B, L)."""
        return self.hands.mask[self.hand]


class Drawn(NamedTuple):
    """Grasps that a model has drawn for one hand and one object.

    Attributes:
        poses: Normalised link pose vectors, shape (count, L, 9).
        points: Index of the object point of each, shape (count,), int64.
        latents: What else was drawn for each, shape (count, D); D may be 0.
    """

    poses: Tensor
    points: Tensor
    latents: Tensor


class Model(nn.Module, ABC):
    """A model of grasps: what it learns from a batch, and how it draws grasps.

    What a model draws at random it draws from the generator that it is given, so that every step repeats.

    Attributes:
        kind: Name of the model in checkpoints and configurations.
        config_type: Dataclass of its settings, which refuses values out of bounds by a `ConfigError`.
        weights: Every term of its loss with its weight, 0 for an option.
        config: Its settings.
    """

    kind: ClassVar[str]
    config_type: ClassVar[type]
    weights: ClassVar[Mapping[str, float]]
    config: Any

    @abstractmethod
    def loss(self, batch: Batch, terms: Collection[str], rng: np.random.Generator) -> dict[str, Tensor]:
        """Terms of the loss, without their weights.

        Args:
            batch: The batch.
            terms: The terms to compute, of those in `weights`.
            rng: Generator of what the model draws.

        Returns:
            Means over the batch, shape () each; a term that the batch says nothing about may be left out.
        """

    @abstractmethod
    def reconstruct(self, batch: Batch, rng: np.random.Generator) -> dict[str, Tensor]:
        """What the model makes of grasps it is shown, for validation.

        Args:
            batch: The batch.
            rng: Generator of what the model draws.

        Returns:
            Poses by what they were made from, of which the best of T tries counts, shape (T, B, L, 9) each; not a
            number where there is nothing to make them from. `prior` needs to know the object point alone.
        """

    @abstractmethod
    def sample(
        self,
        hand: HandBatch,
        cloud: Clouds,
        count: int,
        rng: np.random.Generator,
        *,
        temperature: float = 1.0,
        points: Tensor | None = None,
    ) -> Drawn:
        """Draws grasps.

        Args:
            hand: One hand.
            cloud: One object.
            count: Number of grasps.
            rng: Generator. What does not depend on the hand is drawn alike for every hand.
            temperature: Factor on what is drawn from a normal distribution; 0 gives the most typical grasps.
            points: Indices of the object points to head for instead of drawn ones, shape (count,).

        Returns:
            The grasps.
        """


class LatentModel(Model):
    """A model whose latent says how to grasp, whatever the hand: it can carry a grasp from one hand to another."""

    @abstractmethod
    def encode_grasps(self, hand: HandBatch, cloud: Clouds, poses: Tensor, points: Tensor) -> Tensor:
        """The most likely latents of given grasps.

        Args:
            hand: One hand.
            cloud: One object.
            poses: Normalised link pose vectors, shape (count, L, 9).
            points: Indices of their object points, shape (count,).

        Returns:
            Latents, shape (count, D).
        """

    @abstractmethod
    def decode_grasps(self, hand: HandBatch, cloud: Clouds, latents: Tensor, points: Tensor) -> Tensor:
        """The grasps of given latents.

        Args:
            hand: One hand.
            cloud: One object.
            latents: Latents, shape (count, D).
            points: Indices of the object points, shape (count,).

        Returns:
            Normalised link pose vectors, shape (count, L, 9).
        """


def normalize_poses(vectors: Tensor, p_WPoints: Tensor) -> Tensor:
    """Link pose vectors as the networks see them: positions from the object point, in units of 0.1 m.

    Args:
        vectors: Link pose vectors, positions in the frame of `p_WPoints` [m], shape (B, L, 9).
        p_WPoints: Object points [m], shape (B, 3).

    Returns:
        Normalised vectors, shape (B, L, 9).
    """
    return torch.cat([(vectors[..., :3] - p_WPoints[:, None]) / LENGTH_UNIT, vectors[..., 3:]], dim=-1)


def denormalize_poses(poses: Tensor, p_WPoints: Tensor) -> Tensor:
    """Inverse of `normalize_poses`.

    Args:
        poses: Normalised vectors, shape (B, L, 9).
        p_WPoints: Object points [m], shape (B, 3).

    Returns:
        Link pose vectors with positions in the frame of `p_WPoints` [m], shape (B, L, 9).
    """
    return torch.cat([poses[..., :3] * LENGTH_UNIT + p_WPoints[:, None], poses[..., 3:]], dim=-1)
