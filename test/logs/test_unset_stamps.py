"""A stamp of 0 that nobody set, as `ros2 topic pub` leaves it: every command puts it where it was recorded."""

from __future__ import annotations

from pathlib import Path

import pytest
from bag_rows import STAMPED, Row, stamped, write_rows

from rb_dynamics.analysis.bag_selection import part_of
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.formats import cdr
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.unset_stamps import WHEN
from rb_dynamics.logs.wrench_bags import RecordedWrenches
from rb_dynamics.study.compare import compare

SECOND = 10**9
WALL_NS = 1_700_000_000 * SECOND
POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"


def commands(log_ns: int, stamps: list[int | None], zero_ns: int = 0) -> list[Row]:
    """Return commands recorded every second, 7 ns after the stamp, if there is one."""
    return [
        ("/wrench", STAMPED, log_ns + k * SECOND + 7, stamped(0 if at is None else zero_ns + at, 1.0 + k, ""))
        for k, at in enumerate(stamps)
    ]


@pytest.mark.parametrize("zero_ns", [0, WALL_NS])
@pytest.mark.parametrize("bare", [1, 3])
def test_simulate_and_inspect_let_it_act_when_it_was_recorded(tmp_path: Path, zero_ns: int, bare: int) -> None:
    """At 1970 the command before it acted on in its place; in a simulation's time it acted at 0, without a word.

    Without the delay of the others, it alone would act late.
    """
    rows = commands(zero_ns, [None if k == bare else k * SECOND + 1 for k in range(4)], zero_ns)
    bag = write_rows(tmp_path / "a.mcap", rows)
    times = [zero_ns + k * SECOND + 1 for k in range(4)]
    flown = RecordedWrenches([bag], ["wrench"], start="stamp")
    assert [(wrench.stamp_ns, wrench.force[0]) for _, wrench in flown] == list(
        zip(times, (1.0, 2.0, 3.0, 4.0), strict=True)
    )
    assert flown.notes == [f"{bag}: some of its commands have no stamps: {WHEN}"]
    track = read_track(read_bag(bag))
    (seen,) = track.wrenches
    assert (seen.time_ns.tolist(), seen.force[:, 0].tolist()) == (times, [1.0, 2.0, 3.0, 4.0])
    assert f"/wrench: 1 of 4 commands have no stamp: {WHEN}." in track.notes
    part = part_of(track, (bare - 0.5, bare + 0.5)).topics["/wrench"]
    assert part.stamps.tolist() == times[bare - 1 : bare + 1]


def test_log_times_of_another_clock_are_put_on_that_of_the_stamps(tmp_path: Path) -> None:
    bag = write_rows(tmp_path / "a.mcap", commands(WALL_NS, [SECOND, 2 * SECOND, None, 4 * SECOND]))
    times = [SECOND, 2 * SECOND, 3 * SECOND, 4 * SECOND]
    assert [wrench.stamp_ns for _, wrench in RecordedWrenches([bag], ["wrench"], start="stamp")] == times
    (seen,) = read_track(read_bag(bag)).wrenches
    assert seen.time_ns.tolist() == times


@pytest.mark.parametrize("late_ns", [20_000, 5 * SECOND])
@pytest.mark.parametrize("zero_ns", [0, WALL_NS])
def test_a_single_one_beside_the_motion_acts_when_it_was_recorded(tmp_path: Path, zero_ns: int, late_ns: int) -> None:
    """As of `ros2 topic pub --once`: it acted at time 0, without a word. Just after 0 of a simulation, 0 is a stamp."""
    rows: list[Row] = [
        ("/twist", TWIST, zero_ns + at, cdr.encode(TWIST, zero_ns + at, "body", (0.0,) * 6))
        for at in range(0, 10 * SECOND, SECOND // 10)
    ]
    rows.append(("/wrench", STAMPED, zero_ns + late_ns, stamped(0, 1.0)))
    bag, as_stamped = write_rows(tmp_path / "a.mcap", rows), zero_ns == 0 and late_ns < SECOND
    flown = RecordedWrenches([bag], ["wrench"], 20 * SECOND, start="auto")
    assert [wrench.stamp_ns for _, wrench in flown] == [0 if as_stamped else late_ns]
    assert any("its commands have no stamps" in note for note in flown.notes) is not as_stamped
    (seen,) = read_track(read_bag(bag)).wrenches
    assert seen.time_ns.tolist() == [0 if as_stamped else zero_ns + late_ns]


def test_where_the_clock_begins_at_0_the_first_stamps_of_0_are_stamps(tmp_path: Path) -> None:
    """A simulation that is paused takes several commands at 0."""
    bag = write_rows(tmp_path / "a.mcap", commands(WALL_NS, [0, 0, SECOND, 2 * SECOND]))
    flown = RecordedWrenches([bag], ["wrench"], start="stamp")
    times = [0, 0, SECOND, 2 * SECOND]
    assert [wrench.stamp_ns for _, wrench in flown] == times
    (seen,) = read_track(read_bag(bag)).wrenches
    assert seen.time_ns.tolist() == times


def test_a_first_one_without_a_stamp_of_a_recording_that_begins_late_acts_when_it_was_recorded(tmp_path: Path) -> None:
    """It was held from long before the recording, without a word."""
    bag = write_rows(tmp_path / "a.mcap", commands(20 * SECOND, [None, SECOND, 2 * SECOND], 20 * SECOND))
    flown = RecordedWrenches([bag], ["wrench"], start="stamp")
    times = [20 * SECOND, 21 * SECOND, 22 * SECOND]
    assert [wrench.stamp_ns for _, wrench in flown] == times
    assert "some of its commands have no stamps" in flown.notes[0]
    (seen,) = read_track(read_bag(bag)).wrenches
    assert seen.time_ns.tolist() == times


def test_compare_finds_the_same_commands_with_and_without_the_stamp(tmp_path: Path) -> None:
    """Two channels of the same recording, one with a stamp fewer, were told apart."""
    bags = []
    for name, bare in (("a", None), ("b", 1)):
        rows: list[Row] = [
            (topic, kind, at, data)
            for k in range(60)
            for at in [WALL_NS + k * SECOND // 10]
            for topic, kind, data in (
                [("/pose", POSE, cdr.encode(POSE, at, "world", (0.1 * k, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)))]
                + [("/wrench", STAMPED, stamped(0 if k == 10 * (bare or -1) else at, 1.0 + k, ""))] * (k % 10 == 0)
            )
        ]
        bags.append(write_rows(tmp_path / f"{name}.mcap", rows))
    found = compare(*bags)
    assert found.commands == []
    assert f"{bags[1]}: some of its commands have no stamps: {WHEN}" in found.notes
