"""Compile kernels in another process, beside a run that could use them: it does not wait, and the next run has them."""

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


def ask_for(name: str) -> bool:
    """Let another process compile the kernel of this name, unless it is there or on its way; return whether one can.

    Whether it has come, `is_cached` tells.
    """
    if name in _asked or is_cached(name) or failure_of(name):
        return True
    other = _other_process()
    if other is None or other.stdin is None:
        return False
    # It ends early where a third one is at it.
    with contextlib.suppress(OSError):
        other.stdin.write(f"{name}\n".encode())
        other.stdin.flush()
    _asked.add(name)
    return True


@cache
def _other_process() -> subprocess.Popen[bytes] | None:
    """Return one that compiles what it is told, line by line; None where that would help nobody."""
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK) or not sys.executable:
            return None
        # In a session of its own: it goes on when this process is done or interrupted.
        return subprocess.Popen(
            [sys.executable, *_COMMAND],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError:
        return None


def asked_for() -> Iterator[str]:
    """Yield what is asked of this process, which `ask_for` has started, until the other one has ended.

    Nothing where a third process is compiling already. This one gives way to whatever else is to be computed.
    """
    try:
        import fcntl
    except ImportError:
        return
    with (cache_folder() / "compiling").open("w") as lock, contextlib.suppress(BlockingIOError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.nice(19)
        for line in sys.stdin:
            # A folder that was removed, as those of tests are, wants no more.
            if not cache_folder().is_dir():
                return
            yield line.strip()
