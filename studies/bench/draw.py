"""Draws the pictures of the committed benchmarks anew from their figures, which stay as they are.

python studies/bench/draw.py
"""

import json
from pathlib import Path

from xdex_drake.bench.problems import profile_picture
from xdex_drake.bench.watch import Stage, picture

FOLDER = Path(__file__).resolve().parent
PROFILE_TITLE = "share of problems solved within a multiple of the fastest time"


def pictures() -> dict[Path, str]:
    """The text of each picture by its file."""
    drawn = {}
    for file in sorted(FOLDER.glob("*.json")):
        content = json.loads(file.read_text(encoding="utf-8"))
        stages = tuple(Stage(**stage) for stage in content["stages"])
        drawn[file.with_suffix(".svg")] = picture(f"xdex bench {file.stem}: times of one thread", stages)
        if "runs" in content:
            drawn[file.with_name(f"{file.stem}_profile.svg")] = profile_picture(PROFILE_TITLE, content["runs"])
    return drawn


if __name__ == "__main__":
    for path, text in pictures().items():
        path.write_text(text, encoding="utf-8")
        print(path.name)
