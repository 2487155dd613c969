"""Dexterous grasps by optimisation, for any hand and any mesh, on Drake.

Every public name is at hand as `xdex_drake.NAME` and is imported when it is first used: `import xdex_drake` alone loads
neither Drake nor torch. The list of names stands once, as imports in `__init__.pyi` beside this file, where type
checkers and editors read it, too.
"""

import ast
import importlib
from pathlib import Path
from typing import Any

_MODULE_OF = {
    alias.name: f"xdex_drake.{node.module}"
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}

__all__ = ["__version__", *_MODULE_OF]  # noqa: PLE0604, RUF100 # pyright: ignore - names that are found when asked for


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first used (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("xdex_drake")
    elif name in _MODULE_OF:
        value = getattr(importlib.import_module(_MODULE_OF[name]), name)
    else:
        raise AttributeError(f"module 'xdex_drake' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names."""
    return sorted(__all__)
