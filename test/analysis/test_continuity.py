"""Jumps of the pose fail with topic, time and size; noise, jitter, stops and starts do not."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_rows import add_stamped
from noisy_recordings import scene_of
from tumbling import Tumble, bag_of, checks_of, failing, fill, spin

from rb_dynamics import RigidBody, State, free_motion
from rb_dynamics.analysis.continuity import continuity
from rb_dynamics.analysis.identification.flights import flight_of
from rb_dynamics.analysis.read_track import TopicChoice, read_track
from rb_dynamics.analysis.summary import summarize
from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.message_types import ODOMETRY, WRENCH
from rb_dynamics.formats.topic_messages import Topic
from rb_dynamics.logs.bag_reader import Bag
from rb_dynamics.numerics.rotation_arrays import rotate_all_inverse

BALL = scene_of(5.0, np.diag([1.0, 1.0, 1.0]), (0.0, 0.0, 0.0))
BRICK = RigidBody.from_matrix(1.0, np.diag([1.0, 2.0, 2.5]))
JUMPS = "/b/pose has no jumps"


def odometry(name: str, motion: Tumble) -> Topic:
    topic = Topic(name, ODOMETRY)
    body = np.hstack([rotate_all_inverse(motion.orientation_xyzw, motion.velocity), motion.rate])
    rows = np.hstack(
        [motion.position, motion.orientation_xyzw, np.zeros((len(body), 36)), body, np.zeros((len(body), 36))]
    )

    def encode(stamp: int, row: list[float]) -> bytes:
        return cdr.encode(ODOMETRY, stamp, "world", "base", row[:7], row[7:43], row[43:49], row[49:])

    add_stamped(topic, motion.time_ns, motion.time_ns, rows, encode)
    return topic


def tumble(rate: float) -> Tumble:
    """Return the motion of a brick that turns in one place, at 100 Hz for 10 s."""
    spun = State(angular_velocity_body=(0.3 * rate, 0.9 * rate, 0.1 * rate))
    time_ns = np.arange(1000, dtype=np.int64) * 10_000_000
    flown = free_motion(BRICK, spun, time_ns * 1e-9)
    parts = (flown.position_world, flown.orientation_xyzw, flown.linear_velocity_world, flown.angular_velocity_body)
    return Tumble(time_ns, *map(np.array, parts))


@pytest.mark.parametrize("with_twist", [True, False])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_an_attitude_that_jumps_is_told_with_time_and_size(with_twist: bool, noise: float) -> None:
    motion = spin(noise=noise)
    motion.orientation_xyzw[400:] = motion.turned(np.deg2rad(179.5))[400:]
    detail = failing(bag_of(motion, with_twist=with_twist))[JUMPS]
    assert "attitude, by 179." in detail
    assert "within 0.01 s at t = 3.99 s" in detail
    assert detail.count("attitude") == 1


def test_a_position_that_jumps_and_comes_back_is_told_twice() -> None:
    motion = spin(noise=1e-4)
    motion.position[300:350] += (0.5, 0.0, 0.0)
    detail = failing(bag_of(motion))[JUMPS]
    assert "position, by 0.5" in detail
    assert "at t = 2.99 s; position, by" in detail
    assert detail.endswith("at t = 3.49 s")


@pytest.mark.parametrize("with_twist", [True, False])
def test_a_frozen_pose_is_told_with_its_time(with_twist: bool) -> None:
    motion, rows = spin(noise=1e-4), np.arange(1000)
    rows[300:600] = 300
    frozen = replace(motion, position=motion.position[rows], orientation_xyzw=motion.orientation_xyzw[rows])
    told = failing(bag_of(frozen, twist=motion, with_twist=with_twist))
    assert told["/b/pose does not freeze"].endswith(": 2.99 s from t = 3 s")
    if with_twist:
        assert ", from t = 3 to 6 s: " in told["angular velocity fits the attitude"]


def test_a_frozen_twist_is_told_with_its_time_even_if_it_is_short() -> None:
    """Less than two windows of the pose contradict it."""
    time_ns = 10_000_000 * np.arange(1000)
    flown = free_motion(BRICK, State(angular_velocity_body=(0.2, 1.5, 0.2)), 1e-9 * time_ns)
    still, random = np.zeros((1000, 3)), np.random.default_rng(1)
    rate = flown.angular_velocity_body + 1e-4 * random.standard_normal((1000, 3))
    motion = Tumble(time_ns, still, flown.orientation_xyzw, still, rate)
    rows = np.arange(1000)
    begin = int(np.abs(np.diff(rate[:-80, 1])).argmax()) // 10 * 10
    rows[begin : begin + 80] = begin
    assert "/b/twist does not freeze" not in failing(bag_of(motion))
    told = failing(bag_of(motion, twist=replace(motion, rate=rate[rows])))
    assert told == {
        "/b/twist does not freeze": "the same twist to the last bit although the body turned otherwise: "
        f"0.79 s from t = {begin * 0.01:.6g} s"
    }


@pytest.mark.parametrize("noise", [1e-4, 0.02])
def test_a_twist_of_a_steady_spin_is_not_frozen(noise: float) -> None:
    motion = spin(noise=noise)
    rate = motion.rate + 1e-5 * np.random.default_rng(1).standard_normal(motion.rate.shape)
    rows = np.arange(1000)
    rows[300:400] = 300
    steady = replace(motion, rate=rate[rows], velocity=motion.velocity[rows])
    assert "/b/twist does not freeze" not in failing(bag_of(steady))


def test_a_body_at_rest_and_a_pose_that_is_measured_seldom_are_not_frozen() -> None:
    rest = np.maximum(np.arange(1000), 400) - 400
    resting = spin(noise=1e-4).taken(rest, keep_times=True)
    resting.time_ns = spin().time_ns
    still = replace(resting, velocity=resting.velocity * (rest > 0)[:, None], rate=resting.rate * (rest > 0)[:, None])
    seldom = spin().taken(np.arange(1000) // 20 * 20)
    seldom.time_ns = spin().time_ns
    for motion in (still, seldom):
        found = continuity(read_track(bag_of(motion, twist=spin() if motion is seldom else still)))
        assert found is not None
        assert found.frozen == ()


def test_more_jumps_than_are_named_are_counted() -> None:
    motion = spin()
    for k in range(100, 900, 100):
        motion.position[k:] += (0.5, 0.0, 0.0)
    assert failing(bag_of(motion))[JUMPS].endswith("; and 3 more")


def test_a_held_pose_that_jumps_once_is_told() -> None:
    motion = spin(rate=0.0, speed=0.0)
    motion.orientation_xyzw[500:] = motion.turned(np.deg2rad(30.0))[500:]
    assert "by 30° within 0.01 s at t = 4.99 s" in failing(bag_of(motion, with_twist=False))[JUMPS]


@pytest.mark.parametrize("turns", [True, False])
@pytest.mark.parametrize("samples", [1, 3])
def test_a_held_pose_that_jumps_and_comes_back_is_told_twice(turns: bool, samples: int) -> None:
    """The way back was taken for the usual motion."""
    motion = spin(rate=0.0, speed=0.0)
    for begin in (200, 700):
        motion.position[begin : begin + samples] += (0.0 if turns else 0.5, 0.0, 0.0)
        motion.orientation_xyzw[begin : begin + samples] = motion.turned(0.5 * turns)[begin : begin + samples]
    told = failing(bag_of(motion))[JUMPS]
    assert told.count("attitude, by 28.65°" if turns else "position, by 0.5 m") == 4
    assert f"at t = {1.99 + 0.01 * samples:.6g} s" in told


def test_a_held_pose_that_rounding_takes_away_and_back_does_not_jump() -> None:
    motion = spin(rate=0.0, speed=0.0)
    motion.position[[200, 700], 0] += 0.05
    assert not failing(bag_of(motion, with_twist=False))


def test_a_pose_that_is_measured_at_random_times_and_held_between_them_does_not_jump() -> None:
    for seed in range(20):
        measured = np.random.default_rng(seed).random(1000) < 0.05
        held = np.maximum.accumulate(np.where(measured, np.arange(1000), 0))
        motion = spin(rate=0.5, noise=1e-3, seed=seed).taken(held, keep_times=True)
        found = continuity(read_track(bag_of(motion, with_twist=False)))
        assert found is not None
        assert found.jumps == ()


@pytest.mark.parametrize("turns", [True, False])
@pytest.mark.parametrize("seconds", [1.0, 0.01])
def test_what_a_recorded_wrench_does_within_a_sample_is_no_jump(turns: bool, seconds: float) -> None:
    """It turns by 0.5 rad, or goes 0.5 m, and stops: within 1 s, not within 10 ms, as 1 kg m^2 and 5 kg under this."""
    motion = spin(rate=0.0, speed=0.0).taken(slice(0, 1000))
    motion.time_ns = motion.time_ns[0] + np.arange(1000) * round(seconds * 1e9)
    motion.position[500:] += (0.0 if turns else 0.5, 0.0, 0.0)
    motion.orientation_xyzw[500:] = motion.turned(0.5 * turns)[500:]
    bag = bag_of(motion, with_twist=False)
    push = np.array([[10.0 * (not turns), 0.0, 0.0, 2.0 * turns, 0.0, 0.0]])
    bag.topics["/w"] = Topic("/w", WRENCH)
    at = motion.time_ns[499] + np.array([0, 0.5, 1.0]) * seconds * 1e9
    fill(bag.topics["/w"], at.astype(np.int64), "base", np.vstack([push, -push, 0.0 * push]), 0)
    found = continuity(read_track(bag, BALL))
    assert found is not None
    assert len(found.jumps) == (seconds < 1.0)


@pytest.mark.parametrize("seed", range(12))
def test_what_sensors_and_robots_do_is_no_jump(seed: int) -> None:
    random = np.random.default_rng(seed)
    stamps = ("even", "jitter", "random")[seed % 3]
    motion = spin(rate=random.uniform(0.0, 6.0), noise=10 ** random.uniform(-5.0, -2.0), stamps=stamps, seed=seed)
    if seed % 4 == 1:  # measured every fifth time, held in between
        motion = motion.taken(np.arange(1000) // 5 * 5, keep_times=True)
    if seed % 4 == 2:  # stands still, goes, stands still
        motion = motion.taken(np.clip(np.arange(1000), 300, 700), keep_times=True)
    found = continuity(read_track(bag_of(motion, with_twist=False)))
    assert found is not None
    assert (found.jumps, found.returns) == ((), None)


@pytest.mark.parametrize("noise", [1e-4, 3e-4, 6e-4])
@pytest.mark.parametrize("with_twist", [True, False])
def test_a_body_whose_position_is_rounded_to_millimetres_is_one(noise: float, with_twist: bool) -> None:
    """Noise takes it away and back by one millimetre: it was called two bodies, and nothing was judged."""
    motion = spin(speed=0.0, noise=1e-3)
    place = [1.0005, 2.0003, 0.4995] + noise * np.random.default_rng(7).standard_normal((1000, 3))
    motion.position[:] = np.round(place, 3)
    found = continuity(read_track(bag_of(motion, with_twist=with_twist)))
    assert found is not None
    assert (found.jumps, found.returns) == ((), None)


@pytest.mark.parametrize("with_twist", [True, False])
def test_a_body_in_one_place_whose_last_digits_change_is_one(with_twist: bool) -> None:
    """As where a chain of transforms gives the position."""
    motion = tumble(1.0)
    random = np.random.default_rng(1)
    motion.position = 1.0 + np.finfo(float).eps * random.integers(0, 2, (1000, 1)) * [1.0, 0.0, 0.0]
    found = continuity(read_track(bag_of(motion, with_twist=with_twist)))
    assert found is not None
    assert (found.jumps, found.returns) == ((), None)


@pytest.mark.parametrize("turns", [True, False])
def test_two_bodies_at_rest_are_no_rounding(turns: bool) -> None:
    """Without noise, their distance was taken for the step of the rounding."""
    motion = spin(rate=0.0, speed=0.0)
    if turns:
        motion.orientation_xyzw[::2] = motion.turned(1.0)[::2]
    else:
        motion.position[::2] += (0.5, 0.0, 0.0)
    found = continuity(read_track(bag_of(motion, with_twist=False)))
    assert found is not None
    assert found.returns is not None
    assert found.returns.size == pytest.approx(1.0 if turns else 0.5)


@pytest.mark.parametrize("every", [2, 3])
@pytest.mark.parametrize("with_twist", [True, False])
def test_two_bodies_on_one_topic_are_no_motion(every: int, with_twist: bool) -> None:
    """Every second or third message is of the second body; changes that recur are not jumps."""
    motion = spin(noise=1e-3)
    motion.position[::every] += (5.0, 0.0, 0.0)
    detail = failing(bag_of(motion, with_twist=with_twist))[JUMPS]
    assert "two bodies on one topic" in detail
    assert "by 5" in detail


def test_a_second_body_that_lies_otherwise_is_no_turning() -> None:
    """It makes the usual rotation between two samples, in which nothing would be a jump; the rates know better."""
    motion = spin(noise=1e-3)
    motion.position[::3] += (3.0, 0.0, 0.0)
    motion.orientation_xyzw[::3] = motion.turned(1.06)[::3]
    assert "position jumps away and back" in failing(bag_of(motion, with_twist=True))[JUMPS]


@pytest.mark.parametrize("turn", [1.5, np.pi, 2.0])
@pytest.mark.parametrize("by_turns", [True, False])
def test_two_attitudes_on_one_topic_are_two_bodies(turn: float, by_turns: bool) -> None:
    motion = spin(noise=1e-4)
    other = np.arange(1000) % 2 == 0 if by_turns else np.random.default_rng(3).random(1000) < 0.5
    motion.orientation_xyzw[other] = motion.turned(turn)[other]
    summary = summarize(read_track(bag_of(motion, with_twist=turn < 3.0, wrench=True), BALL))
    detail = {check.name: check.detail for check in summary.checks if not check.passed}[JUMPS]
    assert "the attitude jumps away and back" in detail
    assert "two bodies on one topic" in detail
    assert summary.residual is None
    assert not any(check.judged for check in summary.checks if "balance" in check.name)


@pytest.mark.parametrize(
    ("far", "turn", "other", "result"),
    [
        (3.0, 0.0, spin(rate=3.3, speed=1.2), False),
        (0.0, 1.0, spin(rate=3.3, speed=1.2), False),
        # Another origin, other axes, an estimate with much noise: nothing tells whether that is another body.
        (3.0, 0.0, spin(), None),
        (0.0, 1.0, spin(), None),
        (3.0, 0.0, spin(noise=0.05), None),
        (0.1, 0.1, spin(), True),
    ],
)
def test_two_topics_of_one_frame_are_two_bodies_if_they_move_otherwise(
    far: float, turn: float, other: Tumble, result: bool | None
) -> None:
    one, other = spin(), replace(other, position=other.position.copy())
    other.position += (far, 0.0, 0.0)
    other.orientation_xyzw = other.turned(turn)
    topics = {name: odometry(name, motion) for name, motion in (("/a/odom", one), ("/b/odom", other))}
    track = read_track(Bag(Path("two.mcap"), True, topics, {}, {}), BALL)
    summary = summarize(track)
    checks = [check for check in summary.checks if check.name == "topics of base are of one body"]
    assert [check.passed if check.judged else None for check in checks] == [result] * (result is not True)
    assert all("/b/odom by" in check.detail for check in checks)
    assert (track.body is not None and summary.residual is None) == (result is False)


@pytest.mark.parametrize("every", [10, 25])
@pytest.mark.parametrize("slow_odometry", [True, False])
def test_one_body_that_turns_far_between_two_samples_of_a_slow_topic_is_no_second_one(
    every: int, slow_odometry: bool
) -> None:
    """A quick topic was compared with the next sample of a slow one, by when the body had turned on."""
    motion = tumble(12.0)
    slow = motion.taken(np.arange(3, 1000, every))
    bag = bag_of(motion if slow_odometry else slow, twist=motion)
    bag.topics["/odom"] = odometry("/odom", slow if slow_odometry else motion)
    track = read_track(bag, BALL, TopicChoice(pose="/b/pose", twist="/b/twist"))
    assert not [each for each in summarize(track).checks if each.name.endswith("are of one body")]


def test_attitudes_too_far_apart_to_tell_are_not_judged() -> None:
    (check,) = [each for each in checks_of(bag_of(spin(rate=120.0), with_twist=False)) if each.name == JUMPS]
    assert not check.judged
    assert "turns by 1.2 rad from one sample to the next" in check.detail


def test_no_torque_is_claimed_where_the_pose_jumps() -> None:
    motion = spin()
    motion.orientation_xyzw[400:] = motion.turned(0.5)[400:]
    summary = summarize(
        read_track(bag_of(motion, wrench=True), scene_of(5.0, np.diag([1.0, 1.0, 1.0]), (0.0, 0.0, 0.0)))
    )
    assert summary.residual is None
    unknown = {check.name: check.detail for check in summary.checks if not check.judged}
    assert unknown["inertia explains the motion"] == "not judged; the pose jumps"
    assert "angular momentum balance" in unknown


@pytest.mark.parametrize("what", ["position", "attitude", "velocity", "angular velocity"])
@pytest.mark.parametrize("every", [1, 100])
def test_samples_of_one_stamp_that_contradict_each_other_fail(what: str, every: int) -> None:
    """However many: neither is the truth, and there is no motion in no time."""
    motion = spin(noise=1e-4)
    rows = np.sort(np.append(np.arange(1000), np.arange(0, 1000, every)))
    twice = motion.taken(rows)
    second = np.append(False, np.diff(rows) == 0)
    other = replace(motion, orientation_xyzw=motion.turned(0.5)).taken(rows)
    told = {"position": "position", "attitude": "orientation_xyzw", "velocity": "velocity", "angular velocity": "rate"}
    values = getattr(twice, told[what])
    values[second] = other.orientation_xyzw[second] if what == "attitude" else values[second] + (0.4, 0.0, 0.3)
    pose = what in ("position", "attitude")
    bag = bag_of(
        twice if pose else motion, twist=motion if pose else replace(twice, orientation_xyzw=other.orientation_xyzw)
    )
    detail = failing(bag)[f"/b/{'pose' if pose else 'twist'} is whole"]
    assert f"{what} jumps within 0 s, by up to 0.5" in detail
    assert f": {1000 // every} samples have the stamp of one that they contradict, first at t = 0 s" in detail


def test_poses_of_one_stamp_only_are_no_motion() -> None:
    motion = spin()
    assert (
        "attitude jumps within 0 s" in failing(bag_of(replace(motion, time_ns=0 * motion.time_ns)))["/b/pose is whole"]
    )


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("tick_ns", [20_000_000, 50_000_000])
def test_stamps_of_a_coarse_clock_are_no_contradiction(noise: float, tick_ns: int) -> None:
    motion = spin(noise=noise)
    coarse = replace(motion, time_ns=motion.time_ns // tick_ns * tick_ns)
    assert not any("within 0 s" in detail for detail in failing(bag_of(coarse)).values())


@pytest.mark.parametrize("stamps", ["even", "jitter"])
@pytest.mark.parametrize("shift_ns", [0, 4_000_000])
def test_a_clock_that_was_set_back_in_a_file_sorted_by_its_stamps_is_told(stamps: str, shift_ns: int) -> None:
    """Where no stamp came twice every check passed, and a fit searched for minutes."""
    motion = spin(noise=1e-3, stamps=stamps)
    motion.time_ns[500:] -= 500_000_000 - shift_ns
    bag = bag_of(motion.taken(np.argsort(motion.time_ns, kind="stable")), wrench=True, with_twist=False)
    words = r"from t = 4\.\d* to [45]\.\d* s samples come twice as often as usual and jump to and fro: two runs"
    assert re.search(words, failing(bag)["/b/pose is whole"])
    summary = summarize(read_track(bag, BALL))
    assert any(check.detail == "not judged; these are several runs" for check in summary.checks)
    with pytest.raises(LogError, match=rf"/b/pose: {words}.*; cut it to before or after that"):
        flight_of(bag, BALL)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("tick_ns", [1, 20_000_000])
def test_what_a_sensor_does_is_no_overlap_of_two_runs(seed: int, tick_ns: int) -> None:
    noise, rate = (1e-5, 1e-3, 1e-2)[seed % 3], (0.0, 3.0)[seed % 2]
    motion = spin(rate=rate, speed=0.1 * rate, noise=noise, stamps=("even", "jitter", "random")[seed % 3], seed=seed)
    motion.position[:] = np.round(motion.position, 3)
    coarse = replace(motion, time_ns=motion.time_ns // tick_ns * tick_ns)
    assert not any("twice as often" in detail for detail in failing(bag_of(coarse)).values())


@pytest.mark.parametrize("later_ns", [10_000_000, 1_510_000_000])
def test_stamps_that_stand_still_for_a_while_are_named_and_no_physics(later_ns: int) -> None:
    """As of a driver that hangs for 1.5 s, unless they then leap to the right time."""
    motion = spin(noise=1e-4)
    start_ns = int(motion.time_ns[0])
    motion.time_ns[400:550], motion.time_ns[550:] = motion.time_ns[400], motion.time_ns[400:850] + later_ns
    bag, leaps = bag_of(motion, wrench=True), later_ns > 1_000_000_000
    detail = failing(bag)["/b/pose is whole"]
    assert ("stamps stand still at t = 4 s for 150 samples" in detail) == (not leaps)
    assert ("1 gap: 1.51 s from t = 4 s" in detail) == leaps
    summary = summarize(read_track(bag, BALL))
    assert (summary.residual is None) == (not leaps)
    unknown = {check.name: check.detail for check in summary.checks if not check.judged}
    assert (unknown.get("inertia explains the motion") == "not judged; stamps stand still for a while") == (not leaps)
    if leaps:
        assert flight_of(bag, BALL).span_ns == (0, int(motion.time_ns[-1]) - start_ns)
    else:
        with pytest.raises(LogError, match=r"stamps stand still at t = 4 s .*; cut it to before or after that"):
            flight_of(bag, BALL)
