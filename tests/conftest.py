"""Fixtures that all tests share."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder of the reference hands and objects, which are not part of this repository.

    Found by the environment variable XDEX_REFERENCE, or as `../shared` beside the checkout; tests skip without it.
    """
    folder = Path(os.environ.get("XDEX_REFERENCE", Path(__file__).resolve().parents[2] / "shared"))
    if not (folder / "hands_reference").is_dir():
        pytest.skip(f"no reference data at {folder}; set XDEX_REFERENCE to its folder")
    return folder
