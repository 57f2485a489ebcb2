"""Merging: every message of every bag, byte for byte, read by rosbags; a part of one; what cannot be merged is told."""

from __future__ import annotations

import contextlib
import itertools
import math
import sqlite3
from pathlib import Path
from typing import Any

import pytest
from foreign_bags import GEOMETRY, STORE, TF, header, of, transform, transforms, write_bag

import rb_dynamics as rb
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import summarize
from rb_dynamics.errors import LogError
from rb_dynamics.formats.merging import merge
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.sinks.mcap_sink import McapSink

SECOND = 10**9
ALL = (-math.inf, math.inf)


def wrenches(topic: str, times_s: Any, frame: str = "body") -> list[Any]:
    rows = []
    for k in times_s:
        parts = of("Wrench", of("Vector3", float(k), 0.0, 0.0), of("Vector3", 0.0, 0.0, 0.0))
        rows.append(
            (topic, f"{GEOMETRY}WrenchStamped", k * SECOND, of("WrenchStamped", header(k * SECOND, frame), parts))
        )
    return rows


def content(path: Path) -> list[tuple[int, str, str, bytes]]:
    from rosbags.highlevel import AnyReader

    with AnyReader([path], default_typestore=STORE) as reader:
        return [(time_ns, each.topic, each.msgtype, bytes(data)) for each, time_ns, data in reader.messages()]


@pytest.mark.parametrize("sqlite", [False, True])
def test_every_message_is_there_in_the_order_of_time(tmp_path: Path, sqlite: bool) -> None:
    one = write_bag(tmp_path / "one", wrenches("/a", range(0, 10, 2)), sqlite)
    other = write_bag(tmp_path / "other", wrenches("/b", range(1, 10, 3)))
    found = merge([one, other], tmp_path / "all.mcap", ALL)
    expected = sorted(content(one) + content(other))
    assert content(tmp_path / "all.mcap") == expected
    assert (found.messages, found.notes) == (len(expected), [])
    assert read_bag(tmp_path / "all.mcap").complete


def test_a_part_keeps_the_fixed_transforms_and_the_wrench_that_is_held(tmp_path: Path) -> None:
    fixed = ("/tf_static", TF, 0, transforms([transform(0, "base", "camera", [2.0, 0, 0, 0, 0, 0, 1.0])]))
    bag = write_bag(tmp_path / "bag", [fixed, *wrenches("/a", range(10))])
    merge([bag], tmp_path / "part.mcap", (3 * SECOND, 5 * SECOND))
    assert [(time_ns // SECOND, topic) for time_ns, topic, *_ in content(tmp_path / "part.mcap")] == [
        (0, "/tf_static"),
        (2, "/a"),
        (3, "/a"),
        (4, "/a"),
        (5, "/a"),
    ]
    part = read_bag(tmp_path / "part.mcap")
    assert part.cut_ns == (3 * SECOND, 5 * SECOND)
    merge([bag], tmp_path / "end.mcap", (20 * SECOND, 30 * SECOND))
    assert [time_ns // SECOND for time_ns, *_ in content(tmp_path / "end.mcap")] == [0]
    late = write_bag(tmp_path / "late", wrenches("/b", range(20, 24)))
    assert merge([late, bag], tmp_path / "two.mcap", (0, 1 * SECOND)).messages == 3


def test_parts_that_are_merged_again_begin_after_what_they_hold_from_before(tmp_path: Path) -> None:
    """The motion "began late" in an innocent recording, and simulate began with a command that was held."""
    bag = write_bag(tmp_path / "bag", wrenches("/a", range(0, 30, 3)))
    parts = [tmp_path / "one.mcap", tmp_path / "two.mcap"]
    for part, span_s in zip(parts, ((4, 10), (13, 20)), strict=True):
        merge([bag], part, (span_s[0] * SECOND, span_s[1] * SECOND))
    for order in (parts, parts[::-1]):
        merge(order, tmp_path / "again.mcap", ALL)
        assert read_bag(tmp_path / "again.mcap").cut_ns == (6 * SECOND, 18 * SECOND)
    merge(parts[:1], tmp_path / "again.mcap", (-math.inf, 8 * SECOND))
    assert read_bag(tmp_path / "again.mcap").cut_ns == (6 * SECOND, 8 * SECOND)
    merge([bag, parts[1]], tmp_path / "again.mcap", ALL)
    assert read_bag(tmp_path / "again.mcap").cut_ns == (0, 27 * SECOND)


def test_what_overlapping_parts_share_is_there_once(tmp_path: Path) -> None:
    """A part has the command that it holds; merged with the part before it, it was there twice, and counted twice."""
    bag = write_bag(tmp_path / "bag", wrenches("/a", (0, 2, 7, 7, 9)))
    parts = [tmp_path / "one.mcap", tmp_path / "two.mcap"]
    for part, span_s in zip(parts, ((0, 8), (4, 10)), strict=True):
        merge([bag], part, (span_s[0] * SECOND, span_s[1] * SECOND))
    merge(parts, tmp_path / "again.mcap", ALL)
    assert content(tmp_path / "again.mcap") == content(bag), "what is twice in one bag is so here"
    merge(parts, tmp_path / "later.mcap", (8 * SECOND, math.inf))
    assert [time_ns // SECOND for time_ns, *_ in content(tmp_path / "later.mcap")] == [7, 9]


def test_what_a_part_holds_is_in_the_order_of_time_with_what_is_latched(tmp_path: Path) -> None:
    """Behind transforms that a later file repeats, a held command came too late to be seen as that of another part."""
    fixed = transforms([transform(0, "base", "camera", [2.0, 0, 0, 0, 0, 0, 1.0])])
    rows = [*wrenches("/a", (1, 1, 8)), *(("/tf_static", TF, k * SECOND, fixed) for k in (0, 3, 6))]
    bag = write_bag(tmp_path / "bag", sorted(rows, key=lambda row: row[2]))
    parts = [tmp_path / f"{name}.mcap" for name in ("one", "two", "three")]
    for part, span_s in zip(parts, ((0, 5), (5, 8), (2, 9)), strict=True):
        merge([bag], part, (span_s[0] * SECOND, span_s[1] * SECOND))
    for order in itertools.permutations(parts):
        merge(order, tmp_path / "again.mcap", ALL)
        assert content(tmp_path / "again.mcap") == content(bag)


def test_a_part_knows_what_actuators_do_that_were_commanded_before_it(tmp_path: Path) -> None:
    """A thruster that was on seemed to be off, and inspect then found a torque that nobody commanded."""
    body = "{mass: 12, inertia: {diagonal: [0.9, 1.2, 1.6]}, frames: {jet: {position: [0.3, 0.1, 0]}}}"
    jet = "{type: thruster, name: jet, frame: jet, force: 1.0, command: level, rise: 0.5, fall: 0.3}"
    scene = rb.parse_scene(f"body: {body}\nactuators: [{jet}]\nduration: 20\noutput_rate: 50\n")
    levels = [
        ("jet/command", rb.Setpoint(level, stamp_ns=at * SECOND)) for at, level in ((1, 0.6), (2, 0.5), (12, 0.2))
    ]
    log, part = tmp_path / "log.mcap", tmp_path / "part.mcap"
    rb.simulate(scene, levels, [McapSink(log)])
    merge([log], part, (5 * SECOND, 18 * SECOND))
    commands = read_bag(part).topics["/jet/command"]
    assert commands.log_times.tolist() == [2 * SECOND, 12 * SECOND]
    (check,) = [c for c in summarize(read_track(read_bag(part), scene)).checks if c.name.startswith("inertia explains")]
    assert check.passed


def test_what_may_be_two_bodies_or_two_clocks_is_told(tmp_path: Path) -> None:
    one = write_bag(tmp_path / "one", wrenches("/a", range(5)))
    other = write_bag(tmp_path / "other", wrenches("/a", range(3, 9)))
    far = write_bag(tmp_path / "far", wrenches("/a", range(1_700_000_000, 1_700_000_003)))
    (note,) = merge([one, other], tmp_path / "both.mcap", ALL).notes
    assert "/a is in" in note
    (note,) = merge([one, far], tmp_path / "far.mcap", ALL).notes
    assert "apart by their log times" in note


def test_what_cannot_be_merged_is_one_error(tmp_path: Path) -> None:
    one = write_bag(tmp_path / "one", wrenches("/a", range(5)))
    parts = of("Vector3", 1.0, 0.0, 0.0), of("Vector3", 0.0, 0.0, 0.0)
    plain = write_bag(tmp_path / "plain", [("/a", f"{GEOMETRY}Wrench", 7 * SECOND, of("Wrench", *parts))])
    with pytest.raises(LogError, match=r"topic /a is .*WrenchStamped in one bag and .*Wrench in another"):
        merge([one, plain], tmp_path / "out.mcap", ALL)
    with pytest.raises(LogError, match="found no message to write"):
        merge([one], tmp_path / "out.mcap", (100 * SECOND, 200 * SECOND))
    early = write_bag(tmp_path / "early", wrenches("/a", range(5)), True)
    (database,) = early.glob("*.db3")
    with contextlib.closing(sqlite3.connect(database)) as changed, changed:
        changed.execute("UPDATE messages SET timestamp = -5 WHERE id = 1")
    with pytest.raises(LogError, match=r"/a has the log time -5 ns, expected 0 or more, as MCAP has no earlier times"):
        merge([early], tmp_path / "out.mcap", ALL)
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize("begin_s", [None, 5])
def test_what_was_held_when_a_bag_was_cut_off_is_not_known_after_it(tmp_path: Path, begin_s: int | None) -> None:
    """In what it was merged with, it was taken to act on."""
    whole, cut = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    merge([write_bag(tmp_path / "bag", wrenches("/a", range(1, 4)))], whole, ALL)
    cut.write_bytes(whole.read_bytes()[:-9])
    later = write_bag(tmp_path / "later", wrenches("/b", range(1, 9)))
    merge([cut, later], tmp_path / "all.mcap", (-math.inf if begin_s is None else begin_s * SECOND, math.inf))
    bag = read_bag(tmp_path / "all.mcap")
    assert bag.missing == [(3 * SECOND, 8 * SECOND)]
    (acting,) = (each for each in read_track(bag).acting if each.topic == "/a")
    assert (acting.time_ns[-1], acting.known[-1]) == (3 * SECOND, False)
