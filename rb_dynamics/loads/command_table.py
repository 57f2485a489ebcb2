"""`CommandTable`: wrench commands of several channels as arrays, in the order in which they take effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from rb_dynamics.loads.wrench import HeldWrench, Wrench, held_of

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Numbers = npt.NDArray[np.float64]
    Whole = npt.NDArray[np.int64]

HELD = 12
"""Numbers of a held wrench: force and torque in body axes, force and torque in world axes."""


class CommandBatch(NamedTuple):
    """Commands as they came, in any order.

    Attributes:
        time_ns: (n,), when each is to take effect.
        channel: (n,), its number in the order of the scene.
        arrival: (n, 3), growing in the order in which those of one channel came, the first number first.
        wrench: (n, 6), force (N) and torque (N m), in the axes of the frame.
        frame: (n,), number of the frame in `frame_ids`.
        frame_ids: names.
        received: returns the command of a row.
    """

    time_ns: Whole
    channel: Whole
    arrival: Whole
    wrench: Numbers
    frame: Whole
    frame_ids: Sequence[str]
    received: Callable[[int], Wrench]

    @classmethod
    def of(cls, batches: Sequence[CommandBatch]) -> CommandBatch:
        """Return all commands of `batches`, by time, then channel, then arrival."""
        import numpy as np

        frame_ids = sorted({name for batch in batches for name in batch.frame_ids})
        frames = [np.array([frame_ids.index(name) for name in b.frame_ids], dtype=np.int64)[b.frame] for b in batches]
        time_ns = np.concatenate([batch.time_ns for batch in batches])
        channel = np.concatenate([batch.channel for batch in batches])
        arrival = np.concatenate([batch.arrival for batch in batches])
        wrench = np.concatenate([batch.wrench for batch in batches])
        order = np.lexsort((arrival, channel, time_ns))
        first = np.cumsum([0, *(len(batch.time_ns) for batch in batches)])

        def received(row: int) -> Wrench:
            at = int(order[row])
            k = int(first.searchsorted(at, side="right")) - 1
            return batches[k].received(at - int(first[k]))

        columns = time_ns[order], channel[order], arrival[order], wrench[order], np.concatenate(frames)[order]
        return cls(*columns, frame_ids, received)

    def part(self, first: int, last: int) -> CommandBatch:
        """Return the commands in the rows from `first` to `last`."""
        received = self.received
        return CommandBatch(
            self.time_ns[first:last],
            self.channel[first:last],
            self.arrival[first:last],
            self.wrench[first:last],
            self.frame[first:last],
            self.frame_ids,
            lambda row: received(first + row),
        )


class CommandTable(NamedTuple):
    """Commands that can be honoured as they are, by time, then channel, then as they came.

    Attributes:
        time_ns: (n,), when each takes effect.
        channel: (n,), its number in the order of the scene.
        held: (n, `HELD`), what it does while it is held, body axes.
        received: returns the command of a row.
    """

    time_ns: Whole
    channel: Whole
    held: Numbers
    received: Callable[[int], Wrench]

    @classmethod
    def empty(cls) -> CommandTable:
        """Return a table without commands."""
        import numpy as np

        none = np.empty(0, dtype=np.int64)
        return cls(none, none, np.empty((0, HELD)), lambda _: Wrench())

    def behind(self, row: int) -> CommandTable:
        """Return the commands from `row` on."""
        received = self.received
        return CommandTable(self.time_ns[row:], self.channel[row:], self.held[row:], lambda i: received(row + i))

    def until(self, row: int) -> CommandTable:
        """Return the commands before `row`."""
        return CommandTable(self.time_ns[:row], self.channel[:row], self.held[:row], self.received)

    def followed_by(self, other: CommandTable) -> CommandTable:
        """Return these and then those of `other`."""
        import numpy as np

        if not len(self.time_ns):
            return other
        count, first, second = len(self.time_ns), self.received, other.received
        return CommandTable(
            np.concatenate([self.time_ns, other.time_ns]),
            np.concatenate([self.channel, other.channel]),
            np.concatenate([self.held, other.held]),
            lambda i: first(i) if i < count else second(i - count),
        )

    def held_wrench(self, row: int) -> HeldWrench:
        """Return what the command of a row does."""
        return held_of(self.held[row].tolist())


class Timeline(NamedTuple):
    """When what all channels together hold changes, and to what.

    Attributes:
        time_ns: (k,), growing.
        held: (k, `HELD`), the sum over the channels from each time on, body axes.
    """

    time_ns: Whole
    held: Numbers

    def until(self, time_ns: int) -> Timeline:
        """Return the changes up to `time_ns`."""
        kept = self.time_ns <= time_ns
        return Timeline(self.time_ns[kept], self.held[kept])


class Holding(NamedTuple):
    """What a channel holds now: numbers as in `CommandTable.held`, and when it expires; None for never."""

    held: Sequence[float]
    expires_ns: int | None


def timeline(
    table: CommandTable, rows: slice, holding: Sequence[Holding], timeout_ns: Sequence[int], until_ns: int
) -> Timeline:
    """Return the changes up to `until_ns` that `rows` of `table` and the timeouts of the channels make.

    A command that comes at the very time of its channel's timeout wins over it; of several of one time the last does.
    """
    import numpy as np

    times, channels, held = table.time_ns[rows], table.channel[rows], table.held[rows]
    each = [
        _changes(times[channels == number], held[channels == number], now, timeout, until_ns)
        for number, (now, timeout) in enumerate(zip(holding, timeout_ns, strict=True))
    ]
    at = np.unique(np.concatenate([table.time_ns[:0], *(changes.time_ns for changes in each)]))
    total = np.zeros((len(at), HELD))
    for (now, _), changes in zip(holding, each, strict=True):
        rows_held = np.concatenate([np.array([now]), changes.held])
        total += rows_held[np.searchsorted(changes.time_ns, at, side="right")]
    return Timeline(at, total)


def _changes(times: Whole, held: Numbers, now: Holding, timeout_ns: int, until_ns: int) -> Timeline:
    """Return the changes of one channel."""
    import numpy as np

    last = np.append(times[1:] != times[:-1], True)[: len(times)]
    times, held = times[last], held[last]
    # Who expires, and whether the next command comes first.
    starts, drops = times, times + timeout_ns
    if not timeout_ns:
        drops = drops[:0]
    elif len(times):
        drops = drops[np.append(drops[:-1] < times[1:], True)]
    if now.expires_ns is not None and not (len(starts) and starts[0] <= now.expires_ns):
        drops = np.append(now.expires_ns, drops)
    at = np.concatenate([starts, drops])
    order = np.argsort(at, kind="stable")
    rows = np.concatenate([held, np.zeros((len(drops), HELD))])
    kept = at[order] <= until_ns
    return Timeline(at[order][kept], rows[order][kept])
