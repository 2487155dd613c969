"""The state of a training run: everything it needs to go on as if it had never stopped, and its log.

A state appears whole or not at all, so that a run can be killed at any moment.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from xdex_drake.errors import ConfigError
from xdex_drake.learning.protocol import Model
from xdex_drake.learning.tensor_file import FileType, describe, read_arrays, write_tensor_file
from xdex_drake.whole_file import whole_file

STATE_NAME = "state.safetensors"
LOG_NAME = "log.jsonl"

_STATE = FileType("training state", "begin a new run", "delete it to start again")


@dataclass(frozen=True)
class Progress:
    """How far a run has come.

    Attributes:
        step: Steps taken.
        seconds: Wall time that they took.
        validation: Figures of the last validation; empty before the first.
    """

    step: int = 0
    seconds: float = 0.0
    validation: Mapping[str, float] = field(default_factory=dict)


def save_state(
    file: Path,
    model: Model,
    average: Model | None,
    optimizer: torch.optim.Optimizer,
    progress: Progress,
    identity: Mapping[str, Any],
) -> None:
    """Writes a run's state.

    Args:
        file: The file.
        model: The model.
        average: The running mean of its weights, where there is one.
        optimizer: Its optimiser.
        progress: How far the run has come.
        identity: What must be the same when the run goes on, as JSON, by parts.
    """
    arrays = {name: _array(tensor) for name, tensor in _weights(model, average).items()}
    for parameter, values in optimizer.state_dict()["state"].items():
        arrays |= {f"optimizer/{parameter}/{name}": _array(tensor) for name, tensor in values.items()}
    header = {
        "kind": "state",
        "step": progress.step,
        "seconds": progress.seconds,
        "validation": finite(progress.validation),
        "identity": identity,
    }
    write_tensor_file(file, arrays, header)


def load_state(
    file: Path,
    model: Model,
    average: Model | None,
    optimizer: torch.optim.Optimizer,
    identity: Mapping[str, Mapping[str, Any]],
) -> Progress:
    """Puts a run where its state was saved.

    Args:
        file: The file.
        model: The model, whose parameters are overwritten.
        average: The running mean of its weights, likewise, where there is one.
        optimizer: Its optimiser, the same.
        identity: What must be the same.

    Returns:
        How far the run had come.

    Raises:
        CheckpointError: The file is damaged.
        ConfigError: The run was begun with another configuration or other data.
    """
    header = describe(file, _STATE).header
    arrays = read_arrays(file, _STATE)
    damaged = _STATE.error(f"{file}: damaged training state; {_STATE.remedy}")
    try:
        found, figures = header["identity"], header["validation"]
        progress = Progress(
            int(header["step"]),
            float(header["seconds"]),
            {name: math.nan if value is None else float(value) for name, value in figures.items()},
        )
        _check_identity(file, found, json.loads(json.dumps(identity)))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise damaged from error
    tensors = {name: torch.tensor(array) for name, array in arrays.items()}
    expected = {name: tensor.shape for name, tensor in _weights(model, average).items()}
    if {name: t.shape for name, t in tensors.items() if name.startswith(("model/", "average/"))} != expected:
        raise damaged
    for prefix, owner in (("model/", model), ("average/", average)):
        if owner is not None:
            owner.load_state_dict({name: tensors[prefix + name] for name in owner.state_dict()})
    state: dict[int, dict[str, torch.Tensor]] = {}
    try:
        for name in tensors.keys() - expected.keys():
            _, parameter, entry = name.split("/")
            state.setdefault(int(parameter), {})[entry] = tensors[name]
        optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})
    except (KeyError, ValueError, RuntimeError) as error:
        raise damaged from error
    return progress


def _check_identity(file: Path, found: Mapping[str, Any], identity: Mapping[str, Mapping[str, Any]]) -> None:
    for part, values in identity.items():
        for name, value in values.items():
            if found[part].get(name) != value:
                raise ConfigError(
                    f"{file}: was written with another {part} ('{name}'); use another folder, or do not resume"
                )


def write_log(out: Path, line: Mapping[str, Any]) -> None:
    """Adds a line to a run's log."""
    with (out / LOG_NAME).open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(line) + "\n")


def cut_log(out: Path, step: int) -> None:
    """Takes out of a run's log what came after a step: a run that goes on from there does it again.

    Args:
        out: Folder of the run.
        step: The last step to keep.
    """
    file = out / LOG_NAME
    if not file.exists():
        return
    kept = []
    for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            if json.loads(line)["step"] <= step:
                kept.append(line + "\n")
        except (ValueError, KeyError, TypeError):  # the line that the kill cut in two
            continue
    with whole_file(file) as unfinished:
        unfinished.write_text("".join(kept), encoding="utf-8")


def finite(figures: Mapping[str, float]) -> dict[str, float | None]:
    """Figures as JSON holds them, which has no nan."""
    return {name: round(value, 6) if math.isfinite(value) else None for name, value in figures.items()}


def _weights(model: Model, average: Model | None) -> dict[str, torch.Tensor]:
    owners = {"model/": model} if average is None else {"model/": model, "average/": average}
    return {prefix + name: t for prefix, owner in owners.items() for name, t in owner.state_dict().items()}


def _array(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy()
