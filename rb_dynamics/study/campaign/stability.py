"""Predict from the base scene, before the runs, whether a loop samples too slowly to be stable.

For the laws of this package small motion about one principal axis is linear: theta' = w, I w' = u, with u = -k theta -
d w sampled every T, acting a delay later and held, through a channel that may have a delay and a lag of its own. Each
sample multiplies the state by a matrix; the motion grows if an eigenvalue has a magnitude above 1 (Astrom and
Wittenmark, Computer-Controlled Systems, section 3.2).
"""

from __future__ import annotations

from collections.abc import Mapping

from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.vector import norm
from rb_dynamics.study.campaign.bodies import CHANNEL
from rb_dynamics.study.campaign.control import delay_ns
from rb_dynamics.study.campaign.model import Campaign
from rb_dynamics.study.campaign.scenes import Scenes

_GAINS: Mapping[str, tuple[str, str]] = {"rate_damping": ("", "gain"), "attitude_pd": ("proportional", "derivative")}
"""Parameters of a law: stiffness and damping."""

_MOST_WAITING = 200
"""Samples of delay up to which eigenvalues are computed."""

_TURN = 0.5
"""Angle between samples (rad) beyond which a law does not see how the body turns."""


def remarks(campaign: Campaign) -> list[str]:
    """Return what is wrong with the control period of a campaign, empty if nothing is known to be."""
    control = campaign.control
    if control is None:
        return []
    base, found = Scenes(campaign).base, []
    period_s, delay_s = control.period_ns / NANOSECONDS, delay_ns(control, {}) / NANOSECONDS
    channel = next((each for each in base.channels if each.topic == CHANNEL), Channel(CHANNEL))
    delay_s += channel.delay
    turn = norm(base.initial.angular_velocity_body) * period_s
    if turn > _TURN:
        found.append(
            f"the body turns by {turn:.2g} rad from one sample of the control law to the next; raise control.rate"
        )
    lagging = f", followed with a lag of {channel.lag:g} s" if channel.lag else ""
    names = _GAINS.get(control.law)
    if names is None:
        return found
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
