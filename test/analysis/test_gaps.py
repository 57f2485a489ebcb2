"""The first gaps are listed one by one, with the number and total length of all."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_rows import STAMPED, add, stamped, write_rows
from foreign_bags import TF, transform, transforms, write_bag
from tumbling import TWIST, WRENCH, bag_of, failing, fill, spin, summary_of

from rb_dynamics.analysis.bag_selection import part_of
from rb_dynamics.analysis.checks import losses
from rb_dynamics.analysis.gaps import holes, silences, told, without_strays
from rb_dynamics.analysis.read_track import TopicChoice, read_track
from rb_dynamics.formats.topic_messages import Topic
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.numerics.rotation_arrays import rotate_all_inverse

STEP = 10_000_000
WALL_NS = 1_700_000_000_123_456_789


def without(*holes: tuple[int, int]) -> np.ndarray:
    rows = np.arange(1000)
    return rows[~np.any([(rows > a) & (rows < b) for a, b in holes], axis=0)]


def test_each_hole_is_named_and_their_sum() -> None:
    motion = spin(stamps="jitter").taken(without((100, 300), (500, 700)))
    detail = failing(bag_of(motion))["/b/pose is whole"]
    assert detail.startswith("2 gaps, 4.0")
    assert detail.count(" s from t = ") == 2


def test_the_longest_of_many_holes_are_named_in_their_order() -> None:
    steps = np.full(200, STEP)
    steps[10:170:20] = STEP * np.array([9, 3, 8, 4, 7, 5, 6, 2])
    found = told(np.concatenate([[0], np.cumsum(steps)]), 0)
    assert found.startswith("8 gaps, 0.44 s together: 0.09 s from t = 0.1 s; 0.08 s")
    assert found.endswith("; and 3 more")
    assert found.count(" from t = ") == 5


def test_stamps_of_a_clock_that_ticks_seldom_are_no_gaps() -> None:
    """Of each ten samples nine have the stamp of the one before: every tick was a gap."""
    assert told(np.repeat(STEP * np.arange(100), 10), 0) == ""
    assert told(np.repeat(STEP * np.delete(np.arange(100), 50), 10), 0).startswith("1 gap: 0.02 s")


@pytest.mark.parametrize(("missing", "words"), [((0, 350), "begins 3.5 s after"), ((600, 1000), "stops 4 s before")])
def test_a_stream_that_begins_late_or_ends_early_is_named(missing: tuple[int, int], words: str) -> None:
    begin, end = missing
    rows = np.arange(1000)
    part = spin().taken(rows[(rows < begin) | (rows >= end)])
    assert words in failing(bag_of(part, twist=spin()))["/b/pose is whole"]
    assert "/b/twist" in failing(bag_of(part, twist=spin()))["/b/pose is whole"]


@pytest.mark.parametrize("by_s", [-3600, 3600])
def test_a_stream_that_was_logged_later_but_stamped_alike_is_whole(by_s: int) -> None:
    """Only the log times were an hour apart, and it was said to begin an hour late."""
    motion, later = spin(), spin()
    bag = bag_of(motion, with_twist=False)
    bag.topics["/b/twist"] = Topic("/b/twist", TWIST)
    rows = np.hstack([rotate_all_inverse(later.orientation_xyzw, later.velocity), later.rate])
    fill(bag.topics["/b/twist"], later.time_ns, "base", rows, by_s * 10**9)
    assert not {"/b/pose is whole", "/b/twist is whole"} & failing(bag).keys()
    assert any("/b/twist is stamped 3600 s" in each for each in summary_of(bag).warnings)


def test_a_part_begins_with_its_motion_and_not_with_the_wrench_that_is_held_into_it() -> None:
    assert not failing(part_of(read_track(bag_of(spin(), wrench=True)), (5.0, None)))
    rows = np.arange(1000)
    late = bag_of(spin().taken(rows[rows >= 700]), twist=spin(), wrench=True)
    assert "begins 2 s after" in failing(part_of(read_track(late), (5.0, None)))["/b/pose is whole"]


def test_a_topic_without_a_usable_message_fails_alone() -> None:
    bag = bag_of(spin(), twist_rows=np.full((1000, 6), np.nan))
    assert "1000 of 1000 messages of /b/twist have" in losses(read_track(bag))[0]
    assert failing(bag) == {"/b/twist is whole": "1000 of 1000 messages have a number that is not finite or too large"}


def test_what_one_finding_says_hides_no_other() -> None:
    """One number that is not finite, or two stamps out of order, hid a hole and a stream that ended early."""
    rows = np.delete(np.arange(600), np.arange(200, 300))
    rows[[50, 51]] = rows[[51, 50]]
    motion = spin().taken(rows)
    motion.position[10, 0] = np.nan
    detail = failing(bag_of(motion, twist=spin()))["/b/pose is whole"]
    expected = (
        "1 of 500 messages have a number",
        "1 of 499 stamps is out of order",
        "1.01 s from t",
        "stops 4 s before",
    )
    assert all(words in detail for words in expected)


def test_a_stream_begins_late_by_the_log_of_ros_alone_is_none() -> None:
    bag = bag_of(spin().moved(5 * 10**9))
    bag.topics["/rosout"] = Topic("/rosout", "rcl_interfaces/msg/Log")
    add(bag.topics["/rosout"], 0, b"")
    assert not failing(bag)


@pytest.mark.parametrize("time_ns", [0, 20 * 10**9])
def test_a_topic_of_an_unknown_type_may_be_the_first_or_the_last(time_ns: int) -> None:
    """An image that was recorded before all else, or after, ended `inspect` with a KeyError."""
    bag = bag_of(spin().moved(5 * 10**9))
    bag.topics["/image"] = Topic("/image", "sensor_msgs/msg/Image")
    add(bag.topics["/image"], time_ns, b"")
    detail = failing(bag)["/b/pose is whole"]
    assert detail.endswith("with /image")
    assert not bag.topics["/image"].stamped


def test_fixed_frames_that_came_first_are_no_beginning(tmp_path: Path) -> None:
    """Without a profile in the recording, the pose was said to begin 5 s late."""
    pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    rows = [("/tf_static", TF, 0, transforms([transform(0, "base", "imu", pose)]))]
    fixed = read_bag(write_bag(tmp_path / "bag", rows)).topics
    bag = bag_of(spin().moved(5 * 10**9))
    for topic in fixed.values():
        topic.qos = ""
    bag.topics.update(fixed)
    assert not failing(bag)


def test_every_topic_says_what_it_is_used_for_or_why_it_is_not() -> None:
    bag = bag_of(spin(), wrench=True)
    for name, kind, count in (
        ("/c/pose", "geometry_msgs/msg/PoseStamped", 0),
        ("/accel", "geometry_msgs/msg/AccelStamped", 1),
        ("/temperature", "std_msgs/msg/Float64", 1),
        ("/image", "sensor_msgs/msg/Image", 1),
    ):
        bag.topics[name] = Topic(name, kind)
        for _ in range(count):
            add(bag.topics[name], 0, bytes(100))
    bag.topics["/d/pose"] = bag_of(spin(), with_twist=False).topics["/b/pose"]
    bag.topics["/d/pose"].name = "/d/pose"
    assert {topic.name: topic.use for topic in summary_of(bag).topics} == {
        "/accel": "(not used)",
        "/b/pose": "pose",
        "/b/twist": "twist",
        "/c/pose": "(no messages)",
        "/d/pose": "(another used)",
        "/image": "(other type)",
        "/temperature": "(other name)",
        "/w": "wrench",
    }


def commanded(time_ns: np.ndarray, last: float = 1.0) -> list[str]:
    """Return what is said of commands at these times, `last` before the first pause."""
    bag = bag_of(spin())
    bag.topics["/thrust"] = Topic("/thrust", STAMPED)
    pause = int(np.diff(time_ns).argmax())
    for k, at in enumerate(time_ns.tolist()):
        add(bag.topics["/thrust"], at, stamped(at, last if k == pause else 1.0))
    return [each for each in summary_of(bag).warnings if "received no commands" in each]


def test_a_pause_of_a_steady_stream_of_commands_is_warned_of() -> None:
    times = spin(stamps="jitter").time_ns
    (said,) = commanded(times[(times < 4_000_000_000) | (times > 5_500_000_000)])
    assert said.startswith("/thrust received no commands for 1.5")
    assert " s from t = 3.98" in said


def test_pauses_of_sparse_commands_and_of_bursts_are_meant() -> None:
    generator = np.random.default_rng(4)
    stream = spin().time_ns
    assert not commanded(stream[(stream < 4 * 10**9) | (stream > 5.5 * 10**9)], last=0.0)
    for times in (
        np.cumsum(generator.exponential(2e9, 400)).astype(np.int64),
        np.concatenate([stream[:300] + k * 5 * 10**9 for k in range(5)]),
        np.concatenate([stream[:300], stream[:300] + 8 * 10**9]),
        np.concatenate([stream[:50], stream[:20] + 8 * 10**9]),
    ):
        assert not len(silences(times))
        assert not commanded(times)


@pytest.mark.parametrize(
    ("stray", "kept"),
    [
        ([-(10**18)], slice(1, 301)),
        ([10**18], slice(0, 300)),
        ([-(10**18), 10**18, 10**18 + 5], slice(1, 301)),
        ([40 * 10**9], slice(0, 300)),
        ([9 * 10**9], slice(0, 301)),
        ([10**18 + k for k in range(30)], slice(0, 330)),
        ([], slice(0, 300)),
    ],
)
def test_a_few_stamps_far_from_all_the_others_are_strays(stray: list[int], kept: slice) -> None:
    assert without_strays(np.sort(np.concatenate([STEP * np.arange(300), np.array(stray, np.int64)]))) == kept


def test_a_motion_is_followed_where_a_sensor_measures_or_the_body_turns_little() -> None:
    one, other = STEP * without((100, 300), (500, 700)), STEP * without((290, 800))
    assert holes([one], 1.0) == [(STEP * 100, STEP * 300), (STEP * 500, STEP * 700)]
    assert holes([one], 0.4) == holes([one, STEP * np.arange(1000)], 1.0) == []
    assert holes([one, other], 1.0) == [(STEP * 500, STEP * 700)]
    # As much of holes is bridged as of what is measured, the shortest first.
    assert holes([np.append(one, 10**13)], 1.0, 10.0) == [(STEP * 999, 10**13)]


def test_a_stray_stamp_is_left_out_and_named() -> None:
    """It made every time of the output a wall clock's, and the noise was blamed that nothing was judged."""
    motion = spin()
    motion = motion.taken(np.concatenate([[0], np.arange(len(motion.time_ns))]))
    motion.time_ns[0] -= 10**18
    found = read_track(bag_of(motion))
    assert found.pose is not None
    assert len(found.pose.time_ns) == len(spin().time_ns)
    assert "1 of 1001 stamps is far from all the others, 1e+09 s before" in failing(bag_of(motion))["/b/pose is whole"]
    assert any("far from all the others" in each for each in losses(found))


def test_messages_that_are_sent_again_are_no_run() -> None:
    rows = np.arange(1000)
    again = spin().taken(np.concatenate([rows, rows[975:980]]))
    assert "/b/pose is whole" not in failing(bag_of(again))
    twice = spin().taken(np.concatenate([rows, rows]))
    assert "begin again" in failing(bag_of(twice))["/b/pose is whole"]


def test_stray_stamps_and_numbers_of_composed_transforms_are_left_out_and_named(tmp_path: Path) -> None:
    """Such a stamp was time 0 of the whole output."""
    motion = spin(count=300)
    rows = np.hstack([motion.position, motion.orientation_xyzw])
    rows[200, 0] = np.nan
    stamps = np.append(motion.time_ns + 10**18, [0])
    turning = [transform(int(at), "odom", "base", row) for at, row in zip(stamps, [*rows, rows[0]], strict=True)]
    logged = [("/tf", TF, 10**18 + 10**7 * k, transforms([each])) for k, each in enumerate(turning)]
    still = transform(10**18, "map", "odom", (0, 0, 0, 0, 0, 0, 1))
    logged.append(("/tf_static", TF, 10**18, transforms([still])))
    found = read_track(read_bag(write_bag(tmp_path / "tf", logged)), choice=TopicChoice(frames=("map", "base")))
    assert found.pose is not None
    assert found.zero_ns == 10**18
    assert found.pose.unusable == 1
    assert any("1 of 301 stamps is far from all the others" in each for each in found.faults)


@pytest.mark.parametrize("far", [-(10**17), 10**17])
def test_a_command_far_from_all_the_others_is_left_out_and_named(far: int) -> None:
    """One of long before all others acted from the start until the next."""
    motion, torque = spin(), np.zeros((200, 6))
    torque[:, 5] = 0.1
    bag = bag_of(motion)
    bag.topics["/w"] = Topic("/w", WRENCH)
    times = motion.time_ns[300:500] + 0
    times[100] += far
    fill(bag.topics["/w"], times, "base", torque, 0)
    found = read_track(bag)
    (wrench,) = found.wrenches
    assert len(wrench.time_ns) == 199
    assert "1 of 200 stamps is far from all the others" in failing(bag)["/w is whole"]
    assert any("/w: 1 of 200 stamps is far" in each for each in losses(found))


@pytest.mark.parametrize("by_s", [-1e9, -3600.0, 3600.0, 1e8])
@pytest.mark.parametrize("row", [1, 10, 19])
def test_a_command_with_a_stamp_far_off_acts_when_it_was_recorded(tmp_path: Path, by_s: float, row: int) -> None:
    """The one before it acted on in its place, unless more than a hundred were recorded."""
    times = WALL_NS + np.arange(20) * 100_000_000
    stamps = times.tolist()
    stamps[row] += round(by_s * 1e9)
    rows = [
        ("/wrench", STAMPED, at + 3_000_000, stamped(stamps[k], float(k), "")) for k, at in enumerate(times.tolist())
    ]
    (found,) = read_track(read_bag(write_rows(tmp_path / "bag.mcap", rows))).wrenches
    assert found.time_ns.tolist() == times.tolist()
    assert found.force[:, 0].tolist() == [*range(20)]
    (said,) = found.faults(WALL_NS)
    assert re.search(r"1 of 20 stamps is far from all the others, .* and taken at the log time instead", said)


def test_a_missing_piece_whose_end_is_not_known_says_so() -> None:
    """It ended "at 9.22337e+09 s"."""
    track = read_track(bag_of(spin()))
    begin = int(track.span_ns[0]) + 5 * 10**9
    (lost,) = losses(replace(track, missing=((begin, 2**63 - 1),)))
    assert lost == "a piece is missing from t = 5 to an end that is not known"
