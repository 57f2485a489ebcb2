"""`RerunFile`: the file of a Rerun recording, written through a pipe: Rerun itself hangs where a disk is full."""

from __future__ import annotations

import fcntl
import os
import select
import termios
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rb_dynamics.formats.output_file import make_folder, open_new

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

_PART_BYTES = 2**16


class RerunFile:
    """A file to which a thread writes what a stream sends; after a failure it goes on taking, so that none waits."""

    def __init__(self, stream: rr.RecordingStream, path: Path, layout: rrb.Blueprint | None = None) -> None:
        """Create the file, and connect the stream to it.

        Raises:
            OSError: the file cannot be created.
        """
        make_folder(path)
        self._file = open_new(path)
        self._error: OSError | None = None
        self._taking = threading.Lock()
        self._pipe, end = os.pipe()
        self._thread = threading.Thread(target=self._copy, daemon=True)
        self._thread.start()
        try:
            stream.save(f"/dev/fd/{end}", default_blueprint=layout)
        finally:
            os.close(end)

    def check(self) -> None:
        """Wait until what the stream has flushed is in the file.

        Raises:
            OSError: it cannot be written.
        """
        while self._thread.is_alive() and any(fcntl.ioctl(self._pipe, termios.FIONREAD, bytes(4))):
            time.sleep(1e-4)
        with self._taking:
            if self._error is not None:
                raise self._error

    def close(self) -> None:
        """Wait until everything is in the file, of a stream that was disconnected.

        Raises:
            OSError: it cannot be written.
        """
        self._thread.join()
        os.close(self._pipe)
        if self._error is not None:
            raise self._error

    def _copy(self) -> None:
        ready = select.poll()
        ready.register(self._pipe, select.POLLIN)
        with self._file:
            part = b"begin"
            while part:
                ready.poll()
                with self._taking:
                    part = os.read(self._pipe, _PART_BYTES)
                    self._write(part)

    def _write(self, part: bytes) -> None:
        try:
            while part and self._error is None:
                part = part[self._file.write(part) :]
        except OSError as error:
            self._error = error
