"""The published figures are those of the results that lie beside the studies."""

import importlib.util
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_table_is_what_the_studies_results_say():
    spec = importlib.util.spec_from_file_location("measured", ROOT / "studies" / "measured.py")
    assert spec is not None and spec.loader is not None
    measured = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(measured)
    page = (ROOT / "docs" / "measured.md").read_text(encoding="utf-8")
    assert page == measured.written(page), "run `python studies/measured.py --write`"
    assert len(measured.ROWS) >= 8


def test_every_study_that_is_named_is_there():
    import re

    for page in (ROOT / "docs").rglob("*.md"):
        for path in re.findall(r"`(?:python )?(studies/[\w/.]*)", page.read_text(encoding="utf-8")):
            assert (ROOT / path).exists() or "NAME" in path, f"{page.name}: {path}"
