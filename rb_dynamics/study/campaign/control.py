"""The closed loop of a block of bodies: measure, evaluate the law, limit its torque; commands apply after a delay.

`block_propagation.py` moves the bodies.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.formats.yaml.fields import Rule
from rb_dynamics.loads.number_ranges import TIME
from rb_dynamics.loads.wheel_set import shares
from rb_dynamics.loads.wrench import largest_wrench
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.vector import Vector, scale
from rb_dynamics.scene.model import Scene
from rb_dynamics.study.campaign.block_propagation import FORCE, TORQUE, Commands
from rb_dynamics.study.campaign.control_inputs import OnboardValues
from rb_dynamics.study.campaign.laws import LAWS, LawInput, Parameters, RandomStreams
from rb_dynamics.study.campaign.model import Campaign, Control
from rb_dynamics.study.campaign.sampling import LAW, NOISE, generator
from rb_dynamics.study.campaign.scenes import scenes_of
from rb_dynamics.study.campaign.user_functions import FunctionError, called, called_for_numbers, find_function

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers
    from rb_dynamics.run.sample_arrays import Samples

DELAY = "control.delay"
"""Key of the time from a sample to the torque computed from it."""

NUMBER = Rule("a finite number")
NOT_NEGATIVE = Rule("a number of 0 or more", lambda v: v >= 0.0, "write a size without a sign")
POSITIVE = Rule("a number greater than 0", lambda v: v > 0.0, "write a size, neither 0 nor with a sign")
_DELAY = Rule(TIME.expected, TIME.holds, "write 0 for none")

RULES: Mapping[str, Rule] = {
    DELAY: _DELAY,
    "control.saturation": POSITIVE,
    "control.noise.attitude": NOT_NEGATIVE,
    "control.noise.rate": NOT_NEGATIVE,
}
"""Limits of the numbers of `Control`, by key; any other may be any `NUMBER`."""

_NONE: Mapping[str, float] = {
    "control.saturation": math.inf,
    **{f"control.bias[{i}]": 0.0 for i in range(3)},
    "control.noise.attitude": 0.0,
    "control.noise.rate": 0.0,
}

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
        failed: why the law gave a body no command, by its index; the body coasts from then on and counts as failed.
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
        given = {**_NONE, **dict(control.numbers)}
        numbers = {key: values[key] if key in values else np.full(count, value) for key, value in given.items()}
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
        self._share = sharing(scenes_of(campaign).base, control.through)
        self._units = {each.name: each.unit for each in scenes_of(campaign).base.actuators}
        self._count, largest = len(bodies), np.array([largest_wrench(body) for body in bodies])
        self._largest: Mapping[str, Numbers] = {FORCE: largest[:, :1], TORQUE: largest[:, 1:]}
        self._most = numbers["control.saturation"][:, None]
        self._bias = np.stack([numbers[f"control.bias[{i}]"] for i in range(3)]).T
        self._sizes = np.stack([numbers["control.noise.attitude"], numbers["control.noise.rate"]], axis=-1)
        self._noise = [generator(campaign.seed, run, NOISE) for run in runs] if self._sizes.any() else []
        self._random = RandomStreams(lambda: [generator(campaign.seed, run, LAW) for run in runs])
        self._drawn: Numbers = np.empty((0, count, 2, 3))
        self._sample, self._silent = 0, tuple[str, ...]()

    def end(self) -> None:
        """Count the runs as failed if their law was never called: they show the uncontrolled body."""
        if self._silent:
            why = f"{self._name} was never called: it waits for a first message from {', '.join(self._silent)}; "
            why += "correct their rate, delay or dropout, or make the run longer"
            self.failed.update(dict.fromkeys(range(self._count), why))

    def commands(self, samples: Samples, onboard: OnboardValues) -> Commands:
        """Return what is commanded at the sample that is due now: nothing before each sensor has sent a message.

        Raises:
            FunctionError: the law raised, returned no array of the right shape, or commands what does not exist.
        """
        self._silent = onboard.silent
        if self._silent:
            return {}
        measured = self._measure(samples, onboard)
        # The law gets arrays of its own, which it may overwrite.
        found = called(self._name, self._law, measured)
        given = found if isinstance(found, Mapping) else {TORQUE: found}
        commands = {name: self._checked(name, value, measured.time_s) for name, value in given.items()}
        if self._share and TORQUE in commands:
            x, y, z = commands.pop(TORQUE).T
            commands |= {wheel: a * x + b * y + c * z for wheel, (a, b, c) in self._share.items()}
        return commands

    def _checked(self, name: str, value: object, time_s: float) -> Numbers:
        """Return one command as numbers, a torque limited and biased; a body fails if they are not valid."""
        import numpy as np

        unit = {TORQUE: "N m", FORCE: "N", **self._units}.get(name)
        if unit is None:
            known = ", ".join([TORQUE, FORCE, *self._units])
            raise FunctionError(
                f"{self._name} returned a command for {name!r}, expected one of {known}; correct the law"
            )
        # The law may change its array later.
        plain = type(value) is np.ndarray and value.dtype == np.float64
        numbers: Numbers = np.array(value) if plain else called_for_numbers(self._name, lambda: value)
        is_wrench = name in self._largest
        shape = (self._count, 3) if is_wrench else (self._count,)
        if numbers.shape != shape:
            what = f"a {name}" if is_wrench else f"a command to {name}"
            raise FunctionError(
                f"{self._name} returned an array of shape {numbers.shape}, expected {shape}: {what} for each body; "
                "correct the law"
            )
        found = numbers
        if name == TORQUE:
            found = np.minimum(np.maximum(numbers, -self._most), self._most) + self._bias
        # What is not a number is not within it, either.
        within = np.abs(found) <= (self._largest[name] if is_wrench else sys.float_info.max)
        if within.all():
            return found
        lost = ~np.all(within.reshape(self._count, -1), axis=-1)
        for place in np.flatnonzero(lost).tolist():
            came, acts = np.atleast_1d(numbers[place]), np.atleast_1d(found[place])
            why = f"no finite {name}" if is_wrench else f"no finite command to {name}"
            if np.isfinite(acts).all():
                with_bias = "" if (acts == came).all() else ", saturated and with its bias"
                size = f"{float(np.abs(acts).max()):.3g} {unit}{with_bias}"
                most = f"{float(self._largest[name][place, 0]):.3g} {unit}"
                why = f"{size}, is more than the {most} that the body can be simulated under"
            shown = ", ".join(map(repr, came.tolist()))
            # A command to an actuator fails only where it is no number, which has no unit.
            shown = f"({shown}) {unit}" if is_wrench else shown
            self.failed.setdefault(place, f"{self._name} returned {shown} at simulation time {time_s!r} s, {why}")
        return np.where(lost[:, None] if is_wrench else lost, 0.0, found)

    def _measure(self, samples: Samples, onboard: OnboardValues) -> LawInput:
        import numpy as np

        time_s = float(samples.time_ns / NANOSECONDS)
        if onboard.sensors:
            return LawInput(time_s, onboard.orientation_xyzw, onboard.angular_velocity_body, self._random, onboard)
        attitude, rate = samples.orientation_xyzw.copy(), samples.angular_velocity_body.copy()
        if self._noise:
            k = self._sample % _AHEAD
            if k == 0:
                # Sample first, so that what is used together lies together in memory.
                self._drawn = np.stack([each.standard_normal((_AHEAD, 2, 3)) for each in self._noise], axis=1)
            self._sample += 1
            noise = self._drawn[k] * self._sizes[:, :, None]
            attitude = _turned(attitude, noise[:, 0]) if self._sizes[:, 0].any() else attitude
            rate += noise[:, 1]
        return LawInput(time_s, attitude, rate, self._random, onboard)


def sharing(scene: Scene, through: Sequence[str]) -> Mapping[str, Vector]:
    """Return the row, by wheel, that makes its torque from that on the body, with the least sum of squares.

    With the axes a of the base scene: u = -a . (sum of a a^T)^-1 torque. Empty if the torque acts by itself.

    Raises:
        SceneError: there are no such wheels, or their axes lie in a plane.
    """
    wheels = {wheel.name: wheel for wheel in scene.wheels if wheel.command == "torque"}
    if any(name not in wheels for name in through):
        raise SceneError(
            f"names of reaction wheels of which a torque is commanded, known: {', '.join(wheels) or 'none'}"
        )
    axes = [wheels[name].axis for name in through]
    if not axes:
        return {}
    rows = shares(axes)
    if rows is None:
        raise SceneError("three wheels or more, with axes that do not lie in one plane")
    return {name: scale(-1.0, row) for name, row in zip(through, rows, strict=True)}


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
