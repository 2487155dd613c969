"""Fits the scores P(lift) and P(hold), and says how well they foretell on hands and objects that a fit has not seen.

    python studies/scores/fit.py features studies/scores/features.parquet SHARDS...
    python studies/scores/fit.py fit studies/scores/features.parquet --version 2026.1

The first command reads the features of certified grasps with lifts from shards of data sets, or files of `make.py`; the
second fits and writes `xdex_drake/grasping/scores.json` and `results.json`. Hands and objects are each split into three
by their names. Each of the nine blocks is foretold by a fit on rows that share neither a hand nor an object with it, so
that every figure is of unseen hands and objects; the scores that ship are fitted to all rows. Files whose name begins
with `test-` are never fitted to: their figures are of the scores that ship, on meshes and hands of their own.
"""

import argparse
import hashlib
import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import log_loss, roc_auc_score
from sklearn.preprocessing import SplineTransformer

from xdex_drake.dataset.grasp_file import read_grasps, read_metadata
from xdex_drake.dataset.schema import grasp_from_row
from xdex_drake.grasping.scores import FEATURES, FILE, Curve, Score, Scores, features, probability
from xdex_drake.typed_yaml import to_plain

NAMES = list(FEATURES)
PARTS = 3
BINS = 10
QUANTILES = (0.02, 0.15, 0.35, 0.65, 0.85, 0.98)
BENDS = (0.5, 2.0, 6.0)
"""Weights of bends beside slopes: the smaller, the straighter the curves."""

PENALTIES = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Inverse strengths of the ridge; the pair of least log-loss on unseen hands and objects is taken."""


def feature_table(files: list[Path]) -> pa.Table:
    """Features and outcomes of the certified and lifted grasps of some files."""
    rows, x, commits = [], [], set()
    for file in sorted(files):
        commits.add(read_metadata(file).get("xdex_commit", ""))
        stored = [row for row in read_grasps(file) if row["success"] is not None and row["contacts"]]
        x.append(features([grasp_from_row(row) for row in stored]))
        for row in stored:
            is_test = file.name.startswith("test-")
            facts = {"hand": row["hand"], "object": row["object"], "carried": bool(row["source_grasp_id"])}
            rows.append({**facts, "test": is_test, "lift": row["success"], "hold": row["holds"]})
    columns = {name: pa.array([row[name] for row in rows]) for name in rows[0]}
    columns |= {name: pa.array(column, pa.float32()) for name, column in zip(NAMES, np.concatenate(x).T, strict=True)}
    return pa.table(columns).replace_schema_metadata({"commits": ", ".join(sorted(commits - {""}))})


@dataclass(frozen=True)
class Ramp:
    """A feature's knots, and the mean and deviation by which it is scaled."""

    knots: np.ndarray
    mean: float
    deviation: float


def ramp_of(column: np.ndarray) -> Ramp:
    """Knots at quantiles of a feature."""
    known = column[np.isfinite(column)]
    knots = np.unique(np.quantile(known, QUANTILES).round(6)) if len(known) else np.zeros(1)
    clipped = np.clip(known, knots[0], knots[-1])
    return Ramp(knots, float(clipped.mean()) if len(known) else 0.0, float(clipped.std()) or 1.0 if len(known) else 1.0)


def basis(x: np.ndarray, ramps: list[Ramp], bend: float) -> np.ndarray:
    """Of each feature, clipped to its knots: itself, scaled; bends about the knots; and whether it is missing.

    A ridge then asks for few bends rather than for little slope.
    """
    columns = []
    for column, ramp in zip(x.T, ramps, strict=True):
        known = np.isfinite(column)
        hats, line = np.zeros((len(x), len(ramp.knots))), np.zeros((len(x), 1))
        if len(ramp.knots) > 1 and known.any():
            spline = SplineTransformer(degree=1, knots=ramp.knots[:, None], extrapolation="constant")
            hats[known] = bend * spline.fit_transform(column[known, None])
            clipped = np.clip(column[known, None], ramp.knots[0], ramp.knots[-1])
            line[known] = (clipped - ramp.mean) / ramp.deviation
        columns += [line, hats, ~known[:, None]]
    return np.concatenate(columns, axis=1)


def fitted(x: np.ndarray, y: np.ndarray, setting: tuple[float, float]) -> Score:
    """An additive score by logistic regression with a ridge."""
    (penalty, bend), ramps = setting, [ramp_of(column) for column in x.T]
    model = LogisticRegression(C=penalty, max_iter=5000).fit(basis(x, ramps, bend), y)
    weights, curves, position = model.coef_[0], [], 0
    for name, ramp in zip(NAMES, ramps, strict=True):
        slope, *bends, missing = weights[position : position + len(ramp.knots) + 2]
        position += len(ramp.knots) + 2
        values = slope * (ramp.knots - ramp.mean) / ramp.deviation + bend * np.array(bends)
        values = values if len(ramp.knots) > 1 else np.zeros(1)
        curves.append(Curve(name, tuple(ramp.knots.tolist()), tuple(values.round(5).tolist()), round(missing, 5)))
    return Score(round(float(model.intercept_[0]), 5), tuple(curves))


def part(name: str) -> int:
    """Which third a hand or an object belongs to."""
    return hashlib.sha256(name.encode()).digest()[0] % PARTS


def blocks(hands: np.ndarray, objects: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Rows to fit to and rows to foretell, which share neither a hand nor an object."""
    h, o = np.array([part(name) for name in hands]), np.array([part(name) for name in objects])
    for a in range(PARTS):
        for b in range(PARTS):
            yield (h != a) & (o != b), (h == a) & (o == b)


def foretold(
    x: np.ndarray, y: np.ndarray, hands: np.ndarray, objects: np.ndarray, setting: tuple[float, float]
) -> np.ndarray:
    """Probability of each row by a fit that has seen neither its hand nor its object."""
    p = np.full(len(y), np.nan)
    for fit, rest in blocks(hands, objects):
        if rest.any():
            p[rest] = probability(fitted(x[fit], y[fit], setting), x[rest])
    return p


def calibration_error(p: np.ndarray, y: np.ndarray) -> float:
    """Mean difference of the mean probability and the share that came true, over bins of as many rows each."""
    order = np.argsort(p, kind="stable")
    return float(sum(abs((p[some] - y[some]).sum()) for some in np.array_split(order, BINS)) / len(p))


def judged(p: np.ndarray, y: np.ndarray) -> dict[str, float]:
    """Figures of probabilities against what came true."""
    rng, base = np.random.default_rng(0), y.mean()
    chance = [calibration_error(p, rng.uniform(size=len(p)) < p) for _ in range(200)]
    brier, of_base = float(((p - y) ** 2).mean()), float(((base - y) ** 2).mean())
    return {
        "rows": len(y),
        "failures": int((~y).sum()),
        "rate": round(float(base), 4),
        "mean_probability": round(float(p.mean()), 4),
        "auc": round(float(roc_auc_score(y, p)), 4) if 0 < y.sum() < len(y) else float("nan"),
        "brier_skill": round(1.0 - brier / of_base, 4) if of_base else float("nan"),
        "calibration_error": round(calibration_error(p, y), 4),
        "calibration_error_by_chance": round(float(np.mean(chance)), 4),
    }


def fit(path: Path, version: str) -> None:
    """Fits both scores and writes them with their figures."""
    table = pq.read_table(path)
    x = np.stack([table[name].to_numpy().astype(np.float64) for name in NAMES], axis=1)
    hands, objects = (table[name].to_numpy(zero_copy_only=False) for name in ("hand", "object"))
    test = table["test"].to_numpy(zero_copy_only=False).astype(bool)
    results: dict = {"version": version, "commits": (table.schema.metadata or {}).get(b"commits", b"").decode()}
    scores = {}
    for name in ("lift", "hold"):
        outcome = table[name].to_numpy(zero_copy_only=False)
        known = np.array([value is not None for value in outcome])
        y = np.array([value is True or value == np.True_ for value in outcome])
        rows = known & ~test
        data = x[rows], y[rows], hands[rows], objects[rows]
        losses = {s: float(log_loss(data[1], foretold(*data, s))) for s in itertools.product(PENALTIES, BENDS)}
        setting = min(losses, key=losses.__getitem__)
        scores[name] = fitted(data[0], data[1], setting)
        results[name] = {"penalty": setting[0], "bend": setting[1]}
        results[name]["unseen"] = judged(foretold(*data, setting), data[1])
        results[name]["alone"] = alone(*data)
        if (known & test).any():
            results[name]["test"] = judged(probability(scores[name], x[known & test]), y[known & test])
    shipped = Scores(version, scores["lift"], scores["hold"])
    FILE.write_text(json.dumps(to_plain(shipped), indent=1) + "\n", encoding="utf-8")
    path.with_name("results.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(results, indent=1))


def alone(x: np.ndarray, y: np.ndarray, hands: np.ndarray, objects: np.ndarray) -> dict[str, float]:
    """Area under the ROC curve of each feature by itself, either way round; a missing one counts as the median."""
    areas = {}
    for name, column in zip(NAMES, x.T, strict=True):
        filled = np.where(np.isnan(column), np.nanmedian(column) if np.isfinite(column).any() else 0.0, column)
        area = float(roc_auc_score(y, filled))
        areas[name] = round(max(area, 1.0 - area), 3)
    return areas


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("features", "fit"))
    parser.add_argument("table", type=Path)
    parser.add_argument("shards", nargs="*", type=Path)
    parser.add_argument("--version", default="1")
    options = parser.parse_args()
    if options.what == "features":
        found = feature_table(options.shards)
        pq.write_table(found, options.table, compression="zstd")
        print(f"{len(found)} grasps: {options.table}")
    else:
        fit(options.table, options.version)
