"""Reads and draws from checkpoints of the first kind of model, whose links stood as their files put them.

It saw link clouds in H at the zero configuration and predicted the origins of link frames; `models.cvae` does neither.
It can be drawn from, no more. This module goes when the checkpoint that the library ships is of the newer kind.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from xdex_drake.errors import CheckpointError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.kinematics import zero_configuration
from xdex_drake.learning.features import POINTS_PER_LINK, sample_shapes, shortest_path_distances
from xdex_drake.learning.losses import rotations_from_columns
from xdex_drake.learning.models.layers import Block, Ragged, SparseUNet, TopologyBias, mlp
from xdex_drake.learning.pack import ObjectFeatures
from xdex_drake.learning.protocol import LENGTH_UNIT, Clouds
from xdex_drake.learning.tensor_file import FileType, describe, read_arrays
from xdex_drake.programs.inverse_kinematics import IkResult
from xdex_drake.programs.link_pose_ik import link_pose_ik
from xdex_drake.typed_yaml import from_plain

_FILE = FileType("checkpoint", "train one with `xdex train`, or name its folder", "get the file again")
_ONLY_TRAINED = ("encoder.", "pose_token.", "latent_head.")


@dataclass(frozen=True)
class FirstConfig:
    """Sizes; see `models.cvae.CVAEConfig`."""

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
        sizes = (self.width, self.heads, self.latent, self.embodiment_layers, self.decoder_layers, self.max_distance)
        if not (all(0 <= n <= 1024 for n in (*sizes, *self.object_channels)) and self.heads and self.object_channels):
            raise CheckpointError("the sizes of the model are out of bounds")


class _FirstUNet(SparseUNet):
    """A point was its position from the object's center, its place in its voxel, its height over the lowest point."""

    def inputs(self, clouds: Clouds, within: Tensor) -> Tensor:
        """See `SparseUNet.inputs`."""
        points = clouds.points
        height = (points[..., 2] - points[..., 2].amin(dim=1, keepdim=True)).flatten()[:, None]
        return torch.cat([points.flatten(0, 1) / LENGTH_UNIT, within, height / LENGTH_UNIT], dim=1)


class _FirstPointNet(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.shared, self.after = mlp(6, width // 2, width), mlp(width, width, width)


class FirstModel(nn.Module):
    """The decoder of the first model, and what it needs."""

    def __init__(self, config: FirstConfig) -> None:
        """Make the model.

        Args:
            config: Its sizes.
        """
        super().__init__()
        self.config = config
        d, h = config.width, config.heads
        self.link_net, self.topology = _FirstPointNet(d), TopologyBias(h, config.max_distance)
        self.embodiment = nn.ModuleList([Block(d, h) for _ in range(config.embodiment_layers)])
        self.object_net = _FirstUNet(config.object_channels, d, config.voxel_size)
        self.point_head = mlp(d, d // 2, 1)
        self.decoder = nn.ModuleList([Block(d, h, config.latent + d) for _ in range(config.decoder_layers)])
        self.pose_head = nn.Sequential(nn.LayerNorm(d), nn.Linear(d, 9))

    @torch.inference_mode()
    def configurations(self, hand: Hand, object: ObjectFeatures, count: int, seed: int) -> IkResult:
        """Draws link poses and solves inverse kinematics.

        Args:
            hand: The hand.
            object: The object.
            count: Number of grasps.
            seed: Seed of the draw; equal seeds give corresponding grasps of different hands.

        Returns:
            The configurations.
        """
        rng = np.random.default_rng(seed)
        cloud = Clouds(_tensor(object.points)[None], _tensor(object.normals)[None], _tensor(-object.p_WCenter[2:]))
        features = self.object_net(cloud)[0]
        probability = torch.softmax(self.point_head(features).squeeze(-1).double(), dim=0).numpy()
        points = rng.choice(len(probability), count, p=probability / probability.sum())
        z = _tensor(rng.standard_normal((count, self.config.latent)))
        links = self._link_features(hand)
        L = len(links)
        sets = Ragged.of(torch.ones((count, L), dtype=torch.bool))
        x, source = links.repeat(count, 1), torch.cat([z, features[torch.as_tensor(points)]], dim=-1)
        for block in self.decoder:
            x = block(x, sets, sets.bias(), source)
        poses = self.pose_head(x).view(count, L, 9).double()
        p_WLs = LENGTH_UNIT * poses[..., :3].numpy() + (object.points[points] + object.p_WCenter)[:, None]
        return link_pose_ik(hand, rotations_from_columns(poses[..., 3:]).numpy(), p_WLs)

    def _link_features(self, hand: Hand) -> Tensor:
        R_HLs, p_HLs = zero_configuration(hand)
        rng = np.random.default_rng(0)
        samples = [sample_shapes(link.geometry, POINTS_PER_LINK, rng, np.zeros(3))[0] for link in hand.links]
        clouds = np.array([p_LPs @ R.T + p for p_LPs, R, p in zip(samples, R_HLs, p_HLs, strict=True)])
        x = torch.cat([_tensor(clouds), _tensor(clouds - p_HLs[:, None])], dim=-1) / LENGTH_UNIT
        x = self.link_net.after(self.link_net.shared(x).amax(dim=-2))
        sets = Ragged.of(torch.ones((1, len(x)), dtype=torch.bool))
        bias = self.topology(torch.as_tensor(shortest_path_distances(hand.parents))[None])
        for block in self.embodiment:
            x = block(x, sets, bias)
        return x


def is_first(file: Path) -> bool:
    """Whether a checkpoint, its file or folder, is of the first kind."""
    file = file if file.suffix == ".safetensors" else file / "model.safetensors"
    return describe(file, _FILE).header.get("feature_schema") == 1


def load_first(file: Path) -> FirstModel:
    """Reads a checkpoint of the first kind.

    Args:
        file: A file, or a folder that holds `model.safetensors`.

    Returns:
        The model.

    Raises:
        CheckpointError: It is damaged.
    """
    file = file if file.suffix == ".safetensors" else file / "model.safetensors"
    header = describe(file, _FILE).header
    model = FirstModel(from_plain(header.get("config"), FirstConfig, str(file), field="config", error=CheckpointError))
    arrays = {k: v for k, v in read_arrays(file, _FILE).items() if not k.startswith(_ONLY_TRAINED)}
    shapes = {name: tuple(tensor.shape) for name, tensor in model.state_dict().items()}
    if {name: array.shape for name, array in arrays.items()} != shapes:
        raise CheckpointError(f"{file}: its tensors do not fit the config in its header; get the file again")
    model.load_state_dict({name: torch.tensor(array).float() for name, array in arrays.items()})
    return model.eval()


def _tensor(array: np.ndarray) -> Tensor:
    return torch.as_tensor(array, dtype=torch.float32)
