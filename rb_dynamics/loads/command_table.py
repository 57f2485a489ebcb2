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


class Received(NamedTuple):
    """Where the commands of rows are found.

    Attributes:
        blocks: each returns the command of one of its own rows.
        block: (n,), which of them has it.
        row: (n,), where.
    """

    blocks: tuple[Callable[[int], Wrench], ...]
    block: Whole
    row: Whole

    def __call__(self, i: int) -> Wrench:
        """Return the command of row i."""
        return self.blocks[int(self.block[i])](int(self.row[i]))

    def some(self, rows: Whole | slice) -> Received:
        """Return the same for some rows."""
        return Received(self.blocks, self.block[rows], self.row[rows])

    @classmethod
    def joined(cls, parts: Sequence[Received]) -> Received:
        """Return one for all rows, without blocks that none of them needs."""
        import numpy as np

        blocks: list[Callable[[int], Wrench]] = []
        numbers = []
        for part in parts:
            used, where = np.unique(part.block, return_inverse=True)
            numbers.append(where + len(blocks))
            blocks += (part.blocks[k] for k in used.tolist())
        return cls(tuple(blocks), np.concatenate(numbers), np.concatenate([part.row for part in parts]))


class CommandBatch(NamedTuple):
    """Commands as they came, in any order.

    Attributes:
        time_ns: (n,), when each is to take effect.
        channel: (n,), its number in the order of the scene.
        arrival: (n, 3), growing in the order in which those of one channel came: the first column counts most.
        wrench: (n, 6), force (N) and torque (N m), in the axes of the frame.
        frame: (n,), number of the frame in `frame_ids`.
        frame_ids: names.
        received: the commands themselves.
    """

    time_ns: Whole
    channel: Whole
    arrival: Whole
    wrench: Numbers
    frame: Whole
    frame_ids: Sequence[str]
    received: Received

    @classmethod
    def of(cls, batches: Sequence[CommandBatch]) -> CommandBatch:
        """Return all commands of `batches`, by time, then arrival."""
        import numpy as np

        number = {name: k for k, name in enumerate(sorted({name for batch in batches for name in batch.frame_ids}))}
        frames = [np.array([number[name] for name in b.frame_ids], dtype=np.int64)[b.frame] for b in batches]
        time_ns = np.concatenate([batch.time_ns for batch in batches])
        channel = np.concatenate([batch.channel for batch in batches])
        arrival = np.concatenate([batch.arrival for batch in batches])
        wrench = np.concatenate([batch.wrench for batch in batches])
        received = Received.joined([batch.received for batch in batches])
        together = cls(time_ns, channel, arrival, wrench, np.concatenate(frames), list(number), received)
        return together.some(np.lexsort((*arrival.T[::-1], time_ns)))

    def some(self, rows: Whole | slice) -> CommandBatch:
        """Return the commands in some rows."""
        return CommandBatch(
            self.time_ns[rows],
            self.channel[rows],
            self.arrival[rows],
            self.wrench[rows],
            self.frame[rows],
            self.frame_ids,
            self.received.some(rows),
        )


class CommandTable(NamedTuple):
    """Commands that act as they are, by time, then as they came.

    Attributes:
        time_ns: (n,), when each takes effect.
        channel: (n,), its number in the order of the scene.
        held: (n, `HELD`), what it does while it is held, body axes.
        received: the commands themselves.
    """

    time_ns: Whole
    channel: Whole
    held: Numbers
    received: Received

    @classmethod
    def empty(cls) -> CommandTable:
        """Return a table without commands."""
        import numpy as np

        none = np.empty(0, dtype=np.int64)
        return cls(none, none, np.empty((0, HELD)), Received((), none, none))

    def followed_by(self, other: CommandTable, row: int) -> CommandTable:
        """Return the commands from `row` on, and then those of `other`."""
        import numpy as np

        return CommandTable(
            np.concatenate([self.time_ns[row:], other.time_ns]),
            np.concatenate([self.channel[row:], other.channel]),
            np.concatenate([self.held[row:], other.held]),
            Received.joined([self.received.some(slice(row, None)), other.received]),
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
