"""Metrics of a run: quantities of its state, and how each is reduced over the run.

Quantities are functions of `Samples`, so that one call evaluates a block of runs. Users can add their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from rb_dynamics.errors import SceneError
from rb_dynamics.loads.actuator import Actuator
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.study.campaign.model import Campaign, Metric
from rb_dynamics.study.campaign.user_functions import FunctionError, called_for_numbers, find_function

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers
    from rb_dynamics.run.sample_arrays import Samples

Quantity = Callable[["Samples"], "Numbers"]
"""Takes samples of N bodies, and returns one number per body: (N,)."""


def rate(samples: Samples) -> Numbers:
    """Return |w|, rad/s."""
    return _length(samples.angular_velocity_body)


def angular_momentum(samples: Samples) -> Numbers:
    """Return |L| about the centre of mass, kg m^2/s."""
    return _length(samples.angular_momentum_world)


def energy(samples: Samples) -> Numbers:
    """Return the kinetic energy, J."""
    return samples.kinetic_energy


def energy_defect(samples: Samples) -> Numbers:
    """Return |T - T0 - work|, J, a measure of the integration error."""
    import numpy as np

    return np.abs(samples.energy_defect)


def wheel_speed(samples: Samples) -> Numbers:
    """Return the largest |speed| of a reaction wheel, rad/s."""
    import numpy as np

    speed: Numbers = np.abs(samples.wheel_speeds).max(axis=-1)
    return speed


def rejected_commands(samples: Samples) -> Numbers:
    """Return how many commands were rejected so far, such as an on-time below `minimum_on`."""
    return samples.rejected_commands


def clipped_commands(samples: Samples) -> Numbers:
    """Return how many commands limits have reduced so far."""
    return samples.clipped_commands


def attitude_from(target_xyzw: Sequence[float]) -> Quantity:
    """Return the function that gives the rotation angle from `target_xyzw`, rad, 0 to pi."""
    a, b, c, d = target_xyzw

    def attitude(samples: Samples) -> Numbers:
        import numpy as np

        x, y, z, w = samples.orientation_xyzw.T
        error = (
            d * x - a * w - b * z + c * y,
            d * y + a * z - b * w - c * x,
            d * z - a * y + b * x - c * w,
        )
        size = np.sqrt(error[0] * error[0] + error[1] * error[1] + error[2] * error[2])
        angle: Numbers = 2.0 * np.arctan2(size, np.abs(d * w + a * x + b * y + c * z))
        return angle

    return attitude


QUANTITIES: Mapping[str, tuple[str, str]] = {
    "attitude": ("angle from the target attitude", "rad"),
    "rate": ("angular rate", "rad/s"),
    "angular_momentum": ("angular momentum", "kg m²/s"),
    "energy": ("kinetic energy", "J"),
    "energy_defect": ("defect of the energy", "J"),
    "wheel_speed": ("largest speed of a wheel", "rad/s"),
    "rejected_commands": ("rejected commands", ""),
    "clipped_commands": ("clipped commands", ""),
}
"""Description and unit of each quantity."""

_FUNCTIONS: Mapping[str, Quantity] = {
    "rate": rate,
    "angular_momentum": angular_momentum,
    "energy": energy,
    "energy_defect": energy_defect,
    "wheel_speed": wheel_speed,
    "rejected_commands": rejected_commands,
    "clipped_commands": clipped_commands,
}

LARGEST: Mapping[str, float] = {"attitude": math.pi}
"""Largest possible value of a quantity, if it has one; the least of each is 0."""

OF_ACTUATORS: Mapping[str, type[Actuator]] = {
    "wheel_speed": ReactionWheel,
    "rejected_commands": Actuator,
    "clipped_commands": Actuator,
}
"""Quantities for which the scene must list actuators, and of which type."""


def _length(vectors: Numbers) -> Numbers:
    import numpy as np

    x, y, z = vectors.T
    length: Numbers = np.sqrt(x * x + y * y + z * z)
    return length


def quantity(campaign: Campaign, metric: Metric) -> Quantity:
    """Return the function that `metric` evaluates.

    Raises:
        SceneError: there is no quantity of that name.
    """
    if metric.quantity == "attitude":
        return attitude_from(metric.target_xyzw)
    try:
        return find_function(metric.quantity, _FUNCTIONS, campaign.modules)
    except SceneError as error:
        raise SceneError(f"{campaign.source}: metrics.{metric.name}.{metric.reduction}: {error}") from error


class MetricAccumulator:
    """The metrics of N runs, accumulated over time in constant memory."""

    def __init__(self, campaign: Campaign, count: int) -> None:
        """Start without observations."""
        functions: dict[tuple[object, ...], tuple[Quantity, list[_Reduction]]] = {}
        self._reductions: dict[str, _Reduction] = {}
        self._count = count
        for metric in campaign.metrics:
            reduction = self._reductions[metric.name] = REDUCTIONS[metric.reduction](metric, count)
            # Each quantity is evaluated once, however many metrics use it.
            key = (metric.quantity, metric.target_xyzw)
            functions.setdefault(key, (quantity(campaign, metric), []))[1].append(reduction)
        self._functions = list(functions.items())

    def add(self, samples: Samples, *, is_last: bool) -> None:
        """Add N bodies at a later time than before.

        Of a quantity of this package, of which all metrics take the last value, no other is computed. A function of a
        user may keep state, and is always called.

        Raises:
            FunctionError: a user function raised, or did not return one number per body.
        """
        time_s, count = float(samples.time_ns / NANOSECONDS), self._count
        for (name, *_), (function, reductions) in self._functions:
            if not is_last and name in QUANTITIES and all(type(each) is _Reduction for each in reductions):
                continue
            values = called_for_numbers(f"metrics: {name}", function, samples)
            if values.shape != (count,):
                raise FunctionError(
                    f"metrics: {name} returned an array of shape {values.shape}, expected ({count},): a number for "
                    "each body; correct the function"
                )
            for reduction in reductions:
                reduction.take(time_s, values)

    def results(self) -> dict[str, Numbers]:
        """Return each metric by name, (N,)."""
        return {name: reduction.result() for name, reduction in self._reductions.items()}


class _Reduction:
    """Reduces a quantity over time; this class keeps the last value."""

    def __init__(self, metric: Metric, count: int) -> None:
        import numpy as np

        self._metric = metric
        self._value: Numbers = np.full(count, math.nan)
        self._begun = False

    def take(self, time_s: float, values: Numbers) -> None:
        """Add the values (N,) at a later time."""
        self._value = values

    def result(self) -> Numbers:
        """Return the metric, (N,)."""
        return self._value


class _Worst(_Reduction):
    """The largest value; NaN if one is NaN, as that one may have been the largest."""

    def take(self, time_s: float, values: Numbers) -> None:
        import numpy as np

        self._value = np.maximum(self._value, values) if self._begun else values
        self._begun = True


class _Least(_Worst):
    """The smallest value; NaN if one is NaN."""

    def take(self, time_s: float, values: Numbers) -> None:
        super().take(time_s, -values)

    def result(self) -> Numbers:
        return -super().result()


class _Mean(_Reduction):
    """The mean over time, by the trapezoidal rule."""

    def __init__(self, metric: Metric, count: int) -> None:
        import numpy as np

        super().__init__(metric, count)
        self._sum, self._since, self._time, self._last = np.zeros(count), math.nan, 0.0, np.zeros(count)

    def take(self, time_s: float, values: Numbers) -> None:
        if math.isnan(self._since):
            self._since = time_s
        else:
            self._sum = self._sum + 0.5 * (time_s - self._time) * (values + self._last)
        self._time, self._last = time_s, values

    def result(self) -> Numbers:
        return self._sum / (self._time - self._since) if self._time > self._since else self._last


class _TimeTo(_Reduction):
    """The first observation (s) at which the condition holds (with `stays`: holds to the end); NaN if none."""

    def take(self, time_s: float, values: Numbers) -> None:
        import numpy as np

        metric = self._metric
        holds = (values < metric.below) & (values > metric.above)
        self._value = np.where(np.isnan(self._value) & holds, time_s, self._value)
        if metric.stays:
            self._value = np.where(holds, self._value, math.nan)


REDUCTIONS: Mapping[str, type[_Reduction]] = {
    "final": _Reduction,
    "worst": _Worst,
    "least": _Least,
    "mean": _Mean,
    "time_to": _TimeTo,
}
