"""Training of the model: a function over data in memory, that can be stopped at any time and goes on where it stopped.

Each step draws from a generator seeded with (seed, step): an unbroken run and one that was stopped and resumed do the
same.
"""

import io
import json
import logging
import math
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from xdex_drake.errors import CheckpointError, ConfigError
from xdex_drake.learning.batches import Batch, BatchSizes, Data, TrainingSet, draw_batch, draw_couples, make_batch, pack
from xdex_drake.learning.checkpoint import save_checkpoint
from xdex_drake.learning.losses import (
    embedding_loss,
    keypoint_loss,
    keypoints,
    kl_loss,
    point_loss,
    reconstruction_loss,
)
from xdex_drake.learning.models.cvae import CVAE, CVAEConfig
from xdex_drake.learning.models.layers import LENGTH_UNIT
from xdex_drake.whole_file import whole_file

logger = logging.getLogger(__name__)

STATE_NAME = "state.pt"
LOG_NAME = "log.jsonl"


@dataclass(frozen=True)
class LossWeights:
    """Weights of the loss terms.

    Attributes:
        reconstruction: Link pose vectors, lambda_R of Eq. (5).
        kl: Divergence of the latents, lambda_KL of Eq. (5), after its warm-up.
        point: Cross entropy of the object points.
        retargeting: Keypoints of two hands decoded from one latent; lowers success on new hands in the paper.
        embedding: Distance of the latent means of a pair.
        cross: Reconstruction of one hand's grasp from the latent of its pair, the task of neural retargeting.
    """

    reconstruction: float = 1.0
    kl: float = 2e-3
    point: float = 0.05
    retargeting: float = 0.0
    embedding: float = 0.0
    cross: float = 0.0


@dataclass(frozen=True)
class TrainConfig:
    """How to train.

    Attributes:
        steps: Steps to take.
        minutes: Stop after this time where it comes first; the learning rate has then run down, too. None for no limit.
        batch: Grasps in a step, an even number: they are drawn two by two from the same pair.
        scenes_per_batch: Scenes in a step; they share its grasps evenly.
        points: Object points that a step sees of each scene.
        jitter: Standard deviation of the noise on object points [m].
        learning_rate: Greatest learning rate.
        warm_up: Steps over which it rises.
        kl_warm_up: Steps over which the weight of the divergence rises.
        weight_decay: Weight decay of AdamW.
        clip: Greatest norm of a gradient.
        validation_fraction: Fraction of the scenes to hold out.
        log_every: Steps between lines of the log.
        validate_every: Steps between validations.
        save_every: Steps between saves.
        seed: Seed of everything.
        device: `auto` for CUDA where there is one, or a device's name.
        model: Sizes of the model.
        weights: Weights of the loss terms.
    """

    steps: int = 4000
    minutes: float | None = None
    batch: int = 64
    scenes_per_batch: int = 8
    points: int = 1024
    jitter: float = 0.001
    learning_rate: float = 1e-3
    warm_up: int = 100
    kl_warm_up: int = 1000
    weight_decay: float = 0.01
    clip: float = 1.0
    validation_fraction: float = 0.1
    log_every: int = 50
    validate_every: int = 500
    save_every: int = 200
    seed: int = 0
    device: str = "auto"
    model: CVAEConfig = field(default_factory=CVAEConfig)
    weights: LossWeights = field(default_factory=LossWeights)


class TrainingReport(NamedTuple):
    """What a call of `train` did.

    Attributes:
        stopped: `finished`, `time` or `interrupted`.
        steps: Steps taken in all, resumed ones included.
        seconds: Wall time in all, resumed parts included.
        validation: Figures of the last validation, as in the log; empty without held-out scenes.
        checkpoint: The model's file.
    """

    stopped: str
    steps: int
    seconds: float
    validation: dict[str, float]
    checkpoint: Path


class Forward(NamedTuple):
    """What the model made of a batch; see `CVAE` for shapes."""

    links: Tensor
    mask: Tensor
    feature: Tensor
    logits: Tensor
    mean: Tensor
    log_sigma: Tensor


def forward(model: CVAE, batch: Batch) -> Forward:
    """Features and latent distributions of a batch.

    Args:
        model: The model.
        batch: The batch.

    Returns:
        They.
    """
    links = model.link_features(batch.hands).index_select(0, batch.hand)  # (B, L, d)
    mask = batch.hands.mask[batch.hand]  # (B, L)
    features = model.point_features(batch.clouds)  # (S, N, d)
    S, N, d = features.shape
    feature = features.view(S * N, d).index_select(0, batch.cloud * N + batch.point)  # (B, d)
    mean, log_sigma = model.encode(batch.poses, mask, feature)
    return Forward(links, mask, feature, model.point_logits(features), mean, log_sigma)


def loss_terms(model: CVAE, batch: Batch, data: Data, weights: LossWeights) -> dict[str, Tensor]:
    """The loss terms of a batch, without their weights; options of weight 0 are left out.

    Args:
        model: The model.
        batch: The batch.
        data: The data, for its keypoints.
        weights: Which options to compute.

    Returns:
        Terms by the names of `LossWeights`.
    """
    f = forward(model, batch)
    z = f.mean + f.log_sigma.exp() * batch.noise
    predicted = model.decode(f.links, f.mask, z, f.feature)
    terms = {
        "reconstruction": reconstruction_loss(predicted, batch.poses, f.mask),
        "kl": kl_loss(f.mean, f.log_sigma),
        "point": point_loss(f.logits, batch.point_weights),
    }
    first = 2 * batch.paired.nonzero().squeeze(1)  # first of each paired couple; its mate follows
    if len(first) == 0:
        return terms
    second = first + 1
    if weights.embedding > 0.0:
        terms["embedding"] = embedding_loss(f.mean[first], f.mean[second])
    if weights.cross > 0.0 or weights.retargeting > 0.0:
        # Each decodes the other's latent, at its own snapped point: a pair shares the true one.
        own, mate = torch.cat([first, second]), torch.cat([second, first])
        crossed = model.decode(f.links[own], f.mask[own], z[mate], f.feature[own])
        if weights.cross > 0.0:
            terms["cross"] = reconstruction_loss(crossed, batch.poses[own], f.mask[own])
        if weights.retargeting > 0.0:
            a, b = batch.hand_indices[batch.hand[own]], batch.hand_indices[batch.hand[mate]]
            terms["retargeting"] = keypoint_loss(
                keypoints(crossed, data.keypoint_links[a], data.keypoint_offsets[a]),
                keypoints(predicted[mate], data.keypoint_links[b], data.keypoint_offsets[b]),
                data.keypoint_mask[a] & data.keypoint_mask[b],
            )
    return terms


@torch.no_grad()
def validate(model: CVAE, data: Data, scenes: np.ndarray, config: TrainConfig) -> dict[str, float]:
    """Figures on held-out scenes, the same draw at every call.

    Args:
        model: The model.
        data: The data.
        scenes: The held-out scenes, each with grasps.
        config: How to train.

    Returns:
        `reconstruction` and `kl` as in the loss, at the latent mean; `position_mm`, mean error of link origins;
        `prior_mm`, the same for the best of eight latents from the prior; `cross_mm`, the same for a pair's latent mean
        (nan without pairs); `point_gain`, nats by which the point's distribution beats the uniform one.
    """
    rng = np.random.default_rng(config.seed)
    model.eval()
    rows = []
    for scene in scenes:
        grasps = draw_couples(data, int(scene), min(16, int((data.scene == scene).sum())), rng)
        batch = make_batch(data, np.array([scene]), grasps, np.zeros(1), batch_sizes(config), rng)
        f = forward(model, batch)

        def error(z: Tensor, f: Forward = f, batch: Batch = batch) -> tuple[Tensor, Tensor]:
            poses = model.decode(f.links, f.mask, z, f.feature)
            apart = (poses - batch.poses)[..., :3].norm(dim=-1).masked_fill(~f.mask, 0.0)
            return poses, 1000.0 * LENGTH_UNIT * apart.sum(dim=1) / f.mask.sum(dim=1)

        poses, position = error(f.mean)
        prior = torch.as_tensor(rng.standard_normal((8, *f.mean.shape)), dtype=f.mean.dtype, device=f.mean.device)
        crossed = error(f.mean.view(-1, 2, f.mean.shape[1]).flip(1).reshape_as(f.mean))[1].view(-1, 2)[batch.paired]
        uniform = math.log(config.points)
        rows.append(
            {
                "reconstruction": float(reconstruction_loss(poses, batch.poses, f.mask)),
                "kl": float(kl_loss(f.mean, f.log_sigma)),
                "position_mm": float(position.mean()),
                "prior_mm": float(torch.stack([error(z)[1] for z in prior]).amin(dim=0).mean()),
                "cross_mm": float(crossed.mean()),
                "point_gain": uniform - float(point_loss(f.logits, batch.point_weights)),
            }
        )
    model.train()
    table = {name: np.array([row[name] for row in rows]) for name in (rows[0] if rows else {})}
    return {name: float(np.nanmean(v)) if np.isfinite(v).any() else math.nan for name, v in table.items()}


def split_scenes(data: Data, config: TrainConfig, validation: Sequence[int] | None) -> tuple[np.ndarray, np.ndarray]:
    """Scenes to train on and scenes to hold out, of those that have grasps.

    Args:
        data: The data.
        config: How to train.
        validation: Scenes to hold out; None draws a fraction of them, from five scenes on at least one.

    Returns:
        Scenes to train on and scenes to hold out.

    Raises:
        ConfigError: No scene would be left to train on.
    """
    scenes = np.unique(data.scene)
    if validation is None:
        count = round(config.validation_fraction * len(scenes))
        if config.validation_fraction > 0.0 and len(scenes) >= 5:
            count = max(count, 1)
        held = np.random.default_rng(config.seed).permutation(scenes)[:count]
    else:
        held = np.intersect1d(scenes, np.asarray(list(validation), dtype=np.int64))
    kept = np.setdiff1d(scenes, held)
    if len(kept) == 0:
        raise ConfigError("no scene is left to train on; lower 'validation_fraction' or add scenes")
    return kept, np.sort(held)


def train(
    config: TrainConfig,
    samples: TrainingSet,
    out: str | Path,
    *,
    validation: Sequence[int] | None = None,
    resume: bool = True,
    progress: bool = True,
) -> TrainingReport:
    """Train a model.

    Writes `model.safetensors` (the model), `state.pt` (to go on from) and `log.jsonl` into the folder. Ctrl-C ends the
    run after the current step, with everything saved; a second one ends it at once.

    Args:
        config: How to train.
        samples: What to learn from.
        out: Folder to write to.
        validation: Scenes to hold out; by default a fraction of them, by seed.
        resume: Go on from the folder's state where there is one; otherwise start again.
        progress: Whether to show a progress bar.

    Returns:
        What was done.

    Raises:
        ConfigError: The config or the data cannot be used, or are not those of the folder's state.
        CheckpointError: The folder's state is damaged.
    """
    _check(config)
    device = _device(config.device)
    data = pack(samples, device)
    train_scenes, held_scenes = split_scenes(data, config, validation)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        model = CVAE(config.model).to(device)
    optimizer = torch.optim.AdamW(model.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)
    identity = _identity(config, data, held_scenes)
    step, before = 0, 0.0
    if resume and (out / STATE_NAME).exists():
        step, before = _load_state(out / STATE_NAME, model, optimizer, identity)
    elif (out / LOG_NAME).exists():
        (out / LOG_NAME).unlink()

    start, figures, stopped, means = time.monotonic(), {}, "finished", {}
    weights = asdict(config.weights)
    last_saved = -1

    def elapsed() -> float:
        return before + time.monotonic() - start

    def save() -> None:
        notes = {"steps": step, "seed": config.seed, "grasps": len(data.hand), "validation": _finite(figures)}
        notes["hands"] = [hand.name for hand in samples.hands]
        save_checkpoint(model, out, notes)
        _save_state(out / STATE_NAME, model, optimizer, identity, step, elapsed())

    with _interruptible() as interrupted, tqdm(total=config.steps, initial=step, disable=not progress) as bar:
        while step < config.steps:
            share = step / config.steps
            if config.minutes is not None:
                share = max(share, elapsed() / (60.0 * config.minutes))
            if share >= 1.0 or interrupted.is_set():
                stopped = "interrupted" if interrupted.is_set() else "time"
                break
            rate = config.learning_rate * min(1.0, (step + 1) / max(config.warm_up, 1))
            for group in optimizer.param_groups:
                group["lr"] = rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * share)))
            rng = np.random.default_rng((config.seed, step))
            batch = draw_batch(data, train_scenes, batch_sizes(config), rng)
            terms = loss_terms(model, batch, data, config.weights)
            warm = min(1.0, (step + 1) / max(config.kl_warm_up, 1))
            loss = torch.stack([weights[n] * (warm if n == "kl" else 1.0) * term for n, term in terms.items()]).sum()
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            norm = torch.nn.utils.clip_grad_norm_(model.parameters(), config.clip)
            if not bool(torch.isfinite(norm)):
                raise ConfigError(f"training diverged at step {step}; lower 'learning_rate' ({config.learning_rate:g})")
            optimizer.step()
            step += 1
            bar.update()

            for name, term in {"loss": loss, **terms}.items():
                means.setdefault(name, []).append(term.item())
            if step % config.log_every == 0 or step == config.steps:
                line = {name: float(np.mean(values)) for name, values in means.items()}
                _log(out, {"step": step, "seconds": round(elapsed(), 3), **line})
                bar.set_postfix(loss=f"{line['loss']:.4f}", refresh=False)
                means = {}
            if len(held_scenes) and (step % config.validate_every == 0 or step == config.steps):
                figures = validate(model, data, held_scenes, config)
                _log(out, {"step": step, "validation": _finite(figures)})
            if step % config.save_every == 0:
                save()
                last_saved = step
        if stopped == "time" and len(held_scenes):
            figures = validate(model, data, held_scenes, config)
            _log(out, {"step": step, "validation": _finite(figures)})
        if last_saved != step or stopped == "time":
            save()
    logger.info("training %s after %d steps, %.0f s", stopped, step, elapsed())
    return TrainingReport(stopped, step, elapsed(), figures, out / "model.safetensors")


def batch_sizes(config: TrainConfig) -> BatchSizes:
    """Sizes of a training step's batch.

    Args:
        config: How to train.

    Returns:
        The sizes.
    """
    return BatchSizes(config.batch, config.scenes_per_batch, config.points, config.jitter, config.model.latent)


def _check(config: TrainConfig) -> None:
    if config.batch % 2 or not 1 <= config.scenes_per_batch <= config.batch // 2:
        raise ConfigError(
            f"'batch' ({config.batch}) must be even and hold two grasps of each of 'scenes_per_batch' "
            f"({config.scenes_per_batch}) scenes"
        )
    for name in ("steps", "points", "log_every", "validate_every", "save_every"):
        if getattr(config, name) < 1:
            raise ConfigError(f"'{name}' ({getattr(config, name)}) must be at least 1")
    if config.model.width % config.model.heads:
        raise ConfigError(f"'model.width' ({config.model.width}) must be a multiple of 'model.heads'")


def _device(name: str) -> torch.device:
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise ConfigError(f"'device' {name!r} is not a device of torch; use 'auto', 'cpu' or 'cuda'") from error
    if device.type == "cuda" and not torch.cuda.is_available():
        raise ConfigError(f"'device' is {name!r} but torch sees no GPU; use 'auto' or 'cpu'")
    return device


def _identity(config: TrainConfig, data: Data, held: np.ndarray) -> dict[str, Any]:
    """What must not change between a run and its resumption; the lengths of the run and its log may."""
    free = ("steps", "minutes", "log_every", "validate_every", "save_every", "device")
    settings = {name: value for name, value in asdict(config).items() if name not in free}
    settings["model"]["object_channels"] = list(config.model.object_channels)
    sizes = {"grasps": len(data.hand), "scenes": len(data.clouds), "links": data.hands.mask.sum(dim=1).tolist()}
    total = float(data.vectors.double().sum())
    return {"config": settings, "data": {**sizes, "held": held.tolist(), "sum": round(total, 3)}}


def _save_state(
    file: Path, model: CVAE, optimizer: torch.optim.Optimizer, identity: dict, step: int, seconds: float
) -> None:
    stream = io.BytesIO()
    state = {"model": model.state_dict(), "optimizer": optimizer.state_dict()}
    torch.save({**state, "identity": json.dumps(identity), "step": step, "seconds": seconds}, stream)
    with whole_file(file) as unfinished:
        unfinished.write_bytes(stream.getvalue())


def _load_state(file: Path, model: CVAE, optimizer: torch.optim.Optimizer, identity: dict) -> tuple[int, float]:
    try:
        state = torch.load(file, map_location="cpu", weights_only=True)
        found = json.loads(state["identity"])
    except Exception as error:  # torch's reader lets through whatever it stumbles over, struct.error among others
        raise CheckpointError(f"{file}: damaged training state; delete it to start again") from error
    for part in ("config", "data"):
        for name, value in identity[part].items():
            if found.get(part, {}).get(name) != value:
                raise ConfigError(
                    f"{file}: was written with another {part} ('{name}'); use another folder, or do not resume"
                )
    model.load_state_dict(state["model"])
    optimizer.load_state_dict(state["optimizer"])
    return int(state["step"]), float(state["seconds"])


def _log(out: Path, line: dict[str, Any]) -> None:
    with (out / LOG_NAME).open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(line) + "\n")


def _finite(figures: dict[str, float]) -> dict[str, float | None]:
    """JSON has no nan."""
    return {name: round(value, 6) if math.isfinite(value) else None for name, value in figures.items()}


@contextmanager
def _interruptible() -> Iterator[threading.Event]:
    """Set an event at the first Ctrl-C, so that a step is never cut in half; a second Ctrl-C interrupts as usual."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    previous = signal.getsignal(signal.SIGINT)

    def stop(signum: int, frame: object) -> None:
        event.set()
        signal.signal(signal.SIGINT, previous)

    signal.signal(signal.SIGINT, stop)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, previous)
