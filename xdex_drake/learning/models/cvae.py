"""The whole model: a conditional variational autoencoder over the link poses of any hand (section 3.3 of the paper).

    f_l^link = Embodiment(PointNet(P_l), SPD)        what each link is, and where it stands in the tree
    f_p^obj  = SparseUNet(P_O) at the point p        what the object is like around the grasp
    mu, sigma = MLP(max_l Enc([pi_l || f_p^obj]))    Eq. (3); z = mu + sigma eps
    pi_l     = Dec(f_l^link, z || f_p^obj)           Eq. (4)

The latent says how to grasp, the point says where, the links say with what. Where the paper is silent: positions are
relative to the object point p, in the axes of W and in units of 0.1 m; a link's PointNet sees each point from the wrist
and from the link's own origin, which no cloud shows; and p is drawn from a softmax over the object's points, which
depends on the object alone, so that one draw serves every hand.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from xdex_drake.errors import ConfigError
from xdex_drake.learning.losses import (
    embedding_loss,
    keypoint_loss,
    keypoints,
    kl_loss,
    point_loss,
    reconstruction_loss,
)
from xdex_drake.learning.models.layers import Block, PointNet, SparseUNet, TopologyBias, mlp, padding_bias
from xdex_drake.learning.protocol import LENGTH_UNIT, Batch, Clouds, Drawn, HandBatch, LatentModel

PRIOR_TRIES = 8
"""Draws from the prior of which the best counts in validation."""


@dataclass(frozen=True)
class CVAEConfig:
    """Sizes of the model.

    Attributes:
        width: Width d of all tokens and features.
        heads: Heads of every attention.
        latent: Dimensions of z.
        embodiment_layers: Blocks of the embodiment encoder; 0 leaves it out, as an ablation of the paper does.
        encoder_layers: Blocks of the pose encoder.
        decoder_layers: Blocks of the decoder.
        max_distance: Greatest shortest-path distance with a bias of its own.
        object_channels: Channels of the sparse U-Net's levels, the finest first.
        voxel_size: Edge of the finest voxels [m].

    Raises:
        ConfigError: A size is out of bounds, which keep a damaged file from exhausting memory.
    """

    width: int = 96
    heads: int = 4
    latent: int = 32
    embodiment_layers: int = 2
    encoder_layers: int = 2
    decoder_layers: int = 3
    max_distance: int = 16
    object_channels: tuple[int, ...] = (24, 32, 48)
    voxel_size: float = 0.005

    def __post_init__(self) -> None:
        for name, (low, high) in _BOUNDS.items():
            if not low <= getattr(self, name) <= high:
                raise ConfigError(f"{name} is {getattr(self, name)!r}; give {low} to {high}")
        if not 1 <= len(self.object_channels) <= 8 or not all(1 <= c <= 1024 for c in self.object_channels):
            raise ConfigError(f"object_channels is {self.object_channels}; give one to eight numbers in 1 to 1024")
        if self.width % self.heads:
            raise ConfigError(f"width ({self.width}) must be a multiple of heads ({self.heads})")


_BOUNDS = {
    "width": (8, 1024),
    "heads": (1, 64),
    "latent": (1, 1024),
    "embodiment_layers": (0, 32),
    "encoder_layers": (0, 32),
    "decoder_layers": (1, 32),
    "max_distance": (1, 1024),
    "voxel_size": (1e-4, 1.0),
}


class Forward(NamedTuple):
    """What the model made of a batch; see `CVAE` for shapes."""

    links: Tensor
    mask: Tensor
    feature: Tensor
    logits: Tensor
    mean: Tensor
    log_sigma: Tensor


class CVAE(LatentModel):
    """The model. Its methods are the steps of Eqs. (3), (4) and (7), and compose freely.

    Terms of its loss: `reconstruction` and `kl` of Eq. (5); `point`, the cross entropy of the object points; and, of
    pairs, `retargeting`, keypoints of two hands decoded from one latent (lowers success on new hands in the paper),
    `embedding`, the distance of their latent means, and `cross`, the reconstruction of one hand's grasp from the latent
    of its pair, the task of neural retargeting.
    """

    kind = "cvae"
    config_type = CVAEConfig
    weights: ClassVar = {
        "reconstruction": 1.0,
        "kl": 2e-3,
        "point": 0.05,
        "retargeting": 0.0,
        "embedding": 0.0,
        "cross": 0.0,
    }

    def __init__(self, config: CVAEConfig) -> None:
        """Make the model.

        Args:
            config: Its sizes.
        """
        super().__init__()
        self.config = config
        d, h = config.width, config.heads
        self.link_net = PointNet(6, d)
        self.topology = TopologyBias(h, config.max_distance)
        self.embodiment = nn.ModuleList([Block(d, h) for _ in range(config.embodiment_layers)])
        self.object_net = SparseUNet(config.object_channels, d, config.voxel_size)
        self.point_head = mlp(d, d // 2, 1)
        self.pose_token = nn.Linear(9 + d, d)
        self.encoder = nn.ModuleList([Block(d, h) for _ in range(config.encoder_layers)])
        self.latent_head = mlp(d, d, 2 * config.latent)
        self.decoder = nn.ModuleList([Block(d, h, config.latent + d) for _ in range(config.decoder_layers)])
        self.pose_head = nn.Sequential(nn.LayerNorm(d), nn.Linear(d, 9))

    def link_features(self, hands: HandBatch) -> Tensor:
        """Features f^link of the links of some hands.

        Args:
            hands: The hands.

        Returns:
            Features, shape (H, L, d).
        """
        from_link = hands.points - hands.origins[:, :, None, :]
        x = self.link_net(torch.cat([hands.points, from_link], dim=-1) / LENGTH_UNIT)  # (H, L, d)
        bias = self.topology(hands.spd) + padding_bias(hands.mask)
        for block in self.embodiment:
            x = block(x, bias)
        return x

    def point_features(self, clouds: Tensor) -> Tensor:
        """Features f^obj of every point of some objects.

        Args:
            clouds: Points relative to the object's center, axes of W [m], shape (S, N, 3).

        Returns:
            Features, shape (S, N, d).
        """
        return self.object_net(clouds)

    def point_logits(self, features: Tensor) -> Tensor:
        """Log-probability, up to a constant for each object, that a grasp heads for a point.

        Args:
            features: Point features, shape (S, N, d).

        Returns:
            Logits, shape (S, N).
        """
        return self.point_head(features).squeeze(-1)

    def encode(self, poses: Tensor, mask: Tensor, point_feature: Tensor) -> tuple[Tensor, Tensor]:
        """Latent distribution of a grasp, Eq. (3).

        Args:
            poses: Normalised link pose vectors, shape (B, L, 9).
            mask: True where a link is real, shape (B, L).
            point_feature: Feature of the object point, shape (B, d).

        Returns:
            Mean and log standard deviation, shape (B, latent) each.
        """
        L = poses.shape[1]
        x = self.pose_token(torch.cat([poses, point_feature[:, None].expand(-1, L, -1)], dim=-1))  # (B, L, d)
        bias = padding_bias(mask)
        for block in self.encoder:
            x = block(x, bias)
        pooled = x.masked_fill(~mask[:, :, None], -torch.inf).amax(dim=1)  # (B, d)
        mean, log_sigma = self.latent_head(pooled).chunk(2, dim=-1)
        return mean, log_sigma.clamp(-8.0, 4.0)

    def decode(self, links: Tensor, mask: Tensor, z: Tensor, point_feature: Tensor) -> Tensor:
        """Link poses of a grasp, Eq. (4).

        Args:
            links: Link features, shape (B, L, d).
            mask: True where a link is real, shape (B, L).
            z: Latents, shape (B, latent).
            point_feature: Feature of the object point, shape (B, d).

        Returns:
            Normalised link pose vectors, shape (B, L, 9); rows of padded links mean nothing.
        """
        source = torch.cat([z, point_feature], dim=-1)  # (B, latent + d)
        bias, x = padding_bias(mask), links
        for block in self.decoder:
            x = block(x, bias, source)
        return self.pose_head(x)

    def forward(self, batch: Batch) -> Forward:
        """Features and latent distributions of a batch.

        Args:
            batch: The batch.

        Returns:
            They.
        """
        links = self.link_features(batch.hands).index_select(0, batch.hand)  # (B, L, d)
        features = self.point_features(batch.clouds.points)  # (S, N, d)
        S, N, d = features.shape
        feature = features.view(S * N, d).index_select(0, batch.cloud * N + batch.point)  # (B, d)
        mean, log_sigma = self.encode(batch.poses, batch.mask, feature)
        return Forward(links, batch.mask, feature, self.point_logits(features), mean, log_sigma)

    def loss(self, batch: Batch, terms: Collection[str], rng: np.random.Generator) -> dict[str, Tensor]:
        """Terms of the loss; those of pairs are left out where a batch has none. See `Model`."""
        f = self(batch)
        z = f.mean + f.log_sigma.exp() * _normal(rng, f.mean)
        predicted = self.decode(f.links, f.mask, z, f.feature)
        values = {
            "reconstruction": reconstruction_loss(predicted, batch.poses, f.mask),
            "kl": kl_loss(f.mean, f.log_sigma),
            "point": point_loss(f.logits, batch.point_weights),
            **self._pair_losses(batch, f, z, predicted, terms),
        }
        return {name: value for name, value in values.items() if name in terms}

    def _pair_losses(
        self, batch: Batch, f: Forward, z: Tensor, predicted: Tensor, terms: Collection[str]
    ) -> dict[str, Tensor]:
        first = 2 * batch.paired.nonzero().squeeze(1)  # first of each paired couple; its mate follows
        if len(first) == 0:
            return {}
        second = first + 1
        values = {"embedding": embedding_loss(f.mean[first], f.mean[second])}
        if "cross" not in terms and "retargeting" not in terms:
            return values
        # Each decodes the other's latent, at its own snapped point: a pair shares the true one.
        own, mate = torch.cat([first, second]), torch.cat([second, first])
        crossed = self.decode(f.links[own], f.mask[own], z[mate], f.feature[own])
        values["cross"] = reconstruction_loss(crossed, batch.poses[own], f.mask[own])
        link, offset, has = (entry[batch.hand] for entry in batch.keypoints)
        values["retargeting"] = keypoint_loss(
            keypoints(crossed, link[own], offset[own]),
            keypoints(predicted[mate], link[mate], offset[mate]),
            has[own] & has[mate],
        )
        return values

    def reconstruct(self, batch: Batch, rng: np.random.Generator) -> dict[str, Tensor]:
        """Grasps of a batch from their own latent means, from those of their pairs, and from the prior. See `Model`."""
        f = self(batch)
        crossed = self.decode(f.links, f.mask, f.mean.view(-1, 2, f.mean.shape[1]).flip(1).flatten(0, 1), f.feature)
        alone = ~batch.paired.repeat_interleave(2)
        prior = [self.decode(f.links, f.mask, _normal(rng, f.mean), f.feature) for _ in range(PRIOR_TRIES)]
        return {
            "posterior": self.decode(f.links, f.mask, f.mean, f.feature)[None],
            "prior": torch.stack(prior),
            "cross": crossed.masked_fill(alone[:, None, None], torch.nan)[None],
        }

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
        """Draws object points and latents, which depend on the object alone, and decodes them. See `Model`."""
        features = self.point_features(cloud.points)
        probability = torch.softmax(self.point_logits(features)[0].double(), dim=0).cpu().numpy()
        drawn = torch.as_tensor(rng.choice(len(probability), count, p=probability / probability.sum()))
        points = drawn.to(features.device) if points is None else points
        z = temperature * _normal(rng, features.new_empty(count, self.config.latent))
        return Drawn(self._decode_one_hand(hand, features[0, points], z), points, z)

    def encode_grasps(self, hand: HandBatch, cloud: Clouds, poses: Tensor, points: Tensor) -> Tensor:
        """Latent means of given grasps. See `LatentModel`."""
        features = self.point_features(cloud.points)[0]
        return self.encode(poses, hand.mask.expand(len(poses), -1), features[points])[0]

    def decode_grasps(self, hand: HandBatch, cloud: Clouds, latents: Tensor, points: Tensor) -> Tensor:
        """The grasps of given latents. See `LatentModel`."""
        return self._decode_one_hand(hand, self.point_features(cloud.points)[0, points], latents)

    def _decode_one_hand(self, hand: HandBatch, point_feature: Tensor, z: Tensor) -> Tensor:
        links = self.link_features(hand).expand(len(z), -1, -1)
        return self.decode(links, hand.mask.expand(len(z), -1), z, point_feature)


def _normal(rng: np.random.Generator, like: Tensor) -> Tensor:
    """Standard normal draws in the shape of a tensor; the same on every device."""
    return torch.as_tensor(rng.standard_normal(like.shape), dtype=like.dtype, device=like.device)
