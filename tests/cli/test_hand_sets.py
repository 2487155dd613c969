"""Commands on many hands."""

from xdex_drake.cli import main


def test_generate_count_check_and_browse(tmp_path, capsys, caplog) -> None:
    folder = tmp_path / "hands"
    assert main(["hand", "generate", "--count", "3", "--seed", "7", "--out", str(folder), "--workers", "0"]) == 0
    assert "3 hands" in capsys.readouterr().out
    assert (folder / "g7-0002.yaml").exists()
    assert main(["hand", "stats", str(folder), "--out", str(tmp_path / "figure.png")]) == 0
    assert "topologies" in capsys.readouterr().out
    assert (tmp_path / "figure.png").stat().st_size > 5000
    assert main(["hand", "check", str(folder), "--seconds", "0.1", "--workers", "0"]) == 0
    assert "3 of 3 hands are sound" in capsys.readouterr().out
    page = tmp_path / "page.html"
    assert main(["hand", "browse", str(folder), "ability", "g7-0001", "--html", str(page)]) == 0
    assert "5 hands" in capsys.readouterr().out
    assert page.stat().st_size > 1_000_000
    assert "listening" not in caplog.text  # nobody is to open Meshcat's address
    assert main(["hand", "show", "g7-0001"]) == 0
    assert "variation" in capsys.readouterr().out


def test_list_says_how_else_a_hand_is_named(capsys) -> None:
    assert main(["hand", "list"]) == 0
    said = capsys.readouterr().out
    assert "allegro" in said
    assert "g0-0137" in said
    assert ".urdf" in said


def test_bad_input_is_told_in_one_line(tmp_path, capsys) -> None:
    for words in (
        ["hand", "stats", str(tmp_path)],
        ["hand", "stats", str(tmp_path), "--sheet", str(tmp_path / "sheet.gif")],
        ["hand", "generate", "--count", "0", "--out", str(tmp_path / "x"), "--workers", "0"],
        ["hand", "browse", "g7-1", "--html", str(tmp_path / "x.html")],
        ["hand", "browse", "--html", str(tmp_path / "x.html")],
    ):
        assert main(words) == 2, words
        said = capsys.readouterr().err.strip().splitlines()
        assert said[-1].startswith("xdex: "), said
