"""Parsing, help, refusals: what a typo or a bad file costs."""

import importlib
import subprocess
import sys

import numpy as np
import pytest

from xdex_drake.cli import main, output
from xdex_drake.cli.app import COMMANDS


def refusal(capsys: pytest.CaptureFixture, *words: object) -> str:
    """Runs a command that must be refused: status 2, one line on standard error, nothing on standard output.

    On a busy machine lines of progress may come before it.
    """
    assert main([str(word) for word in words]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    lines = [line for line in said.err.splitlines() if not line.startswith("xdex: preparing ")]
    assert len(lines) == 1 and lines[0].startswith("xdex: "), said.err
    return lines[0]


def test_overview_names_every_command(capsys):
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in COMMANDS)
    assert main([]) == 2


def test_every_command_exists_and_explains_itself(capsys):
    for name, entry in COMMANDS.items():
        command = getattr(importlib.import_module(f"xdex_drake.cli.{entry.module}"), entry.name)
        assert callable(command.run)
        assert main([*name.split(), "--help"]) == 0
        said = capsys.readouterr().out
        assert f"usage: xdex {name}" in said
        for field in getattr(command, "__dataclass_fields__", {}):
            assert f"        {field}: " in command.__doc__, f"{name}: {field} is not explained"


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("xdex_drake ")


def test_group_alone_lists_its_commands(capsys):
    assert main(["hand", "--help"]) == 0
    assert "xdex hand list" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["gasp"], "`xdex grasp`"),
        (["hand", "lits"], "`xdex hand list`"),
        (["frobnicate"], "there are"),
        (["hand", "show"], "HAND"),
        (["object", "show", "can", "--scael", "2"], "did you mean --scale"),
        (["grasp", "--hnd", "allegro", "--object", "can"], "--hnd; did you mean --hand"),
        (["grasp", "--hand", "allegro", "--object", "can", "--keep_faild"], "--keep_faild; did you mean --keep-failed"),
        (["grasp", "--hand", "allegro", "--object", "can", "--grasp-type", "hook"], "pinch"),
        (["grasp", "--hand", "allegro", "--object", "can", "--approach", "0", "0", "1"], "below the table"),
        (["grasp", "--hand", "allegro", "--object", "can", "--pose", "0", "--upright"], "give one of them"),
        (["hand", "list", "--all"], "there is no option --all"),
        (["predict", "--hand", "alegro", "--object", "can"], "did you mean allegro"),
        (["retarget", "missing.parquet", "--to", "shaddow"], "did you mean shadow"),
        (["object", "show", "can", "--scale", "two"], "two"),
        (["hand", "show", "alegro"], "did you mean allegro"),
        (["object", "show", "mgu"], "did you mean mug"),
        (["solve", "alegro_can"], "allegro_can"),
        (["solve", "allegro_can", "--solver", "snop"], "snopt"),
        (["solve", "missing.yaml"], "missing.yaml: no such file"),
        (["grasp", "--hand", "allegro", "--object", "can", "--count", "0"], "--count"),
        (["grasp", "--hand", "allegro", "--object", "can", "--mass", "-1"], "mass"),
        (["grasp", "--hand", "allegro", "--object", "can", "--scale", "nan"], "scale"),
        (["grasp", "--hand", "allegro", "--object", "can", "--out", "grasps.csv"], ".parquet"),
        (["lift", "missing.parquet"], "missing.parquet"),
        (["view", "missing.parquet"], "missing.parquet"),
        (["export", "missing.parquet"], "missing.parquet"),
        (["retarget", "missing.parquet", "--to", "shadow"], "missing.parquet"),
        (["dataset", "info", "missing"], "missing"),
        (["dataset", "verify", "missing"], "missing"),
        (["train", "missing.yaml"], "missing.yaml"),
    ],
)
def test_bad_words_are_refused_in_one_line(capsys, tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    assert expected in refusal(capsys, *words)
    assert not list(tmp_path.iterdir())


CUBE = """v 0 0 0
v 0.05 0 0
v 0 0.05 0
v 0 0 0.05
f 1 3 2
f 1 2 4
f 2 3 4
f 3 1 4
"""


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("gone.obj", None, "no such file"),
        ("empty.obj", "", "empty"),
        ("points.obj", "v 0 0 0\nv 1 0 0\n", "points.obj"),
        ("nan.obj", CUBE.replace("0.05 0 0", "nan 0 0"), "nan.obj"),
        ("robot.urdf", "<robot name='r'/>", "not a mesh"),
        ("mesh.docx", "text", "unknown type"),
    ],
)
def test_bad_meshes_are_refused_in_one_line(capsys, tmp_path, monkeypatch, name, content, expected):
    monkeypatch.chdir(tmp_path)
    if content is not None:
        (tmp_path / name).write_text(content)
    before = sorted(tmp_path.iterdir())
    assert expected in refusal(capsys, "grasp", "--hand", "allegro", "--object", tmp_path / name)
    assert expected in refusal(capsys, "object", "show", tmp_path / name)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("title: [", "line 1"),
        ("- a\n- b\n", "mapping"),
        ("title: t\nhand: allegro\nobject: {name: can}\nseeed: 1\n", "'seed'"),
        ("title: t\nhand: allegro\nobject: {name: can, scael: 2}\n", "'scale'"),
        ("title: t\nhand: allegro\nobject: {name: can}\nseed: one\n", "seed is 'one'"),
        ("title: t\nhand: allegro\nobject: {name: can}\nseed: true\n", "seed is True"),
        ("title: t\nhand: allegro\nobject: {name: can}\nsolver: fast\n", "sequential"),
        ("title: t\nhand: allegro\nobject: {name: can}\nweights: {fc: .nan}\n", "weights.fc"),
        ("title: t\nobject: {name: can}\n", "hand"),
        ("title: t\nhand: allegro\nobject: {name: can}\nprogram: retargeting\n", "source"),
        ("title: t\nhand: allegro\nobject: {name: can}\nstarts: 0\n", "starts"),
    ],
)
def test_bad_problem_files_are_refused_in_one_line(capsys, tmp_path, text, expected):
    file = tmp_path / "problem.yaml"
    file.write_text(text)
    said = refusal(capsys, "solve", file)
    assert expected in said and "problem.yaml" in said


@pytest.mark.parametrize("folder", ["file.txt/inside", "/proc/nowhere"])
def test_output_that_cannot_be_written_is_refused_before_the_work(capsys, tmp_path, folder):
    (tmp_path / "file.txt").write_text("a file, no folder")
    out = tmp_path / folder / "grasps.parquet"
    said = refusal(capsys, "grasp", "--hand", "allegro", "--object", "can", "--out", out)
    assert "cannot be written" in said


def test_a_folder_is_no_output_file(capsys, tmp_path):
    (tmp_path / "x.parquet").mkdir()
    said = refusal(capsys, "grasp", "--hand", "allegro", "--object", "can", "--out", tmp_path / "x.parquet")
    assert "folder" in said


def test_a_damaged_file_of_grasps_is_refused(capsys, tmp_path):
    file = tmp_path / "grasps.parquet"
    file.write_bytes(b"PAR1 and then nothing of use")
    for command in ("lift", "view", "export"):
        assert "grasps.parquet" in refusal(capsys, command, file)


@pytest.mark.parametrize(
    "words",
    [
        ["grasp", "--hand", "alegro", "--object", "can"],
        ["grasp", "--hand", "allegro", "--object", "cann"],
        ["solve", "alegro_can"],
        ["retarget", "missing.parquet", "--to", "shaddow"],
        ["predict", "--hand", "allegro", "--object", "cann"],
    ],
)
def test_a_wrong_name_is_told_before_anything_large_is_imported(words):
    script = f"import sys; from xdex_drake.cli import main; print(main({words!r}), 'torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == ["2", "False"] and "did you mean" in done.stderr


def test_what_a_user_edited_is_not_written_over(capsys, tmp_path):
    out = tmp_path / "left.yaml"
    out.write_text("# edited for hours\n")
    assert "exists already" in refusal(capsys, "hand", "mirror", "allegro", "--out", out)
    assert "--force" in refusal(capsys, "hand", "import", tmp_path / "hand.urdf", "--out", out)
    assert out.read_text() == "# edited for hours\n"
    assert main(["hand", "mirror", "allegro", "--out", str(out), "--force"]) == 0
    assert "allegro" in out.read_text()


def test_progress_without_a_terminal_is_a_few_plain_lines(capsys, monkeypatch):
    monkeypatch.setattr(output, "SECONDS_A_LINE", 3600.0)
    with output.progress(300, "lift") as bar:
        for k in range(300):
            bar.update()
            bar.set_postfix(tried=k)
    said = capsys.readouterr().err
    assert [line.split()[1:3] for line in said.splitlines()] == [["0%", "0/300"], ["100%", "300/300"]]
    assert "\r" not in said and "tried=299" in said


def test_a_bug_keeps_its_traceback(monkeypatch):
    def broken(self: object) -> int:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("xdex_drake.cli.hands.HandList.run", broken)
    with pytest.raises(ZeroDivisionError):
        main(["hand", "list"])


def test_interruption_is_told_by_the_exit_status(monkeypatch, capsys):
    def interrupted(self: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr("xdex_drake.cli.hands.HandList.run", interrupted)
    assert main(["hand", "list"]) == 130


def test_lists_and_tables(capsys):
    assert main(["hand", "list"]) == 0 and "allegro" in capsys.readouterr().out
    assert main(["hand", "show", "ability"]) == 0 and "coupling" in capsys.readouterr().out
    assert main(["object", "list"]) == 0 and "mug" in capsys.readouterr().out
    assert main(["solve"]) == 0 and "allegro_can" in capsys.readouterr().out
    for command in ("dataset generate", "train"):
        assert main([*command.split(), "--print-config"]) == 0 and "seed:" in capsys.readouterr().out


def test_object_import_writes_metres(capsys, tmp_path):
    (tmp_path / "part.obj").write_text(CUBE.replace("0.05", "50"))
    assert main(["object", "import", str(tmp_path / "part.obj"), "--scale", "0.001", "--out", str(tmp_path / "o")]) == 0
    rows = [line.split()[1:] for line in (tmp_path / "o" / "part.obj").read_text().splitlines() if line[0] == "v"]
    assert np.max(np.array(rows, dtype=float)) == pytest.approx(0.05)


def test_object_import_keeps_what_is_good(capsys, tmp_path):
    (tmp_path / "good.obj").write_text(CUBE)
    (tmp_path / "bad.obj").write_text("")
    words = ["object", "import", str(tmp_path / "bad.obj"), str(tmp_path / "good.obj"), "--out", str(tmp_path / "o")]
    assert main(words) == 2
    said = capsys.readouterr()
    assert "bad.obj" in said.err.splitlines()[-1] and (tmp_path / "o" / "good.obj").exists()
