"""Broken hand files, one for each way to break them of `studies/mutants`, are read or refused in one clear line."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

STUDY = Path(__file__).parents[2] / "studies" / "mutants"
COUNT = 15


def study(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"mutants_{name}", STUDY / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, Path]]:
    return list(study("hands").mutants(tmp_path_factory.mktemp("mutants"), COUNT, 7))


@pytest.mark.parametrize("k", range(COUNT))
def test_a_broken_hand_file_is_read_or_refused_in_one_line(broken: list[tuple[str, Path]], k: int) -> None:
    way, path = broken[k]
    found, said = study("run").outcome(study("hands").read, path)
    assert found in ("read", "refused"), f"{way}: {said}"


def test_the_sound_files_are_read(tmp_path: Path) -> None:
    hands = study("hands")
    for path in hands.bases(tmp_path):
        hands.read(path)
