"""A magnetometer: the magnetic flux density of the scene's `magnetic_field`, with errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from rb_dynamics.loads.wrench import FixedFrame
from rb_dynamics.numerics.argument_checks import instance
from rb_dynamics.numerics.rotation import multiply, rotate, rotate_inverse
from rb_dynamics.numerics.vector import add
from rb_dynamics.sensors.axis_errors import AXIS_KEYS, AxisErrors
from rb_dynamics.sensors.random_numbers import RandomNumbers
from rb_dynamics.sensors.sensor import Reading, Sensor, Truth

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


@dataclass(frozen=True, kw_only=True)
class Magnetometer(Sensor):
    """The magnetic flux density (T) at the origin of its frame, in the axes of its frame.

    Attributes:
        errors: of its axes, in T; in a scene their keys are those of the sensor.
    """

    kind: ClassVar[str] = "magnetometer"
    message: ClassVar[str] = "sensor_msgs/msg/MagneticField"
    needs_field: ClassVar[bool] = True
    keys: ClassVar[tuple[str, ...]] = AXIS_KEYS
    values: ClassVar[Mapping[str, slice]] = {"magnetic_field": slice(0, 3)}

    errors: AxisErrors = AxisErrors()

    def __post_init__(self) -> None:
        """Check the arguments, as `Sensor` does."""
        super().__post_init__()
        instance(self.errors, AxisErrors, "magnetometer: errors", "write AxisErrors(noise_density=...)")

    @property
    def ideal(self) -> Magnetometer:
        """The same sensor without errors and losses."""
        return replace(self, dropout=0.0, errors=AxisErrors())

    @classmethod
    def read(cls, entry: SceneEntry) -> Magnetometer:
        """Return the sensor of an entry."""
        return cls(**cls._common(entry), errors=AxisErrors.read(entry))

    def measuring(self, random: RandomNumbers, place: FixedFrame) -> Reading:
        """Begin to measure."""
        measure, covariance = self.errors.measuring(random, 0, self.rate), self.errors.covariance(self.rate)

        def read(sample: int, truth: Truth) -> tuple[float, ...]:
            at = add(truth.position_world, rotate(truth.orientation_xyzw, place.position))
            axes = multiply(truth.orientation_xyzw, place.orientation_xyzw)
            return (*measure(sample, rotate_inverse(axes, truth.magnetic_field(at))), *covariance)

        return read
