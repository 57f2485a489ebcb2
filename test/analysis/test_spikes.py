"""Spikes of a twist are named and not judged, those of a pose are left out; what another sensor shows is motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from noisy_recordings import flipping, recording
from tumbling import bag_of, failing, spin

from rb_dynamics import RigidBody, State, free_motion
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.spikes import spikes_of_attitude, spikes_of_position, without_spikes
from rb_dynamics.analysis.track import TimeSeries
from rb_dynamics.analysis.unexplained_wrench import residual
from rb_dynamics.numerics.rotation_arrays import exponentials, lengths, product, rotate_all, rotate_all_inverse


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_spikes_of_a_gyro_are_no_error_of_its_own(seed: int) -> None:
    """One in a hundred samples made a bias, a factor or a delay."""
    made, random = flipping(seed), np.random.default_rng(seed)
    track = read_track(made.bag, made.scene())
    assert track.twist is not None
    assert track.pose is not None
    values = track.twist.values.copy()
    # Two next to each other, and the first and the last.
    at = np.append(random.choice(np.arange(10, 1990), 16, replace=False), [0, 700, 701, 1999])
    values[at, 3:] += np.where(random.random((20, 3)) < 0.5, -1.0, 1.0) * random.uniform(0.1, 1.0, (20, 3))
    wild = replace(track.twist, values=values)
    left = residual(replace(track, twist=wild), 1e-6)
    assert left is not None
    assert not (left.explained and left.told)
    tame = without_spikes(wild, track.pose, False)
    assert [each.unit for each in tame.spikes] == ["rad/s"]
    assert sorted(at) == (tame.spikes[0].time_ns // 20_000_000).tolist()
    left = residual(replace(track, twist=tame), 1e-6)
    assert left is not None
    assert left.explained
    assert left.told


@pytest.mark.parametrize("seed", [88, 154, 402, 524])
def test_beside_missing_samples_there_is_no_spike(seed: int) -> None:
    """A sample in a gap, as of random stamps, is as far away as a body gets in that time."""
    made = recording(seed)
    track = read_track(replace(made.bag, topics={n: t for n, t in made.bag.topics.items() if n != "/b/pose"}))
    assert track.twist is not None
    assert track.pose is None
    assert not track.twist.spikes


def test_spikes_are_named_with_their_size_and_time() -> None:
    motion = spin(noise=1e-3)
    rows = np.hstack([rotate_all_inverse(motion.orientation_xyzw, motion.velocity), motion.rate])
    rows += 1e-3 * np.random.default_rng(1).standard_normal(rows.shape)
    assert not failing(bag_of(motion, twist_rows=rows))
    rows[[100, 500], 4] += [0.5, -2.0]
    rows[300, 0] += 3.0
    ((name, said),) = failing(bag_of(motion, twist_rows=rows)).items()
    assert name == "/b/twist is whole"
    assert "1 is a spike, up to 3 m/s from the samples about them, the largest at t = 3 s" in said
    assert "2 are spikes, up to 2 rad/s from the samples about them, the largest at t = 5 s" in said


@pytest.mark.parametrize("rate", [0.0, 1.0])
def test_so_are_those_of_a_twist_that_stands_still(rate: float) -> None:
    """The least step is that of a spike, and was taken for the steps of the sensor."""
    motion = spin(rate=rate, speed=0.0, noise=1e-3)
    rows = np.hstack([np.zeros((1000, 3)), np.round(motion.rate, 3)])
    rows[::60, 4] += 0.02
    assert not failing(bag_of(motion, twist_rows=rows))
    rows[::60, 4] -= 0.02
    rows[[100, 500, 501], 4] += [5.0, -7.0, -7.0]
    told = failing(bag_of(motion, twist_rows=rows))
    assert "3 are spikes, up to 7 rad/s" in told["/b/twist is whole"]


@pytest.mark.parametrize("noise", [0.005, 0.02])
@pytest.mark.parametrize("missing", [False, True])
def test_quick_turns_that_the_pose_cannot_show_are_no_spikes(noise: float, missing: bool) -> None:
    """In its noise, or where samples are missing, they were accused and replaced."""
    random, time_ns = np.random.default_rng(1), np.arange(1000) * 50_000_000
    rate = np.zeros(1000)
    rate[50:950:60] = 1.5
    angle = np.cumsum(0.05 * 0.5 * (rate + np.roll(rate, 1))) + (1e-4 if missing else noise) * random.normal(size=1000)
    poses = np.zeros((1000, 7))
    poses[:, 5], poses[:, 6] = np.sin(0.5 * angle), np.cos(0.5 * angle)
    twists = 1e-3 * random.normal(size=(1000, 6))
    twists[:, 5] += rate
    kept = ~np.isin(np.arange(1000) % 60, (49, 51)) | (not missing)
    pose, twist = (TimeSeries(name, time_ns[kept], rows[kept]) for name, rows in (("/p", poses), ("/t", twists)))
    assert not without_spikes(twist, pose, False).spikes
    if noise == 0.005 and not missing:
        still = poses * 0.0 + [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        assert len(without_spikes(twist, TimeSeries("/p", time_ns, still), False).spikes[0].size) == 15


@pytest.mark.parametrize("quick", [1, 2, 3])
def test_what_the_pose_shows_too_is_motion(quick: int) -> None:
    """A body that turns quickly for a few samples, as seen by a slow recorder."""
    rate = np.zeros((1000, 3))
    for at in (200, 500, 800):
        rate[at : at + quick, 2] = 2.0
    angle = np.cumsum(0.5 * 0.01 * (rate[:, 2] + np.roll(rate[:, 2], 1)))
    motion = spin(rate=0.0)
    motion.orientation_xyzw = np.stack([0 * angle, 0 * angle, np.sin(0.5 * angle), np.cos(0.5 * angle)], axis=1)
    rows = np.hstack([0.0 * rate, rate]) + 1e-4 * np.random.default_rng(quick).standard_normal((1000, 6))
    for turns in (motion, spin(rate=0.0)):
        twist = read_track(bag_of(turns, twist_rows=rows)).twist
        assert twist is not None
        assert len(twist.spikes) == (turns is not motion)


@pytest.mark.parametrize("slower", [1, 2, 5])
@pytest.mark.parametrize("offset_ns", [0, 3_000_000])
def test_so_is_what_a_slower_pose_shows_a_part_of(slower: int, offset_ns: int) -> None:
    """A body that turns quickly for one sample: the differences of a pose show less of it, the slower the pose is."""
    random, time_ns = np.random.default_rng(slower), np.arange(1000) * 10_000_000
    twists = 1e-4 * random.normal(size=(1000, 6))
    twists[[200, 333, 500, 801], 5] += 2.0
    finely = np.arange(10_000) * 1_000_000
    rate = np.interp(finely, time_ns, twists[:, 5])
    angle = np.append(0.0, np.cumsum(0.5e-3 * (rate[1:] + rate[:-1])))
    pose_ns = time_ns[:-1:slower] + offset_ns
    turned = 0.5 * np.interp(pose_ns, finely, angle) + 1e-5 * random.normal(size=len(pose_ns))
    for half in (turned, 0.0 * turned):
        poses = np.zeros((len(pose_ns), 7))
        poses[:, 5], poses[:, 6] = np.sin(half), np.cos(half)
        found = without_spikes(TimeSeries("/t", time_ns, twists), TimeSeries("/p", pose_ns, poses), False).spikes
        assert [len(each.size) for each in found] == ([] if half is turned else [4])


def test_rounding_is_no_spike() -> None:
    motion = spin()
    motion.velocity = np.tile([1.0, 0.0, 0.0], (1000, 1))
    motion.position = motion.velocity * motion.time_ns[:, None] * 1e-9
    rows = np.hstack([motion.velocity, rotate_all(motion.orientation_xyzw, motion.rate)])
    rows[::50, 0] += 2.0**-52
    rows[333, 0] += 2.0**-39
    assert not failing(bag_of(motion, twist_frame="world", twist_rows=rows))


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("every_ns", [5_000_000, 100_000_000])
def test_positions_that_come_back_are_spikes_and_an_impact_is_none(noise: float, every_ns: int) -> None:
    for seed in range(40):
        random, seconds = np.random.default_rng(seed), np.arange(1200) * every_ns * 1e-9
        away, hit = random.standard_normal((2, 3))
        positions = away * seconds[:, None] + 5.0 * hit * np.maximum(seconds - seconds[600], 0.0)[:, None]
        turn = random.uniform(0.0, 4.0) * seconds
        positions += np.stack([np.cos(turn), np.sin(turn), -4.905 * seconds**2], axis=1)
        positions += noise * random.standard_normal((1200, 3))
        series = TimeSeries("/p", np.arange(1200) * every_ns, positions)
        assert spikes_of_position(series, None) is None
        positions[[300, 301, 900], 1] += 5.0
        found = spikes_of_position(series, None)
        assert found is not None
        assert (found.time_ns // every_ns).tolist() == [300, 301, 900]
        assert found.size == pytest.approx(5.0, rel=0.05)


def test_positions_that_a_velocity_follows_are_no_spikes() -> None:
    time_ns, positions = np.arange(1000) * 10_000_000, 1e-4 * np.random.default_rng(1).standard_normal((1000, 3))
    positions[500, 0] += 0.5
    series = TimeSeries("/p", time_ns, positions)
    speeds = np.zeros(1000)
    assert spikes_of_position(series, TimeSeries("/v", time_ns, speeds)) is not None
    speeds[[499, 501]] = 25.0
    assert spikes_of_position(series, TimeSeries("/v", time_ns, speeds)) is None


@pytest.mark.parametrize("noise", [0.0, 1e-2])
def test_attitudes_that_come_back_are_spikes_unless_a_gyro_shows_them(noise: float) -> None:
    for seed in range(20):
        random, time_ns = np.random.default_rng(seed), np.arange(1000) * 10_000_000
        body = RigidBody.from_diagonal(1.0, (1.0, 2.0, 2.5))
        spin = random.uniform(0.01, 5.0) * random.standard_normal(3)
        motion = free_motion(body, State(angular_velocity_body=tuple(spin.tolist())), time_ns * 1e-9)
        attitudes = product(motion.orientation_xyzw, exponentials(noise * random.standard_normal((1000, 3))))
        # Both signs are one attitude.
        attitudes *= random.choice([-1.0, 1.0], (1000, 1))
        gyro = TimeSeries("/w", time_ns, lengths(motion.angular_velocity_body))
        assert spikes_of_attitude(TimeSeries("/q", time_ns, attitudes), None) is None
        at = [300, 301, 302, 900]
        attitudes[at] = product(attitudes[at], exponentials(np.tile([0.0, 0.0, 1.5], (4, 1))))
        series = TimeSeries("/q", time_ns, attitudes)
        for rates in (None, gyro):
            found = spikes_of_attitude(series, rates)
            assert found is not None
            assert (found.time_ns // 10_000_000).tolist() == at
            assert found.size == pytest.approx(1.5, abs=0.1)
        gyro.values[[299, 302, 303, 899, 900]] += 150.0
        assert spikes_of_attitude(series, gyro) is None


def test_a_jump_of_the_attitude_is_no_spike() -> None:
    """It does not come back: the attitudes beside it are as good as the others."""
    seconds = np.arange(200)[:, None] * 0.02
    for seed in range(20):
        random = np.random.default_rng(seed)
        rate, other = random.uniform(0.05, 5.0, (2, 1)) * random.standard_normal((2, 3))
        jump = exponentials(random.standard_normal((1, 3)))
        after = product(jump, exponentials(seconds[:100] * other))
        attitudes = np.vstack(
            [exponentials(seconds[:100] * rate), product(exponentials(seconds[99:100] * rate), after)]
        )
        series = TimeSeries("/q", np.arange(200) * 20_000_000, attitudes)
        assert spikes_of_attitude(series, None) is None


@pytest.mark.parametrize("second", [1, 91])
def test_a_sample_at_an_end_beside_missing_ones_is_no_spike(second: int) -> None:
    """The other samples are far from it, as from the one beside it."""
    for seed in range(40):
        random = np.random.default_rng(seed)
        number = np.arange(94) + 4 * (np.arange(94) > second)
        velocity = random.standard_normal(3)
        rows = number[:, None] * velocity + 1e-3 * random.standard_normal((94, 3))
        assert spikes_of_position(TimeSeries("/p", (number * 1e7).astype(np.int64), rows), None) is None
        attitudes = exponentials(0.05 * rows)
        assert spikes_of_attitude(TimeSeries("/q", (number * 1e7).astype(np.int64), attitudes), None) is None


def test_a_pose_comes_back_where_wrenches_push_it_to_and_fro() -> None:
    number = np.arange(200)
    moved = 0.01 * number + np.select([number == 101, number == 102], [0.5, 0.5])
    rows = moved[:, None] * [1.0, 0.5, 0.2]
    pushes = [(np.array([100, 101, 102, 103]) * 10_000_000, np.array([[1.0], [-1.0], [-1.0], [0.0]]) * [2.0, 1.0, 0.4])]
    for found, values in ((spikes_of_position, rows), (spikes_of_attitude, exponentials(rows))):
        series = TimeSeries("/p", number * 10_000_000, values)
        assert found(series, None) is not None
        assert found(series, None, pushes) is None


@pytest.mark.parametrize("apart_ns", [0, 3_000_000])
def test_two_channels_that_are_commanded_together_push_nothing_to_and_fro(apart_ns: int) -> None:
    """Of four spikes of a flight with force and torque commands, one or two were left in beside these."""
    time_ns, positions = np.arange(1000) * 10_000_000, 1e-4 * np.random.default_rng(1).standard_normal((1000, 3))
    positions[500:502, 0] += 0.5
    commands = np.arange(5) * 2_500_000_000
    wrenches = [(commands + each, np.random.default_rng(each).standard_normal((5, 6))) for each in (1, apart_ns + 2)]
    found = spikes_of_position(TimeSeries("/p", time_ns, positions), None, wrenches)
    assert found is not None
    assert (found.time_ns // 10_000_000).tolist() == [500, 501]


def test_without_a_pose_spikes_stand_out_unless_wrenches_could_make_them() -> None:
    """Five wild samples of a gyro in 4000 left nothing known, and a verdict in which they counted as motion."""
    random, time_ns = np.random.default_rng(1), np.arange(4000) * 10_000_000
    twists = 1e-3 * random.standard_normal((4000, 6)) + np.sin(np.arange(4000) * 3e-3)[:, None]
    at = [700, 701, 1500, 2500, 3999]
    twists[at] += 0.5 * random.choice([-1.0, 1.0], (5, 6))
    twist = TimeSeries("/t", time_ns, twists)
    found = without_spikes(twist, None, False)
    assert [each.unit for each in found.spikes] == ["m/s", "rad/s"]
    assert all((each.time_ns // 10_000_000).tolist() == at for each in found.spikes)
    # Two wrenches that turn the body to and fro, among others or alone, may have made one of them.
    alone = np.array([-0.01, 15.0, 15.01]) * 1e9, np.array([[0.0], [1.0], [0.0]])
    every = np.arange(4000.0) * 1e7, 0.01 * random.standard_normal((4000, 1))
    every[1][1500:1502] = [[1.0], [-1.0]]
    for times, rows in (alone, every):
        found = without_spikes(twist, None, False, [(times.astype(np.int64), rows)])
        assert all(1500 not in each.time_ns // 10_000_000 and len(each.size) == 4 for each in found.spikes)


@pytest.mark.parametrize("turned", [slice(None), slice(None, None, -1)])
def test_a_body_that_turns_faster_at_an_end_makes_no_spike(turned: slice) -> None:
    """A command 0.2 s before the last sample made a spike of it: nothing comes back there."""
    steps = np.where(np.arange(500) < 497, 0.014, 0.04)
    rows = np.zeros((500, 6))
    rows[:, 3] = np.cumsum(steps)[turned]
    rows[:, 4:] = 1e-3 * np.random.default_rng(1).standard_normal((500, 2))
    twist = TimeSeries("/twist", np.arange(500) * 50_000_000, rows)
    assert not without_spikes(twist, None, False).spikes
    rows[[0, -1], 3] += 0.2
    (spikes,) = without_spikes(twist, None, False).spikes
    assert spikes.time_ns.tolist() == [0, 499 * 50_000_000]


def test_a_push_just_before_the_last_sample_makes_no_spike() -> None:
    """Differences of the pose show a seventh of it there."""
    number = np.arange(500.0)
    late = (number - 498.7).clip(min=0.0)
    angle, rate = 0.1 * number + 5.0 * late**2, 10.0 + 1000.0 * late
    twist = TimeSeries("/twist", (number * 1e7).astype(np.int64), np.zeros((500, 6)))
    twist.values[:, 3:] = np.column_stack([rate, 0.0 * rate, 0.0 * rate])
    twist.values[:, 3:] += 1e-3 * np.random.default_rng(1).standard_normal((500, 3))
    pose = replace(twist, values=np.hstack([np.zeros((500, 3)), exponentials(angle[:, None] * [1.0, 0.0, 0.0])]))
    push = [(np.array([0, 4_987_000_000]), np.array([[0.0], [1.0]]))]
    assert without_spikes(twist, pose, False).spikes
    assert not without_spikes(twist, pose, False, push).spikes
