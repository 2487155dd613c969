"""Runs units of work in child processes, so that a crash costs one unit and memory stays bounded.

Drake and the solvers end the process where they meet what they cannot handle. Here each worker is a process that
computes one unit at a time; one that crashes, or takes too long, is replaced, and its unit is reported as failed.

A worker is forked, in some 10 ms, where a fresh interpreter would import for two to four seconds: from the caller's
process, as long as that has one thread, as the command line's has; else from a server, a process of one thread that has
imported the library and does nothing else.
"""

import gc
import math
import multiprocessing as mp
import os
import pickle
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import islice
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkContext, ForkServerContext
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from xdex_drake.errors import ConfigError, XdexError

Unit = TypeVar("Unit")
Value = TypeVar("Value")

_ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
PRELOADED = ("xdex_drake.dataset.files", "xdex_drake.simulation.drake")
"""What the server imports; what else a unit needs, its worker imports."""

_FAILED_STARTS = 3
_GRACE_S = 5.0


class FailureKind(StrEnum):
    """How a unit came to have no value."""

    TIMEOUT = "timeout"
    CRASHED = "crashed"
    RAISED = "raised"


@dataclass(frozen=True)
class Failure:
    """Why a unit has no value.

    Attributes:
        kind: How it came.
        detail: More, in words; of `RAISED` the exception in one line.
        trace: Traceback of the exception, empty where there was none.
        error: The exception, where it says that the unit's input cannot be used.
    """

    kind: FailureKind
    detail: str
    trace: str = ""
    error: XdexError | None = None

    def __str__(self) -> str:
        """One line."""
        return self.detail if self.kind is FailureKind.RAISED else f"{self.kind}: {self.detail}"


@dataclass(frozen=True)
class UnitResult(Generic[Unit, Value]):
    """What became of a unit.

    Attributes:
        unit: The unit.
        value: What the work returned, None where it failed.
        failure: Why there is no value, None where there is one.
        seconds: Wall time of the unit.
    """

    unit: Unit
    value: Value | None
    failure: Failure | None
    seconds: float


def run_units(
    units: Iterable[Unit],
    work: Callable[[Unit], Value],
    *,
    workers: int,
    on_done: Callable[[UnitResult[Unit, Value]], None] | None = None,
    timeout_s: float | None = None,
    until: float = math.inf,
    units_per_process: int = 50,
) -> Iterator[UnitResult[Unit, Value]]:
    """Runs work on each unit, in child processes, and yields the results in the order in which they come.

    A value must depend on its unit only; then the set of results is the same whatever the number of workers. Each
    process uses one thread for linear algebra. A unit that raises, crashes its process or exceeds the time costs only
    itself. Where the caller stops early, by Ctrl-C or by closing the iterator, `on_done` still gets the results that
    were already finished; units that are under way are lost. Workers end when the caller's process does.

    Args:
        units: The units; taken one by one as workers become free.
        work: A function at the top level of a module, or a `functools.partial` of one: it is pickled, as are units and
            values.
        workers: Number of processes; 0 runs in the caller's process, without protection and without `timeout_s`.
        on_done: Called in the caller's process with each result before it is yielded: the place to save it.
        timeout_s: Longest wall time of a unit [s].
        until: Time of `time.monotonic` at which units that are under way are given up, too [s].
        units_per_process: Number of units after which a process is replaced, which bounds its memory.

    Yields:
        One result a unit.

    Raises:
        ConfigError: A number is out of range.
        RuntimeError: Workers end before they begin: `work` cannot be imported, or a script with threads lacks its
            `if __name__ == "__main__":` line.
    """
    if workers < 0 or units_per_process < 1 or (timeout_s is not None and timeout_s <= 0.0):
        raise ConfigError(
            f"workers={workers} must be 0 or more, units_per_process={units_per_process} 1 or more, and "
            f"timeout_s={timeout_s} positive or None"
        )
    save = on_done or _ignore
    if workers == 0:
        return _run_here(units, work, save)
    return _run_in_processes(units, work, workers, save, _Limits(timeout_s, until), units_per_process)


def run_apart(
    work: Callable[[Unit], Value],
    unit: Unit,
    *,
    timeout_s: float = math.inf,
    on_wait: Callable[[float], None] | None = None,
    wait_s: float = 0.5,
) -> UnitResult[Unit, Value]:
    """Runs work on one unit in a child process, which is killed where it takes too long, native code or not.

    Args:
        work: A function at the top level of a module.
        unit: The unit.
        timeout_s: Longest wall time, the start of the process included [s].
        on_wait: Called again and again while the work goes on, with the seconds so far.
        wait_s: Time between two such calls [s].

    Returns:
        What became of it.

    Raises:
        RuntimeError: The process ends before it begins.
    """
    begin = time.monotonic()
    limits = _Limits(None, begin + timeout_s)
    worker, waiting = _start(work, 1), [unit]
    try:
        while True:
            if worker.is_ready and waiting:
                _give(worker, waiting)
            if not wait([worker.connection], max(0.0, min(wait_s, limits.until - time.monotonic()))):
                if time.monotonic() < limits.until:
                    if on_wait is not None:
                        on_wait(time.monotonic() - begin)
                    continue
                worker.units, worker.begin = [unit], begin
            if (result := _collect(worker, limits)) is not None:
                return result
            if worker.connection.closed:
                raise RuntimeError("the worker process ended before it began, as standard error says above")
    finally:
        _end(worker)


def _ignore(result: UnitResult[Any, Any]) -> None:
    """Does nothing with a result."""


def _run_here(
    units: Iterable[Unit], work: Callable[[Unit], Value], save: Callable[[UnitResult[Unit, Value]], None]
) -> Iterator[UnitResult[Unit, Value]]:
    """Runs the units one after the other in this process."""
    for unit in units:
        begin = time.monotonic()
        result = UnitResult(unit, *attempt(work, unit), time.monotonic() - begin)
        save(result)
        yield result


def attempt(work: Callable[[Unit], Value], unit: Unit) -> tuple[Value | None, Failure | None]:
    """Value or failure of a unit, in this process.

    Args:
        work: The work.
        unit: The unit.

    Returns:
        What the work returned and None, or None and why it raised.
    """
    try:
        return work(unit), None
    except Exception as error:
        return None, _raised(error)


def _raised(error: Exception) -> Failure:
    """An exception that is being handled, as a failure."""
    ours = error if isinstance(error, XdexError) else None
    return Failure(FailureKind.RAISED, f"{type(error).__name__}: {error}", traceback.format_exc(), ours)


# The caller's side ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Limits:
    """When units are given up: after so many seconds each [s], and all of them at a time of `time.monotonic` [s]."""

    timeout_s: float | None
    until: float

    def of(self, worker: "_Worker[Any]") -> float:
        """When the unit of a worker is given up."""
        return min(self.until, math.inf if self.timeout_s is None else worker.begin + self.timeout_s)

    def __str__(self) -> str:
        return "the time limit" if self.timeout_s is None else f"{self.timeout_s:g} s"


@dataclass
class _Worker(Generic[Unit]):
    """A child process, and what it is doing."""

    process: BaseProcess
    connection: Connection
    is_ready: bool = False
    units: list[Unit] = field(default_factory=list)  # the one that is under way, if any
    begin: float = 0.0
    done: int = 0


def _run_in_processes(
    units: Iterable[Unit],
    work: Callable[[Unit], Value],
    count: int,
    save: Callable[[UnitResult[Unit, Value]], None],
    limits: _Limits,
    units_per_process: int,
) -> Iterator[UnitResult[Unit, Value]]:
    """Runs the units in `count` processes."""
    remaining = iter(units)
    waiting: list[Unit] = []
    workers: list[_Worker[Unit]] = []
    results: list[UnitResult[Unit, Value]] = []
    failed_starts = 0
    try:
        while True:
            waiting.extend(islice(remaining, count - len(waiting)))
            for worker in workers:
                if worker.is_ready and not worker.units and waiting:
                    _give(worker, waiting)
            free = sum(not worker.units for worker in workers)
            for _ in range(min(count - len(workers), len(waiting) - free)):
                workers.append(_start(work, units_per_process))
            yield from results  # only now, so that nobody waits for the caller
            if not waiting and not any(worker.units for worker in workers):
                return
            results.clear()
            for worker in _which_woke(workers, limits):
                result = _collect(worker, limits)
                if result is not None:
                    save(result)
                    results.append(result)
                if worker.is_ready:
                    failed_starts = 0
                if worker.connection.closed or worker.done >= units_per_process:
                    failed_starts += not worker.is_ready
                    _end(worker)
            workers = [worker for worker in workers if not worker.connection.closed]
            if failed_starts >= _FAILED_STARTS:
                raise RuntimeError(
                    "worker processes end before they begin, as standard error says above: the work must be a function "
                    'of a module that can be imported, and a script needs its `if __name__ == "__main__":` line'
                )
    except (KeyboardInterrupt, GeneratorExit):
        for worker in workers:
            if worker.units and not worker.connection.closed and worker.connection.poll():
                result = _collect(worker, limits)
                if result is not None:
                    save(result)
        raise
    finally:
        for worker in workers:
            _end(worker)


def _start(work: Callable[[Any], Any], units_per_process: int) -> "_Worker[Any]":
    """Starts a process; it says when it is ready."""
    resource_tracker.ensure_running()  # or else the first start does this, and lets interrupts through again
    with _single_threaded(), _without_interrupts():
        context = _fork_context()
        ours, theirs = context.Pipe()
        # A server has the environment of when it was started.
        arguments = (work, theirs, units_per_process, dict(os.environ))
        process = context.Process(target=_serve, args=arguments, daemon=True)
        process.start()
    theirs.close()  # so that our end tells when the process has gone
    return _Worker(process, ours)


def _fork_context() -> ForkContext | ForkServerContext:
    """Forks the caller's process where it has one thread; else a server, which is started where there is none yet."""
    if _has_one_thread():
        return mp.get_context("fork")
    context = mp.get_context("forkserver")
    context.set_forkserver_preload([*PRELOADED])
    forkserver.ensure_running()
    return context


def _has_one_thread() -> bool:
    """Whether this process has one thread, those of native libraries included; not known where there is no /proc."""
    try:
        return len(os.listdir("/proc/self/task")) == 1
    except OSError:
        return False


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Environment that a process inherits, so that its linear algebra uses one thread."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Mask that a process inherits: Ctrl-C reaches every process, and the caller alone decides what it means."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _give(worker: _Worker[Unit], waiting: list[Unit]) -> None:
    """Sends the first unit that waits to a worker that is free; not where the worker turns out to have gone."""
    with suppress(BrokenPipeError, ConnectionResetError):
        worker.connection.send(waiting[0])
        worker.units = [waiting.pop(0)]
        worker.begin = time.monotonic()


def _which_woke(workers: list[_Worker[Unit]], limits: _Limits) -> list[_Worker[Unit]]:
    """Waits until some workers have something to say, have gone, or are out of time."""
    first = min((limits.of(worker) for worker in workers if worker.units), default=math.inf)
    left = max(0.0, first - time.monotonic())
    woke = wait([worker.connection for worker in workers], None if math.isinf(left) else left)
    return [worker for worker in workers if worker.connection in woke or _is_late(worker, limits)]


def _is_late(worker: _Worker[Any], limits: _Limits) -> bool:
    return bool(worker.units) and time.monotonic() >= limits.of(worker)


def _collect(worker: _Worker[Unit], limits: _Limits) -> UnitResult[Unit, Any] | None:
    """Takes what a worker has to say; None where that is no result.

    A worker that has crashed or is out of time is ended here, so that its exit status is known.
    """
    try:
        if not worker.connection.poll():
            _end(worker)
            return _give_up(worker, Failure(FailureKind.TIMEOUT, f"more than {limits}"))
        message = worker.connection.recv_bytes()
    except (EOFError, OSError):
        _end(worker, grace_s=_GRACE_S)
        return _give_up(worker, Failure(FailureKind.CRASHED, _how_it_ended(worker.process)))
    if not worker.is_ready:
        worker.is_ready = True
        return None
    worker.done += 1
    seconds = time.monotonic() - worker.begin
    try:
        value, failure = pickle.loads(message)
    except Exception as error:
        value, failure = None, _raised(error)
    return UnitResult(worker.units.pop(), value, failure, seconds)


def _give_up(worker: _Worker[Unit], failure: Failure) -> UnitResult[Unit, Any] | None:
    """The result of a worker that has gone; None where it had no unit."""
    if not worker.units:
        return None
    return UnitResult(worker.units.pop(), None, failure, time.monotonic() - worker.begin)


def _end(worker: _Worker[Any], *, grace_s: float = 0.0) -> None:
    """Ends a worker's process, whose unit, if any, is given up; one that is ending by itself has `grace_s` for it."""
    if worker.connection.closed:
        return
    worker.process.join(grace_s)
    worker.process.kill()
    worker.process.join()
    worker.connection.close()


def _how_it_ended(process: BaseProcess) -> str:
    code = process.exitcode
    if code is None or code >= 0:
        return f"the process ended with status {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


# The worker's side ----------------------------------------------------------------------------------------------------


def _serve(
    work: Callable[[Any], Any], connection: Connection, units_per_process: int, environment: dict[str, str]
) -> None:
    """Computes units until there are no more."""
    for name in os.environ.keys() - environment.keys():
        del os.environ[name]
    os.environ.update(environment)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # also for whatever resets the mask
    threading.Thread(target=_end_with_caller, daemon=True).start()
    # Drake's diagrams go in circles, which only the collector ends, and it counts Python's objects alone: it would let
    # gigabytes lie. What is here already stays, so that to look after each unit takes no time.
    gc.freeze()
    with suppress(EOFError, OSError):
        connection.send_bytes(b"ready")
        for _ in range(units_per_process):
            answer = attempt(work, connection.recv())
            gc.collect()
            try:
                message = pickle.dumps(answer)
            except Exception as error:
                message = pickle.dumps((None, _raised(error)))
            connection.send_bytes(message)


def _end_with_caller() -> None:
    """Ends this process when its parent does, even in the midst of a unit."""
    parent = mp.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
