"""`Topic`: the values kept of each message are independent of block sizes, and memory is bounded."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bag_rows import add

from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.channel_metadata import log_channel
from rb_dynamics.formats.mcap_records import McapChannel, Message, Schema, in_blocks
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.message_types import ODOMETRY, PLAIN_WRENCH, TWIST
from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.formats.topic_messages import Topic

COVARIANCE = (9.0,) * 36
COUNT = 2500  # more than two batches


def odometry(k: int, stamp_ns: int, frame: str = "map") -> bytes:
    pose, twist = [k + 0.1 * i for i in range(7)], [-k - 0.1 * i for i in range(6)]
    return cdr.encode(ODOMETRY, stamp_ns, frame, "base", pose, COVARIANCE, twist, COVARIANCE)


@pytest.mark.parametrize("late_from", [0, 1, 1024, 2000, COUNT])
def test_stamps_and_numbers_are_those_of_the_messages(late_from: int) -> None:
    """Stamps that equal the log times up to some message, and differ from then on."""
    topic = Topic("/odom", ODOMETRY)
    stamps = [10 * k - (k >= late_from) for k in range(COUNT)]
    for k, stamp_ns in enumerate(stamps):
        add(topic, 10 * k, odometry(k, stamp_ns, "map" if k % 2000 else "world"))
    assert topic.stamps.tolist() == stamps
    assert topic.numbers[:, 0].tolist() == [float(k) for k in range(COUNT)]
    assert topic.numbers[:, 7].tolist() == [-float(k) for k in range(COUNT)]
    assert topic.numbers.shape == (COUNT, 13)
    assert topic.texts == [
        (0, ("world", "base")), (1, ("map", "base")), (2000, ("world", "base")), (2001, ("map", "base")),
    ]  # fmt: skip


def test_strings_that_change_within_a_block_or_between_blocks_are_kept() -> None:
    """Of one length: what the messages before had in common is not taken for granted."""
    topic = Topic("/odom", ODOMETRY)
    channel = McapChannel("/odom", Schema(ODOMETRY), "cdr", {})
    frames = [*("map",) * 1500, *("odo",) * 1500, *("map", "odo") * 500]
    rows = [Message(channel, k, k, odometry(k, k, frame)) for k, frame in enumerate(frames)]
    for first in range(0, len(rows), 750):
        for block in in_blocks(rows[first : first + 750]):
            topic.take(block)
    changes = [(0, "map"), (1500, "odo"), *((k, frames[k]) for k in range(3000, 4000))]
    assert topic.texts == [(row, (frame, "base")) for row, frame in changes]
    assert topic.numbers[:, 0].tolist() == [float(k) for k in range(len(frames))]


def test_a_type_without_header_has_its_log_times() -> None:
    topic = Topic("/w", PLAIN_WRENCH)
    for k in range(3):
        add(topic, k, cdr.encode(PLAIN_WRENCH, (k, 0, 0, 0, 0, 0)))
    assert topic.stamps.tolist() == [0, 1, 2]
    assert topic.numbers[:, 0].tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize("bad", [0, 1500])
def test_a_damaged_message_is_no_error_until_the_topic_is_looked_at(bad: int) -> None:
    topic = Topic("/twist", TWIST)
    for k in range(COUNT):
        data = cdr.encode(TWIST, k, "body", (0.0,) * 6)
        add(topic, k, data[:-1] if k == bad else data)
    assert topic.count == COUNT
    for _ in range(2):
        with pytest.raises(LogError, match="before its last field"):
            _ = topic.numbers


@pytest.mark.parametrize("bad", [0, 700, 2400])
def test_a_topic_that_bears_damage_counts_it(bad: int) -> None:
    topic = Topic("/twist", TWIST, bears=True)
    for k in range(COUNT):
        data = cdr.encode(TWIST, k - 5, "body", (float(k),) * 6)
        add(topic, k, {bad: data[:-1], bad + 1: b"", bad + 2: data[:12] + b"\xff" * 4 + data[16:]}.get(k, data))
    rows = [bad, bad + 1, bad + 2]
    assert np.isnan(topic.numbers).all(axis=1).nonzero()[0].tolist() == topic.damaged == rows
    assert topic.stamps.tolist() == [k if k in rows else k - 5 for k in range(COUNT)]
    assert {text for _, text in topic.texts} == {("body",)}
    assert topic.only(np.arange(COUNT) >= bad + 1).damaged == [0, 1]


def test_a_topic_of_which_nothing_can_be_read_is_an_error() -> None:
    topic = Topic("/twist", TWIST, bears=True)
    for k in range(3):
        add(topic, k, b"\0\1\0\0damaged")
    with pytest.raises(LogError, match=r"topic /twist: .* message ends after 11 bytes"):
        _ = topic.numbers


def test_a_large_bag_takes_little_more_memory_than_its_numbers(tmp_path: Path) -> None:
    """40 000 Odometry, 30 MB: without their covariances 5 MB, and no Python object for each."""
    if not Path("/proc/self/status").exists():
        pytest.skip("peaks of memory are read from /proc")
    path = tmp_path / "odom.mcap"
    numbers = np.random.default_rng(5).standard_normal((40_000, 85))
    file = OutputFile(path)
    writer = McapWriter(file, "test")
    writer.begin()
    channel = writer.add_channel(log_channel("/odom", ODOMETRY, ""))
    for k, row in enumerate(numbers):
        fields = np.split(row, (7, 43, 49))
        writer.add_messages((channel,), (cdr.encode(ODOMETRY, k, "map", "base", *fields),), k, k)
    writer.finish()
    file.close()
    code = f"""
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.analysis.read_track import read_track
def peak_mb():
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM")) / 1024
before = peak_mb()
track = read_track(read_bag({str(path)!r}))
assert len(track.pose.values) == 40_000
print(peak_mb() - before)
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert path.stat().st_size > 25e6
    assert float(found.stdout) < 20.0
