"""Probabilities that a certified grasp lifts, and that it also holds, from what is stored with it.

A score is computed when it is asked for and never stored: grasps keep facts, and another fit gives other probabilities.
Its form is additive: the log-odds are a constant and a piecewise-linear curve of each feature, so that each curve can
be read and plotted. `studies/scores` fits the curves and says how well they foretell on hands and objects that the fit
has not seen.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.contact.held_object import GRAVITY
from xdex_drake.errors import ConfigError
from xdex_drake.grasp import Certificate, Grasp
from xdex_drake.typed_yaml import from_plain

FILE = Path(__file__).with_name("scores.json")
"""The curves that ship."""


@dataclass(frozen=True)
class Curve:
    """What a feature adds to the log-odds: linear between knots, constant beyond them.

    Attributes:
        feature: Name of the feature.
        knots: Where the curve bends, ascending [unit of the feature].
        values: Log-odds at the knots.
        missing: Log-odds where the feature is not known.
    """

    feature: str
    knots: tuple[float, ...]
    values: tuple[float, ...]
    missing: float


@dataclass(frozen=True)
class Score:
    """A probability of a grasp.

    Attributes:
        constant: Log-odds that all grasps share.
        curves: What each feature adds.
    """

    constant: float
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class Scores:
    """The scores of one fit.

    Attributes:
        version: What the fit is called; figures of different versions do not compare.
        lift: Of lifting by the protocol `lift-0.2/2tips`.
        hold: Of passing the protocol `hold`: lifting, and staying in the hand under six pushes.
    """

    version: str
    lift: Score
    hold: Score


def _forces(grasp: Grasp, proof: Certificate) -> Array:
    """Normal forces over the weight, shape (n,)."""
    return np.array([contact.f_C[2] for contact in proof.contacts]) / (proof.mass * GRAVITY)


def _heights(grasp: Grasp, proof: Certificate) -> Array:
    """Heights of the contacts above the table [m], shape (n,)."""
    return np.array([(grasp.X_WO @ contact.p_OC)[2] for contact in proof.contacts])


def _offset(grasp: Grasp, proof: Certificate) -> float:
    """Horizontal distance of the contacts' middle from the center of mass, in `length`."""
    middle = np.mean([grasp.X_WO @ contact.p_OC for contact in proof.contacts], axis=0)
    return float(np.linalg.norm((middle - grasp.X_WO @ proof.p_OOcm)[:2]) / proof.length)


def _logarithm(value: float) -> float:
    return float(np.log(value)) if value > 0.0 else float("nan")


FEATURES: dict[str, Callable[[Grasp, Certificate], float]] = {
    "task_margin": lambda grasp, proof: proof.task_margin,
    "ball_margin": lambda grasp, proof: proof.margin_lower,
    "friction_left": lambda grasp, proof: proof.friction_left,
    "foretold_motion": lambda grasp, proof: grasp.foretold_motion,
    "squeeze_margin": lambda grasp, proof: grasp.squeeze_margin,
    "log_stiffness": lambda grasp, proof: _logarithm(grasp.stiffness_least),
    "contacts": lambda grasp, proof: float(len(proof.contacts)),
    "log_squeeze": lambda grasp, proof: _logarithm(float(_forces(grasp, proof).sum())),
    "log_weakest": lambda grasp, proof: _logarithm(float(_forces(grasp, proof).min())),
    "lowest_contact_mm": lambda grasp, proof: 1e3 * float(_heights(grasp, proof).min()),
    "center_height_mm": lambda grasp, proof: 1e3 * float((grasp.X_WO @ proof.p_OOcm)[2]),
    "offset": _offset,
    "length_mm": lambda grasp, proof: 1e3 * proof.length,
    "penetration_mm": lambda grasp, proof: 1e3 * max(grasp.penetration_parts_m, grasp.penetration_mesh_m),
}
"""What may foretell an outcome, from a grasp and its certificate; NaN where it is not known."""


def features(grasps: Sequence[Grasp]) -> Array:
    """What may foretell the outcome of grasps.

    Args:
        grasps: The grasps.

    Returns:
        A row a grasp and a column for each of `FEATURES`; NaN where it is not known, throughout without a certificate.
    """
    rows = np.full((len(grasps), len(FEATURES)), np.nan)
    for row, grasp in zip(rows, grasps, strict=True):
        if grasp.certificate is not None and grasp.certificate.contacts:
            row[:] = [feature(grasp, grasp.certificate) for feature in FEATURES.values()]
    return rows


def probability(score: Score, x: Array) -> Array:
    """A score's probabilities.

    Args:
        score: The score.
        x: Features, as `features` gives them, shape (n, number of `FEATURES`).

    Returns:
        Probabilities, shape (n,); NaN where no feature is known.
    """
    names, log_odds = list(FEATURES), np.full(len(x), score.constant)
    for curve in score.curves:
        column = x[:, names.index(curve.feature)]
        log_odds += np.where(np.isnan(column), curve.missing, np.interp(column, curve.knots, curve.values))
    return np.where(np.isnan(x).all(axis=1), np.nan, 1.0 / (1.0 + np.exp(-log_odds)))


def read_scores(path: str | Path) -> Scores:
    """Reads the scores of a fit.

    Args:
        path: A JSON file, as `studies/scores/fit.py` writes it.

    Returns:
        The scores.

    Raises:
        ConfigError: The file cannot be read, or holds no scores of these features.
    """
    try:
        values = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}; give a file of studies/scores/fit.py") from None
    scores = from_plain(values, Scores, str(path))
    for curve in (*scores.lift.curves, *scores.hold.curves):
        if curve.feature not in FEATURES:
            raise ConfigError(f"{path}: there is no feature {curve.feature!r}; use {', '.join(FEATURES)}")
        if not len(curve.knots) == len(curve.values) > 0 or np.any(np.diff(curve.knots) <= 0.0):
            raise ConfigError(f"{path}: the curve of {curve.feature} needs ascending knots and a value for each")
    return scores


@cache
def shipped_scores() -> Scores:
    """The scores that ship with the library."""
    return read_scores(FILE)


def lift_probability(grasps: Sequence[Grasp]) -> Array:
    """Probability that each grasp lifts, by the fit that ships; NaN without a certificate, shape (n,)."""
    return probability(shipped_scores().lift, features(grasps))


def hold_probability(grasps: Sequence[Grasp]) -> Array:
    """Probability that each grasp lifts and holds, by the fit that ships; NaN without a certificate, shape (n,)."""
    return probability(shipped_scores().hold, features(grasps))
