"""The closed loop of a block of bodies: measure with noise, ask the law, saturate, and command after a delay.

Never moves a body: `flight.py` does.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rb_dynamics.campaign.laws import LAWS, Measurement, Parameters
from rb_dynamics.campaign.model import Campaign, Control
from rb_dynamics.campaign.named import named
from rb_dynamics.campaign.sampling import NOISE, generator
from rb_dynamics.errors import SceneError
from rb_dynamics.motion.step_control import NANOSECONDS

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.samples import Samples

    Numbers = npt.NDArray[np.float64]

_AHEAD = 64
"""Samples for which noise is drawn at a time."""


class Loop:
    """The controllers of N runs.

    Attributes:
        delays_ns: (N,), from a sample to the torque it commands, integer nanoseconds.
    """

    def __init__(
        self, campaign: Campaign, control: Control, runs: Sequence[int], values: Mapping[str, Numbers], unit_ns: int
    ) -> None:
        """Make the law.

        Args:
            campaign: that they belong to.
            control: its loop.
            runs: their numbers.
            values: by the name of each input, (N,).
            unit_ns: delays are rounded to whole multiples of it.
        """
        import numpy as np

        count = len(runs)
        numbers = {key: values[key] if key in values else np.full(count, value) for key, value in control.numbers}
        try:
            self._law = named(control.law, LAWS, campaign.modules)(_parameters(numbers))
        except SceneError as error:
            raise SceneError(f"{campaign.source}: control.law: {error}") from error
        self.name = control.law
        self.delays_ns = np.rint(numbers["control.delay"] * (NANOSECONDS / unit_ns)).astype(np.int64) * unit_ns
        self._most = numbers["control.saturation"][:, None]
        self._bias = np.stack([numbers[f"control.bias[{i}]"] for i in range(3)], axis=-1)
        self._sizes = np.stack([numbers["control.noise.attitude"], numbers["control.noise.rate"]], axis=-1)
        self._noise = [generator(campaign.seed, run, NOISE) for run in runs] if self._sizes.any() else []
        self._drawn: Numbers = np.empty((0, count, 2, 3))
        self._sample = 0

    def torque(self, samples: Samples) -> Numbers:
        """Return the torques (N, 3), body axes, N m, that are commanded at the next sample, of which the time has come.

        Raises:
            SceneError: the law returned something else.
        """
        import numpy as np

        measured = self._measure(samples)
        torque = np.asarray(self._law(measured), dtype=np.float64)
        if torque.shape != measured.angular_velocity_body.shape:
            raise SceneError(
                f"control.law: {self.name} returned an array of shape {torque.shape}, expected "
                f"{measured.angular_velocity_body.shape}: a torque for each body; correct the law"
            )
        limited: Numbers = np.minimum(np.maximum(torque, -self._most), self._most)
        biased: Numbers = limited + self._bias
        return biased

    def _measure(self, samples: Samples) -> Measurement:
        import numpy as np

        time_s = samples.time_ns / NANOSECONDS
        if not self._noise:
            return Measurement(float(time_s), samples.orientation_xyzw, samples.angular_velocity_body)
        k = self._sample % _AHEAD
        if k == 0:
            # By sample first: what is taken at a time then lies together.
            self._drawn = np.stack([each.standard_normal((_AHEAD, 2, 3)) for each in self._noise], axis=1)
        self._sample += 1
        noise = self._drawn[k] * self._sizes[:, :, None]
        attitude = samples.orientation_xyzw
        if self._sizes[:, 0].any():
            attitude = _turned(attitude, noise[:, 0])
        return Measurement(float(time_s), attitude, samples.angular_velocity_body + noise[:, 1])


def _parameters(numbers: Mapping[str, Numbers]) -> Parameters:
    """Return what stands below `control.parameters`: numbers as they are, lists together."""
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
    """Return attitudes turned by small rotation vectors (rad, body axes), right to second order, of unit length."""
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
