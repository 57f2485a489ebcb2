"""Catch the signals that end a command or a node, so that logs are closed first; restore the handlers afterwards."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def stop_signals(handle: Callable[[int], None], *others: signal.Signals) -> Iterator[None]:
    """Call `handle` on SIGTERM, SIGHUP and `others`; the previous handlers are restored afterwards.

    SIGHUP remains ignored if it was, as under nohup. Outside the main thread nothing is changed.
    """
    numbers = [signal.SIGTERM, *others]
    hangup = getattr(signal, "SIGHUP", None)  # not on Windows
    if hangup is not None and signal.getsignal(hangup) != signal.SIG_IGN:
        numbers.append(hangup)
    if threading.current_thread() is not threading.main_thread():
        numbers = []
    before = [signal.signal(each, lambda caught, _: handle(caught)) for each in numbers]
    try:
        yield
    finally:
        for each, handler in zip(numbers, before, strict=True):
            signal.signal(each, handler)


class Stopped(KeyboardInterrupt):
    """SIGTERM, SIGHUP or Ctrl-C; handled wherever Ctrl-C is."""

    def __init__(self, number: int) -> None:
        """Create it for the signal of this `number`."""
        super().__init__(number)
        self.number = number


@contextlib.contextmanager
def interrupted_by_signals() -> Iterator[None]:
    """Treat the first SIGTERM or SIGHUP like Ctrl-C; further signals do not interrupt the closing of logs."""
    came: list[int] = []
    _waiting.clear()

    def handle(number: int) -> None:
        came.append(number)
        if len(came) > 1 and number != signal.SIGINT:
            return
        if _depth[0]:
            _waiting.append(number)
        else:
            raise Stopped(number)

    # If Ctrl-C is ignored, as in the background of a script, it remains so.
    interrupt = [signal.SIGINT] if signal.getsignal(signal.SIGINT) is signal.default_int_handler else []
    with stop_signals(handle, *interrupt):
        yield


@contextlib.contextmanager
def interrupts_wait() -> Iterator[None]:
    """For users of the library: let Ctrl-C wait for the end of a block of `uninterrupted`, if Python handles it."""
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return

    def handle(number: int, _frame: object) -> None:
        if not _depth[0]:
            raise KeyboardInterrupt
        _waiting.append(number)

    before = signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


# Number of `uninterrupted` blocks that the main thread is in, and the signals that wait for their end.
_depth, _waiting = [0], list[int]()


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Let signals of the two contexts above wait until the block ends: an interrupted write would damage a log."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _depth[0] += 1
    try:
        yield
    finally:
        _depth[0] -= 1
        if _waiting and not _depth[0]:
            number = _waiting[0]
            _waiting.clear()
            raise Stopped(number)
