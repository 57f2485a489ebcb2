"""`GuardedSink`: a sink whose failure stops it, but not the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from rb_dynamics.errors import LogError
from rb_dynamics.run.event_arrays import EventArrays
from rb_dynamics.run.sink import Event, RunInfo, Sink


class GuardedSink:
    """Passes everything to a sink until that raises a `LogError`, which it keeps as `error` and reports once."""

    def __init__(
        self,
        sink: Sink,
        on_error: Callable[[LogError], None],
        guard_open: bool = True,
        before_open: Callable[[], None] | None = None,
    ) -> None:
        """Guard `sink`; `on_error` is called with the failure that stops it.

        `guard_open=False` lets a sink that cannot even be opened stop the run, which has not begun. `before_open` makes
        room for it, when the sinks of an earlier run are closed, and is guarded with it.
        """
        self._sink, self._on_error, self._guard_open, self._before_open = sink, on_error, guard_open, before_open
        self.error: LogError | None = None

    def open(self, run: RunInfo) -> None:
        """Open the sink."""
        if self._guard_open:
            self._try(lambda: self._open(run))
        else:
            self._open(run)

    def write(self, event: Event) -> None:
        """Pass one event on."""
        if self.error is None:
            self._try(lambda: self._sink.write(event))

    @property
    def write_block(self) -> Callable[[EventArrays], None] | None:
        """Pass many events on, if the sink takes many at once."""
        write_block: Callable[[EventArrays], None] | None = getattr(self._sink, "write_block", None)
        if write_block is None:
            return None
        taken = write_block
        return lambda block: self._try(lambda: taken(block)) if self.error is None else None

    def close(self, result: Mapping[str, str]) -> None:
        """Close the sink even after a failure, so that what was written is finished as far as it can be."""
        self._try(lambda: self._sink.close(result))

    def _open(self, run: RunInfo) -> None:
        if self._before_open is not None:
            self._before_open()
        self._sink.open(run)

    def _try(self, call: Callable[[], None]) -> None:
        try:
            call()
        except LogError as error:
            if self.error is None:
                self.error = error
                self._on_error(error)
