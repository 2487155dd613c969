"""Runs units of work on a Ray cluster: many machines, any of which may go away in mid-run.

The counterpart of `processes.run_units`. Ray gives the units to free cores; one whose machine, or process, is lost is
tried again elsewhere. Results come to the caller's process, which alone writes.
"""

from __future__ import annotations

import gc
import os
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from xdex_drake.errors import ConfigError, MissingExtra
from xdex_drake.jobs.processes import Failure, FailureKind, UnitResult, attempt

Unit = TypeVar("Unit")
Value = TypeVar("Value")

TRIES_AGAIN = 3
"""How often a unit is tried again whose process or machine was lost; one that ends its process each time has failed."""

AHEAD = 2
"""Units that are handed to the cluster for each of its cores, so that none waits."""


CONNECT_S = 10.0
"""Longest time for the head of a cluster to answer [s]."""


def ray_module() -> ModuleType:
    """Ray.

    Raises:
        MissingExtra: It is not installed.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError:
        raise MissingExtra("--ray needs Ray; install it by `pip install 'xdex_drake[ray]'`, on every machine") from None
    return ray


def run_units_on_ray(
    units: Iterable[Unit],
    work: Callable[[Unit], Value],
    *,
    address: str,
    on_done: Callable[[UnitResult[Unit, Value]], None] | None = None,
    units_per_process: int = 50,
) -> Iterator[UnitResult[Unit, Value]]:
    """Runs work on each unit on a Ray cluster, and yields the results in the order in which they come.

    A value must depend on its unit only; then the set of results is that of `processes.run_units`. Every machine needs
    the library in the same version, and files that units name under the same path. A unit has no limit of time.

    Args:
        units: The units; taken one by one as cores become free.
        work: A function at the top level of a module, or a `functools.partial` of one.
        address: Where the cluster is: `HOST:6379`, `auto` for the one that this machine is of, or `local` for one that
            is started here and ends with the run.
        on_done: Called in the caller's process with each result before it is yielded: the place to save it.
        units_per_process: Number of units after which a process is replaced, which bounds its memory.

    Yields:
        One result a unit.

    Raises:
        MissingExtra: Ray is not installed.
        ConfigError: There is no cluster at the address.
    """
    ray = ray_module()
    was_there = ray.is_initialized()
    if not was_there:
        _join(ray, address)
    task = ray.remote(num_cpus=1, max_retries=TRIES_AGAIN, max_calls=units_per_process)(_attempt_there)
    remaining, running = iter(units), {}
    try:
        work_there = ray.put(work)
        while True:
            cores = max(1, int(ray.cluster_resources().get("CPU", 1.0)))  # fewer where a machine has gone
            room = max(0, AHEAD * cores - len(running))
            running |= {task.remote(work_there, unit, str(Path.cwd())): unit for unit in islice(remaining, room)}
            if not running:
                return
            for done in ray.wait([*running], num_returns=1)[0]:
                result = _result(ray, done, running.pop(done))
                if on_done is not None:
                    on_done(result)
                yield result
    finally:
        for reference in running:
            ray.cancel(reference, force=True)
        if not was_there:
            ray.shutdown()


def _join(ray: ModuleType, address: str) -> None:
    """Connects this process to a cluster; raises where there is none."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        if host and port.isdecimal():  # Ray itself would try for minutes
            socket.create_connection((host, int(port)), timeout=CONNECT_S).close()
        ray.init(address=address, log_to_driver=False, logging_level="ERROR")
    except (OSError, OverflowError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        told = f"--ray {address}: no Ray cluster answers: {reason}; start one by `ray start --head`"
        raise ConfigError(told) from None


def _attempt_there(work: Callable[[Any], Any], unit: Any, folder: str) -> tuple[Any, Failure | None, float]:
    """Value or failure of a unit, and its wall time; on the machine that computes it."""
    if Path(folder).is_dir():
        os.chdir(folder)  # so that relative paths mean what they mean to the caller
    begin = time.monotonic()
    value, failure = attempt(work, unit)
    gc.collect()  # as in `processes`: Drake's diagrams go in circles
    return value, failure, time.monotonic() - begin


def _result(ray: ModuleType, reference: Any, unit: Unit) -> UnitResult[Unit, Any]:
    """The result of a unit, a failure where its process or machine was lost again and again."""
    try:
        value, failure, seconds = ray.get(reference)
    except ray.exceptions.RayError as error:
        value, seconds = None, float("nan")
        failure = Failure(FailureKind.CRASHED, f"{type(error).__name__} in each of {TRIES_AGAIN + 1} tries")
    return UnitResult(unit, value, failure, seconds)
