"""Drift, steps and offsets between stamps and log times are reported; transport delay is not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bag_rows import add
from tumbling import TWIST, bag_of, fill, in_world, spin, summary_of

from rb_dynamics.analysis.clocks import leaps, remarks
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.formats import cdr
from rb_dynamics.formats.topic_messages import Topic

SECOND = 1_000_000_000
PLAIN = "geometry_msgs/msg/Wrench"
COUNT = 1000


def later(seconds: Any) -> Any:
    return np.rint(np.broadcast_to(seconds, COUNT) * 1e9).astype(np.int64)


def test_a_clock_that_drifts_is_told() -> None:
    told = remarks(read_track(bag_of(spin(), logged_later_ns=later(0.05 * np.arange(COUNT) * 0.01))))
    assert any("/b/pose drift against its stamps, by 0.4" in each and "(5 %)" in each for each in told)


def test_a_clock_that_was_set_is_told_with_time_and_size() -> None:
    told = remarks(read_track(bag_of(spin(), logged_later_ns=later(np.where(np.arange(COUNT) < 600, 0.01, 3.21)))))
    assert any("/b/twist do not run alike" in each and "+3.2 s at once at t = 5.99 s" in each for each in told)


@pytest.mark.parametrize("by_s", [2.0, 60.0])
def test_a_clock_that_was_set_forward_leaves_a_hole_and_does_not_drift(by_s: float) -> None:
    """A line leads over a hole that is as long as the leap: it was called a drift of 85 %."""
    leapt = (np.arange(COUNT) >= 600) * round(by_s * SECOND)
    motion = replace(spin(), time_ns=spin().time_ns + leapt)
    track = read_track(bag_of(motion, logged_later_ns=10_000_000 - leapt))
    assert any(f"by {-by_s:+.3g} s at once at t = 5.99 s" in each for each in remarks(track))
    ((at, by),) = leaps(track.bag.topics["/b/pose"])
    assert at == spin().time_ns[599]
    assert by == pytest.approx(by_s, rel=1e-6)


def test_messages_that_wait_or_are_lost_are_no_leap_of_a_clock() -> None:
    """A queue that is full drops what comes then, and is emptied at once."""
    times = spin().time_ns
    kept = np.delete(np.arange(COUNT), slice(500, 700))
    waiting = np.where((kept >= 300) & (kept < 700), times[700] - times[kept], 0)
    motion = spin().taken(kept)
    for later_ns in (waiting, 0 * waiting):
        track = read_track(bag_of(motion, logged_later_ns=later_ns + 10_000_000))
        assert leaps(track.bag.topics["/b/pose"]) == []


@pytest.mark.parametrize("apart_s", [0.0, 1.7e9])
def test_the_longest_gap_is_placed_in_the_time_of_the_motion(apart_s: float) -> None:
    """Whatever the clock of the log times: that of a simulation may begin at 0, and the log in 1970."""
    logged = later(apart_s + np.where(np.arange(COUNT) < 600, 0.0, 0.5))
    summary = summary_of(bag_of(spin(), logged_later_ns=logged))
    (pose,) = (topic for topic in summary.topics if topic.use == "pose")
    assert pose.longest_at_s == pytest.approx(5.99, abs=0.02)


@pytest.mark.parametrize("seed", range(5))
def test_what_messages_take_to_come_is_no_drift(seed: int) -> None:
    random = np.random.default_rng(seed)
    under_way = random.exponential(10 ** random.uniform(-4.0, -1.0), COUNT) + 0.02
    under_way[random.integers(0, COUNT, 5)] += 0.5
    assert not remarks(read_track(bag_of(spin(), logged_later_ns=later(under_way) + 1_700_000_000 * SECOND)))


def test_topics_by_two_clocks_are_told() -> None:
    bag = bag_of(spin(), with_twist=False)
    bag.topics["/b/twist"] = Topic("/b/twist", TWIST)
    fill(bag.topics["/b/twist"], spin().time_ns, "world", in_world(spin()), 7 * SECOND)
    assert any(each.startswith("/b/twist is stamped 7 s behind /b/pose") for each in summary_of(bag).warnings)


def test_messages_that_wait_to_be_logged_are_of_no_other_clock() -> None:
    """Of a topic that is recorded in bursts, half of all waited for more than a second."""
    every = 3 * SECOND
    bag = bag_of(spin(), logged_later_ns=every - spin().time_ns % every, wrench=True)
    assert not any("by another clock" in each for each in summary_of(bag).warnings)


def test_a_wrench_on_log_time_is_put_to_the_stamps_of_the_pose() -> None:
    bag = bag_of(spin(), logged_later_ns=1_700_000_000 * SECOND)
    bag.topics["/w"] = Topic("/w", PLAIN)
    add(bag.topics["/w"], 1_700_000_004 * SECOND, cdr.encode(PLAIN, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    track = read_track(bag)
    assert track.wrenches[0].time_ns.tolist() == [4 * SECOND]
    assert any("/w has no stamps" in note and "put 1.7e+09 s earlier" in note for note in track.notes)


def test_a_pose_without_stamps_is_put_to_those_of_the_twist() -> None:
    motion = spin()
    bag = bag_of(motion, logged_later_ns=1_700_000_000 * SECOND)
    plain = bag_of(motion, with_twist=False).topics["/b/pose"]
    bag.topics["/b/pose"] = Topic("/b/pose", plain.type_name)
    for log_time, row in zip(bag.topics["/b/twist"].log_times, plain.numbers.tolist(), strict=True):
        add(bag.topics["/b/pose"], log_time, cdr.encode(plain.type_name, 0, "world", row))
    summary = summary_of(bag)
    assert summary.passed
    assert summary.duration_s == pytest.approx(9.99)


@pytest.mark.parametrize("topic", ["/b/pose", "/b/twist", "/w"])
def test_stamps_that_stand_still_are_told_and_the_rest_is_judged(topic: str) -> None:
    motion = spin()
    bag = bag_of(motion, wrench=True)
    rows = bag.topics[topic].numbers if topic != "/w" else np.arange(6.0 * COUNT).reshape(-1, 6)
    frame = "world" if topic == "/b/pose" else "base"
    bag.topics[topic] = Topic(topic, bag.topics[topic].type_name)
    fill(bag.topics[topic], np.full_like(motion.time_ns, SECOND), frame, rows, motion.time_ns)
    summary = summary_of(bag)
    told = {check.name: check.detail for check in summary.checks if not check.passed}
    assert told[f"{topic} is whole"].startswith("stamps stand still: 1000 messages, 1000 with one stamp")
    assert not any("run alike" in each or "another clock" in each for each in summary.warnings)
    assert len(told) == 1


@pytest.mark.parametrize("slower", [0.0, 1.0])
def test_a_piece_that_is_missing_is_told_by_the_stamps(slower: float) -> None:
    """It was told from t = 1e+09 s, and a wrench that was held before it was taken to act through it."""
    kept = np.delete(np.arange(COUNT), slice(400, 700))
    motion = spin().taken(kept)
    moved = np.rint(10**18 + slower * motion.time_ns).astype(np.int64)
    bag = bag_of(motion, logged_later_ns=moved)
    wrench = bag.topics["/wrench"] = Topic("/wrench", PLAIN)
    logged = bag.topics["/b/pose"].log_times
    for place in (100, 650):
        add(wrench, int(logged[place]), cdr.encode(PLAIN, (0.0, 0.0, 0.0, 0.0, 0.0, 0.1)))
    assert read_track(bag).missing == ()
    bag.metadata["rb_dynamics.interrupted"] = {"reason": "damaged", "missing_ns": f"{logged[399]} {logged[400]}"}
    track = read_track(bag)
    assert track.missing == ((int(motion.time_ns[399]), int(motion.time_ns[400])),)
    (acting,) = track.acting
    assert acting.known.tolist() == [True, False, True]
    assert acting.time_ns.tolist() == pytest.approx([motion.time_ns[k] for k in (100, 399, 650)], abs=SECOND // 50)
