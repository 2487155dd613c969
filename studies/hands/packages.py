"""Hands of packages from PyPI that the importer was not made for, held against a table made by hand.

`python studies/hands/packages.py FOLDER [--grasp]` downloads the packages by pip into FOLDER, imports each hand, and
compares z_H and x_H in the base frame (within 10 degrees), the fingers, and the number of actuated and of all joints.
With `--grasp` it then runs `xdex grasp --hand HAND --object can --count 3 --workers 1 --time-limit SECONDS` for each.
It writes packages.csv; a line whose hand is the same as before keeps its grasps.

The hands have at least two moving fingers, and are none of those of the library's five makers, of MuJoCo Menagerie or
of dex-urdf. The table's directions were read off the drawings: along the stretched fingers, and to where they close;
x_H of a gripper may point to either jaw. Couplings are those that the file states: tiago's, for one, states none.
packages.csv lacks the hands, and the grasps, that were not run yet; its limit was 300 s for the first five and 150 s
for the others, on a machine so busy that these gave a hand some 20 s of processor time.
"""

import argparse
import csv
import os
import subprocess
import sys
import time
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from xdex_drake.errors import XdexError
from xdex_drake.hand.importing.files import import_hand
from xdex_drake.hand.yaml_file import hand_digest, write_hand

X, Y, Z = np.eye(3)
COLUMNS = (
    "package",
    "hand",
    "z_off_deg",
    "x_off_deg",
    "fingers",
    "joints",
    "lifted",
    "tried",
    "cpu_s",
    "digest",
    "says",
)


@dataclass(frozen=True)
class Expected:
    """A hand and what its import should find: z_H and x_H in the base frame, fingers, actuated and all joints."""

    package: str
    file: str
    z: np.ndarray
    x: np.ndarray
    fingers: int
    joints: tuple[int, int]
    side: str | None = None
    jaws: bool = False  # x_H may point either way.


SUITE = "robosuite/models/assets/grippers"
ORCA = "orca_sim"
DEXMATE = "dexmate_urdf/robots/hands"
DATA = "cmeel.prefix/share/example-robot-data/robots"
HANDS = (
    Expected("robosuite", f"{SUITE}/fourier_right_hand.xml", -Y, -X, 5, (11, 11)),
    Expected("robosuite", f"{SUITE}/fourier_left_hand.xml", -Y, -X, 5, (11, 11)),
    Expected("robosuite", f"{SUITE}/jaco_three_finger_gripper.xml", Z, -Y, 3, (3, 6)),
    Expected("robosuite", f"{SUITE}/robotiq_gripper_s.xml", Y, X, 3, (4, 11)),
    Expected("robosuite", f"{SUITE}/robotiq_gripper_140.xml", -Z, X, 2, (2, 6), jaws=True),
    Expected("robosuite", f"{SUITE}/rethink_gripper.xml", Z, Y, 2, (2, 2), jaws=True),
    Expected("orca-sim", f"{ORCA}/scene_right.xml", Z, Y, 5, (16, 16)),
    Expected("orca-sim", f"{ORCA}/scene_left.xml", Z, Y, 5, (16, 16)),
    Expected("orca-sim", f"{ORCA}/scene_right_extended.xml", Z, Y, 5, (16, 16)),
    Expected("orca-sim", f"{ORCA}/scene_left_extended.xml", Z, Y, 5, (16, 16)),
    Expected("dexmate-urdf", f"{DEXMATE}/f5d6_hand/f5d6_right.urdf", Z, X, 5, (6, 11)),
    Expected("dexmate-urdf", f"{DEXMATE}/f5d6_hand/f5d6_left.urdf", Z, X, 5, (6, 11)),
    Expected("dexmate-urdf", f"{DEXMATE}/dexs_gripper/dexs_gripper.urdf", Z, X, 2, (1, 2), jaws=True),
    Expected("dexmate-urdf", f"{DEXMATE}/dexd_gripper/dexd_gripper.urdf", Z, Y, 2, (1, 2), jaws=True),
    Expected("example-robot-data", f"{DATA}/tiago_description/robots/tiago.urdf", Z, X, 5, (33, 33)),
    Expected("example-robot-data", f"{DATA}/romeo_description/urdf/romeo.urdf", X, -Z, 4, (1, 12), "right"),
    Expected("example-robot-data", f"{DATA}/pr2_description/urdf/pr2.urdf", X, Y, 2, (1, 4), "right", jaws=True),
    Expected("example-robot-data", f"{DATA}/baxter_description/urdf/baxter.urdf", Z, Y, 2, (1, 2), "right", jaws=True),
    Expected(
        "example-robot-data",
        f"{DATA}/alex_description/urdf/alex_sake_hands.urdf",
        -Z,
        Y,
        2,
        (2, 2),
        "right",
        jaws=True,
    ),
    Expected("mani-skill", "mani_skill/assets/robots/fetch/fetch.urdf", X, Y, 2, (2, 2), jaws=True),
)
"""Written after the files of robosuite, orca and egk40 had been tried; claws, bars and fingers drawn half bent were
mended on jaco, robotiq_s, robotiq_140 and f5d6. Files without a finger or a shape are left out. The row of romeo was
read wrongly at first: its fingers are drawn closed, and point along X where they are open."""


def fetched(package: str, folder: Path) -> Path:
    """The unpacked wheel of a package, downloaded where it is not there yet."""
    target = folder / package
    if not target.is_dir():
        command = [sys.executable, "-m", "pip", "download", "--no-deps", "-q", "-d", str(folder / "wheels"), package]
        subprocess.run(command, check=True)
        (wheel,) = (folder / "wheels").glob(f"{package.replace('-', '_')}-*.whl")
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(target)
    return target


def angle(a: np.ndarray, b: np.ndarray, either: bool = False) -> float:
    """Angle between two unit vectors, or lines [deg]."""
    cosine = float(a @ b)
    return float(np.degrees(np.arccos(np.clip(abs(cosine) if either else cosine, -1.0, 1.0))))


def grasped(file: Path, limit: float) -> dict[str, str]:
    """Number of three grasps of the can that lift it, candidates tried, and processor time."""
    out = file.with_suffix(".parquet")
    out.unlink(missing_ok=True)
    command = [sys.executable, "-m", "xdex_drake", "grasp", "--hand", str(file), "--object", "can", "--count", "3"]
    command += ["--workers", "1", "--seed", "0", "--time-limit", str(limit)]
    before = os.times()
    done = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True)
    after = os.times()
    lines = done.stdout.splitlines()

    def told(word: str, default: str = "") -> str:
        return next((line[len(word) :].strip() for line in lines if line.startswith(f"{word}  ")), default)

    lifted = min(3, int(told("lifted", "0")))
    why = [f"{word}: {told(word)}" for word in ("rejected by", "failed by") if told(word)] if lifted < 3 else []
    if not lines:
        why = done.stderr.strip().splitlines()[-1:]

    seconds = after.children_user + after.children_system - before.children_user - before.children_system
    return {
        "lifted": f"{lifted} of 3",
        "tried": told("tried", "0"),
        "cpu_s": f"{seconds:.0f}",
        "says": "; ".join(why)[:160].replace(str(file.parent), ""),
    }


def line(hand: Expected, folder: Path, before: dict[str, dict[str, str]], limit: float | None) -> dict[str, str]:
    """What became of one hand."""
    path = fetched(hand.package, folder) / hand.file
    row = dict.fromkeys(COLUMNS, "") | {"package": hand.package, "hand": path.stem}
    try:
        found = import_hand(path, side=hand.side).hand
    except XdexError as error:
        return row | {"says": f"refused: {error}".replace(str(folder), "")[:160]}
    row["z_off_deg"] = f"{angle(found.R_HB[2], hand.z):.1f}"
    row["x_off_deg"] = f"{angle(found.R_HB[0], hand.x, hand.jaws):.1f}"
    row["fingers"] = f"{len(found.fingers)} of {hand.fingers}"
    row["joints"] = f"{len(found.joint_names)}/{len(found.joints)} of {hand.joints[0]}/{hand.joints[1]}"
    row["digest"] = hand_digest(found)[:16]
    old = before.get(path.stem, {})
    if old.get("digest") == row["digest"] and old.get("lifted"):
        return row | {key: old[key] for key in ("lifted", "tried", "cpu_s", "says")}
    if limit is not None:
        write_hand(found, file := folder / f"{path.stem}.yaml")
        row |= grasped(file, limit)
    return row


def main() -> None:
    """Writes a line for each hand, after each of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--grasp", action="store_true")
    parser.add_argument("--time-limit", type=float, default=60.0, help="for each hand [s]")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "packages.csv")
    options = parser.parse_args()
    before = {}
    if options.out.exists():
        before = {row["hand"]: row for row in csv.DictReader(options.out.open(encoding="utf-8"))}
    for hand in HANDS:
        start = time.monotonic()
        row = line(hand, options.folder, before, options.time_limit if options.grasp else None)
        before[row["hand"]] = row
        print(*(row[key] for key in COLUMNS if key != "digest"), f"({time.monotonic() - start:.0f} s)", flush=True)
        names = [Path(hand.file).stem for hand in HANDS]
        with options.out.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n", extrasaction="ignore")
            writer.writeheader()
            writer.writerows(before[name] for name in names if name in before)


if __name__ == "__main__":
    main()
