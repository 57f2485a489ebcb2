"""`transforms`: the messages of /tf by pair of frames, as if each pair had a topic of TransformStamped of its own."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.mcap_records import McapChannel, MessageBlock, Schema
from rb_dynamics.formats.message_types import TRANSFORM

_NUMBERS = 56
# Row of the block, the bytes of each message.
_Rows: TypeAlias = tuple[NDArray[np.intp], NDArray[np.uint8]]


class Transforms(NamedTuple):
    """The content of a block of TFMessage.

    Attributes:
        blocks: one for each pair of frames, on the topic "/tf world:base".
        damaged: rows of messages that are cut short or not CDR, ascending.
        error: what is wrong with one of them; None if `damaged` is empty.
    """

    blocks: list[MessageBlock]
    damaged: list[int]
    error: LogError | None


def transforms(block: MessageBlock) -> Transforms:
    """Return the transforms in a block of TFMessage.

    Messages of one publisher mostly differ in stamps and numbers alone, and are taken together.
    """
    found: dict[tuple[str, str], list[_Rows]] = {}
    damaged: list[int] = []
    wrong: LogError | None = None
    lengths = block.ends - block.begins
    for length in np.unique(lengths):
        left = np.flatnonzero(lengths == length)
        raw = block.data[block.begins[left][:, None] + np.arange(length)]
        while len(left):
            first = raw[0].tobytes()
            try:
                places = cdr.transform_places(first)
            except LogError as error:
                damaged.append(int(left[0]))
                wrong = wrong or error
                left, raw = left[1:], raw[1:]
                continue
            same = np.ones(length, dtype=bool)
            for stamp_at, _, _, at in places:
                same[stamp_at : stamp_at + 8] = same[at : at + _NUMBERS] = False
            alike = (raw[:, same] == raw[0, same]).all(axis=1)
            for stamp_at, frame, child, at in places:
                rows = _messages(raw[alike], stamp_at, frame, child, at, "<" if first[1] else ">")
                found.setdefault((frame, child), []).append((left[alike], rows))
            left, raw = left[~alike], raw[~alike]
    return Transforms([_block(block, *pair, parts) for pair, parts in found.items()], sorted(damaged), wrong)


def _messages(raw: NDArray[np.uint8], stamp_at: int, frame: str, child: str, at: int, order: str) -> NDArray[np.uint8]:
    """Return a message of TransformStamped for each row, little endian."""
    stamp = raw[:, stamp_at : stamp_at + 8].copy().view(order + "u4").astype("<u4").view(np.uint8)
    numbers = raw[:, at : at + _NUMBERS].copy().view(order + "u8").astype("<u8").view(np.uint8)
    head = np.array([0, 1, 0, 0], dtype=np.uint8)
    text = np.frombuffer(cdr.strings_after_stamp((frame, child)), np.uint8)
    parts = (np.tile(head, (len(raw), 1)), stamp, np.tile(text, (len(raw), 1)), numbers)
    return np.concatenate(parts, axis=1)


def _block(block: MessageBlock, frame: str, child: str, parts: list[_Rows]) -> MessageBlock:
    rows, messages = (np.concatenate(each) for each in zip(*parts, strict=True))
    order = np.argsort(rows, kind="stable")
    messages = messages[order]
    ends = messages.shape[1] * np.arange(1, len(messages) + 1)
    channel = McapChannel(f"{block.channel.topic} {frame}:{child}", Schema(TRANSFORM), "cdr", block.channel.metadata)
    return MessageBlock(channel, block.log_times[rows[order]], messages.ravel(), ends - messages.shape[1], ends)
