"""`LogFile`: a file that takes each write whole or says why not, and can give back its end when the disk is full.

Never buffers: what `write` has taken survives a kill of the process. Never replaces an earlier file unless told to.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from rb_dynamics.errors import LogError


class LogFile:
    """One new file, written front to back."""

    def __init__(self, path: Path, overwrite: bool = False) -> None:
        """Create `path` and the folders above it.

        Raises:
            LogError: it is there already and may not be replaced, or cannot be written.
        """
        self._path = path
        self._position = 0
        self._failure: LogError | None = None
        require_free(path, overwrite)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # A pipe or a device is there before it is written; of a regular file the check and the creation are one.
            self._file = path.open("wb" if overwrite or path.exists() else "xb", buffering=0)
        except OSError as error:
            raise LogError(f"cannot write {path}: {error.strerror or error}; give a file you may write") from error

    @property
    def closed(self) -> bool:
        """Whether nothing can be written any more."""
        return self._file.closed

    @property
    def failure(self) -> LogError | None:
        """Why the last write failed; None while all is well."""
        return self._failure

    def tell(self) -> int:
        """Return the bytes written; a pipe has no other position."""
        return self._position

    def write(self, data: bytes | bytearray) -> None:
        """Write all of `data`.

        Raises:
            LogError: this write or an earlier one failed.
        """
        if self._failure is not None:
            raise self._failure
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self._failure = LogError(
                f"cannot go on writing {self._path}: {error.strerror or error}; what was written before stands and can "
                "be read. Free space or give another file"
            )
            raise self._failure from error
        self._position += len(data)

    def cut(self, position: int) -> bool:
        """Give back what lies behind `position` and take writes again; False where the file cannot (a pipe)."""
        try:
            self._file.truncate(position)
            self._file.seek(position)
        except OSError:
            return False
        self._position, self._failure = position, None
        return True

    def close(self) -> None:
        """Close; the data is on the disk when this returns.

        Raises:
            LogError: the disk does not take it.
        """
        try:
            if self._path.is_file():
                os.fsync(self._file.fileno())
            self._file.close()
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.close()
            raise LogError(f"cannot finish {self._path}: {error.strerror or error}; free space") from error


def require_free(path: Path, overwrite: bool = False) -> None:
    """Refuse a path that is a directory, or a file that is there already.

    Raises:
        LogError: names the remedy.
    """
    if path.is_dir():
        raise LogError(f"cannot write {path}: it is a directory, expected a file name such as {path / 'run.mcap'}")
    if path.is_file() and not overwrite:
        raise LogError(
            f"{path} is there already and is not replaced; give another name, move the file away, or say --overwrite "
            "where the command takes it"
        )
