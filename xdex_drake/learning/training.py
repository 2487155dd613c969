"""Training of a model: a function over a training pack, that can be stopped at any time and goes on where it stopped.

Each step draws from a generator seeded with (seed, step): an unbroken run and one that was stopped and resumed do the
same. Torch, NumPy, safetensors, PyYAML and tqdm suffice:

    python -m xdex_drake.learning.training CONFIG.yaml --pack FILE.safetensors --out DIR

A long training is a list of legs: each starts from the weights that the one before has left (`start`), with its own
warm-up and its own fall of the learning rate.
"""

import argparse
import copy
import logging
import math
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from xdex_drake.errors import ConfigError, XdexError
from xdex_drake.learning.batches import (
    BatchSizes,
    Data,
    Views,
    draw_batch,
    draw_couples,
    grasps_of_scenes,
    load_pack,
    make_batch,
)
from xdex_drake.learning.checkpoint import (
    FILE_NAME,
    MODELS,
    checkpoint_digest,
    load_checkpoint,
    make_model,
    model_config,
    save_checkpoint,
)
from xdex_drake.learning.losses import keypoints
from xdex_drake.learning.pack import LIFTED, Pack, read_pack
from xdex_drake.learning.protocol import LENGTH_UNIT, Batch, Model
from xdex_drake.learning.run_state import STATE_NAME, Progress, cut_log, finite, load_state, save_state, write_log
from xdex_drake.typed_yaml import read_typed_yaml, to_plain

logger = logging.getLogger(__name__)

VALIDATION_GRASPS = 16
"""Grasps of a scene that validate, at most."""
VALIDATION_SCENES = 32
"""Scenes in which held-out hands validate, at most."""


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
        link_points: Points that a step sees of each link; 0 for all.
        max_hands: Hands in a step, at most; 0 for any number.
        mirror: Share of the scenes that are mirrored, hands and all.
        learning_rate: Greatest learning rate.
        warm_up: Steps over which it rises.
        weight_decay: Weight decay of AdamW.
        clip: Greatest norm of a gradient.
        ema: Decay of the running mean of the weights, which is the model that is kept; 0 keeps the last weights.
        precision: Numbers of matrix products, `float32` or `bfloat16`; losses and weights have 32 bits always.
        validation_fraction: Fraction of the scenes to hold out where the pack names none.
        log_every: Steps between lines of the log.
        validate_every: Steps between validations.
        save_minutes: Time between saves.
        save_every: Steps between saves, besides; None for none.
        seed: Seed of everything.
        device: `auto` for CUDA where there is one, or a device's name.
        kind: Kind of the model.
        model: Its settings; what they leave out keeps its default.
        weights: Weights of the terms of its loss; a term that is left out keeps the kind's own weight.
        warm_ups: Steps over which the weights of terms rise.
    """

    steps: int = 8000
    minutes: float | None = None
    batch: int = 512
    scenes_per_batch: int = 8
    points: int = 1024
    jitter: float = 0.001
    link_points: int = 32
    max_hands: int = 192
    mirror: float = 0.5
    learning_rate: float = 5e-4
    warm_up: int = 200
    weight_decay: float = 0.01
    clip: float = 1.0
    ema: float = 0.999
    precision: Literal["float32", "bfloat16"] = "float32"
    validation_fraction: float = 0.1
    log_every: int = 50
    validate_every: int = 500
    save_minutes: float = 5.0
    save_every: int | None = None
    seed: int = 0
    device: str = "auto"
    kind: str = "cvae"
    model: dict[str, Any] = field(default_factory=dict)
    weights: dict[str, float] = field(default_factory=dict)
    warm_ups: dict[str, int] = field(default_factory=lambda: {"kl": 1000})


class TrainingReport(NamedTuple):
    """What a call of `train` did.

    Attributes:
        stopped: `finished`, `time` or `interrupted`.
        steps: Steps taken in all, resumed ones included.
        seconds: Wall time in all, resumed parts included.
        validation: Figures of the last validation, as in the log; empty without held-out grasps.
        checkpoint: The model's file.
    """

    stopped: str
    steps: int
    seconds: float
    validation: Mapping[str, float]
    checkpoint: Path

    def lines(self) -> list[tuple[str, object]]:
        """Names and values, to print."""
        return [
            ("stopped", self.stopped),
            ("steps", self.steps),
            ("seconds", f"{self.seconds:.0f}"),
            *((f"validation {name}", value) for name, value in self.validation.items()),
            ("model", str(self.checkpoint)),
        ]


class Split(NamedTuple):
    """Which lifted grasps train, and which validate: indices, in each scene that has any.

    Attributes:
        train: Grasps of training hands in training scenes.
        scenes: Grasps of training hands in held-out scenes.
        hands: Grasps of held-out hands.
    """

    train: dict[int, np.ndarray]
    scenes: dict[int, np.ndarray]
    hands: dict[int, np.ndarray]


def read_train_config(path: str | Path | None, **changes: Any) -> TrainConfig:
    """Reads how to train.

    Args:
        path: A YAML file; what it leaves out keeps its default. None for all defaults.
        **changes: Fields to set otherwise; those that are None are not.

    Returns:
        The configuration, with every setting of the model and every weight spelt out.

    Raises:
        ConfigError: The file cannot be used, or contradicts itself.
    """
    config = TrainConfig() if path is None else read_typed_yaml(path, TrainConfig)
    return resolve(replace(config, **{name: value for name, value in changes.items() if value is not None}))


def resolve(config: TrainConfig) -> TrainConfig:
    """Checks a configuration and spells out what it leaves to the kind of model.

    Args:
        config: The configuration.

    Returns:
        The same with every setting of the model and the weight of every term.

    Raises:
        ConfigError: It contradicts itself, or names what the kind of model does not have.
    """
    if config.batch % 2 or not 1 <= config.scenes_per_batch <= config.batch // 2:
        raise ConfigError(
            f"'batch' ({config.batch}) must be even and hold two grasps of each of 'scenes_per_batch' "
            f"({config.scenes_per_batch}) scenes"
        )
    for name in ("steps", "points", "log_every", "validate_every", "save_every"):
        if getattr(config, name) is not None and getattr(config, name) < 1:
            raise ConfigError(f"'{name}' ({getattr(config, name)}) must be at least 1")
    for name, most in (("ema", 0.999999), ("mirror", 1.0), ("max_hands", math.inf), ("link_points", math.inf)):
        if not 0.0 <= getattr(config, name) <= most:
            raise ConfigError(f"'{name}' ({getattr(config, name)}) must lie in 0 to {most:g}")
    settings = to_plain(model_config(config.kind, config.model))
    known = MODELS[config.kind].weights
    for name in ("weights", "warm_ups"):
        if unknown := getattr(config, name).keys() - known.keys():
            raise ConfigError(f"'{name}' has an unknown term {min(unknown)!r}; known are {', '.join(known)}")
    return replace(config, model=settings, weights={**known, **config.weights})


def train(
    config: TrainConfig,
    pack: Pack,
    out: str | Path,
    *,
    start: str | Path | None = None,
    resume: bool = True,
    progress: bool = True,
) -> TrainingReport:
    """Trains a model.

    Writes `model.safetensors` (the model), `state.safetensors` (to go on from) and `log.jsonl` into the folder. Ctrl-C
    ends the run after the current step, with everything saved; a second one ends it at once. A run that was killed goes
    on from its last save, and ends with the weights of an unbroken one.

    Args:
        config: How to train.
        pack: What to learn from.
        out: Folder to write to.
        start: A checkpoint whose weights to start from, of a model of the same settings; random ones where None.
        resume: Go on from the folder's state where there is one; otherwise start again.
        progress: Whether to show a progress bar.

    Returns:
        What was done.

    Raises:
        ConfigError: The configuration or the data cannot be used, or are not those of the folder's state.
        CheckpointError: The folder's state, or the checkpoint to start from, is damaged.
    """
    config, out = resolve(config), Path(out)
    device = _device(config.device)
    split = split_grasps(pack, config)
    out.mkdir(parents=True, exist_ok=True)
    run = _Run(config, pack, split, out, device, start)
    begun = run.resumed() if resume and (out / STATE_NAME).exists() else Progress()
    cut_log(out, begun.step)
    with _interruptible() as interrupted, tqdm(total=config.steps, initial=begun.step, disable=not progress) as bar:
        stopped, now = _take_steps(run, begun, interrupted, bar)
    logger.info("training %s after %d steps, %.0f s", stopped, now.step, now.seconds)
    return TrainingReport(stopped, now.step, now.seconds, now.validation, out / FILE_NAME)


class _Run:
    """A run: the model, its optimiser, its data and its folder."""

    def __init__(
        self, config: TrainConfig, pack: Pack, split: Split, out: Path, device: torch.device, start: str | Path | None
    ) -> None:
        self.config, self.split, self.out = config, split, out
        self.data, self.sizes = load_pack(pack, device), batch_sizes(config)
        self.terms = [name for name, weight in config.weights.items() if weight > 0.0]
        self.model = (_seeded_model(config) if start is None else _started_model(config, start)).to(device).train()
        self.optimizer = torch.optim.AdamW(
            self.model.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        )
        self.average = copy.deepcopy(self.model).requires_grad_(False).eval() if config.ema > 0.0 else None
        self.identity = _identity(config, pack, split, start)
        self.notes = {"seed": config.seed, "grasps": len(pack.hand), "hands": list(pack.hand_names)}

    @property
    def kept(self) -> Model:
        """The model that is saved and validates."""
        return self.model if self.average is None else self.average

    def resumed(self) -> Progress:
        """Puts model, running mean and optimiser where the folder's state has them."""
        return load_state(self.out / STATE_NAME, self.model, self.average, self.optimizer, self.identity)

    def save(self, now: Progress) -> None:
        """Writes the model and the state to go on from."""
        notes = {**self.notes, "steps": now.step, "validation": finite(now.validation)}
        save_checkpoint(self.kept, self.out, notes)
        save_state(self.out / STATE_NAME, self.model, self.average, self.optimizer, now, self.identity)

    def step(self, step: int, share: float) -> dict[str, float]:
        """Takes a step; returns the loss and its terms.

        Args:
            step: Number of the step.
            share: How much of the run is done, from 0 to 1.
        """
        config = self.config
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(config, step, share)
        rng = np.random.default_rng((config.seed, step))
        batch = draw_batch(self.data, self.split.train, self.sizes, rng)
        half = config.precision == "bfloat16"
        with torch.autocast(self.data.points.device.type, torch.bfloat16, enabled=half):
            terms = self.model.loss(batch, self.terms, rng)
        loss = torch.stack([term_weight(config, name, step) * term for name, term in terms.items()]).sum()
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), config.clip)
        if not bool(torch.isfinite(norm)):
            raise ConfigError(f"training diverged at step {step}; lower 'learning_rate' ({config.learning_rate:g})")
        self.optimizer.step()
        if self.average is not None:
            # A mean of few steps first, so that the weights it began with do not linger.
            share = max(1.0 - config.ema, 9.0 / (10.0 + step))
            with torch.no_grad():
                for mean, value in zip(self.average.parameters(), self.model.parameters(), strict=True):
                    mean.lerp_(value, share)
        return {name: term.item() for name, term in {"loss": loss, **terms}.items()}

    def validate(self) -> dict[str, float]:
        """Figures on held-out scenes, and on held-out hands under names that begin with `hands_`."""
        figures = validate(self.kept, self.data, self.split.scenes, self.config)
        some = dict(list(self.split.hands.items())[:VALIDATION_SCENES])
        new = validate(self.kept, self.data, some, self.config)
        return {**figures, **{f"hands_{name}": value for name, value in new.items()}}


def _take_steps(run: _Run, begun: Progress, interrupted: threading.Event, bar: tqdm) -> tuple[str, Progress]:
    """Takes the steps of a run from where it stands to its end; returns why it stopped, and where."""
    config, start = run.config, time.monotonic()
    step, figures, saved, saved_at = begun.step, begun.validation, -1, start
    first, mark = begun.step, start
    sums: dict[str, list[float]] = {}

    def now() -> Progress:
        return Progress(step, begun.seconds + time.monotonic() - start, figures)

    def validated() -> Mapping[str, float]:
        found = run.validate()
        if found:
            write_log(run.out, {"step": step, "validation": finite(found)})
        return found

    stopped = "finished"
    while step < config.steps:
        share = step / config.steps
        if config.minutes is not None:
            share = max(share, now().seconds / (60.0 * config.minutes))
        if share >= 1.0 or interrupted.is_set():
            stopped = "interrupted" if interrupted.is_set() else "time"
            break
        for name, value in run.step(step, share).items():
            sums.setdefault(name, []).append(value)
        step += 1
        bar.update()
        if step % config.log_every == 0 or step == config.steps:
            means = {name: float(np.mean(values)) for name, values in sums.items()}
            rate = config.batch * (step - first) / max(time.monotonic() - mark, 1e-9)
            first, mark, sums = step, time.monotonic(), {}
            seconds = round(now().seconds, 3)
            write_log(run.out, {"step": step, "seconds": seconds, "grasps_per_second": round(rate, 1), **means})
            left = (config.steps - step) * config.batch / rate / 60.0
            bar.set_postfix_str(f"loss {means['loss']:.4f}, {rate:.0f} grasps/s, {left:.0f} min left", refresh=False)
        if step % config.validate_every == 0 or step == config.steps:
            figures = validated()
        due = config.save_every is not None and step % config.save_every == 0
        if due or time.monotonic() - saved_at > 60.0 * config.save_minutes:
            run.save(now())
            saved, saved_at = step, time.monotonic()
    if stopped == "time":
        figures = validated()
    if saved != step or stopped == "time":
        run.save(now())
    return stopped, now()


def term_weight(config: TrainConfig, name: str, step: int) -> float:
    """Weight of a term of the loss at a step: it rises over the term's warm-up, where it has one."""
    return config.weights[name] * min(1.0, (step + 1) / max(config.warm_ups.get(name, 0), 1))


def learning_rate(config: TrainConfig, step: int, share: float) -> float:
    """Learning rate of a step: it rises over the warm-up and falls along a cosine to a hundredth.

    Args:
        config: How to train.
        step: Number of the step.
        share: How much of the run is done, from 0 to 1.

    Returns:
        The learning rate.
    """
    rise = min(1.0, (step + 1) / max(config.warm_up, 1))
    return config.learning_rate * rise * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * share)))


@torch.no_grad()
def validate(model: Model, data: Data, held: dict[int, np.ndarray], config: TrainConfig) -> dict[str, float]:
    """Figures on held-out grasps, the same draw at every call.

    Args:
        model: The model.
        data: The data.
        held: The grasps by their scenes.
        config: How to train.

    Returns:
        The terms of the loss; and for everything that the model reconstructs grasps from (`posterior`, `prior`, ...)
        the mean error of links' centers, as `posterior_mm`, and of fingertips, as `posterior_tip_mm`, of the best try;
        nan without any. Empty where there is nothing to validate.
    """
    rng = np.random.default_rng(config.seed)
    rows: list[dict[str, float]] = []
    training = model.training
    model.eval()
    for scene, here in held.items():
        grasps = draw_couples(data, here, max(1, min(VALIDATION_GRASPS, len(here)) // 2), rng)
        batch = make_batch(data, {scene: here}, grasps, Views.plain(1), batch_sizes(config), rng)
        terms = [name for name, weight in config.weights.items() if weight > 0.0]
        row = {name: float(value) for name, value in model.loss(batch, terms, rng).items()}
        for name, tries in model.reconstruct(batch, rng).items():
            origins, tips = pose_errors(tries, batch)
            row[f"{name}_mm"], row[f"{name}_tip_mm"] = float(origins.nanmean()), float(tips.nanmean())
        rows.append(row)
    model.train(training)
    names = dict.fromkeys(name for row in rows for name in row)
    table = {name: np.array([row.get(name, math.nan) for row in rows]) for name in names}
    return {name: float(np.nanmean(v)) if np.isfinite(v).any() else math.nan for name, v in table.items()}


def pose_errors(tries: Tensor, batch: Batch) -> tuple[Tensor, Tensor]:
    """Errors of predicted link poses, the best try of each grasp.

    Args:
        tries: Predicted poses, shape (T, B, L, 9).
        batch: The true grasps.

    Returns:
        Mean error of the links' centers, and of the fingertips (nan for a hand without fingers) [mm], shape (B,) each.
    """
    mask, unit = batch.mask, 1000.0 * LENGTH_UNIT
    link, offset, has = (entry[batch.hand] for entry in batch.keypoints)
    true = keypoints(batch.poses, link, offset)
    finger = has & (link > 0)  # the wrist is the base's only keypoint
    origins, tips = [], []
    for poses in tries:
        apart = (poses - batch.poses)[..., :3].norm(dim=-1).masked_fill(~mask, 0.0)
        origins.append(unit * apart.sum(dim=1) / mask.sum(dim=1))
        off = (keypoints(poses, link, offset) - true).norm(dim=-1).masked_fill(~finger, 0.0)
        tips.append(unit * off.sum(dim=1) / finger.sum(dim=1))
    return torch.stack(origins).amin(dim=0), torch.stack(tips).amin(dim=0)


def split_grasps(pack: Pack, config: TrainConfig) -> Split:
    """Which grasps train and which validate.

    Scenes and hands that the pack holds out are held out; where it names no scene, a fraction of those with grasps is
    drawn, from five scenes on at least one.

    Args:
        pack: The pack.
        config: How to train.

    Returns:
        The split.

    Raises:
        ConfigError: Nothing would be left to train on.
    """
    lifted = pack.outcome == LIFTED
    new_hand = pack.held_hands[pack.hand] > 0
    held = np.flatnonzero(pack.held_scenes)
    if len(held) == 0:
        scenes = np.unique(pack.scene[lifted & ~new_hand])
        count = round(config.validation_fraction * len(scenes))
        if config.validation_fraction > 0.0 and len(scenes) >= 5:
            count = max(count, 1)
        held = np.sort(np.random.default_rng(config.seed).permutation(scenes)[:count])
    new_scene = np.isin(pack.scene, held)
    parts = [
        grasps_of_scenes(pack.scene, np.flatnonzero(lifted & chosen))
        for chosen in (~new_hand & ~new_scene, ~new_hand & new_scene, new_hand)
    ]
    split = Split(*parts)
    if not split.train:
        raise ConfigError("no grasp is left to train on; lower 'validation_fraction', or add scenes and hands")
    return split


def batch_sizes(config: TrainConfig) -> BatchSizes:
    """Sizes of a training step's batch.

    Args:
        config: How to train.

    Returns:
        The sizes.
    """
    return BatchSizes(
        config.batch,
        config.scenes_per_batch,
        config.points,
        config.jitter,
        config.link_points,
        config.max_hands,
        config.mirror,
    )


def _seeded_model(config: TrainConfig) -> Model:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        return make_model(config.kind, config.model)


def _started_model(config: TrainConfig, start: str | Path) -> Model:
    model = load_checkpoint(start)
    found, asked = to_plain(model.config), to_plain(model_config(config.kind, config.model))
    # What a model is made of must agree; how it is taught may not.
    differs = [name for name in asked if name not in ("swap", "free_bits") and found.get(name) != asked[name]]
    if model.kind != config.kind or differs:
        raise ConfigError(
            f"{start}: its model differs from the configuration's in {', '.join(differs) or 'kind'}; "
            "give the same 'model', or start without it"
        )
    model.config = model_config(config.kind, config.model)
    return model


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


def _identity(config: TrainConfig, pack: Pack, split: Split, start: str | Path | None) -> dict[str, dict[str, Any]]:
    """What must not change between a run and its resumption; the lengths of the run and its log may."""
    free = ("steps", "minutes", "log_every", "validate_every", "save_minutes", "save_every", "device")
    settings = {name: value for name, value in asdict(config).items() if name not in free}
    data = {
        "hands": list(pack.hand_names),
        "scenes": list(pack.scene_names),
        "grasps": len(pack.hand),
        "held": [sorted(split.scenes), int(pack.held_hands.sum())],
        "sum": round(float(pack.vectors.sum(dtype=np.float64)), 3),
        "start": None if start is None else checkpoint_digest(start),
    }
    return {"config": settings, "data": data}


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


def main(argv: Sequence[str] | None = None) -> int:
    """The command of this module.

    Args:
        argv: Its arguments; those of the process where None.

    Returns:
        Exit status: 0 done, 2 bad input, 130 interrupted.
    """
    parser = argparse.ArgumentParser(prog="python -m xdex_drake.learning.training", description="Train a model.")
    parser.add_argument("config", nargs="?", type=Path, help="a YAML file; without it all defaults hold")
    parser.add_argument("--pack", type=Path, required=True, help="a training pack")
    parser.add_argument("--out", type=Path, default=Path("model"), help="folder of the model, its log and its state")
    parser.add_argument("--from", dest="start", type=Path, help="a checkpoint whose weights to start from")
    parser.add_argument("--steps", type=int, help="another number of steps")
    parser.add_argument("--minutes", type=float, help="another limit of time")
    arguments = parser.parse_args(argv)
    try:
        config = read_train_config(arguments.config, steps=arguments.steps, minutes=arguments.minutes)
        report = train(config, read_pack(arguments.pack), arguments.out, start=arguments.start)
    except (XdexError, OSError) as error:
        print("training: " + " ".join(str(error).split()), file=sys.stderr)
        return 2
    for name, value in report.lines():
        print(f"{name}  {value}")
    return 130 if report.stopped == "interrupted" else 0


if __name__ == "__main__":
    sys.exit(main())
