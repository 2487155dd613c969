"""Every tutorial runs from top to bottom, in a folder of its own."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "tutorials"
TUTORIALS = sorted(FOLDER.glob("*.py"))


def test_there_are_tutorials():
    numbers = [int(path.name[:2]) for path in TUTORIALS]
    assert numbers and numbers == sorted(set(numbers))


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_more_prose_than_helpers(path):
    text = path.read_text()
    assert text.count("# %% [markdown]") >= text.count("# %%\n") // 2
    assert "**Exercise.**" in text and "sys.path" not in text


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_it_writes_a_picture_for_the_site(path):
    assert re.search(r"\w\.(png|svg|jpg)\"", path.read_text()), "see the last cells of tutorial 01"


@pytest.mark.slow
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_it_runs(path, tmp_path):
    for module, extra in (("cvxpy", "reference"), ("mujoco", "mujoco")):
        if f"import {module}" in path.read_text() and importlib.util.find_spec(module) is None:
            pytest.skip(f"this tutorial needs {module}, of the extra `{extra}`")
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning:__main__", str(path)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert done.returncode == 0, done.stderr[-3000:]
