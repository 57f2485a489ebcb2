"""Compile kernels in another process: the present run does not wait for them, and later runs can load them."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import cache

from rb_dynamics.numerics.compilation import cache_folder, failure_of, is_cached

_COMMAND = ("-m", "rb_dynamics", "compile", "--beside")
_asked: set[str] = set()


def ask_for(name: str, order: str | None = "") -> bool:
    """Request another process to compile the kernel of this name, unless it is cached or requested.

    `order` is what it needs besides the name; None if it cannot compile it. Return whether such a process runs.
    `is_cached` tells whether the kernel is ready.
    """
    if name in _asked or is_cached(name) or failure_of(name):
        return True
    other = None if order is None else _other_process()
    if other is None or other.stdin is None:
        return False
    # The process ends early if a third one is compiling.
    with contextlib.suppress(OSError):
        other.stdin.write(f"{name} {order}\n".encode())
        other.stdin.flush()
    _asked.add(name)
    return True


@cache
def _other_process() -> subprocess.Popen[bytes] | None:
    """Return a process that compiles the kernels named on its standard input; None if nobody could use them."""
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK) or not sys.executable:
            return None
        # In its own session, so that it continues when this process ends or is interrupted.
        return subprocess.Popen(
            [sys.executable, *_COMMAND],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError:
        return None


def asked_for() -> Iterator[tuple[str, str]]:
    """In the process that `ask_for` has started, yield names and orders until the requesting process ends.

    Yield nothing if a third process is already compiling. This process runs at low priority.
    """
    try:
        import fcntl
    except ImportError:
        return
    with (cache_folder() / "compiling").open("w") as lock, contextlib.suppress(BlockingIOError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.nice(19)
        for line in sys.stdin:
            # If the folder has been removed, as tests do, nobody needs its kernels.
            if not cache_folder().is_dir():
                return
            name, _, order = line.strip().partition(" ")
            yield name, order
