"""An inertial measurement unit: three gyros, and three accelerometers, which measure specific force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from rb_dynamics.loads.wrench import FixedFrame
from rb_dynamics.numerics.argument_checks import instance
from rb_dynamics.numerics.rotation import rotate, rotate_inverse
from rb_dynamics.numerics.vector import Vector, add, cross, subtract
from rb_dynamics.sensors.axis_errors import AXIS_KEYS, AxisErrors
from rb_dynamics.sensors.random_numbers import RandomNumbers
from rb_dynamics.sensors.sensor import Reading, Sensor, Truth

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry

# sensor_msgs/Imu: a covariance that begins with -1 means that there is no attitude.
_NO_ATTITUDE = (0.0, 0.0, 0.0, 1.0, -1.0, *(0.0,) * 8)


@dataclass(frozen=True, kw_only=True)
class Imu(Sensor):
    """Angular velocity (rad/s) and specific force (m/s^2) in the axes of its frame.

    The specific force is the acceleration of the frame's origin minus gravity there: f = a + w' x r + w x (w x r) - g,
    with a of the body origin and r from it to the frame (Titterton and Weston, Strapdown Inertial Navigation
    Technology, section 2.4). At rest on a table it would point up; in free fall it is 0 at the centre of mass.

    Attributes:
        gyro: errors of the gyros, in rad/s.
        accelerometer: errors of the accelerometers, in m/s^2.
    """

    kind: ClassVar[str] = "imu"
    message: ClassVar[str] = "sensor_msgs/msg/Imu"
    keys: ClassVar[tuple[str, ...]] = ("gyro", "accelerometer")
    values: ClassVar[Mapping[str, slice]] = {"angular_velocity": slice(13, 16), "specific_force": slice(25, 28)}

    gyro: AxisErrors = AxisErrors()
    accelerometer: AxisErrors = AxisErrors()

    def __post_init__(self) -> None:
        """Check the arguments, as `Sensor` does."""
        super().__post_init__()
        for name in ("gyro", "accelerometer"):
            instance(getattr(self, name), AxisErrors, f"imu: {name}", "write AxisErrors(noise_density=...)")

    @property
    def ideal(self) -> Imu:
        """The same sensor without errors and losses."""
        return replace(self, dropout=0.0, gyro=AxisErrors(), accelerometer=AxisErrors())

    @classmethod
    def read(cls, entry: SceneEntry) -> Imu:
        """Return the sensor of an entry."""
        gyro, accelerometer = (AxisErrors.read(entry.inner(name, AXIS_KEYS)) for name in cls.keys)
        return cls(**cls._common(entry), gyro=gyro, accelerometer=accelerometer)

    def measuring(self, random: RandomNumbers, place: FixedFrame) -> Reading:
        """Begin to measure."""
        gyro = self.gyro.measuring(random, 0, self.rate)
        accelerometer = self.accelerometer.measuring(random, 2, self.rate)
        arm, axes = place.position, place.orientation_xyzw
        of_gyro, of_accelerometer = self.gyro.covariance(self.rate), self.accelerometer.covariance(self.rate)

        def read(sample: int, truth: Truth) -> tuple[float, ...]:
            omega, (acceleration, spin_up) = truth.angular_velocity_body, truth.acceleration()
            at = add(truth.position_world, rotate(truth.orientation_xyzw, arm))
            falling = rotate_inverse(truth.orientation_xyzw, truth.gravity(at))
            force = specific_force(acceleration, spin_up, omega, arm, falling)
            rates = gyro(sample, rotate_inverse(axes, omega))
            forces = accelerometer(sample, rotate_inverse(axes, force))
            return (*_NO_ATTITUDE, *rates, *of_gyro, *forces, *of_accelerometer)

        return read


def specific_force(acceleration: Vector, spin_up: Vector, omega: Vector, arm: Vector, falling: Vector) -> Vector:
    """Return the specific force (m/s^2) at `arm` from the body origin; all in body axes.

    `acceleration` is that of the origin, `spin_up` the angular one, `falling` that of gravity at the place.
    """
    turning = add(cross(spin_up, arm), cross(omega, cross(omega, arm)))
    return subtract(add(acceleration, turning), falling)
