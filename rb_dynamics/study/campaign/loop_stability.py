"""Tell before the runs whether a loop samples too slowly to be stable.

For the laws of this package small motion about rest is linear: theta' = w, I w' = h x w + u, with the momentum h of
wheels and rotors at the start and u = -k theta - d w sampled every T, acting a delay later and held, through a channel
that may have a delay and a lag of its own. Each sample multiplies the state by a matrix; the motion grows if an
eigenvalue has a magnitude above 1 (Astrom and Wittenmark, Computer-Controlled Systems, section 3.2). Any other law may
keep state and see sensors, so its matrix is not known: run 0 is simulated with it, and again with half the period and
delay. If a rate grows, and grows much less in the second run, the period is the cause.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.command_channels import Channel
from rb_dynamics.loads.reaction_wheel import NEAR_LIMIT
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

_MOST_WAITING = 200
"""Samples of delay up to which eigenvalues are computed."""

_MOST_SAMPLES, _LEAST_SAMPLES, _LEAST_AWAY = 1000, 16, 4
"""Samples that a trial flight has at most, and those below which it tells nothing; the last where it runs away."""

_GROWN, _MORE = 2.0, 1.6
"""Growth of the rate in a flight, and its ratio to that of a finer one, beyond which the period is to blame.

Growth that the period causes goes with its square (Euler's method on w' = i W w grows by sqrt(1 + (W T)^2) per step),
so with half of it a flight grows by the square root only. The second is above that of noise, sqrt(2).
"""

_PARTS = 2, 8
"""Parts of period and delay in finer flights; the last where the first runs away too."""


def remarks(campaign: Campaign) -> list[str]:
    """Return what is wrong with the scene and the control period of a campaign, empty if nothing is known to be."""
    control, base = campaign.control, Scenes(campaign).base
    found = scene_remarks(base)
    if control is None:
        return found
    period_s, delay_s = control.period_ns / NANOSECONDS, delay_ns(control, {}) / NANOSECONDS
    turn = norm(base.initial.angular_velocity_body) * period_s
    if turn > TURN_SEEN:
        found.append(
            f"the body turns by {turn:.2g} rad from one sample of the control law to the next; raise control.rate"
        )
    names = _GAINS.get(control.law)
    if names is None:
        return found + _tried(campaign, control)
    if base.actuators:
        found += _strain(campaign, _flown(campaign, control.period_ns))
    # Wheels that give the torque are commanded themselves, not the channel.
    channel = next((each for each in base.channels if each.topic == CHANNEL and not control.through), Channel(CHANNEL))
    delay_s += channel.delay
    lagging = f", followed with a lag of {channel.lag:g} s" if channel.lag else ""
    numbers = dict(control.numbers)
    gains = tuple(numbers.get(f"control.parameters.{name}", 0.0) for name in names)
    growth, where = _growth(base, gains, period_s, delay_s, channel.lag)
    if growth > 1.0 + 1e-9:
        found.append(
            f"{control.law} is unstable {where}: with a period of {period_s:g} s and a delay of {delay_s:g} s"
            f"{lagging}, an error grows by a factor of {growth:.3g} per sample; lower the gain or raise control.rate"
        )
    return found


def _growth(scene: Scene, gains: Sequence[float], period_s: float, delay_s: float, lag_s: float) -> tuple[float, str]:
    """Return by how much small motion of a scene grows per sample, and where: about which axis it is unstable."""
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
    return growth, f"beside {np.linalg.norm(inside):.3g} N m s of wheels and rotors"


class _EnoughError(Exception):
    """A trial flight has shown enough."""


def _tried(campaign: Campaign, control: Control) -> list[str]:
    """Return what run 0, and run 0 with half the period and delay, say about the period."""
    period_s, delay_s = control.period_ns / NANOSECONDS, delay_ns(control, values_of(campaign, 0)) / NANOSECONDS
    flight = _flown(_faster(campaign, control, delay_s, 1), control.period_ns)
    rates, strain = flight.rates, _strain(campaign, flight)
    away = _runs_away(rates, control.period_ns)
    if len(rates) < (_LEAST_AWAY if away else _LEAST_SAMPLES):
        return strain
    start, *_, end = _quarters(rates)
    # What grows fast is at its largest before the first quarter is over.
    if end < _GROWN * min(start, rates[0]):
        return strain
    for parts in _PARTS if away else _PARTS[:1]:
        finer = _flown(_faster(campaign, control, delay_s, parts), control.period_ns, len(rates)).rates
        if len(finer) == len(rates) and end > _MORE * (most := max(_quarters(finer))):
            break
    else:
        return strain
    part = "half" if parts == 2 else f"1/{parts} of"
    sensed = Scenes(campaign).base.sensors
    keeping_up = ", and sensors as fast," if sensed else ""
    raised = "control.rate and the rate of sensors" if sensed else "control.rate"
    told = (
        f"{control.law} depends on its period of {period_s:g} s: in the first {(len(rates) - 1) * period_s:g} s of run "
        f"0 the rate of the body grows to {end:.2g} rad/s, with {part} the period and delay{keeping_up} to no more "
        f"than {most:.2g}; a torque that has to change within the period, such as a gyroscopic one, drives what it "
        f"should damp while it is held: lower the gain, raise {raised}, or let actuators or effects of the scene give "
        "it"
    )
    return [*strain, told]


def _faster(campaign: Campaign, control: Control, delay_s: float, parts: int) -> Campaign:
    """Return `campaign` with a part of the period and of the delay, `delay_s`, of run 0, and without noise.

    Sensors keep up with that: no faster than the law, unless they are anyway.
    """
    given = {DELAY: delay_s / parts, "control.noise.attitude": 0.0, "control.noise.rate": 0.0}
    period_ns = max(1, control.period_ns // parts)
    sensors: dict[str, float] = {}
    if parts > 1:
        for each in Scenes(campaign).base.sensors:
            rate = max(each.rate, min(parts * each.rate, NANOSECONDS / period_ns))
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


class _Flight(NamedTuple):
    """What a trial flight of run 0 shows.

    Attributes:
        rates: angular rate every period, rad/s.
        full: wheels that came near their `max_speed`, and when first, s.
        rejected: number of rejected commands.
    """

    rates: list[float]
    full: dict[str, float]
    rejected: int


def _flown(campaign: Campaign, period_ns: int, most: int = _MOST_SAMPLES) -> _Flight:
    """Return what run 0 shows every period, at most until it runs away or fails."""
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
        if len(rates) == most or _runs_away(rates, period_ns):
            raise _EnoughError

    # The row of a run that fails says why.
    with contextlib.suppress(_EnoughError, ConvergenceError, FunctionError, SceneError):
        simulate_alone(replace(campaign, observe_ns=period_ns, metrics=()), 0, watch=watch)
    return _Flight(rates, full, rejected)


def _strain(campaign: Campaign, flight: _Flight) -> list[str]:
    """Return what actuators cannot do in run 0."""
    speeds = {wheel.name: wheel.max_speed for wheel in Scenes(campaign).base.wheels}
    found = [
        f"{name} comes near its max_speed of {speeds[name]:g} rad/s in run 0, at {at:g} s, beyond which it gives no "
        "torque; take momentum out otherwise, or allow it more speed"
        for name, at in flight.full.items()
    ]
    if flight.rejected:
        found.append(
            f"{flight.rejected} commands are rejected in the first {len(flight.rates)} samples of run 0, such as an "
            "on-time below minimum_on; --rerun 0 writes a log of which inspect tells more"
        )
    return found


def _runs_away(rates: list[float], period_ns: int) -> bool:
    """Return whether the body turns by half a turn in a period at the end of `rates`."""
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

    Numbers, or n x n matrices. What stiffness and damping give is sampled every `period_s`, commanded `delay_s` later
    and held, and followed with a lag. 0 where the delay is too long to tell.
    """
    import numpy as np
    from scipy.linalg import expm

    whole, part_s = divmod(delay_s, period_s)
    waiting = int(whole) + 1
    if waiting > _MOST_WAITING:
        return 0.0
    stiffness, damping, turning = (np.atleast_2d(each) for each in (stiffness, damping, turning))
    one, free = np.eye(n := len(stiffness)), not stiffness.any()
    # theta, w and, with a lag, what acts; in time, the last columns are what is commanded.
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
        # Without stiffness the attitude is free.
        matrix = matrix[n:, n:]
    return float(np.abs(np.linalg.eigvals(matrix)).max())
