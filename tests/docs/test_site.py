"""What the site says is true of the code: names, commands and snippets. `make docs` builds it, with more checks."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import xdex_drake

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(page for page in (ROOT / "docs").rglob("*.md") if "generated" not in page.parts)


@pytest.mark.usefixtures("docs_modules")
def test_every_public_name_and_every_command_has_its_page(tmp_path, monkeypatch):
    import generate

    from xdex_drake.cli.app import COMMANDS

    monkeypatch.setattr(generate, "GENERATED", tmp_path)
    (tmp_path / "api").mkdir()
    generate.write_names()
    index = (tmp_path / "api" / "index.md").read_text(encoding="utf-8")
    for name in set(xdex_drake.__all__) - {"__version__"}:
        assert f":: {name}\n" in (tmp_path / "api" / f"{name}.md").read_text(encoding="utf-8")
        assert re.search(rf"\| \[{name}\]\({name}.md\) \| \S", index), f"{name} is not told in one line"
    generate.write_commands()
    commands = (tmp_path / "commands.md").read_text(encoding="utf-8")
    for name in COMMANDS:
        assert f"\n## xdex {name}\n" in commands and f"usage: xdex {name}" in commands


@pytest.mark.usefixtures("docs_modules")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_names_in_the_texts_exist(page):
    import texts

    text = page.read_text(encoding="utf-8")
    lines = [
        line for language in ("sh", "bash") for block in texts.blocks(text, language) for line in block.splitlines()
    ]
    for line in [*texts.commands_in("\n".join(lines)), *re.findall(r"`(xdex [^`]*)`", text)]:
        assert texts.wrong_command(line) is None, line
    for name in re.findall(r"\bxd\.(\w+)", text):
        assert name in xdex_drake.__all__, name


@pytest.mark.usefixtures("docs_modules")
def test_a_wrong_command_is_found():
    import texts

    assert "no command" in str(texts.wrong_command("xdex hand improt FILE"))
    assert "--hnd" in str(texts.wrong_command("xdex grasp --hnd allegro"))
    assert texts.wrong_command("xdex grasp --hand allegro --object can [--count N]") is None
    assert list(texts.commands_in("cd x\nxdex grasp \\\n  --count 3\n")) == ["xdex grasp    --count 3"]


@pytest.mark.usefixtures("docs_modules")
def test_every_snippet_runs(tmp_path):
    # One process for all pages: what costs time is the import.
    import texts

    code = []
    for page in PAGES:
        for snippet in texts.blocks(page.read_text(encoding="utf-8"), "python"):
            if "import mujoco" in snippet and "scenes/GRASP.xml" in snippet:
                continue  # needs a file that stands for one of the reader's
            code.append(
                f"print({page.stem!r})\nexec(compile({snippet!r}, {page.name!r}, 'exec'), {{'__name__': '__main__'}})"
            )
    (tmp_path / "all.py").write_text("\n".join(code), encoding="utf-8")
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "all.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=280
    )
    assert done.returncode == 0, done.stdout[-500:] + done.stderr[-3000:]
    assert len(code) >= 10


def test_every_protocol_is_told():
    from xdex_drake.simulation.protocol import PROTOCOLS

    page = (ROOT / "docs" / "concepts" / "protocols.md").read_text(encoding="utf-8")
    for name in PROTOCOLS:
        assert f"| `{name}` |" in page, name
