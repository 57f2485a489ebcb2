"""Readings of one sensor on many bodies at one time, in one compiled call, with the bits of the readings of each alone.

For inertial measurement units (on request with their accelerometers), magnetometers, star trackers, motion capture and
sun sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rb_dynamics.loads.central_gravity import falling
from rb_dynamics.loads.compiled_load import source_at
from rb_dynamics.loads.magnetic_field import flux_density
from rb_dynamics.loads.wrench import WrenchFrames
from rb_dynamics.numerics.compilation import lane
from rb_dynamics.numerics.rotation import Quaternion, conjugate, multiply, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add
from rb_dynamics.sensors.attitude_sensors import PoseSensor, StarTracker, SunSensor, moved, seen, turned
from rb_dynamics.sensors.axis_errors import AxisErrors, AxisNumbers, measured
from rb_dynamics.sensors.imu import Imu, specific_force
from rb_dynamics.sensors.magnetometer import Magnetometer
from rb_dynamics.sensors.random_numbers import key_of, uniform_numbers
from rb_dynamics.sensors.sensor import DROPOUT, Sensor

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

    Whole = npt.NDArray[np.int64]

# Numbers of a sensor: kind, dropout and place on the body, then those of its kind; for gyros, accelerometers and
# magnetometers the bias at the next sample comes first, and the source of the field, or gravity, last.
_GYRO, _TRACKER, _POSE, _FIELD, _SUN, _IMU = 1.0, 2.0, 3.0, 4.0, 5.0, 6.0
_DROPOUT, _POSITION, _AXES, _OWN, _SOURCE, _GRAVITY, _NUMBERS = 1, 2, 5, 9, 23, 37, 41
# Of three axes.
_EACH = 14

LOST, VALUE, IN_BODY, READING = 0, 1, 8, 12
"""In a reading: whether there is none; position, if it measures that, and behind it angular velocity, field, direction
or attitude, then specific force, in the frames of the message; and angular velocity or attitude of the body, in its
axes."""


FORCE = "specific_force"
"""What accelerometers measure."""


def numbers_of(
    sensor: Sensor, frames: WrenchFrames, source: Sequence[float] | None, gravity: Sequence[float] | None = None
) -> tuple[float, ...] | None:
    """Return the numbers of a sensor before its first sample; None if its readings have no kernel.

    `source` is that of the magnetic field, see `source_numbers`; with `gravity`, see `gravity_numbers`, accelerometers
    are read, too.
    """
    kind = type(sensor)
    place = sensor.fixed(frames)
    before = (sensor.dropout, *place.position, *place.orientation_xyzw)
    found: tuple[float, ...]
    if kind is Imu and isinstance(sensor, Imu):
        found = (_GYRO, *before, *_of_axes(sensor.gyro, sensor.rate))
        if gravity is not None:
            found = (_IMU, *found[1:], *_of_axes(sensor.accelerometer, sensor.rate), *gravity)
    elif kind is Magnetometer and isinstance(sensor, Magnetometer) and source is not None:
        found = (_FIELD, *before, *_of_axes(sensor.errors, sensor.rate), *source)
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


def _of_axes(errors: AxisErrors, rate: float) -> tuple[float, ...]:
    turn, gain, *others = errors.numbers(rate)
    return (*errors.bias, *turn, *gain, *others)


def words_of(sensor: Sensor, seed: int) -> tuple[int, ...]:
    """Return the keys of its noise and of its losses in a run."""
    return *key_of(seed, sensor.name), *key_of(seed, sensor.name + DROPOUT)


def parts_of(sensor: Sensor) -> dict[str, slice]:
    """Return where in a reading each of its values stands; those of accelerometers only if they are read."""
    if isinstance(sensor, Imu):
        return {"angular_velocity": slice(VALUE, VALUE + 3), FORCE: slice(VALUE + 3, VALUE + 6)}
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
        truth: (N, 16), position, attitude, angular velocity and, for accelerometers, accelerations of the bodies, as in
            `Truth`.
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
        if n[0] == _GYRO or n[0] == _FIELD or n[0] == _IMU:
            omega: Vector = (t[7], t[8], t[9])
            there = add((t[0], t[1], t[2]), rotate(orientation, place))
            for part in range(2 if n[0] == _IMU else 1):
                k, at = _OWN + part * _EACH, VALUE + 3 * part
                turn: Quaternion = (n[k + 3], n[k + 4], n[k + 5], n[k + 6])
                errors = AxisNumbers(turn, (n[k + 7], n[k + 8], n[k + 9]), n[k + 10], n[k + 11], n[k + 12], n[k + 13])
                true = rotate_inverse(axes, omega)
                if n[0] == _FIELD:
                    true = rotate_inverse(sensed, add(ZERO, flux_density(source_at(n, _SOURCE), there)))
                elif part == 1:
                    true = rotate_inverse(axes, _force_on(n, t, orientation, omega, place, there))
                value, bias = measured(errors, (n[k], n[k + 1], n[k + 2]), key, 2 * part, sample, true)
                n[k], n[k + 1], n[k + 2] = bias
                r[at], r[at + 1], r[at + 2] = value
                if part == 0:
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


def _force_on(n: Numbers, t: Numbers, orientation: Quaternion, omega: Vector, place: Vector, there: Vector) -> Vector:
    """Return the specific force at a place on the body, in body axes."""
    gravity: Vector = ZERO
    if n[_GRAVITY] > 0.0:
        center: Vector = (n[_GRAVITY + 1], n[_GRAVITY + 2], n[_GRAVITY + 3])
        gravity = add(ZERO, falling(n[_GRAVITY], center, there))
    acceleration: Vector = (t[10], t[11], t[12])
    spin_up: Vector = (t[13], t[14], t[15])
    return specific_force(acceleration, spin_up, omega, place, rotate_inverse(orientation, gravity))


READINGS = "void(int64, float64[:, ::1], float64[:, ::1], int64[:, ::1], float64[:, ::1])"
"""Types of the arguments of `read_all`, as numba writes them."""
