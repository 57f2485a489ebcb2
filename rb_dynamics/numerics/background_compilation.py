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
_asked: dict[str, str] = {}


def ask_for(name: str, order: str | None = "") -> bool:
    """Request another process to compile the kernel of this name, unless it is cached or requested.

    `order` is what it needs besides the name; None if it cannot compile it. Return whether this is or will be done;
    `is_cached` tells whether the kernel is ready.
    """
    if is_cached(name) or failure_of(name):
        return True
    other = None if order is None else _other_process()
    if other is None or other.stdin is None or other.poll() is not None:
        return False
    if name not in _asked:
        with contextlib.suppress(OSError):
            other.stdin.write(f"{name} {order}\n".encode())
            other.stdin.flush()
        _asked[name] = str(order)
    return True


def waited_for() -> list[str]:
    """Return the names of the kernels of this package that `ask_for` has requested and that are not there yet."""
    return [name for name, order in _asked.items() if not (order or is_cached(name) or failure_of(name))]


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

    Of all such processes one compiles at a time. The others wait, and pass over what it has compiled meanwhile.
    """
    try:
        import fcntl
    except ImportError:
        return
    for line in sys.stdin:
        # If the folder has been removed, as tests do, nobody needs its kernels.
        if not cache_folder().is_dir():
            return
        name, _, order = line.strip().partition(" ")
        # The system releases the lock of a process that is killed.
        with (cache_folder() / "compiling").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (is_cached(name) or failure_of(name)):
                yield name, order
