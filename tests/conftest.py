"""Fixtures that all tests share."""

import os
import signal
from pathlib import Path

import pytest

# A shell that starts the tests in the background lets them ignore Ctrl-C, and so the programs that they interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder of the reference hands and objects, which are not part of this repository.

    Found by the environment variable XDEX_REFERENCE, or as `../shared` beside the checkout; tests skip without it.
    """
    folder = Path(os.environ.get("XDEX_REFERENCE", Path(__file__).resolve().parents[2] / "shared"))
    if not (folder / "hands_reference").is_dir():
        pytest.skip(f"no reference data at {folder}; set XDEX_REFERENCE to its folder")
    return folder
