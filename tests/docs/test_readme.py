"""Every command and every line of code in the README works as it stands there."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

import xdex_drake as xd
from xdex_drake.cli import main

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def lines(language: str) -> list[str]:
    """Lines of the code blocks of a language."""
    return [line for block in re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL) for line in block.splitlines()]


def test_it_is_short_and_its_links_lead_somewhere():
    assert len(README.splitlines()) < 120
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert target.startswith("https://") or (ROOT / target).is_file(), target
    (picture,) = re.findall(r"!\[[^]]*\]\(([^)]+)\)", README)
    assert (ROOT / picture).stat().st_size < 3_000_000


def test_the_install_lines_are_understood(tmp_path):
    made, installed = lines("sh")[:2]
    assert made.startswith("python3 -m venv") and installed.startswith(".venv/bin/pip install")
    arguments = [*shlex.split(made)[1:], "--without-pip"]
    subprocess.run([sys.executable, *arguments], cwd=tmp_path, check=True)
    assert (tmp_path / ".venv" / "bin" / "python").exists()
    # A dry run without the network: metadata are built, versions of the constraints are read, nothing changes.
    dry = ["--dry-run", "--no-deps", "--no-index", "--no-build-isolation"]
    pip = [sys.executable, "-m", "pip", *shlex.split(installed)[1:], *dry]
    done = subprocess.run(pip, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "Would install xdex_drake" in done.stdout
    for target in re.findall(r"`make (\w+)`", README):
        subprocess.run(["make", "-n", target], cwd=ROOT, check=True, capture_output=True)


@pytest.mark.slow
def test_the_ten_lines_end_in_a_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(compile("\n".join(lines("python")), "README.md", "exec"), {"__name__": "__main__"})
    assert "can" in Path("can.html").read_text(encoding="utf-8")
    assert "success=True" in capsys.readouterr().out


@pytest.mark.slow
def test_the_commands_work_one_after_the_other(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    # What stands for the reader's own files.
    xd.export_urdf(xd.load_hand("ability"), "hand")
    (urdf,) = Path("hand").glob("*.urdf")
    for file in urdf.parent.iterdir():
        file.rename(file.name)
    Path(urdf.name).rename("my_hand.urdf")
    trimesh.creation.cylinder(0.03, 0.1, sections=24).export("my_mesh.stl")
    commands = [line for line in lines("sh")[2:] if line]
    for line in commands:
        words = shlex.split(line, comments=True)
        assert words[0] == "xdex" and main(words[1:]) == 0, line + capsys.readouterr().err
        for option in ("--out", "--html"):
            if option in words:
                assert Path(words[words.index(option) + 1]).is_file(), line
    assert len(commands) >= 6
