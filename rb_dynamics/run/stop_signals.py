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
    """SIGTERM or SIGHUP; handled wherever Ctrl-C is."""

    def __init__(self, number: int) -> None:
        """Keep the `number` of the signal."""
        super().__init__(number)
        self.number = number


@contextlib.contextmanager
def interrupted_by_signals() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP like Ctrl-C, once: further signals do not interrupt the closing of logs."""
    came: list[int] = []

    def handle(number: int) -> None:
        came.append(number)
        if len(came) == 1:
            raise Stopped(number)

    with stop_signals(handle):
        yield
