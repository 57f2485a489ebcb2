"""Readings of one sensor on many bodies at one time, in one compiled call, with the bits of the readings of each alone.

For inertial measurement units (their gyros), magnetometers, star trackers, motion capture and sun sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rb_dynamics.loads.compiled_load import source_at
from rb_dynamics.loads.magnetic_field import flux_density
from rb_dynamics.loads.wrench import WrenchFrames
from rb_dynamics.numerics.compilation import lane
from rb_dynamics.numerics.rotation import Quaternion, conjugate, multiply, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add
from rb_dynamics.sensors.attitude_sensors import PoseSensor, StarTracker, SunSensor, moved, seen, turned
from rb_dynamics.sensors.axis_errors import AxisNumbers, measured
from rb_dynamics.sensors.imu import Imu
from rb_dynamics.sensors.magnetometer import Magnetometer
from rb_dynamics.sensors.random_numbers import key_of, uniform_numbers
from rb_dynamics.sensors.sensor import DROPOUT, Sensor

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

    Whole = npt.NDArray[np.int64]

# Numbers of a sensor: kind, dropout and place on the body, then those of its kind; for gyros and magnetometers the bias
# at the next sample comes first, and the source of the field last.
_GYRO, _TRACKER, _POSE, _FIELD, _SUN = 1.0, 2.0, 3.0, 4.0, 5.0
_DROPOUT, _POSITION, _AXES, _OWN, _SOURCE, _NUMBERS = 1, 2, 5, 9, 23, 33

LOST, VALUE, IN_BODY, READING = 0, 1, 8, 12
"""In a reading: whether there is none; position, if it measures that, and behind it angular velocity, field, direction
or attitude, in the frames of the message; and angular velocity or attitude of the body, in its axes."""


def numbers_of(sensor: Sensor, frames: WrenchFrames, source: Sequence[float] | None) -> tuple[float, ...] | None:
    """Return the numbers of a sensor before its first sample; None if its readings have no kernel.

    `source` is that of the magnetic field, see `source_numbers`.
    """
    kind = type(sensor)
    place = sensor.fixed(frames)
    before = (sensor.dropout, *place.position, *place.orientation_xyzw)
    found: tuple[float, ...]
    if kind is Imu and isinstance(sensor, Imu):
        turn, gain, *others = sensor.gyro.numbers(sensor.rate)
        found = (_GYRO, *before, *sensor.gyro.bias, *turn, *gain, *others)
    elif kind is Magnetometer and isinstance(sensor, Magnetometer) and source is not None:
        turn, gain, *others = sensor.errors.numbers(sensor.rate)
        found = (_FIELD, *before, *sensor.errors.bias, *turn, *gain, *others, *source)
    elif kind is StarTracker and isinstance(sensor, StarTracker):
        found = (_TRACKER, *before, sensor.noise)
    elif kind is PoseSensor and isinstance(sensor, PoseSensor):
        found = (_POSE, *before, sensor.position_noise, sensor.orientation_noise)
    elif kind is SunSensor and isinstance(sensor, SunSensor):
        direction, least = sensor.numbers
        found = (_SUN, *before, *direction, least, sensor.noise)
    else:
        return None
    return (*found, *(0.0,) * (_NUMBERS - len(found)))


def words_of(sensor: Sensor, seed: int) -> tuple[int, ...]:
    """Return the keys of its noise and of its losses in a run."""
    return *key_of(seed, sensor.name), *key_of(seed, sensor.name + DROPOUT)


def parts_of(sensor: Sensor) -> dict[str, slice]:
    """Return where in a reading each of its values stands."""
    if isinstance(sensor, Imu):
        return {"angular_velocity": slice(VALUE, VALUE + 3)}
    if isinstance(sensor, Magnetometer):
        return {"magnetic_field": slice(VALUE, VALUE + 3)}
    if isinstance(sensor, PoseSensor):
        return {"position_world": slice(VALUE, VALUE + 3), "orientation_xyzw": slice(VALUE + 3, VALUE + 7)}
    if isinstance(sensor, SunSensor):
        return {"direction": slice(VALUE, VALUE + 3)}
    return {"orientation_xyzw": slice(VALUE, VALUE + 4)}


def read_all(sample: int, truth: Numbers, numbers: Numbers, words: Whole, found: Numbers) -> None:
    """Take a sample of one sensor on each body, and move the biases on.

    Args:
        sample: its number.
        truth: (N, 10), position, attitude and angular velocity of the bodies, as in `Truth`.
        numbers: (N, ...), of the sensors, see `numbers_of`.
        words: (N, 4), see `words_of`.
        found: (N, `READING`), for the readings.
    """
    for i in range(len(truth)):
        n, t, r = numbers[i], truth[i], found[i]
        key, of_losses = (lane(words[i, 0]), lane(words[i, 1])), (lane(words[i, 2]), lane(words[i, 3]))
        orientation: Quaternion = (t[3], t[4], t[5], t[6])
        place: Vector = (n[_POSITION], n[_POSITION + 1], n[_POSITION + 2])
        axes: Quaternion = (n[_AXES], n[_AXES + 1], n[_AXES + 2], n[_AXES + 3])
        sensed, k, at, hidden = multiply(orientation, axes), _OWN, VALUE, False
        if n[0] == _GYRO or n[0] == _FIELD:
            turn: Quaternion = (n[k + 3], n[k + 4], n[k + 5], n[k + 6])
            errors = AxisNumbers(turn, (n[k + 7], n[k + 8], n[k + 9]), n[k + 10], n[k + 11], n[k + 12], n[k + 13])
            true = rotate_inverse(axes, (t[7], t[8], t[9]))
            if n[0] == _FIELD:
                there = add((t[0], t[1], t[2]), rotate(orientation, place))
                true = rotate_inverse(sensed, add(ZERO, flux_density(source_at(n, _SOURCE), there)))
            value, bias = measured(errors, (n[k], n[k + 1], n[k + 2]), key, 0, sample, true)
            n[k], n[k + 1], n[k + 2] = bias
            r[at], r[at + 1], r[at + 2] = value
            r[IN_BODY], r[IN_BODY + 1], r[IN_BODY + 2] = rotate(axes, value)
        elif n[0] == _SUN:
            true = rotate_inverse(sensed, (n[k], n[k + 1], n[k + 2]))
            hidden = true[0] < n[k + 3]
            r[at], r[at + 1], r[at + 2] = seen(true, n[k + 4], key, 0, sample)
        else:
            if n[0] == _POSE:
                there = add((t[0], t[1], t[2]), rotate(orientation, place))
                r[at], r[at + 1], r[at + 2] = moved(there, n[k], key, 0, sample)
                at = VALUE + 3
                sensed = turned(sensed, n[k + 1], key, 1, sample)
            else:
                sensed = turned(sensed, n[k], key, 0, sample)
            r[at], r[at + 1], r[at + 2], r[at + 3] = sensed
            back = multiply(sensed, conjugate(axes))
            r[IN_BODY], r[IN_BODY + 1], r[IN_BODY + 2], r[IN_BODY + 3] = back
        lost = n[_DROPOUT] > 0.0 and uniform_numbers(of_losses, sample, 0)[0] < n[_DROPOUT]
        r[LOST] = 1.0 if lost or hidden else 0.0


READINGS = "void(int64, float64[:, ::1], float64[:, ::1], int64[:, ::1], float64[:, ::1])"
"""Types of the arguments of `read_all`, as numba writes them."""
