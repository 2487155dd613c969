"""Paired data sets: what is planned, that rows depend on the plan alone, and that nothing ends a run for good."""

import errno
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from xdex_drake import whole_file
from xdex_drake.cli import main
from xdex_drake.dataset.folder import completed_units, failed_units, iter_rejected, read_dataset
from xdex_drake.dataset.lock import locked
from xdex_drake.dataset.verify import verify
from xdex_drake.errors import ConfigError, DatasetError, GraspFileError
from xdex_drake.jobs import pairs
from xdex_drake.jobs.pairs import DatasetConfig, UnitRows, generate, part_of, plan
from xdex_drake.jobs.population import expand_names
from xdex_drake.visualization.pictures import can_render

TINY = DatasetConfig(
    hands=("inspire", "ability", "allegro"),
    source_hands=("inspire",),
    objects=("s0-0000", "can"),
    scale=(0.9, 1.0),
    targets=1,
    candidates=16,
    sources_per_unit=2,
    hold_every=2,
)
MANY = DatasetConfig(hands=("g0-0000..g0-0099",), objects=("s0-0000..s0-0002",), units_per_scene=4, targets=6)


def shards(folder):
    return {path.name: path.read_bytes() for path in sorted((Path(folder) / "shards").glob("*.parquet"))}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A data set of two units, made in this process."""
    folder = tmp_path_factory.mktemp("pairs") / "one"
    assert generate(TINY, folder, workers=0) == (2, 0)
    return folder


# What is planned ------------------------------------------------------------------------------------------------------


def test_names_are_written_in_few_words():
    assert expand_names(["g0-0008..g0-0011", "shadow", "-g0-0009"], "hands") == (
        "g0-0008",
        "g0-0010",
        "g0-0011",
        "shadow",
    )
    assert expand_names(["g1-0000..g1-0010/5"], "hands") == ("g1-0000", "g1-0005", "g1-0010")
    assert expand_names(["../meshes/part.obj"], "objects") == ("../meshes/part.obj",)


@pytest.mark.parametrize("entry", ["g0-0003..g0-0001", "g0-0001..g1-0003", "g0-0000..g0-0005/0", "a..b", "-shadow"])
def test_ranges_that_mean_nothing_are_refused(entry):
    with pytest.raises(ConfigError, match="hands"):
        expand_names([entry], "hands")


def test_hands_are_drawn_by_seed_and_every_round_covers_every_scene():
    units = plan(MANY)
    assert units == plan(MANY) and units != plan(replace(MANY, seed=1))
    assert [unit.object for unit in units] == [f"s0-000{k}" for _ in range(4) for k in range(3)]
    assert len({unit.name for unit in units}) == len({unit.seed for unit in units}) == 12
    for unit in units:
        assert len(set(unit.targets)) == 6 and unit.source not in unit.targets
    assert len({hand for unit in units for hand in unit.targets}) > 40


def test_families_can_be_kept_out():
    config = replace(MANY, objects=("s0-0000..s0-0007",), without_families=("tool", "handled"))
    assert {unit.object for unit in plan(config)} == {f"s0-{k:04d}" for k in (0, 1, 2, 3, 4, 7)}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"targets": -1}, "targets"),
        ({"candidates": 0}, "candidates"),
        ({"scale": (1.0,)}, "scale"),
        ({"scale": (1.2, 0.8)}, "scale"),
        ({"without_families": ("tools",)}, "without_families"),
        ({"hands": ()}, "hands, objects"),
    ],
)
def test_a_configuration_that_means_nothing_is_refused(change, message):
    with pytest.raises(ConfigError, match=message):
        plan(replace(MANY, **change))


def test_parts_make_up_the_whole():
    units = plan(MANY)
    parts = [part_of(units, (i, 5)) for i in range(1, 6)]
    assert sorted(unit.name for part in parts for unit in part) == sorted(unit.name for unit in units)
    with pytest.raises(ConfigError, match="6/5"):
        part_of(units, (6, 5))


# What is made ---------------------------------------------------------------------------------------------------------


def test_rows_name_their_sources_and_are_sound(made):
    report = verify(made)
    assert report.ok and not report.missing_units and report.successes > 4
    rows = read_dataset(made).to_pylist()
    sources = {row["grasp_id"]: row for row in rows if not row["source_grasp_id"]}
    carried = [row for row in rows if row["source_grasp_id"]]
    assert carried and {row["hand"] for row in sources.values()} == {"inspire"}
    for row in carried:
        assert row["grasp_id"] == f"{row['source_grasp_id']}>{row['hand']}"
        assert row["source_object_point_O"] == sources[row["source_grasp_id"]]["object_point_O"]
    # Every attempt is a row or told as rejected, and every other one was pushed.
    rejected = [entry for _, entries in iter_rejected(made) for entry in entries]
    lifted = sum(row["success"] for row in sources.values())
    assert len(carried) + len(rejected) == lifted and {entry.source_grasp_id for entry in rejected} <= sources.keys()
    assert {row["protocol"] for row in carried} <= {"lift-0.2/2tips", "hold"}


def test_the_card_counts_every_attempt(made, tmp_path, capsys):
    assert main(["dataset", "card", str(made), "--out", str(tmp_path / "card.md")]) == 0
    text = (tmp_path / "card.md").read_text()
    assert text == capsys.readouterr().out
    if can_render():
        shown = sorted((tmp_path / "card_pictures").glob("*.jpg"))
        assert shown and all(f"](card_pictures/{path.name})" in text for path in shown)
        assert Image.open(shown[0]).size[0] >= 640  # a source and a version at least
    assert "data_files: shards/*.parquet" in text and "MIT, as the library" in text
    rows = [row for row in read_dataset(made).to_pylist() if row["source_grasp_id"]]
    rejected = [entry for _, entries in iter_rejected(made) for entry in entries]
    lifted = sum(row["success"] for row in rows)
    attempts = len(rows) + len(rejected)
    assert f"| all | {attempts} | {len(rows)} | {lifted} | {lifted / attempts:.3f} |" in text
    assert "| generated: vase |" in text and "without_families: []" in text


def test_two_workers_make_the_same_bytes(made, tmp_path):
    assert generate(TINY, tmp_path / "two", workers=2) == (2, 0)
    assert shards(tmp_path / "two") == shards(made)


def test_unpaired_hands_search_for_themselves(tmp_path):
    config = replace(TINY, mode="unpaired", objects=("can",), sources_per_unit=1)
    assert generate(config, tmp_path / "u", workers=0) == (1, 0)
    rows = read_dataset(tmp_path / "u").to_pylist()
    (unit,) = plan(config)
    assert rows and {row["hand"] for row in rows} == set(unit.targets)
    assert all(row["source_grasp_id"] == "" for row in rows) and verify(tmp_path / "u").ok


# What may go wrong ----------------------------------------------------------------------------------------------------


@pytest.fixture
def quick(monkeypatch, made):
    """Generation whose units take no time: each gives the rows that were made, under names of its own."""
    rows = read_dataset(made).to_pylist()
    monkeypatch.setattr(pairs, "run_unit", lambda unit, config: UnitRows(tuple(renamed(rows, unit.name)), ()))


def renamed(rows, unit):
    return [
        {**row, "grasp_id": f"{unit}/{row['grasp_id']}"}
        | {"source_grasp_id": row["source_grasp_id"] and f"{unit}/{row['source_grasp_id']}"}
        for row in rows
    ]


SLOW_RUN = """
import sys, time
from xdex_drake.dataset.grasp_file import read_grasps
from xdex_drake.jobs import pairs
sys.path.insert(0, sys.argv[1])
from test_pairs import MANY, renamed

rows = [row for path in sys.argv[4:] for row in read_grasps(path)]

def work(unit, config):
    time.sleep(0.05)
    return pairs.UnitRows(tuple(renamed(rows, unit.name)), ())

if __name__ == "__main__":
    pairs.run_unit = work
    print("begun", flush=True)
    say = lambda done: print(done.unit.name, flush=True)
    pairs.generate(MANY, sys.argv[2], workers=int(sys.argv[3]), on_done=say)
"""


def begin_run(script, folder, workers, made):
    words = [sys.executable, str(script), str(Path(__file__).parent), str(folder), str(workers)]
    return subprocess.Popen([*words, *map(str, sorted((made / "shards").iterdir()))], stdout=subprocess.PIPE, text=True)


def test_killed_runs_go_on_and_lose_nothing(tmp_path, made, quick):
    generate(MANY, tmp_path / "whole", workers=0)
    script, folder = tmp_path / "run.py", tmp_path / "killed"
    script.write_text(SLOW_RUN)
    done: set[str] = set()
    for workers, moment in ((0, 0.0), (2, 0.03), (0, 0.07)):
        with begin_run(script, folder, workers, made) as run:
            assert run.stdout is not None
            for _ in range(3):
                run.stdout.readline()
            time.sleep(moment)
            os.kill(run.pid, signal.SIGKILL)
        now = completed_units(folder)
        assert done < now  # nothing lost, and something done
        done = now
    assert len(done) < 12 and not failed_units(folder)
    generate(MANY, folder, workers=0)
    assert shards(folder) == shards(tmp_path / "whole")


def test_a_second_run_is_refused_but_on_a_part_of_its_own(tmp_path, made, quick):
    script, folder = tmp_path / "run.py", tmp_path / "busy"
    script.write_text(SLOW_RUN)
    with begin_run(script, folder, 0, made) as run:
        assert run.stdout is not None
        for _ in range(2):
            run.stdout.readline()
        with pytest.raises(DatasetError, match="another run is at work"):
            generate(MANY, folder, workers=0)
        with pytest.raises(DatasetError, match="another run is at work"):
            generate(MANY, folder, workers=0, shard=(1, 2))
        run.kill()
    generate(MANY, folder, workers=0, shard=(1, 2))
    generate(MANY, folder, workers=0, shard=(2, 2))
    assert len(completed_units(folder)) == 12


def test_a_full_disk_stops_the_run_and_keeps_what_is_there(tmp_path, quick, monkeypatch):
    folder, left = tmp_path / "full", [20]
    synced = whole_file.os.fsync

    def fill(descriptor):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        synced(descriptor)

    monkeypatch.setattr(whole_file.os, "fsync", fill)
    with pytest.raises(GraspFileError, match=r"shards.*No space left"):
        generate(MANY, folder, workers=0)
    done = completed_units(folder)
    assert 0 < len(done) < 12
    monkeypatch.setattr(whole_file.os, "fsync", synced)
    assert generate(MANY, folder, workers=0) == (12 - len(done), 0)


def test_a_folder_that_cannot_be_written_is_an_error_of_ours(tmp_path, quick, monkeypatch):
    generate(MANY, tmp_path / "a", workers=0, shard=(1, 12))

    def refuse(path, *words):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr("xdex_drake.dataset.lock.os.open", refuse)
    with pytest.raises(DatasetError, match=r"Read-only file system; choose"), locked(tmp_path / "a"):
        pass


def test_a_damaged_shard_is_made_again(tmp_path, quick):
    generate(MANY, tmp_path / "d", workers=0)
    before = shards(tmp_path / "d")
    victim = tmp_path / "d" / "shards" / next(iter(before))
    victim.write_bytes(victim.read_bytes()[:-40])
    assert not verify(tmp_path / "d").ok
    assert generate(MANY, tmp_path / "d", workers=0) == (1, 0)
    assert shards(tmp_path / "d") == before


@pytest.mark.parametrize("text", ["3", "0/4", "5/4", "a/b"])
def test_parts_that_do_not_exist_are_refused(text, tmp_path, capsys):
    config = tmp_path / "c.yaml"
    config.write_text("hands: [inspire]\n")
    assert main(["dataset", "generate", str(config), "--out", str(tmp_path / "o"), "--shard", text]) == 2
    assert "shard" in capsys.readouterr().err and not (tmp_path / "o").exists()
