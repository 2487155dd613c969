"""The public namespace: every name exists, and asking for none of them costs nothing."""

import json
import subprocess
import sys
import time

import pytest

import xdex_drake


def test_every_public_name_resolves():
    for name in xdex_drake.__all__:
        assert getattr(xdex_drake, name) is not None, name
    assert sorted(xdex_drake._MODULE_OF) == sorted(set(xdex_drake.__all__) - {"__version__"})
    assert dir(xdex_drake) == sorted(xdex_drake.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="load_hnad"):
        xdex_drake.load_hnad  # noqa: B018


def loaded_by(code: str) -> tuple[set[str], float]:
    """Names of the modules that a fresh interpreter has loaded after some code, and the seconds that the code took."""
    program = f"import sys, time, json; t = time.process_time(); {code}; t = time.process_time() - t\n"
    program += "print(json.dumps([sorted(sys.modules), t]))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    modules, seconds = json.loads(done.stdout.splitlines()[-1])
    return set(modules), seconds


def test_import_is_light():
    modules, seconds = loaded_by("import xdex_drake; dir(xdex_drake)")
    assert seconds < 1.0
    assert not modules & {"torch", "pydrake", "numpy", "trimesh", "pyarrow", "tyro"}


def test_hands_and_scenes_need_no_torch():
    modules, _ = loaded_by("import xdex_drake; xdex_drake.load_hand; xdex_drake.make_scene; xdex_drake.lift")
    assert "torch" not in modules


def test_help_is_fast():
    begin = time.perf_counter()
    modules, seconds = loaded_by("from xdex_drake.cli import main; main(['--help'])")
    assert seconds < 1.0 and time.perf_counter() - begin < 10.0
    assert not modules & {"torch", "pydrake", "numpy", "tyro"}


def test_help_of_a_command_imports_nothing_heavy():
    modules, _ = loaded_by("from xdex_drake.cli import main; main(['grasp', '--help'])")
    assert not modules & {"torch", "pydrake", "trimesh"}


def test_a_grasp_imports_no_more_than_it_uses():
    # Each of these costs a tenth of a second or more at every start.
    modules, _ = loaded_by("import xdex_drake.jobs.grasps, xdex_drake.grasping.synthesis, xdex_drake.cli.grasps")
    assert not modules & {"cvxpy", "matplotlib", "pandas", "qpsolvers", "scipy.signal", "scipy.stats", "sklearn"}
    assert not modules & {
        "sympy",
        "torch._dynamo",
        "torch._inductor",
        "xdex_drake.learning",
        "xdex_drake.visualization",
    }
