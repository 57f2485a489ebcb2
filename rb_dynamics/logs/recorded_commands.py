"""`commands_of`: the commands in a block of messages as arrays, and each as it was recorded on demand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.formats.mcap_records import MessageBlock
from rb_dynamics.formats.message_types import WRENCH
from rb_dynamics.formats.topic_messages import Times, Topic
from rb_dynamics.loads.wrench import Wrench, frame_name
from rb_dynamics.loads.wrench_command_arrays import CommandBatch, Received


def commands_of(
    topic: Topic, block: MessageBlock, channel: int, time_ns: Times, stamp_ns: Times, arrival: Times
) -> CommandBatch:
    """Return the commands of a block, the only one of `topic`.

    Args:
        topic: of wrenches.
        block: its messages.
        channel: number of their channel in the order of the scene.
        time_ns: (n,), when each is to take effect.
        stamp_ns: (n,), the stamp that each has in the run.
        arrival: (n, 3), see `CommandBatch`.

    Raises:
        LogError: a message is cut short or not CDR.
    """
    wrench, texts, rows = topic.numbers, topic.texts, np.arange(topic.count)
    frame_ids = [frame_name(text[0]) if text else "" for _, text in texts]
    frame = np.searchsorted([row for row, _ in texts], rows, side="right") - 1
    stamps = topic.stamps if topic.type_name == WRENCH else None
    received = Received((_Commands(block, wrench, frame_ids, frame, stamp_ns, stamps),), np.zeros_like(rows), rows)
    columns = time_ns, stamp_ns, np.full(topic.count, channel), arrival, wrench, frame, frame_ids
    return CommandBatch(*columns, received)


class _Commands(NamedTuple):
    """The commands of a block with the stamps (ns) that they have in a run; `stamps` is None if they have no header."""

    block: MessageBlock
    wrench: NDArray[np.float64]
    frame_ids: Sequence[str]
    frame: NDArray[np.int64]
    stamp_ns: Times
    stamps: Times | None

    def __call__(self, row: int) -> Wrench:
        fx, fy, fz, tx, ty, tz = self.wrench[row].tolist()
        frame_id = self.frame_ids[int(self.frame[row])]
        command = Wrench((fx, fy, fz), (tx, ty, tz), frame_id, int(self.stamp_ns[row]))
        # Where its stamp in the run is another, a message of its own has that.
        if self.stamps is not None and self.stamp_ns[row] == self.stamps[row]:
            data = self.block.data[self.block.begins[row] : self.block.ends[row]].tobytes()
            object.__setattr__(command, "message", data)
        return command

    def messages(self, rows: Times) -> list[bytes | None]:
        if self.stamps is None:
            return [None] * len(rows)
        # Where its stamp in the run is another, a message of its own has that.
        stands = (self.stamp_ns[rows] == self.stamps[rows]).tolist()
        begins, ends = self.block.begins[rows], self.block.ends[rows]
        first = int(begins.min(initial=len(self.block.data)))
        data = self.block.data[first : int(ends.max(initial=0))].tobytes()
        places = zip(stands, (begins - first).tolist(), (ends - first).tolist(), strict=True)
        return [data[begin:end] if stand else None for stand, begin, end in places]
