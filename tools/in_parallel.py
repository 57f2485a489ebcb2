"""A function of many seeds in several processes, until Ctrl-C: what the calibrations share."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from typing import TypeVar

T = TypeVar("T")


def in_parallel(of: Callable[[int], T], seeds: range, jobs: int) -> Iterator[T]:
    """Yield `of(seed)` in the order of the seeds, `jobs` at a time; Ctrl-C ends it with those so far."""
    if jobs > 1:
        # A child of fork would share the threads of numpy and numba.
        with get_context("spawn").Pool(jobs, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
            yield from _until_interrupted(pool.imap(of, seeds))
    else:
        yield from _until_interrupted(map(of, seeds))


def _until_interrupted(results: Iterator[T]) -> Iterator[T]:
    while True:
        try:
            result = next(results)
        except (KeyboardInterrupt, StopIteration):
            return
        yield result
