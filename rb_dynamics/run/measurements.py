"""`Measurements`: takes the samples of the sensors of a run and delivers them after their delays, in order of time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

from rb_dynamics.numerics.nanoseconds import exact_period_ns, nanoseconds, sample_ns
from rb_dynamics.run.sink import Measurement
from rb_dynamics.scene.model import Scene
from rb_dynamics.sensors.sensor import Reading, Sensor, Truth


class SampleTimes:
    """When a sensor takes its samples: number k at k / rate, rounded to a nanosecond."""

    def __init__(self, rate: float) -> None:
        """Take so many samples a second."""
        self._period_ns = exact_period_ns(rate)

    def of(self, sample: int) -> int:
        """Return the time of a sample, ns."""
        return sample_ns(sample, self._period_ns)


class _Measuring:
    """One sensor in a run."""

    def __init__(self, sensor: Sensor, reading: Reading) -> None:
        self.topic, self.delay_ns, self._reading = sensor.name, nanoseconds(sensor.delay), reading
        self._times, self._sample = SampleTimes(sensor.rate), 0

    @property
    def due_ns(self) -> int:
        """Time of its next sample."""
        return self._times.of(self._sample)

    def take(self, truth: Truth) -> Measurement | None:
        """Take the next sample; None if it gives no message."""
        time_ns = self.due_ns
        numbers = self._reading(self._sample, truth)
        self._sample += 1
        if numbers is None:
            return None
        return Measurement(time_ns + self.delay_ns, time_ns, self.topic, numbers)


class Measurements:
    """The sensors of one run."""

    def __init__(self, scene: Scene) -> None:
        """Start before the first sample."""
        self._sensors = [_Measuring(sensor, sensor.reading(scene.seed, scene.frames)) for sensor in scene.sensors]
        # Samples not yet delivered: time of arrival, number of the sensor, time of the sample.
        self._waiting: list[tuple[int, int, int, Measurement]] = []

    @property
    def next_ns(self) -> int:
        """The next time at which a sample is taken or arrives."""
        due_ns = min(sensor.due_ns for sensor in self._sensors)
        return min(due_ns, self._waiting[0][0]) if self._waiting else due_ns

    def at(self, time_ns: int, truth: Truth) -> Iterator[Measurement]:
        """Take the samples due at `time_ns`, and yield those that arrive then, in the order of the scene."""
        for number, sensor in enumerate(self._sensors):
            while sensor.due_ns <= time_ns:
                if (found := sensor.take(truth)) is not None:
                    heapq.heappush(self._waiting, (found.time_ns, number, found.taken_ns, found))
        while self._waiting and self._waiting[0][0] <= time_ns:
            yield heapq.heappop(self._waiting)[3]
