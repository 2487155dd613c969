"""Hands of packages from PyPI that the importer was not made for, held against a table made by hand.

`python studies/hands/packages.py FOLDER [--grasp]` downloads the packages by pip into FOLDER, imports each hand, and
compares z_H and x_H in the base frame (within 10 degrees), the fingers' last links, and the number of actuated and of
all joints. With `--grasp`, `xdex grasp` then grasps the can, three grasps for each hand. It writes packages.csv.

The hands have at least two moving fingers, and are none of those of the library's five makers, of MuJoCo Menagerie or
of dex-urdf. The table's directions were read off the drawings: along the stretched fingers, and to where they close;
x_H of a gripper may point to either jaw.
"""

import argparse
import csv
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from xdex_drake.errors import XdexError
from xdex_drake.hand.importing.files import import_hand
from xdex_drake.hand.yaml_file import write_hand

X, Y, Z = np.eye(3)


@dataclass(frozen=True)
class Expected:
    """A hand and what its import should find: z_H and x_H in the base frame, number of fingers, joints."""

    package: str
    file: str
    z: np.ndarray
    x: np.ndarray
    fingers: int
    side: str | None = None
    jaws: bool = False  # x_H may point either way.


SUITE = "robosuite/models/assets/grippers"
ORCA = "orca_sim"
DEXMATE = "dexmate_urdf/robots/hands"
DATA = "cmeel.prefix/share/example-robot-data/robots"
HANDS = (
    Expected("robosuite", f"{SUITE}/fourier_right_hand.xml", -Y, -X, 5),
    Expected("robosuite", f"{SUITE}/fourier_left_hand.xml", -Y, -X, 5),
    Expected("robosuite", f"{SUITE}/jaco_three_finger_gripper.xml", Z, -Y, 3),
    Expected("robosuite", f"{SUITE}/robotiq_gripper_s.xml", Y, X, 3),
    Expected("robosuite", f"{SUITE}/robotiq_gripper_140.xml", -Z, X, 2, jaws=True),
    Expected("robosuite", f"{SUITE}/rethink_gripper.xml", Z, Y, 2, jaws=True),
    Expected("orca-sim", f"{ORCA}/scene_right.xml", Z, Y, 5),
    Expected("orca-sim", f"{ORCA}/scene_left.xml", Z, Y, 5),
    Expected("orca-sim", f"{ORCA}/scene_right_extended.xml", Z, Y, 5),
    Expected("orca-sim", f"{ORCA}/scene_left_extended.xml", Z, Y, 5),
    Expected("dexmate-urdf", f"{DEXMATE}/f5d6_hand/f5d6_right.urdf", Z, X, 5),
    Expected("dexmate-urdf", f"{DEXMATE}/f5d6_hand/f5d6_left.urdf", Z, X, 5),
    Expected("dexmate-urdf", f"{DEXMATE}/dexs_gripper/dexs_gripper.urdf", Z, X, 2, jaws=True),
    Expected("dexmate-urdf", f"{DEXMATE}/dexd_gripper/dexd_gripper.urdf", Z, Y, 2, jaws=True),
    Expected("example-robot-data", f"{DATA}/tiago_description/robots/tiago.urdf", Z, X, 5),
    Expected("example-robot-data", f"{DATA}/romeo_description/urdf/romeo.urdf", X, -Z, 4, "right"),
    Expected("example-robot-data", f"{DATA}/pr2_description/urdf/pr2.urdf", X, Y, 2, "right", jaws=True),
    Expected("example-robot-data", f"{DATA}/baxter_description/urdf/baxter.urdf", Z, Y, 2, "right", jaws=True),
    Expected("example-robot-data", f"{DATA}/alex_description/urdf/alex_sake_hands.urdf", -Z, Y, 2, "right", jaws=True),
    Expected("mani-skill", "mani_skill/assets/robots/fetch/fetch.urdf", X, Y, 2, jaws=True),
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


def grasped(file: Path) -> int:
    """Number of three grasps of the can that lift it."""
    command = ["xdex", "grasp", "--hand", str(file), "--object", "can", "--count", "3", "--workers", "1", "--seed", "0"]
    done = subprocess.run([*command, "--out", str(file.with_suffix(".parquet"))], capture_output=True, text=True)
    return next((int(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("lifted  ")), 0)


def main() -> None:
    """Writes a line for each hand."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--grasp", action="store_true")
    options = parser.parse_args()
    rows = []
    for hand in HANDS:
        path = fetched(hand.package, options.folder) / hand.file
        row = {
            "package": hand.package,
            "hand": path.stem,
            "z_off_deg": "",
            "x_off_deg": "",
            "fingers": "",
            "lifted": "",
        }
        try:
            found = import_hand(path, side=hand.side).hand
        except XdexError as error:
            row["fingers"] = f"refused: {error}".replace(str(options.folder), "")[:120]
        else:
            row["z_off_deg"] = f"{angle(found.R_HB[2], hand.z):.1f}"
            row["x_off_deg"] = f"{angle(found.R_HB[0], hand.x, hand.jaws):.1f}"
            row["fingers"] = f"{len(found.fingers)} of {hand.fingers}"
            if options.grasp:
                write_hand(found, file := options.folder / f"{path.stem}.yaml")
                row["lifted"] = f"{grasped(file)} of 3"
        rows.append(row)
        print(*row.values(), flush=True)
    with (Path(__file__).parent / "packages.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0])
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
