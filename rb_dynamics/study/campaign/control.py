"""The closed loop of a block of bodies: measure with noise, evaluate the law, saturate, and apply after a delay.

`flight.py` moves the bodies.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.wrench import largest_wrench
from rb_dynamics.numerics.nanoseconds import LONGEST, NANOSECONDS
from rb_dynamics.scene.fields import Rule
from rb_dynamics.study.campaign.laws import LAWS, Measurement, Parameters
from rb_dynamics.study.campaign.model import Campaign, Control
from rb_dynamics.study.campaign.sampling import NOISE, generator
from rb_dynamics.study.campaign.user_functions import called, called_for_numbers, find_function

if TYPE_CHECKING:
    from rb_dynamics.numerics.arrays import Numbers
    from rb_dynamics.run.sample_arrays import Samples

DELAY = "control.delay"
"""Key of the time from a sample to the torque computed from it."""

NUMBER = Rule("a finite number")
NOT_NEGATIVE = Rule("a number of 0 or more", lambda v: v >= 0.0, "write a size without a sign")
POSITIVE = Rule("a number greater than 0", lambda v: v > 0.0, "write a size, neither 0 nor with a sign")
_DELAY = Rule(f"a number from 0 to {LONGEST:.1e} (s)", lambda v: 0.0 <= v <= LONGEST, "write a time of 0 or more")

RULES: Mapping[str, Rule] = {
    DELAY: _DELAY,
    "control.saturation": POSITIVE,
    "control.noise.attitude": NOT_NEGATIVE,
    "control.noise.rate": NOT_NEGATIVE,
}
"""Limits of the numbers of `Control`, by key; any other may be any `NUMBER`."""

_AHEAD = 64
"""Noise is drawn for this many samples at a time."""


def check_values(values: Mapping[str, float]) -> None:
    """Check the dispersed values of a controller.

    Raises:
        SceneError: a value is outside its limits.
    """
    for key, value in values.items():
        rule = RULES.get(key, NUMBER)
        if key.startswith("control.") and not (math.isfinite(value) and rule.accepts(value)):
            raise SceneError(
                f"{key}: found {value!r}, expected {rule.expected}; disperse it less, or with low and high"
            )


def delay_ns(control: Control, values: Mapping[str, float]) -> int:
    """Return the delay of a run in integer nanoseconds."""
    return round(values.get(DELAY, dict(control.numbers)[DELAY]) * NANOSECONDS)


class ControlLoop:
    """The controllers of N runs.

    Attributes:
        failed: why the law gave a body no torque, by its index; the body coasts from then on and counts as failed.
    """

    def __init__(
        self,
        campaign: Campaign,
        control: Control,
        runs: Sequence[int],
        values: Mapping[str, Numbers],
        bodies: Sequence[RigidBody],
    ) -> None:
        """Make the law.

        Args:
            campaign: the campaign of the runs.
            control: its control loop.
            runs: their numbers.
            values: of each input, by its name, (N,).
            bodies: that they turn, N.

        Raises:
            FunctionError: the law raised.
            SceneError: there is no such law, or it does not return a function.
        """
        import numpy as np

        count = len(runs)
        numbers = {key: values[key] if key in values else np.full(count, value) for key, value in control.numbers}
        try:
            make = find_function(control.law, LAWS, campaign.modules)
        except SceneError as error:
            raise SceneError(f"{campaign.source}: control.law: {error}") from error
        self._name = f"control.law: {control.law}"
        self._law = called(self._name, make, _parameters(numbers))
        if not callable(self._law):
            raise SceneError(
                f"{self._name} returned {self._law!r}, expected a function of the measurement; correct the law"
            )
        self.failed: dict[int, str] = {}
        self._largest = [largest_wrench(body) for body in bodies]
        self._possible = np.array([[torque] for _, torque in self._largest])
        self._most = numbers["control.saturation"][:, None]
        self._bias = np.stack([numbers[f"control.bias[{i}]"] for i in range(3)], axis=-1)
        self._sizes = np.stack([numbers["control.noise.attitude"], numbers["control.noise.rate"]], axis=-1)
        self._noise = [generator(campaign.seed, run, NOISE) for run in runs] if self._sizes.any() else []
        self._drawn: Numbers = np.empty((0, count, 2, 3))
        self._sample = 0

    def torque(self, samples: Samples) -> Numbers:
        """Return the torques (N, 3), body axes, N m, commanded at the sample that is due now.

        Raises:
            FunctionError: the law raised.
            SceneError: the law did not return an array of the right shape.
        """
        import numpy as np

        measured = self._measure(samples)
        # The law gets arrays of its own, which it may overwrite.
        torque = called_for_numbers(self._name, self._law, measured)
        if torque.shape != measured.angular_velocity_body.shape:
            raise SceneError(
                f"{self._name} returned an array of shape {torque.shape}, expected "
                f"{measured.angular_velocity_body.shape}: a torque for each body; correct the law"
            )
        limited: Numbers = np.minimum(np.maximum(torque, -self._most), self._most)
        biased: Numbers = limited + self._bias
        # What is no number is not within it, either.
        lost = ~np.all(np.abs(biased) <= self._possible, axis=-1, keepdims=True)
        for place in np.flatnonzero(lost).tolist():
            x, y, z = torque[place].tolist()
            why = "no finite torque"
            if np.isfinite(biased[place]).all():
                with_bias = "" if (biased[place] == torque[place]).all() else ", saturated and with its bias"
                size = f"{float(np.abs(biased[place]).max()):.3g} N m{with_bias}"
                why = f"{size}, is more than the {self._largest[place][1]:.3g} N m that the body can be simulated under"
            self.failed.setdefault(
                place,
                f"{self._name} returned ({x!r}, {y!r}, {z!r}) N m at simulation time {measured.time_s!r} s, {why}",
            )
        return np.where(lost, 0.0, biased) if lost.any() else biased

    def _measure(self, samples: Samples) -> Measurement:
        import numpy as np

        time_s = samples.time_ns / NANOSECONDS
        if not self._noise:
            return Measurement(float(time_s), samples.orientation_xyzw.copy(), samples.angular_velocity_body.copy())
        k = self._sample % _AHEAD
        if k == 0:
            # Sample first, so that what is used together lies together in memory.
            self._drawn = np.stack([each.standard_normal((_AHEAD, 2, 3)) for each in self._noise], axis=1)
        self._sample += 1
        noise = self._drawn[k] * self._sizes[:, :, None]
        attitude = samples.orientation_xyzw.copy()
        if self._sizes[:, 0].any():
            attitude = _turned(attitude, noise[:, 0])
        return Measurement(float(time_s), attitude, samples.angular_velocity_body + noise[:, 1])


def _parameters(numbers: Mapping[str, Numbers]) -> Parameters:
    """Return the values below `control.parameters`: scalars as they are, the elements of lists stacked."""
    import numpy as np

    parts: dict[str, list[Numbers]] = {}
    scalars: dict[str, Numbers] = {}
    for key, value in numbers.items():
        name = key.removeprefix("control.parameters.")
        if name == key:
            continue
        match = re.fullmatch(r"(.+)\[\d+\]", name)
        if match is None:
            scalars[name] = value
        else:
            parts.setdefault(match[1], []).append(value)
    return scalars | {name: np.stack(columns, axis=-1) for name, columns in parts.items()}


def _turned(orientation: Numbers, angles: Numbers) -> Numbers:
    """Return attitudes rotated by small rotation vectors (rad, body axes), to second order, normalized."""
    import numpy as np

    x, y, z, w = orientation.T
    a, b, c = 0.5 * angles.T
    turned = (
        x + a * w + c * y - b * z,
        y + b * w + a * z - c * x,
        z + c * w + b * x - a * y,
        w - a * x - b * y - c * z,
    )
    length = np.sqrt(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2] + turned[3] * turned[3])
    return np.stack([component / length for component in turned], axis=-1)
