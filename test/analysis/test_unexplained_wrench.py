"""The residual of a bag from another program is zero for the right body and identifies it if another one is given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from noisy_recordings import scene_of
from tumbling import Tumble, bag_of, fill

from rb_dynamics import MemorySink, Setpoint, TopicChoice, Wrench, inspect, simulate
from rb_dynamics.analysis.checks import balanced
from rb_dynamics.analysis.momentum_energy_balance import balances
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import EXPLAINS, MASS_EXPLAINS, _unless_mistimed, summarize
from rb_dynamics.analysis.unexplained_wrench import Residual, residual
from rb_dynamics.cli import main
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.numerics.rotation_arrays import rotate_all_inverse
from rb_dynamics.report.inspection_text import residual_sentence
from rb_dynamics.scene import parse_scene
from rb_dynamics.scene.model import Scene
from rb_dynamics.sinks.mcap_sink import McapSink

TRUE = np.array([[0.5, 0.02, -0.01], [0.02, 0.7, 0.03], [-0.01, 0.03, 0.9]])
OTHER = np.diag([0.5, 0.8, 0.9])
BODY = "body: {frame: base, mass: 4.0, center_of_mass: [0.1, -0.2, 0.05], inertia: {matrix: MATRIX}}"


@pytest.fixture
def judged(bagger: Any) -> Callable[..., Residual]:
    """Return a function that records a run as another program would and computes its residual for this inertia."""
    both = ("/thrust/applied", "/push/applied")

    def judge(
        flight: Any,
        inertia: np.ndarray,
        wrenches: tuple[str, ...] = both,
        noise: float = 0.0,
        unit: float | None = None,
        body: str = BODY,
    ) -> Residual:
        """Return it; `unit` is that of the positions, m, where there is no twist."""
        rows, random = [], np.random.default_rng(1)
        for sample in flight.samples.samples:
            q, t = sample.orientation_xyzw, sample.time_ns
            velocity = rotate_all_inverse(np.array(q), np.array(sample.linear_velocity_world))
            rate = np.array(sample.angular_velocity_body) + noise * random.standard_normal(3)
            place = np.array(sample.position_world) / (unit or 1.0)
            rows.append(("/b/pose", "geometry_msgs/msg/PoseStamped", t, (t, "world", (*place.tolist(), *q))))
            if unit is None:
                rows.append(("/b/twist", "geometry_msgs/msg/TwistStamped", t, (t, "base", (*velocity, *rate))))
        log = read_bag(flight.log)
        for topic in wrenches:
            for time_ns, wrench in log.wrenches(topic):
                frame = "base" if wrench.frame_id == "body" else wrench.frame_id
                values = (time_ns, frame, (*wrench.force, *wrench.torque))
                rows.append((topic, "geometry_msgs/msg/WrenchStamped", time_ns, values))
        scene = parse_scene(body.replace("MATRIX", str(inertia.tolist())))
        left = residual(read_track(read_bag(bagger(rows)), scene), 1e-6)
        assert left is not None
        return left

    return judge


def test_the_body_that_moved_explains_the_motion(flight: Any, judged: Any) -> None:
    left = judged(flight, TRUE)
    assert left.explained
    assert left.scaled
    assert left.relative < 1e-8
    assert left.mass == pytest.approx(4.0, rel=1e-9)
    np.testing.assert_allclose(left.inertia, TRUE, rtol=0, atol=1e-4)
    assert max(left.root_mean_square) < 1e-6


def test_another_inertia_does_not_and_the_right_one_is_found(flight: Any, judged: Any) -> None:
    left = judged(flight, OTHER)
    assert not left.explained
    assert left.relative > 1e-5
    np.testing.assert_allclose(left.inertia, TRUE, rtol=0, atol=1e-4)
    assert left.explainable
    assert "does NOT explain the motion. The best fit, principal moments of " in (said := residual_sentence(left, 0))
    assert " ± " in said


@pytest.mark.parametrize("factor", [1e-4, pytest.param(1e3, marks=pytest.mark.slow)])
def test_an_inertia_in_other_units_is_no_torque_that_nobody_commanded(flight: Any, judged: Any, factor: float) -> None:
    left = judged(flight, factor * TRUE, noise=1e-5)
    assert not left.explained
    assert left.explainable
    assert left.scaled
    np.testing.assert_allclose(left.inertia, TRUE, rtol=0, atol=1e-2)
    assert "does NOT explain the motion. The best fit, principal moments of " in residual_sentence(left, 0)
    # Nor does another size excuse a torque.
    hidden = judged(flight, factor * TRUE, wrenches=("/push/applied",), noise=1e-5)
    assert not hidden.explainable


def test_where_no_inertia_explains_it_the_torque_nobody_commanded_is_named(flight: Any, judged: Any) -> None:
    left = judged(flight, TRUE, wrenches=("/push/applied",))
    assert not left.explained
    assert not left.explainable
    found = left.strongest
    assert (found.start_ns, found.end_ns) == (500_000_000, 700_000_000)
    np.testing.assert_allclose(found.torque_body, [0.2, -0.1, 0.3], atol=2e-3)
    assert found.peak == pytest.approx(np.linalg.norm([0.2, -0.1, 0.3]), rel=1e-2)
    said = residual_sentence(left, 0)
    assert "NO inertia explains the motion" in said
    assert "from t = 0.5 to 0.7 s: (0.2" in said
    assert "principal moments" not in said


@pytest.mark.parametrize(("unit", "name"), [(1.0, ""), (1e-3, "millimetres"), (1e-2, "centimetres")])
def test_positions_in_another_unit_are_named(flight: Any, judged: Any, unit: float, name: str) -> None:
    """The forces were said to tell no mass, and all checks passed."""
    left = judged(flight, TRUE, unit=unit)
    assert left.mass == pytest.approx(4.0, rel=1e-4)
    assert (left.unit, left.mass_explained) == (name, not name)
    assert (f" best if positions are in {name}; with those in m no mass fits" in left.mass_words) == bool(name)


def test_a_mass_far_from_the_one_given_is_doubted(flight: Any, judged: Any) -> None:
    left = judged(flight, TRUE, body=BODY.replace("mass: 4.0", "mass: 4000"))
    assert left.mass == pytest.approx(4.0, rel=1e-4)
    assert left.mass_words.endswith(
        "1000 times less than the 4000 kg given, as of lengths in millimetres or forces in kN"
    )
    assert left.mass_words[0].lower() in residual_sentence(left, 0).lower()


def test_without_a_torque_only_the_ratios_are_told(coasting: Any, judged: Any) -> None:
    twice = judged(coasting, 2.0 * TRUE)
    assert twice.explained
    assert not twice.scaled
    assert twice.mass is None
    other = judged(coasting, OTHER)
    assert not other.explained
    assert np.trace(other.inertia) == pytest.approx(2.2)
    assert other.best < 1e-3 * other.relative


def test_noise_does_not_condemn_the_right_inertia(flight: Any, judged: Any) -> None:
    noisy = judged(flight, TRUE, noise=1e-5)
    assert noisy.explained
    assert noisy.relative > 1e-6
    other = judged(flight, OTHER, noise=1e-5)
    assert not other.explained
    assert other.explainable


def test_what_nobody_recorded_is_the_residual(flight: Any, judged: Any) -> None:
    left = judged(flight, TRUE, wrenches=())
    during = (left.time_ns > 1_000_000_000) & (left.time_ns <= 2_240_000_000)
    np.testing.assert_allclose(left.force_world[during], np.tile([1.0, -2.0, 0.5], (int(during.sum()), 1)), atol=1e-9)
    np.testing.assert_allclose(left.force_world[left.time_ns > 2_270_000_000], 0.0, atol=1e-9)


def test_an_own_log_is_not_judged(flight: Any) -> None:
    assert residual(read_track(read_bag(flight.log)), 1e-6) is None


def on_wheels(noise: float, rate: Callable[[np.ndarray], np.ndarray], wrench: bool) -> Residual:
    """Return the residual of a robot that drives on the ground and turns about its vertical axis."""
    random, t = np.random.default_rng(4), np.arange(1500) * 0.02
    turn = rate(t)
    yaw = np.concatenate([[0.0], np.cumsum(0.01 * (turn[1:] + turn[:-1]))])
    flat = np.zeros_like(t)
    attitude = np.column_stack([flat, flat, np.sin(0.5 * yaw), np.cos(0.5 * yaw)])
    measured = np.column_stack([flat, flat, turn]) + noise * random.standard_normal((1500, 3))
    motion = Tumble((t * 1e9).astype(np.int64), np.zeros((1500, 3)), attitude, np.zeros((1500, 3)), measured)
    scene = scene_of(46.0, np.diag([0.6, 1.5, 1.7]), (0.0, 0.0, 0.1))
    left = residual(read_track(bag_of(motion, wrench=wrench), scene), 1e-6)
    assert left is not None
    return left


@pytest.mark.parametrize("noise", [pytest.param(0.0, marks=pytest.mark.slow), 1e-3])
@pytest.mark.parametrize("wrench", [True, False])
def test_a_robot_on_the_ground_tells_of_a_torque_and_nothing_of_its_inertia(noise: float, wrench: bool) -> None:
    """The best fit was an inertia of zero about the only axis, which leaves nothing."""
    left = on_wheels(noise, lambda t: 0.5 * np.sin(0.4 * t), wrench)
    assert left.axis is not None
    np.testing.assert_allclose(left.axis, [0.0, 0.0, 1.0], atol=1e-3)
    np.testing.assert_allclose(left.inertia, np.diag([0.6, 1.5, 1.7]), rtol=1e-4, atol=1e-4)
    assert left.best == pytest.approx(left.relative, rel=1e-3)
    said = residual_sentence(left, 0)
    given = "with the commands as recorded" if wrench else "without a torque, and none is recorded"
    assert f"NO inertia explains the motion {given}. " in said
    assert f"a torque that was not {'commanded' if wrench else 'recorded'}" in said
    assert (
        "turns about one axis only, (0, 0, 1) in body axes: without recorded torques, the recording tells nothing"
        in said
    )


def not_turning(speed: float, torque: float | None) -> Residual:
    """Return the residual of a body that does not turn, with a torque commanded from 1 s on."""
    t, flat = np.arange(500) * 0.02, np.zeros((500, 3))
    velocity = np.tile([speed, 0.0, 0.0], (500, 1))
    motion = Tumble(np.rint(t * 1e9).astype(np.int64), velocity * t[:, None], np.eye(4)[[3] * 500], velocity, flat)
    bag = bag_of(motion, wrench=torque is not None)
    if torque is not None:
        fill(bag.topics["/w"], motion.time_ns[50:51], "base", np.array([[0.0, 0.0, 0.0, torque, 0.0, 0.0]]), 0)
    left = residual(read_track(bag, scene_of(4.0, TRUE, (0.0, 0.0, 0.0))), 1e-6)
    assert left is not None
    return left


@pytest.mark.parametrize("speed", [0.0, 0.1])
def test_a_body_that_does_not_turn_tells_nothing_of_its_inertia(speed: float) -> None:
    """Nothing was judged, and it was said that the inertia explains the motion."""
    for torque in (None, 0.0):
        left = not_turning(speed, torque)
        assert not left.told
        assert "CANNOT TELL whether the inertia given explains the motion: a body with" in residual_sentence(left, 0)


def test_a_body_that_does_not_turn_despite_a_torque_is_not_explained() -> None:
    """Its rates are zero, and so was what was left relative to them."""
    left = not_turning(0.0, 0.03)
    assert not left.explained
    assert not left.explainable
    assert left.relative == left.best > 0.1


def test_a_few_samples_of_rest_tell_nothing_either() -> None:
    count = 12
    flat = np.zeros((count, 3))
    motion = Tumble(np.arange(count) * 20_000_000, flat, np.eye(4)[[3] * count], flat, flat)
    left = residual(read_track(bag_of(motion), scene_of(4.0, TRUE, (0.0, 0.0, 0.0))), 1e-6)
    assert left is not None
    assert not left.told


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_steady_turn_about_one_axis_tells_nothing_of_the_inertia(noise: float) -> None:
    left = on_wheels(noise, lambda t: np.full_like(t, 0.5), True)
    assert left.explained
    assert not left.told
    assert "any other would do as well" in residual_sentence(left, 0)


def test_what_a_wheel_does_is_no_torque_that_nobody_recorded(tmp_path: Path) -> None:
    """The part of a log is as a recording of a node with a wheel: its momentum was taken for a torque."""
    text = (
        BODY.replace("MATRIX", str(TRUE.tolist()))
        + """
initial: {angular_velocity_body: [0.3, 0.5, -0.2]}
wrenches: []
actuators: [{type: reaction_wheel, name: wheel, axis: [0, 1, 0], inertia: 0.01, max_torque: 0.1}]
duration: 4
"""
    )
    log, part = tmp_path / "run.mcap", tmp_path / "part.mcap"
    simulate(parse_scene(text), [("wheel/command", Setpoint(0.1, 10**9))], [McapSink(log)])
    assert main(["convert", str(log), str(part), "--from", "0.5", "--to", "3.5"]) == 0
    for found in (inspect(part), inspect(part, scene=parse_scene(text))):
        assert found.summary.residual is None
        (judged,) = (each for each in found.summary.checks if each.name == "inertia explains the motion")
        assert (judged.judged, judged.passed) == (False, True)
        assert "what turns by /wheels has angular momentum, too" in judged.detail


def test_the_wheel_of_another_body_in_the_bag_does_not_matter(tmp_path: Path) -> None:
    """Two bodies in one bag, each in its namespace. The wheel of the second was taken for one of the first."""
    body = BODY.replace("MATRIX", str(TRUE.tolist())) + "\ninitial: {angular_velocity_body: [0.3, 0.5, -0.2]}\n"
    wheel = "[{type: reaction_wheel, name: wheel, axis: [0, 1, 0], inertia: 0.01, max_torque: 0.1}]"
    one, other = parse_scene(f"{body}duration: 4\n"), parse_scene(f"{body}actuators: {wheel}\nduration: 4\n")
    push = ("wrench", Wrench((0.0, 0.0, 0.0), (0.1, 0.05, 0.0), stamp_ns=10**9))
    simulate(one, [push], [McapSink(tmp_path / "one.mcap", namespace="one")])
    simulate(other, [], [McapSink(tmp_path / "other.mcap", namespace="other")])
    bag = tmp_path / "both.mcap"
    assert main(["convert", *(str(tmp_path / f"{name}.mcap") for name in ("one", "other")), str(bag)]) == 0
    for name, scene, told in (("one", one, "/other/wheels"), ("other", other, "/one/wheels")):
        found = inspect(bag, scene=scene, topics=TopicChoice(pose=f"/{name}/pose", twist=f"/{name}/twist"))
        (judged,) = (each for each in found.summary.checks if each.name == "inertia explains the motion")
        assert told not in judged.detail
        assert judged.judged == (name == "one")


@pytest.mark.parametrize("given", [pytest.param("[0.5, 0.7, 0.9]", marks=pytest.mark.slow), "[0.5, 0.8, 0.9]"])
def test_what_a_magnetorquer_does_is_no_torque_that_nobody_recorded(tmp_path: Path, given: str) -> None:
    """A part of a log has its commands, and nothing of its torque: no inertia was said to explain the motion."""
    text = """
body: {mass: 4, inertia: {diagonal: [0.5, 0.7, 0.9]}}
initial: {angular_velocity_body: [0.3, 0.5, -0.2]}
wrenches: []
effects: [{type: magnetic_field, model: uniform, field_world: [2.0e-5, 0, 3.0e-5]}]
actuators: [{type: magnetorquer, name: rod, axis: [0, 1, 0], max_dipole: 3000.0}]
output_rate: 100
duration: 4
"""
    log, part = tmp_path / "run.mcap", tmp_path / "part.mcap"
    simulate(parse_scene(text), [("rod/command", Setpoint(2000.0, 10**9))], [McapSink(log)])
    assert main(["convert", str(log), str(part), "--from", "0.5", "--to", "3.5"]) == 0
    scene = parse_scene(f"body: {{mass: 4, inertia: {{diagonal: {given}}}}}")
    bag = read_bag(part)
    # As another recorder has it, it does not say what acted.
    bag.metadata.clear()
    told, commanded = "the force and torque of magnetorquer are in no topic", "/rod/command may command actuators"
    for found, words in (
        (inspect(part).summary, told),
        (inspect(part, scene=scene).summary, told),
        (summarize(read_track(bag)), commanded),
        (summarize(read_track(bag, scene)), commanded),
    ):
        (judged,) = (each for each in found.checks if each.name == "inertia explains the motion")
        assert (judged.judged, judged.passed) == (False, True)
        assert words in judged.detail


@pytest.mark.parametrize("unset", [False, True], ids=["rounded", "unset"])
@pytest.mark.parametrize("rates", [False, True], ids=["poses", "rates"])
def test_commands_whose_times_are_known_only_to_some_milliseconds_accuse_nobody(
    bagger: Any, unset: bool, rates: bool
) -> None:
    """Of stamps in whole milliseconds, or beside which some were not set, so that these act when they were recorded."""
    for seed in range(2):
        random = np.random.default_rng(seed)
        times = np.sort(random.integers(500_000_000, 11_500_000_000, 25)).tolist()
        torques, forces = 0.3 * random.standard_normal((25, 3)), 2.0 * random.standard_normal((25, 3))
        scene = parse_scene(
            f"{BODY.replace('MATRIX', str(TRUE.tolist()))}\nwrenches: [{{topic: wrench}}]\nduration: 12\n"
            "initial: {angular_velocity_body: [0.3, -0.2, 0.4]}\n"
        )
        commands = zip(times, forces.tolist(), torques.tolist(), strict=True)
        sent = [("wrench", Wrench(tuple(force), tuple(torque), "base", at)) for at, force, torque in commands]
        simulate(scene, sent, [memory := MemorySink()])
        rows: list[Any] = []
        for sample in memory.samples:
            t, attitude = sample.time_ns, np.array(sample.orientation_xyzw)
            velocity = rotate_all_inverse(attitude, np.array(sample.linear_velocity_world))
            attitude[:3] += 1e-3 * random.standard_normal(3)
            attitude /= np.linalg.norm(attitude)
            rate = np.array(sample.angular_velocity_body) + 2e-3 * random.standard_normal(3)
            rows.append(
                ("/b/pose", "geometry_msgs/msg/PoseStamped", t, (t, "world", (*sample.position_world, *attitude)))
            )
            if rates:
                rows.append(("/b/twist", "geometry_msgs/msg/TwistStamped", t, (t, "base", (*velocity, *rate))))
        for number, (_, wrench) in enumerate(sent):
            logged = wrench.stamp_ns + 1_000_000 + int(random.integers(3_000_000))
            stamp = round(wrench.stamp_ns, -6)
            if unset:
                stamp = wrench.stamp_ns if number % 4 else 0
            values = (stamp, "base", (*wrench.force, *wrench.torque))
            rows.append(("/b/wrench", "geometry_msgs/msg/WrenchStamped", logged, values))
        left = residual(read_track(read_bag(bagger(rows)), scene), 1e-6)
        assert left is not None
        assert left.explained or left.untold
        assert left.mass_explained


def test_forces_at_rounded_times_accuse_no_mass(bagger: Any) -> None:
    """Stamps in whole milliseconds move a mass that is known to 1e-4, but hide none that is 2 % off."""
    scene = parse_scene(f"{BODY.replace('MATRIX', str(TRUE.tolist()))}\nwrenches: [{{topic: wrench}}]\nduration: 12\n")
    random = np.random.default_rng(2)
    times = np.sort(random.integers(500_000_000, 11_500_000_000, 25)).tolist()
    forces = 12.0 * random.standard_normal((25, 3))
    sent = [
        ("wrench", Wrench(tuple(force), (0.0, 0.0, 0.0), "world", at))
        for at, force in zip(times, forces.tolist(), strict=True)
    ]
    simulate(scene, sent, [memory := MemorySink()])
    rows: list[Any] = []
    for sample in memory.samples:
        place = np.array(sample.position_world) + 1e-3 * random.standard_normal(3)
        attitude = np.append(1e-3 * random.standard_normal(3), 1.0)
        attitude /= np.linalg.norm(attitude)
        values = (sample.time_ns, "world", (*place.tolist(), *attitude.tolist()))
        rows.append(("/b/pose", "geometry_msgs/msg/PoseStamped", sample.time_ns, values))
    for _, wrench in sent:
        at = round(wrench.stamp_ns, -6)
        rows.append(
            ("/b/wrench", "geometry_msgs/msg/WrenchStamped", at, (at, "world", (*wrench.force, *wrench.torque)))
        )
    bag = read_bag(bagger(rows))
    left = residual(read_track(bag, scene), 1e-6)
    assert left is not None
    assert left.mass is not None
    assert left.mass_explained
    heavier = residual(read_track(bag, scene_of(4.08, TRUE, (0.1, -0.2, 0.05))), 1e-6)
    assert heavier is not None
    assert not heavier.mass_explained
    # Nor is one that they may hide called right beside the one that fits.
    unsure = summarize(read_track(bag, scene_of(4.01, TRUE, (0.1, -0.2, 0.05))))
    found = next(check for check in unsure.checks if check.name == MASS_EXPLAINS)
    assert (found.passed, found.judged) == (True, False), found.detail
    assert "would explain the one given as well" in found.detail
    assert unsure.reservation.endswith("whether the mass explains the motion is not judged")


def test_exact_motion_under_forces_at_rounded_times_fails_no_balance(bagger: Any) -> None:
    """No torque acts, so that the inertia explains all; the forces alone are mistimed."""
    scene = parse_scene(f"{BODY.replace('MATRIX', str(TRUE.tolist()))}\nwrenches: [{{topic: wrench}}]\nduration: 12\n")
    random = np.random.default_rng(0)
    forces = 12.0 * random.standard_normal((25, 3))
    sent = [
        ("wrench", Wrench(tuple(force), (0.0, 0.0, 0.0), "world", at))
        for at, force in zip(np.sort(random.integers(500_000_000, 11_500_000_000, 25)), forces.tolist(), strict=True)
    ]
    simulate(scene, sent, [memory := MemorySink()])
    rows: list[Any] = []
    for sample in memory.samples:
        t, pose = sample.time_ns, (*sample.position_world, *sample.orientation_xyzw)
        turn, speed = np.array([sample.orientation_xyzw]), np.array([sample.linear_velocity_world])
        spin = (*rotate_all_inverse(turn, speed)[0].tolist(), *sample.angular_velocity_body)
        rows.append(("/b/pose", "geometry_msgs/msg/PoseStamped", t, (t, "world", pose)))
        rows.append(("/b/twist", "geometry_msgs/msg/TwistStamped", t, (t, "base", spin)))
    for _, wrench in sent:
        at = round(int(wrench.stamp_ns), -6)
        rows.append(("/b/wrench", "geometry_msgs/msg/WrenchStamped", at, (at, "world", (*wrench.force, 0.0, 0.0, 0.0))))
    found = summarize(read_track(read_bag(bagger(rows)), scene))
    assert found.passed, [check for check in found.checks if not check.passed]
    moved = next(check for check in found.checks if check.name == "linear momentum balance")
    assert not moved.judged
    assert "rounded or stray" in moved.detail


def test_angular_momentum_that_late_commands_may_leave_fails_only_where_a_cause_is_found(bagger: Any) -> None:
    """Beside "cannot tell", the balance of an exact pose and gyro failed under commands without stamps."""
    scene = parse_scene(f"{BODY.replace('MATRIX', str(TRUE.tolist()))}\nwrenches: [{{topic: wrench}}]\nduration: 10\n")
    random = np.random.default_rng(4)
    sent = [
        ("wrench", Wrench((0.0, 0.0, 0.0), tuple((0.3 * random.standard_normal(3)).tolist()), "base", at))
        for at in np.sort(random.integers(500_000_000, 9_500_000_000, 20)).tolist()
    ]
    simulate(scene, sent, [memory := MemorySink()])
    rows: list[Any] = []
    for sample in memory.samples:
        t, pose = sample.time_ns, (*sample.position_world, *sample.orientation_xyzw)
        rows.append(("/b/pose", "geometry_msgs/msg/PoseStamped", t, (t, "world", pose)))
        turn, speed = np.array([sample.orientation_xyzw]), np.array([sample.linear_velocity_world])
        spin = (*rotate_all_inverse(turn, speed)[0].tolist(), *sample.angular_velocity_body)
        rows.append(("/b/twist", "geometry_msgs/msg/TwistStamped", t, (t, "base", spin)))
    for _, wrench in sent:
        logged = int(wrench.stamp_ns) + int(random.integers(100_000, 300_000))
        rows.append(
            ("/b/wrench", "geometry_msgs/msg/WrenchStamped", logged, (0, "base", (*wrench.force, *wrench.torque)))
        )
    track = read_track(read_bag(bagger(rows)), scene)
    left = residual(track, 1e-6)
    assert left is not None
    found = next(each for each in balances(track, 1e-6) if each.name == "angular momentum").without_colour()
    assert not balanced(track, found, 1e-6).passed
    assert _unless_mistimed(track, found, replace(left, untold="it hides"), 1e-6).covered == 0.0
    assert _unless_mistimed(track, found, replace(left, untold=""), 1e-6) is found


@pytest.mark.parametrize(("arrival", "least_ms"), [(True, 0.2), (True, -80.0), (False, 5.0)])
def test_what_acts_on_arrival_leaves_no_torque_that_nobody_commanded(
    arrival: bool, least_ms: float, bagger: Any
) -> None:
    """By default a node lets commands act when they arrive, after their stamps; its motion has no noise.

    That commands are logged late hides no wrong body where they acted at their stamps.
    """

    def scene_of(inertia: np.ndarray) -> Scene:
        body = BODY.replace("MATRIX", str(inertia.tolist()))
        return parse_scene(f"{body}\nwrenches: [{{topic: wrench}}]\nduration: 10\n")

    random = np.random.default_rng(2)
    acted = np.sort(random.integers(500_000_000, 9_500_000_000, 20)).tolist()
    sent = [
        ("wrench", Wrench((0.0, 0.0, 0.0), tuple(torque), "base", at))
        for at, torque in zip(acted, (0.1 * random.standard_normal((20, 3))).tolist(), strict=True)
    ]
    simulate(scene_of(TRUE), sent, [memory := MemorySink()])
    late = round(1e6 * least_ms) + random.integers(0, 300_000 if arrival else 1, len(sent))
    rows: list[Any] = []
    for sample, after in zip(memory.samples, random.integers(200_000, 500_000, len(memory.samples)), strict=True):
        t, pose = sample.time_ns, (*sample.position_world, *sample.orientation_xyzw)
        rows.append(("/b/pose", "geometry_msgs/msg/PoseStamped", t + int(after), (t, "world", pose)))
        turn, speed = np.array([sample.orientation_xyzw]), np.array([sample.linear_velocity_world])
        spin = (*rotate_all_inverse(turn, speed)[0].tolist(), *sample.angular_velocity_body)
        rows.append(("/b/twist", "geometry_msgs/msg/TwistStamped", t + int(after), (t, "base", spin)))
    for (_, wrench), after in zip(sent, late.tolist(), strict=True):
        stamp = int(wrench.stamp_ns) - after * arrival
        values = (stamp, "base", (*wrench.force, *wrench.torque))
        rows.append(("/b/wrench", "geometry_msgs/msg/WrenchStamped", stamp + after, values))
    bag = read_bag(bagger(rows))

    def told(inertia: np.ndarray) -> Any:
        return next(each for each in summarize(read_track(bag, scene_of(inertia))).checks if each.name == EXPLAINS)

    found = told(TRUE)
    assert found.passed
    assert found.judged != arrival
    assert ("act on arrival" in found.detail) == arrival
    assert not told(TRUE + 0.15 * np.linalg.eigvalsh(TRUE)[0] * np.diag([1.0, 0.0, 0.0])).passed


def test_the_error_of_a_mass_contains_that_of_the_inertia_found_beside_it(bagger: Any) -> None:
    """A thrust that turns with the body tells its mass only as well as the attitude under it is known."""
    scene = parse_scene(f"{BODY.replace('MATRIX', str(TRUE.tolist()))}\nwrenches: [{{topic: wrench}}]\nduration: 12\n")
    random = np.random.default_rng(4)
    sent = [
        ("wrench", Wrench((0.0, 0.0, 40.0), tuple((0.3 * random.standard_normal(3)).tolist()), "base", at))
        for at in range(5_000_000, 12_000_000_000, 500_000_000)
    ]
    simulate(scene, sent, [memory := MemorySink()])
    rows: list[Any] = []
    for sample in memory.samples:
        place = np.array(sample.position_world) + 1e-3 * random.standard_normal(3)
        attitude = np.array(sample.orientation_xyzw) + 1e-3 * random.standard_normal(4)
        attitude /= np.linalg.norm(attitude)
        values = (sample.time_ns, "world", (*place.tolist(), *attitude.tolist()))
        rows.append(("/b/pose", "geometry_msgs/msg/PoseStamped", sample.time_ns, values))
    for _, wrench in sent:
        at = wrench.stamp_ns
        rows.append(("/b/wrench", "geometry_msgs/msg/WrenchStamped", at, (at, "base", (*wrench.force, *wrench.torque))))
    bag = read_bag(bagger(rows))
    left = residual(read_track(bag, scene_of(4.0, OTHER, (0.1, -0.2, 0.05))), 1e-6)
    assert left is not None
    assert left.mass is not None
    assert left.mass_explained
    assert left.mass == pytest.approx(4.0, abs=3.0 * left.mass_error)
    assert left.mass_error < 4e-3
