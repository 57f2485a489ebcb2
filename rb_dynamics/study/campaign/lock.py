"""A lock for a file that only one process may write; the operating system releases it when the process ends.

A second file beside it names the holder, and is removed when the lock is released.
"""

from __future__ import annotations

import errno
import logging
import os
import platform
from collections.abc import Callable
from pathlib import Path

from rb_dynamics.errors import LogError

_SAID = 200

_log = logging.getLogger(__name__)


def lock(path: Path) -> Callable[[], None]:
    """Lock `path` and return a function that releases it.

    Raises:
        LogError: another process, or another part of this one, holds the lock, or the folder cannot be written.
    """
    try:
        import fcntl
    except ImportError:  # A system without such locks.
        return lambda: None
    name = Path(f"{path}.lock")
    try:
        while True:
            descriptor = os.open(name, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                if error.errno not in (errno.EAGAIN, errno.EACCES):
                    # This file system has no locks, as on some clusters.
                    _log.warning(
                        "%s cannot be locked (%s): make sure that no other process writes it", path, error.strerror
                    )
                    break
                holder = os.pread(descriptor, _SAID, 0).decode(errors="replace") or "another process"
                os.close(descriptor)
                raise LogError(
                    f"{path} is being written by {holder}; wait until it is done, or give another file with --out"
                ) from None
            # The previous holder may have removed the file since it was opened.
            if name.exists() and os.path.samestat(os.fstat(descriptor), os.stat(name)):
                break
            os.close(descriptor)
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"process {os.getpid()} on {platform.node()}".encode(), 0)
    except OSError as error:
        raise LogError(f"cannot write {name}: {error.strerror or error}; give another file with --out") from error

    def release() -> None:
        name.unlink(missing_ok=True)
        os.close(descriptor)

    return release
