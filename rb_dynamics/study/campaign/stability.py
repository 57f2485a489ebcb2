"""Predict from the base scene, before the runs, whether a loop samples too slowly to be stable.

For the laws of this package small motion about one principal axis is linear: theta' = w, I w' = u, with u = -k theta -
d w sampled every T, acting a delay later and held. Each sample multiplies the state by a matrix; the motion grows if an
eigenvalue has a magnitude above 1 (Astrom and Wittenmark, Computer-Controlled Systems, section 3.2).
"""

from __future__ import annotations

from collections.abc import Mapping

from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.vector import norm
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
    turn = norm(base.initial.angular_velocity_body) * period_s
    if turn > _TURN:
        found.append(
            f"the body turns by {turn:.2g} rad from one sample of the control law to the next; raise control.rate"
        )
    names = _GAINS.get(control.law)
    if names is None:
        return found
    numbers = dict(control.numbers)
    stiffness, damping = (numbers.get(f"control.parameters.{name}", 0.0) for name in names)
    for moment in sorted(set(base.body.principal_moments)):
        growth = growth_per_sample(stiffness / moment, damping / moment, period_s, delay_s)
        if growth > 1.0 + 1e-9:
            found.append(
                f"{control.law} is unstable about the axis of {moment:.4g} kg m²: with a period of {period_s:g} s and "
                f"a delay of {delay_s:g} s, an error grows by a factor of {growth:.3g} per sample; lower the gain or "
                "raise control.rate"
            )
            break
    return found


def growth_per_sample(stiffness: float, damping: float, period_s: float, delay_s: float) -> float:
    """Return the factor by which theta'' = -stiffness theta - damping theta' grows; 0 where the delay is too long.

    The right side is sampled every `period_s`, acts `delay_s` later and is held.
    """
    import numpy as np

    whole, part_s = divmod(delay_s, period_s)
    waiting = int(whole) + 1
    if waiting > _MOST_WAITING:
        return 0.0
    # theta, w, and the commands of the last samples, newest first; the one that acts after `part_s` is `waiting` - 1
    # samples old, and the one before it acts until then.
    matrix, rest_s = np.zeros((2 + waiting, 2 + waiting)), period_s - part_s
    command = np.zeros(2 + waiting)
    command[:2] = -stiffness, -damping
    new = command if waiting == 1 else np.eye(2 + waiting)[waiting]
    old = np.eye(2 + waiting)[1 + waiting]
    matrix[0, :2] = 1.0, period_s
    matrix[0] += 0.5 * rest_s * rest_s * new + (part_s * period_s - 0.5 * part_s * part_s) * old
    matrix[1, 1] = 1.0
    matrix[1] += rest_s * new + part_s * old
    matrix[2] = command
    matrix[3:, 2:-1] = np.eye(waiting - 1)
    if stiffness == 0.0:
        # Without stiffness the attitude is free.
        matrix = matrix[1:, 1:]
    return float(np.abs(np.linalg.eigvals(matrix)).max())
