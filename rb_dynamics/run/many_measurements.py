"""`ManyMeasurements`: the sensors of many bodies side by side: what each has measured last, as `Measurements` gives it.

The bodies have the same sensors, with the same rates and delays: samples are taken and arrive at the same times. Errors
and losses are those of each.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING, Any

from rb_dynamics.loads.compiled_load import gravity_numbers, source_numbers
from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.motion.kernel_layout import TRUTHS, find_truths
from rb_dynamics.motion.wheel_arcs_kernel import FIND_ACCELERATIONS
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, nanoseconds
from rb_dynamics.run.measurements import SampleTimes
from rb_dynamics.scene.model import Scene
from rb_dynamics.sensors.many_readings import LOST, READING, READINGS, numbers_of, read_all, words_of

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

# Samples of each body for which the kernel is worth loading.
_AHEAD = 100.0


READ_ALL = OnDemand("rk4", read_all, READINGS, steps=20.0)
FIND_TRUTHS = OnDemand("rk4", find_truths, TRUTHS, steps=20.0)
"""The kernels that read a sensor on many bodies, and find what it senses."""


def has_readable_forces(scene: Scene) -> bool:
    """Return whether accelerometers of the scene can be read together."""
    return gravity_numbers(scene.effects) is not None


def shared_by_sensors(scene: Scene) -> Hashable | None:
    """Return what bodies with the sensors of `scene` have in common; None if not all can be read together."""
    if any(numbers_of(sensor, scene.frames, source_numbers(scene.effects)) is None for sensor in scene.sensors):
        return None
    return tuple((type(each), each.name, each.rate, each.delay) for each in scene.sensors)


def kernel_at_hand() -> bool:
    """Return whether nothing has to be compiled to read them."""
    # Both are asked for.
    found = [kernel.get(_AHEAD, _AHEAD) for kernel in (READ_ALL, FIND_TRUTHS)]
    return None not in found


class _Sensor:
    """One sensor, on all bodies.

    Attributes:
        newest: the last readings that have arrived, (N, `READING`), see `many_readings.py`; NaN before the first.
        taken_s: when they were taken, (N,).
        may_be_silent: whether its target may be out of its view, (N,).
    """

    def __init__(self, scenes: Sequence[Scene], number: int, *, forces: bool) -> None:
        import numpy as np

        sensors = [scene.sensors[number] for scene in scenes]
        self._times, self.delay_ns = SampleTimes(sensors[0].rate), nanoseconds(sensors[0].delay)
        self.may_be_silent = np.array([sensor.may_be_silent for sensor in sensors])
        self._numbers = np.array(
            [
                numbers_of(
                    sensor,
                    scene.frames,
                    source_numbers(scene.effects),
                    gravity_numbers(scene.effects) if forces else None,
                )
                for sensor, scene in zip(sensors, scenes, strict=True)
            ]
        )
        words = [words_of(sensor, scene.seed) for sensor, scene in zip(sensors, scenes, strict=True)]
        self._words = np.array(words, dtype=np.uint64).view(np.int64)
        self.newest = np.full((len(scenes), READING), math.nan)
        self.taken_s = np.full(len(scenes), math.nan)
        self._sample = 0

    @property
    def due_ns(self) -> int:
        """When it takes its next sample."""
        return self._times.of(self._sample)

    def take(self, kernel: Any, truth: Numbers) -> Numbers:
        """Take the next sample."""
        import numpy as np

        found = np.empty_like(self.newest)
        kernel(self._sample, truth, self._numbers, self._words, found)
        self._sample += 1
        return found

    def receive(self, found: Numbers, taken_ns: int) -> None:
        """Receive readings that were taken at `taken_ns`."""
        import numpy as np

        came = found[:, LOST] == 0.0
        taken_s = taken_ns / NANOSECONDS
        if came.all():
            self.newest, self.taken_s = found, np.full(len(found), taken_s)
            return
        self.newest = np.where(came[:, np.newaxis], found, self.newest)
        self.taken_s = np.where(came, taken_s, self.taken_s)


class ManyMeasurements:
    """The sensors of N bodies.

    Attributes:
        sensors: of a body, in the order of the scene.
    """

    def __init__(self, scenes: Sequence[Scene], *, forces: bool = False) -> None:
        """Begin before the first sample, for scenes that share what `shared_by_sensors` returns.

        With `forces`, accelerometers are read, too, if scenes `has_readable_forces`.

        Raises:
            LookupError: the kernels are not there, and not worth compiling now.
        """
        import numpy as np

        ahead = _AHEAD * len(scenes)
        needed = [READ_ALL, FIND_TRUTHS, *([FIND_ACCELERATIONS] if forces else [])]
        kernels: Any = [kernel.get(ahead, ahead) for kernel in needed]
        if None in kernels:
            raise LookupError("the kernels for sensors are not there")
        self._kernel, *self._find = kernels
        bodies = [(*scene.body.center_of_mass, *scene.body.principal_orientation_xyzw) for scene in scenes]
        self._bodies, self._truth = np.ascontiguousarray(np.array(bodies).T), np.empty((len(scenes), 16))
        self.sensors = [_Sensor(scenes, number, forces=forces) for number in range(len(scenes[0].sensors))]
        # Readings not yet delivered: when they arrive, the number of their sensor, when they were taken.
        self._waiting: list[tuple[int, int, int, Numbers]] = []

    @property
    def due_ns(self) -> int:
        """The next time at which a sample is taken."""
        return min(sensor.due_ns for sensor in self.sensors)

    def take(self, rows: Numbers, time_ns: int) -> None:
        """Take the samples that are due at `time_ns`, of the bodies with these numbers, see `find_truths`."""
        for find in self._find:
            find(rows, self._bodies, self._truth)
        for number, sensor in enumerate(self.sensors):
            while sensor.due_ns <= time_ns:
                taken_ns = sensor.due_ns
                found = sensor.take(self._kernel, self._truth)
                heapq.heappush(self._waiting, (taken_ns + sensor.delay_ns, number, taken_ns, found))

    def deliver(self, time_ns: int) -> None:
        """Let the readings arrive that do so by `time_ns`."""
        while self._waiting and self._waiting[0][0] <= time_ns:
            _, number, taken_ns, found = heapq.heappop(self._waiting)
            self.sensors[number].receive(found, taken_ns)

    def silent(self) -> npt.NDArray[np.bool_]:
        """Return which sensors of which bodies have sent no message so far, (N, sensors), as they should have."""
        import numpy as np

        found = [np.isnan(sensor.taken_s) & ~sensor.may_be_silent for sensor in self.sensors]
        return np.stack(found, axis=1)
