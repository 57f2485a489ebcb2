"""What sensors measured, for Rerun: rates and attitudes in body axes, beside the true ones, and the other messages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from rb_dynamics.numerics.rotation import Quaternion, conjugate, multiply, rotate
from rb_dynamics.run.sink import Measurement
from rb_dynamics.scene.model import Scene

ATTITUDE, RATE = "orientation_xyzw", "angular_velocity"
TRUE = {ATTITUDE: "attitude", RATE: "angular_velocity"}
"""The entity of the true value of what is measured."""


class SensorValue(NamedTuple):
    """One value of a sensor: when it was taken, the newest sample when it came, and its numbers."""

    taken_ns: int
    sample: int
    numbers: tuple[float, ...]


def entities(scene: Scene) -> Iterator[tuple[str, str, str, int]]:
    """Yield entity, sensor, what it measures and how many numbers that has."""
    for sensor in scene.sensors:
        for what, place in sensor.values.items():
            yield f"measured/{sensor.name}/{what}", sensor.name, what, place.stop - place.start


class Readings:
    """Readings that wait to be sent: of each sensor `most`, then every second as far again, every fourth, ..."""

    def __init__(self, scene: Scene, most: int) -> None:
        """Begin with none."""
        self._sensors = {sensor.name: (sensor, sensor.fixed(scene.frames).orientation_xyzw) for sensor in scene.sensors}
        self._most = most
        self._count = dict.fromkeys(self._sensors, 0)
        self._stride = dict.fromkeys(self._sensors, 1)
        self._waiting: dict[str, list[SensorValue]] = {}

    def take(self, event: Measurement, sample: int, attitude: Quaternion | None) -> None:
        """Take a measurement made after `sample`, in which the body had `attitude`; q or -q, whichever is near it."""
        name = event.topic
        count = self._count[name]
        self._count[name] += 1
        if count >= self._most * self._stride[name] * 2:
            self._stride[name] *= 2
        if count % self._stride[name]:
            return
        sensor, frame = self._sensors[name]
        for what, place in sensor.values.items():
            numbers = event.numbers[place]
            if what == RATE:
                x, y, z = numbers
                numbers = rotate(frame, (x, y, z))
            elif what == ATTITUDE:
                x, y, z, w = numbers
                numbers = multiply((x, y, z, w), conjugate(frame))
                if attitude is not None and sum(a * b for a, b in zip(numbers, attitude, strict=True)) < 0.0:
                    numbers = tuple(-number for number in numbers)
            entity = f"measured/{name}/{what}"
            self._waiting.setdefault(entity, []).append(SensorValue(event.taken_ns, sample, numbers))

    def unsent(self) -> int:
        """Return how many wait."""
        return sum(map(len, self._waiting.values()))

    def fetch(self) -> dict[str, list[SensorValue]]:
        """Return what has arrived since the last call, by entity."""
        fetched, self._waiting = self._waiting, {}
        return fetched
