"""How long a thousand generated hands take, and how much memory.

    python studies/hands/thousand.py studies/hands/thousand.json

Runs `xdex hand generate --count 1000 --seed 0 --workers 2` into a folder that is removed; the machine shall do nothing
else meanwhile. Memory is that of the largest process.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def main(out: Path) -> None:
    """Generates, and writes what it took."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["hand", "generate", "--count", "1000", "--seed", "0", "--workers", "2", "--out", folder]
        begin = time.monotonic()
        subprocess.run([sys.executable, "-m", "xdex_drake", *command], check=True, capture_output=True)
        seconds = time.monotonic() - begin
        index = json.loads((Path(folder) / "index.json").read_text(encoding="utf-8"))
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    figures = {
        "hands": len(index["hands"]),
        "topologies": len({hand["topology"] for hand in index["hands"]}),
        "wall_s": round(seconds, 1),
        "processor_s": round(usage.ru_utime + usage.ru_stime, 1),
        "largest_process_mb": round(usage.ru_maxrss / 1024.0),
    }
    out.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    print(figures)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
