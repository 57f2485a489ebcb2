"""Tell before the runs whether a loop samples too slowly to be stable.

For the laws of this package small motion about one principal axis is linear: theta' = w, I w' = u, with u = -k theta -
d w sampled every T, acting a delay later and held, through a channel that may have a delay and a lag of its own. Each
sample multiplies the state by a matrix; the motion grows if an eigenvalue has a magnitude above 1 (Astrom and
Wittenmark, Computer-Controlled Systems, section 3.2). Any other law may keep state and see sensors, so its matrix is
not known: run 0 is simulated with it, and again with half the period and delay. If a rate grows, and grows much less in
the second run, the period is the cause.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.vector import norm
from rb_dynamics.run.scene_remarks import TURN_SEEN, scene_remarks
from rb_dynamics.study.campaign.block_of_runs import simulate_alone, values_of
from rb_dynamics.study.campaign.bodies import CHANNEL
from rb_dynamics.study.campaign.control import DELAY, delay_ns
from rb_dynamics.study.campaign.distributions import Choice
from rb_dynamics.study.campaign.model import Campaign, Control
from rb_dynamics.study.campaign.scenes import Scenes
from rb_dynamics.study.campaign.user_functions import FunctionError

if TYPE_CHECKING:
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
    channel = next((each for each in base.channels if each.topic == CHANNEL), Channel(CHANNEL))
    delay_s += channel.delay
    turn = norm(base.initial.angular_velocity_body) * period_s
    if turn > TURN_SEEN:
        found.append(
            f"the body turns by {turn:.2g} rad from one sample of the control law to the next; raise control.rate"
        )
    lagging = f", followed with a lag of {channel.lag:g} s" if channel.lag else ""
    names = _GAINS.get(control.law)
    if names is None:
        return found + _tried(campaign, control)
    numbers = dict(control.numbers)
    stiffness, damping = (numbers.get(f"control.parameters.{name}", 0.0) for name in names)
    for moment in sorted(set(base.body.principal_moments)):
        growth = growth_per_sample(stiffness / moment, damping / moment, period_s, delay_s, channel.lag)
        if growth > 1.0 + 1e-9:
            found.append(
                f"{control.law} is unstable about the axis of {moment:.4g} kg m²: with a period of {period_s:g} s and "
                f"a delay of {delay_s:g} s{lagging}, an error grows by a factor of {growth:.3g} per sample; lower the "
                "gain or raise control.rate"
            )
            break
    return found


class _EnoughError(Exception):
    """A trial flight has shown enough."""


def _tried(campaign: Campaign, control: Control) -> list[str]:
    """Return what run 0, and run 0 with half the period and delay, say about the period."""
    period_s, delay_s = control.period_ns / NANOSECONDS, delay_ns(control, values_of(campaign, 0)) / NANOSECONDS
    rates = _rates(_faster(campaign, control, delay_s, 1), control.period_ns)
    away = _runs_away(rates, control.period_ns)
    if len(rates) < (_LEAST_AWAY if away else _LEAST_SAMPLES):
        return []
    start, *_, end = _quarters(rates)
    if end < _GROWN * start:
        return []
    for parts in _PARTS if away else _PARTS[:1]:
        finer = _rates(_faster(campaign, control, delay_s, parts), control.period_ns, len(rates))
        if len(finer) == len(rates) and end > _MORE * (most := max(_quarters(finer))):
            break
    else:
        return []
    part = "half" if parts == 2 else f"1/{parts} of"
    told = (
        f"{control.law} depends on its period of {period_s:g} s: in the first {(len(rates) - 1) * period_s:g} s of run "
        f"0 the rate of the body grows to {end:.2g} rad/s, with {part} the period and delay to no more than "
        f"{most:.2g}; a torque that has to change within the period, such as a gyroscopic one, drives what it should "
        "damp while it is held: lower the gain, raise control.rate, or let actuators or effects of the scene give it"
    )
    return [told]


def _faster(campaign: Campaign, control: Control, delay_s: float, parts: int) -> Campaign:
    """Return `campaign` with a part of the period and of the delay, `delay_s`, of run 0, and without noise."""
    given = {DELAY: delay_s / parts, "control.noise.attitude": 0.0, "control.noise.rate": 0.0}
    numbers = tuple((key, given.get(key, value)) for key, value in control.numbers)
    inputs = tuple(
        replace(each, distribution=Choice((given[each.name],), (1.0,))) if each.name in given else each
        for each in campaign.inputs
    )
    period_ns = max(1, control.period_ns // parts)
    return replace(campaign, control=replace(control, period_ns=period_ns, numbers=numbers), inputs=inputs)


def _rates(campaign: Campaign, period_ns: int, most: int = _MOST_SAMPLES) -> list[float]:
    """Return the angular rate (rad/s) of run 0 every period, at most until it runs away or fails."""
    found: list[float] = []

    def watch(samples: Samples) -> None:
        found.append(math.hypot(*samples.angular_velocity_body[0].tolist()))
        if len(found) == most or _runs_away(found, period_ns):
            raise _EnoughError

    # The row of a run that fails says why.
    with contextlib.suppress(_EnoughError, ConvergenceError, FunctionError, SceneError):
        simulate_alone(replace(campaign, observe_ns=period_ns, metrics=()), 0, watch=watch)
    return found


def _runs_away(rates: list[float], period_ns: int) -> bool:
    """Return whether the body turns by half a turn in a period at the end of `rates`."""
    return bool(rates) and rates[-1] * period_ns > math.pi * NANOSECONDS


def _quarters(rates: list[float]) -> tuple[float, ...]:
    """Return the root mean square of each quarter of `rates`."""
    size = len(rates) // 4
    parts = (rates[k * size : (k + 1) * size] for k in range(3))
    return tuple(math.hypot(*part) / math.sqrt(len(part)) for part in (*parts, rates[3 * size :]))


def growth_per_sample(stiffness: float, damping: float, period_s: float, delay_s: float, lag_s: float = 0.0) -> float:
    """Return the factor by which theta'' = -stiffness theta - damping theta' grows; 0 where the delay is too long.

    The right side is sampled every `period_s`, commanded `delay_s` later and held, and followed with a lag.
    """
    import numpy as np
    from scipy.linalg import expm

    whole, part_s = divmod(delay_s, period_s)
    waiting = int(whole) + 1
    if waiting > _MOST_WAITING:
        return 0.0
    # theta, w and, with a lag, what acts; in time, the last column is what is commanded.
    count = 3 if lag_s > 0.0 else 2
    rates = np.zeros((count + 1, count + 1))
    rates[0, 1] = rates[1, 2] = 1.0
    if lag_s > 0.0:
        rates[2, 2:] = -1.0 / lag_s, 1.0 / lag_s
    before, after = expm(part_s * rates)[:count], expm((period_s - part_s) * rates)[:count]
    # Behind them the commands of the last samples, newest first; the one that acts after `part_s` is `waiting` - 1
    # samples old, and the one before it acts until then.
    size = count + waiting
    command, states = np.zeros(size), np.eye(size)
    command[:2] = -stiffness, -damping
    new = command if waiting == 1 else states[size - 2]
    matrix = np.zeros((size, size))
    then = before[:, :count] @ states[:count] + np.outer(before[:, count], states[size - 1])
    matrix[:count] = after[:, :count] @ then + np.outer(after[:, count], new)
    matrix[count] = command
    matrix[count + 1 :, count:-1] = np.eye(waiting - 1)
    if stiffness == 0.0:
        # Without stiffness the attitude is free.
        matrix = matrix[1:, 1:]
    return float(np.abs(np.linalg.eigvals(matrix)).max())
