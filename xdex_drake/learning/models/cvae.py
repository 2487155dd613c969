"""The whole model: a conditional variational autoencoder over the link poses of any hand (section 3.3 of the paper).

    f_l^link = Embodiment(PointNet(P_l), SPD)        what each link is, and where it stands in the tree
    f_p^obj  = SparseUNet(P_O) at the point p        what the object is like around the grasp
    mu, sigma = MLP(max_l Enc([pi_l || f_p^obj]))    Eq. (3); z = mu + sigma eps
    pi_l     = Dec(f_l^link, z || f_p^obj)           Eq. (4)

The latent says how to grasp, the point says where, the links say with what. Where the paper is silent: link poses are
those of frames that no choice of a description's author can move (see `features`), relative to the object point p, in
the axes of W and in units of 0.1 m. The base's token tells the wrist's pose, every other link's how far it has moved
from its rest pose relative to the palm; all heads start at zero, so that an untrained model gives the hand at rest. The
point p is drawn from a softmax over the object's points, which depends on the object alone, so that one draw serves
every hand.
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
    rotations_from_columns,
)
from xdex_drake.learning.models.layers import Block, PointNet, Ragged, SparseUNet, TopologyBias, mlp
from xdex_drake.learning.pack import JOINT_FEATURES
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
        joints: Whether links come with their joint's axis and limits, besides their points.
        swap: Share of the couples of a batch in which each grasp is decoded from the latent of the other.
        free_bits: Divergence of each dimension of z that costs nothing [nat].

    Raises:
        ConfigError: A size is out of bounds, which keep a damaged file from exhausting memory.
    """

    width: int = 160
    heads: int = 4
    latent: int = 32
    embodiment_layers: int = 3
    encoder_layers: int = 3
    decoder_layers: int = 4
    max_distance: int = 16
    object_channels: tuple[int, ...] = (24, 32, 48, 64)
    voxel_size: float = 0.005
    joints: bool = True
    swap: float = 0.0
    free_bits: float = 0.01

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
    "swap": (0.0, 1.0),
    "free_bits": (0.0, 10.0),
}


class Links(NamedTuple):
    """The links of some grasps' hands, T in all.

    Attributes:
        features: Features f^link, shape (T, d).
        sets: Which of them belong to one grasp.
        centers: Origins of their frames G in H at rest, in units of 0.1 m, padded, shape (B, L, 3).
    """

    features: Tensor
    sets: Ragged
    centers: Tensor

    def of_grasps(self, hand: Tensor) -> "Links":
        """The links of grasps by hands; `self` has every hand once.

        Args:
            hand: Hand of each grasp, shape (B,).

        Returns:
            The same with an entry for each grasp.
        """
        sets = Ragged.of(self.sets.mask[hand])
        rows = self.sets.padded.view(self.sets.mask.shape)[hand].flatten().index_select(0, sets.inside)
        return Links(self.features.index_select(0, rows), sets, self.centers[hand])


class Forward(NamedTuple):
    """What the model made of a batch; see `CVAE` for shapes."""

    links: Links
    feature: Tensor
    logits: Tensor
    mean: Tensor
    log_sigma: Tensor


class CVAE(LatentModel):
    """The model. Its methods are the steps of Eqs. (3), (4) and (7), and compose freely.

    Terms of its loss: `reconstruction` and `kl` of Eq. (5); `tips`, the squared error of fingertips and wrist, which
    decide what a grasp does; `point`, the cross entropy of the object points; and, of pairs, `retargeting`, keypoints
    of two hands decoded from one latent (lowers success on new hands in the paper), `embedding`, the distance of their
    latent means, and `cross`, the reconstruction of one hand's grasp from the latent of its pair, the task of neural
    retargeting.
    """

    kind = "cvae"
    config_type = CVAEConfig
    weights: ClassVar = {
        "reconstruction": 1.0,
        "tips": 4.0,
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
        self.link_net = PointNet(6, d, 3 + JOINT_FEATURES * config.joints)
        self.base = nn.Parameter(torch.randn(d) * 0.02)
        self.topology = TopologyBias(h, config.max_distance)
        self.embodiment = nn.ModuleList([Block(d, h) for _ in range(config.embodiment_layers)])
        self.object_net = SparseUNet(config.object_channels, d, config.voxel_size)
        self.point_head = mlp(d, d // 2, 1)
        self.pose_token, self.object_token = nn.Linear(9, d), nn.Linear(d, d)
        self.encoder = nn.ModuleList([Block(d, h) for _ in range(config.encoder_layers)])
        self.latent_head = mlp(d, d, 2 * config.latent)
        self.decoder = nn.ModuleList([Block(d, h, config.latent + d) for _ in range(config.decoder_layers)])
        self.leave = nn.LayerNorm(d)
        self.wrist_head, self.link_head = nn.Linear(d, 9), nn.Linear(d, 9)
        for head in (self.wrist_head, self.link_head):
            nn.init.zeros_(head.weight)
            nn.init.zeros_(head.bias)

    def links(self, hands: HandBatch) -> Links:
        """The links of some hands with their features f^link.

        Args:
            hands: The hands.

        Returns:
            They.
        """
        sets = Ragged.of(hands.mask)
        centers = hands.centers / LENGTH_UNIT  # (T, 3)
        points = torch.cat([(hands.points - hands.centers[:, None]) / LENGTH_UNIT, hands.normals], dim=-1)
        x = self.link_net(points, torch.cat([centers, hands.joints], dim=1) if self.config.joints else centers)
        is_base = sets.inside % hands.mask.shape[1] == 0
        x = x + is_base[:, None] * self.base
        bias = self.topology(hands.spd) + sets.bias()
        for block in self.embodiment:
            x = block(x, sets, bias)
        return Links(x, sets, sets.pad(centers))

    def point_features(self, clouds: Clouds) -> Tensor:
        """Features f^obj of every point of some objects.

        Args:
            clouds: The objects.

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
        return self.point_head(features).squeeze(-1).float()

    def encode(self, poses: Tensor, mask: Tensor, point_feature: Tensor) -> tuple[Tensor, Tensor]:
        """Latent distribution of a grasp, Eq. (3).

        Args:
            poses: Normalised link pose vectors, shape (B, L, 9).
            mask: True where a link is real, shape (B, L).
            point_feature: Feature of the object point, shape (B, d).

        Returns:
            Mean and log standard deviation, shape (B, latent) each.
        """
        sets = Ragged.of(mask)
        # A linear map of [pi_l || f_p^obj], the part of f_p^obj once a grasp.
        x = self.pose_token(sets.unpad(poses)) + self.object_token(point_feature).index_select(0, sets.owner)
        bias = sets.bias()
        for block in self.encoder:
            x = block(x, sets, bias)
        pooled = sets.pad(x).masked_fill(~mask[:, :, None], -torch.inf).amax(dim=1)  # (B, d)
        mean, log_sigma = self.latent_head(pooled).float().chunk(2, dim=-1)
        return mean, log_sigma.clamp(-8.0, 4.0)

    def decode(self, links: Links, z: Tensor, point_feature: Tensor) -> Tensor:
        """Link poses of a grasp, Eq. (4).

        Args:
            links: The links.
            z: Latents, shape (B, latent).
            point_feature: Feature of the object point, shape (B, d).

        Returns:
            Normalised link pose vectors, shape (B, L, 9); rows of padded links mean nothing.
        """
        source = torch.cat([z, point_feature], dim=-1)  # (B, latent + d)
        sets, x = links.sets, links.features
        bias = sets.bias()
        for block in self.decoder:
            x = block(x, sets, bias, source)
        x = sets.pad(self.leave(x))
        return compose(self.wrist_head(x[:, 0]).float(), self.link_head(x).float(), links.centers)

    def forward(self, batch: Batch) -> Forward:
        """Features and latent distributions of a batch.

        Args:
            batch: The batch.

        Returns:
            They.
        """
        links = self.links(batch.hands).of_grasps(batch.hand)
        features = self.point_features(batch.clouds)  # (S, N, d)
        S, N, d = features.shape
        feature = features.view(S * N, d).index_select(0, batch.cloud * N + batch.point)  # (B, d)
        mean, log_sigma = self.encode(batch.poses, batch.mask, feature)
        return Forward(links, feature, self.point_logits(features), mean, log_sigma)

    def loss(self, batch: Batch, terms: Collection[str], rng: np.random.Generator) -> dict[str, Tensor]:
        """Terms of the loss; those of pairs are left out where a batch has none. See `Model`."""
        f = self(batch)
        z = f.mean + f.log_sigma.exp() * _normal(rng, f.mean)
        if self.config.swap > 0.0:
            chosen = torch.as_tensor(rng.random(len(batch.paired)) < self.config.swap, device=z.device)
            swapped = (chosen & batch.paired).repeat_interleave(2)
            predicted = self.decode(f.links, torch.where(swapped[:, None], _mates(z), z), f.feature)
        else:
            predicted = self.decode(f.links, z, f.feature)
        link, offset, has = (entry[batch.hand] for entry in batch.keypoints)
        tips = keypoints(predicted, link, offset), keypoints(batch.poses, link, offset)
        values = {
            "reconstruction": reconstruction_loss(predicted, batch.poses, batch.mask),
            "tips": keypoint_loss(*tips, has),
            "kl": kl_loss(f.mean, f.log_sigma, self.config.free_bits),
            "point": point_loss(f.logits, batch.point_weights),
            **self._pair_losses(batch, f, z, tips[0], terms),
        }
        return {name: value for name, value in values.items() if name in terms}

    def _pair_losses(
        self, batch: Batch, f: Forward, z: Tensor, predicted_keypoints: Tensor, terms: Collection[str]
    ) -> dict[str, Tensor]:
        first = 2 * batch.paired.nonzero().squeeze(1)  # first of each paired couple; its mate follows
        if len(first) == 0:
            return {}
        values = {"embedding": embedding_loss(f.mean[first], f.mean[first + 1])}
        if "cross" not in terms and "retargeting" not in terms:
            return values
        # Each decodes the other's latent, at its own snapped point: a pair shares the true one.
        crossed = self.decode(f.links, _mates(z), f.feature)
        paired = torch.cat([first, first + 1])
        values["cross"] = reconstruction_loss(crossed[paired], batch.poses[paired], batch.mask[paired])
        link, offset, has = (entry[batch.hand] for entry in batch.keypoints)
        values["retargeting"] = keypoint_loss(
            keypoints(crossed, link, offset)[paired],
            _mates(predicted_keypoints)[paired],
            (has & _mates(has))[paired],
        )
        return values

    def reconstruct(self, batch: Batch, rng: np.random.Generator) -> dict[str, Tensor]:
        """Grasps of a batch from their own latent means, from those of their pairs, and from the prior. See `Model`."""
        f = self(batch)
        crossed = self.decode(f.links, _mates(f.mean), f.feature)
        alone = ~batch.paired.repeat_interleave(2)
        prior = [self.decode(f.links, _normal(rng, f.mean), f.feature) for _ in range(PRIOR_TRIES)]
        return {
            "posterior": self.decode(f.links, f.mean, f.feature)[None],
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
        features = self.point_features(cloud)
        probability = torch.softmax(self.point_logits(features)[0].double(), dim=0).cpu().numpy()
        drawn = torch.as_tensor(rng.choice(len(probability), count, p=probability / probability.sum()))
        points = drawn.to(features.device) if points is None else points
        z = temperature * _normal(rng, features.new_empty(count, self.config.latent))
        return Drawn(self._decode_one_hand(hand, features[0, points], z), points, z)

    def encode_grasps(self, hand: HandBatch, cloud: Clouds, poses: Tensor, points: Tensor) -> Tensor:
        """Latent means of given grasps. See `LatentModel`."""
        features = self.point_features(cloud)[0]
        return self.encode(poses, hand.mask.expand(len(poses), -1), features[points])[0]

    def decode_grasps(self, hand: HandBatch, cloud: Clouds, latents: Tensor, points: Tensor) -> Tensor:
        """The grasps of given latents. See `LatentModel`."""
        return self._decode_one_hand(hand, self.point_features(cloud)[0, points], latents)

    def _decode_one_hand(self, hand: HandBatch, point_feature: Tensor, z: Tensor) -> Tensor:
        hand_of = torch.zeros(len(z), dtype=torch.long, device=z.device)
        return self.decode(self.links(hand).of_grasps(hand_of), z, point_feature)


def compose(wrist: Tensor, moved: Tensor, centers: Tensor) -> Tensor:
    """Link pose vectors from the wrist's pose and what links have moved since the rest posture, relative to the palm.

    Rotations are told by what is added to the first two columns of the identity.

    Args:
        wrist: Origin of H from the object point and rotation R_WH, shape (B, 9).
        moved: Displacement of the origin of each G, and its rotation, in H; the base's are not used, shape (B, L, 9).
        centers: Origins of G in H at rest, shape (B, L, 3); all lengths in units of 0.1 m.

    Returns:
        Normalised link pose vectors, shape (B, L, 9).
    """
    identity = torch.eye(3, device=wrist.device).T[:2].flatten()
    R_WH = rotations_from_columns(wrist[:, 3:] + identity)  # (B, 3, 3)
    moved = torch.cat([torch.zeros_like(moved[:, :1]), moved[:, 1:]], dim=1)
    R_HGs = rotations_from_columns(moved[..., 3:] + identity)  # (B, L, 3, 3)
    columns = R_WH[:, None] @ R_HGs[..., :2]  # (B, L, 3, 2)
    p_WGs = wrist[:, None, :3] + (centers + moved[..., :3]) @ R_WH.transpose(-1, -2)
    return torch.cat([p_WGs, columns[..., 0], columns[..., 1]], dim=-1)


def _mates(x: Tensor) -> Tensor:
    """Rows of the other grasp of each couple."""
    return x.unflatten(0, (-1, 2)).flip(1).flatten(0, 1)


def _normal(rng: np.random.Generator, like: Tensor) -> Tensor:
    """Standard normal draws in the shape of a tensor; the same on every device."""
    return torch.as_tensor(rng.standard_normal(like.shape), dtype=like.dtype, device=like.device)
