"""Warn before the runs of a control loop that samples too slowly to be stable.

For the laws of this package small motion about rest is linear: theta' = w, I w' = h x w + u, with the momentum h of
wheels and rotors at the start and u = -k theta - d w sampled every T, acting a delay later and held, through a channel
that may have a delay and a lag of its own. Each sample multiplies the state by a matrix; the motion grows if an
eigenvalue has a magnitude above 1 (Astrom and Wittenmark, Computer-Controlled Systems, section 3.2). Any other law may
keep state and read sensors, so its matrix is not known: run 0 is simulated with it, and again with half the period and
delay. If the rate of the body grows, and grows much less in the second run, the period is the cause.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, NamedTuple

from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.reaction_wheel import NEAR_LIMIT
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.vector import norm
from rb_dynamics.run.scene_remarks import TURN_SEEN, gyrostat, has_momentum_inside, scene_remarks
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.read import parse_scene
from rb_dynamics.study.campaign.block_of_runs import simulate_alone, values_of
from rb_dynamics.study.campaign.block_propagation import CHANNEL
from rb_dynamics.study.campaign.control import DELAY, delay_ns
from rb_dynamics.study.campaign.distributions import Choice
from rb_dynamics.study.campaign.model import Campaign, Control
from rb_dynamics.study.campaign.scenes import Scenes
from rb_dynamics.study.campaign.user_functions import FunctionError

if TYPE_CHECKING:
    from rb_dynamics.numerics.array_types import Numbers
    from rb_dynamics.run.sample_arrays import Samples

_GAINS: Mapping[str, tuple[str, str]] = {"rate_damping": ("", "gain"), "attitude_pd": ("proportional", "derivative")}
"""Parameters of a law: stiffness and damping."""

_MAX_DELAY = 200
"""Samples of delay up to which eigenvalues are computed."""

_MAX_SAMPLES, _MIN_SAMPLES, _MIN_DIVERGING = 1000, 16, 4
"""Largest and least number of samples of a trial flight; the last is the least of one that diverges."""

_GROWTH, _GROWTH_RATIO = 2.0, 1.6
"""Growth of the rate in a flight, and its ratio to that with finer sampling, beyond which the period is the cause.

Growth caused by the period T is of order T^2 (Euler's method on w' = i W w grows by sqrt(1 + (W T)^2) per step), so
with half the period a flight grows by the square root only. The ratio is above that of noise, sqrt(2).
"""

_FRACTIONS = 2, 8
"""Divisors of period and delay in finer flights; the last is for a flight that diverges with the first, too."""


def remarks(campaign: Campaign) -> list[str]:
    """Return warnings about the scene and the control period of a campaign."""
    control, base = campaign.control, Scenes(campaign).base
    found = scene_remarks(base)
    if control is None:
        return found
    period_s, delay_s = float(control.period_ns / NANOSECONDS), delay_ns(control, {}) / NANOSECONDS
    turn = norm(base.initial.angular_velocity_body) * period_s
    if turn > TURN_SEEN:
        found.append(
            f"the body turns by {turn:.2g} rad from one sample of the control law to the next; raise control.rate"
        )
    names = _GAINS.get(control.law)
    if names is None:
        return found + _effect_of_period(campaign, control)
    if base.actuators:
        found += _actuator_limits(campaign, _trial_flight(campaign, control.period_ns))
    # Wheels that give the torque are commanded themselves, not the channel.
    channel = next((each for each in base.channels if each.topic == CHANNEL and not control.through), Channel(CHANNEL))
    delay_s += channel.delay
    lagging = f", followed with a lag of {channel.lag:g} s" if channel.lag else ""
    numbers = dict(control.numbers)
    gains = tuple(numbers.get(f"control.parameters.{name}", 0.0) for name in names)
    growth, where = _growth(base, gains, period_s, delay_s, channel.lag)
    if growth > 1.0 + 1e-9:
        found.append(
            f"{control.law} is unstable {where}: for a period of {period_s:g} s and a delay of {delay_s:g} s"
            f"{lagging}, an error grows by a factor of {growth:.3g} per sample; lower the gain or raise control.rate"
        )
    return found


def _growth(scene: Scene, gains: Sequence[float], period_s: float, delay_s: float, lag_s: float) -> tuple[float, str]:
    """Return by how much small motion of a scene grows per sample, and about which axis it is unstable."""
    import numpy as np

    if not has_momentum_inside(scene):
        for moment in sorted(set(scene.body.principal_moments)):
            stiffness, damping = (gain / moment for gain in gains)
            growth = growth_per_sample(stiffness, damping, period_s, delay_s, lag_s)
            if growth > 1.0 + 1e-9:
                return growth, f"about the axis of {moment:.4g} kg m²"
        return 0.0, ""
    inside, each, turning = gyrostat(scene)
    stiff, damped = ((gain * each).astype(np.float64) for gain in gains)
    growth = growth_per_sample(stiff, damped, period_s, delay_s, lag_s, turning)
    return growth, f"with {np.linalg.norm(inside):.3g} N m s in wheels and rotors"


class _TrialEndError(Exception):
    """Ends a trial flight that needs no more samples."""


def _effect_of_period(campaign: Campaign, control: Control) -> list[str]:
    """Return warnings from a trial of run 0, and from one with half the period and delay."""
    period_s, delay_s = float(control.period_ns / NANOSECONDS), delay_ns(control, values_of(campaign, 0)) / NANOSECONDS
    flight = _trial_flight(_sampled_faster(campaign, control, delay_s, 1), control.period_ns)
    rates, found = flight.rates, _actuator_limits(campaign, flight)
    diverges = _diverges(rates, control.period_ns)
    if len(rates) < (_MIN_DIVERGING if diverges else _MIN_SAMPLES):
        return found
    start, *_, end = _quarters(rates)
    # Fast growth may reach its maximum within the first quarter.
    if end < _GROWTH * min(start, rates[0]):
        return found
    for parts in _FRACTIONS if diverges else _FRACTIONS[:1]:
        finer = _trial_flight(_sampled_faster(campaign, control, delay_s, parts), control.period_ns, len(rates)).rates
        if len(finer) == len(rates) and end > _GROWTH_RATIO * (most := max(_quarters(finer))):
            break
    else:
        return found
    part = "half" if parts == 2 else f"1/{parts} of"
    sensed = Scenes(campaign).base.sensors
    keeping_up = ", and sensors as fast," if sensed else ""
    raised = "control.rate and the rate of sensors" if sensed else "control.rate"
    message = (
        f"{control.law} depends on its period of {period_s:g} s: in the first {(len(rates) - 1) * period_s:g} s of run "
        f"0 the rate of the body grows to {end:.2g} rad/s, with {part} the period and delay{keeping_up} to no more "
        f"than {most:.2g}; a torque that has to change within the period, such as a gyroscopic one, drives what it "
        f"should damp while it is held: lower the gain, raise {raised}, or let actuators or effects of the scene give "
        "it"
    )
    return [*found, message]


def _sampled_faster(campaign: Campaign, control: Control, delay_s: float, parts: int) -> Campaign:
    """Return `campaign` with a part of the period and of the delay, `delay_s`, of run 0, and without noise.

    Sensors keep up with that: no faster than the law, unless they are anyway.
    """
    given = {DELAY: delay_s / parts, "control.noise.attitude": 0.0, "control.noise.rate": 0.0}
    period_ns = max(Fraction(1), control.period_ns / parts)
    sensors: dict[str, float] = {}
    if parts > 1:
        for each in Scenes(campaign).base.sensors:
            rate = max(each.rate, min(parts * each.rate, float(NANOSECONDS / period_ns)))
            sensors |= {f"sensors.{each.name}.rate": rate, f"sensors.{each.name}.delay": each.delay / parts}
    text = parse_scene(campaign.scene_text, campaign.source, sensors).text if sensors else campaign.scene_text
    given |= sensors
    numbers = tuple((key, given.get(key, value)) for key, value in control.numbers)
    inputs = tuple(
        replace(each, distribution=Choice((given[each.name],), (1.0,))) if each.name in given else each
        for each in campaign.inputs
    )
    control = replace(control, period_ns=period_ns, numbers=numbers)
    return replace(campaign, scene_text=text, control=control, inputs=inputs)


class _TrialFlight(NamedTuple):
    """Results of a trial flight of run 0.

    Attributes:
        rates: angular rate every period, rad/s.
        full: wheels that came near their `max_speed`, and when first, s.
        rejected: number of rejected commands.
    """

    rates: list[float]
    full: dict[str, float]
    rejected: int


def _trial_flight(campaign: Campaign, period_ns: Fraction, most: int = _MAX_SAMPLES) -> _TrialFlight:
    """Simulate run 0, observed every period, until it diverges, fails or has `most` samples."""
    rates: list[float] = []
    full: dict[str, float] = {}
    rejected, wheels = 0, Scenes(campaign).base.wheels

    def watch(samples: Samples) -> None:
        nonlocal rejected
        rates.append(math.hypot(*samples.angular_velocity_body[0].tolist()))
        if wheels:
            for wheel, speed in zip(wheels, samples.wheel_speeds[0].tolist(), strict=True):
                if abs(speed) >= NEAR_LIMIT * wheel.max_speed:
                    full.setdefault(wheel.name, float(samples.time_ns / NANOSECONDS))
        rejected = int(samples.rejected_commands[0])
        if len(rates) == most or _diverges(rates, period_ns):
            raise _TrialEndError

    # The campaign reports the error of a run that fails in its row.
    with contextlib.suppress(_TrialEndError, ConvergenceError, FunctionError, SceneError):
        simulate_alone(replace(campaign, observe_ns=period_ns, metrics=()), 0, watch=watch)
    return _TrialFlight(rates, full, rejected)


def _actuator_limits(campaign: Campaign, flight: _TrialFlight) -> list[str]:
    """Return warnings about limits that actuators meet in run 0."""
    speeds = {wheel.name: wheel.max_speed for wheel in Scenes(campaign).base.wheels}
    found = [
        f"{name} comes near its max_speed of {speeds[name]:g} rad/s in run 0, at {at:g} s, beyond which its "
        "motor does not drive it; unload its momentum by other means, or raise max_speed"
        for name, at in flight.full.items()
    ]
    if flight.rejected:
        found.append(
            f"{flight.rejected} commands are rejected in the first {len(flight.rates)} samples of run 0, such as an "
            "on-time below minimum_on; --rerun 0 writes a log, and inspect shows the details"
        )
    return found


def _diverges(rates: list[float], period_ns: Fraction) -> bool:
    """Return whether the last of `rates` turns the body by more than half a turn in a period."""
    return bool(rates) and rates[-1] * period_ns > math.pi * NANOSECONDS


def _quarters(rates: list[float]) -> tuple[float, ...]:
    """Return the root mean square of each quarter of `rates`."""
    size = len(rates) // 4
    parts = (rates[k * size : (k + 1) * size] for k in range(3))
    return tuple(math.hypot(*part) / math.sqrt(len(part)) for part in (*parts, rates[3 * size :]))


def growth_per_sample(
    stiffness: float | Numbers,
    damping: float | Numbers,
    period_s: float,
    delay_s: float,
    lag_s: float = 0.0,
    turning: float | Numbers = 0.0,
) -> float:
    """Return the factor by which theta'' = turning theta' - stiffness theta - damping theta' grows.

    Numbers, or n x n matrices. The command is computed every `period_s`, takes effect `delay_s` later, is held, and is
    followed with a lag. Returns 0 if the delay is too long for the computation.
    """
    import numpy as np
    from scipy.linalg import expm

    whole, part_s = divmod(delay_s, period_s)
    waiting = int(whole) + 1
    if waiting > _MAX_DELAY:
        return 0.0
    stiffness, damping, turning = (np.atleast_2d(each) for each in (stiffness, damping, turning))
    one, free = np.eye(n := len(stiffness)), not stiffness.any()
    # Derivatives of theta, w and, with a lag, the acting torque; the last columns are for the command.
    count = 3 * n if lag_s > 0.0 else 2 * n
    rates = np.zeros((count + n, count + n))
    rates[:n, n : 2 * n] = rates[n : 2 * n, 2 * n : 3 * n] = one
    rates[n : 2 * n, n : 2 * n] = turning
    if lag_s > 0.0:
        rates[2 * n : 3 * n, 2 * n :] = np.hstack([-one, one]) / lag_s
    before, after = expm(part_s * rates)[:count], expm((period_s - part_s) * rates)[:count]
    # Behind them the commands of the last samples, newest first; the one that acts after `part_s` is `waiting` - 1
    # samples old, and the one before it acts until then.
    size = count + waiting * n
    command, states = np.zeros((n, size)), np.eye(size)
    command[:, : 2 * n] = np.hstack([-stiffness, -damping])
    new = command if waiting == 1 else states[size - 2 * n : size - n]
    matrix = np.zeros((size, size))
    then = before[:, :count] @ states[:count] + before[:, count:] @ states[size - n :]
    matrix[:count] = after[:, :count] @ then + after[:, count:] @ new
    matrix[count : count + n] = command
    matrix[count + n :, count:-n] = np.eye(size - count - n)
    if free:
        # Without stiffness, the eigenvalue 1 of the attitude says nothing.
        matrix = matrix[n:, n:]
    return float(np.abs(np.linalg.eigvals(matrix)).max())
