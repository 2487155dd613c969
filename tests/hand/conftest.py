"""The reference data in the terms of our descriptions."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from xdex_drake.arrays import Array
from xdex_drake.hand.description import Hand


def _transform(joint: dict, q: float = 0.0) -> Array:
    """X_PC of a URDF joint at a value, shape (4, 4)."""
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = joint["origin_rotation"], joint["origin_xyz"]
    if joint["type"] != "fixed":
        X[:3, :3] = X[:3, :3] @ Rotation.from_rotvec(np.array(joint["axis"]) * q).as_matrix()
    return X


def _fk_cases(folder: Path, hand: Hand) -> list[dict]:
    """Cases of `fk_vectors.json`: q, and positions of links and fingertips in our base link B."""
    kinematics = json.loads((folder / "hands_reference" / "kinematics.json").read_text())["hands"][hand.name]
    vectors = json.loads((folder / "hands_reference" / "fk_vectors.json").read_text())["hands"][hand.name]
    tip_key = {"little": "pinky"}
    cases = []
    for case in vectors["cases"]:
        X = np.eye(4)
        if hand.name == "shadow":  # Our base is the palm, beyond the forearm and the wrist joints.
            for link in kinematics["links"]:
                if link["name"] in ("forearm", "wrist", "palm"):
                    X = X @ _transform(link["joint"], case["actuated"].get(link["joint"]["name"], 0.0))
        to_B = np.linalg.inv(X)

        def in_B(p: list[float], to_B: Array = to_B) -> Array:
            return to_B[:3, :3] @ np.array(p) + to_B[:3, 3]

        cases.append(
            {
                "q": np.array([case["actuated"][name] for name in hand.joint_names]),
                "links": {link.name: in_B(case["links"][link.name]) for link in hand.links[1:]},
                "tips": {f.name: in_B(case["tips"][tip_key.get(f.name, f.name)]["position"]) for f in hand.fingers},
            }
        )
    return cases


@pytest.fixture(scope="session")
def fk_cases(reference: Path) -> Callable[[Hand], list[dict]]:
    """Function that gives the reference cases of a hand of the library."""
    return lambda hand: _fk_cases(reference, hand)


@pytest.fixture(scope="session")
def reference_kinematics(reference: Path) -> dict:
    """Facts of each reference hand, from `kinematics.json`."""
    return json.loads((reference / "hands_reference" / "kinematics.json").read_text())["hands"]
