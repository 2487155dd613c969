"""Checkpoints: safetensors with a JSON header, checked before a tensor is read. Nothing that is loaded can run code."""

import json
import math
from dataclasses import asdict, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from xdex_drake.errors import CheckpointError
from xdex_drake.learning.features import FEATURE_SCHEMA
from xdex_drake.learning.models.cvae import CVAE, CVAEConfig
from xdex_drake.whole_file import whole_file

FILE_NAME = "model.safetensors"
MAX_HEADER = 1 << 20
MAX_FILE = 1 << 30
_KEY = "xdex_drake"
_KIND = "cvae"


def save_checkpoint(model: CVAE, path: str | Path, notes: dict[str, Any] | None = None) -> Path:
    """Write a model, whole or not at all.

    Args:
        model: The model.
        path: A file that ends in `.safetensors`, or a folder to hold `model.safetensors`.
        notes: What else to say in the header, as JSON: data, seed, steps, figures.

    Returns:
        The file.
    """
    file = _file(Path(path))
    file.parent.mkdir(parents=True, exist_ok=True)
    header = {
        "kind": _KIND,
        "feature_schema": FEATURE_SCHEMA,
        "config": asdict(model.config),
        "versions": {name: _version(name) for name in ("xdex_drake", "torch", "numpy", "safetensors")},
        "notes": notes or {},
    }
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in model.state_dict().items()}
    with whole_file(file) as unfinished:
        unfinished.write_bytes(save_tensors(tensors, metadata={_KEY: json.dumps(header)}))
    return file


def load_checkpoint(path: str | Path) -> CVAE:
    """Read a model, ready to predict on the CPU.

    Args:
        path: A file, or a folder that holds `model.safetensors`.

    Returns:
        The model, in evaluation mode.

    Raises:
        CheckpointError: There is no such file, or it is damaged, cut short, oversized or of another version.
    """
    file = _file(Path(path))
    header, described = _checked_header(file)
    config = _config(file, header.get("config"))
    with torch.device("meta"):
        model = CVAE(config)
    expected = {name: list(tensor.shape) for name, tensor in model.state_dict().items()}
    if described != expected:
        wrong = sorted(name for name in described.keys() | expected.keys() if described.get(name) != expected.get(name))
        raise CheckpointError(f"{file}: tensor '{wrong[0]}' does not fit the config in its header; get the file again")
    try:
        tensors = load_tensors(file.read_bytes())
    except (SafetensorError, ValueError) as error:
        raise CheckpointError(f"{file}: damaged ({error}); get the file again") from error
    if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors.values()):
        raise CheckpointError(f"{file}: holds numbers that are not finite; train again or get the file again")
    model.load_state_dict(tensors, assign=True)
    return model.eval()


def checkpoint_header(path: str | Path) -> dict[str, Any]:
    """The JSON header of a checkpoint: `kind`, `feature_schema`, `config`, `versions`, `notes`.

    Args:
        path: A file, or a folder that holds `model.safetensors`.

    Returns:
        The header.

    Raises:
        CheckpointError: As `load_checkpoint`.
    """
    return _checked_header(_file(Path(path)))[0]


def _checked_header(file: Path) -> tuple[dict[str, Any], dict[str, list[int]]]:
    """Our header and the shapes that the file describes, without touching the tensors' bytes."""
    if not file.is_file():
        raise CheckpointError(f"{file}: no such checkpoint; train one with `xdex train`, or name its folder")
    size = file.stat().st_size
    if size > MAX_FILE:
        raise CheckpointError(f"{file}: {size} bytes are more than a checkpoint may have ({MAX_FILE})")
    with file.open("rb") as stream:
        length = int.from_bytes(stream.read(8), "little")
        if size < 8 or length > min(MAX_HEADER, size - 8):
            raise CheckpointError(f"{file}: not a safetensors file, or cut short; get the file again")
        raw = stream.read(length)
    try:
        table = json.loads(raw)
        header = json.loads(table.pop("__metadata__")[_KEY])
        described = {name: [int(n) for n in entry["shape"]] for name, entry in table.items()}
        types = {entry["dtype"] for entry in table.values()}
        end = max(entry["data_offsets"][1] for entry in table.values())
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise CheckpointError(f"{file}: its header is not that of a model of xdex_drake; get the file again") from error
    if not isinstance(header, dict) or header.get("kind") != _KIND:
        raise CheckpointError(f"{file}: field 'kind' is not '{_KIND}'; this file holds something else")
    if header.get("feature_schema") != FEATURE_SCHEMA:
        found = header.get("feature_schema")
        raise CheckpointError(
            f"{file}: field 'feature_schema' is {found!r} but this version reads {FEATURE_SCHEMA}; "
            "train again, or use the version of the library that wrote it"
        )
    if types != {"F32"} or 8 + length + end != size:
        raise CheckpointError(f"{file}: cut short or damaged; get the file again")
    return header, described


_BOUNDS = {
    "width": (8, 1024),
    "heads": (1, 64),
    "latent": (1, 1024),
    "embodiment_layers": (0, 32),
    "encoder_layers": (0, 32),
    "decoder_layers": (1, 32),
    "max_distance": (1, 1024),
}


def _config(file: Path, value: Any) -> CVAEConfig:
    """The config of a header, each number within bounds that keep a damaged file from exhausting memory."""
    names = {field.name for field in fields(CVAEConfig)}
    if not isinstance(value, dict) or value.keys() != names:
        raise CheckpointError(f"{file}: field 'config' must have exactly the keys {sorted(names)}; get the file again")
    for name, (low, high) in _BOUNDS.items():
        if type(value[name]) is not int or not low <= value[name] <= high:
            raise CheckpointError(f"{file}: field 'config.{name}' is {value[name]!r}, not an integer in {low}..{high}")
    channels, size = value["object_channels"], value["voxel_size"]
    if not isinstance(channels, list) or not 1 <= len(channels) <= 8:
        raise CheckpointError(f"{file}: field 'config.object_channels' must list one to eight integers")
    if not all(type(c) is int and 1 <= c <= 1024 for c in channels):
        raise CheckpointError(f"{file}: field 'config.object_channels' must list integers in 1..1024")
    if not isinstance(size, float) or not math.isfinite(size) or not 1e-4 <= size <= 1.0:
        raise CheckpointError(f"{file}: field 'config.voxel_size' is {size!r}, not a length in 0.0001..1 m")
    if value["width"] % value["heads"] != 0:
        raise CheckpointError(f"{file}: field 'config.width' is not a multiple of 'config.heads'")
    return CVAEConfig(**{**value, "object_channels": tuple(channels)})


def _file(path: Path) -> Path:
    return path if path.suffix == ".safetensors" else path / FILE_NAME


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
