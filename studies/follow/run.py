"""Beside dex-retargeting 0.5: the same hands, the same targets, one thread; whose objective is lower, who is faster.

Both follow a clip of a person's hand frame by frame. The published objective is evaluated for both without regulariser
and filter, by one function on one model of the hand. dex-retargeting runs twice: with its own regulariser, which pulls
toward the frame before, and without it. Its time is that of its optimiser alone; ours includes checks of the points,
the wrist frame and the targets.

Run from the repository's root, with the reference hands beside it:

    python studies/follow/run.py --peer PYTHON

PYTHON is an interpreter with dex-retargeting 0.5.0 and torch; where --peer is left out, an environment is made in
`build/dex_retargeting` with pip. Writes results.csv beside this file.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import numpy as np  # noqa: E402
from pydrake.math import RigidTransform  # noqa: E402

import xdex_drake as xd  # noqa: E402
from xdex_drake.arrays import Array  # noqa: E402
from xdex_drake.hand.description import Hand  # noqa: E402
from xdex_drake.hand.kinematics import forward_kinematics  # noqa: E402
from xdex_drake.retargeting.keypoints import TIPS, in_wrist_frame, wrist_frames  # noqa: E402

HERE = Path(__file__).parent
BETA = 0.02
REPEATS = 2
CLIPS, NOISE = 3, 5e-4
"""Clips of as many people, each a stream of its own, and the noise on each coordinate of their points [m]."""

_WORDS = ("thumb", "index", "middle", "ring", "pinky")
HANDS: dict[str, tuple[tuple[str, ...], str]] = {
    "allegro": (("link_15.0_tip", "link_3.0_tip", "link_7.0_tip", "link_11.0_tip"), "wrist"),
    "shadow": (("thtip", "fftip", "mftip", "rftip", "lftip"), "palm"),
    "ability": (tuple(f"{word}_tip" for word in _WORDS), "base_link"),
    "inspire": (tuple(f"{word}_tip" for word in _WORDS), "base"),
    "schunk_svh": (("thtip", "fftip", "mftip", "rftip", "lftip"), "base_link"),
}
"""For each hand the links of its fingertips, thumb first, and the origin of vectors, as dex-retargeting's files say."""


@dataclass(frozen=True)
class Peer:
    """dex-retargeting in its environment, for one hand."""

    python: Path
    job: dict[str, object]

    def ask(self, **more: object) -> dict[str, Array]:
        """Runs `peer.py` and returns what it wrote."""
        with tempfile.TemporaryDirectory() as folder:
            job, out = Path(folder) / "job.json", Path(folder) / "out.npz"
            job.write_text(json.dumps({**self.job, **more}))
            subprocess.run([self.python, HERE / "peer.py", job, out], check=True, capture_output=True, text=True)
            with np.load(out, allow_pickle=False) as file:
                return dict(file)


def environment(folder: Path) -> Path:
    """An interpreter that has dex-retargeting, made where it is missing."""
    python = folder / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        packages = ["dex-retargeting==0.5.0", "torch", "six", "trimesh"]  # it names neither six nor torch itself
        subprocess.run([python, "-m", "pip", "install", "-q", *packages], check=True)
    return python


def same_tips(hand: Hand, facts: dict[str, Array]) -> tuple[Hand, Array]:
    """The hand with its key points at the file's tip links, and the pose X_RH of its wrist in the file's root."""
    links = {joint.name: joint.child for joint in hand.joints}
    fingers = [
        replace(finger, tip_link=links[str(joint)], p_LTip=offset)
        for finger, joint, offset in zip(hand.fingers, facts["joints"], facts["offsets"], strict=True)
    ]
    hand = replace(hand, fingers=tuple(fingers))
    X_HB = np.eye(4)
    X_HB[:3, :3], X_HB[:3, 3] = hand.R_HB, hand.p_HB
    return hand, facts["base"] @ np.linalg.inv(X_HB)


def tips_in_wrist(hand: Hand, q: Array) -> Array:
    """Fingertips in H [m], shape (T, fingers, 3)."""
    R, p = forward_kinematics(hand, RigidTransform(), q)
    links = [hand.link_index[finger.tip_link] for finger in hand.fingers]
    offsets = np.array([finger.p_LTip for finger in hand.fingers])
    return p[:, links] + (R[:, links] @ offsets[:, :, None])[..., 0]


def published(objective: str, r: Array) -> Array:
    """The published objective of residuals (T, fingers, 3), without regulariser, shape (T,)."""
    size = np.abs(r).reshape(len(r), -1) if objective == "position" else np.linalg.norm(r, axis=-1)
    return np.where(size < BETA, size**2 / (2.0 * BETA), size - 0.5 * BETA).mean(axis=1)


def compare(name: str, python: Path, reference: Path) -> list[dict[str, object]]:
    """Rows of one hand."""
    hand = xd.load_hand(name)
    tips, origin = HANDS[name]
    urdf = next((reference / "hands_reference" / name).glob("*.urdf")).resolve()
    job = {"urdf": str(urdf), "tips": tips, "origin": origin, "base": hand.links[0].name, "joints": hand.joint_names}
    peer = Peer(python, job)
    facts = peer.ask()
    hand, X_RH = same_tips(hand, facts)
    at_root = tips_in_wrist(hand, facts["q"]) @ X_RH[:3, :3].T + X_RH[:3, 3]
    model_error = float(np.abs(at_root - facts["tips"]).max())
    if model_error > 1e-6:
        raise RuntimeError(f"{name}: the two models' fingertips differ by {model_error} m")
    shapes = [xd.sample_shape(np.random.default_rng(seed)) for seed in range(CLIPS)]
    clips = [xd.reach_grasp_lift(noise_m=NOISE, seed=k, shape=shape).points for k, shape in enumerate(shapes)]
    points = np.concatenate(clips)
    p_HPs = in_wrist_frame(points, *wrist_frames(points, "right"))
    retargeters, goals, runs = {}, {}, {}
    for objective in ("position", "vector"):
        it = xd.HandRetargeter(hand, objective)
        retargeters[objective] = it = it if objective == "position" else it.calibrated(points)
        goals[objective] = goal = it.scale * p_HPs[:, [TIPS[finger.name] for finger in hand.fingers]]
        # The same residuals in the file's root: positions there, or vectors from its origin link.
        shift = X_RH[:3, 3] - (0.0 if objective == "position" else facts["origin"][:3, 3])
        targets = (goal @ X_RH[:3, :3].T + shift).reshape(CLIPS, -1, *goal.shape[1:]).tolist()
        for kind, delta in (("theirs", 4e-3), ("bare", 0.0)):
            runs[f"{objective}_{kind}"] = {"objective": objective, "normal_delta": delta, "targets": targets}
    found = peer.ask(runs=runs, repeats=REPEATS)
    rows = []
    for objective, retargeter in retargeters.items():
        qs = {kind: found[f"{objective}_{kind}_q"].astype(float) for kind in ("theirs", "bare")}
        seconds = {kind: float(found[f"{objective}_{kind}_seconds"]) for kind in ("theirs", "bare")}
        ours = [follow(retargeter, clips) for _ in range(REPEATS)]
        qs["ours"], seconds["ours"] = ours[0][0], min(one[1] for one in ours)
        start = time.process_time()
        qs["batch"] = retargeter.batch(points).q
        seconds["batch"] = (time.process_time() - start) / len(points)
        rows.append(row((name, objective), retargeter.scale, hand, goals[objective], qs, seconds))
        print({key: f"{value:.5g}" if isinstance(value, float) else value for key, value in rows[-1].items()})
    return rows


def follow(retargeter: xd.HandRetargeter, clips: list[Array]) -> tuple[Array, float]:
    """Joint values of clips, each a stream of its own, and processor time a frame but the first [s]."""
    found, seconds = [], 0.0
    for clip in clips:
        stream = retargeter.stream()
        found.append(stream.follow(clip[0]).q)
        start = time.process_time()
        found += [stream.follow(frame).q for frame in clip[1:]]
        seconds += (time.process_time() - start) / (len(clips) * (len(clip) - 1))
    return np.array(found), seconds


def row(
    what: tuple[str, str], scale: float, hand: Hand, goal: Array, qs: dict[str, Array], seconds: dict[str, float]
) -> dict[str, object]:
    """One row of the table."""
    costs, mm = {}, {}
    name, objective = what
    low, high = hand.limits
    beyond = {kind: float(np.maximum(low - q, q - high).max()) for kind, q in qs.items()}
    # Their limits are a milliradian wider: what that gains is shown apart, and all are compared within the limits.
    wide = {
        kind: float(published(objective, tips_in_wrist(hand, qs[kind]) - goal).mean()) for kind in ("theirs", "bare")
    }
    for kind, q in ((kind, np.clip(q, low, high)) for kind, q in qs.items()):
        r = tips_in_wrist(hand, q) - goal
        costs[kind], mm[kind] = published(objective, r), 1e3 * np.linalg.norm(r, axis=-1).mean()
    best = {kind: 1e3 * value for kind, value in seconds.items()}
    steps = {kind: float(np.abs(np.diff(q.reshape(CLIPS, -1, len(low)), axis=1)).max()) for kind, q in qs.items()}
    return {
        "hand": name,
        "objective": objective,
        "frames": len(goal),
        "scale": round(scale, 4),
        **{f"cost_{kind}": float(costs[kind].mean()) for kind in qs},
        **{f"mm_{kind}": float(mm[kind]) for kind in qs},
        "frames_worse": int((costs["ours"] > 1.0001 * np.minimum(costs["theirs"], costs["bare"]) + 1e-9).sum()),
        **{f"cost_{kind}_wide": wide[kind] for kind in wide},
        **{f"beyond_{kind}_rad": beyond[kind] for kind in ("theirs", "bare", "ours")},
        **{f"step_{kind}_rad": steps[kind] for kind in ("theirs", "bare", "ours")},
        **{f"ms_{kind}": best[kind] for kind in best},
        "times_faster": best["theirs"] / best["ours"],
        "times_faster_than_bare": best["bare"] / best["ours"],
    }


def main() -> None:
    """Writes results.csv."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer", type=Path, help="an interpreter with dex-retargeting 0.5.0 and torch")
    parser.add_argument("--reference", type=Path, default=Path("../shared"))
    parser.add_argument("--hands", nargs="*", default=list(HANDS))
    parser.add_argument("--out", type=Path, default=HERE / "results.csv")
    options = parser.parse_args()
    python = options.peer or environment(Path("build/dex_retargeting"))
    rows = [line for name in options.hands for line in compare(name, python, options.reference)]
    with options.out.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        for line in rows:
            writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in line.items()})


if __name__ == "__main__":
    main()
