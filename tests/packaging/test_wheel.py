"""The built wheel works in an empty folder, with nothing of the checkout in sight."""

import json
import os
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROBLEM = "allegro_can.yaml"  # solved from the wheel; a small one


def run(*command, **options):
    """Output of a command; a failure shows what it wrote."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    result = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, env=environment, timeout=280, **options
    )
    assert result.returncode == 0, f"{command} ended with {result.returncode}:\n{result.stdout}\n{result.stderr}"
    return result.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel that XDEX_WHEEL_DIR holds, as `make check` builds it, or one that is built here."""
    folder = os.environ.get("XDEX_WHEEL_DIR")
    if folder is None:
        pytest.importorskip("hatchling")
        folder = tmp_path_factory.mktemp("dist")
        run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT, cwd=folder)
    (path,) = (ROOT / folder).glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Folder of the commands of an environment that has the wheel, and this one's other packages.

    These are found through a path file. Path files in that folder are not followed, so that the checkout, which an
    editable install adds by one, stays out of sight.
    """
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder, with_pip=False)
    commands = folder / "bin"
    run(sys.executable, "-m", "pip", "--python", commands / "python", "install", "--no-deps", "--no-index", wheel)
    (site,) = folder.glob("lib/python*/site-packages")
    (site / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return commands


def test_the_wheel_holds_code_hands_and_problems_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"xdex_drake"}
    assert "xdex_drake/py.typed" in names
    for kind in ("hands", "problems"):
        files = {f"xdex_drake/_data/{kind}/{path.relative_to(ROOT / kind)}" for path in (ROOT / kind).rglob("*.yaml")}
        assert {name for name in names if name.startswith(f"xdex_drake/_data/{kind}/")} == files
    assert any(name.startswith("xdex_drake/_data/hands/") for name in names)
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)


def test_the_installed_library_finds_itself_and_its_data(installed, tmp_path):
    code = """
import json, xdex_drake
from xdex_drake.data_files import data_folder
names = getattr(xdex_drake, "__all__", ())
print(json.dumps({
    "library": xdex_drake.__file__,
    "hands": [str(path) for path in data_folder("hands").glob("*.yaml")],
    "missing": [name for name in names if not hasattr(xdex_drake, name)],
}))
"""
    found = json.loads(run(installed / "python", "-c", code, cwd=tmp_path))
    environment = str(installed.parent)
    assert found["library"].startswith(environment)
    assert len(found["hands"]) == len(list((ROOT / "hands").glob("*.yaml")))
    assert all(path.startswith(environment) for path in found["hands"])
    assert found["missing"] == []


def test_a_problem_is_solved_from_the_wheel(installed, tmp_path):
    where = "from xdex_drake.data_files import data_folder; print(data_folder('problems'))"
    problem = Path(run(installed / "python", "-c", where, cwd=tmp_path).strip()) / PROBLEM
    run(installed / "xdex", "solve", problem, "--out", "grasp.parquet", cwd=tmp_path)
    read = "from xdex_drake.dataset.grasp_file import read_grasps; print(len(read_grasps('grasp.parquet')))"
    assert int(run(installed / "python", "-c", read, cwd=tmp_path)) >= 1


def test_import_is_quick_and_leaves_heavy_packages_alone(tmp_path):
    code = """
import json, sys, time
begin = time.perf_counter()
import xdex_drake
print(json.dumps({"seconds": time.perf_counter() - begin, "modules": sorted(sys.modules)}))
"""
    runs = [json.loads(run(sys.executable, "-c", code, cwd=tmp_path)) for _ in range(3)]
    heavy = {"torch", "matplotlib", "pydrake.geometry", "pydrake.visualization", "cvxpy", "coacd"}
    assert heavy & set(runs[0]["modules"]) == set()
    assert sorted(entry["seconds"] for entry in runs)[1] < 1.0


def test_data_sets_are_read_without_torch(tmp_path):
    code = """
import json, sys
import xdex_drake.jobs.processes, xdex_drake.dataset.schema, xdex_drake.dataset.grasp_file
print(json.dumps(sorted(sys.modules)))
"""
    modules = set(json.loads(run(sys.executable, "-c", code, cwd=tmp_path)))
    assert {"torch", "matplotlib", "pydrake.geometry", "pydrake.multibody.plant"} & modules == set()


def test_exact_versions_meet_the_requirements():
    """Each requirement of pyproject.toml is pinned in constraints.txt, to a version that it allows."""
    requirements = pytest.importorskip("packaging.requirements")
    utils = pytest.importorskip("packaging.utils")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    pins = {utils.canonicalize_name(name): version for name, version in pins.items()}
    wanted = [
        *project["dependencies"],
        *(entry for extra in project["optional-dependencies"].values() for entry in extra),
    ]
    for text in wanted:
        requirement = requirements.Requirement(text)
        version = pins[utils.canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(version), text
