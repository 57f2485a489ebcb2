"""`GrowingArray`: numbers added at the end; of many, all stand in a file without a name instead of in memory."""

from __future__ import annotations

import mmap
import os
from array import array
from collections.abc import Iterable
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

# What one array takes of the memory at most, where a file can be written; and what then waits for the next write.
_IN_MEMORY, _WAITING = 2**22, 2**18


class GrowingArray:
    """Numbers of 8 bytes, added at the end."""

    def __init__(self) -> None:
        """Begin with none."""
        self._bytes = array("B")
        self._limit = _IN_MEMORY
        self._file: IO[bytes] | None = None
        self._in_file = 0

    def __del__(self) -> None:
        """Close the file; arrays that `view` gave keep it for themselves."""
        if self._file is not None:
            self._file.close()

    def __len__(self) -> int:
        """Return how many numbers there are."""
        return (self._in_file + len(self._bytes)) // 8

    def add(self, numbers: NDArray[Any]) -> None:
        """Add the bits of `numbers`, in their order."""
        self._bytes.frombytes(np.ascontiguousarray(numbers).reshape(-1).view(np.uint8).data)
        if len(self._bytes) > self._limit:
            self._write()

    def view(self, kind: str) -> NDArray[Any]:
        """Return the numbers, (n,), as `kind`, such as "f8"; those in a file cannot be changed."""
        if self._file is not None and self._bytes:
            self._write()
        if self._file is not None:
            try:
                return np.frombuffer(mmap.mmap(self._file.fileno(), self._in_file, access=mmap.ACCESS_READ), kind)
            except OSError:
                self._to_memory()
        return np.frombuffer(self._bytes, kind) if self._bytes else np.empty(0, kind)

    def _write(self) -> None:
        """Move what is in memory to the file; where the disk has no room for it, the file to memory."""
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
    """Give back the memory that reading numbers in a file took: they are read again when they are wanted."""
    base: Any = rows
    while isinstance(base, np.ndarray):
        base = base.base
    mapped = base.obj if isinstance(base, memoryview) else base
    if isinstance(mapped, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        mapped.madvise(mmap.MADV_DONTNEED)


def _folder() -> str | None:
    """Return where large files go: the usual folder of temporary files may be in memory itself, this one is not."""
    return "/var/tmp" if "TMPDIR" not in os.environ and os.access("/var/tmp", os.W_OK) else None
