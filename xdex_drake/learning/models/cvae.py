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

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from xdex_drake.learning.models.layers import LENGTH_UNIT, Block, PointNet, SparseUNet, TopologyBias, mlp, padding_bias


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


class HandBatch(NamedTuple):
    """Some hands, padded to the same number of links.

    Attributes:
        points: Link clouds in H at the zero configuration [m], shape (H, L, N, 3).
        origins: Link origins in H at the zero configuration [m], shape (H, L, 3).
        spd: Shortest-path distances between links, shape (H, L, L), int64.
        mask: True where a link is real, shape (H, L).
    """

    points: Tensor
    origins: Tensor
    spd: Tensor
    mask: Tensor


class CVAE(nn.Module):
    """The model. Its methods are the steps of Eqs. (3), (4) and (7), and compose freely."""

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
