"""Writes type stubs of Drake that a type checker can use, from those that Drake ships.

Drake's stubs write arrays as `numpy.ndarray[numpy.float64[3, 1]]`, which says something else to a type checker, so
that it refuses every array. Here an argument becomes `ArrayLike` and a result `NDArray`; nothing else changes.

Usage: python pydrake_stubs.py OUT
"""

import re
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

_ARRAY = re.compile(r"numpy\.ndarray\[(?:numpy\.)?(\w+)\[[^\[\]]*\](?:, flags\.\w+)*\]")


def _as_result(match: re.Match[str]) -> str:
    kind = match.group(1)
    return f"numpy.typing.NDArray[numpy.{'bool_' if kind == 'bool' else 'object_' if kind == 'object' else kind}]"


def _mend(line: str) -> str:
    head, arrow, tail = line.rpartition(" -> ") if line.lstrip().startswith("def ") else ("", "", line)
    return _ARRAY.sub("numpy.typing.ArrayLike", head) + arrow + _ARRAY.sub(_as_result, tail)


def main() -> None:
    """Writes the stubs to the folder that the command line names."""
    spec = find_spec("pydrake")
    if spec is None or spec.origin is None:
        raise SystemExit("pydrake is not installed")
    source = Path(spec.origin).parent
    out = Path(sys.argv[1]) / "pydrake"
    shutil.rmtree(out, ignore_errors=True)
    for stub in source.rglob("*.pyi"):
        lines = stub.read_text(encoding="utf-8").splitlines()
        target = out / stub.relative_to(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text("\n".join(["import numpy.typing", *map(_mend, lines)]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
