"""`GrowingArray`: an array to which numbers are appended; if large, it is in an unnamed file instead of memory."""

from __future__ import annotations

import mmap
import os
from array import array
from collections.abc import Iterable
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

# Largest size in memory before an array moves to a file, and largest size of what then waits to be written.
_IN_MEMORY, _WAITING = 2**22, 2**18


class GrowingArray:
    """A growing array of numbers of 8 bytes each."""

    def __init__(self) -> None:
        """Create an empty array."""
        self._bytes = array("B")
        self._limit = _IN_MEMORY
        self._file: IO[bytes] | None = None
        self._in_file = 0

    def __del__(self) -> None:
        """Close the file; arrays from `view` keep it open for themselves."""
        if self._file is not None:
            self._file.close()

    def __len__(self) -> int:
        """Return the number of elements."""
        return (self._in_file + len(self._bytes)) // 8

    def add(self, numbers: NDArray[Any]) -> None:
        """Append the bits of `numbers`."""
        self._bytes.frombytes(np.ascontiguousarray(numbers).reshape(-1).view(np.uint8).data)
        if len(self._bytes) > self._limit:
            self._write()

    def view(self, kind: str) -> NDArray[Any]:
        """Return the numbers, (n,), as dtype `kind`, such as "f8"; read-only if they are in a file."""
        if self._file is not None and self._bytes:
            self._write()
        if self._file is not None:
            try:
                return np.frombuffer(mmap.mmap(self._file.fileno(), self._in_file, access=mmap.ACCESS_READ), kind)
            except OSError:
                self._to_memory()
        return np.frombuffer(self._bytes, kind) if self._bytes else np.empty(0, kind)

    def _write(self) -> None:
        """Move the numbers in memory to the file; if the disk is full, move the file to memory instead."""
        import tempfile

        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0, dir=_folder())  # noqa: SIM115
            written = self._file.write(self._bytes)
        except OSError:
            written = 0
        if written != len(self._bytes):
            self._to_memory()
            return
        self._in_file += written
        self._bytes, self._limit = array("B"), _WAITING

    def _to_memory(self) -> None:
        rest, self._bytes, self._limit = self._bytes, array("B"), 2**63
        if self._file is not None:
            self._file.seek(0)
            while self._in_file > 0:
                part = self._file.read(min(self._in_file, _IN_MEMORY))
                self._bytes.frombytes(part)
                self._in_file -= len(part)
            self._file.close()
            self._file = None
        self._bytes += rest


def stored(blocks: Iterable[NDArray[Any]], columns: int) -> NDArray[np.float64]:
    """Return the rows of blocks (k, columns), or of numbers (k,) where `columns` is 0, as one array, read-only."""
    found = GrowingArray()
    for block in blocks:
        found.add(block)
    numbers = found.view("f8")
    return numbers.reshape(-1, columns) if columns else numbers


def give_back(rows: NDArray[Any]) -> None:
    """Release the memory that numbers of a file occupy after reading; later accesses read them again."""
    base: Any = rows
    while isinstance(base, np.ndarray):
        base = base.base
    mapped = base.obj if isinstance(base, memoryview) else base
    if isinstance(mapped, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        mapped.madvise(mmap.MADV_DONTNEED)


def _folder() -> str | None:
    """Return a folder for large files that is on disk, unlike some systems' folder of temporary files."""
    return "/var/tmp" if "TMPDIR" not in os.environ and os.access("/var/tmp", os.W_OK) else None
