"""What a bag of another program says, as `identify` takes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_rows import add
from identified_flights import flown, guess
from noisy_recordings import recording

from rb_dynamics import (
    Channel,
    LogError,
    ReactionWheel,
    RigidBody,
    SceneError,
    Wrench,
    identify,
    parse_scene,
    simulate,
)
from rb_dynamics.analysis.identification.flights import ATTITUDE, POSITION, RATES, VELOCITY, Flight, flight_of
from rb_dynamics.formats import cdr
from rb_dynamics.logs.bag_reader import Bag, Topic, read_bag
from rb_dynamics.sinks.mcap_sink import McapSink

IMU = "sensor_msgs/msg/Imu"


def imu_bag(flight: Flight) -> Bag:
    """Return a bag with the rates of `flight` in an IMU that measures nothing else."""
    topic, unknown = Topic("/imu", IMU), (-1.0, *[0.0] * 8)
    stream = flight.streams[0]
    for stamp, rate in zip(stream.time_ns.tolist(), stream.values.tolist(), strict=True):
        nothing = (unknown[:1], unknown[1:])
        data = cdr.encode(
            IMU, stamp + 10**9, "imu", (0.0, 0.0, 0.0, 1.0), *nothing, rate, (0.0,), [0.0] * 8, [0.0] * 3, *nothing
        )
        add(topic, stamp + 10**9, data)
    return Bag(Path("imu.mcap"), True, {topic.name: topic}, {}, {})


def test_motion_between_samples_that_cannot_be_told_is_refused_before_the_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of times in milliseconds that are called seconds; one sensor that is fast enough tells what others miss."""
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    made = flown(body, np.random.default_rng(3), seconds=20.0, spin=(0.3, 3.0, 0.5), gyro=1e-3, pose=1e-3)
    rates, attitude, _ = made.streams
    slow_rates = replace(rates, time_ns=1000 * rates.time_ns)
    slow_attitude = replace(attitude, time_ns=1000 * attitude.time_ns)
    few = slice(None, None, 300)
    rare = replace(attitude, time_ns=attitude.time_ns[few], values=attitude.values[few])
    for streams in ((rates,), (attitude,), (attitude, rates), (slow_attitude, rates), (slow_attitude,)):
        replace(made, streams=streams).require_dense()
    monkeypatch.setattr("rb_dynamics.analysis.identification.identify.fitted", None)
    for wrong in ((slow_rates,), (slow_attitude, slow_rates), (rare,)):
        flight = replace(made, streams=wrong)
        with pytest.raises(
            LogError, match=r"^flight: .* at most .* check that times are in sec.*; or record (\d+|several) "
        ):
            identify(guess(body), [flight])
        with pytest.raises(LogError, match="cannot be told"):
            identify(guess(body), [made], validate=[flight])


def test_gyro_alone_tells_ratios_and_its_bias() -> None:
    body, bias = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04)), np.array([0.02, -0.01, 0.03])
    random = np.random.default_rng(3)
    made = flown(body, random, seconds=6.0, spin=(0.3, 3.0, 0.5), gyro=1e-3, bias=bias)
    flight = flight_of(imu_bag(made), guess(body))
    found = identify(guess(body), [flight], ["inertia_ratios", "gyro_bias"])

    assert [(stream.kind, stream.gyro) for stream in flight.streams] == [(RATES, True)]
    assert flight.span_ns[0] == 0
    assert found.passed
    for each in found.parameters:
        if each.name.startswith("gyro_bias"):
            assert each.standard_error is not None
            assert abs(each.value - bias["xyz".index(each.name[-1])]) < 5.0 * each.standard_error


def test_a_bag_of_pose_twist_and_commands_tells_the_body() -> None:
    made = next(each for each in map(recording, range(20)) if each.facts["commanded"] and each.facts["with_pose"])
    flight = flight_of(made.bag, made.scene(moments=1.5, mass=1.5))
    found = identify(made.scene(moments=1.5, mass=1.5), [flight], ["inertia", "mass"])

    assert {stream.kind for stream in flight.streams} == {ATTITUDE, POSITION, RATES, VELOCITY}
    assert found.passed
    np.testing.assert_allclose(
        found.body.inertia, made.body.inertia, rtol=0.0, atol=0.1 * max(made.body.principal_moments)
    )
    assert found.body.mass == pytest.approx(made.body.mass, rel=0.1)


def test_a_bag_with_too_few_samples_is_refused() -> None:
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    made = flown(body, np.random.default_rng(4), seconds=0.1)
    with pytest.raises(LogError, match="found 3 samples of the motion, expected at least 4"):
        flight_of(imu_bag(made), guess(body)).until(2 * 10**7)


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        (
            {"actuators": (ReactionWheel(name="wheel", axis=(0.0, 0.0, 1.0), inertia=1e-4),)},
            "actuators: found wheel, expected none",
        ),
        ({"channels": (Channel("push", bias_torque=(0.0, 0.0, 1e-3)),)}, "found a bias of push, expected none"),
    ],
)
def test_what_would_be_taken_for_a_torque_is_refused(part: dict[str, object], expected: str) -> None:
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    made = flown(body, np.random.default_rng(3), seconds=1.0, spin=(0.3, 3.0, 0.5), gyro=1e-3)
    with pytest.raises(SceneError, match=expected):
        identify(replace(guess(body), **part), [made], ["inertia_ratios"])


def test_commands_act_after_the_delay_of_their_channel() -> None:
    made = next(each for each in map(recording, range(20)) if each.facts["commanded"] and each.facts["with_pose"])
    scene = made.scene(moments=1.0, mass=1.0)
    late = replace(scene, channels=tuple(replace(channel, delay=0.125) for channel in scene.channels))
    for prompt, delayed in zip(flight_of(made.bag, scene).channels, flight_of(made.bag, late).channels, strict=True):
        assert (delayed.time_ns == prompt.time_ns + 125_000_000).all()


def test_gravity_in_a_log_of_this_package_does_not_act_twice(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    gravity = "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}]\n"
    text = f"body: {{mass: 2, inertia: {{diagonal: [1, 2, 3]}}}}\n{gravity}wrenches: [{{topic: push}}]\nduration: 0.1\n"
    for namespace in ("", "a"):
        simulate(parse_scene(text), [("push", Wrench((1.0, 0.0, 0.0)))], [McapSink(path, namespace=namespace)])
        flight = flight_of(read_bag(path), parse_scene(text))
        assert [channel.topic.rpartition("/")[2] for channel in flight.channels] == ["push"]
