"""The velocities in messages of `sensor_msgs/msg/JointState`, as arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.mcap_records import MessageBlock
from rb_dynamics.formats.message_types import JOINTS
from rb_dynamics.numerics.nanoseconds import NANOSECONDS

Times = NDArray[np.int64]
Values = NDArray[np.float64]


def velocities(block: MessageBlock, names: Sequence[str]) -> tuple[NDArray[np.bool_], Times, Values]:
    """Return which messages tell the velocities of all joints `names`, their stamps (ns), and rows of these (rad/s).

    Messages may list the joints in any order, and others beside them.
    """
    told, stamps, found = list[NDArray[np.bool_]](), list[Times](), list[Values]()
    for rows in block.rows():
        mine, times, speeds = (
            np.zeros(len(rows), bool),
            np.zeros(len(rows), np.int64),
            np.zeros((len(rows), len(names))),
        )
        left = np.arange(len(rows))
        while len(left):
            # Those that are like the next one but for their numbers; most logs have one kind.
            model = rows[left[0]].tobytes()
            numbers, wanted = _places(model, names)
            same = np.delete(np.arange(len(model)), [begin + k for begin in numbers for k in range(8)])
            alike = (rows[left][:, same] == np.frombuffer(model, np.uint8)[same]).all(axis=1)
            these, left = left[alike], left[~alike]
            if wanted:
                order = "<" if model[1] else ">"
                stamp, *parts = (np.ascontiguousarray(rows[these, at : at + 8]) for at in (numbers[0], *wanted))
                seconds, rest = stamp.view(f"{order}i4")[:, 0], stamp.view(f"{order}u4")[:, 1]
                times[these] = seconds.astype(np.int64) * NANOSECONDS + rest
                speeds[these] = np.hstack([part.view(f"{order}f8") for part in parts])
                mine[these] = True
        told.append(mine)
        stamps.append(times)
        found.append(speeds)
    whole = np.concatenate(told)
    return whole, np.concatenate(stamps)[whole], np.vstack(found)[whole]


def names_of(block: MessageBlock) -> list[str]:
    """Return the joints in the first message; none if it is damaged."""
    try:
        return [name for (name,) in cdr.decode(JOINTS, block.rows()[0][0].tobytes())[2]]
    except LogError:
        return []


def _places(message: bytes, names: Sequence[str]) -> tuple[list[int], list[int]]:
    """Return where numbers of 8 bytes are, the stamp first, and where the velocities of `names`; of a damaged one none.

    A message without them has none of the second kind.
    """
    try:
        _, _, joints, positions, speeds, _ = cdr.decode(JOINTS, message)
    except LogError:
        return [], []
    stamps, runs = cdr.places(JOINTS, message)
    listed = [name for (name,) in joints]
    if len(speeds) != len(listed) or any(listed.count(name) != 1 for name in names):
        return [*stamps, *runs], []
    return [*stamps, *runs], [runs[len(positions) + listed.index(name)] for name in names]
