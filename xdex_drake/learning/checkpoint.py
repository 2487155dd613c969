"""Models by their kind, and their checkpoints: safetensors whose header names the kind, checked before it is loaded."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from xdex_drake.errors import CheckpointError, ConfigError
from xdex_drake.learning.models.cvae import CVAE
from xdex_drake.learning.pack import FEATURE_SCHEMA
from xdex_drake.learning.protocol import Model
from xdex_drake.learning.tensor_file import FileType, describe, read_arrays, versions, write_tensor_file
from xdex_drake.typed_yaml import from_plain, to_plain

FILE_NAME = "model.safetensors"
MODELS: dict[str, type[Model]] = {model.kind: model for model in (CVAE,)}
"""Every model by its kind; a model of one's own is known once it is added here."""

_CHECKPOINT = FileType("checkpoint", "train one with `xdex train`, or name its folder", "get the file again")


def model_config(kind: str, settings: Mapping[str, Any]) -> Any:
    """Settings of a kind of model.

    Args:
        kind: The kind.
        settings: Some of its settings, as YAML gives them; what they leave out keeps its default.

    Returns:
        The kind's own dataclass.

    Raises:
        ConfigError: There is no such kind, or a setting is unknown, of the wrong type or out of bounds.
    """
    if kind not in MODELS:
        raise ConfigError(f"there is no model of kind {kind!r}; known are {', '.join(sorted(MODELS))}")
    return from_plain(to_plain(dict(settings)), MODELS[kind].config_type, f"model {kind}")


def make_model(kind: str, settings: Mapping[str, Any]) -> Model:
    """A new model, its parameters drawn from torch's generator.

    Args:
        kind: Its kind.
        settings: Some of its settings; see `model_config`.

    Returns:
        The model.

    Raises:
        ConfigError: As `model_config`.
    """
    config = model_config(kind, settings)
    return MODELS[kind](config)  # type: ignore[call-arg]


def save_checkpoint(model: Model, path: str | Path, notes: Mapping[str, Any] | None = None) -> Path:
    """Writes a model in 16-bit numbers, whole or not at all.

    Args:
        model: The model.
        path: A file that ends in `.safetensors`, or a folder to hold `model.safetensors`.
        notes: What else to say in the header, as JSON: data, seed, steps, figures.

    Returns:
        The file.
    """
    file = _file(Path(path))
    header = {
        "kind": model.kind,
        "feature_schema": FEATURE_SCHEMA,
        "config": to_plain(model.config),
        "versions": versions(),
        "notes": dict(notes or {}),
    }
    write_tensor_file(file, {name: t.detach().cpu().half().numpy() for name, t in model.state_dict().items()}, header)
    return file


def load_checkpoint(path: str | Path) -> Model:
    """Reads a model, ready to predict on the CPU.

    Args:
        path: A file, or a folder that holds `model.safetensors`.

    Returns:
        The model, in evaluation mode.

    Raises:
        CheckpointError: There is no such file, or it is damaged, cut short, oversized, of another version or of a kind
            that is not known.
    """
    file = _file(Path(path))
    described = describe(file, _CHECKPOINT)
    header = _checked_header(file, described.header)
    kind = MODELS[header["kind"]]
    config = from_plain(header.get("config"), kind.config_type, str(file), field="config", error=CheckpointError)
    with torch.device("meta"):
        model = kind(config)  # type: ignore[call-arg]
    expected = {name: tuple(tensor.shape) for name, tensor in model.state_dict().items()}
    if described.shapes != expected:
        names = described.shapes.keys() | expected.keys()
        wrong = sorted(name for name in names if described.shapes.get(name) != expected.get(name))
        raise CheckpointError(f"{file}: tensor '{wrong[0]}' does not fit the config in its header; get the file again")
    if set(described.dtypes.values()) - {"F32", "F16"}:
        raise CheckpointError(f"{file}: holds other numbers than of 32 and 16 bits; get the file again")
    arrays = read_arrays(file, _CHECKPOINT)
    model.load_state_dict({name: torch.tensor(array).float() for name, array in arrays.items()}, assign=True)
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
    file = _file(Path(path))
    return _checked_header(file, describe(file, _CHECKPOINT).header)


def checkpoint_digest(path: str | Path) -> str:
    """SHA-256 of a checkpoint's file, hexadecimal; arguments and errors as of `checkpoint_header`."""
    file = _file(Path(path))
    describe(file, _CHECKPOINT)
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _checked_header(file: Path, header: dict[str, Any]) -> dict[str, Any]:
    kind, found = header.get("kind"), header.get("feature_schema")
    if not isinstance(kind, str) or kind not in MODELS:
        raise CheckpointError(f"{file}: field 'kind' is {kind!r}; known are {', '.join(sorted(MODELS))}")
    if found != FEATURE_SCHEMA:
        raise CheckpointError(
            f"{file}: field 'feature_schema' is {found!r} but this version reads {FEATURE_SCHEMA}; "
            "train again, or use the version of the library that wrote it"
        )
    return header


def _file(path: Path) -> Path:
    return path if path.suffix == ".safetensors" else path / FILE_NAME
