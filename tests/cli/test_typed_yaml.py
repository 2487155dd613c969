"""Configuration files come back as they were meant, or are refused."""

from dataclasses import dataclass, field
from pathlib import Path

import pytest
import yaml

from xdex_drake.errors import ConfigError
from xdex_drake.typed_yaml import read_typed_yaml, to_plain


@dataclass(frozen=True)
class Inner:
    size: float = 1.0
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outer:
    count: int
    inner: Inner = field(default_factory=Inner)
    limit: float | None = None
    table: dict[str, float] = field(default_factory=dict)
    ready: bool = False


def read(tmp_path: Path, text: str) -> Outer:
    (tmp_path / "c.yaml").write_text(text)
    return read_typed_yaml(tmp_path / "c.yaml", Outer)


def test_round_trip(tmp_path):
    value = Outer(3, Inner(2.5, ("a", "b")), 1e-3, {"x": 2.0}, True)
    assert read(tmp_path, yaml.safe_dump(to_plain(value))) == value


def test_defaults_and_whole_numbers_as_reals(tmp_path):
    assert read(tmp_path, "count: 1\ninner: {size: 2}\nlimit: 1e-3") == Outer(1, Inner(2.0), 1e-3)
    assert read(tmp_path, "count: 1\nlimit: null") == Outer(1)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{}", "lacks count"),
        ("", "lacks count"),
        ("count: 1.5", "count is 1.5"),
        ("count: 1\ninner: {sise: 1}", "inner has an unknown key 'sise'; did you mean 'size'"),
        ("count: 1\ninner: {names: a}", "inner.names"),
        ("count: 1\ninner: {names: [1]}", r"inner.names\[0\]"),
        ("count: 1\nlimit: .inf", "limit"),
        ("count: 1\ntable: {x: y}", "table.x"),
        ("count: 1\nready: 1", "ready is 1"),
        ("count: !!python/object/apply:os.getcwd []", "YAML"),
    ],
)
def test_refusals_name_file_and_field(tmp_path, text, expected):
    with pytest.raises(ConfigError, match=expected) as caught:
        read(tmp_path, text)
    assert "c.yaml" in str(caught.value) and "\n" not in str(caught.value)
