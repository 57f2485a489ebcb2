"""Inputs of a controller on board: messages of the sensors, speeds of the wheels, a model of the field.

`NewestMeasurements` is a sink, so a law gets exactly the messages that are logged or published, at the same nanosecond.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import Quaternion, conjugate, multiply, rotate
from rb_dynamics.numerics.vector import Vector
from rb_dynamics.run.sink import Event, Measurement, RunInfo
from rb_dynamics.scene.model import Scene
from rb_dynamics.sensors.sensor import Sensor

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers


class SensorReading:
    """The newest message of one sensor: what it measures, by attribute; NaN before the first.

    Attributes:
        time_s: when it was taken, (N,).
        values: by name, (N, k), in the frames of the message.
    """

    def __init__(self, name: str, time_s: Numbers, values: Mapping[str, Numbers]) -> None:
        """Keep a message of the sensor `name`."""
        self.time_s, self.values, self._name = time_s, values, name

    def __getattr__(self, name: str) -> Numbers:
        """Return what it measures, such as `angular_velocity`.

        Raises:
            AttributeError: it does not measure that.
        """
        found: Mapping[str, Numbers] = self.__dict__.get("values", {})
        if name not in found:
            known = ", ".join(["time_s", *found])
            raise AttributeError(f"the sensor {self.__dict__.get('_name')} has no {name}, expected one of {known}")
        return found[name]


class OnboardValues(NamedTuple):
    """The measurements on board N bodies.

    Attributes:
        sensors: newest message of each, by name.
        wheel_speeds: relative to the body, rad/s, (N,), by name of the wheel.
        field_world: returns the magnetic flux density at the body origin, T, (N, 3); None without a field.
        orientation_xyzw: body to world, as first sensor that measures it says, (N, 4); None if there is none.
        angular_velocity_body: rad/s, (N, 3), likewise.
        silent: sensors without a message so far, except those that may have nothing to report.
    """

    sensors: Mapping[str, SensorReading] = MappingProxyType({})
    wheel_speeds: Mapping[str, Numbers] = MappingProxyType({})
    field_world: Callable[[], Numbers] | None = None
    orientation_xyzw: Numbers | None = None
    angular_velocity_body: Numbers | None = None
    silent: tuple[str, ...] = ()


class NewestMeasurements:
    """Keeps the newest message of each sensor of one run."""

    def __init__(self, scene: Scene) -> None:
        """Listen to the sensors of `scene`."""
        self._scene, self._newest = scene, dict[str, Measurement]()

    def open(self, run: RunInfo) -> None:
        """Begin."""

    def write(self, event: Event) -> None:
        """Keep a message of a sensor."""
        if isinstance(event, Measurement):
            self._newest[event.topic] = event

    def close(self, result: Mapping[str, str]) -> None:
        """End."""

    @property
    def silent(self) -> tuple[str, ...]:
        """Sensors without a message so far, except those that may have nothing to report."""
        names = (sensor.name for sensor in self._scene.sensors if not sensor.may_be_silent)
        return tuple(name for name in names if name not in self._newest)

    def sensors(self) -> dict[str, SensorReading]:
        """Return the newest messages, with a leading axis of one body."""
        import numpy as np

        found = {}
        for sensor in self._scene.sensors:
            message = self._newest.get(sensor.name)
            time_s = np.nan if message is None else message.taken_ns / NANOSECONDS
            values = {
                name: np.full((1, part.stop - part.start), np.nan)
                if message is None
                else np.array([message.numbers[part]])
                for name, part in sensor.values.items()
            }
            found[sensor.name] = SensorReading(sensor.name, np.array([time_s]), values)
        return found

    def orientation(self) -> Quaternion | None:
        """Return the attitude of the body as the first sensor that measures it says."""
        found = self._first("orientation_xyzw")
        if found is None:
            return None
        sensor, (x, y, z, w) = found
        return multiply((x, y, z, w), conjugate(sensor.fixed(self._scene.frames).orientation_xyzw))

    def angular_velocity(self) -> Vector | None:
        """Return the angular velocity in body axes, as the first sensor that measures it says."""
        found = self._first("angular_velocity")
        if found is None:
            return None
        sensor, (x, y, z) = found
        return rotate(sensor.fixed(self._scene.frames).orientation_xyzw, (x, y, z))

    def _first(self, name: str) -> tuple[Sensor, tuple[float, ...]] | None:
        for sensor in self._scene.sensors:
            if name in sensor.values and (message := self._newest.get(sensor.name)) is not None:
                return sensor, message.numbers[sensor.values[name]]
        return None
