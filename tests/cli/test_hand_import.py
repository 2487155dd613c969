"""Commands that bring hands in and out."""

import pytest

from xdex_drake.cli import main
from xdex_drake.hand.library import load_hand
from xdex_drake.hand.yaml_file import hand_digest, read_hand


@pytest.fixture
def exported(tmp_path, capsys, monkeypatch):
    """A URDF file of a hand of the library."""
    monkeypatch.setenv("XDEX_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    assert main(["hand", "export", "ability", "--out", str(tmp_path / "urdf")]) == 0
    assert "ability.urdf" in capsys.readouterr().out
    return tmp_path / "urdf" / "ability.urdf"


def test_import_tells_what_it_decided_and_writes_what_it_found(tmp_path, capsys, exported) -> None:
    out, page = tmp_path / "new" / "mine.yaml", tmp_path / "mine.html"
    assert main(["hand", "import", str(exported), "--name", "mine", "--out", str(out), "--html", str(page)]) == 0
    said = capsys.readouterr().out
    assert "6 of 10, 4 coupled" in said
    assert "decided  finger thumb" in said
    assert "tip point [mm]" in said
    hand = read_hand(out)
    assert (hand.name, hand.side) == ("mine", "right")
    assert hand.joint_names == load_hand("ability").joint_names
    text = page.read_text()
    assert "What was decided" in text
    assert "wrist frame H" in text
    assert main(["hand", "show", str(out)]) == 0


def test_a_robot_file_is_a_hand_anywhere_and_is_imported_once(tmp_path, capsys, exported) -> None:
    first = load_hand(exported)
    (kept,) = (tmp_path / "cache").glob("hand-*.yaml")
    stamp = kept.stat().st_mtime_ns
    assert hand_digest(load_hand(exported)) == hand_digest(first)
    assert kept.stat().st_mtime_ns == stamp
    kept.write_text("damaged")
    assert hand_digest(load_hand(exported)) == hand_digest(first)
    assert main(["hand", "show", str(exported)]) == 0
    assert "ability" in capsys.readouterr().out


def test_a_hand_is_not_written_over_unasked(tmp_path, capsys, exported) -> None:
    assert main(["hand", "import", str(exported)]) == 0
    assert (tmp_path / "ability.yaml").is_file()
    assert main(["hand", "import", str(exported)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_mirror(tmp_path, capsys) -> None:
    out = tmp_path / "left.yaml"
    assert main(["hand", "mirror", "allegro", "--out", str(out)]) == 0
    assert "allegro_left" in capsys.readouterr().out
    assert read_hand(out).side == "left"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["hand", "import", "absent.urdf"], "no such file"),
        (["hand", "import", "hand.xacro"], "expand it first"),
        (["hand", "import", "hand.urdf", "--out", "hand.json"], ".yaml"),
        (["hand", "import", "hand.urdf", "--side", "middle"], "side"),
        (["hand", "export", "alegro"], "did you mean allegro"),
        (["hand", "mirror", "allegro"], "--out"),
    ],
)
def test_bad_input_is_told_in_one_line(capsys, words, told) -> None:
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert told in said.err
