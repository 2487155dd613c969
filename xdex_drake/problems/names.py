"""Names of the library's problems; found without importing what solves them."""

from __future__ import annotations

import difflib
from pathlib import Path

from xdex_drake.data_files import data_folder
from xdex_drake.errors import ProblemFileError


def list_problems() -> tuple[str, ...]:
    """Names of the library's problems, in alphabetical order."""
    return tuple(sorted(path.stem for path in data_folder("problems").glob("*.yaml")))


def problem_file(name_or_path: str | Path) -> Path:
    """The file of a problem.

    Args:
        name_or_path: Name of a problem of the library (`list_problems`), or a path to a `.yaml` file.

    Returns:
        The path as it was given, or that of the library's file.

    Raises:
        ProblemFileError: There is no such file.
    """
    path = Path(name_or_path)
    if path.suffix or path.name != str(name_or_path):
        if not path.is_file():
            raise ProblemFileError(f"{path}: no such file; check the path, or give a name of `xdex solve`")
        return path
    names = list_problems()
    if path.name not in names:
        close = difflib.get_close_matches(path.name, names, n=3, cutoff=0.4)
        mend = f"did you mean {' or '.join(close)}?" if close else f"known are {', '.join(names)}"
        raise ProblemFileError(f"there is no problem {path.name!r}; {mend} (a path to a .yaml file also works)")
    return data_folder("problems") / f"{path.name}.yaml"
