import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def docs_modules(monkeypatch):
    """Makes the modules beside the site's texts importable."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    yield
    for name in ("generate", "texts"):
        sys.modules.pop(name, None)
