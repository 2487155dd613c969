"""Ends work of this process at a given time, wherever it is."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

AGAIN_S = 0.5
"""Time after which the end is asked for again, where the first time fell into code that lets nothing through [s]."""


class _TimeUp(BaseException):
    """The time is up; no error, so that no handler of errors takes it for one."""


def _end(number: int, frame: FrameType | None) -> None:
    raise _TimeUp


@contextmanager
def ending_at(deadline: float) -> Iterator[None]:
    """Leaves a block at a time, between any two steps of Python; what the block had done by then stays.

    A native call ends first, so that the block may end later by as much. Signals reach the main thread alone: in
    another one, and on systems without alarms, the block runs to its end.

    Args:
        deadline: Time of `time.time` [s].
    """
    left = deadline - time.time()
    possible = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
    if not possible or left > 1e8:
        yield
        return
    handler = signal.signal(signal.SIGALRM, _end)
    before = signal.setitimer(signal.ITIMER_REAL, max(left, 1e-3), AGAIN_S)
    try:
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, handler)
            signal.setitimer(signal.ITIMER_REAL, *before)
    except _TimeUp:
        pass
