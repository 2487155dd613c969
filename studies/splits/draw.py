"""Draws what is kept out of training and tuning, once, by seed.

Run `python studies/splits/draw.py REFERENCE/objects/index.json`; it writes `held_out.yaml`, for people and for studies,
and `validation.yaml`, for `xdex dataset pack --splits`.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import yaml

from xdex_drake.hand.generation import HUMAN_EVERY, hand_name

SEED = 20
DEVELOPMENT = 12
HANDS = 1000
KEPT = 20
"""Generated hands that test, and as many that validate; a fifth of them human, as of all."""


def drawn_hands() -> tuple[list[str], list[str]]:
    """Names of the generated hands that test, and of those that validate."""
    rng = np.random.default_rng([SEED, 1])
    humans = rng.permutation(np.arange(0, HANDS, HUMAN_EVERY))
    robots = rng.permutation([k for k in range(HANDS) if k % HUMAN_EVERY])
    few, many = KEPT // HUMAN_EVERY, KEPT - KEPT // HUMAN_EVERY
    groups = [[*humans[k * few : (k + 1) * few], *robots[k * many : (k + 1) * many]] for k in range(2)]
    test, validation = ([hand_name(0, int(k)) for k in sorted(group)] for group in groups)
    return test, validation


def main() -> None:
    """Writes the files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("index", type=Path)
    meshes = sorted(entry["name"] for entry in json.loads(parser.parse_args().index.read_text())["objects"])
    chosen = set(np.random.default_rng([SEED, 0]).permutation(len(meshes))[:DEVELOPMENT].tolist())
    test, validation = drawn_hands()
    here = Path(__file__).parent
    held_out = {
        "test_families": ["tool", "handled"],
        "development_meshes": [name for k, name in enumerate(meshes) if k in chosen],
        "test_meshes": [name for k, name in enumerate(meshes) if k not in chosen],
        "test_hands": ["inspire", "ability", "schunk_svh", "shadow", "allegro", *test],
        "validation_hands": validation,
    }
    heading = (
        "# Drawn by studies/splits/draw.py. Test families, meshes and hands are for final figures only: nothing is\n"
    )
    heading += "# trained or tuned on them. Sources of paired grasps come from no hand named here.\n"
    (here / "held_out.yaml").write_text(heading + yaml.safe_dump(held_out, sort_keys=False, width=116))
    heading = (
        "# Drawn by studies/splits/draw.py, for `xdex dataset pack --splits`; scenes are left to training's own draw.\n"
    )
    (here / "validation.yaml").write_text(heading + yaml.safe_dump({"validation_hands": validation}, width=116))


if __name__ == "__main__":
    main()
