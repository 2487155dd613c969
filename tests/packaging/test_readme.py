"""The README's figures are those of the results that lie beside the studies."""

import importlib.util
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_readmes_table_is_what_the_studies_results_say():
    spec = importlib.util.spec_from_file_location("measured", ROOT / "studies" / "measured.py")
    assert spec is not None and spec.loader is not None
    measured = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(measured)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme == measured.written(readme), "run `python studies/measured.py --write`"
    assert len(measured.ROWS) >= 8
