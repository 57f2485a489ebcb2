"""Attitude sensors: a star tracker, motion capture (`pose`), a sun sensor, and the error from a target attitude."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from rb_dynamics.errors import SceneError
from rb_dynamics.loads.number_ranges import Range, check_vector
from rb_dynamics.loads.wrench import FixedFrame
from rb_dynamics.numerics.argument_checks import quaternion
from rb_dynamics.numerics.rotation import Quaternion, conjugate, exp, log, multiply, normalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import Vector, add, add_scaled, cross, norm, scale
from rb_dynamics.sensors.random_numbers import Key, RandomNumbers, normal_numbers
from rb_dynamics.sensors.sensor import Reading, Sensor, Truth, diagonal

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


def _size(unit: str) -> Range:
    return Range(f"a number of 0 or more ({unit})", "write a size without a sign", least=0.0)


def turned(orientation: Quaternion, size: float, key: Key, lane: int, sample: int) -> Quaternion:
    """Return an attitude with random errors of standard deviation `size` (rad) about the sensor's three axes."""
    if not size > 0.0:
        return orientation
    return normalize(multiply(orientation, exp(scale(size, normal_numbers(key, sample, lane)))))


def moved(position: Vector, size: float, key: Key, lane: int, sample: int) -> Vector:
    """Return a position with random errors of standard deviation `size` (m) along each axis."""
    return add_scaled(position, size, normal_numbers(key, sample, lane))


def seen(direction: Vector, size: float, key: Key, lane: int, sample: int) -> Vector:
    """Return a unit vector with random errors of standard deviation `size` (rad) about the axes across it."""
    found = add(direction, cross(scale(size, normal_numbers(key, sample, lane)), direction))
    return scale(1.0 / norm(found), found)


@dataclass(frozen=True, kw_only=True)
class StarTracker(Sensor):
    """The rotation from its frame to the world.

    Attributes:
        noise: standard deviation of the angle about each axis of its frame, rad, in every sample.
    """

    kind: ClassVar[str] = "star_tracker"
    message: ClassVar[str] = "geometry_msgs/msg/QuaternionStamped"
    in_world: ClassVar[bool] = True
    keys: ClassVar[tuple[str, ...]] = ("noise",)
    ranges: ClassVar[Mapping[str, Range]] = {**Sensor.ranges, "noise": _size("rad")}
    values: ClassVar[Mapping[str, slice]] = {"orientation_xyzw": slice(0, 4)}

    noise: float = 0.0

    @property
    def ideal(self) -> StarTracker:
        """The same sensor without errors and losses."""
        return replace(self, dropout=0.0, noise=0.0)

    def measuring(self, random: RandomNumbers, place: FixedFrame) -> Reading:
        """Begin to measure."""

        def read(sample: int, truth: Truth) -> tuple[float, ...]:
            true = multiply(truth.orientation_xyzw, place.orientation_xyzw)
            return turned(true, self.noise, random.key, 0, sample)

        return read


@dataclass(frozen=True, kw_only=True)
class PoseSensor(Sensor):
    """Position of the origin of its frame and rotation from its frame, in the world, as motion capture gives them.

    Attributes:
        position_noise: standard deviation of each coordinate, m, in every sample.
        orientation_noise: of the angle about each axis of its frame, rad.
    """

    kind: ClassVar[str] = "pose"
    message: ClassVar[str] = "geometry_msgs/msg/PoseWithCovarianceStamped"
    in_world: ClassVar[bool] = True
    keys: ClassVar[tuple[str, ...]] = ("position_noise", "orientation_noise")
    ranges: ClassVar[Mapping[str, Range]] = {
        **Sensor.ranges,
        "position_noise": _size("m"),
        "orientation_noise": _size("rad"),
    }
    values: ClassVar[Mapping[str, slice]] = {"position_world": slice(0, 3), "orientation_xyzw": slice(3, 7)}

    position_noise: float = 0.0
    orientation_noise: float = 0.0

    @property
    def ideal(self) -> PoseSensor:
        """The same sensor without errors and losses."""
        return replace(self, dropout=0.0, position_noise=0.0, orientation_noise=0.0)

    def measuring(self, random: RandomNumbers, place: FixedFrame) -> Reading:
        """Begin to measure."""
        off, angle = self.position_noise * self.position_noise, self.orientation_noise * self.orientation_noise
        covariance = diagonal((off, off, off, angle, angle, angle))

        def read(sample: int, truth: Truth) -> tuple[float, ...]:
            at = add(truth.position_world, rotate(truth.orientation_xyzw, place.position))
            at = moved(at, self.position_noise, random.key, 0, sample)
            true = multiply(truth.orientation_xyzw, place.orientation_xyzw)
            return (*at, *turned(true, self.orientation_noise, random.key, 1, sample), *covariance)

        return read


@dataclass(frozen=True, kw_only=True)
class SunSensor(Sensor):
    """The direction of the sun, a unit vector in the axes of its frame; no message while the sun is out of view.

    Attributes:
        direction_world: towards the sun; its length does not matter.
        noise: standard deviation of the angle about each axis perpendicular to the direction, rad, in every sample.
        field_of_view: angle (rad) from the x axis of its frame within which it sees the sun.
    """

    kind: ClassVar[str] = "sun_sensor"
    message: ClassVar[str] = "geometry_msgs/msg/Vector3Stamped"
    keys: ClassVar[tuple[str, ...]] = ("direction_world", "noise", "field_of_view")
    ranges: ClassVar[Mapping[str, Range]] = {
        **Sensor.ranges,
        "noise": _size("rad"),
        "field_of_view": Range(
            "an angle greater than 0 and at most pi (rad)", "leave it out to see all around", above=0.0, most=math.pi
        ),
    }
    values: ClassVar[Mapping[str, slice]] = {"direction": slice(0, 3)}

    direction_world: Vector
    noise: float = 0.0
    field_of_view: float = math.pi

    def __post_init__(self) -> None:
        """Check the arguments, as `Sensor` does.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: a number is out of range, or the direction is zero.
        """
        super().__post_init__()
        check_vector(self, "direction_world", "the direction of the sun", direction=True)

    @property
    def may_be_silent(self) -> bool:
        """Whether the sun can be out of view."""
        return self.field_of_view < math.pi

    @property
    def ideal(self) -> SunSensor:
        """The same sensor without errors and losses."""
        return replace(self, dropout=0.0, noise=0.0)

    @classmethod
    def read(cls, entry: SceneEntry) -> SunSensor:
        """Return the sensor of an entry."""
        direction = entry.direction("direction_world", "write where the sun is, such as [1, 0, 0]")
        return cls(**cls._common(entry), direction_world=direction)

    @property
    def numbers(self) -> tuple[Vector, float]:
        """The unit vector towards the sun, and the least x of its direction in the frame at which it is in view."""
        least = math.cos(self.field_of_view) if self.field_of_view < math.pi else -math.inf
        return scale(1.0 / norm(self.direction_world), self.direction_world), least

    def measuring(self, random: RandomNumbers, place: FixedFrame) -> Reading:
        """Begin to measure."""
        direction, least = self.numbers

        def read(sample: int, truth: Truth) -> tuple[float, ...] | None:
            true = rotate_inverse(multiply(truth.orientation_xyzw, place.orientation_xyzw), direction)
            return None if true[0] < least else seen(true, self.noise, random.key, 0, sample)

        return read


@dataclass(frozen=True, kw_only=True)
class AttitudeErrorSensor(Sensor):
    """The rotation vector (rad) from a target to the attitude of its frame; its length is the pointing error.

    In the axes of its frame, of at most half a turn, and without errors: a quantity to log rather than a device.

    Attributes:
        target: rotation from its frame to the world that the body is to have.
    """

    kind: ClassVar[str] = "attitude_error"
    message: ClassVar[str] = "geometry_msgs/msg/Vector3Stamped"
    keys: ClassVar[tuple[str, ...]] = ("target",)
    values: ClassVar[Mapping[str, slice]] = {"rotation": slice(0, 3)}

    target: Quaternion

    def __post_init__(self) -> None:
        """Check the arguments, as `Sensor` does.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: a number is out of range, or the target is no attitude.
        """
        super().__post_init__()
        object.__setattr__(self, "target", quaternion(self.target, f"{self.kind}: target", SceneError))

    @property
    def ideal(self) -> AttitudeErrorSensor:
        """The same sensor without losses."""
        return replace(self, dropout=0.0)

    @classmethod
    def read(cls, entry: SceneEntry) -> AttitudeErrorSensor:
        """Return the sensor of an entry."""
        if not entry.has("target"):
            entry.section.missing("target", "a unit quaternion", "add target: {x: 0, y: 0, z: 0, w: 1}")
        return cls(**cls._common(entry), target=entry.section.quaternion("target"))

    def aim(self, place: FixedFrame) -> Quaternion:
        """Return the attitude of the body that has its frame at the target."""
        return multiply(self.target, conjugate(place.orientation_xyzw))

    def measuring(self, random: RandomNumbers, place: FixedFrame) -> Reading:
        """Begin to measure."""

        def read(_: int, truth: Truth) -> tuple[float, ...]:
            return log(multiply(conjugate(self.target), multiply(truth.orientation_xyzw, place.orientation_xyzw)))

        return read
