"""Every tutorial runs from top to bottom, in a folder of its own."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "tutorials"
TUTORIALS = sorted(FOLDER.glob("*.py"))


def test_there_are_tutorials():
    assert [path.name[:2] for path in TUTORIALS] == [f"{k + 1:02d}" for k in range(len(TUTORIALS))] != []


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_more_prose_than_helpers(path):
    text = path.read_text()
    assert text.count("# %% [markdown]") >= text.count("# %%\n") // 2
    assert "**Exercise.**" in text and "sys.path" not in text


@pytest.mark.slow
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_it_runs(path, tmp_path):
    if "import cvxpy" in path.read_text() and importlib.util.find_spec("cvxpy") is None:
        pytest.skip("this tutorial needs cvxpy, of the extra `reference`")
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
