"""Sensors on many bodies read at once: the bits of each alone, in plain Python and compiled."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest

from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.compiled_load import gravity_numbers, source_numbers
from rb_dynamics.loads.magnetic_field import MagneticField
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.loads.wrench import FixedFrame, WrenchFrames
from rb_dynamics.numerics.compilation import available
from rb_dynamics.numerics.rotation import exp
from rb_dynamics.run.many_measurements import READ_ALL
from rb_dynamics.sensors.attitude_sensors import PoseSensor, StarTracker, SunSensor
from rb_dynamics.sensors.axis_errors import AxisErrors
from rb_dynamics.sensors.imu import Imu
from rb_dynamics.sensors.magnetometer import Magnetometer
from rb_dynamics.sensors.many_readings import FORCE, LOST, READING, numbers_of, parts_of, read_all, words_of
from rb_dynamics.sensors.random_numbers import key_of, normal_numbers, uniform_numbers
from rb_dynamics.sensors.sensor import Sensor, Truth

FRAMES = WrenchFrames(fixed={"skew": FixedFrame((0.1, -0.2, 0.3), exp((0.3, 1.0, -0.4)))})
GYRO = AxisErrors(1e-3, 1e-4, (0.01, 0.0, -0.02), (0.01, 0.0, 0.02), (0.01, -0.02, 0.03), 0.4, 1e-3)
SENSORS = [
    Imu(name="imu", rate=10.0, frame="skew", dropout=0.3, gyro=GYRO),
    Imu(name="gyro", rate=3.0, gyro=AxisErrors(noise_density=1e-4)),
    Imu(name="ideal", rate=3.0),
    Imu(name="forces", rate=10.0, frame="skew", gyro=GYRO, accelerometer=replace(GYRO, range=8.0)),
    StarTracker(name="tracker", rate=5.0, frame="skew", noise=1e-2, dropout=0.1),
    StarTracker(name="exact", rate=5.0),
    PoseSensor(name="pose", rate=5.0, frame="skew", position_noise=1e-3, orientation_noise=1e-3),
    PoseSensor(name="place", rate=5.0, position_noise=0.0),
    SunSensor(name="sun", rate=2.0, direction_world=(1.0, -2.0, 0.5), noise=1e-2, dropout=0.2),
    SunSensor(name="seen", rate=2.0, frame="skew", direction_world=(0.0, 0.0, 3.0), field_of_view=1.9),
    Magnetometer(
        name="mag",
        rate=2.0,
        frame="skew",
        dropout=0.1,
        errors=AxisErrors(1e-3, 1e-4, (1e-3, 0.0, 0.0), (0.01, 0.0, 0.0), (0.0, 0.1, 0.0), 1.0, 1e-4),
    ),
]
FIELD = MagneticField("dipole", moment_world=(1e6, 0.0, -3e6), center_world=(1.0, 2.0, 3.0))
SOURCE = source_numbers([FIELD])
CENTER = CentralGravity(gravitational_parameter=5.0, center_world=(1.0, 0.0, 2.0))


def truths(count: int) -> list[tuple[float, ...]]:
    draw = random.Random(count)
    rows = [[draw.gauss(0.0, 0.5) for _ in range(15)] for _ in range(count)]
    return [(*row[:3], *exp((row[3], row[4], row[5])), *row[6:]) for row in rows]


def alone(sensor: Sensor, seed: int, samples: list[tuple[float, ...]]) -> list[tuple[float, ...] | None]:
    """Return the messages at these truths."""
    reading, found = sensor.reading(seed, FRAMES), []
    for number, row in enumerate(samples):
        q, w = (row[3], row[4], row[5], row[6]), (row[7], row[8], row[9])
        moves = (row[10], row[11], row[12]), (row[13], row[14], row[15])
        truth = Truth(
            (row[0], row[1], row[2]), q, w, lambda moves=moves: moves, CENTER.gravity(), FIELD.magnetic_field()
        )
        found.append(reading(number, truth))
    return found


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("sensor", SENSORS, ids=lambda sensor: sensor.name)
def test_each_reading_has_the_bits_of_itself_alone(
    monkeypatch: pytest.MonkeyPatch, sensor: Sensor, compiled: bool
) -> None:
    """Over samples in which biases wander, some are lost, and gyros are at their limits."""
    if compiled and not available():
        pytest.skip("needs numba")
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always" if compiled else "never")
    kernel, seeds, samples = READ_ALL.get(1.0, 1.0) or read_all, [0, 5, 2**53], 20
    rows = truths(samples * len(seeds))
    gravity = gravity_numbers([CENTER]) if sensor.name in ("forces", "imu") else None
    numbers = np.array([numbers_of(sensor, FRAMES, SOURCE, gravity) for _ in seeds])
    words = np.array([words_of(sensor, seed) for seed in seeds], dtype=np.uint64).view(np.int64)
    found = []
    for number in range(samples):
        truth, into = np.array(rows[number * 3 : number * 3 + 3]), np.full((3, READING), math.nan)
        kernel(number, truth, numbers, words if compiled else words.view(np.uint64).astype(object), into)
        found.append(into)
    lost = 0
    for i, seed in enumerate(seeds):
        for number, message in enumerate(alone(sensor, seed, rows[i::3])):
            row = found[number][i]
            lost += message is None
            assert row[LOST] == (message is None)
            for name, part in parts_of(sensor).items():
                if name == FORCE and gravity is None:
                    continue
                assert message is None or tuple(row[part]) == message[sensor.values[name]], name
    assert lost < samples * len(seeds)
    assert (lost > 0) == (sensor.dropout > 0.0 or sensor.may_be_silent)


def test_a_sensor_without_a_kernel_has_no_numbers() -> None:
    assert numbers_of(SENSORS[-1], FRAMES, None) is None

    class Derived(StarTracker):
        pass

    assert numbers_of(Derived(name="tracker", rate=1.0), FRAMES, SOURCE) is None


def test_normal_numbers_are_those_of_the_standard_library() -> None:
    """Algorithm AS 241 in both, in the middle and in the tails."""
    for number in range(2000):
        key = key_of(number, "x")
        shares = uniform_numbers(key, number, 1)
        expected = tuple(map(NormalDist().inv_cdf, shares[:3]))
        assert normal_numbers(key, number, 1) == pytest.approx(expected, rel=1e-15)


def test_the_frame_of_a_sensor_counts() -> None:
    tracker = SENSORS[3]
    assert numbers_of(tracker, FRAMES, None) != numbers_of(replace(tracker, frame=""), FRAMES, None)


def test_gravity_of_several_centres_is_not_read() -> None:
    assert gravity_numbers([FIELD]) == (0.0, 0.0, 0.0, 0.0)
    assert gravity_numbers([FIELD, CENTER]) == (5.0, 1.0, 0.0, 2.0)
    assert gravity_numbers([CENTER, CENTER]) is None
    assert gravity_numbers([UniformGravity(acceleration_world=(0.0, 0.0, -9.81))]) is None
