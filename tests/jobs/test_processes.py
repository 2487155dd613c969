"""A unit that crashes, hangs or raises costs only itself."""

import contextlib
import functools
import gc
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from xdex_drake.errors import ConfigError
from xdex_drake.jobs.deadline import ending_at
from xdex_drake.jobs.processes import UnitResult, run_apart, run_units


def square(unit):
    return unit * unit


def misbehave(unit):
    if unit == "abort":
        os.abort()
    if unit == "exit":
        sys.exit(3)
    if unit == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if unit == "hang":
        time.sleep(600)
    if unit == "raise":
        raise ValueError("no such thing")
    if unit == "unpicklable":
        return lambda: None
    return unit.upper()


def draw(unit, seed):
    """What a real unit does: a result of its own seed only."""
    return np.random.default_rng([seed, unit]).normal(size=4).tolist()


def process_id(unit):
    return os.getpid()


class Knot:
    """Something that only the collector ends, as it does Drake's diagrams."""

    def __init__(self):
        self.itself = self


def knots(unit):
    """Knots that earlier units left; leaves one more."""
    left = sum(isinstance(thing, Knot) for thing in gc.get_objects())
    Knot()
    return left


def threads(unit):
    return [os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")]


def touch(unit, folder):
    time.sleep(0.05)
    (Path(folder) / f"{unit}").touch()
    return unit


@pytest.mark.parametrize("workers", [0, 1, 2])
def test_each_unit_gives_its_value(workers):
    saved = []
    results = list(run_units(iter(range(7)), square, workers=workers, on_done=saved.append))
    assert {result.unit: result.value for result in results} == {k: k * k for k in range(7)}
    assert all(result.failure is None and result.seconds >= 0.0 for result in results)
    assert saved == results


def test_no_units_start_no_process():
    assert list(run_units([], square, workers=4)) == []


def test_one_worker_equals_four():
    work = functools.partial(draw, seed=3)
    by_count = []
    for workers in (0, 1, 4):
        results = run_units(range(9), work, workers=workers, units_per_process=4)
        by_count.append({result.unit: result.value for result in results})
    assert by_count[0] == by_count[1] == by_count[2]
    assert len(by_count[0]) == 9


def test_a_bad_unit_costs_only_itself():
    units = ["a", "abort", "b", "exit", "hang", "c", "killed", "raise", "d", "unpicklable", "e"]
    results = {result.unit: result for result in run_units(units, misbehave, workers=2, timeout_s=2.0)}
    assert list(sorted(results)) == sorted(units)
    assert {unit: results[unit].value for unit in "abcde"} == {unit: unit.upper() for unit in "abcde"}
    assert str(results["abort"].failure) == "crashed: SIGABRT"
    assert str(results["killed"].failure) == "crashed: SIGKILL"
    assert str(results["exit"].failure) == "crashed: the process ended with status 3"
    assert str(results["hang"].failure) == "timeout: more than 2 s"
    assert 2.0 <= results["hang"].seconds < 10.0
    assert str(results["raise"].failure) == "ValueError: no such thing"
    assert "in misbehave" in results["raise"].failure.trace
    assert "lambda" in str(results["unpicklable"].failure)
    assert all(result.value is None for unit, result in results.items() if len(unit) > 1)


def test_in_this_process_an_exception_costs_only_its_unit():
    results = list(run_units(["raise", "a"], misbehave, workers=0))
    assert [str(result.failure) for result in results] == ["ValueError: no such thing", "None"]


def test_a_process_is_replaced_after_some_units():
    results = [result.value for result in run_units(range(5), process_id, workers=1, units_per_process=2)]
    assert [results.count(pid) for pid in dict.fromkeys(results)] == [2, 2, 1]
    assert os.getpid() not in results


def test_what_a_unit_leaves_in_circles_is_gone_before_the_next():
    assert [result.value for result in run_units(range(5), knots, workers=1)] == [0] * 5


def test_workers_use_one_thread_and_leave_the_environment_alone(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    (result,) = run_units([0], threads, workers=1)
    assert result.value == ["1", "1", "1"]
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


def test_units_are_taken_as_they_are_needed():
    taken = []

    def endless():
        k = 0
        while True:
            taken.append(k)
            yield k
            k += 1

    results = run_units(endless(), square, workers=1)
    assert [next(results).unit for _ in range(3)] == [0, 1, 2]
    results.close()
    assert len(taken) < 10


def test_the_consumer_may_stop_early(tmp_path):
    """What was finished when the iterator is closed is saved all the same."""
    saved: list[UnitResult[int, int]] = []
    work = functools.partial(touch, folder=str(tmp_path))
    with contextlib.closing(run_units(range(50), work, workers=2, on_done=saved.append)) as results:
        first = next(results).unit
        wait_for([tmp_path / str(first + 1)])  # another unit is done, and nobody has asked for its result
        time.sleep(0.5)
        assert len(saved) == 1
    assert 2 <= len(saved) <= 4


@pytest.mark.parametrize(
    "options", [{"workers": -1}, {"workers": 1, "timeout_s": 0.0}, {"workers": 1, "units_per_process": 0}]
)
def test_bad_numbers_are_refused_at_once(options):
    with pytest.raises(ConfigError, match="must be 0 or more"):
        run_units([0], square, **options)


SCRIPT = """
    import functools, sys, threading, time
    from pathlib import Path
    from xdex_drake.jobs.processes import run_units

    def work(unit, folder):
        (Path(folder) / f"{unit}.begun").touch()
        time.sleep(0.2 if unit < 4 else 600)
        return unit

    def save(result):
        (Path(sys.argv[1]) / f"{result.unit}.saved").touch()

    if GUARD:
        if THREAD:  # workers are forked from a server then
            threading.Thread(target=time.sleep, args=(600,), daemon=True).start()
        for _ in run_units(range(8), functools.partial(work, folder=sys.argv[1]), workers=2, on_done=save):
            pass
"""


def start_script(tmp_path, guard, thread):
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(SCRIPT).replace("GUARD", guard).replace("THREAD", str(thread)))
    (tmp_path / "out").mkdir()
    return subprocess.Popen(
        [sys.executable, str(script), str(tmp_path / "out")],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # so that the signal reaches it and its workers, as Ctrl-C does, and nobody else
    )


def wait_for(paths, seconds=60.0):
    deadline = time.monotonic() + seconds
    while not all(path.exists() for path in paths):
        assert time.monotonic() < deadline, f"still waiting for {paths}"
        time.sleep(0.02)


@pytest.mark.parametrize("thread", [False, True])
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_ctrl_c_or_a_kill_leaves_finished_work_and_no_process(tmp_path, how, thread):
    with start_script(tmp_path, '__name__ == "__main__"', thread) as process:
        out = tmp_path / "out"
        wait_for([*(out / f"{k}.saved" for k in range(4)), out / "4.begun", out / "5.begun"])
        if how is signal.SIGINT:
            os.killpg(process.pid, how)
        else:
            process.send_signal(how)  # the caller alone: its workers must notice
        _, errors = process.communicate(timeout=60)  # returns only when the workers, who share the pipe, have gone
    assert process.returncode == (-how if how is signal.SIGKILL else process.returncode) != 0
    assert sorted(path.name for path in out.glob("*.saved")) == [f"{k}.saved" for k in range(4)]
    if how is signal.SIGINT:
        assert errors.count("KeyboardInterrupt") == 1  # the caller's; workers are silent


def test_a_script_without_its_guard_gets_an_explanation(tmp_path):
    with start_script(tmp_path, "True", thread=True) as process:
        _, errors = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "a script needs its `if __name__" in errors


def test_one_unit_apart_is_killed_at_its_limit_and_tells_how_long_it_takes():
    assert run_apart(misbehave, "word").value == "WORD"
    waited = []
    done = run_apart(misbehave, "hang", timeout_s=3.0, on_wait=waited.append, wait_s=0.2)
    assert done.value is None and done.failure.kind == "timeout" and waited == sorted(waited) and waited
    assert run_apart(misbehave, "raise").failure.kind == "raised"
    assert run_apart(misbehave, "abort").failure.kind == "crashed"


def test_a_block_ends_at_its_deadline_whatever_it_does():
    steps = 0
    begin = time.time()
    with ending_at(begin + 0.2):
        while time.time() < begin + 60.0:
            with contextlib.suppress(Exception):  # no handler of errors takes the end for one
                steps += 1
    assert steps > 0 and time.time() < begin + 30.0
    with ending_at(time.time() + 1e9):
        steps = 0
    assert steps == 0


def test_what_a_limit_ends_takes_its_own_children_along(tmp_path):
    """A worker that splits a mesh has a child of its own, which must not go on without it."""
    code = (
        "from xdex_drake.scene.split_process import _end_with_parent as f; f(); print('on', flush=True); import time\n"
    )
    parent = f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', {code + 'time.sleep(60)'!r}]).wait()"
    with subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"on\n"
        process.kill()
        if sys.platform.startswith("linux"):
            assert process.stdout.read() == b""  # its end of the pipe is closed: it has gone
