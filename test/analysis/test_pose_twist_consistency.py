"""A twist that contradicts the pose is reported with the convention that reconciles them; balances are not blamed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from noisy_recordings import recording, scene_of
from tumbling import Tumble, bag_of, checks_of, failing, in_world, spin

from rb_dynamics.analysis.pose_twist_consistency import agreements
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import summarize
from rb_dynamics.numerics.rotation_arrays import rotate_all, rotate_all_inverse

TURNS, MOVES = "angular velocity fits the attitude", "linear velocity fits the position"
BALL = scene_of(5.0, np.diag([1.0, 1.0, 1.0]), (0.0, 0.0, 0.0))


def precessing() -> Tumble:
    """Return a body whose spin axis is not constant in any axes."""
    motion = spin(rate=2.0)
    t = motion.time_ns[:, None] * 1e-9
    zeros, half = np.zeros_like(t), 0.5 * 1.5 * t
    turn = np.hstack([zeros, zeros, np.sin(half), np.cos(half)])
    axis, w = turn[:, :3], turn[:, 3:]
    other = motion.orientation_xyzw
    vector = w * other[:, :3] + other[:, 3:] * axis + np.cross(axis, other[:, :3])
    motion.orientation_xyzw = np.hstack([vector, w * other[:, 3:] - np.sum(axis * other[:, :3], axis=1)[:, None]])
    motion.rate = motion.rate + rotate_all_inverse(motion.orientation_xyzw, np.tile([0.0, 0.0, 1.5], (len(t), 1)))
    return motion


def body_twist(motion: Tumble) -> Any:
    return np.hstack([rotate_all_inverse(motion.orientation_xyzw, motion.velocity), motion.rate])


WRONG: dict[str, tuple[Callable[[Tumble], Any], dict[str, str]]] = {
    "world axes": (in_world, {TURNS: "read in world axes", MOVES: "read in world axes"}),
    "opposite sign": (lambda m: -body_twist(m), {TURNS: "with the opposite sign", MOVES: "with the opposite sign"}),
    "degrees": (
        lambda m: body_twist(m) * np.repeat([1.0, 180.0 / np.pi], 3),
        {TURNS: "read in degrees per second"},
    ),
    "velocity in world axes": (
        lambda m: np.hstack([m.velocity, m.rate]),
        {MOVES: "read in world axes"},
    ),
    "converted from degrees twice": (
        lambda m: body_twist(m) * np.repeat([1.0, np.pi / 180.0], 3),
        {TURNS: "read multiplied by 180/π"},
    ),
    "an axis with the wrong sign": (
        lambda m: body_twist(m) * np.array([1.0, 1.0, 1.0, 1.0, -1.0, 1.0]),
        {TURNS: "read with (x, -y, z) for its (x, y, z) it fits to"},
    ),
    "axes in another order": (
        lambda m: body_twist(m)[:, [0, 2, 1, 3, 5, 4]] * np.array([1.0, 1.0, -1.0, 1.0, 1.0, -1.0]),
        {TURNS: "read with (x, -z, y) for its (x, y, z)", MOVES: "read with (x, -z, y) for its (x, y, z)"},
    ),
    "another spin": (lambda m: body_twist(m)[::-1], {TURNS: "contradict each other by", MOVES: "contradict"}),
    "it was not filled in": (lambda m: np.zeros((1000, 6)), {TURNS: "always zero", MOVES: "always zero"}),
}


def test_a_twist_that_stands_still_for_a_while_is_told() -> None:
    """The median over all windows misses it, and the torque it implies would show as a residual."""
    motion = precessing()
    rows = body_twist(motion)
    rows[300:600] = rows[300]
    detail = failing(bag_of(motion, twist_rows=rows))[TURNS]
    assert "in 30 % of them they contradict each other" in detail
    rows[330:600] = body_twist(motion)[330:600]
    assert TURNS not in failing(bag_of(motion, twist_rows=rows))


@pytest.mark.parametrize("ticks", [2, 10, 20])
def test_stamps_coarser_than_the_samples_are_no_lag(ticks: int) -> None:
    """Of each stamp the first pose stood against the mean of all twists: a twist of the same messages was ahead."""
    motion = precessing()
    motion.time_ns = motion.time_ns // (ticks * 10_000_000) * (ticks * 10_000_000)
    assert not failing(bag_of(motion))
    found = {each.name: each.detail for each in checks_of(bag_of(motion))}
    assert not any("ahead" in found[each] or "lags" in found[each] for each in (TURNS, MOVES))
    repeated, clock = 1000 - 1000 // ticks, f"a clock that ticks every {0.01 * ticks:g} s"
    assert f"{repeated} have the stamp of the one before, as of {clock}" in found["/b/pose is whole"]


@pytest.mark.parametrize("lag_ms", [50, -50, pytest.param(10, marks=pytest.mark.slow), 400])
def test_a_twist_that_lags_the_pose_is_told_with_its_lag(lag_ms: int) -> None:
    motion = precessing()
    bag = bag_of(motion, twist=motion.moved(lag_ms * 1_000_000), wrench=True)
    turning, _ = agreements(read_track(bag))
    aligned = turning.aligned
    assert aligned.lag_s == pytest.approx(1e-3 * lag_ms, abs=8.0 * aligned.lag_error_s)
    assert aligned.lag_error_s < 1e-4
    assert (aligned.scale, aligned.turn) == (0.0, 0.0)
    summary = summarize(read_track(bag, BALL))
    assert summary.residual is None
    assert not [check.name for check in summary.checks if "balance" in check.name and check.judged]
    large = abs(lag_ms) > 15
    words = f"the twist {'lags behind' if lag_ms > 0 else 'is ahead of'} the pose by {abs(lag_ms)}"
    found = {check.name: check for check in summary.checks}
    assert found[TURNS].passed == found[MOVES].passed == (not large)
    assert words in found[TURNS].detail
    reason = "pose and twist contradict each other" if large else words
    assert reason in found["inertia explains the motion"].detail


@pytest.mark.parametrize(
    ("of", "factor"), [(slice(0, 1000), 1.2), (slice(500, 1000), 1.2), (slice(0, 300), 180.0 / np.pi)]
)
def test_a_twist_of_another_scale_is_told_also_of_a_part(of: slice, factor: float) -> None:
    motion = precessing()
    rows = body_twist(motion)
    rows[of, 3:] *= factor
    summary = summarize(read_track(bag_of(motion, twist_rows=rows, wrench=True), BALL))
    assert summary.residual is None
    detail = {check.name: check.detail for check in summary.checks if not check.passed}[TURNS]
    whole = of == slice(0, 1000)
    assert ("the twist has 1.2 ±" if whole else "for a while one of the two stood still, had another scale") in detail


@pytest.mark.slow
def test_a_moment_in_degrees_is_not_taken_for_a_torque() -> None:
    """A single window is too little for a contradiction, and a torque too much of a conclusion."""
    motion = precessing()
    rows = body_twist(motion)
    rows[910:, 3:] *= 180.0 / np.pi
    summary = summarize(read_track(bag_of(motion, twist_rows=rows, wrench=True), BALL))
    assert summary.passed
    assert summary.residual is None
    detail = {check.name: check.detail for check in summary.checks}["inertia explains the motion"]
    assert detail == "not judged; pose and twist contradict each other for a moment"


def test_a_twist_in_axes_of_its_own_is_told() -> None:
    """A misaligned gyro implies a torque that does not exist."""
    motion = precessing()
    turn = np.array([[1.0, -0.1, 0.0], [0.1, 1.0, 0.0], [0.0, 0.0, 1.0]]) / np.array([[np.hypot(1, 0.1)] * 2 + [1.0]]).T
    rows = body_twist(motion)
    turning, _ = agreements(
        read_track(bag_of(motion, twist_rows=np.hstack([rows[:, :3] @ turn.T, rows[:, 3:] @ turn.T])))
    )
    assert turning.contradicts
    assert turning.aligned.turn == pytest.approx(0.1, abs=2e-3)


def test_a_lag_too_small_for_a_contradiction_is_none_where_physics_holds() -> None:
    motion = spin()
    summary = summarize(read_track(bag_of(motion, twist=motion.moved(3_000_000), wrench=True), BALL))
    assert summary.passed


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_with_a_twist_is_told(wrong: str) -> None:
    motion = precessing()
    said, expected = WRONG[wrong]
    found = failing(bag_of(motion, twist_rows=said(motion)))
    assert {*found} == {*expected}
    for name, words in expected.items():
        assert words in found[name]


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ((-1, -2, -3, 4), "read with attitudes from world to body it fits"),
        ((4, 1, 2, 3), "read with (w, x, y, z) for the (x, y, z, w) of attitudes it fits"),
        ((4, -1, -2, -3), "read with (w, x, y, z) for the (x, y, z, w) of attitudes from world to body it fits"),
    ],
)
def test_a_quaternion_of_another_convention_is_told(order: tuple[int, ...], words: str) -> None:
    motion = precessing()
    rows = body_twist(motion)
    motion.orientation_xyzw = motion.orientation_xyzw[:, np.abs(order) - 1] * np.sign(order)
    assert words in failing(bag_of(motion, twist_rows=rows))[TURNS]


def test_a_recording_of_a_second_is_judged() -> None:
    motion = precessing().taken(np.arange(100))
    assert "in degrees per second" in failing(bag_of(motion, twist_rows=WRONG["degrees"][0](motion)))[TURNS]


def test_a_recording_that_often_lacks_a_sample_is_judged() -> None:
    """No second has half a second without a gap."""
    motion = precessing().taken(np.flatnonzero(np.arange(1000) % 40))
    assert TURNS not in failing(bag_of(motion))
    assert "in degrees per second" in failing(bag_of(motion, twist_rows=WRONG["degrees"][0](motion)))[TURNS]


@pytest.mark.parametrize("every", [50, 10])
def test_quaternions_that_were_not_filled_in_make_no_factor(every: int) -> None:
    motion = precessing()
    twist_rows = body_twist(motion)
    motion.orientation_xyzw[1::every] = 0.0
    bag = bag_of(motion, twist_rows=twist_rows)
    assert list(failing(bag)) == ["quaternion is unit"]
    assert not any(each.contradicts or each.words for each in agreements(read_track(bag)))


def test_a_wrong_sign_of_an_axis_about_which_the_body_turns_little_is_told() -> None:
    """The difference is small beside the whole rate; it used to pass, and no inertia then explained the motion."""
    motion, axis = spin(rate=2.0), np.array([0.8, 0.08, np.sqrt(1.0 - 0.8**2 - 0.08**2)])
    half = motion.time_ns[:, None] * 1e-9
    motion.orientation_xyzw = np.hstack([np.sin(half) * axis, np.cos(half)])
    motion.rate = np.tile(2.0 * axis, (len(half), 1))
    rows = body_twist(motion) * np.array([1.0, 1.0, 1.0, 1.0, -1.0, 1.0])
    assert "contradict each other by 13.5 %" in (told := failing(bag_of(motion, twist_rows=rows))[TURNS])
    assert "read with (x, -y, z) for its (x, y, z)" in told


def test_a_twist_said_to_be_in_world_axes_that_is_not_is_told() -> None:
    motion = precessing()
    found = failing(bag_of(motion, twist_frame="world", twist_rows=body_twist(motion)))
    assert "read in body axes" in found[TURNS]
    assert "read in body axes" in found[MOVES]


def test_physics_is_not_blamed_for_a_contradiction() -> None:
    motion = precessing()
    summary = summarize(read_track(bag_of(motion, twist_rows=in_world(motion), wrench=True), BALL))
    assert summary.residual is None
    unknown = {check.name: check.detail for check in summary.checks if not check.judged}
    assert unknown["inertia explains the motion"] == "not judged; pose and twist contradict each other"
    assert {*unknown} > {f"{name} balance" for name in ("energy", "angular momentum", "linear momentum")}
    assert {check.name for check in summary.checks if not check.passed} == {TURNS, MOVES}


@pytest.mark.parametrize("seed", range(8))
def test_noise_jitter_and_other_rates_are_no_contradiction(seed: int) -> None:
    random = np.random.default_rng(seed)
    motion = spin(
        rate=random.uniform(0.0, 5.0),
        speed=random.uniform(0.0, 2.0),
        noise=10 ** random.uniform(-5.0, -2.0),
        stamps=("even", "jitter", "random")[seed % 3],
        seed=seed,
    )
    slow = motion.taken(np.arange(0, 1000, 4))
    noise = 0.01 * random.standard_normal((1000, 6)) + 0.01
    fast = {"twist": motion, "twist_rows": body_twist(motion) + noise}
    for bag in (bag_of(slow, **fast), bag_of(motion, twist=slow), recording(seed).bag):
        assert not any(each.contradicts or each.aligned.words for each in agreements(read_track(bag)))


def test_what_is_too_slow_too_fast_or_of_another_time_is_not_judged() -> None:
    still = {check.name: check.detail for check in checks_of(bag_of(spin(0.0, 0.0))) if not check.judged}
    assert {*still} == {TURNS, MOVES}
    fast = spin(rate=120.0)
    assert "turns by more than 1 rad" in {c.name: c.detail for c in checks_of(bag_of(fast)) if not c.judged}[TURNS]
    later = agreements(read_track(bag_of(spin(), twist=spin().moved(20_000_000_000))))
    assert [each.reason for each in later] == ["/b/pose and /b/twist are not of the same time"] * 2


def test_of_a_few_samples_it_is_said_that_they_are_few() -> None:
    """They were said not to be of the same time."""
    found = agreements(read_track(bag_of(spin(count=4))))
    assert [each.reason for each in found] == ["/b/pose and /b/twist have too few samples of the same time"] * 2


@pytest.mark.parametrize("arm", [(0.02, 0.03, -0.01), (0.2, 0.3, -0.1)])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_the_pose_of_a_marker_is_told_and_no_turned_axes(arm: tuple[float, float, float], noise: float) -> None:
    """Its velocity has a part ω × r, which looked like axes turned by several degrees."""
    motion = precessing()
    body = body_twist(motion)
    motion.position = motion.position + rotate_all(motion.orientation_xyzw, np.tile(np.array(arm), (1000, 1)))
    motion.position += noise * np.random.default_rng(3).standard_normal((1000, 3))
    found = {each.of: each for each in agreements(read_track(bag_of(motion, twist_rows=body)))}["position"]
    assert found.arm == pytest.approx(arm, abs=max(8.0 * found.arm_error, 1e-4))
    assert not found.aligned.words
    told = [check.detail for check in checks_of(bag_of(motion, twist_rows=body)) if check.name == MOVES]
    assert "the pose is of a point (" in told[0]
    assert "axes turned" not in told[0]


def rolling(every_ns: int, count: int, spin_up: float, rate: float = 0.0, thrust: float = 0.0) -> Tumble:
    """Return a body whose rate about z grows from `rate` by `spin_up`, rad/s^2; one of constant rate has a thrust."""
    time_ns = every_ns * np.arange(count)
    t = time_ns * 1e-9
    omega, half, flat = rate + spin_up * t, 0.5 * (rate + 0.5 * spin_up * t) * t, np.zeros_like(t)
    speed, radius = (thrust / rate, thrust / rate**2) if thrust else (0.0, 0.0)
    return Tumble(
        time_ns,
        np.column_stack([0.5 * t - radius * np.cos(rate * t), -radius * np.sin(rate * t), flat]),
        np.column_stack([flat, flat, np.sin(half), np.cos(half)]),
        np.column_stack([0.5 + speed * np.sin(rate * t), -speed * np.cos(rate * t), flat]),
        np.column_stack([flat, flat, omega]),
    )


@pytest.mark.parametrize("noise", [0.2, 0.4])
def test_a_gyro_whose_noise_is_larger_than_the_rate_contradicts_nothing(noise: float) -> None:
    motion = rolling(100_000_000, 200, 0.0, 0.05)
    rows = np.hstack([rotate_all_inverse(motion.orientation_xyzw, motion.velocity), motion.rate])
    rows[:, 3:] += noise * np.random.default_rng(1).standard_normal((200, 3))
    of_attitude = agreements(read_track(bag_of(motion, twist_rows=rows)))[0]
    assert not of_attitude.contradicts
    assert not of_attitude.partly
    assert "as noisy as these" in of_attitude.reason
    # Another handedness is still found beneath less of it.
    rows[:, 3:] = noise / 40.0 * np.random.default_rng(1).standard_normal((200, 3)) - motion.rate
    assert agreements(read_track(bag_of(motion, twist_rows=rows)))[0].contradicts


def test_interpolation_between_rare_samples_is_no_contradiction_and_hides_no_torque() -> None:
    """At 0.75 rad from sample to sample it explains 14 % of a window, which was called a contradiction."""
    summary = summarize(read_track(bag_of(rolling(50_000_000, 300, 1.0), wrench=True), BALL))
    assert summary.residual is not None
    assert not summary.residual.explained
    assert summary.residual.strongest.torque_body == pytest.approx([0.0, 0.0, 1.0], abs=0.01)
    rare = agreements(read_track(bag_of(rolling(50_000_000, 200, 0.0, 16.0))))[1]
    assert rare.rare
    assert not rare.contradicts
    assert rare.error is not None
    assert rare.error > 0.1
    # With a twist rarer still it is more than a contradiction.
    motion = rolling(50_000_000, 400, 0.0, 10.0)
    assert (
        "as interpolation" in agreements(read_track(bag_of(motion, twist=motion.taken(np.arange(0, 400, 4)))))[1].reason
    )


@pytest.mark.parametrize("scene", [None, BALL])
def test_a_leading_slash_makes_no_frame_another(scene: Any) -> None:
    motion = spin()
    track = read_track(bag_of(motion, twist_frame="/world", twist_rows=in_world(motion)), scene)
    assert track.twist_in_world
    assert not any(found.words for found in agreements(track))


def test_interpolation_is_neither_a_lever_arm_nor_a_factor() -> None:
    motion = rolling(100_000_000, 200, 0.0, 5.0, 2.0)
    (found,) = agreements(read_track(bag_of(motion, twist_frame="world", twist_rows=in_world(motion))))[1:]
    assert not found.words
    motion.position += rotate_all(motion.orientation_xyzw, np.tile([0.3, 0.2, 0.0], (200, 1)))
    (found,) = agreements(read_track(bag_of(motion, twist_frame="world", twist_rows=in_world(motion))))[1:]
    assert found.arm is not None
    assert float(np.linalg.norm(np.subtract(found.arm, (0.3, 0.2, 0.0)))) < found.arm_error < 0.1
    motion = precessing()
    for every in (20, 30, 40):
        turning, _ = agreements(read_track(bag_of(motion, twist=motion.taken(np.arange(0, 1000, every)))))
        assert not turning.words


def of_degrees(motion: Tumble) -> Any:
    """Return attitudes whose Euler angles in degrees were taken for radians."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler(
        "xyz", Rotation.from_quat(motion.orientation_xyzw).as_euler("xyz", degrees=True)
    ).as_quat()


@pytest.mark.parametrize("how", ["degrees", "random"])
def test_attitudes_that_leap_are_no_noise(how: str) -> None:
    """The pose turns by a radian between samples and the twist by a hundredth of it: one of them is wrong."""
    motion = precessing()
    attitudes = np.random.default_rng(4).standard_normal((1000, 4))
    attitudes /= np.linalg.norm(attitudes, axis=1, keepdims=True)
    wrong = replace(motion, orientation_xyzw=of_degrees(motion) if how == "degrees" else attitudes)
    summary = summarize(read_track(bag_of(wrong, twist_rows=body_twist(motion), wrench=True), BALL))
    failed = {check.name: check.detail for check in summary.checks if not check.passed}
    assert "while the angular velocity turns the body by" in failed[TURNS]
    assert "the attitude leaps" in failed["/b/pose has no jumps"]
    assert summary.residual is None
    assert not any(check.judged for check in summary.checks if "balance" in check.name or "explains" in check.name)


def test_fast_turns_and_a_few_leaps_are_no_contradiction() -> None:
    """The rates explain the one; of the other the checks of jumps tell. A pose held between measurements leaps less."""
    for motion in (spin(rate=120.0), spin(rate=150.0, stamps="random")):
        assert not any(each.leaps for each in agreements(read_track(bag_of(motion))))
    motion = spin()
    motion.orientation_xyzw[::50] = motion.turned(2.0)[::50]
    assert not any(each.leaps for each in agreements(read_track(bag_of(motion))))
    held = spin(rate=3.0).taken(np.arange(1000) // 50 * 50, keep_times=True)
    assert not any(each.leaps for each in agreements(read_track(bag_of(held, twist=spin(rate=3.0)))))


def test_what_is_all_noise_explains_nothing() -> None:
    """It was said that an inertia explains the motion up to noise as large as the whole angular momentum."""
    # Between two samples the body turns so far that attitudes at random contradict no rates.
    motion = spin(rate=2.0, count=20_000).taken(np.arange(0, 20_000, 40))
    attitudes = np.random.default_rng(5).standard_normal((500, 4))
    attitudes /= np.linalg.norm(attitudes, axis=1, keepdims=True)
    rows, motion = body_twist(motion), replace(motion, orientation_xyzw=attitudes)
    summary = summarize(read_track(bag_of(motion, twist_rows=rows, wrench=True), BALL))
    (check,) = [each for each in summary.checks if each.name == "inertia explains the motion"]
    assert not check.judged
    assert check.detail == "not judged; the noise of the recording hides it"


@pytest.mark.parametrize("every", [20, 100, 300])
def test_a_body_at_rest_whose_position_rounding_takes_away_and_back_has_a_twist(every: int) -> None:
    """It was said that the twist, which is zero, was not filled in."""
    motion = spin(rate=0.0, speed=0.0)
    motion.position[:, 0] += 1e-3 * (np.arange(1000) // every % 2)
    assert not failing(bag_of(motion))
