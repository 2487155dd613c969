"""Training where only torch, NumPy, safetensors, PyYAML and tqdm are installed: all other imports are refused."""

import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

from xdex_drake.learning.checkpoint import load_checkpoint
from xdex_drake.learning.pack import write_pack
from xdex_drake.learning.training import main

TINY = Path(__file__).parent / "tiny.yaml"
ALLOWED = {"torch", "numpy", "safetensors", "yaml", "_yaml", "tqdm"}
# What torch needs itself.
OF_TORCH = {"torchgen", "functorch", "filelock", "typing_extensions", "sympy", "mpmath", "networkx", "jinja2", "fsspec"}
OF_TORCH |= {"markupsafe", "setuptools", "triton", "nvidia", "isympy", "cuda"}

ABSENT = """
import runpy, sys
refused = set(sys.argv[1].split(","))
OWN = {"hand", "scene", "dataset", "grasping", "programs", "contact", "simulation", "grasp", "jobs", "cli"}
class Finder:
    def __init__(self, finder):
        self.finder = finder
    def find_spec(self, name, path=None, target=None):
        parts = name.split(".")
        if parts[0] in refused or (parts[0] == "xdex_drake" and len(parts) == 2 and parts[1] in OWN):
            return None
        return self.finder.find_spec(name, path, target)
sys.meta_path[:] = [Finder(finder) for finder in sys.meta_path]
"""


def _run(code, *arguments):
    installed = {name for name in packages_distributions() if name.isidentifier()} - {"xdex_drake"}
    refused = ",".join(sorted((installed | {"pydrake", "pyarrow", "scipy", "tyro", "trimesh"}) - ALLOWED - OF_TORCH))
    command = [sys.executable, "-c", ABSENT + code, refused, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


def test_what_is_not_allowed_is_absent():
    modules = ("pydrake.math", "xdex_drake.hand.kinematics", "xdex_drake.grasp", "pyarrow", "tyro", "scipy")
    tries = "".join(f"try:\n    import {m}\n    print('{m}')\nexcept ModuleNotFoundError:\n    pass\n" for m in modules)
    done = _run(tries)
    assert done.returncode == 0 and done.stdout == "", done


def test_the_command_trains(tiny, tmp_path):
    pack, out = tmp_path / "pack.safetensors", tmp_path / "model"
    write_pack(tiny(), pack)
    code = "del sys.argv[1]\nrunpy.run_module('xdex_drake.learning.training', run_name='__main__', alter_sys=True)"
    done = _run(code, TINY, "--pack", pack, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "validation posterior_tip_mm" in done.stdout
    assert {p.name for p in out.iterdir()} == {"model.safetensors", "state.safetensors", "log.jsonl"}
    assert load_checkpoint(out).config.width == 16


def test_the_command_tells_bad_input_in_one_line(tmp_path, capsys):
    assert main(["--pack", str(tmp_path / "nowhere.safetensors"), "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "no such training pack" in said and said.count("\n") == 1
