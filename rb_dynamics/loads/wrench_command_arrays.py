"""`CommandTable`: wrench commands of several channels as arrays, in the order in which they take effect."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

from rb_dynamics.loads.wrench import HeldWrench, Wrench, all_with_floats, components, frame_name, held_of
from rb_dynamics.numerics.argument_checks import as_array, instance, vectors
from rb_dynamics.numerics.distinct import distinct
from rb_dynamics.numerics.vector import ZERO

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Numbers = npt.NDArray[np.float64]
    Whole = npt.NDArray[np.int64]

HELD = 12
"""Size of a held wrench: force and torque in body axes, force and torque in world axes."""


class Commands(Protocol):
    """Access to commands that were received together, by row."""

    def __call__(self, row: int) -> Wrench:
        """Return the command of a row."""

    def messages(self, rows: Whole) -> list[bytes | None]:
        """Return the messages in which these rows were recorded; None for one that is not from a log."""


def _taken(column: npt.NDArray[Any], rows: Whole | slice) -> npt.NDArray[Any]:
    """Return some rows of a column. `take` is faster than an index, if rows have several numbers."""
    return column[rows] if isinstance(rows, slice) else column.take(rows, axis=0)


class Received(NamedTuple):
    """Where to find the command of each row.

    Attributes:
        blocks: each returns the commands of its own rows.
        block: (n,), number of the block.
        row: (n,), row within the block.
    """

    blocks: tuple[Commands, ...]
    block: Whole
    row: Whole

    def __call__(self, i: int) -> Wrench:
        """Return the command of row i."""
        return self.blocks[int(self.block[i])](int(self.row[i]))

    def messages(self) -> list[bytes | None]:
        """Return the message of each row, see `Commands`."""
        found: list[bytes | None] = [None] * len(self.row)
        for number, block in enumerate(self.blocks):
            rows = (self.block == number).nonzero()[0]
            for row, message in zip(rows.tolist(), block.messages(self.row[rows]), strict=True):
                found[row] = message
        return found

    def some(self, rows: Whole | slice) -> Received:
        """Return this for some rows only."""
        return Received(self.blocks, _taken(self.block, rows), _taken(self.row, rows))

    @classmethod
    def joined(cls, parts: Sequence[Received]) -> Received:
        """Return `parts` joined, without blocks that no row needs."""
        import numpy as np

        blocks: list[Commands] = []
        numbers = []
        for part in parts:
            if len(part.blocks) == 1 and len(part.row):
                numbers.append(part.block + len(blocks))
                blocks += part.blocks
                continue
            used = distinct(part.block)
            numbers.append(used.searchsorted(part.block) + len(blocks))
            blocks += (part.blocks[k] for k in used.tolist())
        return cls(tuple(blocks), np.concatenate(numbers), np.concatenate([part.row for part in parts]))


class CommandBatch(NamedTuple):
    """Commands as received, in any order.

    Attributes:
        time_ns: (n,), when each is to take effect.
        stamp_ns: (n,), its stamp.
        channel: (n,), its number in the order of the scene.
        arrival: (n, 3), increasing lexicographically in the order of arrival within a channel.
        wrench: (n, 6), force (N) and torque (N m), in the axes of the frame.
        frame: (n,), number of the frame in `frame_ids`.
        frame_ids: names.
        received: the commands themselves.
    """

    time_ns: Whole
    stamp_ns: Whole
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

        together = cls.joined(batches)
        return together.some(np.lexsort((*together.arrival.T[::-1], together.time_ns)))

    @classmethod
    def joined(cls, batches: Sequence[CommandBatch]) -> CommandBatch:
        """Return all commands of `batches`, one batch after the other."""
        import numpy as np

        number = {name: k for k, name in enumerate(sorted({name for batch in batches for name in batch.frame_ids}))}
        frames = [np.array([number[name] for name in b.frame_ids], dtype=np.int64)[b.frame] for b in batches]
        columns: list[Any] = [np.concatenate(parts) for parts in zip(*(batch[:5] for batch in batches), strict=True)]
        columns += np.concatenate(frames), list(number), Received.joined([batch.received for batch in batches])
        return cls(*columns)

    @classmethod
    def empty(cls) -> CommandBatch:
        """Return a batch without commands."""
        import numpy as np

        none, nothing = np.empty(0, dtype=np.int64), Received((), np.empty(0, np.int64), np.empty(0, np.int64))
        return cls(none, none, none, np.empty((0, 3), np.int64), np.empty((0, 6)), none, [], nothing)

    def some(self, rows: Whole | slice) -> CommandBatch:
        """Return the commands in some rows."""
        columns: list[Any] = [_taken(column, rows) for column in self[:6]]
        return CommandBatch(*[*columns, self.frame_ids, self.received.some(rows)])


@dataclass(frozen=True, eq=False)
class Wrenches:
    """Commands on one channel as arrays: n times `Wrench`.

    Attributes:
        force: (n, 3) or (3,) for all, N, in the axes of `frame_id`.
        torque: (n, 3) or (3,) for all, N m, in the axes of `frame_id`.
        frame_id: as in `Wrench`.
        stamp_ns: (n,), integer nanoseconds.
    """

    force: npt.ArrayLike = ZERO
    torque: npt.ArrayLike = ZERO
    frame_id: str = ""
    stamp_ns: npt.ArrayLike = (0,)

    def __post_init__(self) -> None:
        """Copy the arguments; invalid numbers are rejected only when the command would take effect.

        Raises:
            TypeError: an array is not one of numbers, a stamp is not a whole number, or frame_id is not text.
            ValueError: a shape is not as above.
        """
        import numpy as np

        name = instance(self.frame_id, str, "wrenches frame_id", "write the name of a frame")
        object.__setattr__(self, "frame_id", frame_name(name))
        times = as_array(self.stamp_ns, "wrenches stamp_ns", "whole numbers (n,)", None)
        if times.ndim != 1 or times.dtype.kind != "i":
            raise TypeError(
                f"wrenches stamp_ns has shape {times.shape} and type {times.dtype}, expected whole numbers (n,); give "
                "nanoseconds"
            )
        object.__setattr__(self, "stamp_ns", times.astype(np.int64))
        for name in ("force", "torque"):
            given = vectors(getattr(self, name), f"wrenches {name}")
            if given.shape not in ((3,), (len(times), 3)):
                raise ValueError(f"wrenches {name} has shape {given.shape}, expected ({len(times)}, 3) or (3,)")
            object.__setattr__(self, name, np.broadcast_to(given, (len(times), 3)).copy())

    def __call__(self, row: int) -> Wrench:
        """Return one of them."""
        force, torque, times = self._columns
        (fx, fy, fz), (tx, ty, tz) = force[row].tolist(), torque[row].tolist()
        return Wrench((fx, fy, fz), (tx, ty, tz), self.frame_id, int(times[row]))

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._columns[2])

    def __iter__(self) -> Iterator[Wrench]:
        """Yield them one by one."""
        return map(self, range(len(self)))

    def messages(self, rows: Whole) -> list[bytes | None]:
        """Return None for each row: see `Commands`."""
        return [None] * len(rows)

    @property
    def _columns(self) -> tuple[Numbers, Numbers, Whole]:
        return cast("tuple[Numbers, Numbers, Whole]", (self.force, self.torque, self.stamp_ns))

    def batch(self, channel: int, place: int = 0) -> CommandBatch:
        """Return them as commands on a channel, which arrive after those of a lower `place`."""
        import numpy as np

        force, torque, times = self._columns
        rows = np.arange(len(times))
        none, arrival = np.zeros_like(rows), np.zeros((len(rows), 3), dtype=np.int64)
        arrival[:, 0], arrival[:, 2] = place, rows
        wrench, received = np.hstack([force, torque]), Received((self,), none, rows)
        return CommandBatch(times, times, none + channel, arrival, wrench, none, [self.frame_id], received)


class _Listed(NamedTuple):
    wrenches: Sequence[Wrench]

    def __call__(self, row: int) -> Wrench:
        return self.wrenches[row]

    def messages(self, rows: Whole) -> list[bytes | None]:
        return [self.wrenches[row].message for row in rows.tolist()]


def listed(channels: Sequence[int], wrenches: Sequence[Wrench]) -> CommandBatch:
    """Return commands (numbers of their channels, wrenches) in the order in which they arrived."""
    import numpy as np

    wrenches = all_with_floats(wrenches)
    rows, names = np.arange(len(wrenches)), sorted({*map(attrgetter("frame_id"), wrenches)})
    numbers = {name: number for number, name in enumerate(names)}
    frames = map(numbers.__getitem__, map(attrgetter("frame_id"), wrenches))
    stamps = [*map(attrgetter("stamp_ns"), wrenches)]
    try:
        stamps_ns = np.array(stamps, dtype=np.int64)
    except OverflowError:
        # Before or after any run.
        stamps_ns = np.array([min(max(stamp, -(2**62)), 2**62) for stamp in stamps], dtype=np.int64)
    return CommandBatch(
        stamps_ns,
        stamps_ns,
        np.array(channels, dtype=np.int64),
        np.column_stack([0 * rows, 0 * rows, rows]),
        np.fromiter(components(wrenches), dtype=np.float64, count=6 * len(wrenches)).reshape(-1, 6),
        np.fromiter(frames, dtype=np.int64, count=len(wrenches)),
        names,
        Received((_Listed(wrenches),), np.zeros_like(rows), rows),
    )


class CommandTable(NamedTuple):
    """Commands that take effect unchanged.

    Attributes:
        came: the commands as received, by time, then arrival.
        held: (n, `HELD`), the held wrench of each command, body axes.
    """

    came: CommandBatch
    held: Numbers

    @property
    def time_ns(self) -> Whole:
        """(n,), when each takes effect."""
        return self.came.time_ns

    @property
    def channel(self) -> Whole:
        """(n,), its number in the order of the scene."""
        return self.came.channel

    @property
    def received(self) -> Received:
        """The commands themselves."""
        return self.came.received

    def before(self, row: int) -> CommandTable:
        """Return the commands before `row`."""
        return CommandTable(self.came.some(slice(row)), self.held[:row])

    @classmethod
    def empty(cls) -> CommandTable:
        """Return a table without commands."""
        import numpy as np

        return cls(CommandBatch.empty(), np.empty((0, HELD)))

    def followed_by(self, other: CommandTable, row: int) -> CommandTable:
        """Return the commands from `row` on, and then those of `other`."""
        import numpy as np

        if row == len(self.time_ns):
            return other
        rest = slice(row, None)
        came = CommandBatch.joined([self.came.some(rest), other.came])
        return CommandTable(came, np.concatenate([self.held[rest], other.held]))

    def held_wrench(self, row: int) -> HeldWrench:
        """Return the held wrench of the command of a row."""
        return held_of(self.held[row].tolist())


class Timeline(NamedTuple):
    """Changes of the sum of the held wrenches of all channels.

    Attributes:
        time_ns: (k,), increasing.
        held: (k, `HELD`), the sum over the channels from each time on, body axes.
    """

    time_ns: Whole
    held: Numbers

    def until(self, time_ns: int) -> Timeline:
        """Return the changes up to `time_ns`."""
        kept = slice(self.time_ns.searchsorted(time_ns, side="right"))
        return Timeline(self.time_ns[kept], self.held[kept])


class Changes(NamedTuple):
    """Changes of the channels of a run, in the order in which sinks receive them.

    Attributes:
        time_ns: (n,).
        channel: (n,), its number in the order of the scene.
        row: (n,), of the command in `came`; -1 where a timeout dropped the channel to zero.
        wrench: (n, 6), force and torque as they act, in body or world axes.
        in_world: (n,), whether in world axes.
        came: commands.
        topics: of all channels.
        frames: names of body and world frame.
    """

    time_ns: Whole
    channel: Whole
    row: Whole
    wrench: Numbers
    in_world: npt.NDArray[np.bool_]
    came: CommandBatch
    topics: Sequence[str]
    frames: tuple[str, str]


class Holding(NamedTuple):
    """The wrench that a channel holds now, as in `CommandTable.held`, and when it expires; None for never."""

    held: Sequence[float]
    expires_ns: int | None


def timeline(
    table: CommandTable, rows: slice, holding: Sequence[Holding], timeout_ns: Sequence[int], until_ns: int
) -> Timeline:
    """Return the changes up to `until_ns` that `rows` of `table` and the timeouts of the channels make.

    A command exactly at the time of its channel's timeout takes precedence over it; of several at one time, the last
    counts.
    """
    import numpy as np

    times, channels, held = table.time_ns[rows], table.channel[rows], table.held[rows]
    each = [(channels == number).nonzero()[0] for number in range(len(holding))]
    timeouts = zip(each, holding, timeout_ns, strict=True)
    drops = [_drops(times[mine], now, timeout, until_ns) for mine, now, timeout in timeouts]
    at = distinct(np.concatenate([times, *drops]))
    total = np.zeros((len(at), HELD))
    for mine, (now, _), dropped in zip(each, holding, drops, strict=True):
        came = times[mine].searchsorted(at, side="right")
        first = came.searchsorted(1)
        acting = np.empty_like(total)
        acting[:first], acting[first:] = now, held.take(mine[came[first:] - 1], axis=0)
        if len(dropped):
            last = np.append(at[:1] - 1, times[mine])[came]
            gone = dropped.searchsorted(at, side="right")
            acting[(gone > 0) & (dropped[gone - 1] > last)] = 0.0
        total += acting
    return Timeline(at, total)


def changes(
    table: CommandTable,
    rows: slice,
    holding: Sequence[Holding],
    timeout_ns: Sequence[int],
    until_ns: int,
    topics: Sequence[str],
    frames: tuple[str, str],
) -> Changes:
    """Return the changes by `rows` of `table` and the timeouts of the channels up to `until_ns`, see `timeline`."""
    import numpy as np

    came, held = table.came.some(rows), table.held[rows]
    drops = [
        _drops(came.time_ns[came.channel == number], now, timeout, until_ns)
        for number, (now, timeout) in enumerate(zip(holding, timeout_ns, strict=True))
    ]
    dropped = np.concatenate([came.time_ns[:0], *drops])
    numbers = np.repeat(np.arange(len(drops)), [len(each) for each in drops])
    time_ns, channel = np.concatenate([dropped, came.time_ns]), np.concatenate([numbers, came.channel])
    row = np.concatenate([np.full(len(dropped), -1), np.arange(len(came.time_ns))])
    # At one time timeouts come first; then the channels in the order of the scene, each with its commands by arrival.
    order = np.lexsort((row, channel, row >= 0, time_ns))
    in_world = np.isin(came.frame, [k for k, name in enumerate(came.frame_ids) if name == frames[1]])
    wrench = np.where(in_world[:, None], held[:, 6:], held[:, :6])
    wrench = np.concatenate([np.zeros((len(dropped), 6)), wrench])
    in_world = np.concatenate([np.zeros(len(dropped), dtype=bool), in_world])
    return Changes(time_ns[order], channel[order], row[order], wrench[order], in_world[order], came, topics, frames)


def _drops(times: Whole, now: Holding, timeout_ns: int, until_ns: int) -> Whole:
    """Return when a channel with commands at `times` times out: never if the next command comes by then."""
    import numpy as np

    drops = times + timeout_ns
    drops = drops[np.append(drops[:-1] < times[1:], True)[: len(times)]] if timeout_ns else drops[:0]
    if now.expires_ns is not None and not (len(times) and times[0] <= now.expires_ns):
        drops = np.append(now.expires_ns, drops)
    return drops[drops <= until_ns]
