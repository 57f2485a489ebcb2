"""`OutputFile`: a write succeeds as a whole or fails with a reason, and the file can be truncated on a full disk.

Writes are not buffered, so what `write` has taken survives a kill of the process. An existing file of the same name
is replaced once the new one can be opened; with `OutputFile.whole`, or `renamed` for other writers, once the new one is
finished. Of several processes that write one file at once, each writes its own, and one of these keeps the name; what
one that was killed left is removed by the next that writes this file.
`require_other` and `require_apart` stop a command from overwriting its input or another of its outputs; `move_aside`
keeps an earlier log, and `hold` a folder for one bag.
"""

from __future__ import annotations

import contextlib
import functools
import glob
import hashlib
import os
import re
import secrets
import stat
from collections.abc import Iterable, Iterator
from io import FileIO
from pathlib import Path

from rb_dynamics.errors import LogError


def make_folder(path: Path) -> None:
    """Make the folders above a file that is to be written.

    Raises:
        LogError: one of them cannot be made, or the file would be a folder.
    """
    if path.is_dir():
        raise LogError(f"cannot write {path}: it is a folder, expected the name of a file; give a file in it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = "it is a file" if path.parent.is_file() else error.strerror or error
        raise LogError(
            f"cannot write {path}: the folder {path.parent} cannot be made ({why}); give a file in a folder that you "
            "may write to"
        ) from error


@contextlib.contextmanager
def renamed(path: Path) -> Iterator[Path]:
    """Yield another name in the same folder; when the block ends, the file of that name is renamed to `path`.

    After an error it is removed: a file called `path` is whole and on the disk, and an earlier one stays. What is no
    file, as a pipe, is yielded itself.

    Raises:
        LogError: it cannot be renamed, or the disk does not take it.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    target = path.resolve()
    new = _beside(target)
    try:
        yield new
        try:
            _sync(new)
            os.replace(new, target)
        except OSError as error:
            raise LogError(
                f"cannot finish {path}: {error.strerror or error}; free space or give another file"
            ) from error
        with contextlib.suppress(OSError):
            # Not every system can sync a folder; the file itself exists, under one of the two names.
            _sync(target.parent)
    finally:
        with contextlib.suppress(OSError):
            new.unlink()


def _beside(target: Path) -> Path:
    """Return a name in the same folder that no other process takes, as several may write one file at once.

    What a killed writer of this file left there is removed.
    """
    begin, end = f".{target.stem}.{_processes()}.", f".part{target.suffix}"
    for left in target.parent.glob(f"{glob.escape(begin)}*{glob.escape(end)}"):
        process = left.name[len(begin) :].partition(".")[0]
        with contextlib.suppress(OSError):
            if process.isdecimal() and not _runs(int(process)):
                left.unlink()
    return target.with_name(f"{begin}{os.getpid()}.{secrets.token_hex(4)}{end}")


@functools.cache
def _processes() -> str:
    """Return what tells where a number names this process: one boot of a machine, and in it one set of processes.

    A folder may be shared by several machines, and containers. Where it cannot be known, each process is for itself.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text()
        where = f"{os.uname().nodename} {boot} {os.readlink('/proc/self/ns/pid')}"
    except (OSError, AttributeError):
        return secrets.token_hex(6)
    return hashlib.sha256(where.encode()).hexdigest()[:12]


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # of another user, or no number of a process
        pass
    return True


def open_new(path: Path) -> FileIO:
    """Open a new file called `path`, apart from one of that name that another process may still be writing.

    Raises:
        OSError: it cannot be written.
    """
    if path.is_file() or not path.exists():
        target = path.resolve()
        new = _beside(target)
        with contextlib.suppress(OSError):  # of a folder in which only this file may be written
            file = new.open("xb", buffering=0)
            try:
                os.replace(new, target)
                return file
            except OSError:
                file.close()
                new.unlink()
    return path.open("wb", buffering=0)


def _sync(path: Path) -> None:
    """Sync a file, or the names in a folder."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class OutputFile:
    """One new file, written front to back."""

    def __init__(self, path: Path, whole: Path | None = None) -> None:
        """Create `path` and the folders above it; `whole` is its name in the end, if it is removed after a failure.

        Raises:
            LogError: it cannot be written.
        """
        self._path = whole or path
        self._left = "nothing of it is kept" if whole else "what was written before stands and can be read"
        self._position = 0
        self._failure: LogError | None = None
        make_folder(path)
        try:
            self._file = open_new(path)
        except OSError as error:
            raise LogError(
                f"cannot write {self._path}: {error.strerror or error}; give a file you may write to"
            ) from error

    @classmethod
    @contextlib.contextmanager
    def whole(cls, path: Path) -> Iterator[OutputFile]:
        """Yield a file that is called `path` once the block has ended without an error, see `renamed`.

        Raises:
            LogError: it cannot be written.
        """
        make_folder(path)
        with renamed(path) as new, contextlib.closing(cls(new, path)) as file:
            yield file

    @property
    def closed(self) -> bool:
        """Whether nothing more can be written."""
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
                f"cannot go on writing {self._path}: {error.strerror or error}; {self._left}. Free space or give "
                "another file"
            )
            raise self._failure from error
        self._position += len(data)

    def cut(self, position: int) -> bool:
        """Cut the file at `position` and accept writes again; False if that is impossible (a pipe)."""
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
            if stat.S_ISREG(os.fstat(self._file.fileno()).st_mode):
                os.fsync(self._file.fileno())
            self._file.close()
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.close()
            raise LogError(f"cannot finish {self._path}: {error.strerror or error}; free space") from error


def require_other(target: str | os.PathLike[str], *inputs: str | os.PathLike[str]) -> None:
    """Refuse to overwrite an input: a file, one in the folder of a bag, or a folder around it.

    Raises:
        LogError: names the remedy.
    """
    there = Path(target)
    if not there.exists():
        return
    for given in map(Path, inputs):
        parts = [given, *given.iterdir()] if given.is_dir() else [given]
        same = any(part.exists() and part.samefile(there) for part in parts)
        if same or (there.is_dir() and given.resolve().is_relative_to(there.resolve())):
            raise LogError(f"cannot write {there}: it is, or holds, what is read ({given}); give another name")


def require_apart(targets: Iterable[str | os.PathLike[str]]) -> None:
    """Refuse two outputs on one path, however it is written, for one would replace the other.

    Raises:
        LogError: names them.
    """
    taken: dict[Path, str] = {}
    for target in map(str, targets):
        place = Path(target).resolve()
        if place in taken:
            names = target if taken[place] == target else f"{taken[place]} and {target}, which are one file,"
            raise LogError(f"found {names} more than once, expected a file of its own for each output; rename one")
        taken[place] = target


def is_log(path: str | os.PathLike[str]) -> bool:
    """Return whether a path where a scene is expected is that of a log: an MCAP file, an SQLite file or a folder."""
    return Path(path).suffix in (".mcap", ".db3") or Path(path).is_dir()


def foreign_files(folder: Path) -> list[str]:
    """Return the names of what is in a folder and no part of a bag of its name."""
    own = re.compile(rf"{re.escape(folder.name)}_\d+\.mcap|metadata\.yaml")
    return [name for name in sorted(each.name for each in folder.iterdir()) if not own.fullmatch(name)]


def hold(folder: Path) -> int:
    """Return a descriptor that holds a folder as long as it is open: no other process writes a bag there meanwhile.

    A kill closes it. Where a system cannot lock a folder, as over NFS, nothing is held.

    Raises:
        LogError: another one holds it.
    """
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise LogError(
            f"cannot write {folder}: another run still records into it, expected a folder for each; give another name, "
            "or end that run"
        ) from None
    except OSError:
        pass
    return descriptor


def move_aside(path: Path) -> Path | None:
    """Rename an earlier log, a file or the folder of a bag, to the next free number: run.mcap to run.1.mcap.

    Returns its new name; None if there is nothing to keep. A folder that is not a bag, or holds other files too, stays
    where it is.

    Raises:
        LogError: it cannot be renamed, or a run still records into it.
    """
    if path.is_dir():
        if foreign_files(path) or not any(path.glob("*.mcap")):
            return None
        os.close(hold(path))
        stem, suffix = path.name, ""
    elif path.is_file():
        stem, suffix = path.stem, path.suffix
    else:
        return None
    number = 1
    while (kept := path.with_name(f"{stem}.{number}{suffix}")).exists():
        number += 1
    try:
        return path.rename(kept)
    except OSError as error:
        raise LogError(
            f"cannot move {path}, an earlier log, to {kept.name}: {error.strerror or error}; give another name"
        ) from error
